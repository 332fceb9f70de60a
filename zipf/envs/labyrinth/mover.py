"""How a player moves: Quake III's kinematics as DeepMind Lab sets them, compiled.

A frame is 0.016 s of physics. On the ground, speed falls by friction and grows along the wished
direction up to 320 units a second; in the air there is no friction and little control. The player
is a box, 30 x 30 wide and 56 high, that slides along what it meets and climbs steps of 18.
"""

import math

from zipf.compiled import compiled
from zipf.envs.labyrinth.state import CELL, PITCH, VX, VY, VZ, YAW, X, Y, Z
from zipf.envs.labyrinth.terrain import height_at

FRAME = 0.016  # seconds of physics
RUN = 320.0
ACCELERATION, IN_AIR = 10.0, 1.0
FRICTION, STOP_SPEED = 6.0, 100.0
GRAVITY = 800.0
WIDE = 15.0
"""Half the width of the player's box."""
BELOW, ABOVE = 24.0, 32.0  # distances from the player's point down to the soles and up to the crown
EYE = 26.0  # height of the eye above the player's point
STEP_UP = 18.0
STEEPEST = math.sqrt(1.0 / 0.7**2 - 1.0)
"""Slope that can be climbed: where the unit normal is 0.7 high."""
RISE = 12.0  # speed of a rising platform that holds the player, units per frame
_MOST_PITCH = math.radians(89.0)
SKIN = 1e-6
"""How far bodies stay from walls, units. A step that is shorter may end closer than that."""


@compiled(error_model="numpy")
def move(envs, i, turn, rise, strafe, forward):
    """Moves the player of env `i` by one frame.

    Args:
        turn, rise: of the view, to the left and upwards, radians.
        strafe, forward: 1, 0 or -1: to the right, forward.
    """
    body = envs.bodies[i]
    soles = body[Z] - BELOW
    ground = _ground(envs, i, body[X], body[Y], soles)
    standing = soles <= ground + SKIN
    acceleration = ACCELERATION if standing else IN_AIR
    friction = standing and envs.pushed[i] == 0
    turn_and_run(body, turn, rise, strafe, forward, acceleration, friction)
    if envs.pushed[i] > 0:
        envs.pushed[i] -= 1
    if not standing:
        body[VZ] -= GRAVITY * FRAME
    before_x, before_y = body[X], body[Y]
    for axis in range(2):
        step = body[VX + axis] * FRAME
        if step != 0.0:
            wanted = body[X + axis] + step
            reached = _reach(envs, i, axis, wanted)
            if reached != wanted:
                body[VX + axis] = 0.0
            body[X + axis] = reached
    if envs.quad[i] > 0.0:
        _stay_off_pillars(envs, i)
        _stay_off_slopes(envs, i, before_x, before_y)
    _stay_in_room(envs, i)
    if envs.held[i]:
        body[X], body[Y] = envs.hold[i, 0], envs.hold[i, 1]
        body[Z] = min(body[Z] + RISE, envs.hold[i, 2] + BELOW)
        body[VX] = body[VY] = body[VZ] = 0.0
        return
    ground = _ground(envs, i, body[X], body[Y], soles)
    soles = soles + body[VZ] * FRAME
    # On a terrain, a player who stands follows the ground downhill.
    follows = standing and envs.quad[i] > 0.0 and soles - ground < STEP_UP
    if soles <= ground or follows:
        soles = ground
        body[VZ] = 0.0
    body[Z] = soles + BELOW


@compiled(error_model="numpy")
def turn_and_run(body, turn, rise, strafe, forward, acceleration, friction):
    """Turns a body, float64 [8], as `move` does, and changes its velocity over the ground: with
    ACCELERATION or IN_AIR, and by friction if that slows it."""
    body[YAW] = (body[YAW] + turn) % (2 * math.pi)
    body[PITCH] = min(max(body[PITCH] + rise, -_MOST_PITCH), _MOST_PITCH)
    if friction:
        speed = math.hypot(body[VX], body[VY])
        if speed > 0.0:
            left = max(speed - max(speed, STOP_SPEED) * FRICTION * FRAME, 0.0) / speed
            body[VX] *= left
            body[VY] *= left
    if strafe != 0.0 or forward != 0.0:
        cos, sin = math.cos(body[YAW]), math.sin(body[YAW])
        wish_x, wish_y = forward * cos + strafe * sin, forward * sin - strafe * cos
        length = math.hypot(wish_x, wish_y)
        wish_x, wish_y = wish_x / length, wish_y / length
        missing = RUN - (body[VX] * wish_x + body[VY] * wish_y)
        if missing > 0.0:
            gain = min(acceleration * FRAME * RUN, missing)
            body[VX] += gain * wish_x
            body[VY] += gain * wish_y


