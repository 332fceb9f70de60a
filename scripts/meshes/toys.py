"""The toys, from the most frequent on. Lengths are about centimetres until `assemble` scales them.

At the distances of the task a toy is about ten pixels high, so the features that distinguish it
are exaggerated: thick tines, few teeth, big rings.
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
    Point,
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


def both_sides(*solids: Solid) -> list[Solid]:
    """Each solid and its mirror image across the toy's middle, y = 0."""
    return [*solids, *(solid.mirror() for solid in solids)]


def wheels(radius: float, width: float, x: float) -> Solid:
    """A pair of tyres on z = 0 in one piece, through the toy from side to side."""
    return cylinder(radius, width, DARK, sides=8).turn("x", 90).move(x, width / 2, radius)


def duck() -> Mesh:
    def rump(x: float, width: float, low: float, high: float) -> list[Point]:
        outline = ((0, 0.5), (0.35, 0.9), (0.5, 0.7), (0.45, 0.25), (0.2, 0))
        half = [(x, y * width, low + z * (high - low)) for y, z in outline]
        return half + [(x, -y, z) for _, y, z in half[:0:-1]]

    return assemble(
        [
            loft(
                [
                    [(-21, 0, 25)],
                    rump(-17, 9, 14, 22),
                    rump(-9, 21, 3, 17),
                    rump(4, 25, 0, 18),
                    rump(13, 17, 2, 20),
                    [(18, 0, 10)],
                ]
            ),
            ellipsoid((9, 8.5, 9), at=(8, 0, 26), sides=9, rings=3),
            block((8, 12), (7, 9), 3, ACCENT, at=(18, 0, 22)),
            *both_sides(
                ellipsoid((9, 3, 6), ACCENT, at=(-4, 11, 11), sides=6, rings=2),
                box(3, 2, 3.4, DARK, at=(12, 6.8, 29)),
            ),
        ],
        0.10,
    )


def ball() -> Mesh:
    whole = ellipsoid((1, 1, 1), sides=12, rings=7)
    middle = whole.vertices[whole.triangles].mean(axis=1)
    sector = (np.degrees(np.arctan2(middle[:, 1], middle[:, 0])) - 15) // 60
    stripes = np.array([MAIN, LIGHT, ACCENT, LIGHT, MAIN, LIGHT])
    return assemble([replace(whole, parts=stripes[sector.astype(int) % 6])], 0.22)


def book() -> Mesh:
    leaf = [
        box(1.6, 24, 34, MAIN, at=(0, 12, 17)),
        loft(
            [
                [(0.8, 0, z), (5, 1.5, z), (4.5, 12, z), (2.5, 22.5, z), (0.8, 22.5, z)]
                for z in (1.5, 32.5)
            ],
            LIGHT,
        ),
        *(box(1, 13, 1.6, DARK, at=(4.2, 12, z)).turn("z", 4) for z in (9, 14, 19, 24)),
    ]
    opened = [solid.turn("z", -28) for solid in leaf]
    return assemble([*both_sides(*opened), cylinder(2.2, 34.6, ACCENT, sides=6)], 0.25)


def cup() -> Mesh:
    bowl_shape = [(0, 3), (5, 3), (9, 8), (13, 20), (11.6, 20), (8, 9), (0, 7)]
    saucer = [(0, 0), (8, 0), (17, 3), (17, 4.4), (8, 2), (0, 2)]
    handle = tube(
        [(10, 0, 16), (17, 0, 19), (21, 0, 15), (17, 0, 10), (9, 0, 8)], 1.5, ACCENT, sides=4
    )
    return assemble(
        [
            lathe(bowl_shape, [MAIN] * 4 + [DARK] * 2, sides=12),
            lathe(saucer, ACCENT, sides=12),
            handle.turn("z", 90),
        ],
        0.14,
    )


def car() -> Mesh:
    side = [(-20, 4), (20, 4), (20, 10), (18, 12.5), (10, 13.5), (-19, 13.5), (-20, 11)]
    return assemble(
        [
            slab(side, 19, MAIN, plane="xz"),
            block((25, 18), (14, 15), 8, LIGHT, at=(-4, 0, 13.5), shift=(-1, 0)),
            block((15, 16), (13, 14), 1.8, MAIN, at=(-5, 0, 21.5)),
            block((3, 18.6), (2.5, 15.8), 8.6, MAIN, at=(-5, 0, 13.5)),
            box(2.4, 20, 2.5, ACCENT, at=(20, 0, 6)),
            box(2.4, 20, 2.5, ACCENT, at=(-20, 0, 6)),
            wheels(5.4, 21, -11.5),
            wheels(5.4, 21, 12),
            *both_sides(
                box(1.5, 4, 3, LIGHT, at=(20, 6.5, 10)),
                box(1.5, 3, 2, ACCENT, at=(-20, 7, 10.5)),
            ),
        ],
        0.25,
    )


