"""Procedural textures: RGBA images that repeat without a seam.

Their contrast is low, so that objects stand out against walls and floors.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

SIZE = 128
"""Texels in a line of a texture, and lines; a power of 2."""

Y, X = np.mgrid[0:SIZE, 0:SIZE] * (64 / SIZE) + (32 / SIZE - 0.5)
"""Rows and columns of the texels' middles in 64ths of a texture, where 0 is the middle of the first
and 63 that of the last. Patterns are made of such units, and do not depend on SIZE."""


def _noise(seed: int, rows: int, columns: int) -> NDArray[np.float64]:
    """Smooth noise in -1 .. 1 that wraps around, of so many features down and across."""
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, (rows, columns))
    y, x = Y * rows / 64, X * columns / 64
    row, column = np.floor(y).astype(int), np.floor(x).astype(int)
    v, u = y - row, x - column
    v, u = v * v * (3 - 2 * v), u * u * (3 - 2 * u)
    below, right = (row + 1) % rows, (column + 1) % columns
    top = values[row, column] * (1 - u) + values[row, right] * u
    bottom = values[below, column] * (1 - u) + values[below, right] * u
    return top * (1 - v) + bottom * v


def _grain(seed: int) -> NDArray[np.float64]:
    """Noise at several scales, -1 .. 1."""
    return sum(_noise(seed + i, cells, cells) * w for i, (cells, w) in enumerate(_OCTAVES))  # type: ignore[return-value]


_OCTAVES = ((4, 0.35), (8, 0.3), (16, 0.2), (64, 0.15))


def painted(colour: tuple[int, int, int], light: NDArray[np.float64]) -> NDArray[np.uint8]:
    """An opaque image of `colour` times `light` [SIZE, SIZE]."""
    image = np.full((SIZE, SIZE, 4), 255, np.uint8)
    image[..., :3] = np.clip(np.asarray(colour) * light[..., None], 0, 255)
    return image


def _cells(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the squares of `size` units that texels are in; those before the first
    count as the last."""
    return np.floor(Y / size).astype(int), np.floor(X / size).astype(int)


