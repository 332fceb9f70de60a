"""The renderer's inner loops, compiled.

A camera never rolls, which makes all of this simple. The ray of the pixel at column x, row y is
`forward + a(x) right + b(y) up`, its length t being the depth along the view. With `h` the heading,
`right` its right hand (both horizontal) and p the pitch, its horizontal part is c(y) h + a(x) right
where c(y) = cos p - b sin p, and its rise, sin p + b cos p, is the same along a row. Hence

- on a flat the depth is the same along a row, and positions are affine in x;
- on a wall 1/t, and positions times 1/t, are affine in x and y; and so are the conditions of being
  inside its rectangle. Each bounds x from one side in every row: a wall is a span of x per row,
  found without projecting, clipping or sorting its corners. The near plane is one more condition.

Depth is kept as 1/t, 0 being nothing yet. Colours in the making are uint32, 0x00BBGGRR.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import (
    address,
    flat_block,
    pack_block,
    patchwork_block,
    wall_block,
)
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.mesh_kernels import draw_mesh
from zipf.envs.render3d.optics import FADE2, FAR, NEAR, SURFACE_DARK, SURFACE_SUN, light_on
from zipf.envs.render3d.scene import FACES_DOWN, SCREEN, SEE_THROUGH, TWO_SIDED
from zipf.envs.render3d.sight import look_around, narrow
from zipf.envs.render3d.terrain import draw_terrain

LEVEL_STRIDE = 128
"""Texels in a line of a texture with its smaller versions beside it; see `pack_textures`."""

GROW = 0.0005
"""Walls and flats are this many metres larger than they are on every side, so that no background
shows where two of them meet."""

_SOLID = -(1 << 31)  # makes every texel opaque


@compiled(error_model="numpy")
def _bound(low, high, a, step, b):
    """Narrows each row's span to where a + step * y + b * x >= 0."""
    if abs(b) < 1e-30:
        b = 1e-30
    start = np.float32(-a / b)
    step = np.float32(-step / b)
    if b > 0.0:
        for y in range(len(low)):
            low[y] = max(low[y], start + step * np.float32(y))
    else:
        for y in range(len(high)):
            high[y] = min(high[y], start + step * np.float32(y))


