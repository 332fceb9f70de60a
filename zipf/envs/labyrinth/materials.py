"""Textures and colours of the labyrinth: themes of floors and walls, pictures on walls, skies.

DeepMind Lab's art may not be copied: patterns and pictures are procedural. The colours of floors
and walls are the mean colours of the original's, where those could be measured.
"""

import colorsys
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth import patterns
from zipf.envs.labyrinth.patterns import Colour
from zipf.envs.render3d.textures import SIZE, X, Y, carpet, hexagons, painted, planks

WHITE: Colour = (255, 255, 255)

PICTURES = 80
"""How many pictures there are for walls."""
STYLES = 5  # each has four floors and four walls: two colours, normal and bright

_FLOORS: tuple[tuple[Colour, ...], ...] = (
    ((210, 146, 26), (246, 218, 105), (54, 88, 109), (110, 148, 169)),
    ((52, 117, 174), (150, 190, 228), (93, 133, 56), (165, 203, 121)),
    ((22, 91, 49), (79, 148, 106), (85, 137, 150), (154, 206, 219)),
    ((61, 146, 207), (118, 202, 240), (207, 168, 61), (244, 225, 119)),
    ((60, 90, 170), (130, 160, 230), (214, 120, 40), (246, 182, 118)),  # ours
)
_WALLS: tuple[tuple[Colour, ...], ...] = (
    ((105, 140, 95), (165, 197, 156), (150, 60, 45), (213, 123, 103)),
    ((195, 168, 37), (232, 214, 120), (77, 93, 114), (140, 158, 182)),
    ((200, 90, 0), (232, 118, 14), (76, 74, 79), (145, 143, 148)),
    ((91, 121, 53), (163, 192, 117), (154, 73, 49), (216, 142, 112)),
    ((170, 48, 48), (226, 120, 116), (206, 176, 52), (240, 220, 128)),  # ours
)
CORRIDOR_FLOOR: Colour = (196, 112, 20)
CORRIDOR_WALL: Colour = (92, 132, 86)


def _circuit(colour: Colour, seed: int) -> NDArray[np.uint8]:
    """Panels with conductors that end in dots."""
    x, y = X % 32, Y % 32
    column, row = np.floor(x), np.floor(y)
    lines = ((row == 8) & (x < 22)) | ((column == 22) & (y >= 8) & (y < 20))
    lines |= ((row == 20) & (x >= 22)) | ((row == 26) & (x < 14))
    lines |= (column == 14) & (y > 14) & (y <= 27)
    dots = (np.hypot(x - 14, y - 14) < 2.8) | (np.hypot(x - 4, y - 20) < 2.4)
    seam = (column == 0) | (row == 0)
    return painted(colour, 1 + 0.18 * (lines | dots) - 0.25 * seam)


