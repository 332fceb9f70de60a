"""Closed solids with few triangles, and the function that assembles a mesh from them.

Every primitive takes `part`, the index of its colour: 0 main and 1 accent colour of the instance,
2 dark, 3 light, 4 wood, 5 green; and most take `at`, the position of their own origin. The unit of
length is up to each toy, because `assemble` scales the whole to the toy's size. z is up and a toy
faces +x. Angles are in degrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

MAIN, ACCENT, DARK, LIGHT, WOOD, GREEN = range(6)

Point = tuple[float, float, float]
ORIGIN: Point = (0.0, 0.0, 0.0)


def toy_size(real: float) -> float:
    """The largest dimension of a toy whose model is `real` metres long: half its fourth root.

    A toy is smaller than another where its model is, and no toy is too small to be recognised: real
    lengths from 0.05 m (a dice) to 1.4 m (a piano) become 0.24 to 0.54 m, and 0.24 m are 7 of 96
    pixels, 2 m in front of the agent. Ours: Carvalho et al. 2021 do not give the sizes.
    """
    return 0.5 * real**0.25


@dataclass(frozen=True)
class Solid:
    """A closed surface, counter-clockwise seen from outside.

    vertices float64 [V, 3]; triangles int64 [T, 3]; parts int64 [T]."""

    vertices: np.ndarray
    triangles: np.ndarray
    parts: np.ndarray

    def move(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Solid":
        return replace(self, vertices=self.vertices + (x, y, z))

    def turn(self, axis: str, degrees: float) -> "Solid":
        """Rotates about the x, y or z axis through the origin, right-handed."""
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        rotation = np.eye(3)
        rotation[[j, j, k, k], [j, k, j, k]] = c, -s, s, c
        return replace(self, vertices=self.vertices @ rotation.T)

    def stretch(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> "Solid":
        """Scales along each axis from the origin; factors are positive."""
        return replace(self, vertices=self.vertices * (x, y, z))

    def mirror(self) -> "Solid":
        """The mirror image across the y axis, in the plane through the origin."""
        mirrored = self.vertices * (1.0, -1.0, 1.0)
        return replace(self, vertices=mirrored, triangles=self.triangles[:, ::-1])


@dataclass(frozen=True)
class Mesh:
    """A finished object, in metres.

    vertices float32 [V, 3]; triangles int32 [T, 3]; parts uint8 [T]."""

    vertices: np.ndarray
    triangles: np.ndarray
    parts: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        return self.vertices.max(axis=0) - self.vertices.min(axis=0)


def assemble(solids: Sequence[Solid], real: float | None) -> Mesh:
    """One mesh with its origin at the footprint's centre and its lowest point at z = 0.

    `real` is the largest dimension of the thing that a toy stands for, in metres, and gives the
    toy's by `toy_size`; None keeps the lengths as they are.
    """
    starts = np.cumsum([0] + [len(solid.vertices) for solid in solids])
    vertices = np.concatenate([solid.vertices for solid in solids])
    triangles = np.concatenate(
        [s.triangles + start for s, start in zip(solids, starts, strict=False)]
    )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = vertices - ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    if real is not None:
        vertices *= toy_size(real) / (high - low).max()
    # Sines differ in the last bits between machines; hundredths of a millimetre do not.
    vertices = np.round(vertices, 5) + 0.0
    return Mesh(
        vertices.astype(np.float32),
        triangles.astype(np.int32),
        np.concatenate([solid.parts for solid in solids]).astype(np.uint8),
    )


def _triangulate(ring: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangles of a flat, simple polygon [S, 3], by cutting off its ears."""
    following = np.roll(ring, -1, axis=0)
    normal = np.cross(ring, following).sum(axis=0)
    drop = int(np.abs(normal).argmax())
    flat = ring[:, [(drop + 1) % 3, (drop + 2) % 3]] * (1.0, np.sign(normal[drop]))

    def area(a: int, b: int, c: int) -> float:
        u, v = flat[b] - flat[a], flat[c] - flat[a]
        return float(u[0] * v[1] - u[1] * v[0])

    left = list(range(len(ring)))
    triangles = []
    while len(left) > 3:
        best, cut = -1.0, None
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            if area(a, b, c) <= 1e-12 or any(
                min(area(a, b, p), area(b, c, p), area(c, a, p)) > -1e-12
                for p in left
                if p not in (a, b, c)
            ):
                continue
            # The shortest cut avoids narrow triangles.
            quality = 1.0 / (1.0 + float(np.sum((flat[a] - flat[c]) ** 2)))
            if quality > best:
                best, cut = quality, (i, (a, b, c))
        if cut is None:
            raise ValueError("the polygon crosses itself or repeats a point")
        triangles.append(cut[1])
        del left[cut[0]]
    return [*triangles, (left[0], left[1], left[2])]


