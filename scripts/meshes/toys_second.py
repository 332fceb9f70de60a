"""The toys of ranks 26 to 50. Lengths are about centimetres until `assemble` scales them.

At the distances of the task a toy is some ten pixels high, so what tells it from the others is
drawn large: thick tines, few teeth, big rings.
"""

from dataclasses import replace

import numpy as np

from .shapes import (
    ACCENT,
    DARK,
    GREEN,
    LIGHT,
    MAIN,
    WOOD,
    Mesh,
    Solid,
    arc,
    assemble,
    block,
    box,
    circle,
    cone,
    cylinder,
    ellipsoid,
    lathe,
    loft,
    rod,
    slab,
    torus,
    tube,
)


def _star(outer: float, inner: float, points: int, z: float) -> np.ndarray:
    """A star's outline [2 * points, 3] about the z axis."""
    ring = circle(outer, 2 * points, z)
    ring[1::2, :2] *= inner / outer
    return ring


def _oval(x: float, y: float, z: float, sides: int) -> np.ndarray:
    """An ellipse's outline [sides, 3] about the z axis."""
    return circle(1.0, sides, z, start=180 / sides) * (x, y, 1.0)


def _panels(solid: Solid, count: int, parts: tuple[int, int], *, twist: int = 0) -> Solid:
    """Sectors about the z axis, in turn of two colours; `twist` swaps them."""
    middle = solid.vertices[solid.triangles].mean(axis=1)
    sector = np.floor(np.arctan2(middle[:, 1], middle[:, 0]) / (2 * np.pi) * count).astype(int)
    return replace(solid, parts=np.where((sector + twist) % 2 == 0, *parts))


def keyboard() -> Mesh:
    slope = 19.0
    wedge = [(-10.0, 0.0), (10.0, 0.0), (10.0, 3.0), (-10.0, 3.0 + 20 * np.tan(np.radians(slope)))]
    solids = [slab(wedge, 40, plane="xz")]
    keys = [(x, y, 4.8) for x, shift in ((-6.4, 0.0), (0.0, 1.5)) for y in _spread(6, 6.2, shift)]
    keys += [(6.4, -15.0, 6.0), (6.4, 0.0, 20.0), (6.4, 15.0, 6.0)]
    for x, y, width in keys:
        key = box(4.6, width, 2.6, DARK, at=(x, y, 0.8))
        solids.append(key.turn("y", slope).move(z=3 + 10 * np.tan(np.radians(slope))))
    return assemble(solids)


def _spread(count: int, pitch: float, shift: float = 0.0) -> list[float]:
    """Places at a pitch, about `shift`."""
    return [(i - (count - 1) / 2) * pitch + shift for i in range(count)]


def helicopter() -> Mesh:
    blade = box(40, 5, 1.6, ACCENT, at=(5, 0, 27))
    tail = [(-26.0, 17.0), (-20.0, 17.0), (-23.0, 28.0), (-28.0, 28.0)]
    solids = [
        ellipsoid((12, 8, 9), at=(5, 0, 15), sides=8, rings=3),
        ellipsoid((8, 6.5, 6), LIGHT, at=(10.5, 0, 16.5), sides=8, rings=3),
        rod((-2, 0, 17), (-25, 0, 18.5), 3.6, end_radius=1.8, sides=6),
        slab(tail, 2, ACCENT, plane="xz"),
        rod((5, 0, 22), (5, 0, 28.5), 1.6, DARK, sides=4),
        blade.move(-5).turn("z", 45).move(5),
        blade.move(-5).turn("z", -45).move(5),
    ]
    for y in (-7.5, 7.5):
        solids.append(box(24, 2, 2, DARK, at=(4, y, 1)))
        solids += [rod((x, y, 1), (x, y * 0.5, 9), 1.0, DARK, sides=3) for x in (-2, 10)]
    return assemble(solids)


