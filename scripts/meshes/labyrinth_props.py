"""What else stands in Zipf's Labyrinth: rewards, stands, natural things, and what laser tag needs.

Lengths are centimetres.
"""

from dataclasses import replace

import numpy as np

from .labyrinth_objects import ice_lolly, key
from .shapes import (
    ACCENT,
    DARK,
    MAIN,
    Solid,
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
from .toys import both_sides


def apple() -> list[Solid]:
    flesh = [(0, 3), (4, 0), (10, 4), (12.5, 10), (12, 16), (8, 21.5), (4, 22.5), (0, 19)]
    leaf = [(0.0, 0.0), (6.0, -4.5), (12.0, 0.0), (6.0, 4.5)]
    leaves = [slab(leaf, 2.2, ACCENT).turn("y", -20).turn("z", angle) for angle in (70, 250)]
    return [
        lathe(flesh, [*[MAIN] * 6, ACCENT]),
        rod((0, 0, 18), (-1, 0, 30), 1.8, ACCENT, sides=5, end_radius=2.2),
        *(solid.move(z=23) for solid in leaves),
    ]


def goal() -> list[Solid]:
    """A trophy: a cup with two handles, and a star on it."""
    cup = [(0, 0), (9.5, 0), (9, 3), (2.8, 5), (2.8, 8), (8, 11), (10.5, 19), (0, 19)]
    star = circle(8, 10, start=90)
    star[1::2] *= 0.45
    outline = [(float(y), float(z)) for y, z, _ in star]
    handle = np.array([(0, 8, 18), (0, 13, 19), (0, 14.4, 14), (0, 6, 10)])
    return [
        lathe(cup, [*[ACCENT] * 4, *[MAIN] * 3], sides=10),
        *both_sides(tube(handle, 1.8, ACCENT, sides=4)),
        *(slab(outline, 3, ACCENT, plane=p, at=(0, 0, 25)) for p in ("yz", "xz")),
    ]


def mushroom() -> list[Solid]:
    cap = [(0, 12), (9, 10.5), (9.8, 13), (8.4, 18), (5.5, 22.5), (0, 25)]
    return [
        lathe([(5, 0), (3.6, 2.5), (3.2, 8), (4, 13)], ACCENT, sides=7),
        lathe(cap, [ACCENT, *[MAIN] * 4], sides=10),
    ]


def teleport_pad() -> list[Solid]:
    rim = [(0, 0), (24, 0), (24, 4), (21, 8), (17, 8), (15, 4), (8, 4), (7, 6.5), (0, 6.5)]
    return [lathe(rim, [*[MAIN] * 4, ACCENT, ACCENT, MAIN, MAIN], sides=12)]


def item_stand() -> list[Solid]:
    plate = [(0, 0), (25, 0), (25, 4), (20, 4), (17, 8), (0, 8)]
    return [lathe(plate, [ACCENT, ACCENT, ACCENT, MAIN, MAIN], sides=12)]


def crate() -> list[Solid]:
    beams = [box(32, 5, 5, ACCENT, at=(0, y, z)) for y in (-13.5, 13.5) for z in (-13.5, 13.5)]
    turned = [beam.turn(axis, 90) for axis in ("y", "z") for beam in beams]
    return [box(30, 30, 30), *beams, *turned]


def cactus() -> list[Solid]:
    trunk = lathe([(0, 0), (20, 0), (25, 60), (25, 200), (20, 270), (8, 298), (0, 300)], sides=8)
    across = trunk.vertices[trunk.triangles].mean(axis=1)
    ribs = np.floor(np.degrees(np.arctan2(across[:, 1], across[:, 0])) / 45 - 0.5).astype(int) % 2
    left = np.array([(0, -15, 110), (0, -36, 112), (0, -40, 130), (0, -40, 190), (0, -38, 215)])
    right = np.array([(0, 15, 70), (0, 34, 72), (0, 39, 90), (0, 39, 150), (0, 37, 172)])
    parts = [MAIN, MAIN, ACCENT, MAIN]
    return [
        replace(trunk, parts=np.where(ribs == 1, ACCENT, MAIN)),
        *(tube(arm, [9, 10, 11.5, 11, 4], parts, sides=6) for arm in (left, right)),
    ]


def _lump(seed: float, squash: float) -> Solid:
    """A boulder on flat ground; `seed` shifts its bumps."""
    ball = ellipsoid((1, 1, 1), sides=9, rings=5)
    x, y, z = ball.vertices.T
    bumps = np.sin(3.1 * x + seed) + np.sin(2.7 * y - 2 * seed) + np.sin(3.7 * z + 3 * seed)
    vertices = ball.vertices * (1 + 0.13 * bumps)[:, None]
    vertices[:, 2] = np.maximum(vertices[:, 2], -0.55) * squash
    return replace(ball, vertices=vertices)


def _rock(kind: int) -> list[Solid]:
    rock = _lump(1.0 + 2.0 * kind, (0.9, 0.7, 1.0)[kind])
    x, y, z = rock.vertices[rock.triangles].mean(axis=1).T
    accent = (z > 0.34, np.sin(7 * z + 1.3 * x) > 0.2, np.sin(4 * x + 1) * np.sin(4 * y) > 0.1)[
        kind
    ]
    return [replace(rock, parts=np.where(accent, ACCENT, MAIN))]


def rock_0() -> list[Solid]:
    return _rock(0)


def rock_1() -> list[Solid]:
    return _rock(1)


def rock_2() -> list[Solid]:
    return _rock(2)


def bush_0() -> list[Solid]:
    """Seven tufts."""
    tufts = [(28.0, angle, 22.0, 22.0) for angle in range(0, 360, 60)] + [(0.0, 0, 34.0, 28.0)]
    return [
        ellipsoid((radius, radius, radius), part, sides=6, rings=2)
        .turn("x", 20)
        .move(out, 0, height)
        .turn("z", angle)
        for (out, angle, height, radius), part in zip(
            tufts, [MAIN, ACCENT] * 3 + [MAIN], strict=True
        )
    ]


def bush_1() -> list[Solid]:
    """Spiky leaves in two circles."""
    leaf = block((3, 9), (1, 1), 56, MAIN)
    circles = [(8, 62, 0.0, MAIN), (8, 38, 22.5, ACCENT), (3, 12, 0.0, MAIN)]
    return [
        replace(leaf, parts=np.full_like(leaf.parts, part))
        .turn("y", tilt)
        .move(2)
        .turn("z", phase + 360 / count * i)
        for count, tilt, phase, part in circles
        for i in range(count)
    ]


def platform() -> list[Solid]:
    return [box(126, 126, 84, ACCENT, at=(0, 0, 42)), box(128, 128, 10, MAIN, at=(0, 0, 89))]


def robot() -> list[Solid]:
    """A player of laser tag up to the neck: a round trunk on two boots, its gadget in front."""
    trunk = [(0, 9), (10, 9), (14, 16), (14.6, 22), (13.4, 33), (6, 38.5), (0, 38.5)]
    parts = [ACCENT, ACCENT, MAIN, ACCENT, ACCENT, ACCENT]
    return [
        lathe(trunk, parts, sides=8),
        cylinder(4, 3, DARK, at=(0, 0, 37.8), sides=5),
        box(22, 6, 6, DARK, at=(6, -14, 25)),
        box(6, 7.6, 7.6, MAIN, at=(15, -14, 25)),
        box(9, 5, 14, MAIN, at=(0, 15, 26)),
        box(9, 5, 6, MAIN, at=(-2, -14.8, 31.4)),
        *both_sides(
            box(6, 6, 6, DARK, at=(0, 6.4, 9)),
            block((21, 12), (15, 10), 9, MAIN, at=(1, 7, 0)),
        ),
    ]


def robot_head() -> list[Solid]:
    """A round helmet with a bright visor, two eyes, ears and an antenna with a ball."""
    helmet = [(0, 0), (7, 0), (10.4, 5), (9.4, 11), (5, 15), (0, 15.6)]
    return [
        lathe(helmet, MAIN, sides=8),
        box(5, 13, 6.4, ACCENT, at=(8, 0, 7.4)),
        *both_sides(
            box(2, 3.2, 4, DARK, at=(10.2, 3.1, 7.4)),
            box(6, 4, 6, ACCENT, at=(0, 10.4, 7)),
        ),
        box(4, 9, 5, ACCENT, at=(-9, 0, 6)),
        box(1.6, 1.6, 6, DARK, at=(0, 0, 17)),
        ellipsoid((2.8, 2.8, 2.8), ACCENT, at=(0, 0, 20.2), sides=5, rings=1),
    ]


def bolt() -> list[Solid]:
    """What is seen of a shot: a spindle with a bright core."""
    widths = [(-22.0, 2.4), (-8.0, 3.0), (8.0, 3.0), (22.0, 2.4)]
    rings = [circle(r, 6, x)[:, [2, 0, 1]] for x, r in widths]
    ends = [np.array([(x, 0.0, 0.0)]) for x in (-30, 30)]
    return [loft([ends[0], *rings, ends[1]], [ACCENT, ACCENT, MAIN, ACCENT, ACCENT])]


def orb() -> list[Solid]:
    ring = torus(8.6, 1.9, ACCENT, around=9, sides=3)
    return [
        ellipsoid((8.2, 8.2, 8.2), sides=8, rings=3),
        ring,
        ring.turn("x", 90),
    ]


def beam_gadget() -> list[Solid]:
    """Two prongs about an emitter."""
    return [
        box(14, 14, 10, MAIN, at=(-7, 0, 13)),
        block((6, 5), (7, 6), 9, DARK, at=(-9, 0, 0)),
        box(6, 26, 6, ACCENT, at=(-4, 0, 14)),
        cone(5, 12, MAIN, sides=6).turn("y", 90).move(0, 0, 13),
        box(10, 3, 4, ACCENT, at=(-8, 0, 19)),
        *both_sides(rod((-7, 12, 14), (16, 12, 14), 3.2, ACCENT, sides=6, end_radius=2)),
    ]


def disc_gadget() -> list[Solid]:
    """A large disc on a grip."""
    disc = [(0, 10), (8, 10), (15, 12.5), (15, 14.5), (9, 17), (8, 17), (6, 20), (0, 20)]
    parts = [ACCENT, ACCENT, ACCENT, ACCENT, MAIN, MAIN, MAIN]
    return [
        lathe(disc, parts, sides=12),
        block((9, 9), (6, 6), 11, MAIN),
    ]


def orb_gadget() -> list[Solid]:
    """A ball in a wide funnel, with side wings."""
    funnel = [(0, -15), (5, -15), (6, -4), (10, 8), (8, 8), (4, -2), (0, -2)]
    return [
        lathe(funnel, [*[MAIN] * 4, DARK, DARK], sides=8).turn("y", 90).move(0, 0, 11),
        ellipsoid((7, 7, 7), ACCENT, at=(8, 0, 11), sides=7, rings=3),
        box(8, 30, 3, ACCENT, at=(-8, 0, 11)),
        block((6, 5), (6, 5), 8, DARK, at=(-8, 0, 0)),
    ]


def health_pack() -> list[Solid]:
    """A box with a cross on every side."""
    return [
        box(28, 28, 18, MAIN, at=(0, 0, 9.6)),
        box(30, 8, 13, ACCENT, at=(0, 0, 9.6)),
        box(29, 21, 5.4, ACCENT, at=(0, 0, 9.6)),
        box(8, 30, 13, ACCENT, at=(0, 0, 9.6)),
        box(21, 29, 5.4, ACCENT, at=(0, 0, 9.6)),
        box(22, 8, 20, ACCENT, at=(0, 0, 10)),
        box(8, 22, 19.4, ACCENT, at=(0, 0, 10)),
    ]


def armour_pack() -> list[Solid]:
    """A vest with shoulder plates."""
    vest = [(-9.0, 0.0), (9.0, 0.0), (11.0, 12.0), (7.0, 18.0), (4.0, 13.0), (-4.0, 13.0)]
    outline = [*vest, (-7.0, 18.0), (-11.0, 12.0)]
    stripe = [(-7.0, 2.0), (0.0, 6.0), (7.0, 2.0), (7.0, 6.0), (0.0, 10.0), (-7.0, 6.0)]
    return [
        slab(outline, 22, MAIN, plane="yz"),
        slab(stripe, 24, ACCENT, plane="yz"),
        *both_sides(
            block((26, 8), (18, 6), 7, ACCENT, at=(0, 11, 13)),
            box(14, 4, 5, ACCENT, at=(0, 9.6, 4)),
        ),
    ]


def puff() -> list[Solid]:
    """A burst: spikes in the six directions of the axes and the eight between."""
    solids = [ellipsoid((9, 9, 9), ACCENT, sides=6, rings=2)]
    for axis, turns in (("y", (0, 90, 180, 270)), ("x", (90, 270))):
        solids += [cone(6, 20, MAIN, sides=4).turn(axis, turn) for turn in turns]
    for tilt in (54.7, 125.3):
        for angle in (45, 135, 225, 315):
            solids.append(cone(5.4, 20, ACCENT, sides=4).turn("y", tilt).turn("z", angle))
    return solids


OBJECTS = {
    "apple": (apple, (25, 25, 30)),
    "goal": (goal, (25, 25, 33)),
    "key_large": (key, (10, 47, 82)),
    "ice_lolly_large": (ice_lolly, (23, 43, 92)),
    "mushroom": (mushroom, (19, 18, 25)),
    "teleport_pad": (teleport_pad, (48, 48, 8)),
    "item_stand": (item_stand, (50, 45, 8)),
    "box": (crate, (32, 32, 32)),
    "cactus": (cactus, (50, 100, 300)),
    "rock_0": (rock_0, (100, 90, 70)),
    "rock_1": (rock_1, (100, 90, 70)),
    "rock_2": (rock_2, (100, 90, 70)),
    "bush_0": (bush_0, (100, 100, 60)),
    "bush_1": (bush_1, (100, 100, 60)),
    "platform": (platform, (128, 128, 94)),
    "robot": (robot, (30, 30, 40)),
    "robot_head": (robot_head, (26, 26, 23)),
    "bolt": (bolt, (60, 6, 6)),
    "orb": (orb, (20, 20, 20)),
    "beam_gadget": (beam_gadget, (30, 30, 20)),
    "disc_gadget": (disc_gadget, (30, 30, 20)),
    "orb_gadget": (orb_gadget, (30, 30, 20)),
    "health_pack": (health_pack, (30, 30, 20)),
    "armour_pack": (armour_pack, (30, 30, 20)),
    "puff": (puff, (40, 40, 40)),
}
"""The makers by name, with the size along x, y and z in hundredths of a metre."""