def train() -> Mesh:
    return assemble(
        [
            box(39, 13, 3, ACCENT, at=(-2, 0, 7)),
            cylinder(6.6, 24, MAIN, sides=10).turn("y", 90).move(-8, 0, 14),
            cylinder(7.2, 3, DARK, sides=10).turn("y", 90).move(14, 0, 14),
            loft([[(17, -8, 1), (17, 8, 1), (17, 8, 8), (17, -8, 8)], [(24, 0, 1)]], ACCENT),
            cylinder(2.4, 10, DARK, at=(10, 0, 19), sides=7, top=5),
            cylinder(3, 4, ACCENT, at=(1, 0, 19.5), sides=6, top=2),
            box(12, 15, 18, MAIN, at=(-14, 0, 16)),
            box(16, 18, 2.4, ACCENT, at=(-14, 0, 26)),
            box(7, 15.8, 6, LIGHT, at=(-14, 0, 20.5)),
            wheels(5.5, 18, -14),
            wheels(4, 18, -1),
            wheels(4, 18, 9),
        ],
        0.30,
    )


def boat() -> Mesh:
    def deck(length: float, width: float, z: float) -> list[Point]:
        outline = [(-0.5, -0.35), (-0.1, -0.5), (0.25, -0.35), (0.55, 0), (0.25, 0.35), (-0.1, 0.5)]
        return [(x * length, y * width, z) for x, y in [*outline, (-0.5, 0.35)]]

    hull = [deck(22, 9, 0), deck(32, 18, 10), deck(29, 15, 10), deck(27, 13, 7)]
    return assemble(
        [
            loft(hull, [MAIN, WOOD, WOOD]),
            rod((1, 0, 4), (1, 0, 41), 1.2, WOOD, sides=5),
            slab([(0, 13), (0, 39), (-16, 13)], 2, LIGHT, plane="xz"),
            slab([(3, 13), (15, 13), (3, 34)], 2, ACCENT, plane="xz"),
            rod((1, 0, 11), (-15, 0, 11), 0.8, WOOD, sides=4),
        ],
        0.35,
    )


def robot() -> Mesh:
    arm = [(0, 8, 21), (1, 13.5, 19), (3, 14.5, 12)]
    return assemble(
        [
            block((11, 16), (13, 20), 14, MAIN, at=(0, 0, 10)),
            box(1.4, 12, 8, ACCENT, at=(6.2, 0, 17.5)),
            box(6, 7, 4, DARK, at=(0, 0, 25)),
            box(15, 20, 15, MAIN, at=(0, 0, 33.5)),
            box(1.6, 17, 8.6, DARK, at=(7.5, 0, 34.4)),
            rod((0, 0, 40), (0, 0, 46), 1.2, DARK, sides=4),
            ellipsoid((3.2, 3.2, 3.2), ACCENT, at=(0, 0, 47), sides=5, rings=2),
            *both_sides(
                box(2, 5.4, 5.4, LIGHT, at=(8.1, 4.4, 34.4)),
                tube(arm, 2.6, DARK, sides=5),
                box(6.6, 6.6, 5, ACCENT, at=(4, 14.6, 11)),
                box(5, 5.4, 8, DARK, at=(0, 5.4, 8)),
                block((14, 8.6), (8, 7.6), 5, ACCENT, at=(1.5, 5.6, 0)),
            ),
        ],
        0.30,
    )


def teddy() -> Mesh:
    def limb(x: float, y: float, z: float) -> Solid:
        return ellipsoid((x, y, z), sides=5, rings=2)

    def bead(radius: float, x: float, y: float, z: float) -> Solid:
        return ellipsoid((radius, radius, radius), DARK, at=(x, y, z), sides=4, rings=1)

    return assemble(
        [
            ellipsoid((8.5, 9.5, 10), at=(0, 0, 10), sides=7),
            ellipsoid((4, 6, 6.5), ACCENT, at=(5.5, 0, 10), sides=5, rings=2),
            ellipsoid((9, 11, 9), at=(0.5, 0, 25), sides=7),
            ellipsoid((5, 5, 4), LIGHT, at=(7.5, 0, 22.5), sides=4, rings=2),
            bead(1.8, 12, 0, 24),
            *both_sides(
                cylinder(5, 3.4, MAIN, sides=5).turn("y", 90).move(-1.5, 9.5, 32.5),
                limb(7, 4, 3.6).turn("y", 25).turn("z", 35).move(5, 10, 14),
                limb(9, 4.4, 4.4).turn("z", 22).move(10, 8.5, 4),
                bead(1.9, 8.4, 4.2, 27.6),
            ),
        ],
        0.35,
    )


def rocket() -> Mesh:
    body = [(0, 5), (4, 5), (6.6, 12), (7, 19), (6, 27), (3.6, 34), (0, 40)]
    fin = slab([(4, 20), (15, 8), (15, 0), (12, 0), (4, 8)], 2.4, ACCENT, plane="xz")
    return assemble(
        [
            lathe(body, [MAIN] * 4 + [ACCENT] * 2, sides=9),
            cylinder(5, 4, DARK, at=(0, 0, 2), sides=9, top=3),
            *(fin.turn("z", angle) for angle in (45, 135, 225, 315)),
            *(
                cylinder(3.4, 3, LIGHT, sides=8).turn("y", side * 90).move(side * 4.6, 0, 22)
                for side in (-1, 1)
            ),
        ],
        0.40,
    )