def loft(
    rings: Sequence[np.ndarray | Sequence[Point]],
    part: int | Sequence[int] = MAIN,
    *,
    closed: bool = False,
    at: Point = ORIGIN,
) -> Solid:
    """The surface that joins a sequence of polygons, each of S points, or of 1 for a tip.

    The ends are flat polygons and are capped; `closed` joins the last to the first instead. `part`
    may be a sequence with one colour for each gap between rings: a cap has its neighbour's.
    """
    outlines = [np.asarray(ring, dtype=np.float64).reshape(-1, 3) for ring in rings]
    starts = np.cumsum([0] + [len(ring) for ring in outlines])
    gaps = len(outlines) if closed else len(outlines) - 1
    colours = [part] * gaps if isinstance(part, int) else list(part)
    if len(colours) != gaps:
        raise ValueError(f"{len(colours)} parts for {gaps} gaps between rings")
    triangles: list[tuple[int, int, int]] = []
    parts: list[int] = []
    for gap in range(gaps):
        following = (gap + 1) % len(outlines)
        a, b = starts[gap], starts[following]
        first, second = len(outlines[gap]), len(outlines[following])
        for i in range(max(first, second)):
            j = i + 1
            if first > 1:
                triangles.append((a + i, a + j % first, b + i % second))
            if second > 1:
                triangles.append((a + j % first, b + j % second, b + i))
        parts += [colours[gap]] * (len(triangles) - len(parts))
    if not closed:
        for index, colour, order in ((0, colours[0], -1), (-1, colours[-1], 1)):
            if len(outlines[index]) > 1:
                cap = np.array(_triangulate(outlines[index]))[:, ::order]
                triangles += [tuple(corners) for corners in cap + starts[:-1][index]]
                parts += [colour] * len(cap)
    vertices = np.concatenate(outlines)
    indices = np.array(triangles, dtype=np.int64)
    a, b, c = vertices[indices].transpose(1, 0, 2)
    if np.einsum("ti,ti->", a, np.cross(b, c)) < 0:
        indices = indices[:, ::-1]
    return Solid(vertices + at, indices, np.array(parts, dtype=np.int64))


def circle(radius: float, sides: int, z: float = 0.0, *, start: float = 0.0) -> np.ndarray:
    """A ring about the z axis; `start` is its first corner's angle."""
    angles = np.radians(start) + 2 * np.pi * np.arange(sides) / sides
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(sides, z)], axis=1)


def arc(
    radius: float, start: float, end: float, count: int, *, plane: str = "xz", at: Point = ORIGIN
) -> np.ndarray:
    """Points [count, 3] about the origin, turning from the plane's first axis to its second."""
    angles = np.radians(np.linspace(start, end, count))
    points = np.zeros((count, 3))
    points[:, "xyz".index(plane[0])] = radius * np.cos(angles)
    points[:, "xyz".index(plane[1])] = radius * np.sin(angles)
    return points + at


def box(x: float, y: float, z: float, part: int = MAIN, *, at: Point = ORIGIN) -> Solid:
    """A box of those lengths; its own origin is its centre."""
    corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2
    rings = [np.column_stack([corners, np.full(4, height)]) for height in (-z / 2, z / 2)]
    return loft(rings, part, at=at)


