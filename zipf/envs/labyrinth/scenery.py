"""What the envs of a batch look like: walls, floors, items, and the views of the players."""

from __future__ import annotations

from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zipf.compiled import compiled
from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.lasertag import view
from zipf.envs.labyrinth.lasertag.arena import FIGHTERS
from zipf.envs.labyrinth.mover import BELOW, EYE
from zipf.envs.labyrinth.state import BOXES, CELL, GRID, ITEMS, PITCH, QUADS, YAW, Envs, X, Y, Z
from zipf.envs.render3d import MeshAtlas, Renderer, Scenes, load_meshes, pack_textures
from zipf.envs.render3d.shadows import cast

METRES = 0.01  # metres of the renderer in one unit
FIELD_OF_VIEW = 90.0  # horizontal, degrees (DeepMind Lab)
LARGE = 288, 384  # height and width of the views for people to watch
WALLS, FLATS, OVERLAYS = 768, 288, view.BARS
"""Capacities of each env. The most are those of a skymaze of 10 x 10 nodes that all connect: 280
platforms, 760 sides."""
SCREEN_PIXELS = 128
"""Height and width of an env's screen: twice what is seen of it in a view of 96 x 72."""
BOB, TURN = 4.0, 2.05
"""How far an item that is not static rises and sinks, units, and seconds of a turn."""
SIDES = ((0, 1, (1, 1, 1, 0)), (1, 0, (0, 1, 1, 1)), (0, -1, (0, 0, 0, 1)), (-1, 0, (1, 0, 0, 0)))
"""East, north, west and south side of a solid cell: rows and columns to the cell from which it is
seen, and its ends x0, y0, x1, y1 from the solid cell's south-west corner."""
DOORS = ITEMS + FIGHTERS - 1  # the first shadow of a door, after those of items and opponents


@cache
def atlas() -> MeshAtlas:
    """The meshes of the labyrinth."""
    return load_meshes(Path(__file__).with_name("meshes.npz"))


@cache
def _textures() -> NDArray[np.uint32]:
    return pack_textures(materials.stack())


def _renderer(height: int, width: int) -> Renderer:
    return Renderer(atlas(), _textures(), width=width, height=height, fov=FIELD_OF_VIEW)


@cache
def _combat_meshes() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Numbers of the meshes of laser tag: of its actors, and of its supplies by kind."""
    actors = [atlas().index(name) for name in view.ACTOR_MESHES]
    supplies = [atlas().index(name) if name else -1 for name in view.SUPPLY_MESHES]
    return np.array(actors, np.int32), np.array(supplies, np.int32)


class Scenery:
    """The scenes of N envs, in metres."""

    def __init__(self, envs: Envs, width: int, height: int) -> None:
        n = len(envs.clock)
        self.envs = envs
        self.scenes = Scenes(
            n, walls=WALLS, flats=FLATS, instances=ITEMS + view.ACTORS, tile_cells=GRID * GRID,
            grid=(GRID, GRID), overlays=OVERLAYS, terrain=(QUADS, QUADS),
            screen=(SCREEN_PIXELS, SCREEN_PIXELS), shadows=DOORS + BOXES,
        )  # fmt: skip
        # The mesh of each item; -1: it is not shown even if it is there. Whether it bobs and turns.
        self.shape = np.full((n, ITEMS), -1, np.int32)
        self.spins = np.zeros((n, ITEMS), np.bool_)
        self.renderer = _renderer(height, width)
        # Not shared with other sceneries: a renderer draws without the GIL, in buffers of its own.
        self._large: Renderer | None = None

    def clear(self, world: int) -> None:
        """Empties an env's scene for a new episode."""
        scenes = self.scenes
        scenes.wall_count[world] = scenes.flat_count[world] = scenes.overlay_count[world] = 0
        scenes.grid[world] = scenes.terrain[world] = 0
        scenes.sky[world] = (190, 215, 235), (95, 150, 215)
        scenes.mesh[world] = -1
        scenes.shadows[world] = 0.0
        self.shape[world] = -1
        self.spins[world] = False

    def draw(self, out: NDArray[np.uint8], mask: NDArray[np.bool_]) -> None:
        """Writes the views of the envs of `mask` to their rows of `out`."""
        self._update(mask)
        self.renderer.render(self.scenes, out, mask)

    def large_views(self, height: int = LARGE[0], width: int = LARGE[1]) -> NDArray[np.uint8]:
        """The views of all envs for people to watch, uint8 [N, height, width, 3]."""
        n = len(self.shape)
        views = np.zeros((n, height, width, 3), np.uint8)
        self._update(np.ones(n, np.bool_))
        if self._large is None or (self._large.height, self._large.width) != (height, width):
            self._large = _renderer(height, width)
        self._large.render(self.scenes, views)
        return views

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_large": None}

    def _update(self, mask: NDArray[np.bool_]) -> None:
        scenes, envs = self.scenes, self.envs
        actors, supplies = _combat_meshes()
        fights = envs.combat.fighters.any()
        if fights:
            view.show_supplies(mask, envs.combat, supplies, self.shape, scenes.colours)
        _pose(
            mask, envs.bodies, envs.clock, envs.places, envs.present, envs.quad, atlas().extent,
            self.shape, self.spins, scenes.scale, scenes.camera, scenes.mesh, scenes.position,
            scenes.rotation, scenes.shadows,
        )  # fmt: skip
        if fights:
            view.pose(
                mask, ITEMS, envs.clock, envs.combat, actors,
                view.Pictures(
                    scenes.camera, scenes.mesh, scenes.position, scenes.rotation, scenes.scale,
                    scenes.colours, scenes.overlays, scenes.overlay_colours, scenes.overlay_count,
                    scenes.shadows,
                ),
            )  # fmt: skip

    def add_walls(
        self, world: int, ends: ArrayLike, heights: tuple[float, float], textures: ArrayLike, *,
        faces: ArrayLike = -1, flags: int = 0, repeat: float = 0.0,
        tint: materials.Colour = materials.WHITE,
    ) -> int:  # fmt: skip
        """`Scenes.add_walls` with ends, heights and `repeat` in units."""
        return self.scenes.add_walls(
            world, np.asarray(ends) * METRES, np.array(heights) * METRES, textures, faces=faces,
            flags=flags, repeat=repeat * METRES, tint=tint,
        )  # fmt: skip


