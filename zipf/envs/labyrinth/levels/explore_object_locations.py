"""The explore levels with apples: collect all of them, then do so again from elsewhere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.levels.explore_goals import LARGE, SMALL
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.steering import Ways
from zipf.envs.labyrinth.world import World


class ObjectLocations(Episode):
    """Goal: collect all apples as often as possible; they come back to the same places.

    Layout: a random maze of rooms and corridors, new in every episode. All rooms look alike and
    so do all corridors; pictures on the walls tell places apart.
    Rules: half of the object cells, four to a room, have an apple, the same ones for the whole
    episode. Taking the last apple begins a new map: all apples are back, and the player stands in a
    random spawn cell, looking anywhere.
    Rewards: +1 for an apple.
    Approximated: corridors that turn aside and return are not straightened.
    """

    maze_options: ClassVar[MazeOptions]

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.maze = random_maze(rng, self.maze_options)
        themes.build_maze(world, self.maze, rng)
        self.spawns = [cell for room in self.maze.spawns for cell in room]
        places = [cell for room in self.maze.objects for cell in room]
        chosen = rng.permutation(len(places))[: len(places) // 2].tolist()
        self.apples = {themes.add_apple(world): places[k] for k in chosen}

    def begin_map(self, rng: np.random.Generator) -> None:
        spawn = self.spawns[int(rng.integers(len(self.spawns)))]
        self.world.place_player_in_cell(spawn, float(rng.uniform(0, 2 * np.pi)))
        for apple, cell in self.apples.items():
            self.world.put_in_cell(apple, cell)

    def picked_up(self, item: int) -> None:
        self.world.reward(1)
        if not self._left():
            self.world.finish_map()

    def act(self, known: Knowledge) -> int:
        """Walks to the nearest apple; they come back to where they were."""
        left = [self.apples[apple] for apple in self._left() if known.has_seen(apple)]
        if not left:
            return known.explore(self.maze.solid, size=CELL)
        ways = Ways(self.maze.solid & known.seen(*self.maze.solid.shape), left)
        return ways.walk_to(self.world, ways.nearest(self.world, left))

    def _left(self) -> list[int]:
        return [apple for apple in self.apples if self.world.is_there(apple)]


class ObjectLocationsSmall(ObjectLocations):
    maze_options = SMALL


class ObjectLocationsLarge(ObjectLocations):
    maze_options = LARGE