def block(
    bottom: tuple[float, float],
    top: tuple[float, float],
    height: float,
    part: int = MAIN,
    *,
    at: Point = ORIGIN,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Solid:
    """A box that tapers from one (x, y) size to another; its own origin is the bottom's centre.

    `shift` displaces the top."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    lower = np.column_stack([corners * bottom, np.zeros(4)])
    upper = np.column_stack([corners * top + shift, np.full(4, height)])
    return loft([lower, upper], part, at=at)


def cylinder(
    radius: float,
    height: float,
    part: int = MAIN,
    *,
    at: Point = ORIGIN,
    sides: int = 10,
    top: float | None = None,
) -> Solid:
    """Along z from its own origin; `top` is the upper radius where it differs, 0 for a cone."""
    top = radius if top is None else top
    return lathe([(radius, 0.0), (top, height)], part, at=at, sides=sides)


def cone(
    radius: float, height: float, part: int = MAIN, *, at: Point = ORIGIN, sides: int = 10
) -> Solid:
    return cylinder(radius, height, part, at=at, sides=sides, top=0.0)


def lathe(
    profile: Sequence[tuple[float, float]],
    part: int | Sequence[int] = MAIN,
    *,
    at: Point = ORIGIN,
    sides: int = 10,
    closed: bool = False,
) -> Solid:
    """A profile of (radius, z) points turned about the z axis.

    An end of radius 0 is a point, another gets a cap; a profile may go up outside and down inside,
    as a cup's does. `closed` joins the profile's last point to its first, as in a ring. `part` may
    have one colour for each stretch of the profile.
    """
    rings = [
        circle(radius, sides, z, start=180 / sides) if radius else np.array([(0.0, 0.0, z)])
        for radius, z in profile
    ]
    return loft(rings, part, closed=closed, at=at)


def ellipsoid(
    radii: Point, part: int = MAIN, *, at: Point = ORIGIN, sides: int = 8, rings: int = 3
) -> Solid:
    """About its own origin, with `rings` parallels between the poles on z."""
    angles = np.pi * np.arange(1, rings + 1) / (rings + 1)
    profile = [(0.0, -1.0), *zip(np.sin(angles), -np.cos(angles), strict=True), (0.0, 1.0)]
    ball = lathe([(float(r), float(z)) for r, z in profile], part, sides=sides)
    return ball.stretch(*radii).move(*at)


def tube(
    path: Sequence[Point] | np.ndarray,
    radius: float | Sequence[float],
    part: int | Sequence[int] = MAIN,
    *,
    sides: int = 6,
    closed: bool = False,
) -> Solid:
    """A round tube along a path [P, 3]; one radius, or one for each point, 0 for a tip.

    `closed` joins the path's end to its start."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))
    if closed:
        along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:
        along = np.gradient(points, axis=0)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.eye(3)[np.abs(along[0]).argmin()]
    rings = []
    for point, direction, r in zip(points, along, radii, strict=True):
        across = across - (across @ direction) * direction
        across = across / np.linalg.norm(across)
        outline = circle(r, sides, start=180 / sides) if r else np.zeros((1, 3))
        frame = np.stack([across, np.cross(direction, across), direction])
        rings.append(point + outline @ frame)
    return loft(rings, part, closed=closed)


def rod(
    start: Point,
    end: Point,
    radius: float,
    part: int = MAIN,
    *,
    sides: int = 6,
    end_radius: float | None = None,
) -> Solid:
    """A straight tube from point to point, tapered to `end_radius` where given, 0 for a tip."""
    return tube(
        [start, end], [radius, radius if end_radius is None else end_radius], part, sides=sides
    )


def torus(
    radius: float,
    thickness: float,
    part: int = MAIN,
    *,
    at: Point = ORIGIN,
    around: int = 12,
    sides: int = 5,
) -> Solid:
    """A ring about the z axis and about its own origin; `thickness` is the tube's radius."""
    return tube(circle(radius, around), thickness, part, sides=sides, closed=True).move(*at)


def slab(
    polygon: Sequence[tuple[float, float]],
    thickness: float,
    part: int = MAIN,
    *,
    plane: str = "xy",
    at: Point = ORIGIN,
) -> Solid:
    """A flat, simple polygon given in a plane (two of "xyz"), thickened to both of its sides."""
    first, second = "xyz".index(plane[0]), "xyz".index(plane[1])
    rings = []
    for offset in (-thickness / 2, thickness / 2):
        ring = np.full((len(polygon), 3), offset)
        ring[:, [first, second]] = polygon
        rings.append(ring)
    return loft(rings, part, at=at)
