"""The explore levels with good and bad objects: find out which kinds are good."""

from __future__ import annotations

from itertools import combinations, product
from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.patterns import PATTERNS, SOLID
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.steering import Ways
from zipf.envs.labyrinth.words import SHAPES
from zipf.envs.labyrinth.world import World

_CONSOLE = tuple(
    (r, g, b) if (r, g, b) != (170, 170, 0) else (170, 85, 0)
    for low, high in ((0, 170), (85, 255))
    for r in (low, high)
    for g in (low, high)
    for b in (low, high)
)
"""The sixteen colours of text consoles."""
_PATTERNS = tuple(pattern for pattern in PATTERNS if pattern != SOLID)
_KINDS = tuple(product(SHAPES, _PATTERNS, combinations(_CONSOLE, 2)))


class ObjectRewards(Episode):
    """Goal: take the good objects and leave the bad ones.

    Layout: one room of 11 x 11 cells with pictures on its walls.
    Rules: an episode has four (many: eight) kinds of objects, each a shape with a pattern of two
    colours; half of the kinds are good. A map has one object of each kind in random ones of eight
    (many: sixteen) cells. When all good ones are taken, a new map begins: the player stands in a
    random spawn cell, looking anywhere.
    Rewards: +2 for a good object, -1 for a bad one.
    Approximated: the bitmaps of the patterns are ours.
    """

    kinds: ClassVar[int]

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        options = MazeOptions(13, 13, rooms=1, smallest=11, largest=11, objects=2 * self.kinds)
        self.maze = random_maze(rng, options)
        themes.build_maze(world, self.maze, rng)
        (self.spawns,), (self.places,) = self.maze.spawns, self.maze.objects
        self.objects = []
        for kind in rng.choice(len(_KINDS), self.kinds, replace=False).tolist():
            shape, pattern, pair = _KINDS[kind]
            colours = pair if rng.integers(2) else pair[::-1]
            self.objects.append(world.add_item(shape, colours=colours, pattern=pattern))
        self.good = self.objects[: self.kinds // 2]
        self.tried: set[int] = set()

    def begin_map(self, rng: np.random.Generator) -> None:
        spawn = self.spawns[int(rng.integers(len(self.spawns)))]
        self.world.place_player_in_cell(spawn, float(rng.uniform(0, 2 * np.pi)))
        chosen = [self.places[k] for k in rng.permutation(len(self.places)).tolist()]
        self.cells = dict(zip(self.objects, chosen, strict=False))
        for item, cell in self.cells.items():
            self.world.put_in_cell(item, cell)

    def picked_up(self, item: int) -> None:
        self.world.reward(2 if item in self.good else -1)
        self.tried.add(item)
        if not self._left():
            self.world.finish_map()

    def _left(self) -> list[int]:
        return [item for item in self.good if self.world.is_there(item)]

    def act(self, known: Knowledge) -> int:
        """Walks to the nearest good object around the cells of the bad ones. Who cannot know which
        are good tries what was never taken, as long as not all good kinds are found."""
        there = [item for item in self.objects if self.world.is_there(item) and known.knows(item)]
        if known is EVERYTHING or self.tried.issuperset(self.good):
            wanted = [item for item in there if item in self.good]
        else:
            wanted = [item for item in there if item in self.good or item not in self.tried]
        blocked = self.maze.solid & known.seen(*self.maze.solid.shape)
        for item in there:
            if item not in wanted:
                blocked[self.cells[item]] = True
        if not wanted:
            return known.explore(blocked, size=CELL)
        cells = [self.cells[item] for item in wanted]
        ways = Ways(blocked, cells)
        return ways.walk_to(self.world, ways.nearest(self.world, cells))


class ObjectRewardsFew(ObjectRewards):
    kinds = 4


class ObjectRewardsMany(ObjectRewards):
    kinds = 8