def carriage() -> Mesh:
    bowl = arc(15, 180, 360, 8)[:, [0, 2]]
    hood = np.concatenate([[(0.0, 0.0)], arc(17, 80, 180, 6)[:, [0, 2]]])

    def bulge(polygon: np.ndarray, widths: tuple[float, ...], insets: tuple[float, ...], part: int):
        rings = [
            np.column_stack([polygon[:, 0] * f, np.full(len(polygon), y), polygon[:, 1] * f])
            for y, f in zip(widths, insets, strict=True)
        ]
        return loft(rings, part, at=(0, 0, 23))

    solids = [
        bulge(bowl, (-11, -9, 9, 11), (0.8, 1, 1, 0.8), MAIN),
        bulge(hood, (-12, -10, 10, 12), (0.8, 1, 1, 0.8), ACCENT),
        box(15, 17, 3, LIGHT, at=(6, 0, 23)),
    ]
    for y in (-7.5, 7.5):
        solids.append(rod((13, y, 20), (24, y, 33), 1.1, DARK, sides=3))
    solids.append(rod((24, -9, 33), (24, 9, 33), 1.4, DARK, sides=4))
    for x in (-10, 10):
        for y in (-12, 12):
            wheel = cylinder(8, 3, DARK, sides=8).move(z=-1.5).turn("x", 90)
            solids.append(wheel.move(x, y, 8))
        solids.append(cylinder(4, 28.6, LIGHT, sides=5).move(z=-14.3).turn("x", 90).move(x, 0, 8))
    return assemble(solids)


def racket() -> Mesh:
    loop = circle(1.0, 14)[:, [2, 0, 1]] * (0, 11.5, 13.5) + (0, 0, 26)
    solids = [
        tube(loop, 2.4, sides=4, closed=True),
        rod((0, -7, 16), (0, 0, 7), 1.8, sides=4),
        rod((0, 7, 16), (0, 0, 7), 1.8, sides=4),
        rod((0, 0, -10), (0, 0, 9), 2.6, ACCENT, sides=6),
        cylinder(3.4, 3, DARK, at=(0, 0, -12), sides=6),
    ]
    for offset in (-5.5, 0, 5.5):
        reach = float(np.sqrt(1 - (offset / 12.5) ** 2))
        y, z = 11.5 * reach, 13.5 * reach
        solids.append(rod((0, offset, 26 - z), (0, offset, 26 + z), 0.8, LIGHT, sides=3))
        solids.append(rod((0, -y, 26 + offset), (0, y, 26 + offset), 0.8, LIGHT, sides=3))
    return assemble(solids)


