"""What is in view in a labyrinth: cells of a grid and items, compiled."""

import math

from zipf.compiled import compiled
from zipf.envs.labyrinth.lasertag.sight import to_wall
from zipf.envs.labyrinth.mover import EYE
from zipf.envs.labyrinth.state import CELL, PITCH, YAW, X, Y, Z
from zipf.envs.labyrinth.terrain import height_at

NEVER = -1  # stands for the frame at which a cell was seen last, where it never was
RAYS = 96
"""Directions, across the view, in which cells are looked for: as many as the paper's images have
columns."""
_TALL = 40.0  # of what is looked for above the ground of a terrain


@compiled(error_model="numpy")
def is_ahead(body, x, y, z, wide, high):
    """Whether the point x, y, z, units, is in the image of the player with this body: not beside,
    above or below it. `wide` and `high` are tangents of half the field of view across and upwards.
    """
    ahead_x, ahead_y, up = x - body[X], y - body[Y], z - (body[Z] + EYE)
    cos, sin = math.cos(body[YAW]), math.sin(body[YAW])
    ahead, left = ahead_x * cos + ahead_y * sin, ahead_y * cos - ahead_x * sin
    cos, sin = math.cos(body[PITCH]), math.sin(body[PITCH])
    deep, above = ahead * cos + up * sin, up * cos - ahead * sin
    return deep > 0.0 and abs(left) <= wide * deep and abs(above) <= high * deep


@compiled(error_model="numpy")
def see_cells(solid, body, wide, high, now, seen_at):
    """Marks the cells of a text map that are in view, walls included: `seen_at` of a cell, int64
    [rows, columns] at least, becomes `now`, the frame. `solid` bool [rows, columns] hides what is
    behind it; for body, wide and high see `is_ahead`. Where the horizon is not in view no cell is.
    """
    if math.tan(abs(body[PITCH])) > high:
        return
    for k in range(RAYS + 1):
        angle = body[YAW] + math.atan(wide * (2.0 * k / RAYS - 1.0))
        dx, dy = math.cos(angle), math.sin(angle)
        column, row = math.floor(body[X] / CELL), math.floor(body[Y] / CELL)
        right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        far = 1e30
        next_x = ((column + (dx > 0)) * CELL - body[X]) / dx if dx != 0.0 else far
        next_y = ((row + (dy > 0)) * CELL - body[Y]) / dy if dy != 0.0 else far
        step_x = abs(CELL / dx) if dx != 0.0 else far
        step_y = abs(CELL / dy) if dy != 0.0 else far
        while 0 <= row < solid.shape[0] and 0 <= column < solid.shape[1]:
            seen_at[row, column] = now
            if solid[row, column]:
                break
            if next_x < next_y:
                next_x += step_x
                column += right
            else:
                next_y += step_y
                row += up


@compiled(error_model="numpy")
def see_floors(floor, rows, columns, body, wide, high, now, seen_at):
    """Marks the cells of a text map without visible walls the middle of whose floor is in view; the
    arguments are those of `see_cells`, and `floor` the heights of floors."""
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.5) * CELL, (row + 0.5) * CELL
            if is_ahead(body, x, y, floor[row, column], wide, high):
                seen_at[row, column] = now


@compiled(error_model="numpy")
def see_ground(heights, size, body, wide, high, now, seen_at):
    """Marks the quads of a terrain that are in view and not behind a hill; the arguments are those
    of `see_cells`, and `heights` and `size` the terrain's."""
    if math.tan(abs(body[PITCH])) > high:
        return
    quads = len(heights) - 1
    eye = body[Z] + EYE
    for k in range(RAYS + 1):
        angle = body[YAW] + math.atan(wide * (2.0 * k / RAYS - 1.0))
        dx, dy = math.cos(angle), math.sin(angle)
        steepest = -1e30
        away = 0.5 * size
        while True:
            x, y = body[X] + away * dx, body[Y] + away * dy
            row, column = math.floor(y / size), math.floor(x / size)
            if not (0 <= row < quads and 0 <= column < quads):
                break
            ground = height_at(heights, size, x, y)
            if (ground + _TALL - eye) / away >= steepest:
                seen_at[row, column] = now
            steepest = max(steepest, (ground - eye) / away)
            away += 0.5 * size


