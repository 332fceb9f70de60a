"""Objects of Zipf's Labyrinth, the forty: apple2 to zebra.

Lengths are centimetres. Every object shows both its main and its accent colour from all sides,
because tasks name objects by their colours. What distinguishes an outline is exaggerated.
"""

import numpy as np

from .labyrinth_forms import sectors
from .shapes import (
    ACCENT,
    DARK,
    LIGHT,
    MAIN,
    WOOD,
    Solid,
    arc,
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
from .toys import both_sides, wheels


def apple2() -> list[Solid]:
    flesh = [(0, 4), (7, 0), (15, 4), (20, 13), (20, 17), (18, 22.5), (10, 29), (0, 24)]
    leaf = [(0.0, 0.0), (9.0, -7.0), (19.0, 0.0), (9.0, 7.0)]
    return [
        lathe(flesh, [*[MAIN] * 5, ACCENT, ACCENT]),
        rod((0, 0, 24), (-3, 0, 37), 2.0, DARK, sides=4, end_radius=2.6),
        slab(leaf, 2.8, ACCENT).turn("y", -25).turn("z", 60).move(-1, 0, 30),
    ]


def ball() -> list[Solid]:
    return [sectors(ellipsoid((18, 18, 18), sides=12, rings=5), 6, phase=15)]


def balloon() -> list[Solid]:
    skin = [
        (0, 0), (6, 0), (2, 5), (9, 11), (18, 21), (21.5, 29), (22.5, 37), (19, 50),
        (10.5, 58), (0, 60),
    ]  # fmt: skip
    return [lathe(skin, [*[ACCENT] * 5, *[MAIN] * 4], sides=10)]


def banana() -> list[Solid]:
    path = arc(31, 197, 343, 11, plane="yz")
    path = np.concatenate([path[:1] + (0, -1, 5), path])
    radii = [2.6, 4.0, 6.4, 8.2, 9.2, 9.5, 9.5, 9.2, 8.2, 6.4, 3.6, 1.8]
    return [tube(path, radii, [*[ACCENT] * 3, *[MAIN] * 6, *[ACCENT] * 2], sides=6)]


def bottle() -> list[Solid]:
    glass = [
        (0, 0), (9.6, 0), (10, 10), (10, 28), (9, 32), (4, 38), (3.6, 46), (5, 46), (5, 54),
        (0, 54),
    ]  # fmt: skip
    parts = [MAIN, MAIN, ACCENT, MAIN, MAIN, MAIN, ACCENT, ACCENT, ACCENT]
    return [lathe(glass, parts)]


def cake() -> list[Solid]:
    def layer(radius: float, low: float, high: float, part: int) -> Solid:
        rim = arc(radius, 38, 322, 10, plane="xy")[:, :2].tolist()
        outline = [(-2.0, 0.0), *((x, y) for x, y in rim)]
        return slab(outline, high - low, part, at=(0, 0, (low + high) / 2))

    return [
        layer(26, 0, 6, MAIN),
        layer(25, 6, 8.5, ACCENT),
        layer(26, 8.5, 13, MAIN),
        layer(26.5, 13, 18, ACCENT),
        *(
            ellipsoid((3.6, 3.6, 4), MAIN, at=(float(x), float(y), 19.5), sides=4, rings=2)
            for x, y, _ in arc(18, 65, 295, 4, plane="xy")
        ),
    ]


def can() -> list[Solid]:
    tin = [
        (0, 0), (15, 0), (20, 6), (20, 16), (20, 33), (20, 43), (15, 50), (15, 51), (13, 51),
        (13, 48), (0, 48),
    ]  # fmt: skip
    parts = [LIGHT, LIGHT, MAIN, ACCENT, MAIN, ACCENT, *[LIGHT] * 4]
    return [lathe(tin, parts), box(9, 4, 1.4, DARK, at=(4, 0, 48.6))]


def car() -> list[Solid]:
    side = [(-48, 10), (48, 10), (48, 19), (42, 24), (20, 27), (-46, 27), (-48, 24)]
    return [
        slab(side, 42, MAIN, plane="xz"),
        block((58, 40), (34, 32), 17, ACCENT, at=(-8, 0, 27), shift=(-2, 0)),
        box(4, 44, 6, ACCENT, at=(46.5, 0, 13)),
        box(4, 44, 6, ACCENT, at=(-46.5, 0, 13)),
        wheels(12, 48, -27),
        wheels(12, 48, 27),
        *both_sides(box(2, 8, 5, LIGHT, at=(47.6, 13, 20))),
    ]


def cassette() -> list[Solid]:
    foot = [(-23.0, 0.0), (23.0, 0.0), (19.0, 9.0), (-19.0, 9.0)]
    return [
        box(8, 68, 42, MAIN, at=(0, 0, 22)),
        slab(foot, 12, ACCENT, plane="yz"),
        box(10, 54, 18, ACCENT, at=(0, 0, 27)),
        *(cylinder(6, 11.4, DARK, sides=8).turn("y", 90).move(-5.7, y, 26) for y in (-14.0, 14.0)),
    ]


def chair() -> list[Solid]:
    back = [(-22.0, 20.0), (-12.0, 20.0), (-33.0, 70.0), (-43.0, 70.0)]
    cushion = [(-15.5, 30.0), (-10.5, 32.0), (-26.0, 66.0), (-31.0, 64.0)]
    return [
        box(62, 55, 7, MAIN, at=(12, 0, 26)),
        box(52, 44, 5, ACCENT, at=(16, 0, 31.5)),
        slab(back, 55, MAIN, plane="xz"),
        slab(cushion, 44, ACCENT, plane="xz"),
        *both_sides(
            box(7, 7, 24, ACCENT, at=(38, 23, 12)),
            rod((-14, 23, 24), (-24, 23, 0), 4.5, ACCENT, sides=4),
            box(50, 6, 5, ACCENT, at=(9, 24, 46)),
            box(6, 5, 20, MAIN, at=(30, 24, 36)),
        ),
    ]


def cherries() -> list[Solid]:
    leaf = [(0.0, 33.0), (8.0, 37.5), (20.0, 33.0), (9.0, 27.0)]
    return both_sides(
        ellipsoid((10.5, 10.5, 10.5), MAIN, at=(0, 11, 10.5), sides=8, rings=3),
        tube([(0, 11, 19), (0, 6, 28), (0, 0.2, 35)], 1.7, ACCENT, sides=4),
        slab(leaf, 3.4, ACCENT, plane="yz").turn("z", 14),
    )


def cow() -> list[Solid]:
    return [
        box(56, 22, 22, MAIN, at=(-9, 0, 32)),
        box(17, 24, 17, ACCENT, at=(-23, 0, 36)),
        box(15, 24, 17, ACCENT, at=(4, 0, 33)),
        box(12, 12, 6, ACCENT, at=(-22, 0, 20)),
        block((18, 14), (14, 13), 18, MAIN, at=(29, 0, 33)),
        block((14, 16), (12, 14), 10, ACCENT, at=(40, 0, 31)),
        rod((-36, 0, 41), (-44, 0, 24), 1.8, MAIN, sides=4),
        ellipsoid((3, 3, 6), ACCENT, at=(-44, 0, 20), sides=5, rings=2),
        *both_sides(
            rod((27, 4, 49), (28, 12.5, 57), 2.4, ACCENT, sides=4, end_radius=1),
            box(5, 6, 4, MAIN, at=(26, 9, 46)),
            box(8, 7, 24, MAIN, at=(13, 7, 12)),
            box(8, 7, 24, MAIN, at=(-31, 7, 12)),
            box(9, 8, 6, ACCENT, at=(13, 7, 3)),
            box(9, 8, 6, ACCENT, at=(-31, 7, 3)),
        ),
    ]


def flower() -> list[Solid]:
    petals = circle(13.5, 12)
    petals[1::2] *= 0.68
    back = petals * (0.8, 0.8, 1) + (0, 0, -3)
    blossom = [
        loft([[(0, 0, -4)], back, petals, [(0, 0, 1)]]),
        ellipsoid((5.6, 5.6, 4), ACCENT, at=(0, 0, 1), sides=7, rings=2),
    ]
    leaf = [(0.0, 0.0), (8.0, -6.0), (16.0, 0.0), (8.0, 6.0)]
    return [
        *(solid.turn("y", 70).move(3, 0, 30) for solid in blossom),
        rod((0, 0, 0), (0, 0, 30), 3.0, ACCENT, sides=4),
        *(slab(leaf, 3, ACCENT).turn("y", -45).turn("z", a).move(0, 0, 3) for a in (60, 240)),
    ]


def fork() -> list[Solid]:
    head = [(-2.0, 22), (2.0, 22), (4.4, 27), (4.4, 32), (-4.4, 32), (-4.4, 27)]
    return [
        slab(head, 4, MAIN, plane="yz"),
        *both_sides(block((3.6, 2.6), (2.6, 2.2), 21, MAIN, at=(0, 3.1, 31))),
        block((4, 5.6), (3.6, 4), 20, ACCENT),
        block((3.2, 3.6), (3.2, 3.6), 8, MAIN, at=(0, 0, 19)),
    ]


def fridge() -> list[Solid]:
    return [
        box(21, 24, 56, DARK, at=(-2, 0, 31)),
        box(22, 26, 34, MAIN, at=(-3, 0, 20)),
        box(22, 26, 22, ACCENT, at=(-3, 0, 49)),
        box(5, 25, 33, MAIN, at=(10, 0, 20)),
        box(5, 25, 21, ACCENT, at=(10, 0, 49)),
        box(3, 3, 14, DARK, at=(13, 8, 27)),
        box(3, 3, 10, DARK, at=(13, 8, 47)),
        *both_sides(box(5, 5, 4, DARK, at=(8, 9, 2)), box(5, 5, 4, DARK, at=(-9, 9, 2))),
    ]


def guitar() -> list[Solid]:
    half = [(0, 0), (18, 1), (28, 13), (27, 26), (17, 40), (23, 53), (17, 66), (0, 70)]
    outline = [*half, *((-y, z) for y, z in half[-2:0:-1])]
    head = [(-6, 134), (6, 134), (11, 165), (-11, 165)]
    return [
        slab(outline, 7, MAIN, plane="yz"),
        box(6, 10, 70, ACCENT, at=(0.6, 0, 102)),
        box(2, 10, 24, ACCENT, at=(4, 0, 62)),
        slab(head, 5, ACCENT, plane="yz", at=(0.6, 0, 0)),
        cylinder(9, 1, DARK, sides=8).turn("y", 90).move(3, 0, 41),
        box(2, 26, 7, ACCENT, at=(4, 0, 17)),
        *both_sides(*(box(3, 8, 4, MAIN, at=(0.6, 11, z)) for z in (144, 156))),
    ]


def hair_brush() -> list[Solid]:
    back = [
        (-22.0, 38.0),
        (-12.0, 38.0),
        (-6.0, 46.0),
        (-6.0, 109.0),
        (-20.0, 109.0),
        (-29.0, 98.0),
    ]
    grip = [(-23.0, 0.0), (-11.0, 0.0), (-9.0, 6.0), (-13.0, 40.0), (-21.0, 40.0), (-25.0, 6.0)]
    bristles = [block((3, 7), (2, 5), 37, ACCENT).turn("x", -90) for _ in range(5)]
    return [
        slab(back, 4, MAIN, plane="yz"),
        slab(grip, 4, MAIN, plane="yz"),
        *(tooth.move(0, -7, 53 + 12.5 * i) for i, tooth in enumerate(bristles)),
    ]


def hammer() -> list[Solid]:
    claw = [(-3, 24), (-3, 31), (-6, 31), (-9.5, 26), (-9.5, 22), (-6, 25)]
    return [
        lathe([(4, 0), (4.2, 5), (3, 14), (3, 30)], ACCENT, sides=6),
        box(8.6, 8, 10, MAIN, at=(0, 0, 27)),
        lathe([(4, 0), (5.2, 2.4), (5.2, 7)], MAIN, sides=8).turn("x", -90).move(0, 2.5, 27),
        *(slab(claw, 3.2, MAIN, plane="yz", at=(x, 0, 0)) for x in (-2.4, 2.4)),
    ]


def hat() -> list[Solid]:
    brim = [(0, 1), (22, 0), (31.5, 6), (31.5, 8), (20, 4), (0, 4)]
    crown = [(18, 2), (18.4, 18), (17, 33), (13, 37), (9, 32), (0, 31)]
    return [
        lathe(brim, MAIN, sides=14).stretch(x=0.8),
        lathe(crown, [ACCENT, *[MAIN] * 4], sides=12).stretch(x=0.8),
    ]


def ice_lolly() -> list[Solid]:
    def slice_at(z: float, y: float, x: float) -> np.ndarray:
        corners = np.array([(1, -0.6), (1, 0.6), (0.5, 1), (-0.5, 1)])
        return np.column_stack([np.concatenate([corners, -corners]) * (x, y), np.full(8, z)])

    ice = [(19, 12, 6.5), (21, 14, 8), (40, 14, 8), (52, 13, 7.6), (59, 9, 6), (62, 4, 3)]
    return [
        loft([slice_at(*row) for row in ice], [MAIN, MAIN, ACCENT, ACCENT, ACCENT]),
        box(4, 7, 22, WOOD, at=(0, 0, 11)),
    ]


def jug() -> list[Solid]:
    clay = [
        (0, 0), (9, 0), (13, 7), (14, 14), (12, 21), (8, 28), (7.5, 32), (9.5, 41), (8, 41),
        (5.5, 32), (0, 30),
    ]  # fmt: skip
    parts = [ACCENT, ACCENT, MAIN, MAIN, MAIN, MAIN, ACCENT, ACCENT, DARK, DARK]
    handle = [(0, 7, 37), (0, 15, 38), (0, 19, 31), (0, 17, 22), (0, 11, 15)]
    lip = [(-6.0, 33.0), (-15.5, 41.0), (-8.0, 41.0)]
    return [
        lathe(clay, parts),
        tube(np.array(handle, dtype=float), 2.2, ACCENT, sides=5),
        slab(lip, 7, ACCENT, plane="yz", at=(0, 0, -0.4)),
    ]


def key() -> list[Solid]:
    return [
        torus(12.8, 4.7, MAIN, around=12, sides=4).turn("y", 90).move(0, 0, 44.5),
        cylinder(3.4, 32, ACCENT, sides=6),
        box(6.4, 12, 6, ACCENT, at=(0, 9, 3)),
        box(6.4, 9, 5, ACCENT, at=(0, 7, 14)),
        cylinder(4.8, 4, MAIN, at=(0, 0, 26), sides=6),
    ]


def knife() -> list[Solid]:
    blade = [(-2.2, 21), (3.2, 21), (3.2, 46), (1.0, 51), (-1.6, 53), (-2.2, 45)]
    return [
        slab(blade, 2.4, MAIN, plane="yz"),
        block((4, 5.4), (3.6, 4.4), 20, ACCENT),
        box(3.4, 5.8, 2.4, ACCENT, at=(0, 0, 20.5)),
    ]


def ladder() -> list[Solid]:
    steps = [box(6, 40 - 2 * i, 4.4, ACCENT, at=(8.0 - 1.5 * i, 0, 13 + 18 * i)) for i in range(5)]
    return [
        *steps,
        box(12, 34, 5, ACCENT, at=(0, 0, 103.5)),
        box(2, 42, 4, MAIN, at=(-8, 0, 24)),
        *both_sides(
            rod((8, 22, 0), (1, 15, 103), 3.4, MAIN, sides=4),
            rod((-8, 22, 0), (-1, 15, 103), 2.8, MAIN, sides=4),
        ),
    ]


def mug() -> list[Solid]:
    wall = [(0, 0), (16, 0), (16, 9), (16, 22), (16, 34), (13.5, 34), (13, 6), (0, 6)]
    handle = arc(10, -85, 85, 6, plane="yz", at=(0, 14.5, 17))
    return [
        lathe(wall, [MAIN, MAIN, ACCENT, MAIN, MAIN, DARK, DARK], sides=12),
        tube(handle, 2.9, ACCENT, sides=5),
    ]


def pencil() -> list[Solid]:
    shaft = [(0, 0), (1.9, 5), (6, 16), (6, 43), (6.6, 44), (6.6, 49), (6, 50), (6, 64), (4, 66)]
    lead = lathe(shaft, [DARK, WOOD, MAIN, *[ACCENT] * 5], sides=6)
    return [lead.turn("x", -45)]


def pig() -> list[Solid]:
    barrel = [(0, -27), (8, -25), (11.5, -15), (12, -3), (11.5, 9), (8.5, 17), (0, 20)]
    body = lathe(barrel, [MAIN, MAIN, MAIN, ACCENT, MAIN, MAIN], sides=8)
    tail = [(-26, 0, 25), (-31, 0, 28), (-33, 0, 25), (-31, 0, 23), (-30, 0, 26)]
    return [
        body.turn("y", 90).move(0, 0, 22),
        ellipsoid((11, 9, 9.5), MAIN, at=(20, 0, 25), sides=7, rings=2),
        cylinder(5.4, 7, ACCENT, sides=7, top=4.8).turn("y", 90).move(28, 0, 23),
        tube(np.array(tail, dtype=float), 1.5, ACCENT, sides=3),
        *both_sides(
            slab([(13.0, 28.0), (22.0, 30.0), (20.0, 41.0)], 5, ACCENT, plane="xz", at=(0, 6, 0)),
            block((6, 6), (8, 7), 14, ACCENT, at=(11, 6.5, 0)),
            block((6, 6), (8, 7), 14, ACCENT, at=(-16, 6.5, 0)),
            box(2, 2.4, 3, DARK, at=(28, 4.4, 29)),
        ),
    ]


def pincer() -> list[Solid]:
    jaw = [(0, -1.5, 22), (0, 3, 27), (0, 5, 32), (0, 4.6, 38), (0, 0.9, 44)]
    handle = [(0, 1.5, 24), (0, -2.4, 17), (0, -4.8, 8), (0, -5, 0)]
    return [
        *both_sides(
            tube(np.array(jaw, dtype=float), [1.2, 1.8, 1.9, 1.8, 1.2], MAIN, sides=4),
            tube(np.array(handle, dtype=float), [1.2, 1.5, 1.8, 1.8], ACCENT, sides=4),
        ),
        cylinder(2.4, 4, DARK, sides=6).turn("y", 90).move(-2, 0, 23.5),
    ]


def plant() -> list[Solid]:
    leaf = [
        (0.0, -1.6),
        (9.0, -5.0),
        (15.0, -4.2),
        (21.0, 0.0),
        (15.0, 4.2),
        (9.0, 5.0),
        (0.0, 1.6),
    ]
    pot = [(0, 0), (8.5, 0), (10.5, 11), (12, 11), (12, 16), (0, 16)]
    blades = [(20, -32), (92, -48), (164, -30), (236, -46), (308, -36), (60, -80)]
    return [
        lathe(pot, [*[MAIN] * 4, DARK], sides=8),
        *(
            slab(leaf, 2.6, ACCENT).turn("y", tilt).turn("z", angle).move(0, 0, 15)
            for angle, tilt in blades
        ),
    ]


def saxophone() -> list[Solid]:
    path = [
        (-18, 55), (-14, 60), (-8, 62), (-4.5, 57), (-4, 44), (-4, 28), (-3.4, 13), (1, 5),
        (8, 4.5), (12, 12), (13, 24), (14, 34),
    ]  # fmt: skip
    radii = [1.8, 2.0, 2.0, 2.3, 2.8, 3.4, 4.1, 4.6, 4.7, 4.6, 5.2, 7.6]
    parts = [*[ACCENT] * 3, *[MAIN] * 6, *[ACCENT] * 2]
    return [
        tube(np.array([(0, y, z) for y, z in path], dtype=float), radii, parts, sides=6),
        *(box(7, 5, 4, ACCENT, at=(0, -7.4, z)) for z in (20, 30, 40)),
    ]


def shoe() -> list[Solid]:
    upper = [(-28, 5), (29, 5), (29, 12), (22, 17), (6, 21), (-3, 35), (-25, 35), (-29, 22)]
    sole = [(-30, -9), (-24, -12), (8, -13), (24, -11), (30, -5)]
    outline = [*sole, *((x, -y) for x, y in sole[::-1])]
    flash = [(-24.0, 9.0), (-12.0, 9.0), (4.0, 19.0), (-2.0, 27.0)]
    return [
        slab(upper, 20, MAIN, plane="xz"),
        slab(outline, 7, ACCENT, at=(0, 0, 3.5)),
        slab(flash, 22, ACCENT, plane="xz"),
        box(17, 14, 2, DARK, at=(-14, 0, 34.4)),
        *(box(3.4, 16, 3, ACCENT, at=(x, 0, z)).turn("y", 0) for x, z in ((9, 20.6), (15, 19))),
        box(7, 21, 6, ACCENT, at=(26.5, 0, 9)),
    ]


def spoon() -> list[Solid]:
    handle = [(2.0, 0.0, 0.0), (1.4, 0.0, 10.0), (0.0, 0.0, 26.0), (0.6, 0.0, 36.0)]
    return [
        ellipsoid((2.4, 6.5, 10), MAIN, at=(0, 0, 41), sides=8, rings=3),
        tube(np.array(handle), [2.4, 2.2, 1.8, 1.8], [ACCENT, ACCENT, MAIN], sides=5).stretch(
            y=1.5
        ),
    ]


def suitcase() -> list[Solid]:
    return [
        box(26, 64, 44, MAIN, at=(0, 0, 23)),
        box(16, 66, 26, ACCENT, at=(0, 0, 23)),
        *(box(28, 12, 45.6, ACCENT, at=(0, y, 23)) for y in (-19.0, 19.0)),
        tube(arc(12, 0, 180, 6, plane="yz", at=(0, 0, 42)), 2.4, ACCENT, sides=5),
        *both_sides(
            box(8, 10, 3, DARK, at=(0, 26, 1)),
            box(3, 8, 7, DARK, at=(13, 19, 38)),
        ),
    ]


def tennis_racket() -> list[Solid]:
    loop = circle(1.0, 14)[:, [2, 0, 1]] * (0, 10.2, 15) + (0, 0, 43)
    strings = []
    for offset in (-0.5, 0.0, 0.5):
        reach = float(np.sqrt(1 - offset**2))
        y, z = 10.2 * reach, 15 * reach
        strings.append(
            rod((0, 10.2 * offset, 43 - z), (0, 10.2 * offset, 43 + z), 0.8, ACCENT, sides=3)
        )
        strings.append(
            rod((0, -y, 43 + 15 * offset), (0, y, 43 + 15 * offset), 0.8, ACCENT, sides=3)
        )
    return [
        tube(loop, 1.9, MAIN, sides=4, closed=True),
        *strings,
        *both_sides(rod((0, 6, 31), (0, 0.4, 19), 1.5, MAIN, sides=4)),
        block((4, 6), (4, 4.6), 21, ACCENT),
    ]


def tomato() -> list[Solid]:
    def ring(radius: float, z: float) -> np.ndarray:
        points = circle(radius, 12, z)
        points[1::2, :2] *= 0.93
        return points

    flesh = [(8, 0), (15, 4), (17, 11), (15, 18), (9, 21)]
    calyx = circle(19, 10, 14.5, start=9)
    calyx[1::2] = calyx[1::2] * (0.5, 0.5, 1) + (0, 0, 9.4)
    return [
        loft([[(0, 0, 1)], *(ring(*row) for row in flesh), [(0, 0, 19)]]),
        loft([[(0, 0, 17)], calyx, [(0, 0, 24.5)]], ACCENT),
        rod((0, 0, 22), (1, 0, 27), 1.8, ACCENT, sides=4),
    ]


def toothbrush() -> list[Solid]:
    shaft = [(0, 0, 0), (0, 0, 14), (0, 0, 36), (0, 0, 44), (0, 0, 53)]
    parts = [ACCENT, ACCENT, ACCENT, MAIN]
    tuft = block((6, 8), (5.4, 7), 12, MAIN).turn("x", -90)
    brush = [
        tube(np.array(shaft, dtype=float), [3.4, 4.0, 3.6, 2.6, 2.8], parts, sides=6),
        box(6.6, 6, 28, MAIN, at=(0, 0, 65)),
        *(tuft.move(0, 2, 56 + 9.0 * i) for i in range(3)),
    ]
    return [solid.turn("x", 20) for solid in brush]


def tree() -> list[Solid]:
    tiers = [(24, 13, 31, MAIN), (19.5, 25, 42, ACCENT), (14, 36, 52, MAIN)]
    return [
        cylinder(7, 16, ACCENT, sides=7, top=6),
        *(cone(r, top - low, part, at=(0, 0, low), sides=9) for r, low, top, part in tiers),
    ]


def tv() -> list[Solid]:
    back = block((36, 48), (26, 34), 16, ACCENT).turn("y", -90).move(-4, 0, 31)
    return [
        box(25, 57, 42, MAIN, at=(8, 0, 31)),
        back,
        box(3, 50, 35, ACCENT, at=(19.5, 0, 31)),
        box(2, 34, 27, DARK, at=(20.8, -5, 31)),
        *(box(3, 6, 6, MAIN, at=(21, 18, z)) for z in (38, 28)),
        *both_sides(
            rod((2, 1, 51), (2, 20, 70), 1.7, ACCENT, sides=4),
            rod((16, 18, 12), (18, 23, 0), 3, ACCENT, sides=4),
            rod((0, 18, 12), (-4, 23, 0), 3, ACCENT, sides=4),
        ),
    ]


def wine_glass() -> list[Solid]:
    glass = [
        (0, 0), (12, 0), (12, 3), (3.6, 7), (3, 23), (6, 26), (12, 34), (12.5, 43), (10, 54),
        (9, 54), (10.5, 44), (0, 40),
    ]  # fmt: skip
    return [lathe(glass, [*[ACCENT] * 4, *[MAIN] * 5, ACCENT, ACCENT])]


def zebra() -> list[Solid]:
    trunk = np.array([(x, 0, 42) for x in (-31, -23, -15, -7, 1, 9, 16)], dtype=float)
    stripes = [MAIN, ACCENT] * 3
    neck = np.array([(12, 0, 44), (17, 0, 51), (21, 0, 57), (25, 0, 63), (28, 0, 68)], dtype=float)
    mane = [(7.0, 53.0), (14.0, 51.0), (29.0, 72.0), (24.0, 75.0)]

    def leg(x: float) -> Solid:
        path = [(x, 5.4, 38.0), (x, 5.4, 20.0), (x, 5.4, 0.0)]
        return tube(path, [4.2, 4.0, 3.8], [MAIN, ACCENT], sides=4)

    return [
        tube(trunk, [7, 9.6, 9.8, 9.6, 9.6, 9.4, 6], stripes, sides=5),
        tube(neck, [8, 7, 6.2, 5.8, 5], [ACCENT, MAIN, ACCENT, MAIN], sides=4),
        slab(mane, 4, ACCENT, plane="xz"),
        block((9, 9), (7, 7), 15, MAIN).turn("y", 112).move(25, 0, 68),
        box(6, 8, 7, ACCENT, at=(40, 0, 61)),
        rod((-30, 0, 46), (-38, 0, 28), 1.8, ACCENT, sides=4),
        *both_sides(
            rod((27, 4, 71), (26, 6, 77), 2.2, MAIN, sides=4, end_radius=0),
            leg(-24),
            leg(10),
        ),
    ]


OBJECTS = {
    "apple2": (apple2, (40, 39, 37)),
    "ball": (ball, (36, 36, 36)),
    "balloon": (balloon, (45, 45, 60)),
    "banana": (banana, (19, 62, 30)),
    "bottle": (bottle, (20, 19, 54)),
    "cake": (cake, (53, 53, 23)),
    "can": (can, (40, 40, 51)),
    "car": (car, (97, 48, 44)),
    "cassette": (cassette, (12, 68, 43)),
    "chair": (chair, (86, 55, 70)),
    "cherries": (cherries, (21, 43, 37)),
    "cow": (cow, (94, 25, 57)),
    "flower": (flower, (19, 27, 44)),
    "fork": (fork, (4, 8, 52)),
    "fridge": (fridge, (28, 26, 60)),
    "guitar": (guitar, (9, 56, 165)),
    "hair_brush": (hair_brush, (4, 59, 109)),
    "hammer": (hammer, (10, 19, 32)),
    "hat": (hat, (50, 63, 37)),
    "ice_lolly": (ice_lolly, (16, 28, 62)),
    "jug": (jug, (28, 33, 41)),
    "key": (key, (7, 35, 62)),
    "knife": (knife, (4, 6, 53)),
    "ladder": (ladder, (20, 50, 106)),
    "mug": (mug, (32, 43, 34)),
    "pencil": (pencil, (11, 54, 54)),
    "pig": (pig, (68, 23, 39)),
    "pincer": (pincer, (4, 12, 45)),
    "plant": (plant, (30, 34, 34)),
    "saxophone": (saxophone, (13, 37, 64)),
    "shoe": (shoe, (60, 26, 35)),
    "spoon": (spoon, (4, 13, 51)),
    "suitcase": (suitcase, (28, 66, 56)),
    "tennis_racket": (tennis_racket, (4, 24, 60)),
    "tomato": (tomato, (34, 33, 27)),
    "toothbrush": (toothbrush, (7, 41, 74)),
    "tree": (tree, (48, 48, 52)),
    "tv": (tv, (41, 57, 71)),
    "wine_glass": (wine_glass, (25, 25, 54)),
    "zebra": (zebra, (83, 18, 75)),
}
"""The makers by name, with the size along x, y and z in hundredths of a metre."""