def bus() -> Mesh:
    windows = [box(5.4, 15.8, 6, LIGHT, at=(x, 0, 17)) for x in (-15, -8, -1, 6, 13)]
    return assemble(
        [
            box(40, 15, 20, MAIN, at=(0, 0, 13)),
            block((38, 13), (36, 11), 2, ACCENT, at=(0, 0, 23)),
            *windows,
            box(40.8, 15.6, 2.6, ACCENT, at=(0, 0, 10)),
            box(1.6, 12, 7.5, LIGHT, at=(19.8, 0, 17)),
            box(1.6, 11, 5, LIGHT, at=(-19.8, 0, 17.5)),
            wheels(4, 16.4, -12),
            wheels(4, 16.4, 12),
            *both_sides(box(1.6, 3, 2.4, LIGHT, at=(20, 5, 6))),
        ],
        0.30,
    )


def plane() -> Mesh:
    def section(x: float, radius: float, z: float) -> np.ndarray:
        return circle(radius, 8, start=22.5)[:, [2, 0, 1]] + (x, 0, z)

    fuselage = [
        np.array([(20, 0, 9)]), section(17, 3, 9.4), section(9, 4.8, 10), section(-5, 4.8, 10.5),
        section(-19, 1.6, 13),
    ]  # fmt: skip
    return assemble(
        [
            loft(fuselage),
            slab([(-10, 12), (-18, 24), (-22, 24), (-19, 11)], 2, ACCENT, plane="xz"),
            block((7, 6), (4, 4), 3, LIGHT, at=(10, 0, 13)),
            *both_sides(
                slab([(8, 2), (1, 20), (-5, 20), (-5, 2)], 2, ACCENT, at=(0, 0, 9)),
                slab([(-12, 1), (-17, 9), (-21, 9), (-20, 1)], 1.8, ACCENT, at=(0, 0, 13.5)),
                cylinder(2.2, 8, DARK, sides=6).turn("y", 90).move(-1, 10, 6.5),
            ),
            box(1.6, 4, 6, DARK, at=(1, 0, 4)),
            wheels(2, 8, 1),
            box(1.6, 1.6, 6, DARK, at=(14, 0, 4)),
            wheels(2, 2.5, 14),
        ],
        0.35,
    )


def mug() -> Mesh:
    wall = [(0, 0), (9.4, 0), (10, 1), (10, 18), (8.6, 18), (8.4, 15), (0, 15)]
    handle = tube(arc(6.2, -95, 95, 7, plane="yz", at=(0, 9.4, 9.2)), 2.1, ACCENT, sides=5)
    return assemble(
        [lathe(wall, [MAIN, MAIN, MAIN, LIGHT, LIGHT, WOOD], sides=14), handle],
        0.12,
    )


def spoon() -> Mesh:
    def across(z: float, width: float, depth: float) -> list[Point]:
        half = [(0.8 - depth, 0.3 * width, z), (1.2, 0.8 * width, z), (1.2, width, z)]
        half += [(-0.5 * depth - 0.6, 0.7 * width, z), (-depth - 1, 0.25 * width, z)]
        return half + [(x, -y, z) for x, y, z in half[::-1]]

    scoop = [(20.5, 2, 0.6), (23.5, 8, 3.6), (29.5, 10.2, 6.6), (36, 8.4, 5), (40, 3, 0.6)]
    handle = [
        (0, 3.6, 4.4, 0), (1, 4.6, 5.6, 0), (6, 3, 4.4, 0), (14, 1.7, 3.2, -1.6), (22, 2.2, 3, 0.3),
    ]  # fmt: skip
    return assemble(
        [
            loft([across(*section) for section in scoop]),
            loft(
                [
                    [
                        (x + sx * depth / 2, sy * width, z)
                        for sx, sy in ((-1, -0.6), (0, -1), (1, -0.6), (1, 0.6), (0, 1), (-1, 0.6))
                    ]
                    for z, width, depth, x in handle
                ],
                ACCENT,
            ),
        ],
        0.18,
    )


def bowl() -> Mesh:
    wall = [
        (0, 0), (8, 0), (7, 2.5), (14, 7), (19, 16), (20, 19),
        (18, 19), (12.5, 8.5), (0, 5),
    ]  # fmt: skip
    return assemble(
        [lathe(wall, [ACCENT] * 2 + [MAIN] * 3 + [ACCENT] + [LIGHT] * 2, sides=14)], 0.16
    )


def plate() -> Mesh:
    wall = [(0, 0), (11, 0), (20, 3.6), (20, 4.6), (12, 2), (0, 2)]
    return assemble([lathe(wall, [MAIN, MAIN, ACCENT, ACCENT, LIGHT], sides=18)], 0.26)


def bottle() -> Mesh:
    profile = [(0, 0), (8, 0), (8.6, 1.5), (8.6, 19), (7, 23), (3, 27), (2.8, 35), (0, 35)]
    return assemble(
        [
            lathe(profile, sides=11),
            cylinder(8.8, 9, LIGHT, at=(0, 0, 6), sides=11),
            cylinder(3.8, 6, ACCENT, at=(0, 0, 34), sides=8),
        ],
        0.28,
    )


