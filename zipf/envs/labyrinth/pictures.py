"""Procedural pictures of things, in the place of photographs that may not be passed on.

There are 2400, each the same for ever: 24 things, composed of simple shapes, in 10 colours, with 5
patterns, on white or in a scene. Turn, size, mirroring and the second colour follow from the
picture's number.
"""

import colorsys
import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled

_ELLIPSE, _BOX, _TRIANGLE, _DOME, _RING = range(5)
"""Kinds of shapes; the apex of a triangle is above, a dome is the upper half of an ellipse."""
_MAIN, _ACCENT, _DARK, _LIGHT, _SECOND, _SKY, _GROUND = range(7)
"""Colours of a picture; of the first four a shape has one. Main shapes are patterned with the
second colour."""
_SMALLER = 1.12  # how many times smaller the thing in a picture is than the picture

# Of each thing its shapes, of which later ones cover earlier ones: kind (ellipse, box, triangle,
# dome or ring) and paint (main, accent, dark or light), x and y of the middle, half width and half
# height (-100 .. 100, y grows downwards), and a turn in degrees.
_THINGS = """
house: bM 0 35 55 45 0, tA 0 -45 78 38 0, bD 0 55 15 25 0, bL -32 20 12 12 0, bL 32 20 12 12 0
car: bM 0 20 90 25 0, dA 0 -4 55 45 0, bL -18 -12 16 11 0, bL 18 -12 16 11 0, eD -50 48 23 23 0, eD 50 48 23 23 0
tree: bD 0 60 11 38 0, eM 0 -28 62 52 0, eA -25 -10 13 13 0, eA 25 -35 13 13 0, eA 5 -60 13 13 0
fish: eM -12 0 65 40 0, tA 66 0 38 30 -90, tA -5 -38 22 18 0, eL -48 -10 13 13 0, eD -50 -10 6 6 0
flower: bD 0 50 6 48 0, eM 0 -70 24 30 0, eM 0 10 24 30 0, eM -40 -30 30 24 0, eM 40 -30 30 24 0, eA 0 -30 23 23 0
cat: tM -48 -52 26 36 -18, tM 48 -52 26 36 18, eM 0 10 72 66 0, eL -28 -5 15 17 0, eL 28 -5 15 17 0, eD -28 -5 7 13 0, eD 28 -5 7 13 0, tA 0 28 13 10 180
mushroom: bL 0 45 24 45 0, dM 0 5 82 75 0, eA -35 -22 14 12 0, eA 12 -40 14 12 0, eA 42 -14 13 11 0
umbrella: bD 4 30 5 62 0, eD -10 88 18 9 0, dM 0 5 90 80 0, tA 0 -8 24 68 0
boat: bD 0 -15 5 65 0, tM 40 -22 38 52 0, tA -34 -12 26 40 0, eD 0 50 85 20 0, bD 0 42 82 12 0
rocket: tA -38 58 24 36 0, tA 38 58 24 36 0, bM 0 15 28 55 0, tD 0 -65 28 30 0, eL 0 -5 16 16 0, tA 0 86 15 14 180
clock: eD 0 0 84 84 0, eM 0 0 76 76 0, eL 0 0 46 46 0, bD 0 -18 7 24 0, bD 16 0 20 7 0, eA 0 0 12 12 0
butterfly: eM -46 -32 44 40 25, eM 46 -32 44 40 -25, eA -36 42 32 32 -20, eA 36 42 32 32 20, eD 0 0 10 70 0
cup: rA 55 5 38 38 0, bM -8 10 54 62 0, eD -8 -52 54 15 0, bL -8 30 54 9 0
lamp: bD 0 40 6 50 0, eD 0 88 48 12 0, tM 0 -38 78 52 0, eL 0 14 22 9 0
snowman: eM 0 50 52 46 0, eL 0 -22 34 34 0, bA 0 8 40 9 0, bM 0 -82 28 22 0, bD 0 -58 46 6 0, tA 14 -18 8 20 90, eD -12 -30 6 6 0
ice: tA 0 50 42 50 180, eM 0 -8 52 40 0, eM 0 -50 38 30 0, eD 0 -82 13 13 0
balloon: eM 0 -28 66 64 0, bA 0 -28 12 64 0, bD -18 50 2 22 -12, bD 18 50 2 22 12, bA 0 82 25 17 0
key: rM 0 -48 48 48 0, bM 0 38 12 58 0, bA 24 78 22 10 0, bA 20 48 18 10 0
hammer: bM 0 30 13 68 0, bA 0 -48 74 26 0, bD 62 -48 14 34 0
guitar: bD 0 -58 9 42 0, bA 0 -90 18 12 0, eM 0 12 42 36 0, eM 0 56 60 44 0, eD 0 34 17 17 0, bL 0 72 24 6 0
robot: bM 0 45 48 42 0, bA -66 36 12 38 0, bA 66 36 12 38 0, bM 0 -42 56 36 0, eL -24 -45 16 16 0, eL 24 -45 16 16 0, bD 0 -20 30 6 0, bD 0 -88 4 12 0
crown: bM 0 38 80 38 0, tM -58 -20 26 46 0, tM 58 -20 26 46 0, tM 0 -26 28 54 0, eA -40 42 13 13 0, eA 40 42 13 13 0, eL 0 42 15 15 0
bird: eM -5 5 58 46 0, tA 74 -18 32 20 -65, eA 8 16 36 20 -30, eM -48 -42 32 30 0, tD -88 -38 13 17 -90, eL -52 -48 9 9 0, bD -14 66 4 24 0, bD 10 66 4 24 0
star: tM 0 -22 74 66 0, tM 0 26 74 66 180, eA 0 0 38 38 0, eL 0 0 20 20 0
"""  # noqa: E501

