"""Draws walls: upright rectangles with a texture or with an env's screen."""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import address, screen_block, wall_block
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import (
    FADE2,
    FAR,
    GROW,
    NEAR,
    OPAQUE,
    STRIP,
    SURFACE_DARK,
    SURFACE_SUN,
    light_on,
)
from zipf.envs.render3d.rounding import ceil, floor
from zipf.envs.render3d.scene import GROUNDED, SCREEN, SEE_THROUGH, TWO_SIDED
from zipf.envs.render3d.spans import narrow_rows
from zipf.envs.render3d.textures import SIZE


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_wall(
    place, looks, repeat, tint, screen, sun, lamp, view, sector, texels, image, span, width
):  # fmt: skip
    """Draws one wall, of the rows of `Walls`, in the sector `Sector`; for the other arguments see
    `flats.draw_flat`."""
    colour, depth, low, high = image.colour, image.depth, span.low, span.high
    texture, flags = looks[0], looks[1]
    x0, y0, x1, y1 = place[0], place[1], place[2], place[3]
    bottom, top = np.float64(place[4]), np.float64(place[5])
    ex, ey = np.float64(x0) - x1, np.float64(y0) - y1
    length = math.sqrt(ex * ex + ey * ey)
    tall = top - bottom
    if length == 0.0 or tall <= 0.0:
        return
    ex /= length
    ey /= length
    nx, ny = ey, -ex
    px0, py0, px1, py1 = x0 - view.x, y0 - view.y, x1 - view.x, y1 - view.y
    if sector.narrow:
        if sector.left_x * py0 > sector.left_y * px0 and sector.left_x * py1 > sector.left_y * px1:
            return
        if (
            sector.right_x * py0 < sector.right_y * px0
            and sector.right_x * py1 < sector.right_y * px1
        ):
            return
        if view.hx * px0 + view.hy * py0 < 0.0 and view.hx * px1 + view.hy * py1 < 0.0:
            return
    distance = nx * px0 + ny * py0
    if distance > 0.0 and not flags & TWO_SIDED:
        return
    if abs(distance) < 1e-6:
        return

    # 1/t = z + dz_row * y + dz * x, and likewise u/t along the wall and v/t down from its top.
    c0, dc, a0, da = view.c0, view.dc, view.a0, view.da
    n_h, n_r = nx * view.hx + ny * view.hy, nx * view.hy - ny * view.hx
    e_h, e_r = ex * view.hx + ey * view.hy, ex * view.hy - ey * view.hx
    z = (n_h * c0 + n_r * a0) / distance
    dz_row = n_h * dc / distance
    dz = n_r * da / distance
    along = (view.x - x1) * ex + (view.y - y1) * ey
    u = along * z + e_h * c0 + e_r * a0
    du_row = along * dz_row + e_h * dc
    du = along * dz + e_r * da
    down = top - view.z
    v = down * z - view.rise0
    dv_row = down * dz_row - view.drise
    dv = down * dz

    low[:] = 0.0
    high[:] = width - 1
    narrow_rows(low, high, z - 1.0 / FAR, dz_row, dz)
    narrow_rows(low, high, 1.0 / NEAR - z, -dz_row, -dz)
    narrow_rows(low, high, u + GROW * z, du_row + GROW * dz_row, du + GROW * dz)
    far = length + GROW
    narrow_rows(low, high, far * z - u, far * dz_row - du_row, far * dz - du)
    narrow_rows(low, high, v + GROW * z, dv_row + GROW * dz_row, dv + GROW * dz)
    far = tall + GROW
    narrow_rows(low, high, far * z - v, far * dz_row - dv_row, far * dz - dv)

    if texture == SCREEN:
        _draw_screen(
            screen, z, dz_row, dz, u + GROW * z, du_row + GROW * dz_row, du + GROW * dz,
            v + GROW * z, dv_row + GROW * dz_row, dv + GROW * dz,
            screen.shape[1] / (length + 2 * GROW), screen.shape[0] / (tall + 2 * GROW),
            low, high, colour, depth,
        )  # fmt: skip
        return
    per_u = SIZE / repeat if repeat > 0.0 else SIZE / (length + 2 * GROW)
    per_v = SIZE / repeat if repeat > 0.0 else SIZE / (tall + 2 * GROW)
    shift = 0.0 if repeat > 0.0 else GROW
    u, du_row, du = (
        per_u * (u + shift * z),
        per_u * (du_row + shift * dz_row),
        per_u * (du + shift * dz),
    )
    v, dv_row, dv = (
        per_v * (v + shift * z),
        per_v * (dv_row + shift * dz_row),
        per_v * (dv + shift * dz),
    )
    if distance > 0.0:
        nx, ny = -nx, -ny
    light = light_on(nx, ny, 0.0, SURFACE_DARK, SURFACE_SUN, sun) / 255
    red = light * lamp[0] * tint[0]
    green = light * lamp[1] * tint[1]
    blue = light * lamp[2] * tint[2]
    # A pixel covers area * t**3 texels.
    area = per_u * per_v * da * da / abs(distance)
    solid = 0 if flags & SEE_THROUGH else OPAQUE
    foot = per_v * (tall + shift - STRIP)
    per_foot = 1.0 / (per_v * STRIP) if flags & GROUNDED else 0.0
    texture_at = address(texels) + 4 * texels.shape[1] * texture
    line, depths = address(colour), address(depth)
    line_bytes = 4 * colour.shape[1]
    dz32, du32, dv32 = np.float32(dz), np.float32(du), np.float32(dv)
    for y in range(len(low)):
        if low[y] > high[y]:
            continue
        first, last = ceil(low[y]), floor(high[y])
        if first > last:
            continue
        z_row = np.float32(z + dz_row * y)
        u_row, v_row = np.float32(u + du_row * y), np.float32(v + dv_row * y)
        for x in range(first, last + 1, LANES):
            at = y * line_bytes + 4 * x
            wall_block(
                line + at, depths + at, texture_at, x, last, z_row, dz32, u_row, du32,
                v_row, dv32, area, FADE2, foot, per_foot, red, green, blue, solid,
            )  # fmt: skip


@compiled(references=False, error_model="numpy")
def _draw_screen(
    screen, z, dz_row, dz, u, du_row, du, v, dv_row, dv, per_u, per_v, low, high, colour, depth
):  # fmt: skip
    """Draws a picture of any size on a wall's spans; u and v are over t, as in `draw_wall`."""
    rows, columns = np.int32(screen.shape[0]), np.int32(screen.shape[1])
    texels, line, depths = address(screen), address(colour), address(depth)
    line_bytes = 4 * colour.shape[1]
    u_row, u_column = np.float32(per_u * du_row), np.float32(per_u * du)
    v_row, v_column = np.float32(per_v * dv_row), np.float32(per_v * dv)
    z_row, z_column = np.float32(dz_row), np.float32(dz)
    for y in range(len(low)):
        if low[y] > high[y]:
            continue
        first, last = ceil(low[y]), floor(high[y])
        z_first = np.float32(z + dz_row * y)
        u_first = np.float32(per_u * (u + du_row * y))
        v_first = np.float32(per_v * (v + dv_row * y))
        for x in range(first, last + 1, LANES):
            at = y * line_bytes + 4 * x
            screen_block(
                line + at, depths + at, texels, x, last, z_first, z_column, z_row, u_first,
                u_column, u_row, v_first, v_column, v_row, rows, columns,
            )  # fmt: skip
