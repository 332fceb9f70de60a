"""Draws meshes, triangle by triangle."""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import (
    TRIANGLE_LANES,
    address,
    light_block,
    triangle_block,
    vertex_block,
)
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import FADE2, MESH_DARK, MESH_SUN, NEAR, UNIT_SUN

_EDGE = np.float32(1e-4)  # pixels this near outside of an edge are taken in, lest two let one slip


@compiled(error_model="numpy", fastmath=True)
def draw_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, paint, grow, image):
    """Fills a triangle given in pixels and 1/t (float32), seen from its front.

    It is made larger by `grow` pixels (float32) on every side, and by a very little in any case.
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
    a = a_x * (px - ax) + a_y * (py - ay) + _EDGE + grow * (abs(a_x) + abs(a_y))
    b = b_x * (px - bx) + b_y * (py - by) + _EDGE + grow * (abs(b_x) + abs(b_y))
    c = c_x * (px - cx) + c_y * (py - cy) + _EDGE + grow * (abs(c_x) + abs(c_y))
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


@compiled(error_model="numpy", fastmath=True)
def draw_cut_triangle(
    seen, v0, v1, v2, focal, middle_x, middle_y, corners, paint, grow, image
):  # fmt: skip
    """Fills what is left of a triangle beyond the near plane.

    Its corners are columns of `seen`, as `vertex_block` writes them; `corners` [3, 4] is scratch.
    """
    near = np.float32(NEAR)
    px, py, pz = corners[0], corners[1], corners[2]
    count = 0
    for i in range(3):
        v, w = (v0, v1, v2)[i], (v1, v2, v0)[i]
        depth_v, depth_w = seen[2, v], seen[2, w]
        if depth_v >= near:
            pz[count] = np.float32(1.0) / depth_v
            px[count] = middle_x + focal * pz[count] * seen[0, v]
            py[count] = middle_y - focal * pz[count] * seen[1, v]
            count += 1
        if (depth_v >= near) != (depth_w >= near):
            f = (near - depth_v) / (depth_w - depth_v)
            pz[count] = np.float32(1.0) / near
            right = seen[0, v] + f * (seen[0, w] - seen[0, v])
            up = seen[1, v] + f * (seen[1, w] - seen[1, v])
            px[count] = middle_x + focal * pz[count] * right
            py[count] = middle_y - focal * pz[count] * up
            count += 1
    for i in range(2, count):
        draw_triangle(
            px[0], py[0], pz[0], px[i - 1], py[i - 1], pz[i - 1], px[i], py[i], pz[i], paint, grow,
            image,
        )  # fmt: skip


@compiled(error_model="numpy", fastmath=True)
def draw_mesh(
    mesh, atlas, position, rotation, scale, colors, eye, frame, focal, middle_x, middle_y, slant_x,
    slant_y, seen, lit, front, image,
):  # fmt: skip
    """Draws one mesh of the atlas.

    `frame` [3, 3] holds right, up and forward, `slant_x` and `slant_y` the sine and cosine of half
    the field of view sideways and upwards, `image` is that of `draw_triangle`; `seen` [6, V],
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
    source, target = address(vertices) + 4 * first, address(seen)
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
    sun = UNIT_SUN
    sun_x = rotation[0, 0] * sun[0] + rotation[1, 0] * sun[1] + rotation[2, 0] * sun[2]
    sun_y = rotation[0, 1] * sun[0] + rotation[1, 1] * sun[1] + rotation[2, 1] * sun[2]
    sun_z = rotation[0, 2] * sun[0] + rotation[1, 2] * sun[1] + rotation[2, 2] * sun[2]
    fade = np.float32(1.0 / (1.0 + max(m[2, 3], np.float32(0.0)) ** 2 * FADE2))
    base, slope = fade * (MESH_DARK + 0.5 * MESH_SUN), fade * 0.5 * MESH_SUN
    first, last = first_triangle[mesh], first_triangle[mesh + 1]
    source, target = address(normals) + 4 * first, address(lit)
    for k in range(0, 4 * (last - first), 4 * LANES):
        light_block(
            source + k, normals.strides[0], target + k, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z,
            base, slope,
        )  # fmt: skip
    no_growth = np.float32(0.0)
    count = 0
    for k in range(last - first):
        front[count] = k
        count += lit[k] > 0.0
    if middle[2] - radius > NEAR:
        x, y, inverse = seen[3], seen[4], seen[5]
        for n in range(count):
            k = front[n]
            a, b, c = triangles[first + k, 0], triangles[first + k, 1], triangles[first + k, 2]
            draw_triangle(
                x[a], y[a], inverse[a], x[b], y[b], inverse[b], x[c], y[c], inverse[c],
                _paint(colors, parts[first + k], lit[k]), no_growth, image,
            )  # fmt: skip
        return
    corners = np.empty((3, 4), np.float32)
    for n in range(count):
        k = front[n]
        draw_cut_triangle(
            seen, triangles[first + k, 0], triangles[first + k, 1], triangles[first + k, 2], focal,
            middle_x, middle_y, corners, _paint(colors, parts[first + k], lit[k]), no_growth, image,
        )  # fmt: skip


@compiled(error_model="numpy", fastmath=True)
def _paint(colors, part, light):
    red, green, blue = colors[part, 0], colors[part, 1], colors[part, 2]
    return np.int32(red * light) | np.int32(green * light) << 8 | np.int32(blue * light) << 16
