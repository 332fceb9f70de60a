"""Procedural textures: 64 x 64 RGBA images that repeat without a seam.

Their contrast is low, so that objects stand out against walls and floors.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

SIZE = 64

_Y, _X = np.mgrid[0:SIZE, 0:SIZE]


def _noise(seed: int, cells: int) -> NDArray[np.float64]:
    """Smooth noise [64, 64] in -1 .. 1 that wraps around, with features of 64 / cells texels."""
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, (cells, cells))
    y, x = _Y * cells / SIZE, _X * cells / SIZE
    row, column = y.astype(int), x.astype(int)
    v, u = y - row, x - column
    v, u = v * v * (3 - 2 * v), u * u * (3 - 2 * u)
    below, right = (row + 1) % cells, (column + 1) % cells
    top = values[row, column] * (1 - u) + values[row, right] * u
    bottom = values[below, column] * (1 - u) + values[below, right] * u
    return top * (1 - v) + bottom * v


def _grain(seed: int) -> NDArray[np.float64]:
    """Noise at several scales, -1 .. 1."""
    return sum(_noise(seed + i, cells) * w for i, (cells, w) in enumerate(_OCTAVES))  # type: ignore[return-value]


_OCTAVES = ((4, 0.35), (8, 0.3), (16, 0.2), (64, 0.15))


def _paint(colour: tuple[int, int, int], light: NDArray[np.float64]) -> NDArray[np.uint8]:
    """An opaque image of `colour` times `light` [64, 64]."""
    image = np.full((SIZE, SIZE, 4), 255, np.uint8)
    image[..., :3] = np.clip(np.asarray(colour) * light[..., None], 0, 255)
    return image


def _mix(
    first: NDArray[np.uint8], second: NDArray[np.uint8], where: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    return np.where(where[..., None], second, first)


def plaster(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return _paint(colour, 1 + 0.06 * _grain(seed))


def wallpaper(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """Small diamonds in rows."""
    diamonds = (abs(_X % 16 - 7.5) + abs((_Y + 8 * (_X // 16 % 2)) % 16 - 7.5)) < 5
    return _paint(colour, 1 + 0.03 * _grain(seed) - 0.12 * diamonds)


def stripes(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return _paint(colour, 1 + 0.03 * _grain(seed) - 0.12 * (_X % 16 < 8))


def planks(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """Four horizontal boards, each with one joint."""
    board = _Y // 16
    rng = np.random.default_rng(seed)
    shade, start = rng.uniform(-0.08, 0.08, (4, 2)), rng.integers(0, 64, 4)
    half = ((_X - start[board]) % SIZE >= 32).astype(int)
    grain = _noise(seed, 32)[_Y, (_X // 8 + 5 * board) % SIZE]
    seam = (_Y % 16 == 0) | ((_X - start[board]) % 32 == 0)
    return _paint(colour, 1 + shade[board, half] + 0.06 * grain - 0.3 * seam)


def tiles(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    shade = np.random.default_rng(seed).uniform(-0.05, 0.05, (4, 4))[_Y // 16, _X // 16]
    seam = (_Y % 16 == 0) | (_X % 16 == 0)
    return _paint(colour, 1 + shade + 0.03 * _grain(seed) - 0.22 * seam)


def carpet(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return _paint(colour, 1 + 0.1 * _noise(seed, 64) + 0.06 * _noise(seed + 1, 16))


def brick(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    row = _Y // 8
    x = (_X + 8 * (row % 2)) % SIZE
    shade = np.random.default_rng(seed).uniform(-0.1, 0.1, (8, 4))[row, x // 16]
    mortar = (_Y % 8 == 0) | (x % 16 == 0)
    bricks = _paint(colour, 1 + shade + 0.05 * _grain(seed))
    return _mix(bricks, _paint((196, 190, 180), 1 + 0.05 * _grain(seed + 9)), mortar)


def checker(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return _paint(colour, 1 + 0.03 * _grain(seed) - 0.2 * ((_X // 16 + _Y // 16) % 2))


def hexagons(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """A honeycomb, 4 cells wide and 4 high: each texel belongs to its nearest centre."""
    centres = [(8 * (2 * c + r % 2), 16 * r) for r in range(-1, 6) for c in range(-1, 6)]
    far = np.sort([np.hypot(_X - x, _Y - y) for x, y in centres], axis=0)
    return _paint(colour, 1 + 0.04 * _grain(seed) - 0.2 * (far[1] - far[0] < 1.6))


def fence(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """Upright bars and two rails, with holes between them."""
    bars = _X % 16 < 5
    rails = (_Y % 32 >= 12) & (_Y % 32 < 17)
    light = 1 + 0.05 * _grain(seed) - 0.25 * (bars & (_X % 16 == 4)) - 0.1 * rails
    image = _paint(colour, light)
    image[..., 3] = np.where(bars | rails, 255, 0)
    return image


_TEXTURES: dict[str, tuple[Callable[..., NDArray[np.uint8]], tuple[int, int, int]]] = {
    "plaster": (plaster, (222, 214, 200)),
    "plaster_blue": (plaster, (176, 192, 210)),
    "plaster_green": (plaster, (186, 203, 176)),
    "wallpaper": (wallpaper, (214, 200, 176)),
    "wallpaper_rose": (wallpaper, (216, 186, 182)),
    "wallpaper_blue": (wallpaper, (172, 190, 208)),
    "stripes": (stripes, (220, 208, 186)),
    "stripes_green": (stripes, (180, 198, 172)),
    "planks": (planks, (178, 138, 96)),
    "planks_dark": (planks, (128, 96, 70)),
    "tiles": (tiles, (206, 204, 198)),
    "tiles_blue": (tiles, (142, 168, 186)),
    "carpet": (carpet, (150, 132, 124)),
    "carpet_red": (carpet, (150, 92, 86)),
    "brick": (brick, (170, 98, 78)),
    "checker": (checker, (202, 196, 186)),
    "hexagons": (hexagons, (210, 146, 60)),
    "ceiling": (plaster, (236, 234, 228)),
    "white": (plaster, (245, 245, 245)),
    "fence": (fence, (150, 112, 74)),
}

NAMES: tuple[str, ...] = tuple(_TEXTURES)


def index(name: str) -> int:
    """The number of the texture `name` in `stack()`. Raises ValueError for an unknown name."""
    if name not in NAMES:
        raise ValueError(f"no texture {name!r}; there are {', '.join(NAMES)}")
    return NAMES.index(name)


@cache
def stack() -> NDArray[np.uint8]:
    """All textures in the order of `NAMES`, uint8 [K, 64, 64, 4]; alpha 0 marks holes.
    Computed once; the array is read-only."""
    painted = [paint(colour, 16 * i) for i, (paint, colour) in enumerate(_TEXTURES.values())]
    stacked = np.stack(painted)
    stacked.flags.writeable = False
    return stacked
