"""A frame of laser tag in one env: fighters act, orbs fly, supplies are taken, time heals."""

import math

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.labyrinth.lasertag.arena import (
    AMMUNITION,
    ARMOUR,
    ARMOUR_PACK,
    CLOCK,
    FIRST_HEALTH,
    GADGET,
    HEALTH,
    HEALTH_PACK,
    LOADED,
    LONGEST_REST,
    MILLISECONDS,
    MOST_AMMUNITION,
    MOST_ARMOUR,
    MOST_HEALTH,
    NOTHING,
    PACK,
    RAPID,
    REST,
    RETURN,
    SHOOTER,
    SUPPLIES,
    TAGGED_AT,
    TAGS,
    WAIT,
)
from zipf.envs.labyrinth.lasertag.opponents import act, forget, think
from zipf.envs.labyrinth.lasertag.shooting import fly, make_ready, shoot, take
from zipf.envs.labyrinth.lasertag.walking import walk
from zipf.envs.labyrinth.mover import BELOW
from zipf.envs.labyrinth.state import CELL, TOUCH_X, TOUCH_Y, TOUCH_Z, YAW, X, Y, Z

THINKING = 6  # frames from thought to thought of an opponent: 0.1 s
OPPONENTS_REST = REST + THINKING  # frames until opponents respawn
ROOM = 60.0  # who respawns keeps this distance from others, along x or y


@compiled(error_model="numpy")
def fight(envs, i, turn, rise, strafe, forward, fire):
    """Passes a frame in an env with combat; the arguments are the player's action."""
    combat = envs.combat
    now, count = envs.clock[i], combat.fighters[i]
    bodies, status, minds = combat.bodies[i], combat.status[i], combat.minds[i]
    solid, kinds, until = envs.solid[i], combat.kinds[i], combat.until[i]
    places, present = envs.places[i], envs.present[i]
    bodies[0] = envs.bodies[i]
    for f in range(count):
        if status[f, TAGGED_AT] >= 0:
            rest = now - status[f, TAGGED_AT]
            wakes = (fire and rest >= REST) if f == 0 else rest >= OPPONENTS_REST
            if wakes or rest >= LONGEST_REST:
                respawn(combat, i, f)
            continue
        if f > 0:
            if (now + 2 * f) % THINKING == 0:
                think(envs, i, f)
            turn, rise, strafe, forward, fire = act(minds[f], bodies[f])
        walk(solid, bodies, status, count, f, turn, rise, strafe, forward)
        make_ready(status[f])
        if fire and status[f, WAIT] <= 0:
            shoot(envs, i, f)
        if status[f, TAGGED_AT] < 0:
            _decay(status[f])
            for k in range(SUPPLIES):
                if _touches(kinds, places, present, bodies[f], k):
                    _take_supply(envs, i, f, k)
    if _any_flies(combat.shots[i]):
        fly(envs, i)
    for k in range(SUPPLIES):
        if 0 <= until[k] <= now:
            present[k] = False
    envs.bodies[i] = bodies[0]


@compiled(error_model="numpy")
def next_point(combat, i):
    """Of the points that the episode was not told yet one, 1 or -1; 0: there is none."""
    for k in range(2):
        if combat.points[i, k] > 0:
            combat.points[i, k] -= 1
            return 1 - 2 * k
    return 0


@compiled(error_model="numpy")
def respawn(combat, i, f):
    """Puts a fighter in a random spawn cell that is free, looking anywhere, as good as new."""
    stream, body, status = combat.stream[i], combat.bodies[i, f], combat.status[i, f]
    free = 0
    for k in range(combat.spawn_count[i]):
        free += _is_free(combat, i, f, k)
    chosen = pcg64.below(stream, max(free, 1))
    for k in range(combat.spawn_count[i]):
        if free == 0 or _is_free(combat, i, f, k):
            if chosen == 0:
                body[:] = 0.0
                body[X] = CELL * (combat.spawns[i, k, 1] + 0.5)
                body[Y] = CELL * (combat.spawns[i, k, 0] + 0.5)
                break
            chosen -= 1
    body[Z], body[YAW] = BELOW, pcg64.between(stream, 0.0, 2 * math.pi)
    tags = status[TAGS]
    status[:] = 0
    status[TAGS] = tags
    status[HEALTH], status[GADGET] = FIRST_HEALTH, RAPID
    status[LOADED + RAPID] = AMMUNITION[RAPID]
    status[TAGGED_AT] = -1
    forget(combat.minds[i, f])


@compiled(error_model="numpy")
def _is_free(combat, i, f, spawn):
    """Whether nobody else stands in or near a spawn cell."""
    row, column = combat.spawns[i, spawn]
    for other in range(combat.fighters[i]):
        if other != f and combat.status[i, other, TAGGED_AT] < 0:
            body = combat.bodies[i, other]
            off_x, off_y = CELL * (column + 0.5) - body[X], CELL * (row + 0.5) - body[Y]
            if abs(off_x) < ROOM and abs(off_y) < ROOM:
                return False
    return True


@compiled(error_model="numpy")
def _decay(status):
    """More health and armour than usual shrinks by 1 a second."""
    status[CLOCK] += MILLISECONDS
    if status[CLOCK] >= 1000:
        status[CLOCK] -= 1000
        status[HEALTH] -= status[HEALTH] > MOST_HEALTH
        status[ARMOUR] -= status[ARMOUR] > MOST_HEALTH


@compiled(error_model="numpy")
def _any_flies(shots):
    flying = 0
    for k in range(len(shots)):
        flying += shots[k, SHOOTER] >= 0
    return flying > 0


@compiled(error_model="numpy")
def _touches(kinds, places, present, body, k):
    """Whether supply k lies there and a body touches it."""
    return (
        kinds[k] != NOTHING
        and present[k]
        and abs(body[X] - places[k, 0]) <= TOUCH_X
        and abs(body[Y] - places[k, 1]) <= TOUCH_Y
        and abs(body[Z] - places[k, 2]) <= TOUCH_Z
    )


@compiled(error_model="numpy")
def _take_supply(envs, i, f, k):
    """A fighter takes a supply, if it is of use to him; a gadget comes to hand."""
    combat = envs.combat
    status, kind = combat.status[i, f], combat.kinds[i, k]
    if kind == HEALTH_PACK:
        if status[HEALTH] >= MOST_HEALTH:
            return
        status[HEALTH] = min(status[HEALTH] + PACK, MOST_HEALTH)
    elif kind == ARMOUR_PACK:
        if status[ARMOUR] >= MOST_ARMOUR:
            return
        status[ARMOUR] = min(status[ARMOUR] + PACK, MOST_ARMOUR)
    else:
        shots = max(status[LOADED + kind] + 1, AMMUNITION[kind])
        status[LOADED + kind] = min(shots, MOST_AMMUNITION)
        take(status, kind)
    envs.present[i, k] = False
    if combat.until[i, k] < 0:
        envs.returning[i, k] = envs.clock[i] + RETURN[kind]
