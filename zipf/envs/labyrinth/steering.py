"""How scripted experts walk: towards a point, and through a grid by the shortest way."""

import math

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.labyrinth.actions import DEGREES_PER_PIXEL, EXTENDED
from zipf.envs.labyrinth.grids import Cell, distances
from zipf.envs.labyrinth.mover import WIDE
from zipf.envs.labyrinth.screen import Place, Screen
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.world import World

Point = tuple[float, float]

NAMES = {action.name: number for number, action in enumerate(EXTENDED)}
"""Numbers of the fifteen actions."""
SMALL = 10 * 4 * DEGREES_PER_PIXEL
LARGE = 60 * 4 * DEGREES_PER_PIXEL
"""Degrees that a step of four frames turns."""
MARGIN = WIDE + 3.0  # how far from walls the player's point stays, units

_FORWARD = NAMES["forward"]
BACKWARD = NAMES["backward"]
WAIT = NAMES["fire"]
"""The only action that does nothing, outside lasertag."""


def walk_to(world: World, x: float, y: float, *, slowly: bool = False) -> int:
    """The action that walks to a point in a straight line.
    `slowly` turns on the spot until the point is ahead, to keep to a narrow way."""
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


def look_at(world: World, screen: Screen, place: Place) -> int:
    """The action that turns the gaze to a part of the screen; to wait if it is there."""
    left, top, right, bottom = place
    _, _, yaw, pitch = world.player
    to_yaw, to_pitch = screen.direction((left + right) / 2, (top + bottom) / 2)
    off, rise = bearing(yaw, to_yaw), math.degrees(to_pitch - pitch)
    if abs(off) > (SMALL + LARGE) / 2:
        return NAMES["look left" if off > 0 else "look right"]
    x, y = screen.gaze
    beside, above = not left <= x < right, not top <= y < bottom
    if beside and (abs(off) >= abs(rise) or not above):
        return NAMES["look slightly left" if off > 0 else "look slightly right"]
    if above:
        return NAMES["look up" if rise > 0 else "look down"]
    return WAIT


def bearing(yaw: float, direction: float) -> float:
    """By how many degrees a direction lies to the left of a yaw, both in radians; -180 .. 180."""
    return math.degrees((direction - yaw + math.pi) % (2 * math.pi) - math.pi)