@compiled(error_model="numpy")
def _stay_in_room(envs, i):
    """Moves the player out of the walls of a convex room, along which it slides."""
    body = envs.bodies[i]
    for k in range(envs.plane_count[i]):
        x, y, distance = envs.planes[i, k]
        beyond = x * body[X] + y * body[Y] + WIDE * (abs(x) + abs(y)) - distance
        if beyond > 0.0:
            body[X] -= beyond * x
            body[Y] -= beyond * y
            into = body[VX] * x + body[VY] * y
            if into > 0.0:
                body[VX] -= into * x
                body[VY] -= into * y


@compiled(error_model="numpy")
def _stay_off_pillars(envs, i):
    """Moves the player out of pillars, round which it slides."""
    body = envs.bodies[i]
    for k in range(envs.pillar_count[i]):
        x, y = body[X] - envs.pillars[i, k, 0], body[Y] - envs.pillars[i, k, 1]
        apart = math.hypot(x, y)
        least = envs.pillars[i, k, 2] + WIDE
        if 0.0 < apart < least:
            x, y = x / apart, y / apart
            body[X] += (least - apart) * x
            body[Y] += (least - apart) * y
            into = body[VX] * x + body[VY] * y
            if into < 0.0:
                body[VX] -= into * x
                body[VY] -= into * y


@compiled(error_model="numpy")
def _stay_off_slopes(envs, i, before_x, before_y):
    """Keeps the player from climbing what is too steep, along which it slides."""
    body = envs.bodies[i]
    size = envs.quad[i]
    now = height_at(envs.heights[i], size, before_x, before_y)
    step_x, step_y = body[X] - before_x, body[Y] - before_y
    there = height_at(envs.heights[i], size, body[X], body[Y])
    if there - now <= STEEPEST * math.hypot(step_x, step_y):
        return
    # Uphill, from the heights around.
    east = height_at(envs.heights[i], size, body[X] + 1.0, body[Y]) - there
    north = height_at(envs.heights[i], size, body[X], body[Y] + 1.0) - there
    slope = math.hypot(east, north)
    if slope <= STEEPEST:
        return
    east, north = east / slope, north / slope
    into = step_x * east + step_y * north
    body[X] -= into * east
    body[Y] -= into * north
    fast = body[VX] * east + body[VY] * north
    if fast > 0.0:
        body[VX] -= fast * east
        body[VY] -= fast * north


@compiled(error_model="numpy")
def _ground(envs, i, x, y, soles):
    """The height of the highest floor below the player's box that its soles can stand on."""
    if envs.quad[i] > 0.0:
        return height_at(envs.heights[i], envs.quad[i], x, y)
    rows, columns = envs.cells[i]
    if rows == 0:
        return 0.0
    found = -1e9
    for row in range(_cell(y - WIDE), _cell(y + WIDE) + 1):
        for column in range(_cell(x - WIDE), _cell(x + WIDE) + 1):
            if 0 <= row < rows and 0 <= column < columns and not envs.solid[i, row, column]:
                height = envs.floor[i, row, column]
                if height <= soles + STEP_UP:
                    found = max(found, height)
    return found


@compiled(error_model="numpy")
def _reach(envs, i, axis, wanted):
    """How far the player's box gets along an axis towards `wanted`, without entering anything."""
    body = envs.bodies[i]
    now = body[X + axis]
    ahead = 1.0 if wanted > now else -1.0
    across = body[Y - axis]
    soles = body[Z] - BELOW
    crown = body[Z] + ABOVE
    edge = wanted + ahead * WIDE
    reached = wanted
    rows, columns = envs.cells[i]
    if rows > 0:
        line = _cell(edge)
        for other in range(_cell(across - WIDE + SKIN), _cell(across + WIDE - SKIN) + 1):
            row, column = (other, line) if axis == 0 else (line, other)
            free = 0 <= row < rows and 0 <= column < columns and not envs.solid[i, row, column]
            if not free or envs.floor[i, row, column] > soles + STEP_UP:
                face = CELL * line if ahead > 0 else CELL * (line + 1)
                limit = face - ahead * (WIDE + SKIN)
                if (limit - now) * ahead >= -2.0 * SKIN:
                    reached = min(reached, limit) if ahead > 0 else max(reached, limit)
    for k in range(envs.box_count[i]):
        box = envs.boxes[i, k]
        if box[2] >= crown or box[5] <= soles + STEP_UP:
            continue
        if box[1 - axis] >= across + WIDE or box[4 - axis] <= across - WIDE:
            continue
        face = box[axis] if ahead > 0 else box[3 + axis]
        limit = face - ahead * (WIDE + SKIN)
        if (limit - now) * ahead >= -2.0 * SKIN and (edge - face) * ahead > 0.0:
            reached = min(reached, limit) if ahead > 0 else max(reached, limit)
    return reached


@compiled(error_model="numpy")
def _cell(coordinate):
    return math.floor(coordinate / CELL)
