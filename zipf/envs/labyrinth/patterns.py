"""Colours and patterns of the objects that instructions name, and the floors they stand on.

The colours are those of DeepMind Lab's language levels. Its patterns are bitmaps that mix an
object's two colours; ours are procedural, and coarse, to be told apart at a few pixels.
"""

import colorsys
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zipf.envs.render3d.textures import SIZE, X, Y, honeycomb

Colour = tuple[int, int, int]

_HSL = {
    "black": (0, 0, 0), "gray": (0, 0, 50), "white": (0, 0, 100), "red": (0, 100, 50),
    "orange": (30, 100, 50), "brown": (30, 51, 40), "yellow": (60, 100, 50),
    "green": (120, 100, 50), "cyan": (180, 100, 50), "blue": (240, 100, 50),
    "purple": (270, 100, 50), "magenta": (300, 100, 50), "pink": (330, 100, 50),
}  # fmt: skip
"""Hue in degrees, saturation and lightness in percent."""
NOISE = 1.0  # standard deviation of what is added to each channel of an object's colours
SHADE = 0.72
"""Light of the accent parts of an object of one colour, so that its parts can be told apart."""

FLOORS: dict[str, Colour] = {
    "red": (196, 34, 34), "green": (34, 158, 44), "blue": (44, 60, 206), "cyan": (30, 184, 192),
    "magenta": (190, 44, 186), "yellow": (216, 200, 40), "orange": (214, 122, 24),
    "black": (26, 26, 30),
}  # fmt: skip
"""Colours of floors that have a colour word: darker than objects, which stand out from them."""


@cache
def _pure(name: str) -> tuple[float, float, float]:
    hue, saturation, lightness = _HSL[name]
    return colorsys.hls_to_rgb(hue / 360, lightness / 100, saturation / 100)


def rgb(name: str, rng: np.random.Generator) -> Colour:
    """A colour by its name, with the noise that every object's has."""
    red, green, blue = (
        min(max(round(255 * channel + NOISE * noise), 0), 255)
        for channel, noise in zip(_pure(name), rng.normal(size=3).tolist(), strict=True)
    )
    return red, green, blue


def shaded(colour: Colour) -> Colour:
    """The same colour in less light."""
    red, green, blue = (round(SHADE * channel) for channel in colour)
    return red, green, blue


def _chequered() -> NDArray[np.bool_]:
    return (X // 32 + Y // 32) % 2 == 1


def _crosses() -> NDArray[np.bool_]:
    """An upright cross in the middle."""
    x, y = abs(X - 31.5), abs(Y - 31.5)
    return ((x < 6) & (y < 25)) | ((y < 6) & (x < 25))


def _diagonal_stripe() -> NDArray[np.bool_]:
    return (X + Y) % 64 < 32


def _discs() -> NDArray[np.bool_]:
    """One large disc."""
    return np.hypot(X - 31.5, Y - 31.5) < 24


def _hex() -> NDArray[np.bool_]:
    """The thick seams of a honeycomb, 2 cells wide and 2 high."""
    return honeycomb(16) < 8


def _pinstripe() -> NDArray[np.bool_]:
    """Thin upright lines."""
    return X % 32 < 8


def _spots() -> NDArray[np.bool_]:
    """Small spots in shifted rows."""
    x = (X + 16 * (Y // 32)) % 32
    return np.hypot(x - 15.5, Y % 32 - 15.5) < 9


def _swirls() -> NDArray[np.bool_]:
    """A spiral of two turns."""
    x, y = X - 31.5, Y - 31.5
    far, turn = np.hypot(x, y), np.arctan2(y, x) / (2 * np.pi)
    return ((far / 16 + turn) % 1 < 0.5) & (far < 31)


_BITMAPS: dict[str, Callable[[], NDArray[np.bool_]]] = {
    "chequered": _chequered, "crosses": _crosses, "diagonal_stripe": _diagonal_stripe,
    "discs": _discs, "hex": _hex, "pinstripe": _pinstripe, "spots": _spots, "swirls": _swirls,
}  # fmt: skip
SOLID = "solid"
PATTERNS = (SOLID, *_BITMAPS)


def textures() -> dict[str, NDArray[np.uint8]]:
    """The patterns of two colours as textures: black for the first colour, white for the second."""
    found = {}
    for name, paint in _BITMAPS.items():
        image = np.full((SIZE, SIZE, 4), 255, np.uint8)
        image[..., :3] = np.where(paint(), 255, 0)[..., None]
        found[f"pattern_{name}"] = image
    return found
