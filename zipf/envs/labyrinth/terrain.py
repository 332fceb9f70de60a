"""Hilly deserts: heights, plants and rocks, places for mushrooms and players.

DeepMind Lab's terrains are published as binary maps that could not all be read; these are drawn
so that their statistics are those of the ones that could be (see `Terrain`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.labyrinth.grids import distances
from zipf.envs.labyrinth.state import QUADS

WALKABLE = 0.7  # least height of a unit normal that can be walked on
BORDER = 48.0  # distance of things from the edge, units
_STARTS = 10


@dataclass(frozen=True)
class Prop:
    """A plant or rock: its mesh, place, yaw, scale, and the radius that is solid (0: none)."""

    mesh: str
    x: float
    y: float
    yaw: float
    scale: float
    radius: float


@dataclass(frozen=True)
class Terrain:
    """A terrain, in units."""

    size: float  # of a quad
    # float64 [QUADS + 1, QUADS + 1], at the corners of quads, rows to the north
    heights: NDArray[np.float64]
    # bool [QUADS, QUADS], quads that are flat enough and not under a solid prop
    walkable: NDArray[np.bool_]
    props: tuple[Prop, ...]  # plants and rocks
    # mushrooms, starts: x and y, all of which can be reached from each other
    mushrooms: tuple[tuple[float, float], ...]
    starts: tuple[tuple[float, float], ...]

    def height(self, x: float, y: float) -> float:
        """The height of the ground at a point."""
        return float(height_at(self.heights, self.size, x, y))


@compiled(error_model="numpy")
def height_at(heights, size, x, y):
    """The height at a point of the two triangles that a quad is drawn as."""
    limit = len(heights) - 2
    row = min(max(int(y / size), 0), limit)
    column = min(max(int(x / size), 0), limit)
    u, v = x / size - column, y / size - row
    low, high = heights[row, column], heights[row + 1, column + 1]
    if u >= v:
        corner = heights[row, column + 1]
        return low + (corner - low) * u + (high - corner) * v
    corner = heights[row + 1, column]
    return low + (corner - low) * v + (high - corner) * u


@lru_cache(maxsize=256)
def make_terrain(seed: int, side: float, mushrooms: tuple[int, int]) -> Terrain:
    """Draws a terrain with a side of so many units and this least and most number of mushrooms; the
    same arguments give the same one."""
    rng = np.random.default_rng([seed, round(side), *mushrooms])
    size = side / QUADS
    heights = _heights(rng, size)
    normal = _normal_z(heights, size)
    props: list[Prop] = []
    taken: list[tuple[float, float]] = []
    for meshes, most, radius, scales in (
        (("cactus",), 38, 18.0, (0.4, 1.0)),
        (("rock_0", "rock_1", "rock_2"), 37, 36.0, (0.45, 1.3)),
        (("bush_0", "bush_1"), 18, 0.0, (0.6, 1.3)),
    ):
        for _ in range(int(rng.integers(1, most + 1))):
            x, y = rng.uniform(BORDER, side - BORDER, 2).tolist()
            if all(np.hypot(x - a, y - b) > 60 for a, b in taken):
                taken.append((x, y))
                scale = float(rng.uniform(*scales))
                mesh = meshes[int(rng.integers(len(meshes)))]
                yaw = float(rng.uniform(0, 2 * np.pi))
                props.append(Prop(mesh, x, y, yaw, scale, radius * scale))
    walkable = normal > WALKABLE
    centres = (np.arange(QUADS) + 0.5) * size
    x, y = np.meshgrid(centres, centres)
    for prop in props:
        if prop.radius:
            walkable &= np.hypot(x - prop.x, y - prop.y) > prop.radius + 15
    edge = (np.minimum(x, side - x) > BORDER) & (np.minimum(y, side - y) > BORDER)
    count = int(rng.integers(mushrooms[0], mushrooms[1] + 1))
    places = _places(rng, walkable & edge, size, count + _STARTS, taken)
    return Terrain(
        size, heights, walkable, tuple(props), tuple(places[_STARTS:]), tuple(places[:_STARTS])
    )


def _heights(rng: np.random.Generator, size: float) -> NDArray[np.float64]:
    """Four octaves of value noise, smoothed until most quads can be walked on."""
    corners = np.arange(QUADS + 1) / QUADS
    heights = np.zeros((QUADS + 1, QUADS + 1))
    for octave in range(4):
        cells = 2 * 2**octave
        values = rng.uniform(-1, 1, (cells + 2, cells + 2))
        at = corners * cells
        low = np.floor(at).astype(int)
        part = at - low
        part = part * part * (3 - 2 * part)
        along = values[low] * (1 - part)[:, None] + values[low + 1] * part[:, None]
        octave_heights = along[:, low] * (1 - part) + along[:, low + 1] * part
        heights += octave_heights * 0.45**octave
    heights *= rng.uniform(33, 130) / heights.std()
    while (_normal_z(heights, size) > WALKABLE).mean() < 0.8:
        padded = np.pad(heights, 1, mode="edge")
        windows = [padded[y : y + QUADS + 1, x : x + QUADS + 1] for y in range(3) for x in range(3)]
        heights = np.add.reduce(windows) / 9.0
    return heights - heights.min()


def _normal_z(heights: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """The height of the unit normal of the steeper one of each quad's two triangles."""
    south_west, south_east = heights[:-1, :-1], heights[:-1, 1:]
    north_west, north_east = heights[1:, :-1], heights[1:, 1:]
    lower = (south_east - south_west) ** 2 + (north_east - south_east) ** 2
    upper = (north_east - north_west) ** 2 + (north_west - south_west) ** 2
    return size / np.sqrt(size**2 + np.maximum(lower, upper))


def _places(
    rng: np.random.Generator,
    free: NDArray[np.bool_],
    size: float,
    count: int,
    taken: list[tuple[float, float]],
) -> list[tuple[float, float]]:
    """Points on the largest connected part of the free quads: 32 units from each other and, as
    far as there is room, 60 from plants and rocks; the first of them, the starts, 60 from all."""
    cells = np.argwhere(free)
    steps = distances(~free, *cells[len(cells) // 2])
    for _ in range(20):  # most cells belong to one part: another start finds it if this one did not
        if (steps >= 0).sum() > free.sum() / 2:
            break
        steps = distances(~free, *cells[int(rng.integers(len(cells)))])
    cells = np.argwhere(steps >= 0)
    found: list[tuple[float, float]] = []
    for attempt in range(100 * count):
        row, column = cells[int(rng.integers(len(cells)))]
        x, y = (column + rng.uniform(0.2, 0.8)) * size, (row + rng.uniform(0.2, 0.8)) * size
        clear = 60 if attempt < 50 * count else 20
        # Starts are found first; a player that stands there touches no mushroom.
        if all(
            np.hypot(x - a, y - b) > (60 if k < _STARTS else 32) for k, (a, b) in enumerate(found)
        ) and all(np.hypot(x - a, y - b) > clear for a, b in taken):
            found.append((float(x), float(y)))
            if len(found) == count:
                break
    return found