@compiled(error_model="numpy", fastmath=True)
def _draw_wall(
    wall, texture, flags, repeat, tint, screen, view, sector, low, high, width, texels, color, depth
):
    """Draws one wall.

    `view` holds x, y, z of the eye; heading x, y; c(0), its step per row; rise(0), its step per
    row; a(0) and its step per column. `sector` says whether the view spans less than half a turn,
    and its leftmost and rightmost directions.
    """
    eye_x, eye_y, eye_z, hx, hy, c0, dc, rise0, drise, a0, da = view
    x0, y0, x1, y1 = wall[0], wall[1], wall[2], wall[3]
    bottom, top = np.float64(wall[4]), np.float64(wall[5])
    ex, ey = np.float64(x0) - x1, np.float64(y0) - y1
    length = math.sqrt(ex * ex + ey * ey)
    tall = top - bottom
    if length == 0.0 or tall <= 0.0:
        return
    ex /= length
    ey /= length
    nx, ny = ey, -ex
    px0, py0, px1, py1 = x0 - eye_x, y0 - eye_y, x1 - eye_x, y1 - eye_y
    if sector[0]:
        if sector[1] * py0 > sector[2] * px0 and sector[1] * py1 > sector[2] * px1:
            return
        if sector[3] * py0 < sector[4] * px0 and sector[3] * py1 < sector[4] * px1:
            return
        if hx * px0 + hy * py0 < 0.0 and hx * px1 + hy * py1 < 0.0:
            return
    distance = nx * px0 + ny * py0
    if distance > 0.0 and not flags & TWO_SIDED:
        return
    if abs(distance) < 1e-6:
        return

    # 1/t = z + dz_row * y + dz * x, and likewise u/t along the wall and v/t down from its top.
    n_h, n_r = nx * hx + ny * hy, nx * hy - ny * hx
    e_h, e_r = ex * hx + ey * hy, ex * hy - ey * hx
    z = (n_h * c0 + n_r * a0) / distance
    dz_row = n_h * dc / distance
    dz = n_r * da / distance
    along = (eye_x - x1) * ex + (eye_y - y1) * ey
    u = along * z + e_h * c0 + e_r * a0
    du_row = along * dz_row + e_h * dc
    du = along * dz + e_r * da
    down = top - eye_z
    v = down * z - rise0
    dv_row = down * dz_row - drise
    dv = down * dz

    low[:] = 0.0
    high[:] = width - 1
    _bound(low, high, z - 1.0 / FAR, dz_row, dz)
    _bound(low, high, 1.0 / NEAR - z, -dz_row, -dz)
    _bound(low, high, u + GROW * z, du_row + GROW * dz_row, du + GROW * dz)
    far = length + GROW
    _bound(low, high, far * z - u, far * dz_row - du_row, far * dz - du)
    _bound(low, high, v + GROW * z, dv_row + GROW * dz_row, dv + GROW * dz)
    far = tall + GROW
    _bound(low, high, far * z - v, far * dz_row - dv_row, far * dz - dv)

    if texture == SCREEN:
        _draw_screen(
            screen, z, dz_row, dz, u + GROW * z, du_row + GROW * dz_row, du + GROW * dz,
            v + GROW * z, dv_row + GROW * dz_row, dv + GROW * dz,
            screen.shape[1] / (length + 2 * GROW), screen.shape[0] / (tall + 2 * GROW),
            low, high, color, depth,
        )  # fmt: skip
        return
    per_u = 64.0 / repeat[0] if repeat[0] > 0.0 else 64.0 / (length + 2 * GROW)
    per_v = 64.0 / repeat[1] if repeat[1] > 0.0 else 64.0 / (tall + 2 * GROW)
    shift_u = 0.0 if repeat[0] > 0.0 else GROW
    shift_v = 0.0 if repeat[1] > 0.0 else GROW
    u, du_row, du = (
        per_u * (u + shift_u * z),
        per_u * (du_row + shift_u * dz_row),
        per_u * (du + shift_u * dz),
    )
    v, dv_row, dv = (
        per_v * (v + shift_v * z),
        per_v * (dv_row + shift_v * dz_row),
        per_v * (dv + shift_v * dz),
    )
    if distance > 0.0:
        nx, ny = -nx, -ny
    light = light_on(nx, ny, 0.0, SURFACE_DARK, SURFACE_SUN)
    red, green, blue = light * tint[0] / 255, light * tint[1] / 255, light * tint[2] / 255
    # A pixel covers area * t**3 texels.
    area = per_u * per_v * da * da / abs(distance)
    solid = 0 if flags & SEE_THROUGH else _SOLID
    texture_at = address(texels) + 4 * texels.shape[1] * texture
    line, depths = address(color), address(depth)
    line_bytes = 4 * color.shape[1]
    dz32, du32, dv32 = np.float32(dz), np.float32(du), np.float32(dv)
    for y in range(len(low)):
        if low[y] > high[y]:
            continue
        first, last = math.ceil(low[y]), math.floor(high[y])
        if first > last:
            continue
        z_row = np.float32(z + dz_row * y)
        u_row, v_row = np.float32(u + du_row * y), np.float32(v + dv_row * y)
        for x in range(first, last + 1, LANES):
            at = y * line_bytes + 4 * x
            wall_block(
                line + at, depths + at, texture_at, x, last, z_row, dz32, u_row, du32,
                v_row, dv32, area, FADE2, red, green, blue, solid,
            )  # fmt: skip


@compiled(error_model="numpy")
def _draw_screen(
    screen, z, dz_row, dz, u, du_row, du, v, dv_row, dv, per_u, per_v, low, high, color, depth
):  # fmt: skip
    """Draws a picture of any size on a wall's spans; u and v are over t, as in `_draw_wall`."""
    rows, columns = screen.shape[0], screen.shape[1]
    for y in range(len(low)):
        if low[y] > high[y]:
            continue
        for x in range(math.ceil(low[y]), math.floor(high[y]) + 1):
            inverse = z + dz_row * y + dz * x
            if inverse > depth[y, x]:
                column = int((u + du_row * y + du * x) / inverse * per_u)
                row = int((v + dv_row * y + dv * x) / inverse * per_v)
                texel = screen[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)]
                depth[y, x] = inverse
                color[y, x] = texel[0] | np.int32(texel[1]) << 8 | np.int32(texel[2]) << 16


@compiled(error_model="numpy")
def _draw_overlay(overlay, paint, image):
    """Draws a rectangle given as shares of `image`, uint8 [H, W, 3], in an RGBA colour."""
    height, width = image.shape[0], image.shape[1]
    left, right = _pixel(overlay[0], width), _pixel(overlay[2], width)
    top, bottom = _pixel(overlay[1], height), _pixel(overlay[3], height)
    alpha = np.int32(paint[3])
    for y in range(top, bottom):
        for x in range(left, right):
            for k in range(3):
                mixed = image[y, x, k] * (255 - alpha) + paint[k] * alpha
                image[y, x, k] = (mixed + 127) // 255


@compiled(error_model="numpy")
def _pixel(share, size):
    return min(max(math.floor(share * size + 0.5), 0), size)


