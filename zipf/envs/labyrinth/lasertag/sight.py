"""What lies along a ray in a text map: walls, the ground, the bodies of fighters."""

import math

from zipf.compiled import compiled
from zipf.envs.labyrinth.lasertag.arena import NOTHING, TAGGED_AT
from zipf.envs.labyrinth.mover import ABOVE, BELOW, WIDE
from zipf.envs.labyrinth.state import CELL, X, Y, Z

CEILING = 400.0  # height of the sky, which stops shots; walls reach up to it


@compiled(error_model="numpy")
def to_wall(solid, x, y, dx, dy, most):
    """How far a ray goes over the floor before it meets a wall, at most `most`.

    It begins in a free cell of `solid` [rows, columns], at x, y in units. What is found is in
    multiples of the length of its direction.
    """
    column, row = math.floor(x / CELL), math.floor(y / CELL)
    right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    far = 1e30
    next_x = ((column + (dx > 0)) * CELL - x) / dx if dx != 0.0 else far
    next_y = ((row + (dy > 0)) * CELL - y) / dy if dy != 0.0 else far
    step_x = abs(CELL / dx) if dx != 0.0 else far
    step_y = abs(CELL / dy) if dy != 0.0 else far
    while True:
        if next_x < next_y:
            passed = next_x
            next_x += step_x
            column += right
        else:
            passed = next_y
            next_y += step_y
            row += up
        if passed >= most:
            return most
        if not (0 <= row < solid.shape[0] and 0 <= column < solid.shape[1]):
            return passed
        if solid[row, column]:
            return passed


@compiled(error_model="numpy")
def in_view(solid, x, y, to_x, to_y):
    """Whether no wall is between two points."""
    return to_wall(solid, x, y, to_x - x, to_y - y, 1.0) >= 1.0


@compiled(error_model="numpy")
def to_surroundings(solid, x, y, z, dx, dy, dz, most):
    """How far a ray goes before it meets a wall, the ground or the sky, at most `most`."""
    if dz < 0.0:
        most = min(most, z / -dz)
    elif dz > 0.0:
        most = min(most, (CEILING - z) / dz)
    return to_wall(solid, x, y, dx, dy, most)


@compiled(error_model="numpy")
def to_body(body, x, y, z, dx, dy, dz):
    """How far a ray goes before it enters a body; infinite if it does not."""
    first, last = 0.0, math.inf
    for axis in range(3):
        if axis == 0:
            start, way, low, high = x, dx, body[X] - WIDE, body[X] + WIDE
        elif axis == 1:
            start, way, low, high = y, dy, body[Y] - WIDE, body[Y] + WIDE
        else:
            start, way, low, high = z, dz, body[Z] - BELOW, body[Z] + ABOVE
        if way == 0.0:
            if not low <= start <= high:
                return math.inf
            continue
        one, other = (low - start) / way, (high - start) / way
        first, last = max(first, min(one, other)), min(last, max(one, other))
    return first if first <= last else math.inf


@compiled(error_model="numpy")
def first_body(count, bodies, status, shooter, x, y, z, dx, dy, dz, most):
    """The first fighter beside the shooter whom a ray meets within `most`, or NOTHING; and how far
    that is."""
    found, near = NOTHING, most
    for fighter in range(count):
        if fighter != shooter and status[fighter, TAGGED_AT] < 0:
            away = to_body(bodies[fighter], x, y, z, dx, dy, dz)
            if away < near:
                found, near = fighter, away
    return found, near
