"""The skymazes: a way down over floating platforms on which no step can be taken back."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth import materials, themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.grids import STEPS, Cell, random_path
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.steering import BACKWARD, WAIT, walk_to
from zipf.envs.labyrinth.world import World, middle

UNIT = 20.0  # one step of height; more than a player can step up
_SLOW = 120.0  # units per second
_PITCHES = (0.0, math.radians(-50))  # of the view, when looking for a way
_START, _TOP, _LOWEST, _ABOVE = 26, 21, 8, 14


def random_heights(
    rng: np.random.Generator, difficulty: float
) -> tuple[NDArray[np.int64], Cell, Cell]:
    """Draws platforms: several ways from a start to a goal, of which only the first leads there.

    The difficulty, 0 .. 1, is that of the size, the number of ways and their detours. Returns
    heights int64 [rows, columns], in units of `UNIT`, -1 where there is no platform, and the cells
    of start and goal.
    """
    n = 4 + math.floor(6 * difficulty + 0.5)
    most_paths = 1 + math.floor(7 * difficulty + 0.5)
    extra = math.floor(n * (0.3 + difficulty))
    extra = 2 if extra == 1 else extra
    while True:
        start = math.floor(rng.random() * n / 3), int(rng.integers(1, n - 1))
        goal = math.floor((2 + rng.random()) * n / 3), int(rng.integers(1, n - 1))
        apart = abs(start[0] - goal[0]) + abs(start[1] - goal[1])
        if apart in (n - 3, n - 2):
            break
    free = np.zeros((n, n), np.bool_)
    paths: list[list[Cell]] = []
    visited: set[Cell] = set()
    for _ in range(most_paths):
        for _ in range(1000):
            path = random_path(free, start, goal, rng)
            if len(path) - 1 <= apart + extra and not visited.issuperset(path):
                break
        else:
            break
        paths.append(path)
        visited.update(path)
    heights = np.full((2 * n + 1, 2 * n + 1), -1)
    for number, path in enumerate(map(_doubled, paths)):
        if number == 0:
            _lay_first(rng, heights, path)
        else:
            _lay_further(rng, heights, path)
    heights[heights >= 0] += _ABOVE
    return heights, _doubled([start])[0], _doubled([goal])[0]


def _doubled(path: list[Cell]) -> list[Cell]:
    """The cells of a path of lattice nodes, with the cells between them."""
    cells = [(2 * row + 1, 2 * column + 1) for row, column in path]
    between = [((a[0] + b[0]) // 2, (a[1] + b[1]) // 2) for a, b in pairwise(cells)]
    return [cell for pair in zip(cells, between, strict=False) for cell in pair] + cells[-1:]


def _lay_first(rng: np.random.Generator, heights: NDArray[np.int64], path: list[Cell]) -> None:
    """The way to the goal: from the tower steadily down."""
    heights[path[0]] = _START
    now = _TOP
    for cell in path[1:]:
        if rng.random() < 0.3:
            now = max(now - int(rng.integers(1, 3)), _LOWEST)
        heights[cell] = now


def _lay_further(rng: np.random.Generator, heights: NDArray[np.int64], path: list[Cell]) -> None:
    """A detour: where it leaves laid platforms it ends below the one that it comes back to."""
    at = 0
    while at < len(path):
        if heights[path[at]] >= 0:
            at += 1
            continue
        end = at
        while heights[path[end]] < 0:
            end += 1
        before, after = int(heights[path[at - 1]]), int(heights[path[end]])
        high, low = min(before, _TOP), min(before, after) - 1
        count = end - at
        steps = np.full(count, (high - low) // count)
        steps[rng.permutation(count)[: (high - low) % count]] += 1
        for cell, height in zip(path[at:end], high - np.cumsum(steps), strict=True):
            heights[cell] = height
        at = end


class IrreversiblePath(Episode):
    """Goal: find the way down to the goal; a wrong step cannot be taken back.

    Layout: platforms of one cell that float in the sky. The start is a tower above all others. One
    way leads to the goal; every other one ends below the platform that it comes back to. Floors of
    the same height have the same texture. Invisible walls keep the player on the platforms.
    Rules: downwards any step can be taken, upwards none.
    Rewards: +100 for the goal, which ends the episode.
    """

    difficulty: ClassVar[float | None]  # None: drawn for every episode

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        difficulty = float(rng.random()) if self.difficulty is None else self.difficulty
        heights, self.start, self.goal = random_heights(rng, difficulty)
        self.heights = heights
        textures = {
            int(height): materials.index(f"floor_{rng.integers(4 * materials.STYLES)}")
            for height in np.unique(heights[heights >= 0])
        }
        world.add_platforms(heights * UNIT, heights >= 0, textures, UNIT)
        self.trophy = themes.add_goal(world, scale=3.0)

    def begin_map(self, rng: np.random.Generator) -> None:
        self.world.place_player_in_cell(self.start, float(rng.uniform(0, 2 * np.pi)))
        self.world.put_in_cell(self.trophy, self.goal)

    def picked_up(self, item: int) -> None:
        self.world.reward(100)
        self.world.end_episode()

    def act(self, known: Knowledge) -> int:
        """Follows the way to the goal; a player that does not see one looks around."""
        cell = self.world.cell
        steps = self._distances(known.seen(*self.heights.shape))
        forward, left, up = self.world.velocity
        # Who runs over an edge flies past the next platform.
        if up < 0:
            return BACKWARD if forward > 30 else WAIT
        if math.hypot(forward, left) > _SLOW:
            return WAIT
        if (steps[cell] < 0 and known is not EVERYTHING) or not known.has_seen(self.trophy):
            return known.search(pitches=_PITCHES)
        if steps[cell] == 0:
            return walk_to(self.world, *middle(cell))
        for up, right in STEPS:
            beside = cell[0] + up, cell[1] + right
            lower = self.heights[beside] <= self.heights[cell]
            if lower and 0 <= steps[beside] < steps[cell]:
                return walk_to(self.world, *middle(beside), slowly=True)
        return walk_to(self.world, *middle(cell), slowly=True)  # a trap

    def _distances(self, seen: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Steps to the goal from each platform, by those that were seen; -1 where none lead
        there."""
        steps = np.full(self.heights.shape, -1)
        steps[self.goal] = 0
        queue = [self.goal]
        for cell in queue:
            for up, right in STEPS:
                beside = cell[0] + up, cell[1] + right
                higher = seen[beside] and self.heights[beside] >= self.heights[cell]
                if higher and steps[beside] < 0:
                    steps[beside] = steps[cell] + 1
                    queue.append(beside)
        return steps


class IrreversiblePathHard(IrreversiblePath):
    difficulty = 0.9


class IrreversiblePathVaried(IrreversiblePath):
    difficulty = None