@compiled(error_model="numpy")
def _level(area):
    level = 0
    while area >= 4.0 and level < 6:
        area *= 0.25
        level += 1
    return level


@compiled(error_model="numpy", fastmath=True)
def _draw_flat(
    flat, texture, flags, first, rows, columns, repeat, tint, tiles, view, width, texels, color,
    depth,
):  # fmt: skip
    eye_x, eye_y, eye_z, hx, hy, c0, dc, rise0, drise, a0, da = view
    up = flat[4] - eye_z
    if up == 0.0:
        return
    if up > 0.0 and not flags & (TWO_SIDED | FACES_DOWN):
        return
    if up < 0.0 and flags & FACES_DOWN and not flags & TWO_SIDED:
        return
    west, south, east, north = (
        np.float64(flat[0]),
        np.float64(flat[1]),
        np.float64(flat[2]),
        np.float64(flat[3]),
    )
    if east <= west or north <= south:
        return
    light = light_on(0.0, 0.0, 1.0 if up < 0.0 else -1.0, SURFACE_DARK, SURFACE_SUN)
    per_column = columns / (east - west)
    per_row = rows / (north - south)
    per_u = 64.0 / repeat if repeat > 0.0 else 64.0 * max(columns, 1) / (east - west)
    per_v = 64.0 / repeat if repeat > 0.0 else 64.0 * max(rows, 1) / (north - south)
    area = per_u * per_v * da * da / abs(up)
    solid = 0 if flags & SEE_THROUGH else _SOLID
    tiles_at = address(tiles) + 2 * first
    texels_at = address(texels)
    texture_at = texels_at + 4 * texels.shape[1] * texture
    line, depths = address(color), address(depth)
    line_bytes = 4 * color.shape[1]
    for y in range(len(depth)):
        inverse = (rise0 + drise * y) / up
        if not 1.0 / FAR < inverse < 1.0 / NEAR:
            continue
        t = 1.0 / inverse
        c = (c0 + dc * y) * t
        px, dx = eye_x + hx * c + hy * a0 * t, hy * da * t
        py, dy = eye_y + hy * c - hx * a0 * t, -hx * da * t
        low, high = narrow(0.0, width - 1.0, px - (west - GROW), dx)
        low, high = narrow(low, high, (east + GROW) - px, -dx)
        low, high = narrow(low, high, py - (south - GROW), dy)
        low, high = narrow(low, high, (north + GROW) - py, -dy)
        if low > high:
            continue
        level = _level(area * t * t * t)
        fade = light / (1.0 + t * t * FADE2) / 255.0
        red, green, blue = fade * tint[0], fade * tint[1], fade * tint[2]
        first_x, last_x = math.ceil(low), math.floor(high)
        if first_x > last_x:
            continue
        px -= west
        py -= south
        for x in range(first_x, last_x + 1, LANES):
            at = y * line_bytes + 4 * x
            if rows > 0:
                patchwork_block(
                    line + at, depths + at, texels_at, x, last_x, inverse,
                    px * per_u, dx * per_u, py * per_v, dy * per_v, level, red, green, blue, solid,
                    tiles_at, px * per_column, dx * per_column, columns,
                    py * per_row, dy * per_row, rows,
                )  # fmt: skip
            else:
                flat_block(
                    line + at, depths + at, texture_at, x, last_x,
                    inverse, px * per_u, dx * per_u, py * per_v, dy * per_v, level, red, green,
                    blue, solid,
                )  # fmt: skip