class Ways:
    """Shortest ways through a grid to some cells, from which the player's point stays `margin` away
    from solid ones. The grid has cells of this size and its south-west corner at `origin`."""

    def __init__(
        self,
        solid: NDArray[np.bool_],
        cells: list[Cell],
        *,
        origin: tuple[float, float] = (0.0, 0.0),
        size: float = CELL,
        margin: float = MARGIN,
    ) -> None:
        self.solid = solid
        self.origin = origin
        self.size = size
        self.margin = margin
        self.distances = {cell: distances(solid, *cell) for cell in cells}

    def add(self, cell: Cell) -> None:
        """Finds the ways to a further cell."""
        self.distances[cell] = distances(self.solid, *cell)

    def cell_of(self, x: float, y: float) -> Cell:
        """The cell of a point, or the nearest one of a point outside."""
        rows, columns = self.solid.shape
        row = int((y - self.origin[1]) // self.size)
        column = int((x - self.origin[0]) // self.size)
        return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)

    def steps(self, world: World, cell: Cell) -> int:
        """Cells from the player to one of the cells; a large number if there is no way."""
        x, y, *_ = world.player
        steps = int(self.distances[cell][self.cell_of(x, y)])
        return steps if steps >= 0 else 1 << 20

    def nearest(self, world: World, cells: list[Cell]) -> Cell:
        """The nearest of these cells."""
        return min(cells, key=lambda cell: self.steps(world, cell))

    def walk_to(self, world: World, cell: Cell, *, slowly: bool = False) -> int:
        """The action that walks to one of the cells."""
        x, y, *_ = world.player
        west, south = self.origin
        ahead = _ahead(
            self.solid, self.distances[cell], (x - west) / self.size, (y - south) / self.size,
            cell[1] + 0.5, cell[0] + 0.5, self.margin / self.size,
        )  # fmt: skip
        point = west + ahead[0] * self.size, south + ahead[1] * self.size
        return walk_to(world, *point, slowly=slowly)


@compiled(error_model="numpy")
def _ahead(solid, steps, x, y, goal_x, goal_y, margin):
    """The farthest point of the shortest way that can be walked to in a straight line; in cells."""
    if _is_clear(solid, x, y, goal_x, goal_y, margin):
        return goal_x, goal_y
    rows, columns = solid.shape
    row = min(max(math.floor(y), 0), rows - 1)
    column = min(max(math.floor(x), 0), columns - 1)
    best_x, best_y = column + 0.5, row + 0.5
    first = True
    while steps[row, column] > 0:
        for k in range(4):
            up, right = (k == 1) - (k == 3), (k == 0) - (k == 2)
            r, c = row + up, column + right
            inside = 0 <= r < solid.shape[0] and 0 <= c < solid.shape[1]
            if inside and steps[r, c] >= 0 and steps[r, c] < steps[row, column]:
                row, column = r, c
                break
        if not first and not _is_clear(solid, x, y, column + 0.5, row + 0.5, margin):
            break
        first = False
        best_x, best_y = column + 0.5, row + 0.5
    return best_x, best_y


@compiled(error_model="numpy")
def _is_clear(solid, x, y, to_x, to_y, margin):
    """Whether a square with sides of twice `margin` moves freely along a line; in cells."""
    count = int(10.0 * math.hypot(to_x - x, to_y - y)) + 1
    for k in range(count + 1):
        along = k / count
        at_x, at_y = x + (to_x - x) * along, y + (to_y - y) * along
        wide = margin * min(0.75 + 2.0 * along, 1.0)  # the player may stand at a wall
        for dy in (-wide, wide):
            for dx in (-wide, wide):
                row, column = math.floor(at_y + dy), math.floor(at_x + dx)
                inside = 0 <= row < solid.shape[0] and 0 <= column < solid.shape[1]
                if not inside or solid[row, column]:
                    return False
    return True


class Field(Ways):
    """Shortest ways to the point `goal` over an open floor, between the corners `low` and `high`,
    around obstacles.

    The player's point keeps `away`, along x or y, from obstacles, as what is touched is a box, and
    out of `walls`, further rectangles x0, y0, x1, y1.
    """

    SIZE = 20.0

    def __init__(
        self,
        low: Point,
        high: Point,
        goal: Point,
        obstacles: list[Point],
        away: float,
        walls: tuple[tuple[float, float, float, float], ...] = (),
    ) -> None:
        size = self.SIZE
        rows, columns = (math.ceil((high[axis] - low[axis]) / size) for axis in (1, 0))
        y, x = np.mgrid[0:rows, 0:columns] * size + size / 2
        x, y = x + low[0], y + low[1]
        solid = np.zeros((rows, columns), np.bool_)
        for point in obstacles:
            solid |= (abs(x - point[0]) < away) & (abs(y - point[1]) < away)
        for x0, y0, x1, y1 in walls:
            solid |= (x > x0) & (x < x1) & (y > y0) & (y < y1)
        self.goal = int((goal[1] - low[1]) // size), int((goal[0] - low[0]) // size)
        solid[self.goal] = False
        super().__init__(solid, [self.goal], origin=low, size=size, margin=1.0)

    def is_cut_off(self, world: World) -> bool:
        """Whether obstacles leave the player, who keeps away from them, no way."""
        x, y, *_ = world.player
        own = self.cell_of(x, y)
        return not self.solid[own] and bool(self.distances[self.goal][own] < 0)

    def walk(self, world: World) -> int:
        """The action that walks to the goal."""
        return self.walk_to(world, self.goal, slowly=True)
