"""Algorithms on grids of free and solid cells, bool [rows, columns], True is solid."""

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled

Cell = tuple[int, int]
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""Rows and columns to go: east, north, west, south, since rows grow to the north."""


@compiled()
def distances(solid, row, column):
    """Numbers of steps from a cell to all others, int32 [rows, columns]; -1 where no way leads."""
    rows, columns = solid.shape
    found = np.full((rows, columns), -1, np.int32)
    queue = np.empty((rows * columns, 2), np.int32)
    found[row, column] = 0
    queue[0, 0], queue[0, 1] = row, column
    first, last = 0, 1
    while first < last:
        r, c = queue[first, 0], queue[first, 1]
        first += 1
        for k in range(4):
            y, x = r + (k == 1) - (k == 3), c + (k == 0) - (k == 2)
            if 0 <= y < rows and 0 <= x < columns and not solid[y, x] and found[y, x] < 0:
                found[y, x] = found[r, c] + 1
                queue[last, 0], queue[last, 1] = y, x
                last += 1
    return found


def random_path(
    solid: NDArray[np.bool_], start: Cell, goal: Cell, rng: np.random.Generator
) -> list[Cell]:
    """A random simple path, which need not be a short one.

    A walk to random unvisited neighbours, which goes back where there is none, and ends as soon as
    the goal is a neighbour.
    Returns the cells from `start` to `goal`, both included. Raises ValueError: there is no path.
    """
    visited = solid.copy()
    path = [start]
    visited[start] = True
    while path:
        row, column = path[-1]
        if abs(row - goal[0]) + abs(column - goal[1]) == 1 or path[-1] == goal:
            return path if path[-1] == goal else [*path, goal]
        ways = [
            (row + up, column + right)
            for up, right in STEPS
            if 0 <= row + up < solid.shape[0]
            and 0 <= column + right < solid.shape[1]
            and not visited[row + up, column + right]
        ]
        if ways:
            path.append(ways[int(rng.integers(len(ways)))])
            visited[path[-1]] = True
        else:
            path.pop()
    raise ValueError(f"no path leads from {start} to {goal}")