def pillow() -> Mesh:
    steps = np.linspace(-1, 1, 7)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    # The sides curve inwards between the corners, as a cushion's do.
    x = 15 * u * (1 - 0.16 * (1 - v**2) * np.abs(u))
    y = 20 * v * (1 - 0.16 * (1 - u**2) * np.abs(v))
    height = 8 * ((1 - u**2) * (1 - v**2)) ** 0.4
    index = np.arange(49).reshape(7, 7)
    a, b, c, d = (index[i : i + 6, j : j + 6] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    # Diagonals run towards the corners: no triangle has its three points on the border.
    across = np.outer(steps[:-1] + 0.1, steps[:-1] + 0.1)
    first = np.where(across > 0, [a, b, c], [a, b, d]).reshape(3, -1)
    second = np.where(across > 0, [a, c, d], [b, c, d]).reshape(3, -1)
    upper = np.concatenate([first, second], axis=1).T
    # Both sides share the border, where the height is zero.
    lower = np.where(height > 0, np.arange(49) + 49, np.arange(49))[upper[:, ::-1]]
    vertices = np.concatenate([np.stack([x, y, sign * height], 1) for sign in (1, -1)])
    used, triangles = np.unique(np.concatenate([upper, lower]), return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    return assemble([Solid(vertices[used], triangles, np.full(len(triangles), MAIN))])


def candle() -> Mesh:
    solids = [
        lathe([(9, 0), (13, 3), (12, 4), (8, 1.6), (0, 1.6)], ACCENT, sides=10),
        torus(4.0, 1.3, ACCENT, around=8, sides=4).turn("x", 90).move(0, 0, 0),
        cylinder(5.5, 22, at=(0, 0, 1), sides=8),
        rod((0, 0, 22), (0, 0, 26), 0.8, DARK, sides=4),
        lathe([(0, 25), (3.2, 29), (2.2, 33), (0, 39)], LIGHT, sides=6),
    ]
    solids[1] = solids[1].move(0, 0, 4).move(14.5)
    return assemble(solids)


def teapot() -> Mesh:
    body = [(6, 0), (11, 4), (13, 10), (11, 17), (6, 20)]
    spout = [(9.0, 0.0, 7.0), (15.0, 0.0, 10.0), (18.0, 0.0, 17.0), (22.0, 0.0, 21.0)]
    handle = arc(7, 110, 250, 7, at=(-13, 0, 11))
    return assemble(
        [
            lathe(body, sides=10),
            lathe([(7, 19), (6.5, 21), (0, 23)], ACCENT, sides=10),
            ellipsoid((2.6, 2.6, 2.6), ACCENT, at=(0, 0, 24.5), sides=6, rings=2),
            tube(spout, [4.2, 3.0, 2.2, 2.2], sides=6),
            tube(handle, 1.7, ACCENT, sides=5),
        ]
    )


def banana() -> Mesh:
    path = arc(15, -80, 80, 9, plane="xy")
    path = np.concatenate([path, path[-1:] + (-4.5, 2.5, 0)])
    radii = [1.6, 2.6, 4.6, 5.8, 6.2, 5.8, 4.6, 2.6, 1.7, 2.0]
    return assemble([tube(path, radii, [DARK, *[MAIN] * 6, DARK, DARK], sides=6)])


def apple() -> Mesh:
    flesh = [(0, 3), (4, 0), (8, 2), (14, 11), (16, 20), (13, 27), (7, 29), (0, 24)]
    leaf = [(0.0, 0.0), (5.0, -3.0), (12.0, 0.0), (5.0, 3.0)]
    return assemble(
        [
            lathe(flesh, sides=10),
            rod((0, 0, 24), (-2, 0, 36), 1.4, WOOD, sides=5, end_radius=1.8),
            slab(leaf, 1.6, GREEN).turn("y", -20).move(-1, 0, 32),
        ]
    )


def carrot() -> Mesh:
    root = [(1.5, 0), (4, 6), (3.4, 7), (6.5, 14), (5.8, 15), (9, 24), (7, 28), (0, 29)]
    solids = [lathe(root, sides=10)]
    for angle in (0, 72, 144, 216, 288):
        leaf = slab([(0, -1.5), (9, -3.5), (15, 0), (9, 3.5), (0, 1.5)], 2.4, GREEN)
        solids.append(leaf.turn("y", -55).turn("z", angle).move(z=27))
    return assemble(solids)


def mushroom() -> Mesh:
    cap = [(4, 17), (17, 15), (19, 19), (16, 27), (9, 33), (0, 35)]
    solids = [
        lathe([(8, 0), (6, 3), (5, 10), (5.5, 18)], LIGHT, sides=8),
        lathe(cap, sides=12),
    ]
    for angle, z, r, tilt in ((30, 25, 16.5, 55), (150, 25, 16.5, 55), (270, 25, 16.5, 55)):
        spot = cylinder(4, 2, LIGHT, sides=6, top=3)
        solids.append(spot.turn("y", tilt).move(r - 0.6, 0, z - 0.6).turn("z", angle))
    for angle in (90, 210, 330):
        spot = cylinder(3, 2, LIGHT, sides=6, top=2)
        solids.append(spot.turn("y", 30).move(9, 0, 31.5).turn("z", angle))
    return assemble(solids)


def toothbrush() -> Mesh:
    shaft = [(0, 0, 0), (0, 0, 12), (0, 0, 20), (0, 0, 24), (0, 0, 40)]
    solids = [
        tube(np.array(shaft, dtype=float), [3.4, 3.8, 2.2, 2.8, 3.4], sides=6),
        box(4, 7, 17, at=(0, 0, 31.5)),
        lathe([(4.0, 4), (4.4, 6), (4.4, 12), (4.0, 14)], ACCENT, sides=6),
    ]
    for z in (25.5, 31.5, 37.5):
        solids.append(block((4.4, 6), (5.2, 7), 8, LIGHT).turn("y", 90).move(1.8, 0, z))
    return assemble(solids)


def toothpaste() -> Mesh:
    body = [
        _oval(7.5, 7.5, 7, 10),
        _oval(7.0, 9.0, 16, 10),
        _oval(6.0, 10.5, 22, 10),
        _oval(2.6, 13.0, 36, 10),
        _oval(2.0, 13.4, 40, 10),
    ]
    return assemble(
        [
            cylinder(5.5, 6.5, LIGHT, sides=8, top=5),
            cylinder(3.5, 3, DARK, at=(0, 0, 5), sides=6),
            loft(body, [MAIN, ACCENT, MAIN, LIGHT]),
        ]
    )


def comb() -> Mesh:
    spine = [(-20.0, 14.0), (20.0, 14.0), (20.0, 21.0), (12.0, 24.5), (-12.0, 24.5), (-20.0, 21.0)]
    solids = [slab(spine, 6, plane="yz")]
    solids += [block((3.6, 2.4), (6, 3.6), 15, at=(0, y, 0)) for y in _spread(6, 7.3)]
    return assemble(solids)


def hairdryer() -> Mesh:
    barrel = [(0, -13), (6, -12), (9.5, -7), (10, 0), (7, 10), (7, 12), (9, 20), (7, 20), (5, 14)]
    grip = [(-5.0, 0.0), (5.0, 0.0), (3.5, 26.0), (-6.5, 26.0)]
    return assemble(
        [
            lathe([*barrel, (0, 14)], [*[MAIN] * 4, *[ACCENT] * 3, DARK, DARK], sides=10)
            .turn("y", 90)
            .move(0, 0, 29),
            slab(grip, 7, plane="xz"),
            box(3, 3, 8, DARK, at=(5, 0, 16)),
        ]
    )


def fork() -> Mesh:
    head = [(-3, 18), (3, 18), (10, 23), (10, 28), (-10, 28), (-10, 23)]
    solids = [
        slab(head, 5, plane="yz"),
        rod((0, 0, 4), (0, 0, 20), 2.6, sides=6),
        ellipsoid((3, 4.5, 7), at=(0, 0, 6), sides=8, rings=3),
    ]
    solids += [block((5, 4), (4, 2.6), 16, at=(0, y, 26)) for y in (-8, 0, 8)]
    return assemble(solids)


def hammer() -> Mesh:
    claw = [(-4, 27), (-4, 38), (-9, 38), (-19, 31), (-20, 28), (-10, 30)]
    solids = [
        lathe([(3.6, 0), (3.2, 4), (2.6, 20), (3.0, 38)], WOOD, sides=8),
        box(9, 9, 11, at=(0, 0, 32.5)),
        cylinder(4.5, 6, sides=10).turn("x", -90).move(0, 3, 32.5),
        lathe([(5, 0), (7.5, 2), (7.5, 7), (6.5, 8)], ACCENT, sides=10)
        .turn("x", -90)
        .move(0, 8, 32.5),
    ]
    solids += [slab(claw, 3.4, plane="yz", at=(x, 0, 0)) for x in (-2.8, 2.8)]
    return assemble(solids)


def screwdriver() -> Mesh:
    grip = [_star(r, 0.75 * r, 6, z) for r, z in ((6, 0), (8, 2.5), (8, 15), (4.5, 17))]
    tip = [
        _oval(2.4, 2.4, 33, 8),
        _oval(1.8, 5.0, 37, 8),
        _oval(1.0, 5.0, 41, 8),
    ]
    return assemble(
        [
            loft(grip, [MAIN, MAIN, ACCENT]),
            cylinder(2.4, 18, LIGHT, at=(0, 0, 16), sides=6),
            loft(tip, LIGHT),
        ]
    )


def key() -> Mesh:
    ring = torus(8, 3, around=12, sides=5).turn("y", 90)
    return assemble(
        [
            ring.move(0, 0, 30),
            cylinder(2.8, 22, at=(0, 0, 0), sides=8),
            cylinder(4, 3, ACCENT, at=(0, 0, 17), sides=8),
            box(5, 10, 4.5, at=(0, 6, 3)),
            box(5, 8, 4.5, at=(0, 5, 11)),
        ]
    )


def scissors() -> Mesh:
    solids = []
    for side in (-1, 1):
        blade = slab(
            [(-2.4, -2), (2.4, -2), (2.6, 10), (0, 26), (-1.6, 12)], 2.8, LIGHT, plane="yz"
        )
        arm = rod((0, 0, 2), (0, 0, -8), 1.8, sides=4)
        ring = torus(4.6, 1.7, around=10, sides=4).turn("y", 90).move(0, -1.5, -12.5)
        for solid in (blade, arm, ring):
            if side < 0:
                solid = solid.mirror("y")
            solids.append(solid.turn("x", side * 24).move(side * 1.4))
    solids.append(cylinder(2.4, 7, DARK, sides=6).move(z=-3.5).turn("y", 90))
    return assemble(solids)


def umbrella() -> Mesh:
    rim = circle(20, 16, 22)
    rim[1::2] = rim[1::2] * (0.88, 0.88, 1) + (0, 0, 2.5)
    inner = rim * (0.92, 0.92, 1)
    canopy = loft(
        [np.array([[0, 0, 35.0]]), circle(10, 16, 32), rim, inner, np.array([[0, 0, 32.0]])]
    )
    hook = np.concatenate(
        [[(0.0, 0.0, 33.0), (0.0, 0.0, 12.0)], arc(4.5, 180, 360, 7, plane="yz", at=(0, 4.5, 4.5))]
    )
    hook[:2, 1] = 0
    return assemble(
        [
            _panels(canopy.turn("z", 0), 8, (MAIN, ACCENT)),
            tube(hook, 1.4, DARK, sides=4),
            cone(1.4, 6, DARK, at=(0, 0, 34.5), sides=4),
        ]
    )


def basket() -> Mesh:
    outside = [(11, 0), (13, 5), (14.5, 10), (16, 15)]
    hold = lathe([*outside, (14, 15), (10, 3), (0, 3)], sides=12)
    middle = hold.vertices[hold.triangles].mean(axis=1)
    hold = _panels(hold, 12, (MAIN, ACCENT))
    odd = (middle[:, 2] > 5) & (middle[:, 2] < 10)
    hold = replace(hold, parts=np.where(odd, 1 - hold.parts, hold.parts))
    inside = np.hypot(middle[:, 0], middle[:, 1]) < 0.93 * (11 + middle[:, 2] / 3)
    hold = replace(hold, parts=np.where(inside & (middle[:, 2] > 1), DARK, hold.parts))
    handle = arc(15, 0, 180, 9, plane="yz", at=(0, 0, 14)) * (1, 1, 1.15)
    return assemble([hold, tube(handle, 2, WOOD, sides=5), torus(15.5, 1.6, WOOD, at=(0, 0, 15))])


def cactus() -> Mesh:
    trunk = [_star(r, 0.75 * r, 6, z) for r, z in ((5.5, 8), (6, 20), (5.5, 36), (3, 40))]
    left = np.array([(0, -3, 20), (0, -12, 20), (0, -13.5, 22), (0, -13.5, 32), (0, -13.5, 34)])
    right = np.array([(0, 3, 15), (0, 11, 15), (0, 12.5, 17), (0, 12.5, 25), (0, 12.5, 27)])
    radii = [3, 3.2, 3.4, 3.2, 1.5]
    return assemble(
        [
            lathe([(7, 0), (9, 9), (10.5, 9), (10.5, 12), (8, 12), (0, 11)], sides=8),
            loft(trunk, GREEN),
            tube(left.astype(float), radii, GREEN, sides=6),
            tube(right.astype(float), radii, GREEN, sides=6),
        ]
    )


def dice() -> Mesh:
    pips = {
        1: [(0, 0)],
        2: [(-1, -1), (1, 1)],
        3: [(-1, -1), (0, 0), (1, 1)],
        4: [(-1, -1), (1, -1), (-1, 1), (1, 1)],
        5: [(-1, -1), (1, -1), (0, 0), (-1, 1), (1, 1)],
        6: [(-1, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (1, 1)],
    }
    # Each pair of opposite faces has seven pips.
    turns = {1: ("y", 0), 6: ("y", 180), 2: ("y", 90), 5: ("y", -90), 3: ("x", 90), 4: ("x", -90)}
    solids = [_chamfered_cube(20, 4)]
    for face, (axis, degrees) in turns.items():
        for x, y in pips[face]:
            pip = cone(3.9, 1.0, DARK, sides=5).move(9.5 * x, 9.5 * y, 19.9)
            solids.append(pip.turn(axis, degrees))
    return assemble(solids)


def _chamfered_cube(half: float, cut: float) -> Solid:
    """A cube about the origin with its edges and corners cut off."""
    flat = half - cut
    rings = []
    for z, far, near in (
        (-half, flat, 0.85 * flat),
        (-flat, half, flat),
        (flat, half, flat),
        (half, flat, 0.85 * flat),
    ):
        quarter = [(far, -near), (far, near), (near, far), (-near, far)]
        rings.append([(i * x, i * y, z) for i in (1, -1) for x, y in quarter])
    return loft(rings)


def pyramid() -> Mesh:
    solids = []
    for level in range(6):
        low, high = 40 - 6.4 * level, 38 - 6.4 * level
        solids.append(block((low, low), (high, high), 5, MAIN, at=(0, 0, 5 * level)))
    solids.append(cone(2.5, 4, ACCENT, at=(0, 0, 30), sides=4))
    solids.append(box(8, 8, 10, DARK, at=(16.5, 0, 5)))
    return assemble(solids)


TOYS = {
    toy.__name__: toy
    for toy in (
        keyboard,
        helicopter,
        carriage,
        racket,
        pillow,
        candle,
        teapot,
        banana,
        apple,
        carrot,
        mushroom,
        toothbrush,
        toothpaste,
        comb,
        hairdryer,
        fork,
        hammer,
        screwdriver,
        key,
        scissors,
        umbrella,
        basket,
        cactus,
        dice,
        pyramid,
    )
}