@compiled(error_model="numpy")
def see_items(envs, i, opaque, see_through, wide, high, known):
    """Marks the items of an env that are in view, and forgets those that are not there.

    Args:
        envs: of the batch.
        i: the env's number.
        opaque: bool [rows, columns] at least, walls of a text map that are seen.
        see_through: bool [boxes], solid boxes that hide nothing.
        wide, high: see `is_ahead`.
        known: bool [items], written.
    """
    body = envs.bodies[i]
    x, y, eye = body[X], body[Y], body[Z] + EYE
    rows, columns = envs.cells[i]
    for item in range(known.shape[0]):
        if not envs.present[i, item]:
            known[item] = False
            continue
        if known[item]:
            continue
        to_x, to_y, to_z = envs.places[i, item]
        if not is_ahead(body, to_x, to_y, to_z, wide, high):
            continue
        if rows > 0:
            walls = opaque[:rows, :columns]
            if to_wall(walls, x, y, to_x - x, to_y - y, 1.0) < 1.0:
                continue
        hidden = False
        for box in range(envs.box_count[i]):
            if not see_through[box] and _crosses(envs.boxes[i, box], x, y, eye, to_x, to_y, to_z):
                hidden = True
        if envs.quad[i] > 0.0 and not hidden:
            hidden = _is_behind_a_hill(envs.heights[i], envs.quad[i], x, y, eye, to_x, to_y, to_z)
        known[item] = not hidden


@compiled(error_model="numpy")
def _crosses(box, x, y, z, to_x, to_y, to_z):
    """Whether a line between two points goes through a box."""
    first, last = 0.0, 1.0
    start, end = (x, y, z), (to_x, to_y, to_z)
    for axis in range(3):
        along = end[axis] - start[axis]
        low, high = box[axis] - start[axis], box[axis + 3] - start[axis]
        if along == 0.0:
            if low > 0.0 or high < 0.0:
                return False
            continue
        enters, leaves = min(low / along, high / along), max(low / along, high / along)
        first, last = max(first, enters), min(last, leaves)
    return first < last


@compiled(error_model="numpy")
def _is_behind_a_hill(heights, size, x, y, eye, to_x, to_y, to_z):
    """Whether the ground of a terrain rises above a line between two points."""
    steps = int(2.0 * math.hypot(to_x - x, to_y - y) / size)
    for k in range(1, steps):
        along = k / steps
        ground = height_at(heights, size, x + (to_x - x) * along, y + (to_y - y) * along)
        if ground > eye + (to_z - eye) * along:
            return True
    return False


@compiled(error_model="numpy")
def nearest_unseen(solid, seen_at, row, column):
    """The cell that was never seen to which the way from a cell is shortest, or, where there is
    none, the one that was seen last the longest time ago; `solid` and `seen_at` are [rows,
    columns]."""
    rows, columns = solid.shape
    queue = [(row, column)]
    found = solid.copy()
    found[row, column] = True
    oldest = (row, column)
    first = 0
    while first < len(queue):
        r, c = queue[first]
        first += 1
        if seen_at[r, c] == NEVER:
            return r, c
        if seen_at[r, c] < seen_at[oldest]:
            oldest = (r, c)
        for k in range(4):
            to_r, to_c = r + (k == 1) - (k == 3), c + (k == 0) - (k == 2)
            if 0 <= to_r < rows and 0 <= to_c < columns and not found[to_r, to_c]:
                found[to_r, to_c] = True
                queue.append((to_r, to_c))
    return oldest
