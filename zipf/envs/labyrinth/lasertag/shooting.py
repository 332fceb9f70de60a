"""Gadgets: what shots hit, what damage does, and how orbs fly.

After Quake III Arena, whose gadgets DeepMind Lab renames, from a description of them.
"""

import math

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.labyrinth.lasertag.arena import (
    ARMOUR,
    ATTACKED_AT,
    ATTACKER,
    BEAM,
    BLAST,
    BORN,
    DAMAGE,
    DISC,
    DROP_LIFE,
    FLASH_FRAME,
    FLASH_KIND,
    FLASHES,
    GADGET,
    HEALTH,
    IMPULSE,
    LOADED,
    MILLISECONDS,
    NOTHING,
    ORB,
    PERIOD,
    PUFF,
    RAPID,
    REACH,
    SHOOTER,
    SHOTS,
    SLIDE,
    SPARK,
    SUPPLIES,
    TAGGED_AT,
    TAGS,
    TRACE_FRAME,
    TRACE_GADGET,
    TRACES,
    WAIT,
)
from zipf.envs.labyrinth.lasertag.sight import first_body, in_view, to_body, to_surroundings
from zipf.envs.labyrinth.mover import ABOVE, BELOW, EYE, FRAME, WIDE
from zipf.envs.labyrinth.state import PITCH, VX, VY, VZ, YAW, X, Y, Z

MUZZLE = 14.0  # distance from the eye forward to where shots begin
SPREAD = math.tan(math.radians(1.4))  # most of Rapid's, sideways in a unit of distance
ORB_SPEED, ORB_LIFE = 900.0, 600  # units per second, and frames
BLAST_RADIUS = 120.0
KNOCK_BACK = 1000.0 / 200.0
"""Speed for a point of damage."""
MOST_KNOCK_BACK = 200
CHANGE = 450
"""Milliseconds to change gadgets."""
SAVED = 0.66  # share of damage that armour takes
ARM_X, ARM_Y, ARM_Z = 16.0, 8.0, -14.0
"""Where shots are seen to begin: from the eye forward, to the right and upwards."""
_MOST_HITS = 4


@compiled(error_model="numpy")
def shoot(envs, i, f):
    """Fires the gadget of a fighter, which is ready."""
    combat = envs.combat
    status, body, stream = combat.status[i, f], combat.bodies[i, f], combat.stream[i]
    gadget = status[GADGET]
    cos, sin = math.cos(body[YAW]), math.sin(body[YAW])
    flat, dz = math.cos(body[PITCH]), math.sin(body[PITCH])
    dx, dy = cos * flat, sin * flat
    x, y, z = body[X] + MUZZLE * dx, body[Y] + MUZZLE * dy, body[Z] + EYE + MUZZLE * dz
    if gadget == RAPID:
        turn, off = pcg64.between(stream, 0.0, 2 * math.pi), pcg64.between(stream, -SPREAD, SPREAD)
        right, up = off * math.cos(turn), off * math.sin(turn)
        dx, dy = dx + right * sin - up * cos * dz, dy - right * cos - up * sin * dz
        dz += up * flat
    if gadget == ORB:
        _launch(combat.shots[i], envs.clock[i], f, x, y, z, dx, dy, dz)
    elif gadget == DISC:
        far = to_surroundings(envs.solid[i], x, y, z, dx, dy, dz, REACH[DISC])
        _trace(combat, i, envs.clock[i], f, x + far * dx, y + far * dy, z + far * dz)
        hits = 0
        for other in range(combat.fighters[i]):
            if other != f and combat.status[i, other, TAGGED_AT] < 0 and hits < _MOST_HITS:
                away = to_body(combat.bodies[i, other], x, y, z, dx, dy, dz)
                if away < far:
                    flash(
                        combat, i, envs.clock[i], x + away * dx, y + away * dy, z + away * dz, SPARK
                    )
                    hurt(envs, i, other, f, DAMAGE[DISC], dx, dy, dz)
                    hits += 1
    else:
        far = to_surroundings(envs.solid[i], x, y, z, dx, dy, dz, REACH[gadget])
        hit, far = first_body(
            combat.fighters[i], combat.bodies[i], combat.status[i], f, x, y, z, dx, dy, dz, far
        )
        if gadget == IMPULSE and hit == NOTHING:
            return
        end_x, end_y, end_z = x + far * dx, y + far * dy, z + far * dz
        if gadget != IMPULSE:
            _trace(combat, i, envs.clock[i], f, end_x, end_y, end_z)
        if hit != NOTHING:
            flash(combat, i, envs.clock[i], end_x, end_y, end_z, SPARK)
            hurt(envs, i, hit, f, DAMAGE[gadget], dx, dy, dz)
    status[WAIT] += PERIOD[gadget]
    if gadget != IMPULSE:
        status[LOADED + gadget] -= 1
        if status[LOADED + gadget] == 0:
            take_best(status)


