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

Compiled code is cached beside this file and renewed only when this file changes: after a change to
what it imports (`blocks.py`, the constants of `scene.py`), touch it.
"""

import math

import numpy as np
from numba import njit

from zipf.envs.render3d.blocks import (
    LANES,
    TRIANGLE_LANES,
    flat_block,
    light_block,
    pack_block,
    patchwork_block,
    triangle_block,
    vertex_block,
    wall_block,
)
from zipf.envs.render3d.scene import FACES_DOWN, SCREEN, SEE_THROUGH, TWO_SIDED

LEVEL_STRIDE = 128
"""Texels in a line of a texture with its smaller versions beside it; see `pack_textures`."""

NEAR = 0.02
FAR = 4000.0
GROW = 0.0005
"""Walls and flats are this many metres larger than they are on every side, so that no background
shows where two of them meet."""

SUN = (0.36, 0.48, 0.8)
SURFACE_DARK, SURFACE_SUN = 0.62, 0.38
MESH_DARK, MESH_SUN = 0.34, 0.66
FADE = 14.0
"""Metres at which distance halves the light."""

_SUN = tuple(np.float32(s / math.sqrt(sum(s * s for s in SUN))) for s in SUN)
_EDGE = np.float32(1e-4)  # pixels this near outside of an edge are taken in, lest two let one slip
_SOLID = -(1 << 31)  # makes every texel opaque
_FADE2 = 1.0 / FADE**2


@njit(nogil=True, cache=True)
def _address(array):
    # Signed: numba adds unsigned and signed integers as floats.
    return np.intp(array.ctypes.data)


@njit(nogil=True, cache=True, error_model="numpy")
def _light(x, y, z, dark, sun):
    """The light on a surface with the unit normal x, y, z: wrapped around, to shade all sides."""
    return dark + sun * (0.5 + 0.5 * (x * _SUN[0] + y * _SUN[1] + z * _SUN[2]))


@njit(nogil=True, cache=True, error_model="numpy")
def _inside(low, high, a, b):
    """Narrows a span to where a + b * x >= 0."""
    if b > 0.0:
        return max(low, -a / b), high
    if b < 0.0:
        return low, min(high, -a / b)
    return low, (high if a >= 0.0 else low - 1.0)


@njit(nogil=True, cache=True, error_model="numpy")
def _look_around(solid, x, y, left_x, left_y, right_x, right_y, seen, spans):
    """Marks in `seen` the faces of solid cells that are seen from a place between two directions.

    The place is given in cells, the directions turn by less than a half from right to left. Returns
    False, with nothing marked, where the place is in a solid cell or outside the grid. `spans`
    [4, .] is scratch.

    The view is swept away from the place in each of four directions by columns of cells. What is
    left of it are spans of slopes; in a column each is cut where its rays begin to pass other cells
    than the one before, and the parts that no solid cell stops go on.
    """
    rows, columns = solid.shape
    own_row, own_column = math.floor(y), math.floor(x)
    if not (0 <= own_row < rows and 0 <= own_column < columns) or solid[own_row, own_column]:
        return False
    seen[:] = False
    for ahead in range(4):
        px, py = (1, 0, -1, 0)[ahead], (0, 1, 0, -1)[ahead]
        sx, sy = -py, px  # to the left of it: slopes grow this way
        past = x - own_column if px > 0 else own_column + 1 - x
        aside = y - own_row if px > 0 else own_row + 1 - y
        if px == 0:
            past = y - own_row if py > 0 else own_row + 1 - y
            aside = own_column + 1 - x if py > 0 else x - own_column
        low, high = _inside(-1.0, 1.0, right_x * py - right_y * px, right_x * sy - right_y * sx)
        low, high = _inside(low, high, px * left_y - py * left_x, sx * left_y - sy * left_x)
        count = 0
        if low < high:
            spans[0, 0], spans[1, 0] = low, high
            count = 1
        step = 0
        now = 0
        while count:
            near, far = max(step - past, 0.0), step + 1 - past
            column, row = own_column + step * px, own_row + step * py
            after = 2 - now
            open_count = 0
            for k in range(count):
                slope, end = spans[now, k], spans[now + 1, k]
                enters = math.floor(aside + slope * near)
                leaves = math.floor(aside + slope * far)
                while slope < end:
                    next_enters = (enters + 1 - aside) / near if near > 0.0 else 2.0
                    next_leaves = (leaves + 1 - aside) / far
                    until = min(next_enters, next_leaves, end)
                    if until > slope:
                        r, c = row + enters * sy, column + enters * sx
                        side = (ahead + 2) & 3
                        inside = 0 <= r < rows and 0 <= c < columns
                        stopped = not inside or solid[r, c]
                        if not stopped and leaves != enters:
                            r, c = row + leaves * sy, column + leaves * sx
                            side = (ahead + 3) & 3 if leaves > enters else (ahead + 1) & 3
                            inside = 0 <= r < rows and 0 <= c < columns
                            stopped = not inside or solid[r, c]
                        if stopped:
                            if inside:
                                seen[(r * columns + c) * 4 + side] = True
                        elif open_count and spans[after + 1, open_count - 1] == slope:
                            spans[after + 1, open_count - 1] = until
                        else:
                            spans[after, open_count], spans[after + 1, open_count] = slope, until
                            open_count += 1
                        slope = until
                    if next_enters <= until:
                        enters += 1
                    if next_leaves <= until:
                        leaves += 1
            now, count = after, open_count
            step += 1
    return True


@njit(nogil=True, cache=True, error_model="numpy")
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


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
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
    light = _light(nx, ny, 0.0, SURFACE_DARK, SURFACE_SUN)
    red, green, blue = light * tint[0] / 255, light * tint[1] / 255, light * tint[2] / 255
    # A pixel covers area * t**3 texels.
    area = per_u * per_v * da * da / abs(distance)
    solid = 0 if flags & SEE_THROUGH else _SOLID
    texture_at = _address(texels) + 4 * texels.shape[1] * texture
    line, depths = _address(color), _address(depth)
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
                v_row, dv32, area, _FADE2, red, green, blue, solid,
            )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
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


@njit(nogil=True, cache=True, error_model="numpy")
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


@njit(nogil=True, cache=True, error_model="numpy")
def _pixel(share, size):
    return min(max(math.floor(share * size + 0.5), 0), size)


@njit(nogil=True, cache=True, error_model="numpy")
def _level(area):
    level = 0
    while area >= 4.0 and level < 6:
        area *= 0.25
        level += 1
    return level


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
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
    light = _light(0.0, 0.0, 1.0 if up < 0.0 else -1.0, SURFACE_DARK, SURFACE_SUN)
    per_column = columns / (east - west)
    per_row = rows / (north - south)
    per_u = 64.0 / repeat if repeat > 0.0 else 64.0 * max(columns, 1) / (east - west)
    per_v = 64.0 / repeat if repeat > 0.0 else 64.0 * max(rows, 1) / (north - south)
    area = per_u * per_v * da * da / abs(up)
    solid = 0 if flags & SEE_THROUGH else _SOLID
    tiles_at = _address(tiles) + 2 * first
    texels_at = _address(texels)
    texture_at = texels_at + 4 * texels.shape[1] * texture
    line, depths = _address(color), _address(depth)
    line_bytes = 4 * color.shape[1]
    for y in range(len(depth)):
        inverse = (rise0 + drise * y) / up
        if not 1.0 / FAR < inverse < 1.0 / NEAR:
            continue
        t = 1.0 / inverse
        c = (c0 + dc * y) * t
        px, dx = eye_x + hx * c + hy * a0 * t, hy * da * t
        py, dy = eye_y + hy * c - hx * a0 * t, -hx * da * t
        low, high = _inside(0.0, width - 1.0, px - (west - GROW), dx)
        low, high = _inside(low, high, (east + GROW) - px, -dx)
        low, high = _inside(low, high, py - (south - GROW), dy)
        low, high = _inside(low, high, (north + GROW) - py, -dy)
        if low > high:
            continue
        level = _level(area * t * t * t)
        fade = light / (1.0 + t * t * _FADE2) / 255.0
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


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _draw_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, paint, image):
    """Fills a triangle given in pixels and 1/t (float32), seen from its front.

    `image` holds width, height, pixels in a line of the buffers, and the addresses of the buffers.
    """
    width, height, stride, color, depth = image
    left = max(math.ceil(min(ax, bx, cx)), 0)
    right = min(math.floor(max(ax, bx, cx)), width - 1)
    top = max(math.ceil(min(ay, by, cy)), 0)
    bottom = min(math.floor(max(ay, by, cy)), height - 1)
    if left > right or top > bottom:
        return
    # How far inside of each edge, times its length; and 1/t.
    a_x, a_y = by - ay, ax - bx
    b_x, b_y = cy - by, bx - cx
    c_x, c_y = ay - cy, cx - ax
    area = a_x * c_y - a_y * c_x
    if area <= 0.0:
        return
    per_area = np.float32(1.0) / area
    dz = ((cz - az) * a_x + (bz - az) * c_x) * per_area
    dz_row = ((cz - az) * a_y + (bz - az) * c_y) * per_area
    px, py = np.float32(left), np.float32(top)
    a = a_x * (px - ax) + a_y * (py - ay) + _EDGE
    b = b_x * (px - bx) + b_y * (py - by) + _EDGE
    c = c_x * (px - cx) + c_y * (py - cy) + _EDGE
    z = az + dz * (px - ax) + dz_row * (py - ay)
    start = top * stride + left
    for _ in range(top, bottom + 1):
        for x in range(0, right - left + 1, TRIANGLE_LANES):
            at = 4 * (start + x)
            triangle_block(color + at, depth + at, x, paint, z, dz, a, a_x, b, b_x, c, c_x)
        a += a_y
        b += b_y
        c += c_y
        z += dz_row
        start += stride


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _draw_mesh(
    mesh, atlas, position, rotation, scale, colors, eye, frame, focal, middle_x, middle_y, slant_x,
    slant_y, seen, lit, front, image,
):  # fmt: skip
    """Draws one mesh of the atlas.

    `frame` [3, 3] holds right, up and forward, `slant_x` and `slant_y` the sine and cosine of half
    the field of view sideways and upwards, `image` is that of `_draw_triangle`; `seen` [6, V],
    `lit` [T] and `front` [T] are scratch.
    """
    vertices, triangles, normals, parts, first_vertex, first_triangle, balls = atlas
    ball = balls[mesh]
    offset = np.empty(3, np.float32)
    m = np.empty((3, 4), np.float32)
    for i in range(3):
        offset[i] = position[i] - eye[i]
    middle = np.empty(3, np.float32)
    for i in range(3):
        for j in range(3):
            m[i, j] = scale * (
                frame[i, 0] * rotation[0, j]
                + frame[i, 1] * rotation[1, j]
                + frame[i, 2] * rotation[2, j]
            )
        m[i, 3] = frame[i, 0] * offset[0] + frame[i, 1] * offset[1] + frame[i, 2] * offset[2]
        middle[i] = m[i, 0] * ball[0] + m[i, 1] * ball[1] + m[i, 2] * ball[2] + m[i, 3]
    radius = ball[3] * scale
    if (
        middle[2] + radius < NEAR
        or abs(middle[0]) * slant_x[1] - middle[2] * slant_x[0] > radius
        or abs(middle[1]) * slant_y[1] - middle[2] * slant_y[0] > radius
    ):
        return
    first, last = first_vertex[mesh], first_vertex[mesh + 1]
    source, target = _address(vertices) + 4 * first, _address(seen)
    for k in range(0, 4 * (last - first), 4 * LANES):
        vertex_block(
            source + k, vertices.strides[0], target + k, seen.strides[0], m[0, 0], m[0, 1], m[0, 2],
            m[0, 3], m[1, 0], m[1, 1], m[1, 2], m[1, 3], m[2, 0], m[2, 1], m[2, 2], m[2, 3], focal,
            middle_x, middle_y,
        )  # fmt: skip
    # In the mesh's own frame: the eye, and the sun.
    own = np.float32(1.0) / scale
    eye_x = -own * (
        rotation[0, 0] * offset[0] + rotation[1, 0] * offset[1] + rotation[2, 0] * offset[2]
    )
    eye_y = -own * (
        rotation[0, 1] * offset[0] + rotation[1, 1] * offset[1] + rotation[2, 1] * offset[2]
    )
    eye_z = -own * (
        rotation[0, 2] * offset[0] + rotation[1, 2] * offset[1] + rotation[2, 2] * offset[2]
    )
    sun_x = rotation[0, 0] * _SUN[0] + rotation[1, 0] * _SUN[1] + rotation[2, 0] * _SUN[2]
    sun_y = rotation[0, 1] * _SUN[0] + rotation[1, 1] * _SUN[1] + rotation[2, 1] * _SUN[2]
    sun_z = rotation[0, 2] * _SUN[0] + rotation[1, 2] * _SUN[1] + rotation[2, 2] * _SUN[2]
    fade = np.float32(1.0 / (1.0 + max(m[2, 3], np.float32(0.0)) ** 2 * _FADE2))
    base, slope = fade * (MESH_DARK + 0.5 * MESH_SUN), fade * 0.5 * MESH_SUN
    first, last = first_triangle[mesh], first_triangle[mesh + 1]
    source, target = _address(normals) + 4 * first, _address(lit)
    for k in range(0, 4 * (last - first), 4 * LANES):
        light_block(
            source + k, normals.strides[0], target + k, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z,
            base, slope,
        )  # fmt: skip
    count = 0
    for k in range(last - first):
        front[count] = k
        count += lit[k] > 0.0
    if middle[2] - radius > NEAR:
        x, y, inverse = seen[3], seen[4], seen[5]
        for n in range(count):
            k = front[n]
            a, b, c = triangles[first + k, 0], triangles[first + k, 1], triangles[first + k, 2]
            _draw_triangle(
                x[a], y[a], inverse[a], x[b], y[b], inverse[b], x[c], y[c], inverse[c],
                _paint(colors, parts[first + k], lit[k]), image,
            )  # fmt: skip
        return
    px, py, pz = np.empty(4, np.float32), np.empty(4, np.float32), np.empty(4, np.float32)
    near = np.float32(NEAR)
    for n in range(count):
        k = front[n]
        # The triangle, cut where it is nearer than the near plane: up to four corners.
        corners = 0
        for i in range(3):
            v, w = triangles[first + k, i], triangles[first + k, (i + 1) % 3]
            depth_v, depth_w = seen[2, v], seen[2, w]
            if depth_v >= near:
                pz[corners] = np.float32(1.0) / depth_v
                px[corners] = middle_x + focal * pz[corners] * seen[0, v]
                py[corners] = middle_y - focal * pz[corners] * seen[1, v]
                corners += 1
            if (depth_v >= near) != (depth_w >= near):
                f = (near - depth_v) / (depth_w - depth_v)
                pz[corners] = np.float32(1.0) / near
                right = seen[0, v] + f * (seen[0, w] - seen[0, v])
                up = seen[1, v] + f * (seen[1, w] - seen[1, v])
                px[corners] = middle_x + focal * pz[corners] * right
                py[corners] = middle_y - focal * pz[corners] * up
                corners += 1
        for i in range(2, corners):
            _draw_triangle(
                px[0], py[0], pz[0], px[i - 1], py[i - 1], pz[i - 1], px[i], py[i], pz[i],
                _paint(colors, parts[first + k], lit[k]), image,
            )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _paint(colors, part, light):
    red, green, blue = colors[part, 0], colors[part, 1], colors[part, 2]
    return np.int32(red * light) | np.int32(green * light) << 8 | np.int32(blue * light) << 16


@njit(nogil=True, cache=True, error_model="numpy")
def draw(
    start, stop, mask, camera, walls, wall_looks, wall_repeat, wall_tint, wall_face, wall_count,
    flats, flat_looks, flat_tiles, flat_repeat, flat_tint, flat_count, tiles, mesh, position,
    rotation, scale, colors, sky, screen, overlays, overlay_colors, overlay_count,
    solid, grid, atlas, fixed_colors, texels, focal, color, depth,
    tilts, low, high, seen, lit, front, faces, spans, out,
):  # fmt: skip
    """Draws the worlds start .. stop - 1 that are in `mask` to `out`, uint8 [N, H, W, 3].

    Returns the first of them that names a texture, screen or mesh there is not, or -1.
    """
    height, width = out.shape[1], out.shape[2]
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    frame = np.empty((3, 3))
    image = width, height, color.shape[1], _address(color), _address(depth)
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
        # Seen from above, the view is a sector as wide as its widest line; half a pixel is added.
        narrowest = min(view[5], view[5] + view[6] * (height - 1))
        half = math.atan2((middle_x + 1.0) / focal, narrowest)
        sector = (
            narrowest > 1e-3, math.cos(yaw + half), math.sin(yaw + half), math.cos(yaw - half),
            math.sin(yaw - half),
        )  # fmt: skip
        by_grid = False
        if grid[i, 2] > 0.0 and sector[0]:
            by_grid = _look_around(
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
                _draw_mesh(
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
            line = _address(color) + y * 4 * color.shape[1]
            pixels = _address(out) + 3 * width * (i * height + y)
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