def chair() -> Mesh:
    return assemble(
        [
            box(25, 25, 4, ACCENT, at=(0, 0, 19)),
            box(3, 24.6, 10, ACCENT, at=(-11, 0, 41)),
            box(3, 22, 4, MAIN, at=(-11, 0, 29)),
            *both_sides(
                box(4, 4, 47, MAIN, at=(-10.6, 10.6, 23.5)),
                box(4, 4, 18, MAIN, at=(10.6, 10.6, 9)),
            ),
            box(2.4, 22, 2.4, MAIN, at=(10.6, 0, 8)),
        ],
        0.90,
    )


def lamp() -> Mesh:
    shade = [(16, 21), (15.2, 23.5), (6, 40), (5, 40), (15, 21)]
    foot = [(0, 0), (9.5, 0), (9.5, 2), (4, 3.5), (2.2, 6), (4.2, 10), (2, 14), (2, 34), (0, 34)]
    return assemble(
        [
            lathe(shade, [ACCENT, LIGHT, LIGHT, LIGHT, ACCENT], sides=10, closed=True),
            lathe(foot, MAIN, sides=8),
        ],
        0.50,
    )


def hat() -> Mesh:
    return assemble(
        [
            lathe([(0, 0), (20, 0), (20, 1.8), (11, 2.2), (0, 2.2)], MAIN, sides=14),
            cylinder(11, 22, MAIN, at=(0, 0, 2), sides=14, top=12.5),
            cylinder(11.6, 5, ACCENT, at=(0, 0, 2.2), sides=14, top=11.9),
        ],
        0.30,
    )


def drum() -> Mesh:
    return assemble(
        [
            cylinder(13, 20, MAIN, sides=12),
            cylinder(14.4, 3, ACCENT, sides=12),
            cylinder(14.4, 3, ACCENT, at=(0, 0, 17.2), sides=12),
            cylinder(13, 0.8, LIGHT, at=(0, 0, 20), sides=12),
            *(
                rod((-12, 3 * s, 21.5), (18, -11 * s, 24), 1, WOOD, sides=5).move(2, 0, 0)
                for s in (-1, 1)
            ),
        ],
        0.36,
    )


def guitar() -> Mesh:
    half = [(0, 0), (8, 0.5), (12, 4.5), (11.5, 9), (7, 12.5), (9, 16.5), (7, 20.5), (0, 21.5)]
    outline = [*half, *((-y, z) for y, z in half[-2:0:-1])]
    head = [(-2, 34), (2, 34), (3.6, 40), (-3.6, 40)]
    return assemble(
        [
            slab(outline, 8, MAIN, plane="yz"),
            box(3, 4, 18, WOOD, at=(3.4, 0, 26)),
            slab(head, 3, ACCENT, plane="yz", at=(2.6, 0, 0)),
            cylinder(3.6, 1, DARK, sides=8).turn("y", 90).move(3.6, 0, 13),
            box(1.6, 9, 2, DARK, at=(4.1, 0, 5)),
            *both_sides(*(box(1.4, 2.2, 1.4, LIGHT, at=(2.6, 4, z)) for z in (35.6, 38.4))),
        ],
        1.00,
    )


def piano() -> Mesh:
    return assemble(
        [
            box(13, 44, 36, MAIN, at=(-5, 0, 18)),
            block((15, 46), (13.6, 44.6), 2.4, ACCENT, at=(-4.6, 0, 35.4)),
            box(12, 44, 4, MAIN, at=(6.5, 0, 15)),
            box(9, 40, 1.6, LIGHT, at=(7.6, 0, 17.4)),
            *(
                box(5, 2.6, 1.8, DARK, at=(5.8, y, 18.8))
                for y in (-15.5, -10.5, -1.5, 3.5, 8.5, 16.5)
            ),
            box(1.4, 34, 1.6, DARK, at=(1.8, 0, 21)),
            box(1.6, 16, 8, LIGHT, at=(1.6, 0, 27)),
            *both_sides(
                box(12, 2.4, 6.5, MAIN, at=(6.5, 21.6, 16.4)),
                box(2.6, 2.6, 14, DARK, at=(10.8, 19.6, 7)),
            ),
        ],
        1.40,
    )


def clock() -> Mesh:
    face = [
        cylinder(14.5, 14, MAIN, at=(0, 0, -7), sides=12),
        cylinder(13, 0.8, DARK, at=(0, 0, 6.6), sides=12),
        cylinder(11, 0.8, LIGHT, at=(0, 0, 7), sides=12),
    ]
    bell = ellipsoid((6, 6, 4.6), ACCENT, sides=6, rings=2).turn("x", -32).move(0, 9, 33.5)
    return assemble(
        [
            *(solid.turn("y", 90).move(0, 0, 17) for solid in face),
            box(1.2, 2.2, 9, DARK, at=(8, 0, 20.4)),
            box(1.4, 7, 2.2, DARK, at=(8, -3, 17)),
            box(2, 5, 2, DARK, at=(0, 0, 38)),
            rod((0, 0, 30), (0, 0, 38), 1, DARK, sides=4),
            *both_sides(bell, rod((0, 8, 6), (0, 13, 0), 2.2, DARK, sides=5)),
        ],
        0.15,
    )