@compiled(error_model="numpy")
def take_best(status):
    """Takes the best loaded gadget in hand."""
    for gadget in (DISC, BEAM, ORB, RAPID):
        if status[LOADED + gadget] > 0:
            take(status, gadget)
            return
    take(status, IMPULSE)


@compiled(error_model="numpy")
def take(status, gadget):
    """Takes a gadget in hand, which needs time."""
    if status[GADGET] != gadget:
        status[GADGET] = gadget
        status[WAIT] += CHANGE


@compiled(error_model="numpy")
def hurt(envs, i, target, attacker, damage, dx, dy, dz):
    """Damages a fighter, who is pushed along a direction of length 1, and may be tagged."""
    combat = envs.combat
    status, body = combat.status[i, target], combat.bodies[i, target]
    damage = max(int(damage), 1)
    push = KNOCK_BACK * min(damage, MOST_KNOCK_BACK)
    body[VX] += push * dx
    body[VY] += push * dy
    body[VZ] += push * dz
    if status[SLIDE] <= 0:
        status[SLIDE] = min(max(2 * damage, 50), 200)
    if target == attacker:
        damage = max(damage // 2, 1)
    saved = min(status[ARMOUR], math.ceil(SAVED * damage))
    status[ARMOUR] -= saved
    status[HEALTH] -= damage - saved
    combat.minds[i, target, ATTACKER] = attacker
    combat.minds[i, target, ATTACKED_AT] = envs.clock[i]
    if status[HEALTH] <= 0:
        _tag(envs, i, target, attacker)


@compiled(error_model="numpy")
def _tag(envs, i, target, attacker):
    """A fighter is tagged: vanishes, drops the gadget in hand, and gives or costs a point."""
    combat = envs.combat
    status, body = combat.status[i, target], combat.bodies[i, target]
    status[HEALTH] = 0
    status[TAGGED_AT] = envs.clock[i]
    if target > 0:  # the player would see its own from inside
        flash(combat, i, envs.clock[i], body[X], body[Y], body[Z], PUFF)
    gadget = status[GADGET]
    if gadget > RAPID and status[LOADED + gadget] > 0:
        _drop(envs, i, gadget, body[X], body[Y])
    combat.status[i, attacker, TAGS] += -1 if attacker == target else 1
    if attacker == 0:
        combat.points[i, int(target == 0)] += 1


@compiled(error_model="numpy")
def _drop(envs, i, gadget, x, y):
    """Leaves a gadget on the ground, where there is a place for it."""
    combat = envs.combat
    for k in range(SUPPLIES):
        free = combat.kinds[i, k] == NOTHING
        if free or (combat.until[i, k] >= 0 and not envs.present[i, k]):
            combat.kinds[i, k] = gadget
            combat.until[i, k] = envs.clock[i] + DROP_LIFE
            place = envs.places[i, k]
            place[0], place[1], place[2] = x, y, BELOW
            envs.present[i, k] = True
            return


@compiled(error_model="numpy")
def _launch(shots, now, f, x, y, z, dx, dy, dz):
    k = 0
    while k < SHOTS - 1 and shots[k, SHOOTER] >= 0:
        k += 1
    shots[k, 0], shots[k, 1], shots[k, 2] = x, y, z
    shots[k, 3], shots[k, 4], shots[k, 5] = dx, dy, dz
    shots[k, SHOOTER], shots[k, BORN] = f, now


@compiled(error_model="numpy")
def fly(envs, i):
    """Moves orbs by a frame. Those that meet something burst."""
    combat = envs.combat
    for k in range(SHOTS):
        shot = combat.shots[i, k]
        f = int(shot[SHOOTER])
        if f < 0:
            continue
        x, y, z, dx, dy, dz = shot[:6]
        step = ORB_SPEED * FRAME
        far = to_surroundings(envs.solid[i], x, y, z, dx, dy, dz, step)
        hit, far = first_body(
            combat.fighters[i], combat.bodies[i], combat.status[i], f, x, y, z, dx, dy, dz, far
        )
        shot[0], shot[1], shot[2] = x + far * dx, y + far * dy, z + far * dz
        if hit != NOTHING or far < step or envs.clock[i] - shot[BORN] > ORB_LIFE:
            shot[SHOOTER] = NOTHING
            back = max(far - 1.0, 0.0)  # off the wall
            x, y, z = x + back * dx, y + back * dy, z + back * dz
            flash(combat, i, envs.clock[i], x, y, z, BLAST)
            if hit != NOTHING:
                hurt(envs, i, hit, f, DAMAGE[ORB], dx, dy, dz)
            _burst(envs, i, x, y, z, f, hit)


@compiled(error_model="numpy")
def _burst(envs, i, x, y, z, shooter, spared):
    """Damages the fighters around an orb that bursts, the less the farther they are."""
    combat = envs.combat
    for f in range(combat.fighters[i]):
        if f == spared or combat.status[i, f, TAGGED_AT] >= 0:
            continue
        body = combat.bodies[i, f]
        off_x = max(abs(x - body[X]) - WIDE, 0.0)
        off_y = max(abs(y - body[Y]) - WIDE, 0.0)
        off_z = max(body[Z] - BELOW - z, z - body[Z] - ABOVE, 0.0)
        damage = DAMAGE[ORB] * (1.0 - math.sqrt(off_x**2 + off_y**2 + off_z**2) / BLAST_RADIUS)
        if damage <= 0.0 or not in_view(envs.solid[i], x, y, body[X], body[Y]):
            continue
        dx, dy, dz = body[X] - x, body[Y] - y, body[Z] - z + BELOW
        length = math.sqrt(dx * dx + dy * dy + dz * dz) + 1e-9
        hurt(envs, i, f, shooter, damage, dx / length, dy / length, dz / length)


@compiled(error_model="numpy")
def flash(combat, i, now, x, y, z, kind):
    """Lets something flash in the view."""
    k = combat.written[i, 1] % FLASHES
    combat.written[i, 1] += 1
    made = combat.flashes[i, k]
    made[0], made[1], made[2] = x, y, z
    made[FLASH_FRAME], made[FLASH_KIND] = now, kind


@compiled(error_model="numpy")
def _trace(combat, i, now, f, x, y, z):
    """Remembers a shot for the view."""
    body = combat.bodies[i, f]
    k = combat.written[i, 0] % TRACES
    combat.written[i, 0] += 1
    cos, sin = math.cos(body[YAW]), math.sin(body[YAW])
    made = combat.traces[i, k]
    made[0] = body[X] + ARM_X * cos + ARM_Y * sin
    made[1] = body[Y] + ARM_X * sin - ARM_Y * cos
    made[2] = body[Z] + EYE + ARM_Z
    made[3], made[4], made[5] = x, y, z
    made[TRACE_FRAME] = now
    made[TRACE_GADGET] = combat.status[i, f, GADGET]


@compiled(error_model="numpy")
def make_ready(status):
    """A frame passes for a fighter's gadget and for what slows it."""
    if status[WAIT] > 0:
        status[WAIT] -= MILLISECONDS
    if status[SLIDE] > 0:
        status[SLIDE] -= MILLISECONDS