_HUES: tuple[tuple[float, float, float], ...] = (
    (0.0, 0.85, 0.85), (0.07, 0.95, 1.0), (0.15, 0.95, 0.98), (0.27, 0.8, 0.75),
    (0.42, 0.9, 0.5), (0.5, 0.75, 0.85), (0.6, 0.9, 0.9), (0.74, 0.7, 0.7), (0.88, 0.65, 0.98),
    (0.07, 0.3, 0.35),
)  # fmt: skip
"""Hue, saturation and value of the main colours."""
_PATTERNS = 5  # plain, striped, chequered, spotted, and two halves
THINGS = tuple(line.partition(":")[0] for line in _THINGS.strip().splitlines())
COUNT = len(THINGS) * len(_HUES) * _PATTERNS * 2
"""How many pictures there are."""


def _shapes() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The shapes of all things, and where each thing's begin, int64 [things + 1].

    A row, of float64 [shapes, 8], has kind and paint, and the x and y of the middle and of the
    half axes, across and downwards.
    """
    rows, starts = [], [0]
    for line in _THINGS.strip().splitlines():
        for text in line.partition(":")[2].split(","):
            kinds, *numbers = text.split()
            x, y, wide, high, degrees = (float(number) / 100 for number in numbers)
            cos, sin = math.cos(math.radians(100 * degrees)), math.sin(math.radians(100 * degrees))
            kind, paint = "ebtdr".index(kinds[0]), "MADL".index(kinds[1])
            rows.append((kind, paint, x, y, wide * cos, wide * sin, -high * sin, high * cos))
        starts.append(len(rows))
    return np.array(rows), np.array(starts)


_SHAPES, _STARTS = _shapes()


class _Plan(NamedTuple):
    """What a picture looks like, whatever its size."""

    shapes: NDArray[np.float64]
    palette: NDArray[np.float64]
    pattern: int
    scene: bool
    turn: float
    """Of the thing, radians."""
    slope: float  # of the pattern, radians
    mirrored: bool


@cache
def _plan(number: int) -> _Plan:
    """Follows from a picture's number; there are few enough to keep all."""
    thing, look = number % len(THINGS), number // len(THINGS)
    hue, look = look % len(_HUES), look // len(_HUES)
    pattern, scene = look % _PATTERNS, look // _PATTERNS
    draws = np.random.default_rng(number).random(11).tolist()
    main = _HUES[hue]
    colours = (
        main,
        (main[0] + (0.4 if draws[0] < 0.5 else 0.55), 0.8, 0.8),  # accent
        (main[0], 0.4, 0.22),  # dark
        (main[0] + 0.5, 0.08, 0.97),  # light
        (main[0] + (1 + int(3 * draws[1])) / 4, 0.75, 0.45 if draws[2] < 0.5 < main[2] else 0.9),
        (draws[3], 0.15 + 0.2 * draws[4], 0.75 + 0.2 * draws[5]),  # sky
        (draws[3] + 0.4, 0.3 + 0.25 * draws[6], 0.5 + 0.25 * draws[7]),  # ground
    )
    palette = np.array([colorsys.hsv_to_rgb(h % 1.0, s, v) for h, s, v in colours]) * 255
    shapes = _SHAPES[_STARTS[thing] : _STARTS[thing + 1]]
    turn, slope = 0.5 * draws[8] - 0.25, math.pi * draws[9]
    return _Plan(shapes, palette, pattern, bool(scene), turn, slope, draws[10] < 0.5)


