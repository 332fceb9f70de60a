"""How fast views are drawn, on one core.

    python scripts/benchmark_render.py

Views are 96 x 72 from random places, turned anywhere and pitched up to 25 degrees either way. Times
are CPU seconds of this process. All rows are measured in turn, several times over, and each row's
median is shown. benchmark_peers.py has whole environments beside ViZDoom.
"""

import argparse
import os

import numpy as np
from rich.console import Console
from rich.table import Table
from turns import OwnRow

from zipf.envs.render3d import (
    FACES_DOWN,
    Renderer,
    Scenes,
    load_meshes,
    pack_textures,
    textures,
)

ENVS = 256
CELLS = 21
GOALS = {"maze": 40_000, "room + 5 objects": 15_000, "hills": 8_000}
PITCH = np.radians(25.0)


def carve(rng: np.random.Generator) -> np.ndarray:
    """A maze of corridors with four rooms of 5 x 5 cells: bool [CELLS, CELLS], True is solid."""
    solid = np.ones((CELLS, CELLS), np.bool_)
    for row, column in rng.permutation([(1, 1), (1, 13), (11, 5), (13, 15)]):
        solid[row : row + 5, column : column + 5] = False
    solid[1, 1] = False
    for start in np.argwhere(solid[1::2, 1::2]) * 2 + 1:
        path = [tuple(start)]
        solid[path[-1]] = False
        while path:
            row, column = path[-1]
            ways = [
                (r, c)
                for r, c in ((row + 2, column), (row - 2, column), (row, column + 2))
                + ((row, column - 2),)
                if 0 < r < CELLS and 0 < c < CELLS and solid[r, c]
            ]
            if not ways:
                path.pop()
                continue
            r, c = ways[rng.integers(len(ways))]
            solid[(row + r) // 2, (column + c) // 2] = solid[r, c] = False
            path.append((r, c))
    for row, column in rng.integers(1, CELLS - 1, (40, 2)):
        if (row + column) % 2:
            solid[row, column] = False
    return solid


def maze(*, pitched: bool, ceiling: bool, seed: int = 0) -> Scenes:
    """Mazes of 21 x 21 cells of 1 m, every cell of the floor with its own texture."""
    rng = np.random.default_rng(seed)
    scenes = Scenes(
        ENVS, walls=640, flats=2, tile_cells=CELLS * CELLS, grid=(CELLS, CELLS)
    )  # fmt: skip
    walls = [
        textures.index(name) for name in ("plaster_green", "wallpaper", "stripes_green", "plaster")
    ]
    floors = [textures.index(name) for name in ("planks", "tiles", "carpet", "checker")]
    sides = (
        (0, 1, (1, 1, 1, 0)),
        (1, 0, (0, 1, 1, 1)),
        (0, -1, (0, 0, 0, 1)),
        (-1, 0, (1, 0, 0, 0)),
    )
    for i in range(ENVS):
        solid = carve(rng)
        scenes.solid[i] = solid
        scenes.grid[i] = 0, 0, 1
        for row, column in np.argwhere(solid):
            for side, (down, right, (x0, y0, x1, y1)) in enumerate(sides):
                r, c = row + down, column + right
                if 0 <= r < CELLS and 0 <= c < CELLS and not solid[r, c]:
                    ends = (column + x0, row + y0, column + x1, row + y1)
                    face = (row * CELLS + column) * 4 + side
                    scenes.add_walls(i, ends, (0, 1), int(rng.choice(walls)), faces=face)
        tiles = rng.choice(floors, (CELLS, CELLS))
        scenes.add_flat(i, (0, 0, CELLS, CELLS), 0, 0, tiles=tiles)
        if ceiling:
            scenes.add_flat(
                i, (0, 0, CELLS, CELLS), 1, textures.index("ceiling"),
                repeat=1, flags=FACES_DOWN,
            )  # fmt: skip
        free = np.argwhere(~solid)
        y, x = free[rng.integers(len(free))] + rng.uniform(0.2, 0.8, 2)
        pitch = rng.uniform(-PITCH, PITCH) if pitched else 0.0
        scenes.camera[i] = x, y, 0.5, rng.uniform(-np.pi, np.pi), pitch
    return scenes


def room(*, objects: int, pitched: bool, seed: int = 0) -> Scenes:
    """Rooms of 4 x 3 m, with objects 1 to 2.5 m before the eyes and their shadows on the floor."""
    rng = np.random.default_rng(seed)
    meshes = len(load_meshes().names)
    scenes = Scenes(ENVS, walls=4, flats=2, instances=objects, shadows=objects)
    corners = ((0, 0), (4, 0), (4, 3), (0, 3))
    for i in range(ENVS):
        for k, name in enumerate(("wallpaper", "plaster_blue", "stripes", "plaster_green")):
            ends = corners[k] + corners[(k + 1) % 4]
            scenes.add_walls(i, ends, (0, 2.4), textures.index(name), repeat=1)
        rectangle = (0, 0, 4, 3)
        scenes.add_flat(i, rectangle, 0, textures.index("planks"), repeat=1)
        scenes.add_flat(i, rectangle, 2.4, textures.index("ceiling"), flags=FACES_DOWN)
        yaw = rng.uniform(-np.pi, np.pi)
        pitch = rng.uniform(-PITCH, PITCH) if pitched else 0.0
        x, y = rng.uniform(0.5, 3.5), rng.uniform(0.5, 2.5)
        scenes.camera[i] = x, y, 1.1, yaw, pitch
        for k in range(objects):
            angle, far = yaw + rng.uniform(-0.7, 0.7), rng.uniform(1.0, 2.5)
            scenes.mesh[i, k] = rng.integers(meshes)
            scenes.position[i, k] = (
                x + far * np.cos(angle),
                y + far * np.sin(angle),
                1.1 + far * np.tan(pitch + rng.uniform(-0.5, 0.3)) - 0.2,
            )
            turn = rng.uniform(-np.pi, np.pi)
            x_y = scenes.position[i, k, :2]
            scenes.shadows[i, k] = *x_y, 0, turn, 0.1, 0.07, 0.15, 0.5
            cos, sin = np.cos(turn), np.sin(turn)
            scenes.rotation[i, k, :2, :2] = (cos, -sin), (sin, cos)
        scenes.colours[i] = rng.integers(40, 256, (objects, 2, 3))
    if objects:
        # The room's walls must not hide what is measured.
        scenes.walls[:, :, :4] += (scenes.walls[:, :, :4] > 0) * 4 - 2
        scenes.flats[:, :, :4] += (scenes.flats[:, :, :4] > 0) * 4 - 2
    return scenes


def hills(*, pitched: bool, seed: int = 0) -> Scenes:
    """Hills of 63 x 63 cells of 0.33 m, 0.4 to 1.4 m high (a standard deviation)."""
    rng = np.random.default_rng(seed)
    scenes = Scenes(ENVS, terrain=(63, 63))
    place = np.arange(64) / 63
    for i in range(ENVS):
        heights = np.zeros((64, 64))
        for octave in (3, 6, 12, 24):
            knots = rng.normal(size=(octave + 1, octave + 1)) / octave
            for axis in (0, 1):
                low = np.minimum((place * octave).astype(int), octave - 1)
                share = place * octave - low
                share = (share * share * (3 - 2 * share)).reshape((-1, 1) if axis == 0 else (1, -1))
                below, above = np.take(knots, low, axis), np.take(knots, low + 1, axis)
                knots = below * (1 - share) + above * share
            heights += knots
        heights *= rng.uniform(0.4, 1.4) / heights.std()
        scenes.set_terrain(
            i, (0, 0), 0.33, heights, textures.index("carpet"), repeat=1,
            tint=(255, 240, 200),
        )  # fmt: skip
        row, column = rng.integers(2, 61, 2)
        pitch = rng.uniform(-PITCH, PITCH) if pitched else 0.0
        eye = heights[row, column] + 0.5
        scenes.camera[i] = (
            0.33 * column,
            0.33 * row,
            eye,
            rng.uniform(-np.pi, np.pi),
            pitch,
        )
    return scenes


def row(name: str, scenes: Scenes, size: tuple[int, int] = (96, 72)) -> OwnRow:
    width, height = size
    renderer = Renderer(load_meshes(), pack_textures(textures.stack()), width=width, height=height)
    out = np.zeros((ENVS, height, width, 3), np.uint8)

    def run(calls: int) -> None:
        for _ in range(calls):
            renderer.render(scenes, out)

    return OwnRow(name, ENVS, run)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.5, help="of each row in each round")
    args = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    maze_sky = maze(pitched=True, ceiling=False)
    rows = [
        row("maze", maze_sky),
        row("maze, pitch 0", maze(pitched=False, ceiling=False)),
        row("maze with ceiling", maze(pitched=True, ceiling=True)),
        row("room", room(objects=0, pitched=True)),
        row("room, pitch 0", room(objects=0, pitched=False)),
        row("room + 5 objects", room(objects=5, pitched=True)),
        row("room + 5 objects, pitch 0", room(objects=5, pitched=False)),
        row("hills", hills(pitched=True)),
        row("hills, pitch 0", hills(pitched=False)),
        row("maze 160 x 120", maze_sky, (160, 120)),
    ]
    for each in rows:
        each.run(1)
    for _ in range(args.rounds):
        for each in rows:
            each.measure(args.seconds)
    table = Table("view", "frames/s", "lowest", "highest", "goal")
    for each in rows:
        table.add_row(
            each.name, f"{each.median:,.0f}", f"{min(each.speeds):,.0f}",
            f"{max(each.speeds):,.0f}",
            f"{GOALS[each.name]:,}" if each.name in GOALS else "",
        )  # fmt: skip
    Console().print(table)


if __name__ == "__main__":
    main()
