"""The abstract objects of Zipf's Labyrinth: twelve forms in three patterns of the two colours.

Pattern 0 is painted by the form itself: a band or the ends. Pattern 1 has the accent colour on one
half, pattern 2 on alternate sectors about the form's axis. Lengths are centimetres.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from .shapes import ACCENT, MAIN, Solid, box, circle, ellipsoid, lathe, loft, torus, tube


def sectors(solid: Solid, count: int, *, phase: float = 0.0, axis: str = "z") -> Solid:
    """The solid with its triangles painted in the two colours alternately, by sectors.

    `count` sectors about an axis through the origin, an even number; the first begins at `phase`
    degrees, which should be an angle of the solid's edges.
    """
    first = ("xyz".index(axis) + 1) % 3
    middle = solid.vertices[solid.triangles].mean(axis=1)
    turn = np.degrees(np.arctan2(middle[:, (first + 1) % 3], middle[:, first])) - phase
    odd = np.floor(turn / (360 / count)).astype(int) % 2 == 1
    return Solid(solid.vertices, solid.triangles, np.where(odd, ACCENT, MAIN))


def _turned(profile: list[tuple[float, float]]) -> list[Solid]:
    """A lathe of 12 sides whose stretches 2 and 3 have the accent colour."""
    parts = [ACCENT if i in (2, 3) else MAIN for i in range(len(profile) - 1)]
    return [lathe(profile, parts, sides=12)]


def barbell() -> list[Solid]:
    ball = [(5.4, 2.0), (7.0, 6.0), (5.4, 10.0)]
    upper = [(r, 32 - z) for r, z in ball[::-1]]
    profile = [(0.0, 0.0), *ball, (2.8, 12.0), (2.8, 16.0), (2.8, 20.0), *upper, (0.0, 32.0)]
    parts = [MAIN, MAIN, *[ACCENT] * 6, MAIN, MAIN]
    return [lathe(profile, parts, sides=8)]


def coil() -> list[Solid]:
    angles = np.radians(np.arange(25) * 45.0)
    height = np.arange(25) * 26.0 / 24
    path = np.stack([6.4 * np.cos(angles), 6.4 * np.sin(angles), height], axis=1)
    parts = [ACCENT if 8 <= i < 16 else MAIN for i in range(24)]
    return [tube(path, 2.6, parts, sides=4)]


def cone() -> list[Solid]:
    levels = [(11.5 * (1 - z / 32), float(z)) for z in (0, 10, 16, 22)]
    return _turned([(0.0, 0.0), *levels, (0.0, 32.0)])


def crossbar() -> list[Solid]:
    arms = []
    for axis in ("z", "x", "y"):
        for sign in (-1, 1):
            inner, outer = box(7.6, 7.6, 8, at=(0, 0, sign * 9)), box(9, 9, 4.5, ACCENT)
            pair = [inner, outer.move(z=sign * 13.8)]
            arms += [solid if axis == "z" else solid.turn(axis, 90) for solid in pair]
    return [*arms, box(11, 11, 11)]


def cube() -> list[Solid]:
    square = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]
    rings = [[(16 * x, 16 * y, z) for x, y in square] for z in (0.0, 10.0, 16.0, 22.0, 32.0)]
    parts = [MAIN, MAIN, ACCENT, ACCENT, MAIN, MAIN]
    return [loft([[(0, 0, 0)], *rings, [(0, 0, 32)]], parts)]


def cylinder() -> list[Solid]:
    levels = [(9.0, z) for z in (0.0, 15.0, 24.5, 34.0, 49.0)]
    return _turned([(0.0, 0.0), *levels, (0.0, 49.0)])


def double_prism() -> list[Solid]:
    widths = [(-16.0, 7.5), (-8.0, 4.8), (0.0, 2.8), (8.0, 4.8), (16.0, 7.5)]
    rings = [circle(r * np.sqrt(2), 4, x, start=45)[:, [2, 0, 1]] for x, r in widths]
    ends = [np.array([(x, 0.0, 0.0)]) for x in (-16, 16)]
    return [loft([ends[0], *rings, ends[1]], [MAIN, MAIN, ACCENT, ACCENT, MAIN, MAIN])]


def glow_ball() -> list[Solid]:
    """A ball with fourteen studs."""
    stud = loft([circle(3.6, 4, 8), circle(3.6, 4, 15)], ACCENT)
    ways = [(0, 0), (180, 0), *((90, turn) for turn in (0, 90, 180, 270))]
    ways += [(tilt, turn) for tilt in (54.7, 125.3) for turn in (45, 135, 225, 315)]
    studs = [stud.turn("y", tilt).turn("z", turn) for tilt, turn in ways]
    return [ellipsoid((10.5, 10.5, 10.5), sides=8, rings=3), *studs]


def potcone() -> list[Solid]:
    return _turned(
        [(0.0, 0.0), (8.0, 0.0), (12.0, 7.5), (16.0, 15.0), (11.0, 19.5), (5.0, 25.0), (0.0, 30.0)]
    )


def prism_jack() -> list[Solid]:
    rings = [circle(r, 4, z) for z, r in ((-8.0, 4.4), (0.0, 6.0), (8.0, 4.4))]
    spike = loft([[(0, 0, -16)], *rings, [(0, 0, 16)]], [ACCENT, MAIN, MAIN, ACCENT])
    return [spike, spike.turn("x", 90), spike.turn("y", 90)]


def sphere() -> list[Solid]:
    ball = ellipsoid((15, 15, 16), sides=12, rings=5)
    height = ball.vertices[ball.triangles].mean(axis=1)[:, 2]
    return [replace(ball, parts=np.where(np.abs(height) < 7, ACCENT, MAIN))]


def toroid() -> list[Solid]:
    ring = torus(13.2, 3, around=16, sides=6).turn("y", 90)
    height = ring.vertices[ring.triangles].mean(axis=1)[:, 2]
    return [replace(ring, parts=np.where(np.abs(height) < 6, ACCENT, MAIN))]


def _painted(
    make: Callable[[], list[Solid]],
    half: str | int,
    axis: str,
    count: int,
    phase: float,
    pattern: int,
) -> list[Solid]:
    """A form in one of its patterns.

    `half` is the axis whose lower half has the accent colour in pattern 1, or the number of solids
    that have it, from the first on; `axis`, `count` and
    `phase` are those of pattern 2's sectors.
    """
    solids = make()
    vertices = np.concatenate([solid.vertices for solid in solids])
    x, y, z = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    solids = [solid.move(-x, -y, -z) for solid in solids]
    if pattern == 1 and isinstance(half, int):
        return [
            replace(solid, parts=np.full_like(solid.parts, ACCENT if i < half else MAIN))
            for i, solid in enumerate(solids)
        ]
    if pattern == 1:
        k = "xyz".index(half)
        return [
            replace(s, parts=np.where(s.vertices[s.triangles].mean(axis=1)[:, k] < 0, ACCENT, MAIN))
            for s in solids
        ]
    if pattern == 2:
        return [sectors(solid, count, phase=phase, axis=axis) for solid in solids]
    return solids


FORMS: dict[
    str, tuple[Callable[[], list[Solid]], tuple[int, int, int], str | int, str, int, float]
] = {
    "barbell": (barbell, (14, 14, 32), "z", "z", 4, 22.5),
    "coil": (coil, (18, 18, 33), "z", "z", 4, 0),
    "cone": (cone, (23, 23, 32), "z", "z", 6, 15),
    "crossbar": (crossbar, (31, 31, 32), 4, "z", 4, -50),
    "cube": (cube, (32, 32, 32), "z", "z", 8, 0),
    "cylinder": (cylinder, (18, 18, 49), "z", "z", 6, 15),
    "double_prism": (double_prism, (32, 15, 15), "x", "x", 4, 45),
    "glow_ball": (glow_ball, (30, 30, 32), "z", "z", 4, 22.5),
    "potcone": (potcone, (32, 32, 30), "z", "z", 6, 15),
    "prism_jack": (prism_jack, (32, 32, 32), 1, "z", 4, 10),
    "sphere": (sphere, (30, 30, 32), "z", "z", 6, 15),
    "toroid": (toroid, (6, 32, 34), "z", "x", 8, 0),
}
"""Of each form: its maker, its size, and how patterns 1 and 2 are painted, as `_painted` says."""

OBJECTS = {
    f"{name}_{pattern}": (partial(_painted, make, *paint, pattern), size)
    for name, (make, size, *paint) in FORMS.items()
    for pattern in range(3)
}
"""The makers by name, with the size along x, y and z in hundredths of a metre."""