def phone() -> Mesh:
    base = loft(
        [
            [(-12, -15, 0), (14, -15, 0), (14, 15, 0), (-12, 15, 0)],
            [(-12, -15, 3), (14, -15, 3), (14, 15, 3), (-12, 15, 3)],
            [(-8, -8, 17), (-1, -8, 17), (-1, 8, 17), (-8, 8, 17)],
        ]
    )
    dial = cylinder(7.5, 2, LIGHT, sides=12).turn("y", 43).move(6, 0, 10)
    hub = cylinder(3, 1.5, DARK, sides=8).turn("y", 43).move(7.2, 0, 11.4)
    handle = tube(
        [(-4.5, -15, 21), (-4.5, -8, 24), (-4.5, 8, 24), (-4.5, 15, 21)], 2.4, ACCENT, sides=6
    )
    return assemble(
        [
            base,
            dial,
            hub,
            handle,
            *both_sides(
                cylinder(4.2, 6, ACCENT, at=(-4.5, 15, 17), sides=8, top=3),
                box(3, 2, 6, DARK, at=(-4.5, 6.5, 18.5)),
            ),
        ],
        0.22,
    )


def _star(outer: float, inner: float, points: int, z: float) -> np.ndarray:
    """A star's outline [2 * points, 3] about the z axis."""
    ring = circle(outer, 2 * points, z)
    ring[1::2, :2] *= inner / outer
    return ring


def _oval(x: float, y: float, z: float, sides: int) -> np.ndarray:
    """An ellipse's outline [sides, 3] about the z axis."""
    return circle(1.0, sides, z, start=180 / sides) * (x, y, 1.0)


def _panels(solid: Solid, count: int) -> Solid:
    """Colours sectors about the z axis alternately in the main and the accent colour."""
    middle = solid.vertices[solid.triangles].mean(axis=1)
    sector = np.floor(np.arctan2(middle[:, 1], middle[:, 0]) / (2 * np.pi) * count).astype(int)
    return replace(solid, parts=np.where(sector % 2 == 0, MAIN, ACCENT))


def keyboard() -> Mesh:
    slope = 19.0
    wedge = [(-10.0, 0.0), (10.0, 0.0), (10.0, 3.0), (-10.0, 3.0 + 20 * np.tan(np.radians(slope)))]
    solids = [slab(wedge, 40, plane="xz")]
    keys = [(x, y, 4.8) for x, shift in ((-6.4, 0.0), (0.0, 1.5)) for y in _spread(6, 6.2, shift)]
    keys += [(6.4, -15.0, 6.0), (6.4, 0.0, 20.0), (6.4, 15.0, 6.0)]
    for x, y, width in keys:
        key = box(4.6, width, 2.6, DARK, at=(x, y, 0.8))
        solids.append(key.turn("y", slope).move(z=3 + 10 * np.tan(np.radians(slope))))
    return assemble(solids, 0.44)


def _spread(count: int, pitch: float, shift: float = 0.0) -> list[float]:
    """`count` positions at a distance of `pitch`, centred at `shift`."""
    return [(i - (count - 1) / 2) * pitch + shift for i in range(count)]


def helicopter() -> Mesh:
    tail = [(-21.0, 17.0), (-15.0, 17.0), (-18.5, 29.0), (-24.0, 29.0)]
    blade = box(36, 5.5, 2, ACCENT, at=(0, 0, 27.5))
    solids = [
        ellipsoid((12, 8.5, 9), at=(5, 0, 15.5), sides=8, rings=3),
        ellipsoid((8.5, 7, 6), LIGHT, at=(10.5, 0, 17), sides=8, rings=3),
        rod((-2, 0, 17), (-20, 0, 19), 4, end_radius=2.2, sides=6),
        slab(tail, 2.4, ACCENT, plane="xz"),
        rod((4, 0, 22), (4, 0, 30), 1.8, DARK, sides=4),
        blade.turn("z", 45).move(4),
        blade.turn("z", -45).move(4),
    ]
    for y in (-8, 8):
        solids.append(box(26, 2.4, 2.4, DARK, at=(4, y, 1.2)))
        solids += [rod((x, y, 1), (x, y * 0.5, 10), 1.2, DARK, sides=3) for x in (-2, 10)]
    return assemble(solids, 0.35)


def carriage() -> Mesh:
    bowl = arc(15, 180, 360, 7)[:, [0, 2]]
    hood = np.concatenate([[(0.0, 0.0)], arc(17, 75, 180, 5)[:, [0, 2]]])
    # A tapered hull: two narrow sides about the wide middle.
    hull = [
        np.column_stack([bowl[:, 0] * f, np.full(7, y), bowl[:, 1] * f])
        for y, f in ((-11, 0.8), (-9, 1), (9, 1), (11, 0.8))
    ]
    solids = [
        loft(hull, at=(0, 0, 24)),
        slab([(x, z) for x, z in hood], 23, ACCENT, plane="xz", at=(0, 0, 24)),
        box(14, 16, 3, LIGHT, at=(6.5, 0, 24)),
    ]
    for y in (-7.5, 7.5):
        solids.append(rod((13, y, 21), (24, y, 34), 1.3, DARK, sides=3))
    solids.append(rod((24, -9, 34), (24, 9, 34), 1.6, DARK, sides=3))
    for side in (-1, 1):
        wheel = cylinder(9, 3.4, DARK, sides=7)
        spokes = loft([_star(8, 3.2, 4, 3.0), [(0, 0, 5.0)]], LIGHT)
        for x in (-10.5, 10.5):
            solids += [s.turn("x", -90 * side).move(x, 11 * side, 9) for s in (wheel, spokes)]
    return assemble(solids, 0.60)


