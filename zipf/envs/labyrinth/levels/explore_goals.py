"""The explore levels with a goal: find it once, then come back to it from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.grids import Cell, random_path
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.steering import Ways
from zipf.envs.labyrinth.world import World

SMALL = MazeOptions(11, 11, rooms=4, smallest=3, largest=5)
LARGE = MazeOptions(17, 17, rooms=9, smallest=3, largest=3)


class GoalLocations(Episode):
    """Goal: reach the goal as often as possible; it stays where it is.

    Layout: a random maze of rooms and corridors, new in every episode. All rooms look alike and
    so do all corridors; pictures on the walls tell places apart.
    Rules: a cell of a room has the goal for the whole episode. Reaching it begins a new map: the
    player stands in a random spawn cell, looking anywhere.
    Rewards: +10 for the goal.
    Approximated: corridors that turn aside and return are not straightened.
    """

    maze_options: ClassVar[MazeOptions]

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.maze = random_maze(rng, self.maze_options)
        themes.build_maze(world, self.maze, rng)
        self.spawns = [cell for room in self.maze.spawns for cell in room]
        places = [cell for room in self.maze.objects for cell in room]
        self.goal_cell = places[int(rng.integers(len(places)))]
        self.goal = themes.add_goal(world)

    def begin_map(self, rng: np.random.Generator) -> None:
        self.spawn = self.spawns[int(rng.integers(len(self.spawns)))]
        self.world.place_player_in_cell(self.spawn, float(rng.uniform(0, 2 * np.pi)))
        self.world.put_in_cell(self.goal, self.goal_cell)
        self.blocked = self.maze.solid

    def picked_up(self, item: int) -> None:
        self.world.reward(10)
        self.world.finish_map()

    def act(self, known: Knowledge) -> int:
        if not known.has_seen(self.goal):
            return known.explore(self.blocked, size=CELL)
        believed = self.blocked & known.seen(*self.blocked.shape)
        return Ways(believed, [self.goal_cell]).walk_to(self.world, self.goal_cell)


class GoalLocationsSmall(GoalLocations):
    maze_options = SMALL


class GoalLocationsLarge(GoalLocations):
    maze_options = LARGE


class ObstructedGoals(GoalLocations):
    """Goal: reach the goal as often as possible, though ways open and close.

    Layout: as `GoalLocations`, with a door in every connection.
    Rules: as `GoalLocations`. In every map, the doors along one random way from the player to the
    goal are open, and half of the others; nobody can open or close any.
    Rewards: +10 for the goal.
    Approximated: corridors that turn aside and return are not straightened.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        solid = self.maze.solid
        self.doors = {
            cell: world.add_door(cell, eastwards=not solid[cell[0], cell[1] - 1])
            for cell in self.maze.doors
        }

    def begin_map(self, rng: np.random.Generator) -> None:
        super().begin_map(rng)
        path = random_path(self.maze.solid, self.spawn, self.goal_cell, rng)
        others = [cell for cell in self.doors if cell not in path]
        chosen = rng.permutation(len(others))[: len(others) // 2].tolist()
        opened = {*path, *(others[k] for k in chosen)}
        self.blocked = self.maze.solid.copy()
        for cell, door in self.doors.items():
            self.world.set_door(door, is_open=cell in opened)
            self.blocked[cell] = cell not in opened

    def renewed(self) -> Iterable[Cell]:
        return self.doors


class ObstructedGoalsSmall(ObstructedGoals):
    maze_options = MazeOptions(11, 11, rooms=4, smallest=3, largest=5, doors=True)


class ObstructedGoalsLarge(ObstructedGoals):
    maze_options = MazeOptions(17, 17, rooms=9, smallest=3, largest=3, doors=True)
