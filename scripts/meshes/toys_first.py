"""The toys of ranks 1 to 25, from the most frequent on.

What tells a toy from the others is exaggerated: it is seen a dozen pixels wide.
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
    Solid,
    arc,
    assemble,
    block,
    box,
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
    return [*solids, *(solid.mirror("y") for solid in solids)]


def wheel(radius: float, width: float, x: float, y: float, *, sides: int = 8) -> Solid:
    """A tyre standing on z = 0, its middle at (x, y)."""
    tyre = cylinder(radius, width, DARK, sides=sides).turn("x", 90)
    return tyre.move(x, y + width / 2, radius)


def duck() -> Mesh:
    body = loft(
        [
            [(-24, 0, 21)],
            *(
                [(x, r * np.cos(t), z + 0.8 * r * np.sin(t)) for t in np.radians(range(0, 360, 45))]
                for x, r, z in ((-17, 5, 17), (-8, 11, 12), (5, 12.5, 10.5), (14, 8, 11))
            ),
            [(18, 0, 13)],
        ]
    )
    return assemble(
        [
            body,
            ellipsoid((8, 7.5, 8), at=(11, 0, 25)),
            block((9, 10), (8, 7), 3.5, ACCENT, at=(19, 0, 21)),
            *both_sides(
                ellipsoid((9, 2.5, 5.5), ACCENT, at=(-5, 11, 14), sides=6, rings=2),
                box(2.6, 1.6, 2.6, DARK, at=(14.5, 6.3, 28)),
            ),
        ]
    )


def ball() -> Mesh:
    round_ball = ellipsoid((1, 1, 1), sides=12, rings=7)
    middle = round_ball.vertices[round_ball.triangles].mean(axis=1)
    sector = np.floor(np.degrees(np.arctan2(middle[:, 1], middle[:, 0])) / 60).astype(int)
    return assemble([replace(round_ball, parts=np.where(sector % 2, ACCENT, MAIN))])


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
    return assemble([*both_sides(*opened), cylinder(2.2, 34, ACCENT, sides=6)])


def cup() -> Mesh:
    bowl_shape = [(0, 4), (6, 4), (9, 7), (12, 18), (11, 18), (8, 8), (0, 7)]
    saucer = [(0, 0), (8, 0), (19, 4), (19, 5.2), (8, 2), (0, 2)]
    handle = tube(
        [(10, 0, 16), (15, 0, 17.5), (17.5, 0, 14), (15, 0, 10), (9, 0, 8)], 1.2, ACCENT, sides=4
    )
    return assemble(
        [
            lathe(bowl_shape, [MAIN] * 4 + [DARK] * 2, sides=12),
            lathe(saucer, ACCENT, sides=12),
            handle.turn("z", 90),
        ]
    )


def car() -> Mesh:
    side = [
        (-20, 4), (20, 4), (20, 10), (18, 12), (10, 13), (-19, 13), (-20, 11),
    ]  # fmt: skip
    return assemble(
        [
            slab(side, 18, MAIN, plane="xz"),
            block((22, 17), (13, 14), 8.5, LIGHT, at=(-4, 0, 13), shift=(-1, 0)),
            block((14, 15), (13, 14.5), 1.6, MAIN, at=(-5, 0, 21)),
            block((3, 17.4), (2.5, 14.6), 8.4, MAIN, at=(-6, 0, 13)),
            box(2, 19, 2.5, ACCENT, at=(20, 0, 6)),
            box(2, 19, 2.5, ACCENT, at=(-20, 0, 6)),
            *both_sides(
                wheel(5, 4, -12, 8.5),
                wheel(5, 4, 12, 8.5),
                box(1.5, 3.5, 2.5, LIGHT, at=(20, 6, 9.5)),
            ),
        ]
    )


def train() -> Mesh:
    boiler = cylinder(6, 22, MAIN, sides=10).turn("y", 90).move(-6, 0, 13)
    front = cylinder(6.4, 3, DARK, sides=10).turn("y", 90).move(14, 0, 13)
    catcher = loft([[(17, -7, 1), (17, 7, 1), (17, 7, 7), (17, -7, 7)], [(24, 0, 1)]], ACCENT)
    return assemble(
        [
            box(38, 12, 3, ACCENT, at=(-2, 0, 7)),
            boiler,
            front,
            catcher,
            cylinder(2.2, 9, DARK, at=(11, 0, 18), sides=6, top=4.2),
            cylinder(2.8, 4, ACCENT, at=(2, 0, 18), sides=6, top=2),
            box(12, 14, 18, MAIN, at=(-13, 0, 16)),
            box(15, 17, 2, ACCENT, at=(-13, 0, 26)),
            box(6, 14.6, 6, LIGHT, at=(-13, 0, 20)),
            *both_sides(wheel(5.5, 2.5, -14, 7), wheel(4, 2.5, 0, 7), wheel(4, 2.5, 9.5, 7)),
        ]
    )


def boat() -> Mesh:
    def deck(length: float, width: float, z: float) -> list[tuple[float, float, float]]:
        outline = [(-0.5, -0.35), (-0.1, -0.5), (0.25, -0.35), (0.55, 0), (0.25, 0.35), (-0.1, 0.5)]
        return [(x * length, y * width, z) for x, y in [*outline, (-0.5, 0.35)]]

    hull = [deck(20, 6, 0), deck(30, 14, 9), deck(27, 11.5, 9), deck(25, 9.5, 6)]
    return assemble(
        [
            loft(hull, [MAIN, WOOD, WOOD]),
            rod((1, 0, 4), (1, 0, 40), 0.9, WOOD, sides=5),
            slab([(0, 12), (0, 39), (-15, 12)], 1.2, LIGHT, plane="xz"),
            slab([(2.5, 12), (14, 12), (2.5, 34)], 1.2, ACCENT, plane="xz"),
            rod((1, 0, 11), (-15, 0, 11), 0.8, WOOD, sides=4),
        ]
    )


def robot() -> Mesh:
    return assemble(
        [
            box(9, 14, 13, MAIN, at=(0, 0, 16.5)),
            box(1, 9, 6, ACCENT, at=(4.8, 0, 17)),
            box(4, 4, 3, DARK, at=(0, 0, 24)),
            box(9, 11, 9, MAIN, at=(0, 0, 29.5)),
            box(1, 7, 1.6, DARK, at=(4.8, 0, 27)),
            rod((0, 0, 34), (0, 0, 38), 0.7, DARK, sides=4),
            ellipsoid((1.8, 1.8, 1.8), ACCENT, at=(0, 0, 38.5), sides=5, rings=2),
            *both_sides(
                box(1.4, 2.8, 2.8, LIGHT, at=(4.8, 2.8, 31)),
                box(3, 1.6, 3, ACCENT, at=(0, 6.2, 29.5)),
                box(4, 4, 4, DARK, at=(0, 9, 20.5)),
                box(14, 3.6, 3.6, ACCENT, at=(5, 9.2, 20)),
                box(3, 6, 6, DARK, at=(12, 9.2, 20)),
                box(5, 4, 8, DARK, at=(0, 4, 7)),
                box(10, 6, 4, ACCENT, at=(1.5, 4, 2)),
            ),
        ]
    )


def teddy() -> Mesh:
    def limb(radii: tuple[float, float, float], at: tuple[float, float, float]) -> Solid:
        return ellipsoid(radii, MAIN, at=at, sides=6, rings=2)

    return assemble(
        [
            ellipsoid((8.5, 9, 10), MAIN, at=(0, 0, 10), sides=8),
            ellipsoid((3, 6, 6.5), ACCENT, at=(6, 0, 10), sides=6, rings=2),
            ellipsoid((8, 9, 8), MAIN, at=(0.5, 0, 25), sides=8),
            ellipsoid((4, 3.6, 3), ACCENT, at=(8, 0, 23), sides=6, rings=2),
            box(2, 2.4, 1.8, DARK, at=(11.5, 0, 24)),
            *both_sides(
                limb((2, 4, 4), (0, 8, 32)),
                limb((4, 6.5, 3.4), (3, 10, 15)).turn("x", 8),
                limb((8, 4, 4), (10, 8, 4)).turn("z", 15),
                box(1.6, 1.8, 2.2, DARK, at=(7.2, 3.6, 27.5)),
            ),
        ]
    )


def rocket() -> Mesh:
    body = [(0, 5), (3, 5), (5.5, 12), (6, 20), (5, 28), (3, 34), (0, 40)]
    fin = slab([(4, 16), (13, 6), (13, 0), (10, 0), (4, 7)], 1.6, ACCENT, plane="xz")
    return assemble(
        [
            lathe(body, [MAIN] * 4 + [ACCENT] * 2, sides=9),
            cylinder(4, 3, DARK, at=(0, 0, 2.5), sides=9, top=2.6),
            *(fin.turn("z", angle) for angle in (60, 180, 300)),
            cylinder(2.6, 3, LIGHT, sides=8).turn("y", 90).move(4, 0, 23),
        ]
    )


def bus() -> Mesh:
    windows = [box(5, 14.6, 5, LIGHT, at=(x, 0, 16)) for x in (-15, -8.5, -2, 4.5, 11)]
    return assemble(
        [
            box(40, 14, 17, MAIN, at=(0, 0, 11.5)),
            box(38, 12, 2, ACCENT, at=(0, 0, 21)),
            *windows,
            box(40.6, 14.4, 2, ACCENT, at=(0, 0, 10)),
            box(1.4, 11, 6.5, LIGHT, at=(19.8, 0, 15.5)),
            box(1.4, 10, 5, LIGHT, at=(-19.8, 0, 16)),
            *both_sides(
                wheel(3.6, 3, -12, 6.2),
                wheel(3.6, 3, 12, 6.2),
                box(1.4, 2.4, 2, LIGHT, at=(20, 5, 6)),
            ),
        ]
    )


def plane() -> Mesh:
    def section(x: float, r: float, z: float) -> list[tuple[float, float, float]]:
        return [(x, r * np.cos(t), z + r * np.sin(t)) for t in np.radians(np.arange(22.5, 360, 45))]

    fuselage = loft(
        [
            [(20, 0, 9)],
            section(17, 2.4, 9.3),
            section(10, 4, 10),
            section(-6, 4, 10),
            section(-18, 1.4, 12),
        ]
    )
    wing = [(7, 2), (0, 20), (-5, 20), (-4, 2)]
    tail = [(-13, 1), (-17, 8), (-20, 8), (-18.5, 1)]
    return assemble(
        [
            fuselage,
            slab([(-11, 12), (-18, 22), (-21, 22), (-18, 11)], 1.4, ACCENT, plane="xz"),
            block((6, 5), (3, 3.5), 3, LIGHT, at=(10, 0, 12.5)),
            *both_sides(
                slab(wing, 1.4, ACCENT, at=(0, 0, 8.5)),
                slab(tail, 1.2, ACCENT, at=(0, 0, 12.5)),
                cylinder(1.9, 7, DARK, sides=6).turn("y", 90).move(-1, 9, 6),
                rod((2, 2, 8), (2, 4, 1.5), 0.8, DARK, sides=4),
                wheel(2, 1.4, 2, 4, sides=6),
            ),
            rod((14, 0, 8), (14, 0, 1.5), 0.8, DARK, sides=4),
            wheel(2, 1.4, 14, 0, sides=6),
        ]
    )


def mug() -> Mesh:
    wall = [(0, 0), (11, 0), (11, 30), (9.2, 30), (9.2, 3), (0, 3)]
    handle = tube(arc(9, -80, 80, 6, plane="yz", at=(0, 11, 15)), 2, ACCENT, sides=5)
    return assemble(
        [
            lathe(wall, [MAIN, MAIN, MAIN, DARK, DARK], sides=14),
            handle,
        ]
    )


def spoon() -> Mesh:
    def section(z: float, width: float, back: float) -> list[tuple[float, float, float]]:
        return [
            (-back, 0, z),
            (-back * 0.6, width * 0.6, z),
            (0.8, width, z),
            (-back + 1.8, 0.4 * width, z),
            (-back + 1.8, -0.4 * width, z),
            (0.8, -width, z),
            (-back * 0.6, -width * 0.6, z),
        ]

    bowl_part = loft(
        [
            section(21, 1.6, 1),
            section(24.5, 6, 3),
            section(30, 8, 5),
            section(36, 6.3, 4),
            section(40, 1.6, 1),
        ]
    )
    return assemble(
        [
            bowl_part,
            tube([(0, 0, 22), (-1, 0, 16), (0, 0, 6)], [1.6, 1.6, 2], MAIN, sides=6),
            tube([(0, 0, 7), (0.4, 0, 3), (0, 0, 0)], [2.4, 3.2, 2], ACCENT, sides=8),
        ]
    )


def bowl() -> Mesh:
    wall = [
        (0, 0), (8, 0), (7, 2.5), (14, 7), (19, 16), (20, 19),
        (18, 19), (12.5, 8.5), (0, 5),
    ]  # fmt: skip
    return assemble([lathe(wall, [ACCENT] * 2 + [MAIN] * 3 + [ACCENT] + [LIGHT] * 2, sides=14)])


def plate() -> Mesh:
    wall = [(0, 0), (11, 0), (20, 3.6), (20, 4.6), (12, 2), (0, 2)]
    return assemble([lathe(wall, [MAIN, MAIN, ACCENT, ACCENT, LIGHT], sides=18)])


def bottle() -> Mesh:
    profile = [
        (0, 0), (6, 0), (6.5, 1.5), (6.5, 20), (5.5, 24), (2.4, 28), (2.2, 35), (0, 35),
    ]  # fmt: skip
    return assemble(
        [
            lathe(profile, sides=11),
            cylinder(6.7, 9, LIGHT, at=(0, 0, 7), sides=11),
            cylinder(2.9, 6, ACCENT, at=(0, 0, 34), sides=8),
        ]
    )


def chair() -> Mesh:
    return assemble(
        [
            box(18, 18, 2.4, ACCENT, at=(0, 0, 17)),
            box(1.6, 18, 4, MAIN, at=(-8.6, 0, 37)),
            box(1.6, 18, 4, MAIN, at=(-8.4, 0, 28)),
            *both_sides(
                box(2.4, 2.4, 40, MAIN, at=(-8, 8, 20)),
                box(2.4, 2.4, 16, MAIN, at=(8, 8, 8)),
                box(14, 1.4, 1.8, MAIN, at=(0, 8, 7)),
            ),
        ]
    )


def lamp() -> Mesh:
    shade = [(13, 20), (7, 40), (6.2, 40), (12.2, 20)]
    foot = [(0, 0), (8, 0), (8, 1.8), (3, 3.5), (1.3, 7), (1.3, 34), (0, 34)]
    return assemble(
        [
            lathe(shade, [MAIN, MAIN, LIGHT, LIGHT], sides=11, closed=True),
            lathe(foot, DARK, sides=7),
            ellipsoid((3.4, 3.4, 3.4), LIGHT, at=(0, 0, 31), sides=6, rings=2),
        ]
    )


def hat() -> Mesh:
    return assemble(
        [
            lathe([(0, 0), (20, 0), (20, 1.8), (11, 2.2), (0, 2.2)], MAIN, sides=14),
            cylinder(11, 22, MAIN, at=(0, 0, 2), sides=14, top=12.5),
            cylinder(11.6, 5, ACCENT, at=(0, 0, 2.2), sides=14, top=11.9),
        ]
    )


def drum() -> Mesh:
    return assemble(
        [
            cylinder(13, 20, MAIN, sides=12),
            cylinder(14.4, 3, ACCENT, sides=12),
            cylinder(14.4, 3, ACCENT, at=(0, 0, 17), sides=12),
            cylinder(13, 0.8, LIGHT, at=(0, 0, 20), sides=12),
            *(
                rod((-12, 3 * s, 21.5), (18, -11 * s, 24), 1, WOOD, sides=5).move(2, 0, 0)
                for s in (-1, 1)
            ),
        ]
    )


def guitar() -> Mesh:
    half = [(0, 0), (5, 0.4), (7.6, 3.5), (7.4, 7), (5, 10.5), (6, 14), (5, 17), (0, 18)]
    outline = [(y, z) for y, z in half] + [(-y, z) for y, z in half[-2:0:-1]]
    return assemble(
        [
            slab(outline, 5, MAIN, plane="yz"),
            box(1.6, 2.6, 20, WOOD, at=(2.4, 0, 25)),
            slab(
                [(-1.5, 34), (1.5, 34), (2.8, 40), (-2.8, 40)], 2, ACCENT, plane="yz", at=(2, 0, 0)
            ),
            cylinder(2.5, 0.8, DARK, sides=8).turn("y", 90).move(2, 0, 11.5),
            box(1.2, 6, 1.2, DARK, at=(2.8, 0, 4.5)),
            *both_sides(*(box(1, 1.6, 1, LIGHT, at=(2, 3, z)) for z in (36, 38.4))),
        ]
    )


def piano() -> Mesh:
    case = [(12, -15), (12, 15), (-4, 15), (-8, 9), (-13, 4), (-20, 1), (-22, -6), (-20, -15)]
    lid = slab(case, 1.2, ACCENT).turn("x", 38).move(0, 3, 31)
    return assemble(
        [
            slab(case, 7, MAIN, at=(0, 0, 17)),
            slab([(x * 0.85, y * 0.85) for x, y in case], 1, WOOD, at=(-1, 0, 20.5)),
            lid,
            rod((-2, 10, 20), (-2, 12, 36), 0.6, WOOD, sides=4),
            box(7, 30, 3.4, MAIN, at=(15, 0, 15.2)),
            box(5, 26, 1.2, LIGHT, at=(15.6, 0, 17.3)),
            *(box(3, 1.8, 1.4, DARK, at=(14.4, y, 18)) for y in (-10, -6.5, -1, 2.5, 8)),
            *(
                cylinder(2, 14, MAIN, at=(x, y, 0), sides=5, top=2.4)
                for x, y in ((9, -12), (9, 12), (-17, -8))
            ),
        ]
    )


def clock() -> Mesh:
    def bell(y: float) -> Solid:
        return ellipsoid((5, 5, 4), ACCENT, sides=8, rings=3).turn("x", -28).move(0, y, 34)

    return assemble(
        [
            cylinder(14, 9, MAIN, sides=16).turn("y", 90).move(-4.5, 0, 17),
            cylinder(12, 1, LIGHT, sides=16).turn("y", 90).move(4, 0, 17),
            box(1, 1.8, 9, DARK, at=(5.2, 0, 21)),
            box(1, 7, 1.8, DARK, at=(5.2, -3, 17)),
            bell(8.5),
            bell(-8.5).mirror("y").mirror("y"),
            rod((0, 0, 30), (0, 0, 39), 0.8, DARK, sides=4),
            *both_sides(rod((0, 8, 6), (0, 13, 0), 1.6, DARK, sides=5)),
        ]
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
        ]
    )


TOYS = {
    toy.__name__: toy
    for toy in (
        duck, ball, book, cup, car, train, boat, robot, teddy, rocket,
        bus, plane, mug, spoon, bowl, plate, bottle, chair, lamp, hat,
        drum, guitar, piano, clock, phone,
    )
}  # fmt: skip