@compiled(error_model="numpy")
def draw(
    start, stop, mask, camera, walls, wall_looks, wall_repeat, wall_tint, wall_face, wall_count,
    flats, flat_looks, flat_tiles, flat_repeat, flat_tint, flat_count, tiles, mesh, position,
    rotation, scale, colors, sky, screen, overlays, overlay_colors, overlay_count, solid, grid,
    heights, terrain, terrain_looks, terrain_tint, atlas, fixed_colors, texels, focal, color,
    depth, tilts, low, high, seen, lit, front, faces, spans, ground, out,
):  # fmt: skip
    """Draws the worlds start .. stop - 1 that are in `mask` to `out`, uint8 [N, H, W, 3].

    Returns the first of them that names a texture, screen or mesh there is not, or -1.
    """
    height, width = out.shape[1], out.shape[2]
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    frame = np.empty((3, 3))
    image = width, height, color.shape[1], address(color), address(depth)
    palette = np.empty((len(fixed_colors) + 2, 3), np.float32)
    to_edge = (width / 2 / focal, height / 2 / focal)
    slant_x = (math.sin(math.atan(to_edge[0])), math.cos(math.atan(to_edge[0])))
    slant_y = (math.sin(math.atan(to_edge[1])), math.cos(math.atan(to_edge[1])))
    palette[2:] = fixed_colors
    for i in range(start, stop):
        if not mask[i]:
            continue
        yaw, pitch = np.float64(camera[i, 3]), np.float64(camera[i, 4])
        hx, hy = math.cos(yaw), math.sin(yaw)
        cos, sin = math.cos(pitch), math.sin(pitch)
        frame[0] = hy, -hx, 0.0
        frame[1] = -sin * hx, -sin * hy, cos
        frame[2] = cos * hx, cos * hy, sin
        b = middle_y / focal
        view = (
            np.float64(camera[i, 0]), np.float64(camera[i, 1]), np.float64(camera[i, 2]), hx, hy,
            cos - b * sin, sin / focal, sin + b * cos, -cos / focal,
            -middle_x / focal, 1.0 / focal,
        )  # fmt: skip
        for y in range(height):
            angle = pitch + tilts[y]
            share = min(max(angle / (math.pi / 2), 0.0), 1.0)
            paint = np.uint32(0)
            for k in range(3):
                shade = sky[i, 0, k] * (1.0 - share) + sky[i, 1, k] * share
                paint |= np.uint32(shade) << np.uint32(8 * k)
            color[y] = paint
        depth[:] = 0.0
        if terrain[i, 2] > 0.0:
            for row in range(terrain_looks.shape[1]):
                for column in range(terrain_looks.shape[2]):
                    if terrain_looks[i, row, column] >= len(texels):
                        return i
            # First of all: it borrows the colours of the pixels it covers.
            draw_terrain(
                heights[i], terrain_looks[i], terrain[i], terrain_tint[i], view, frame,
                np.float32(focal), np.float32(middle_x), np.float32(middle_y), texels, image,
                color, depth, ground,
            )  # fmt: skip
        # Seen from above, the view is a sector as wide as its widest line; half a pixel is added.
        narrowest = min(view[5], view[5] + view[6] * (height - 1))
        half = math.atan2((middle_x + 1.0) / focal, narrowest)
        sector = (
            narrowest > 1e-3, math.cos(yaw + half), math.sin(yaw + half), math.cos(yaw - half),
            math.sin(yaw - half),
        )  # fmt: skip
        by_grid = False
        if grid[i, 2] > 0.0 and sector[0]:
            by_grid = look_around(
                solid[i], (camera[i, 0] - grid[i, 0]) / np.float64(grid[i, 2]),
                (camera[i, 1] - grid[i, 1]) / np.float64(grid[i, 2]), *sector[1:], faces, spans,
            )  # fmt: skip
        for k in range(wall_count[i]):
            if by_grid and wall_face[i, k] >= 0 and not faces[wall_face[i, k]]:
                continue
            texture = wall_looks[i, k, 0]
            if texture >= len(texels) or (texture == SCREEN and screen[i].size == 0):
                return i
            if texture >= 0 or texture == SCREEN:
                _draw_wall(
                    walls[i, k], texture, wall_looks[i, k, 1], wall_repeat[i, k], wall_tint[i, k],
                    screen[i], view, sector, low, high, width, texels, color, depth,
                )  # fmt: skip
        for k in range(mesh.shape[1]):
            if mesh[i, k] >= len(atlas[-1]):
                return i
            if mesh[i, k] >= 0:
                palette[:2] = colors[i, k]
                draw_mesh(
                    mesh[i, k], atlas, position[i, k], rotation[i, k], scale[i, k], palette,
                    camera[i], frame, np.float32(focal), np.float32(middle_x),
                    np.float32(middle_y), slant_x, slant_y, seen, lit, front, image,
                )  # fmt: skip
        for k in range(flat_count[i]):
            texture, rows = flat_looks[i, k, 0], flat_tiles[i, k, 1]
            if texture >= len(texels):
                return i
            if texture >= 0 or rows > 0:
                _draw_flat(
                    flats[i, k], texture, flat_looks[i, k, 1], flat_tiles[i, k, 0], rows,
                    flat_tiles[i, k, 2], flat_repeat[i, k], flat_tint[i, k], tiles[i], view,
                    width, texels, color, depth,
                )  # fmt: skip
        for y in range(height):
            line = address(color) + y * 4 * color.shape[1]
            pixels = address(out) + 3 * width * (i * height + y)
            whole = width & -LANES
            for x in range(0, whole, LANES):
                pack_block(line + 4 * x, pixels + 3 * x)
            for x in range(whole, width):
                paint = color[y, x]
                out[i, y, x, 0] = paint & 255
                out[i, y, x, 1] = (paint >> 8) & 255
                out[i, y, x, 2] = (paint >> 16) & 255
        for k in range(overlay_count[i]):
            _draw_overlay(overlays[i, k], overlay_colors[i, k], out[i])
    return -1
