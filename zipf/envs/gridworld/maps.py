"""The maps: rooms, doors, objects and their looks, built from seeds.

Map `i` is drawn from `numpy.random.default_rng(1234 + i)`; with the default sizes the first 20 are
the maps of the released benchmark. Scores are comparable only on identical maps, so the order of
all draws must not change. In some places it depends on the order in which Python iterates a set.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zipf.envs.arguments import checked
from zipf.envs.gridworld import GridworldOptions, sprites

FIRST_SEED = 1234
FRESH_FROM = 20
"""Fresh maps, which nobody trains on, are numbered from here on, or from the number of the maps of
the benchmark where there are more: with the default sizes their seeds are 1254 to 1273."""
VIEW = 7  # rows and columns of cells in the agent's view, which is centred on the agent
PAD = VIEW // 2
MOVES = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
"""(row, column) steps of the actions N, NE, E, SE, S, SW, W, NW."""

# Ours: more take more than about ten seconds to build, whenever a program starts.
MOST_CELLS = 10_000_000  # of all maps
MOST_CUBES = 500_000_000  # rooms ** 3 of all maps: the time that joining the rooms takes

_LOOK_ATTEMPTS = 10_000

Room = tuple[int, int]
Cell = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Maps:
    """The maps of a level. Arrays are read-only and shared between environments."""

    # num_maps, num_rooms, room_size, num_objects, first: the arguments of `build_maps`
    num_maps: int
    num_rooms: tuple[int, int]
    room_size: tuple[int, int]
    num_objects: int
    # uint8 [maps, rows + 6, columns + 6], cell codes (`sprites.py`) without the agent, with three
    # cells of floor around the board so that every view is a slice
    codes: NDArray[np.uint8]
    # int64 [maps, objects + 1, 2], (row, column) on the board of each object in order of frequency
    # rank, and last the agent's start
    cells: NDArray[np.int64]
    first: int = 0

    def __reduce__(self) -> tuple[object, ...]:
        sizes = self.num_maps, self.num_rooms, self.room_size, self.num_objects
        return build_maps, (*sizes, self.first)

    @property
    def boards(self) -> NDArray[np.uint8]:
        """`codes` without the padding: uint8 [maps, rows, columns]."""
        return self.codes[:, PAD:-PAD, PAD:-PAD]


def _check_sizes(
    num_maps: int, num_rooms: tuple[int, int], room_size: tuple[int, int], num_objects: int
) -> None:
    """Raises ValueError for arguments of `build_maps` that `GridworldOptions` does not take, that
    would take minutes to build, or where there are fewer looks than objects."""
    sizes = {"num_maps": num_maps, "num_rooms": num_rooms, "room_size": room_size}
    checked(GridworldOptions, {**sizes, "num_objects": num_objects})
    if num_objects > sprites.NUM_LOOKS:
        raise ValueError(
            f"num_objects = {num_objects}, but there are only {sprites.NUM_LOOKS} different looks "
            f"({len(sprites.COLOURS)} colours x {len(sprites.SHAPES)} shapes)"
        )
    height, width = (n * (size + 1) + 1 for n, size in zip(num_rooms, room_size, strict=True))
    rooms = num_rooms[0] * num_rooms[1]
    if num_maps * height * width > MOST_CELLS or num_maps * rooms**3 > MOST_CUBES:
        raise ValueError(
            f"num_maps = {num_maps}, num_rooms = {num_rooms} and room_size = {room_size} make "
            f"{num_maps * height * width:,} cells and maps of {rooms:,} rooms; at most "
            f"{MOST_CELLS:,} cells, and num_maps * rooms ** 3 of at most {MOST_CUBES:,}, can be "
            "built in seconds"
        )


@lru_cache(maxsize=16)
def build_maps(
    num_maps: int = 20,
    num_rooms: tuple[int, int] = (3, 3),
    room_size: tuple[int, int] = (3, 3),
    num_objects: int = 20,
    first: int = 0,
) -> Maps:
    """Builds `num_maps` maps from map `first` on, of `num_rooms` rooms (rows, columns) of
    `room_size` cells.
    Raises ValueError: sizes out of range, or a map has fewer places than objects."""
    _check_sizes(num_maps, num_rooms, room_size, num_objects)
    height, width = (n * (size + 1) + 1 for n, size in zip(num_rooms, room_size, strict=True))
    codes = np.zeros((num_maps, height + 2 * PAD, width + 2 * PAD), dtype=np.uint8)
    cells = np.zeros((num_maps, num_objects + 1, 2), dtype=np.int64)
    maps = Maps(num_maps, num_rooms, room_size, num_objects, codes, cells, first)
    for i in range(num_maps):
        rng = np.random.default_rng(FIRST_SEED + first + i)
        step = (room_size[0] + 1, room_size[1] + 1)
        links = _link_rooms(num_rooms, rng)
        doors = _open_doors(links, step, rng)
        places = _places(list(links), doors, step)
        if len(places) <= num_objects:
            raise ValueError(
                f"num_objects = {num_objects}, but map {first + i} has only {len(places)} places "
                f"for the objects and the agent, so at most {max(len(places) - 1, 0)} objects fit: "
                f"use fewer objects, or more or larger rooms than num_rooms = {num_rooms}, "
                f"room_size = {room_size}"
            )
        rng.shuffle(places)
        board = maps.boards[i]
        board[:: step[0], :] = sprites.WALL
        board[:, :: step[1]] = sprites.WALL
        for door in doors:
            board[door] = sprites.FLOOR
        cells[i] = places[: num_objects + 1]
        for place, look in zip(places[:num_objects], _draw_looks(num_objects, rng), strict=True):
            board[place] = sprites.code(*look)
    codes.flags.writeable = False
    cells.flags.writeable = False
    return maps


def fresh_from(num_maps: int) -> int:
    """The number of the first fresh map where the benchmark has `num_maps` maps."""
    return max(FRESH_FROM, num_maps)


def _link_rooms(num_rooms: tuple[int, int], rng: np.random.Generator) -> dict[Room, list[Room]]:
    """The neighbours that a door joins each room to, in the order in which doors were added.
    Every room can be reached. A door between two rooms is in the lists of both."""
    rooms = [(row, column) for row in range(num_rooms[0]) for column in range(num_rooms[1])]
    links: dict[Room, list[Room]] = {room: [] for room in rooms}

    def neighbours(room: Room, among: list[Room]) -> list[Room]:
        return [other for other in among if abs(room[0] - other[0]) + abs(room[1] - other[1]) == 1]

    def link(room: Room, other: Room) -> None:
        links[room].append(other)
        links[other].append(room)

    for room in rooms:
        if not links[room] and (candidates := neighbours(room, rooms)):
            link(room, candidates[rng.integers(len(candidates))])

    connected, uncertain = rooms[:1], rooms[1:]
    while uncertain:
        unconnected: list[Room] = []
        while uncertain:
            joined = []
            for room in uncertain:
                if any(room in links[other] for other in connected):
                    connected.append(room)
                    joined.append(room)
            if joined:
                uncertain = list(set(uncertain) - set(joined))
            else:
                unconnected, uncertain = uncertain, []
        if unconnected:
            rng.shuffle(unconnected)
            room = next(room for room in unconnected if neighbours(room, connected))
            candidates = neighbours(room, connected)
            rng.shuffle(candidates)
            link(room, candidates[0])
            connected.append(room)
            uncertain = list(set(unconnected) - {room})
    return links


def _open_doors(
    links: dict[Room, list[Room]], step: tuple[int, int], rng: np.random.Generator
) -> list[Cell]:
    """A door at a random place of the wall between every two linked rooms."""
    doors = []
    for (row, column), others in links.items():
        for other_row, other_column in set(others):
            if other_row < row:
                doors.append((row * step[0], column * step[1] + int(rng.integers(1, step[1]))))
            elif other_column < column:
                doors.append((row * step[0] + int(rng.integers(1, step[0])), column * step[1]))
    return doors


def _places(rooms: list[Room], doors: list[Cell], step: tuple[int, int]) -> list[Cell]:
    """Cells beside a wall and not beside a door, in row-major order."""
    blocked = {
        (row + down, column + right)
        for row, column in doors
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1))
    }
    places = [
        (room_row * step[0] + row, room_column * step[1] + column)
        for room_row, room_column in rooms
        for row in range(1, step[0])
        for column in range(1, step[1])
        if row in (1, step[0] - 1) or column in (1, step[1] - 1)
    ]
    return sorted(set(places) - blocked)


def _draw_looks(num_objects: int, rng: np.random.Generator) -> list[tuple[str, str]]:
    """`num_objects` different (colour, shape) pairs, in order of frequency rank."""
    colours, shapes = list(sprites.COLOURS), list(sprites.SHAPES)
    draws = num_objects + 10
    for _ in range(_LOOK_ATTEMPTS):
        drawn_colours = rng.choice(colours, draws, replace=True).tolist()
        drawn_shapes = rng.choice(shapes, draws, replace=True).tolist()
        pairs = sorted(set(zip(drawn_colours, drawn_shapes, strict=True)))
        rng.shuffle(pairs)
        if len(pairs) >= num_objects:
            return pairs[:num_objects]
    raise ValueError(
        f"num_objects = {num_objects} is too many: the benchmark draws {draws} looks out of "
        f"{sprites.NUM_LOOKS} until {num_objects} of them differ, which {_LOOK_ATTEMPTS} attempts "
        "did not achieve; up to about 90 objects are practical"
    )
