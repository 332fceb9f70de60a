"""The explore levels with a goal: find it once, then come back to it from elsewhere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.world import Episode, World


class GoalLocations(Episode):
    """Goal: reach the goal as often as possible; it stays where it is.

    Layout: a random maze of rooms and corridors, new in every episode. All rooms look alike and
    all corridors do; pictures on the walls tell places apart.
    Rules: one cell of a room has the goal for the whole episode. Reaching it begins a new map: the
    player stands at a random spawn cell, looking anywhere.
    Rewards: +10 for the goal.
    Approximated: corridors are not straightened.
    """

    options: ClassVar[MazeOptions]
    reward: ClassVar[float] = 10.0

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.maze = random_maze(rng, self.options)
        themes.build_maze(world, self.maze, rng)
        places = [cell for room in self.maze.objects for cell in room]
        self.spawns = [cell for room in self.maze.spawns for cell in room]
        self.goal_cell = places[int(rng.integers(len(places)))]
        self.goal = world.add_item(
            "pyramid", colours=((250, 200, 40), (250, 240, 160)), scale=themes.GOAL_SCALE
        )

    def begin_map(self, rng: np.random.Generator) -> None:
        spawn = self.spawns[int(rng.integers(len(self.spawns)))]
        self.world.place_player_in_cell(spawn, float(rng.uniform(0, 2 * np.pi)))
        self.world.put_in_cell(self.goal, self.goal_cell)

    def picked_up(self, item: int) -> None:
        self.world.reward(self.reward)
        self.world.finish_map()


class GoalLocationsSmall(GoalLocations):
    seconds = 90
    options = MazeOptions(11, 11, rooms=4, smallest=3, largest=5)


class GoalLocationsLarge(GoalLocations):
    seconds = 120
    options = MazeOptions(17, 17, rooms=9, smallest=3, largest=3)
