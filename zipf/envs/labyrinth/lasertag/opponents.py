"""How opponents play: ten times a second each decides where to go, where to look, when to shoot.

Their parameters are those of DeepMind Lab's first three bots at skill 4; what they do with them is
ours. An opponent fights the nearest enemy it sees: it turns to it, strafes, keeps its distance and
fires in bursts. Out of sight it fetches supplies it can use, looks where the enemy was last, or
roams: to a random spawn cell, or to where somebody else is, whom it is said to hear. It walks by
the shortest way through the maze and moves by the same kinematics as the player.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.labyrinth.grids import distances
from zipf.envs.labyrinth.lasertag.arena import (
    AIM_PITCH,
    AIM_YAW,
    AMMUNITION,
    ARMOUR,
    ARMOUR_PACK,
    ATTACKED_AT,
    ATTACKER,
    BEAM,
    ENEMY,
    FIELD_COLUMN,
    FIELD_ROW,
    GADGET,
    GOAL_COLUMN,
    GOAL_ROW,
    HEALTH,
    HEALTH_PACK,
    IMPULSE,
    LAST_COLUMN,
    LAST_ROW,
    LAST_SEEN,
    LOADED,
    NOTHING,
    ORB,
    PACK,
    PAUSE_UNTIL,
    REACH,
    SECOND,
    SEEN_AT,
    SHOOT_UNTIL,
    SIDE,
    SIDE_UNTIL,
    STAY_UNTIL,
    SUPPLIES,
    TAGGED_AT,
    TRIGGER,
    WISH_X,
    WISH_Y,
)
from zipf.envs.labyrinth.lasertag.shooting import BLAST_RADIUS, ORB_SPEED
from zipf.envs.labyrinth.lasertag.sight import in_view
from zipf.envs.labyrinth.mover import EYE
from zipf.envs.labyrinth.state import CELL, PITCH, VX, VY, YAW, X, Y, Z

ACCURACY = np.array(
    [[1.0, 0.7, 0.9, 0.7, 1.0], [1.0, 0.9, 0.9, 0.9, 0.9], [1.0, 0.5, 0.75, 0.75, 0.75]]
)
"""For each opponent and gadget; Impulse's is ours."""
THROTTLE = np.array([0.5, 0.9, 1.0])
CAMPING = np.array([0.3, 0.5, 0.5])
REACTION, AIM_DELAY = 1.0 * SECOND, 0.5 * SECOND
"""Frames from the first sight of an enemy to the first shot, and until it turns to it."""
TURN = math.radians(240.0 / SECOND)  # most that an opponent turns in a frame
CONE, CLOSE_CONE, CLOSE = math.radians(25.0), math.radians(60.0), 100.0
"""Largest angle between its view and an enemy at which it shoots; CLOSE_CONE within CLOSE units."""
SIGHT = math.radians(60.0)  # half the angle of its field of view
NEAREST, FARTHEST = 150.0, 400.0  # distances that it keeps from an enemy, units
LOW_HEALTH, WOUNDED = 40, 70
"""Health below which it leaves a fight to be healed, and heals itself when there is no fight."""
DETOUR = 800.0
"""It goes so far for a supply, along x and y together, and anywhere once all it has is Impulse."""
CHASE = 5 * SECOND  # frames for which it looks for an enemy that went out of sight
CALM = 2 * SECOND  # frames out of sight after which an enemy surprises it again
LOYALTY = 0.7  # the enemy that it fights counts as nearer by this factor
HEARING = 0.7  # how often it roams to where another fighter is
PEACE = -10.0 * CHASE  # when nothing has happened yet


@compiled(error_model="numpy")
def forget(mind):
    """An opponent begins anew."""
    mind[:] = 0.0
    mind[ENEMY] = mind[ATTACKER] = NOTHING
    mind[SEEN_AT] = mind[LAST_SEEN] = mind[ATTACKED_AT] = PEACE
    mind[GOAL_ROW] = mind[FIELD_ROW] = NOTHING
    mind[SIDE] = 1.0


@compiled(error_model="numpy")
def act(mind, body):
    """What an opponent does in a frame: turn to the left and upwards, strafe, go forward, fire."""
    turn = min(max(_wrapped(mind[AIM_YAW] - body[YAW]), -TURN), TURN)
    rise = min(max(mind[AIM_PITCH] - body[PITCH], -TURN), TURN)
    cos, sin = math.cos(body[YAW] + turn), math.sin(body[YAW] + turn)
    forward = mind[WISH_X] * cos + mind[WISH_Y] * sin
    strafe = mind[WISH_X] * sin - mind[WISH_Y] * cos
    return turn, rise, strafe, forward, mind[TRIGGER] > 0.0