def _slanted(colour: Colour, seed: int) -> NDArray[np.uint8]:
    """Square tiles on their corners."""
    u, v = (X + Y) % 64, (X - Y) % 64
    tile = (u // 16).astype(int), (v // 16).astype(int)
    shade = np.random.default_rng(seed).uniform(-0.08, 0.08, (4, 4))[tile]
    return painted(colour, 1 + shade - 0.25 * ((u % 16 < 1) | (v % 16 < 1)))


def _basket(colour: Colour, seed: int) -> NDArray[np.uint8]:
    """Strips that pass over and under each other."""
    over = (X // 16 + Y // 16) % 2 == 0
    across = np.where(over, Y % 16, X % 16)
    round_ = 0.14 * np.sin(np.pi * (across + 0.5) / 16)
    return painted(colour, 0.9 + round_ - 0.22 * (across < 1))


def _dots(colour: Colour, seed: int) -> NDArray[np.uint8]:
    distance = np.hypot((X % 16) - 7.5, (Y % 16) - 7.5)
    return painted(colour, 1 - 0.22 * (distance < 3.5))


def _discs(colour: Colour, seed: int) -> NDArray[np.uint8]:
    """Two by two large discs."""
    distance = np.hypot((X % 32) - 15.5, (Y % 32) - 15.5)
    ring = abs(distance - 11.5) < 1.2
    return painted(colour, 0.94 + 0.12 * (distance < 11) - 0.2 * ring)


def _maze_lines(colour: Colour, seed: int) -> NDArray[np.uint8]:
    """Nested angular lines."""
    x, y = abs(X - 31.5), abs(Y - 31.5)
    far = np.maximum(x, y)
    gap = (X > 28) & (X < 36) & ((far // 6).astype(int) % 2 == 0)
    return painted(colour, 1 - 0.24 * ((far % 6 < 1.6) & ~gap))


def _rings(colour: Colour, seed: int) -> NDArray[np.uint8]:
    distance = np.hypot((X % 32) - 15.5, (Y % 32) - 15.5)
    return painted(colour, 1 - 0.2 * ((distance % 8 < 2) & (distance < 16)))


def _chevrons(colour: Colour, seed: int) -> NDArray[np.uint8]:
    return painted(colour, 1 - 0.2 * ((Y + abs(X % 32 - 16)) % 16 < 4))


_FLOOR_PAINTERS = (hexagons, _slanted, _dots, planks, _rings)
_WALL_PAINTERS = (_circuit, _basket, _discs, _maze_lines, _chevrons)


def _plain(colour: Colour) -> NDArray[np.uint8]:
    return painted(colour, np.ones((SIZE, SIZE)))


def _bars(colour: Colour) -> NDArray[np.uint8]:
    """A fence: upright bars and two rails, with holes between them."""
    bars, rails = X % 16 < 5, (Y % 32 >= 12) & (Y % 32 < 16)
    image = painted(colour, 1 - 0.25 * ((X % 16 >= 4) & bars))
    image[..., 3] = np.where(bars | rails, 255, 0)
    return image


def _panel(colour: Colour) -> NDArray[np.uint8]:
    """A door: a frame around two fields."""
    frame = (X < 5) | (X >= 59) | (Y < 4) | (Y >= 60) | (abs(Y - 31.5) < 3)
    return painted(colour, 0.82 + 0.2 * frame)


def _riser(colour: Colour) -> NDArray[np.uint8]:
    """The side of a platform, with a dark rim above."""
    return painted(colour, np.where(Y < 14, 0.25, 1 - 0.15 * ((X + Y) % 16 < 2)))


def _picture(number: int) -> NDArray[np.uint8]:
    """A framed figure on a ground; shape, colours and turn follow from the number."""
    hue = (number * 0.381966) % 1.0  # the golden angle: numbers that follow differ most
    ground = [round(255 * c) for c in colorsys.hsv_to_rgb(hue, 0.35, 0.95)]
    figure = [round(255 * c) for c in colorsys.hsv_to_rgb((hue + 0.42) % 1, 0.9, 0.6)]
    x, y = (X - 31.5) / 22, (Y - 31.5) / 22
    turn = np.pi / 4 * (number // 10 % 4)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    far, angle = np.hypot(u, v), np.arctan2(v, u)
    shapes = (
        far < 0.8,
        np.maximum(abs(u), abs(v)) < 0.65,
        (v > -0.6) & (abs(u) < 0.45 * (0.8 - v)),
        (abs(u) < 0.25) & (abs(v) < 0.85) | (abs(v) < 0.25) & (abs(u) < 0.85),
        (far < 0.85) & (far > 0.45),
        far < 0.5 + 0.3 * np.cos(5 * angle),
        (v + u) % 0.6 < 0.3,
        (np.floor(u * 2.2) + np.floor(v * 2.2)) % 2 == 0,
        (far < 0.85) & (u > 0.15 * np.sin(6 * v)),
        (abs(v) < 0.2) | ((u > 0.2) & (abs(v) < 0.9 - u)),
    )
    image = np.empty((SIZE, SIZE, 4), np.uint8)
    image[..., 3] = 255
    image[..., :3] = np.where(shapes[number % 10][..., None], figure, ground)
    edge = np.minimum(np.minimum(X, 63 - X), np.minimum(Y, 63 - Y))
    image[edge < 5, :3] = (54, 40, 30) if number % 2 else (214, 206, 190)
    return image


@cache
def _named() -> dict[str, NDArray[np.uint8]]:
    textures = {"plain": _plain((255, 255, 255)), "panel": _panel((170, 120, 70))}
    textures["sand"] = carpet((214, 178, 120), 3)
    textures["riser"] = _riser((52, 117, 174))
    textures["bars"] = _bars((255, 255, 255))
    textures["corridor_floor"] = hexagons(CORRIDOR_FLOOR, 7)
    textures["corridor_wall"] = _circuit(CORRIDOR_WALL, 7)
    for style in range(STYLES):
        for shade in range(4):
            seed = 4 * style + shade
            textures[f"floor_{seed}"] = _FLOOR_PAINTERS[style](_FLOORS[style][shade], seed)
            textures[f"wall_{seed}"] = _WALL_PAINTERS[style](_WALLS[style][shade], seed)
    for number in range(PICTURES):
        textures[f"picture_{number}"] = _picture(number)
    for word, colour in patterns.FLOORS.items():
        textures[f"floor_{word}"] = _slanted(colour, 2)
    return textures | patterns.textures()


@cache
def index(name: str) -> int:
    """The number of a texture in `stack()`. Raises ValueError for an unknown name."""
    names = tuple(_named())
    if name not in names:
        raise ValueError(f"no texture {name!r}; there are {', '.join(names)}")
    return names.index(name)


@cache
def stack() -> NDArray[np.uint8]:
    """All textures, uint8 [K, SIZE, SIZE, 4]; alpha 0 marks holes."""
    stacked = np.stack(list(_named().values()))
    stacked.flags.writeable = False
    return stacked


@cache
def mean_colours() -> NDArray[np.float64]:
    """Of the textures without their holes, float64 [K, 3]."""
    textures = stack().astype(np.float64)
    shown = textures[..., 3:] >= 128
    mean: NDArray[np.float64] = (textures[..., :3] * shown).sum((1, 2)) / shown.sum((1, 2))
    return mean
