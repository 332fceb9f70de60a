"""The looks of a room that `looks="varied"` draws anew for every episode.

They change what is shown and nothing else: the light, the textures of walls and floor, and how
large toys are drawn.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.pcg64 import below, between
from zipf.envs.render3d import textures

WALLS = ("wallpaper", "wallpaper_blue", "stripes", "stripes_green")
"""The textures of the four walls of a plain room, counter-clockwise from the south: they differ, so
that they show the direction."""
FLOOR = "planks"

# Ours. No texture is so dark or so coloured that toys are hard to see before it.
VARIED_WALLS = np.array(
    [
        textures.index(name)
        for name in (
            *("plaster", "plaster_blue", "plaster_green", "wallpaper", "wallpaper_rose"),
            *("wallpaper_blue", "stripes", "stripes_green", "checker", "tiles"),
        )
    ]
)
VARIED_FLOORS = np.array(
    [
        textures.index(name)
        for name in ("planks", "planks_dark", "tiles", "tiles_blue", "carpet", "carpet_red")
    ]
)
LOWEST_SUN, HIGHEST_SUN = 0.45, 0.95
"""Sines of the sun's elevation. The plain room's is 0.8."""
DIMMEST = 0.75  # share of the plain room's light
WARMTH = 0.2  # share of blue that the warmest light lacks, and of red that the coldest lacks
SMALLEST = 0.85
"""Share of a toy's size. No toy is larger than its size, so that none is drawn into a wall."""


@compiled()
def vary(mask, streams, walls, floors, toys, wall_looks, flat_looks, sun, lamp, scale):
    """Draws the looks of the episodes of `mask`.

    Args:
        mask: bool [N].
        streams: uint64 [N, 4], advanced.
        walls, floors: numbers of textures to choose from, int64 [any]; walls get different ones.
        toys: how many of an env's instances are toys.
        wall_looks, flat_looks, sun, lamp, scale: arrays of `Scenes`, written.
    """
    order = walls.copy()
    for i in range(mask.size):
        if not mask[i]:
            continue
        stream = streams[i]
        order[:] = walls
        for k in range(4):
            pick = k + below(stream, walls.size - k)
            order[k], order[pick] = order[pick], order[k]
            wall_looks[i, k, 0] = order[k]
        flat_looks[i, 0, 0] = floors[below(stream, floors.size)]
        angle = between(stream, -math.pi, math.pi)
        up = between(stream, LOWEST_SUN, HIGHEST_SUN)
        level = math.sqrt(1.0 - up * up)
        sun[i, 0], sun[i, 1], sun[i, 2] = level * math.cos(angle), level * math.sin(angle), up
        bright = between(stream, DIMMEST, 1.0)
        warm = between(stream, -WARMTH, WARMTH)
        lamp[i, 0] = bright * (1.0 - max(-warm, 0.0))
        lamp[i, 1] = bright * (1.0 - 0.4 * abs(warm))
        lamp[i, 2] = bright * (1.0 - max(warm, 0.0))
        for j in range(toys):
            scale[i, j] = between(stream, SMALLEST, 1.0)
