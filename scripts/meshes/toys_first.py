"""The toys of ranks 1 to 25, from the most frequent on.

The features that distinguish a toy are exaggerated, because it is drawn a dozen pixels wide.
"""

from dataclasses import replace

import numpy as np

from .shapes import (
    ACCENT,
    DARK,
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
    cylinder,
    ellipsoid,
    lathe,
    loft,
    rod,
    slab,
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


TOYS = {
    toy.__name__: toy
    for toy in (
        duck, ball, book, cup, car, train, boat, robot, teddy, rocket,
        bus, plane, mug, spoon, bowl, plate, bottle, chair, lamp, hat,
        drum, guitar, piano, clock, phone,
    )
}  # fmt: skip
