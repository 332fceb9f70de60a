"""How scripted experts walk: towards a point, and through a grid by the shortest way."""

import math

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.labyrinth.actions import DEGREES_PER_PIXEL, EXTENDED
from zipf.envs.labyrinth.grids import Cell, distances
from zipf.envs.labyrinth.mover import WIDE
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.world import World, middle

NAMES = {action.name: number for number, action in enumerate(EXTENDED)}
"""Numbers of the fifteen actions."""
SMALL = 10 * 4 * DEGREES_PER_PIXEL
LARGE = 60 * 4 * DEGREES_PER_PIXEL
"""Degrees that a step of four frames turns."""

_MARGIN = WIDE + 3.0  # units to the side of a line that is walked along
_FORWARD = NAMES["forward"]
BACKWARD = NAMES["backward"]
WAIT = NAMES["fire"]
"""The only action that does nothing, outside lasertag."""


def walk_to(world: World, x: float, y: float, *, slowly: bool = False) -> int:
    """The action that walks to a point in a straight line.

    `slowly` turns on the spot until the point is ahead, to keep to a narrow way.
    """
    own_x, own_y, yaw, _ = world.player
    off = bearing(yaw, math.atan2(y - own_y, x - own_x))
    if abs(off) > (30.0 if slowly else 75.0):
        return NAMES["look left" if off > 0 else "look right"]
    if abs(off) > (SMALL + LARGE) / 2:
        return NAMES["forward and left" if off > 0 else "forward and right"]
    if abs(off) > SMALL / 2:
        if slowly and abs(off) > 2 * SMALL:
            return NAMES["look slightly left" if off > 0 else "look slightly right"]
        return NAMES["forward and slightly left" if off > 0 else "forward and slightly right"]
    return _FORWARD


def face(world: World, x: float, y: float) -> int | None:
    """The action that turns the view towards a point; None when it is within half a small turn."""
    own_x, own_y, yaw, _ = world.player
    off = bearing(yaw, math.atan2(y - own_y, x - own_x))
    if abs(off) <= SMALL / 2:
        return None
    size = "" if abs(off) > (SMALL + LARGE) / 2 else "slightly "
    return NAMES[f"look {size}{'left' if off > 0 else 'right'}"]


def bearing(yaw: float, direction: float) -> float:
    """By how many degrees a direction lies to the left of a yaw, both in radians; -180 .. 180."""
    return math.degrees((direction - yaw + math.pi) % (2 * math.pi) - math.pi)


class Ways:
    """Shortest ways through a grid to some cells.

    Args:
        solid: bool [rows, columns].
        cells: where ways lead to.
    """

    def __init__(self, solid: NDArray[np.bool_], cells: list[Cell]) -> None:
        self.solid = solid
        self.distances = {cell: distances(solid, *cell) for cell in cells}

    def steps(self, world: World, cell: Cell) -> int:
        """Cells from the player to one of the cells; a large number if there is no way."""
        x, y, *_ = world.player
        steps = int(self.distances[cell][int(y // CELL), int(x // CELL)])
        return steps if steps >= 0 else 1 << 20

    def nearest(self, world: World, cells: list[Cell]) -> Cell:
        """The nearest of these cells."""
        return min(cells, key=lambda cell: self.steps(world, cell))

    def walk_to(self, world: World, cell: Cell) -> int:
        """The action that walks to one of the cells."""
        x, y, *_ = world.player
        return walk_to(world, *_ahead(self.solid, self.distances[cell], x, y, *middle(cell)))


@compiled(error_model="numpy")
def _ahead(solid, steps, x, y, goal_x, goal_y):
    """The farthest point of the shortest way that the player can walk to in a straight line."""
    if _is_clear(solid, x, y, goal_x, goal_y):
        return goal_x, goal_y
    row, column = int(y // CELL), int(x // CELL)
    best_x, best_y = CELL * (column + 0.5), CELL * (row + 0.5)
    while steps[row, column] > 0:
        for k in range(4):
            up, right = (k == 1) - (k == 3), (k == 0) - (k == 2)
            r, c = row + up, column + right
            inside = 0 <= r < solid.shape[0] and 0 <= c < solid.shape[1]
            if inside and steps[r, c] >= 0 and steps[r, c] < steps[row, column]:
                row, column = r, c
                break
        middle_x, middle_y = CELL * (column + 0.5), CELL * (row + 0.5)
        if not _is_clear(solid, x, y, middle_x, middle_y):
            break
        best_x, best_y = middle_x, middle_y
    return best_x, best_y


@compiled(error_model="numpy")
def _is_clear(solid, x, y, to_x, to_y):
    """Whether the player's box can move from one point to another in a straight line."""
    length = math.hypot(to_x - x, to_y - y)
    count = int(length / 10.0) + 1
    for k in range(count + 1):
        along = k / count
        at_x, at_y = x + (to_x - x) * along, y + (to_y - y) * along
        margin = min(_MARGIN, WIDE - 1.0 + 20.0 * along)  # the player may stand at a wall
        for dy in (-margin, margin):
            for dx in (-margin, margin):
                row, column = int((at_y + dy) // CELL), int((at_x + dx) // CELL)
                inside = 0 <= row < solid.shape[0] and 0 <= column < solid.shape[1]
                if not inside or solid[row, column]:
                    return False
    return True