def racket() -> Mesh:
    loop = circle(1.0, 14)[:, [2, 0, 1]] * (0, 12.5, 13.5) + (0, 0, 26)
    solids = [
        tube(loop, 3.5, sides=4, closed=True),
        rod((0, -8, 15), (0, 0, 4), 2.2, sides=4),
        rod((0, 8, 15), (0, 0, 4), 2.2, sides=4),
        rod((0, 0, -9), (0, 0, 8), 3, ACCENT, sides=6),
        cylinder(3.8, 3, DARK, at=(0, 0, -11), sides=6),
    ]
    for offset in (-6, 0, 6):
        reach = float(np.sqrt(1 - (offset / 13) ** 2))
        y, z = 12.5 * reach, 13.5 * reach
        solids.append(rod((0, offset, 26 - z), (0, offset, 26 + z), 1.1, LIGHT, sides=3))
        solids.append(rod((0, -y, 26 + offset), (0, y, 26 + offset), 1.1, LIGHT, sides=3))
    return assemble(solids, 0.68)


def pillow() -> Mesh:
    steps = np.linspace(-1, 1, 7)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    # The sides curve inwards between the corners, as a cushion's do.
    x = 15 * u * (1 - 0.16 * (1 - v**2) * np.abs(u))
    y = 20 * v * (1 - 0.16 * (1 - u**2) * np.abs(v))
    height = 9.5 * ((1 - u**2) * (1 - v**2)) ** 0.4
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
    return assemble([Solid(vertices[used], triangles, np.full(len(triangles), MAIN))], 0.60)


def candle() -> Mesh:
    return assemble(
        [
            lathe([(9, 0), (13, 3), (12, 4), (8, 1.6), (0, 1.6)], ACCENT, sides=10),
            torus(4.2, 1.5, ACCENT, around=8, sides=4).turn("x", 90).move(15.5, 0, 5.5),
            cylinder(6, 21, at=(0, 0, 1), sides=8),
            rod((0, 0, 21), (0, 0, 26), 1.0, DARK, sides=4),
            lathe([(0, 24), (4.2, 28.5), (3.2, 32), (0, 40)], LIGHT, sides=6),
        ],
        0.13,
    )


def teapot() -> Mesh:
    body = [(8, 0), (13, 4), (15, 11), (13, 19), (8, 23)]
    spout = [(10.0, 0.0, 7.0), (17.0, 0.0, 11.0), (19.0, 0.0, 18.0), (22.0, 0.0, 24.0)]
    handle = arc(8, 80, 280, 8, at=(-14, 0, 12.5))
    return assemble(
        [
            lathe(body, sides=10),
            lathe([(9, 22), (8, 25), (0, 27.5)], ACCENT, sides=10),
            ellipsoid((3.6, 3.6, 3.6), ACCENT, at=(0, 0, 30), sides=5, rings=2),
            tube(spout, [6, 5, 3.6, 3.6], sides=5),
            tube(handle, 2.5, ACCENT, sides=4),
        ],
        0.24,
    )


def banana() -> Mesh:
    path = arc(17, -75, 75, 10, plane="xy")
    path = np.concatenate([path[:1] + (-2.5, -0.4, 0), path, path[-1:] + (-5, 1.4, 0)])
    radii = [1.6, 2.4, 4.2, 5.4, 5.9, 6.0, 5.9, 5.6, 5.0, 4.0, 2.2, 2.0]
    return assemble([tube(path, radii, [DARK, *[MAIN] * 9, DARK], sides=6)], 0.20)


def apple() -> Mesh:
    flesh = [(0, 3), (5, 0), (11, 3.5), (16.5, 11), (19, 19), (16.5, 26), (9.5, 28.5), (0, 23)]
    leaf = [(0.0, 0.0), (8.0, -5.5), (17.0, 0.0), (8.0, 5.5)]
    return assemble(
        [
            lathe(flesh, sides=10),
            rod((0, 0, 23), (-3, 0, 40), 2.2, WOOD, sides=5, end_radius=2.6),
            slab(leaf, 2.6, GREEN).turn("y", -25).move(-1.5, 0, 33),
        ],
        0.09,
    )


def carrot() -> Mesh:
    root = [(2, 0), (5.4, 7), (4.8, 8), (8.4, 15), (7.6, 16), (11, 24), (9, 28), (0, 29)]
    solids = [lathe(root, sides=10)]
    outline = [(0.0, -1.8), (9.0, -4.0), (15.0, 0.0), (9.0, 4.0), (0.0, 1.8)]
    for angle in (0, 72, 144, 216, 288):
        leaf = slab(outline, 2.6, GREEN).turn("y", -52)
        solids.append(leaf.turn("z", angle).move(z=27))
    return assemble(solids, 0.22)


