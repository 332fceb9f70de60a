"""How fighters move: as all players of the labyrinth, in a text map whose floor is level.

Apart from `mover.move`, which knows every kind of env, since these frames are many: its functions
are handed nothing but the arrays that they need, which compiled code does far faster.
"""

import math

from zipf.compiled import compiled
from zipf.envs.labyrinth.lasertag.arena import SLIDE, TAGGED_AT
from zipf.envs.labyrinth.mover import (
    ACCELERATION,
    BELOW,
    FRAME,
    GRAVITY,
    IN_AIR,
    SKIN,
    WIDE,
    turn_and_run,
)
from zipf.envs.labyrinth.state import CELL, VX, VY, VZ, X, Y, Z


@compiled(error_model="numpy")
def walk(solid, bodies, status, count, f, turn, rise, strafe, forward):
    """Moves fighter `f` of `count` by a frame, see `mover.move`; bodies are written.
    It does not walk through walls, solid cells [rows, columns], nor through others."""
    body = bodies[f]
    standing = body[Z] - BELOW <= SKIN
    grips = standing and status[f, SLIDE] <= 0
    turn_and_run(body, turn, rise, strafe, forward, ACCELERATION if grips else IN_AIR, grips)
    if not standing:
        body[VZ] -= GRAVITY * FRAME
    before_x, before_y = body[X], body[Y]
    if body[VX] != 0.0:
        wanted = before_x + body[VX] * FRAME
        body[X] = _reach(solid, before_x, before_y, wanted, 0)
        if body[X] != wanted:
            body[VX] = 0.0
    if body[VY] != 0.0:
        wanted = before_y + body[VY] * FRAME
        body[Y] = _reach(solid, before_y, body[X], wanted, 1)
        if body[Y] != wanted:
            body[VY] = 0.0
    body[Z] += body[VZ] * FRAME
    if body[Z] <= BELOW:
        body[Z], body[VZ] = BELOW, 0.0
    for other in range(count):
        if other == f or status[other, TAGGED_AT] >= 0:
            continue
        x, y, wide = bodies[other, X], bodies[other, Y], 2 * WIDE
        if abs(body[X] - x) >= wide or abs(body[Y] - y) >= wide:
            continue
        # A fighter that is pushed into another may walk away from it.
        if abs(before_x - x) >= wide:
            body[X], body[VX] = before_x, 0.0
        elif abs(before_y - y) >= wide:
            body[Y], body[VY] = before_y, 0.0


@compiled(error_model="numpy")
def _reach(solid, now, across, wanted, axis):
    """How far a body gets along an axis towards `wanted`; see `mover._reach`."""
    ahead = 1.0 if wanted > now else -1.0
    line = math.floor((wanted + ahead * WIDE) / CELL)
    first, last = (
        math.floor((across - WIDE + SKIN) / CELL),
        math.floor((across + WIDE - SKIN) / CELL),
    )
    for other in range(first, last + 1):
        row, column = (other, line) if axis == 0 else (line, other)
        if solid[row, column]:
            limit = (line if ahead > 0 else line + 1) * CELL - ahead * (WIDE + SKIN)
            if (limit - now) * ahead >= -2.0 * SKIN:
                wanted = min(wanted, limit) if ahead > 0 else max(wanted, limit)
    return wanted
