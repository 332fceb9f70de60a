"""A room with good and bad objects: learn which kind is which, whatever the room looks like."""

from __future__ import annotations

import math

import numpy as np

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.steering import Field, Point
from zipf.envs.labyrinth.world import World

WEST, SOUTH, EAST, NORTH = -568.0, -760.0, 1016.0, 568.0
HEIGHT = 176.0
MOST = 10
"""Objects that are taken before the episode ends."""

_SPOTS = ((224.0, -96.0), (-300.0, 300.0), (700.0, -500.0))
"""Places from which a player that finds nothing searches the room again."""
_KINDS = {
    "hat": ((58, 31, 255), (20, 14, 110)),
    "can": ((241, 255, 30), (150, 150, 20)),
    "cake": ((36, 255, 174), (240, 240, 240)),
    "balloon": ((255, 12, 154), (255, 190, 220)),
}
_LOOKS = {"A": ("floor_0", "wall_0"), "B": ("floor_5", "wall_3")}
_CONFIGURATIONS = (("hat", "can", "A"), ("cake", "balloon", "A"), ("cake", "balloon", "B"))
"""Bad kind, good kind and look of the room; in training."""


class CollectGoodObjects(Episode):
    """Goal: take the ten good objects.

    Layout: a rectangular room of 15.8 x 13.3 cells; orange floor and green walls, or blue floor
    and red walls. Twenty objects and the player stand on a grid.
    Rules: ten objects are good, ten bad; the kind tells which: hats are bad where there are cans,
    cakes where there are balloons. The tenth object taken ends the episode.
    Rewards: +1 for a good object, -1 for a bad one.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        bad, good, look = _CONFIGURATIONS[int(rng.integers(len(_CONFIGURATIONS)))]
        floor, wall = _LOOKS[look]
        world.add_floor((WEST, SOUTH), (EAST, NORTH), floor)
        world.add_room((WEST, SOUTH), (EAST, NORTH), HEIGHT, wall)
        self.good = [world.add_item(good, colours=_KINDS[good], spins=False) for _ in range(10)]
        self.bad = [world.add_item(bad, colours=_KINDS[bad], spins=False) for _ in range(10)]
        self.taken = 0

    def begin_map(self, rng: np.random.Generator) -> None:
        grid = [(-450.0 + 150 * i, -700.0 + 150 * j) for i in range(10) for j in range(9)]
        chosen = [grid[k] for k in rng.permutation(len(grid))[:21].tolist()]
        self.places = dict(zip(self.good + self.bad, chosen, strict=False))
        for item, (x, y) in self.places.items():
            self.world.put(item, x, y)
        x, y = chosen[20]
        self.world.place_player(x, y, float(rng.uniform(0, 2 * np.pi)))

    def picked_up(self, item: int) -> None:
        self.world.reward(1 if item in self.good else -1)
        self.taken += 1
        if self.taken == MOST:
            self.world.end_episode()

    def act(self, known: Knowledge) -> int:
        """Walks to the nearest good object around the bad ones."""
        x, y, *_ = self.world.player
        there = [item for item in self.places if self.world.is_there(item) and known.knows(item)]
        good = [self.places[item] for item in there if item in self.good]
        bad = [self.places[item] for item in there if item in self.bad]

        def walk(goal: Point) -> int:
            return Field((WEST, SOUTH), (EAST, NORTH), goal, bad, 60.0).walk(self.world)

        if not good and any(self.world.is_there(item) for item in self.good):
            return known.search(_SPOTS, walk)
        return walk(min(good, key=lambda place: math.dist(place, (x, y)), default=(x, y)))