def mushroom() -> Mesh:
    cap = [(5, 18), (17, 17), (19, 21), (15.5, 28), (8.5, 33), (0, 34.5)]
    solids = [
        lathe([(9, 0), (7.5, 3), (6, 10), (6.5, 19)], LIGHT, sides=8),
        lathe(cap, sides=10),
    ]
    for angle, radius, height, tilt in [
        *((a, 17.0, 24.5, 62) for a in (0, 120, 240)),
        *((a, 11.0, 30.5, 36) for a in (60, 180, 300)),
    ]:
        spot = cylinder(4.6, 1.6, LIGHT, sides=5, top=3.8).move(z=-0.6)
        solids.append(spot.turn("y", tilt).move(radius, 0, height).turn("z", angle))
    return assemble(solids, 0.10)


def toothbrush() -> Mesh:
    shaft = [(1.5, 0, 0), (0.5, 0, 9), (0, 0, 18), (-0.5, 0, 24), (0, 0, 27)]
    solids = [
        tube(np.array(shaft, dtype=float), [3.6, 4.2, 3.4, 2.2, 2.6], sides=6),
        box(4.2, 8, 18, at=(0, 0, 35)),
        lathe([(4, 4), (5.4, 5.5), (5.4, 13), (4, 14.5)], ACCENT, sides=6).move(0.6),
    ]
    for z in (28.2, 32.7, 37.2, 41.7):
        solids.append(block((3, 6), (3.7, 8), 11, LIGHT).turn("y", 90).move(1.2, 0, z))
    return assemble(solids, 0.19)


def toothpaste() -> Mesh:
    body = [
        _oval(8, 8, 7, 10),
        _oval(7.4, 9.6, 15, 10),
        _oval(6.4, 11.2, 22, 10),
        _oval(3.0, 14.0, 35, 10),
        _oval(2.4, 14.6, 40, 10),
    ]
    return assemble(
        [
            cylinder(6, 6.5, LIGHT, sides=8, top=5.4),
            cylinder(3.5, 3, DARK, at=(0, 0, 5), sides=6),
            loft(body, [MAIN, ACCENT, MAIN, LIGHT]),
        ],
        0.18,
    )


def comb() -> Mesh:
    spine = [(-20.5, 17.0), (20.5, 17.0), (20.5, 22.0), (13.0, 26.0), (-13.0, 26.0), (-20.5, 22.0)]
    solids = [slab(spine, 6, plane="yz")]
    solids += [block((3.4, 2.2), (5, 3.4), 18, at=(0, y, 0)) for y in _spread(7, 6.26)]
    return assemble(solids, 0.18)


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
        ],
        0.24,
    )


def fork() -> Mesh:
    head = [(-3, 20), (3, 20), (12, 24), (12, 29), (-12, 29), (-12, 24)]
    solids = [
        slab(head, 6, plane="yz"),
        lathe([(3, 0), (4.6, 2), (4, 10), (2.8, 16), (2.8, 22)], sides=8),
    ]
    solids += [block((6, 4.4), (4.6, 3), 15, at=(0, y, 28)) for y in (-9.6, 0, 9.6)]
    return assemble(solids, 0.19)


def hammer() -> Mesh:
    claw = [(-4, 28), (-4, 38), (-9, 38), (-20, 31), (-21, 27), (-11, 30)]
    neck = cylinder(4.5, 6, sides=10).turn("x", -90).move(0, 4, 33)
    face = lathe([(4.8, 0), (6.6, 2), (6.6, 8), (5.6, 9)], ACCENT, sides=10)
    return assemble(
        [
            lathe([(4, 0), (3.6, 5), (2.8, 20), (3.2, 36)], WOOD, sides=8),
            box(9.5, 9.5, 11, at=(0, 0, 32.5)),
            neck,
            face.turn("x", -90).move(0, 8, 33),
            *(slab(claw, 3.4, plane="yz", at=(x, 0, 0)) for x in (-3, 3)),
        ],
        0.33,
    )


def screwdriver() -> Mesh:
    grip = [_star(r, 0.74 * r, 6, z) for r, z in ((5.6, 0), (9.4, 2.5), (8.8, 17), (5.4, 20))]
    tip = [_oval(2.9, 2.9, 32, 8), _oval(2.6, 7.4, 36, 8), _oval(1.8, 7.4, 42, 8)]
    return assemble(
        [
            loft(grip, [MAIN, MAIN, ACCENT]),
            cylinder(2.9, 16, LIGHT, at=(0, 0, 18), sides=6),
            loft(tip, LIGHT),
        ],
        0.23,
    )


def key() -> Mesh:
    return assemble(
        [
            torus(12, 4, around=12, sides=4).turn("y", 90).move(0, 0, 34),
            cylinder(3.8, 22, sides=8),
            cylinder(6, 4, ACCENT, at=(0, 0, 18.5), sides=8),
            box(6.4, 17, 6, at=(0, 9, 3)),
            box(6.4, 12, 5, at=(0, 6.5, 13.4)),
        ],
        0.10,
    )


