"""Random mazes of rooms and corridors, as the explore and lasertag levels have them.

After DeepMind Lab's text level generator, from its description: rooms are placed at random, the
rest is filled with corridors, every two neighbouring parts are connected once, and dead ends are
removed. What is approximated: the original also straightens corridors that turn aside and return,
which only shortens detours.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.grids import STEPS, Cell


@dataclass(frozen=True)
class MazeOptions:
    """What a maze is made of; sizes are in cells."""

    # rows, columns: of the maze, odd
    rows: int
    columns: int
    rooms: int  # how many are placed at most
    # smallest, largest: side of a room, odd
    smallest: int
    largest: int
    # spawns, objects: how many cells of each kind a room has, as far as they fit
    spawns: int = 5
    objects: int = 4
    extra: float = 0.0  # probability of a further connection where two parts touch
    doors: bool = False  # whether connections are doors


@dataclass(frozen=True)
class Maze:
    """A maze; rows grow to the north, columns to the east."""

    solid: NDArray[np.bool_]  # bool [rows, columns]
    # int64 [rows, columns], the number of the room that a cell belongs to; -1: none
    room: NDArray[np.int64]
    # spawns, objects: cells, by room
    spawns: list[list[Cell]]
    objects: list[list[Cell]]
    doors: list[Cell]  # cells with a door


def random_maze(rng: np.random.Generator, options: MazeOptions) -> Maze:
    """Draws a maze. All its cells are connected (through doors, if there are any)."""
    rooms = _place_rooms(rng, options)
    part = np.full((options.rows, options.columns), -1)
    for number, (row, column, height, width) in enumerate(rooms):
        part[row : row + height, column : column + width] = number
    room = part.copy()
    _fill_with_corridors(rng, part)
    connections = _connect(rng, part, options.extra)
    open_ = part >= 0
    for cell in connections:
        open_[cell] = True
    _remove_dead_ends(open_, room)
    doors = [cell for cell in connections if open_[cell]] if options.doors else []
    spawns: list[list[Cell]] = []
    objects: list[list[Cell]] = []
    for row, column, height, width in rooms:
        cells = [(row + y, column + x) for y in range(height) for x in range(width)]
        drawn = [cells[k] for k in rng.permutation(len(cells)).tolist()]
        spawns.append(drawn[: options.spawns])
        objects.append(drawn[options.spawns : options.spawns + options.objects])
    return Maze(~open_, room, spawns, objects, doors)


def _place_rooms(rng: np.random.Generator, options: MazeOptions) -> list[tuple[int, int, int, int]]:
    """South-west corner, height and width of each room, in a random order.
    Sizes are drawn on a lattice of every other cell, so that walls stay between rooms."""
    high, wide = (options.rows - 1) // 2, (options.columns - 1) // 2
    least, most = (options.smallest - 1) // 2, (options.largest - 1) // 2
    middle = (least + most) // 2
    taken = np.zeros((options.rows, options.columns), np.bool_)
    rooms: list[tuple[int, int, int, int]] = []
    while len(rooms) < options.rooms and _has_space(taken, 2 * least + 1):
        width, height = rng.integers(least, middle + 1, 2).tolist()
        longer = int(rng.integers(middle, most + 1)) - middle
        if rng.random() < 0.5:
            width += longer
        else:
            height += longer
        row, column = int(rng.integers(high - height)), int(rng.integers(wide - width))
        room = 2 * row + 1, 2 * column + 1, 2 * height + 1, 2 * width + 1
        cells = np.s_[room[0] : room[0] + room[2], room[1] : room[1] + room[3]]
        if not taken[cells].any():
            taken[cells] = True
            rooms.append(room)
    return [rooms[k] for k in rng.permutation(len(rooms)).tolist()]


def _has_space(taken: NDArray[np.bool_], side: int) -> bool:
    """Whether a square of this side fits between the rooms; the original gives up after 1000
    failures instead."""
    windows = np.lib.stride_tricks.sliding_window_view(taken, (side, side))[1::2, 1::2]
    return bool((~windows.any((2, 3))).any())


def _fill_with_corridors(rng: np.random.Generator, part: NDArray[np.int64]) -> None:
    """Grows perfect mazes over the free cells with odd coordinates; each is a part of its own."""
    rows, columns = part.shape
    number = int(part.max()) + 1
    for start in ((r, c) for r in range(1, rows, 2) for c in range(1, columns, 2)):
        if part[start] >= 0:
            continue
        path = [start]
        part[start] = number
        while path:
            row, column = path[-1]
            ways = [
                (up, right)
                for up, right in STEPS
                if 0 < row + 2 * up < rows
                and 0 < column + 2 * right < columns
                and part[row + 2 * up, column + 2 * right] < 0
            ]
            if not ways:
                path.pop()
                continue
            up, right = ways[int(rng.integers(len(ways)))]
            part[row + up, column + right] = number
            path.append((row + 2 * up, column + 2 * right))
            part[path[-1]] = number
        number += 1


def _connect(rng: np.random.Generator, part: NDArray[np.int64], extra: float) -> list[Cell]:
    """The cells to open: one between every two parts that touch, and `extra` ones."""
    rows, columns = part.shape
    between: dict[tuple[int, int], list[Cell]] = {}
    for r in range(1, rows, 2):
        for c in range(1, columns, 2):
            for up, right in STEPS[:2]:
                if r + 2 * up >= rows or c + 2 * right >= columns:
                    continue
                one, other = int(part[r, c]), int(part[r + 2 * up, c + 2 * right])
                if one != other:
                    pair = min(one, other), max(one, other)
                    between.setdefault(pair, []).append((r + up, c + right))
    opened = [cells[int(rng.integers(len(cells)))] for cells in between.values()]
    if extra > 0:
        for cell in (cell for cells in between.values() for cell in cells):
            beside = [(cell[0] + up, cell[1] + right) for up, right in STEPS]
            if rng.random() < extra and not set(beside) & set(opened) and cell not in opened:
                opened.append(cell)
    return opened


def _remove_dead_ends(open_: NDArray[np.bool_], room: NDArray[np.int64]) -> None:
    """Closes cells outside rooms that have at most one open neighbour, until there are none."""
    ends = [(int(r), int(c)) for r, c in np.argwhere(open_ & (room < 0))]
    while ends:
        row, column = ends.pop()
        if not open_[row, column] or room[row, column] >= 0:
            continue
        beside = [(row + up, column + right) for up, right in STEPS]
        ways = [cell for cell in beside if open_[cell]]
        if len(ways) <= 1:
            open_[row, column] = False
            ends += ways