@compiled(error_model="numpy")
def think(envs, i, f):
    """An opponent looks around and decides what it does until it thinks again."""
    combat = envs.combat
    mind, body, status = combat.minds[i, f], combat.bodies[i, f], combat.status[i, f]
    now, solid = envs.clock[i], envs.solid[i]
    enemy = _look_around(combat, solid, i, now, f)
    if enemy != NOTHING:
        if enemy != mind[ENEMY] or now - mind[LAST_SEEN] > CALM:
            mind[SEEN_AT] = now
        there = combat.bodies[i, enemy]
        mind[ENEMY], mind[LAST_SEEN] = enemy, now
        mind[LAST_ROW], mind[LAST_COLUMN] = there[Y] // CELL, there[X] // CELL
    mind[WISH_X] = mind[WISH_Y] = 0.0
    mind[TRIGGER] = 0.0
    noticed = enemy != NOTHING and now - mind[SEEN_AT] >= AIM_DELAY
    hurt = status[HEALTH] < LOW_HEALTH
    supply = NOTHING
    if not noticed or hurt or status[GADGET] == IMPULSE:
        supply = _useful_supply(combat, envs.places[i], envs.present[i], i, f, hurt and noticed)
    if noticed and supply == NOTHING:
        _close_in(combat, i, now, f, combat.bodies[i, int(enemy)])
    else:
        if supply != NOTHING:
            place = envs.places[i, supply]
            _go_to(combat, solid, i, f, place[1] // CELL, place[0] // CELL)
        elif now - mind[LAST_SEEN] < CHASE:
            _go_to(combat, solid, i, f, mind[LAST_ROW], mind[LAST_COLUMN])
        else:
            _roam(combat, solid, i, now, f)
        if mind[WISH_X] != 0.0 or mind[WISH_Y] != 0.0:
            mind[AIM_YAW], mind[AIM_PITCH] = math.atan2(mind[WISH_Y], mind[WISH_X]), 0.0
    if noticed:
        _aim(combat, i, f, int(enemy))
        if now - mind[SEEN_AT] >= REACTION:
            mind[TRIGGER] = _pulls_trigger(combat, i, now, f, combat.bodies[i, int(enemy)])
    elif now - mind[ATTACKED_AT] < SECOND and mind[ATTACKER] >= 0:
        # Whoever shoots it in the back is looked for there.
        there = combat.bodies[i, int(mind[ATTACKER])]
        mind[AIM_YAW] = math.atan2(there[Y] - body[Y], there[X] - body[X])


@compiled(error_model="numpy")
def _look_around(combat, solid, i, now, f):
    """The enemy to fight: the nearest one that is seen; or NOTHING."""
    mind, body = combat.minds[i, f], combat.bodies[i, f]
    found, least = NOTHING, math.inf
    for other in range(combat.fighters[i]):
        if other == f or combat.status[i, other, TAGGED_AT] >= 0:
            continue
        there = combat.bodies[i, other]
        dx, dy = there[X] - body[X], there[Y] - body[Y]
        away = math.hypot(dx, dy)
        fights = other == mind[ENEMY] and now - mind[LAST_SEEN] < SECOND
        if fights:
            away *= LOYALTY
        if away >= least:
            continue
        off = abs(_wrapped(math.atan2(dy, dx) - body[YAW]))
        if not fights and off > SIGHT and away > CLOSE:
            continue
        if in_view(solid, body[X], body[Y], there[X], there[Y]):
            found, least = other, away
    return found


@compiled(error_model="numpy")
def _close_in(combat, i, now, f, there):
    """Strafes around an enemy in view and keeps a distance."""
    mind, body, stream = combat.minds[i, f], combat.bodies[i, f], combat.stream[i]
    dx, dy = there[X] - body[X], there[Y] - body[Y]
    away = math.hypot(dx, dy) + 1e-9
    dx, dy = dx / away, dy / away
    if now >= mind[SIDE_UNTIL] or math.hypot(body[VX], body[VY]) < 20.0:
        mind[SIDE] = -mind[SIDE]
        mind[SIDE_UNTIL] = now + pcg64.between(stream, 0.4, 1.0) * SECOND
    ahead = 0.0
    if combat.status[i, f, GADGET] == IMPULSE or away > FARTHEST:
        ahead = 1.0
    elif away < NEAREST:
        ahead = -1.0
    side = mind[SIDE] if combat.status[i, f, GADGET] != IMPULSE else 0.0
    mind[WISH_X], mind[WISH_Y] = ahead * dx + side * dy, ahead * dy - side * dx


@compiled(error_model="numpy")
def _aim(combat, i, f, enemy):
    """Looks at where an enemy is or will be, with an error that depends on the gadget."""
    mind, body, stream = combat.minds[i, f], combat.bodies[i, f], combat.stream[i]
    there = combat.bodies[i, enemy]
    gadget = combat.status[i, f, GADGET]
    accuracy = ACCURACY[f - 1, gadget]
    off = 20.0 * (1.0 - accuracy)
    x = there[X] - body[X] + pcg64.between(stream, -off, off)
    y = there[Y] - body[Y] + pcg64.between(stream, -off, off)
    z = there[Z] - body[Z] - EYE + 8.0 + pcg64.between(stream, -off / 2, off / 2)
    away = math.sqrt(x * x + y * y + z * z) + 1e-9
    if gadget == ORB:
        x += there[VX] * away / ORB_SPEED
        y += there[VY] * away / ORB_SPEED
        away = math.sqrt(x * x + y * y + z * z) + 1e-9
    x, y, z = x / away, y / away, z / away
    if accuracy < 0.8:
        off = 0.3 * (1.0 - accuracy)
        x += pcg64.between(stream, -off, off)
        y += pcg64.between(stream, -off, off)
        z += pcg64.between(stream, -off, off)
    mind[AIM_YAW], mind[AIM_PITCH] = math.atan2(y, x), math.atan2(z, math.hypot(x, y))


@compiled(error_model="numpy")
def _pulls_trigger(combat, i, now, f, there):
    """Whether an opponent that has aimed shoots."""
    mind, body, stream = combat.minds[i, f], combat.bodies[i, f], combat.stream[i]
    gadget = combat.status[i, f, GADGET]
    dx, dy = there[X] - body[X], there[Y] - body[Y]
    away = math.hypot(dx, dy)
    off = abs(_wrapped(math.atan2(dy, dx) - body[YAW]))
    if off > (CLOSE_CONE if away < CLOSE else CONE):
        return False
    if (gadget == BEAM and away > REACH[BEAM]) or (gadget == ORB and away < BLAST_RADIUS):
        return False
    if now < mind[PAUSE_UNTIL]:
        return False
    if now >= mind[SHOOT_UNTIL]:
        throttle = THROTTLE[f - 1]
        if pcg64.next_double(stream) >= throttle:
            mind[PAUSE_UNTIL] = now + throttle * SECOND
            return False
        mind[SHOOT_UNTIL] = now + (1.0 - throttle) * SECOND
    return True


@compiled(error_model="numpy")
def _useful_supply(combat, places, present, i, f, healing):
    """The nearest supply that an opponent can use, or only one that heals; or NOTHING."""
    body, status = combat.bodies[i, f], combat.status[i, f]
    found, least = NOTHING, math.inf if status[GADGET] == IMPULSE else DETOUR
    for k in range(SUPPLIES):
        kind = combat.kinds[i, k]
        if kind == NOTHING or not present[k]:
            continue
        if kind == HEALTH_PACK:
            useful = status[HEALTH] < WOUNDED
        elif healing:
            useful = False
        elif kind == ARMOUR_PACK:
            useful = status[ARMOUR] < PACK
        else:
            useful = status[LOADED + kind] <= AMMUNITION[kind] // 2
        if useful:
            place = places[k]
            away = abs(place[0] - body[X]) + abs(place[1] - body[Y])
            if away < least:
                found, least = k, away
    return found


@compiled(error_model="numpy")
def _roam(combat, solid, i, now, f):
    """Goes to a random spawn cell or another fighter, again and again; campers stay for a while."""
    mind, body, stream = combat.minds[i, f], combat.bodies[i, f], combat.stream[i]
    if now < mind[STAY_UNTIL]:
        return
    arrived = body[Y] // CELL == mind[GOAL_ROW] and body[X] // CELL == mind[GOAL_COLUMN]
    if mind[GOAL_ROW] < 0 or arrived:
        if arrived and pcg64.next_double(stream) < CAMPING[f - 1]:
            mind[STAY_UNTIL] = now + pcg64.between(stream, 0.0, 2.0) * SECOND
            mind[AIM_YAW] = body[YAW] + pcg64.between(stream, -math.pi, math.pi)
        k = pcg64.below(stream, combat.spawn_count[i])
        mind[GOAL_ROW], mind[GOAL_COLUMN] = combat.spawns[i, k, 0], combat.spawns[i, k, 1]
        if pcg64.next_double(stream) < HEARING:
            heard = pcg64.below(stream, combat.fighters[i] - 1)
            heard += heard >= f
            there = combat.bodies[i, heard]
            mind[GOAL_ROW], mind[GOAL_COLUMN] = there[Y] // CELL, there[X] // CELL
    _go_to(combat, solid, i, f, mind[GOAL_ROW], mind[GOAL_COLUMN])


@compiled(error_model="numpy")
def _go_to(combat, solid, i, f, row, column):
    """Walks towards a cell by the shortest way, then to its middle."""
    mind, body = combat.minds[i, f], combat.bodies[i, f]
    field = combat.fields[i, f]
    if row != mind[FIELD_ROW] or column != mind[FIELD_COLUMN]:
        mind[FIELD_ROW], mind[FIELD_COLUMN] = row, column
        field[:] = distances(solid, int(row), int(column))
    r, c = int(body[Y] // CELL), int(body[X] // CELL)
    best_r, best_c = r, c
    for k in range(4):
        y, x = r + (k == 1) - (k == 3), c + (k == 0) - (k == 2)
        inside = 0 <= y < solid.shape[0] and 0 <= x < solid.shape[1]
        if inside and 0 <= field[y, x] < field[best_r, best_c]:
            best_r, best_c = y, x
    dx, dy = CELL * (best_c + 0.5) - body[X], CELL * (best_r + 0.5) - body[Y]
    away = math.hypot(dx, dy)
    if away > 10.0:
        mind[WISH_X], mind[WISH_Y] = dx / away, dy / away


@compiled(error_model="numpy")
def _wrapped(angle):
    """An angle between -pi and pi."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