def scissors() -> Mesh:
    outline = [(-3.6, -3), (3.4, -3), (4.4, 8), (0.8, 26), (-2.2, 26), (-3.6, 10)]
    solids = [cylinder(2.6, 10, DARK, sides=6).move(z=-5).turn("y", 90)]
    for side in (-1, 1):
        blade = slab(outline, 3.6, LIGHT, plane="yz")
        arm = rod((0, 0, 2), (0, 1, -8), 2.6, sides=4)
        ring = torus(6.2, 2.2, around=10, sides=4).turn("y", 90).move(0, 3.0, -13.5)
        for solid in (blade, arm, ring):
            upright = solid.mirror() if side < 0 else solid
            solids.append(upright.turn("x", side * 27).move(side * 1.8))
    return assemble(solids, 0.18)


def umbrella() -> Mesh:
    rim = circle(19, 16, 22)
    rim[1::2] = rim[1::2] * (0.86, 0.86, 1) + (0, 0, 3)
    peak, hollow = np.array([(0, 0, 36)]), np.array([(0, 0, 33)])
    canopy = [peak, circle(9.5, 16, 33), rim, rim * (0.92, 0.92, 1), hollow]
    bend = arc(5, 180, 350, 6, plane="yz", at=(0, 5, 5))
    hook = np.concatenate([[(0.0, 0.0, 34.0)], bend])
    return assemble(
        [
            _panels(loft(canopy), 8),
            tube(hook, 2.2, DARK, sides=4),
            cone(1.8, 6, DARK, at=(0, 0, 35), sides=4),
        ],
        0.90,
    )


def basket() -> Mesh:
    profile = [(11, 0), (13.2, 6), (15, 12), (16.5, 18), (14.5, 18), (10, 4), (0, 4)]
    hold = lathe(profile, [MAIN] * 5 + [DARK], sides=10).turn("z", 18)
    height = hold.vertices[hold.triangles][:, :, 2].mean(axis=1)
    woven = _panels(hold, 10)
    checked = np.where((height > 6) & (height < 12), 1 - woven.parts, woven.parts)
    hold = replace(hold, parts=np.where(hold.parts == DARK, DARK, checked))
    handle = arc(15.5, 0, 180, 8, plane="yz", at=(0, 0, 16)) * (1, 1, 1.15)
    rim = torus(16, 1.8, WOOD, at=(0, 0, 18), around=10, sides=4)
    return assemble([hold, tube(handle, 2.4, WOOD, sides=4), rim], 0.40)


def cactus() -> Mesh:
    trunk = [_star(r, 0.74 * r, 6, z) for r, z in ((5.5, 10), (6.4, 20), (6, 35), (3, 39))]
    left = np.array([(0, -3, 21), (0, -12, 21), (0, -13.5, 23), (0, -13.5, 33), (0, -13.5, 35)])
    right = np.array([(0, 3, 17), (0, 11, 17), (0, 12.5, 19), (0, 12.5, 27), (0, 12.5, 29)])
    radii = [3.2, 3.4, 3.8, 3.4, 1.5]
    pot = [(8, 0), (10, 9), (12, 9), (12, 12.5), (0, 12.5)]
    return assemble(
        [
            lathe(pot, [MAIN, ACCENT, ACCENT, WOOD], sides=8),
            loft(trunk, GREEN),
            tube(left.astype(float), radii, GREEN, sides=5),
            tube(right.astype(float), radii, GREEN, sides=5),
            cone(3, 4, ACCENT, sides=5, at=(0, 0, 38)),
        ],
        0.25,
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
    turns = {5: ("y", 0), 2: ("y", 180), 6: ("y", 90), 1: ("y", -90), 3: ("x", 90), 4: ("x", -90)}
    solids = [_chamfered_cube(20, 4)]
    for face, (axis, degrees) in turns.items():
        for x, y in pips[face]:
            pip = cone(4.6, 1.0, DARK, sides=5).move(9.8 * x, 9.8 * y, 19.9)
            solids.append(pip.turn(axis, degrees))
    return assemble(solids, 0.05)


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
    for level in range(7):
        low = 40 - 5.4 * level
        solids.append(block((low, low), (low - 3.6, low - 3.6), 4.2, at=(0, 0, 4.2 * level)))
    peak: list[Point] = [(0, 0, 33)]
    solids.append(loft([circle(2.1, 4, 29.4, start=45), peak], ACCENT))
    solids.append(block((6, 10), (6, 7), 9, DARK, at=(18.2, 0, 0), shift=(-5.8, 0)))
    return assemble(solids, 0.40)


TOYS = {
    toy.__name__: toy
    for toy in (
        duck, ball, book, cup, car, train, boat, robot, teddy, rocket,
        bus, plane, mug, spoon, bowl, plate, bottle, chair, lamp, hat,
        drum, guitar, piano, clock, phone,
        keyboard, helicopter, carriage, racket, pillow, candle, teapot, banana, apple,
        carrot, mushroom, toothbrush, toothpaste, comb, hairdryer, fork, hammer, screwdriver,
        key, scissors, umbrella, basket, cactus, dice, pyramid,
    )
}  # fmt: skip