def plaster(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return painted(colour, 1 + 0.06 * _grain(seed))


def wallpaper(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """Small diamonds in rows."""
    diamonds = (abs(X % 16 - 7.5) + abs((Y + 8 * (X // 16 % 2)) % 16 - 7.5)) < 5
    return painted(colour, 1 + 0.03 * _grain(seed) - 0.12 * diamonds)


def stripes(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return painted(colour, 1 + 0.03 * _grain(seed) - 0.12 * (X % 16 < 8))


def planks(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """Four horizontal boards, each with one joint."""
    board, _ = _cells(16)
    rng = np.random.default_rng(seed)
    light, start = rng.uniform(-0.08, 0.08, (4, 2)), rng.integers(0, 64, 4)
    half = ((X - start[board]) % 64 >= 32).astype(int)
    grain = _noise(seed, 32, 4)
    seam = (Y % 16 < 1) | ((X - start[board]) % 32 < 1)
    return painted(colour, 1 + light[board, half] + 0.06 * grain - 0.3 * seam)


def tiles(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    light = np.random.default_rng(seed).uniform(-0.05, 0.05, (4, 4))[_cells(16)]
    seam = (Y % 16 < 1) | (X % 16 < 1)
    return painted(colour, 1 + light + 0.03 * _grain(seed) - 0.22 * seam)


def carpet(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return painted(colour, 1 + 0.1 * _noise(seed, 64, 64) + 0.06 * _noise(seed + 1, 16, 16))


def checker(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    return painted(colour, 1 + 0.03 * _grain(seed) - 0.2 * ((X // 16 + Y // 16) % 2))


def honeycomb(across: int) -> NDArray[np.float64]:
    """How much farther the second nearest middle of a honeycomb is than the nearest, units. Cells
    are 2 * `across` units wide and high, and the honeycomb repeats."""
    far = np.sort(
        [
            np.hypot(X - across * (2 * c + r % 2), Y - 2 * across * r)
            for r in range(-1, 32 // across + 2)
            for c in range(-1, 32 // across + 2)
        ],
        axis=0,
    )
    return far[1] - far[0]


def hexagons(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """A honeycomb, 4 cells wide and 4 high."""
    return painted(colour, 1 + 0.04 * _grain(seed) - 0.2 * (honeycomb(8) < 1.6))


def skirting(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """A board with a bead along its top."""
    return painted(colour, 0.94 + 0.06 * (Y < 14) - 0.25 * ((Y >= 14) & (Y < 20)))


def window(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """A frame with four panes, through which hills and the sky are seen."""
    edge = np.minimum(np.minimum(X, 63 - X), np.minimum(Y, 63 - Y))
    bars = np.minimum(abs(X - 31.5), abs(Y - 31.5))
    frame = painted(colour, 1 - 0.15 * ((edge >= 3) & (edge < 4.5)) - 0.12 * (Y > 60))
    sky = np.stack([150 + Y, 190 + 0.7 * Y, 232 + 0.2 * Y], -1)
    hills = 42 + 4 * np.sin(X / 9) + 2 * np.sin(X / 4 + 1) < Y
    meadow = np.array((112, 158, 96)) * (1 + 0.004 * (Y[..., None] - 50))
    frame[..., :3] = np.where(
        ((edge < 4.5) | (bars < 1.5))[..., None],
        frame[..., :3],
        np.where(hills[..., None], meadow, np.clip(sky, 0, 255)),
    )
    return frame


def picture(colour: tuple[int, int, int], seed: int) -> NDArray[np.uint8]:
    """A boat on the sea under the sun, in a frame with a mount."""
    edge = np.minimum(np.minimum(X, 63 - X), np.minimum(Y, 63 - Y))
    image = painted(colour, 1 - 0.3 * ((edge >= 3.5) & (edge < 4.5)))
    for where, paint in (
        (edge >= 4.5, (236, 232, 222)),
        (edge >= 10, (196, 214, 222)),
        ((edge >= 10) & (np.hypot(X - 46, Y - 20) < 4.5), (226, 178, 92)),
        ((edge >= 10) & (42 + np.sin(X / 2) < Y), (96, 136, 158)),
        ((abs(X - 28) < 11 - 0.8 * (Y - 38)) & (Y >= 38) & (Y < 44), (134, 92, 66)),
        ((X >= 28.5) & (X - 28.5 < 0.45 * (Y - 16)) & (Y < 36.5), (214, 204, 186)),
        ((X < 27) & (27 - X < 0.35 * (Y - 20)) & (Y < 36.5), (186, 120, 100)),
    ):
        image[where, :3] = paint
    return image


# By name: what paints it, in which colour, with which seed.
_TEXTURES: dict[str, tuple[Callable[..., NDArray[np.uint8]], tuple[int, int, int], int]] = {
    "plaster": (plaster, (222, 214, 200), 0),
    "plaster_blue": (plaster, (176, 192, 210), 16),
    "plaster_green": (plaster, (186, 203, 176), 32),
    "wallpaper": (wallpaper, (214, 200, 176), 48),
    "wallpaper_rose": (wallpaper, (216, 186, 182), 64),
    "wallpaper_blue": (wallpaper, (172, 190, 208), 80),
    "stripes": (stripes, (220, 208, 186), 96),
    "stripes_green": (stripes, (180, 198, 172), 112),
    "planks": (planks, (178, 138, 96), 128),
    "planks_dark": (planks, (128, 96, 70), 144),
    "tiles": (tiles, (206, 204, 198), 160),
    "tiles_blue": (tiles, (142, 168, 186), 176),
    "carpet": (carpet, (150, 132, 124), 192),
    "carpet_red": (carpet, (150, 92, 86), 208),
    "checker": (checker, (202, 196, 186), 240),
    "ceiling": (plaster, (236, 234, 228), 272),
    "skirting": (skirting, (236, 230, 218), 320),
    "window": (window, (240, 238, 232), 336),
    "picture": (picture, (120, 88, 60), 352),
}

NAMES: tuple[str, ...] = tuple(_TEXTURES)


def index(name: str) -> int:
    """The number of the texture `name` in `stack()`. Raises ValueError for an unknown name."""
    if name not in NAMES:
        raise ValueError(f"no texture {name!r}; there are {', '.join(NAMES)}")
    return NAMES.index(name)


@cache
def stack() -> NDArray[np.uint8]:
    """All textures in the order of `NAMES`, uint8 [K, SIZE, SIZE, 4].
    Computed once; the array is read-only."""
    images = [paint(colour, seed) for paint, colour, seed in _TEXTURES.values()]
    stacked = np.stack(images)
    stacked.flags.writeable = False
    return stacked
