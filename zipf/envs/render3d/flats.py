"""Draws flats: horizontal rectangles with a texture or a patchwork of textures."""

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import address, flat_block, patchwork_block
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import (
    FADE2,
    FAR,
    GROW,
    NEAR,
    SURFACE_DARK,
    SURFACE_SUN,
    light_on,
)
from zipf.envs.render3d.rounding import ceil, floor
from zipf.envs.render3d.scene import FACES_DOWN, TWO_SIDED
from zipf.envs.render3d.spans import narrow_rows
from zipf.envs.render3d.textures import SIZE


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_flat(
    place, looks, tiling, repeat, tint, tiles, sun, lamp, view, texels, image, span, width
):  # fmt: skip
    """Draws one flat.

    Args:
        place, looks, tiling, repeat, tint: rows of `Flats`.
        tiles, sun, lamp: of the flat's env.
        view: `View`.
        texels: of `Assets`.
        image, span: `ImageBuffers` and `SpanBuffers`, written.
        width: of the image, pixels.
    """
    colour, depth, low, high = image.colour, image.depth, span.low, span.high
    texture, flags = looks[0], looks[1]
    rows, columns = tiling[0], tiling[1]
    up = place[4] - view.z
    if up == 0.0:
        return
    if up > 0.0 and not flags & (TWO_SIDED | FACES_DOWN):
        return
    if up < 0.0 and flags & FACES_DOWN and not flags & TWO_SIDED:
        return
    west, south, east, north = (
        np.float64(place[0]),
        np.float64(place[1]),
        np.float64(place[2]),
        np.float64(place[3]),
    )
    if east <= west or north <= south:
        return
    hx, hy, a0, da = view.hx, view.hy, view.a0, view.da
    light = light_on(0.0, 0.0, 1.0 if up < 0.0 else -1.0, SURFACE_DARK, SURFACE_SUN, sun)
    wide, deep = (east - west) / max(columns, 1), (north - south) / max(rows, 1)
    per_u = SIZE / repeat if repeat > 0.0 else SIZE / wide
    per_v = SIZE / repeat if repeat > 0.0 else SIZE / deep
    area = per_u * per_v * da * da / abs(up)
    lit_red, lit_green, lit_blue = lamp[0] * tint[0], lamp[1] * tint[1], lamp[2] * tint[2]
    tiles_at, texels_at = address(tiles), address(texels)
    texture_at = texels_at + 4 * texels.shape[1] * texture
    line, depths = address(colour), address(depth)
    line_bytes = 4 * colour.shape[1]
    low[:] = 0.0
    high[:] = width - 1
    # On the flat's plane 1/t is affine in y, and coordinates divided by t are affine in x and y; so
    # is the distance from a side, along its normal (nx, ny) to the inside.
    near, step = view.rise0 / up, view.drise / up
    sides = ((1.0, 0.0, west), (-1.0, 0.0, -east), (0.0, 1.0, south), (0.0, -1.0, -north))
    for nx, ny, edge in sides:
        ahead, aside = nx * hx + ny * hy, nx * hy - ny * hx
        inside = nx * view.x + ny * view.y - edge + GROW
        narrow_rows(
            low, high, inside * near + ahead * view.c0 + aside * a0,
            inside * step + ahead * view.dc, aside * da,
        )  # fmt: skip
    for y in range(len(low)):
        inverse = near + step * y
        if not (low[y] <= high[y] and 1.0 / FAR < inverse < 1.0 / NEAR):
            continue
        first_x, last_x = ceil(low[y]), floor(high[y])
        if first_x > last_x:
            continue
        t = 1.0 / inverse
        c = (view.c0 + view.dc * y) * t
        px, dx = view.x - west + hx * c + hy * a0 * t, hy * da * t
        py, dy = view.y - south + hy * c - hx * a0 * t, -hx * da * t
        each = area * t * t * t
        fade = light / (255.0 + t * t * (255.0 * FADE2))
        red, green, blue = fade * lit_red, fade * lit_green, fade * lit_blue
        for x in range(first_x, last_x + 1, LANES):
            at = y * line_bytes + 4 * x
            if rows > 0:
                patchwork_block(
                    line + at, depths + at, texels_at, x, last_x, inverse,
                    px * per_u, dx * per_u, py * per_v, dy * per_v, each, red, green, blue, flags,
                    px / wide, dx / wide, wide, py / deep, dy / deep, deep,
                    tiles_at, columns, rows,
                )  # fmt: skip
            else:
                flat_block(
                    line + at, depths + at, texture_at, x, last_x,
                    inverse, px * per_u, dx * per_u, py * per_v, dy * per_v, each, red, green,
                    blue, flags, px / wide, dx / wide, wide, py / deep, dy / deep, deep,
                )  # fmt: skip
