"""What the mazes look like: one look for corridors, one for rooms."""

from __future__ import annotations

import numpy as np

from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.mazes import Maze
from zipf.envs.labyrinth.world import World


def build_maze(world: World, maze: Maze, rng: np.random.Generator, *, alike: bool = True) -> None:
    """Builds a maze with pictures on its walls in an empty env. If `alike`, all rooms have the same
    look; corridors always have."""
    rooms = int(maze.room.max()) + 1
    drawn = rng.integers(0, 4 * materials.STYLES, (2, 1 if alike else rooms))
    of_room = np.zeros(rooms, np.int64) if alike else np.arange(rooms)
    in_room = maze.room >= 0
    room = of_room[np.maximum(maze.room, 0)]
    floors = np.where(in_room, materials.index("floor_0") + 2 * drawn[0][room], 0)
    walls = np.where(in_room, materials.index("wall_0") + 2 * drawn[1][room], 0)
    floors[~in_room] = materials.index("corridor_floor")
    walls[~in_room] = materials.index("corridor_wall")
    world.add_text_map(maze.solid, floors, walls)
    world.add_pictures(maze.solid, rng)


def add_goal(world: World, scale: float = 1.0) -> int:
    """A goal object that is nowhere yet."""
    return world.add_item("goal", colours=((250, 200, 40), (200, 40, 40)), scale=scale)


def add_apple(world: World) -> int:
    """An apple that is nowhere yet."""
    return world.add_item("apple", colours=((220, 40, 36), (120, 180, 60)))
