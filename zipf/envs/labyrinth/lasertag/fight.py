"""A frame of laser tag in one world: fighters act, orbs fly, supplies are taken, time heals."""

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
    SLIDE,
    SUPPLIES,
    TAGGED_AT,
    TAGS,
    WAIT,
)
from zipf.envs.labyrinth.lasertag.opponents import act, forget, think
from zipf.envs.labyrinth.lasertag.shooting import fly, make_ready, shoot, take
from zipf.envs.labyrinth.lasertag.sight import body_of, is_up
from zipf.envs.labyrinth.mover import ACCELERATION, BELOW, IN_AIR, WIDE, move_body
from zipf.envs.labyrinth.state import (
    CELL,
    TOUCH_X,
    TOUCH_Y,
    TOUCH_Z,
    VX,
    YAW,
    X,
    Y,
    Z,
)

THINKING = 6
"""Frames from thought to thought of an opponent: 0.1 s."""
OPPONENTS_REST = REST + THINKING
"""Frames until opponents respawn."""
ROOM = 60.0
"""Who respawns keeps this distance from others, along x or y."""


@compiled(error_model="numpy")
def fight(worlds, i, turn, rise, strafe, forward, fire):
    """Passes a frame in a world with combat; the arguments are the player's action."""
    combat = worlds.combat
    now = worlds.clock[i]
    for f in range(combat.count[i]):
        status = combat.status[i, f]
        if status[TAGGED_AT] >= 0:
            rest = now - status[TAGGED_AT]
            wakes = (fire and rest >= REST) if f == 0 else rest >= OPPONENTS_REST
            if wakes or rest >= LONGEST_REST:
                respawn(worlds, i, f)
            continue
        if f > 0:
            if (now + 2 * f) % THINKING == 0:
                think(worlds, i, f)
            turn, rise, strafe, forward, fire = act(worlds, i, f)
        _walk(worlds, i, f, turn, rise, strafe, forward)
        make_ready(status)
        if fire and status[WAIT] <= 0:
            shoot(worlds, i, f)
        if status[TAGGED_AT] < 0:
            _decay(status)
            _take_supplies(worlds, i, f)
    fly(worlds, i)
    for k in range(SUPPLIES):
        if 0 <= combat.until[i, k] <= now:
            worlds.present[i, k] = False


@compiled(error_model="numpy")
def next_point(combat, i):
    """Of the points that the episode was not told yet one, 1 or -1; 0: there is none."""
    for k in range(2):
        if combat.points[i, k] > 0:
            combat.points[i, k] -= 1
            return 1 - 2 * k
    return 0


@compiled(error_model="numpy")
def respawn(worlds, i, f):
    """Puts a fighter in a random spawn cell that is free, looking anywhere, as good as new."""
    combat = worlds.combat
    stream, body, status = combat.stream[i], body_of(worlds, i, f), combat.status[i, f]
    free = 0
    for k in range(combat.spawn_count[i]):
        free += _is_free(worlds, i, f, k)
    chosen = pcg64.below(stream, max(free, 1))
    for k in range(combat.spawn_count[i]):
        if free == 0 or _is_free(worlds, i, f, k):
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
    forget(combat, i, f)


@compiled(error_model="numpy")
def _is_free(worlds, i, f, spawn):
    """Whether nobody else stands in or near a spawn cell."""
    row, column = worlds.combat.spawns[i, spawn]
    for other in range(worlds.combat.count[i]):
        if other != f and is_up(worlds, i, other):
            body = body_of(worlds, i, other)
            off_x, off_y = CELL * (column + 0.5) - body[X], CELL * (row + 0.5) - body[Y]
            if abs(off_x) < ROOM and abs(off_y) < ROOM:
                return False
    return True


@compiled(error_model="numpy")
def _walk(worlds, i, f, turn, rise, strafe, forward):
    """Moves a fighter, who does not walk through others."""
    body = body_of(worlds, i, f)
    slides = worlds.combat.status[i, f, SLIDE] > 0
    before_x, before_y = body[X], body[Y]
    move_body(
        worlds, i, body, turn, rise, strafe, forward, not slides,
        IN_AIR if slides else ACCELERATION,
    )  # fmt: skip
    for other in range(worlds.combat.count[i]):
        if other == f or not is_up(worlds, i, other):
            continue
        there = body_of(worlds, i, other)
        wide = 2 * WIDE
        if abs(body[X] - there[X]) >= wide or abs(body[Y] - there[Y]) >= wide:
            continue
        was_x, was_y = abs(before_x - there[X]) < wide, abs(before_y - there[Y]) < wide
        if was_x and was_y:  # both were pushed into each other: they may walk apart
            continue
        if not was_x:
            body[X], body[VX] = before_x, 0.0
        if not was_y:
            body[Y], body[VX + 1] = before_y, 0.0


@compiled(error_model="numpy")
def _decay(status):
    """More health and armour than usual shrinks by 1 a second."""
    status[CLOCK] += MILLISECONDS
    if status[CLOCK] >= 1000:
        status[CLOCK] -= 1000
        status[HEALTH] -= status[HEALTH] > MOST_HEALTH
        status[ARMOUR] -= status[ARMOUR] > MOST_HEALTH


@compiled(error_model="numpy")
def _take_supplies(worlds, i, f):
    """A fighter takes the supplies that he touches, if they are of use."""
    combat = worlds.combat
    body, status = body_of(worlds, i, f), combat.status[i, f]
    for k in range(SUPPLIES):
        kind = combat.kinds[i, k]
        if kind == NOTHING or not worlds.present[i, k]:
            continue
        place = worlds.places[i, k]
        if (
            abs(body[X] - place[0]) > TOUCH_X
            or abs(body[Y] - place[1]) > TOUCH_Y
            or abs(body[Z] - place[2]) > TOUCH_Z
        ):
            continue
        if kind == HEALTH_PACK:
            if status[HEALTH] >= MOST_HEALTH:
                continue
            status[HEALTH] = min(status[HEALTH] + PACK, MOST_HEALTH)
        elif kind == ARMOUR_PACK:
            if status[ARMOUR] >= MOST_ARMOUR:
                continue
            status[ARMOUR] = min(status[ARMOUR] + PACK, MOST_ARMOUR)
        else:
            new = status[LOADED + kind] == 0
            shots = max(status[LOADED + kind] + 1, AMMUNITION[kind])
            status[LOADED + kind] = min(shots, MOST_AMMUNITION)
            if new:
                take(status, kind)
        worlds.present[i, k] = False
        if combat.until[i, k] < 0:
            worlds.returning[i, k] = worlds.clock[i] + RETURN[kind]