def draw(number: int, size: int) -> NDArray[np.uint8]:
    """Picture number 0 to `COUNT` - 1, RGBA uint8 [size, size, 4]."""
    picture = np.full((size, size, 4), 255, np.uint8)
    _paint(picture, *_plan(number))
    return picture


@compiled(error_model="numpy")
def _paint(picture, shapes, palette, pattern, scene, turn, slope, mirrored):
    """Paints a picture on white, from what its plan has."""
    size = len(picture)
    cos, sin = math.cos(turn), math.sin(turn)
    across, along = math.cos(slope), math.sin(slope)
    paints = np.full((size, size), -1, np.int8)
    for k in range(len(shapes)):
        _cover(paints, shapes[k], cos / _SMALLER, sin / _SMALLER, mirrored)
    for row in range(size):
        y = (2 * row + 1) / size - 1
        for column in range(size):
            colour = paints[row, column]
            shade = 1.0
            if colour == _MAIN:
                x = (2 * column + 1) / size - 1
                u, v = (x * cos + y * sin) * _SMALLER, (y * cos - x * sin) * _SMALLER
                if mirrored:
                    u = -u
                shade = 1.05 - 0.12 * (u + v)
                if _is_second(pattern, u * across + v * along, v * across - u * along):
                    colour = _SECOND
            elif colour < 0:
                if not scene:
                    continue
                colour = _SKY if y < 0.45 else _GROUND
                shade = 1.0 - 0.15 * y if colour == _SKY else 0.9 + 0.2 * y
            for c in range(3):
                picture[row, column, c] = int(min(palette[colour, c] * shade, 255.0))


@compiled(error_model="numpy")
def _cover(paints, shape, cos, sin, mirrored):
    """Writes a shape's paint to the pixels of a picture that it covers, int8 [size, size]."""
    size = len(paints)
    kind, paint = shape[0], np.int8(shape[1])
    sign = -1.0 if mirrored else 1.0
    # Middle and half axes in the picture, whose coordinates are -1 .. 1 too.
    x, y = sign * shape[2] * cos - shape[3] * sin, sign * shape[2] * sin + shape[3] * cos
    ax, ay = sign * shape[4] * cos - shape[5] * sin, sign * shape[4] * sin + shape[5] * cos
    bx, by = sign * shape[6] * cos - shape[7] * sin, sign * shape[6] * sin + shape[7] * cos
    scale = 1.0 / (ax * by - ay * bx)
    wide, high = abs(ax) + abs(bx), abs(ay) + abs(by)
    half = size / 2
    first_row = max(int((y - high + 1) * half), 0)
    last_row = min(int((y + high + 1) * half), size - 1)
    first = max(int((x - wide + 1) * half), 0)
    last = min(int((x + wide + 1) * half), size - 1)
    for row in range(first_row, last_row + 1):
        down = (row + 0.5) / half - 1 - y
        for column in range(first, last + 1):
            right = (column + 0.5) / half - 1 - x
            s, t = (right * by - down * bx) * scale, (down * ax - right * ay) * scale
            if abs(s) <= 1.0 and abs(t) <= 1.0 and _inside(kind, s, t):
                paints[row, column] = paint


@compiled(error_model="numpy")
def _inside(kind, x, y):
    """Whether a point of the square -1 .. 1 belongs to the shape that fills it."""
    if kind == _BOX:
        return True
    if kind == _TRIANGLE:
        return 2.0 * abs(x) <= 1.0 + y
    far = x * x + y * y
    if kind == _DOME:
        return far <= 1.0 and y <= 0.0
    if kind == _RING:
        return 0.35 <= far <= 1.0
    return far <= 1.0


@compiled(error_model="numpy")
def _is_second(pattern, s, t):
    """Whether a point of the pattern has the second colour."""
    if pattern == 0:
        return False
    if pattern == 1:
        return _along(s, 0.36) < 0.5
    if pattern == 2:
        return (_along(s, 0.5) < 0.5) != (_along(t, 0.5) < 0.5)
    if pattern == 3:
        x, y = _along(s, 0.36) - 0.5, _along(t, 0.36) - 0.5
        return x * x + y * y < 0.1
    return s > 0.0


@compiled(error_model="numpy")
def _along(s, period):
    """How far a point is in its period, 0 .. 1."""
    s /= period
    return s - math.floor(s)