def faces(solid: NDArray[np.bool_]) -> tuple[NDArray[np.float64], ...]:
    """The walls of a text map, bool [rows, columns] with a solid border: a face wherever a free
    cell has a solid neighbour. Arrays are read-only:

    - the ends, float64 [walls, 4], units
    - the free cell, int64 [walls, 2], row and column
    - the face of the solid cell, int64 [walls], see `Scenes.wall_face`
    """
    return _faces(solid.shape[0], solid.tobytes())


@lru_cache(maxsize=64)  # a maze's are asked for twice, a fixed map's in every episode
def _faces(rows: int, signs: bytes) -> tuple[NDArray[np.float64], ...]:
    solid = np.frombuffer(signs, np.bool_).reshape(rows, -1)
    columns = solid.shape[1]
    all_ends, all_cells, all_numbers = [], [], []
    for side, (up, right, corners) in enumerate(SIDES):
        free = ~np.roll(solid, (-up, -right), (0, 1))
        row, column = np.nonzero(solid & free)
        inside = (
            (row + up >= 0)
            & (row + up < len(solid))
            & (column + right >= 0)
            & (column + right < columns)
        )
        row, column = row[inside], column[inside]
        x0, y0, x1, y1 = corners
        all_ends.append(np.stack([column + x0, row + y0, column + x1, row + y1], 1) * CELL)
        all_cells.append(np.stack([row + up, column + right], 1))
        all_numbers.append((row * columns + column) * 4 + side)
    found: tuple[NDArray[Any], ...] = (
        np.concatenate(all_ends),
        np.concatenate(all_cells),
        np.concatenate(all_numbers),
    )
    for array in found:
        array.flags.writeable = False
    return found


@compiled(error_model="numpy")
def _pose(
    mask, bodies, clock, places, present, quad, extents, shape, spins, scale, camera, mesh,
    position, rotation, shadows,
):  # fmt: skip
    """Copies the poses of players and items to the scenes of the envs of `mask`, with the shadows
    of items, which lie on level floors only."""
    for i in range(mask.size):
        if not mask[i]:
            continue
        camera[i, 0] = bodies[i, X] * METRES
        camera[i, 1] = bodies[i, Y] * METRES
        camera[i, 2] = (bodies[i, Z] + EYE) * METRES
        camera[i, 3] = bodies[i, YAW]
        camera[i, 4] = bodies[i, PITCH]
        turn = 2 * np.pi * clock[i] / (60 * TURN)
        cos, sin = np.cos(turn), np.sin(turn)
        for k in range(shape.shape[1]):
            if not present[i, k] or shape[i, k] < 0:
                if mesh[i, k] >= 0:
                    mesh[i, k] = -1
                    shadows[i, k, 7] = 0.0
                continue
            mesh[i, k] = shape[i, k]
            lift = BOB * (1 + sin) if spins[i, k] else 0.0
            for axis in range(3):
                position[i, k, axis] = places[i, k, axis] * METRES
            floor = position[i, k, 2] - BELOW * METRES
            position[i, k, 2] = floor + lift * METRES
            if spins[i, k]:
                rotation[i, k, 0, 0] = rotation[i, k, 1, 1] = cos
                rotation[i, k, 0, 1], rotation[i, k, 1, 0] = -sin, sin
            if quad[i] == 0.0:
                size = extents[shape[i, k]]
                cast(
                    shadows[i, k], position[i, k, 0], position[i, k, 1], floor,
                    turn if spins[i, k] else np.arctan2(rotation[i, k, 1, 0], rotation[i, k, 0, 0]),
                    scale[i, k] * size[0] / 2, scale[i, k] * size[1] / 2, lift * METRES,
                )  # fmt: skip
