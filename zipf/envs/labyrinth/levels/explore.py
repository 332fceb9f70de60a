"""The explore levels: remember what lies where in a random maze, new in every episode."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations, product
from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.grids import Cell, random_path
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.patterns import PATTERNS, SOLID
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.steering import Ways
from zipf.envs.labyrinth.words import SHAPES
from zipf.envs.labyrinth.world import World

SMALL = MazeOptions(11, 11, rooms=4, smallest=3, largest=5)
LARGE = MazeOptions(17, 17, rooms=9, smallest=3, largest=3)

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


class Explore(Episode):
    """In a random maze; every map begins in a random spawn cell, looking anywhere."""

    maze_options: ClassVar[MazeOptions]

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.maze = random_maze(rng, self.maze_options)
        themes.build_maze(world, self.maze, rng)
        self.spawns = [cell for room in self.maze.spawns for cell in room]
        self.places = [cell for room in self.maze.objects for cell in room]

    def begin_map(self, rng: np.random.Generator) -> None:
        self.spawn = self.spawns[int(rng.integers(len(self.spawns)))]
        self.world.place_player_in_cell(self.spawn, float(rng.uniform(0, 2 * np.pi)))


class GoalLocations(Explore):
    """Goal: reach the goal as often as possible; it stays where it is.

    Layout: a random maze of rooms and corridors, new in every episode. All rooms look alike and
    so do all corridors; pictures on the walls tell places apart.
    Rules: a cell of a room has the goal for the whole episode. Reaching it begins a new map: the
    player stands in a random spawn cell, looking anywhere.
    Rewards: +10 for the goal.
    Approximated: corridors that turn aside and return are not straightened.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.goal_cell = self.places[int(rng.integers(len(self.places)))]
        self.goal = themes.add_goal(world)

    def begin_map(self, rng: np.random.Generator) -> None:
        super().begin_map(rng)
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


class ObjectLocations(Explore):
    """Goal: collect all apples as often as possible; they come back to the same places.

    Layout: a random maze of rooms and corridors, new in every episode. All rooms look alike and
    so do all corridors; pictures on the walls tell places apart.
    Rules: half of the object cells, four to a room, have an apple, the same ones for the whole
    episode. Taking the last apple begins a new map: all apples are back, and the player stands in a
    random spawn cell, looking anywhere.
    Rewards: +1 for an apple.
    Approximated: corridors that turn aside and return are not straightened.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        chosen = rng.permutation(len(self.places))[: len(self.places) // 2].tolist()
        self.apples = {themes.add_apple(world): self.places[k] for k in chosen}

    def begin_map(self, rng: np.random.Generator) -> None:
        super().begin_map(rng)
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


class ObjectRewards(Explore):
    """Goal: take the good objects and leave the bad ones.

    Layout: one room of 11 x 11 cells with pictures on its walls.
    Rules: an episode has four (many: eight) kinds of objects, each a shape with a pattern of two
    colours; half of the kinds are good. A map has one object of each kind in random ones of eight
    (many: sixteen) cells. When all good ones are taken, a new map begins: the player stands in a
    random spawn cell, looking anywhere.
    Rewards: +2 for a good object, -1 for a bad one.
    Approximated: the bitmaps of the patterns are ours.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        kinds = len(self.places) // 2
        self.objects = []
        for kind in rng.choice(len(_KINDS), kinds, replace=False).tolist():
            shape, pattern, pair = _KINDS[kind]
            colours = pair if rng.integers(2) else pair[::-1]
            self.objects.append(world.add_item(shape, colours=colours, pattern=pattern))
        self.good = self.objects[: kinds // 2]
        self.tried: set[int] = set()

    def begin_map(self, rng: np.random.Generator) -> None:
        super().begin_map(rng)
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
    maze_options = MazeOptions(13, 13, rooms=1, smallest=11, largest=11, objects=8)


class ObjectRewardsMany(ObjectRewards):
    maze_options = MazeOptions(13, 13, rooms=1, smallest=11, largest=11, objects=16)
