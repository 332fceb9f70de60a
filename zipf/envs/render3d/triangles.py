"""Fills triangles, for meshes and terrains."""

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import TRIANGLE_LANES, smooth_triangle_block, triangle_block
from zipf.envs.render3d.optics import NEAR
from zipf.envs.render3d.rounding import ceil, floor

_EDGE = np.float32(1e-4)  # pixels, so that rounding leaves no gap between neighbours


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, paint, grow, canvas):
    """Fills a triangle given in pixels and 1/t (float32), unless it is seen from its back.
    It is made larger by `grow` pixels (float32) on every side, and by _EDGE in any case."""
    left = max(ceil(min(ax, bx, cx)), 0)
    right = min(floor(max(ax, bx, cx)), canvas.width - 1)
    top = max(ceil(min(ay, by, cy)), 0)
    bottom = min(floor(max(ay, by, cy)), canvas.height - 1)
    if left > right or top > bottom:
        return
    # The distance inside of each edge, times its length; and 1/t.
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
    start = top * canvas.stride + left
    for _ in range(top, bottom + 1):
        for x in range(0, right - left + 1, TRIANGLE_LANES):
            at = 4 * (start + x)
            triangle_block(
                canvas.colour + at, canvas.depth + at, x, paint, z, dz, a, a_x, b, b_x, c, c_x
            )
        a += a_y
        b += b_y
        c += c_y
        z += dz_row
        start += canvas.stride


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_smooth_triangle(ax, ay, az, al, bx, by, bz, bl, cx, cy, cz, cl, colour, canvas):
    """Like `draw_triangle`, in a colour, float32 [3], in the light al, bl, cl at the corners."""
    left = max(ceil(min(ax, bx, cx)), 0)
    right = min(floor(max(ax, bx, cx)), canvas.width - 1)
    top = max(ceil(min(ay, by, cy)), 0)
    bottom = min(floor(max(ay, by, cy)), canvas.height - 1)
    if left > right or top > bottom:
        return
    a_x, a_y = by - ay, ax - bx
    b_x, b_y = cy - by, bx - cx
    c_x, c_y = ay - cy, cx - ax
    area = a_x * c_y - a_y * c_x
    if area <= 0.0:
        return
    per_area = np.float32(1.0) / area
    dz = ((cz - az) * a_x + (bz - az) * c_x) * per_area
    dz_row = ((cz - az) * a_y + (bz - az) * c_y) * per_area
    dl = ((cl - al) * a_x + (bl - al) * c_x) * per_area
    dl_row = ((cl - al) * a_y + (bl - al) * c_y) * per_area
    px, py = np.float32(left), np.float32(top)
    a = a_x * (px - ax) + a_y * (py - ay) + _EDGE
    b = b_x * (px - bx) + b_y * (py - by) + _EDGE
    c = c_x * (px - cx) + c_y * (py - cy) + _EDGE
    z = az + dz * (px - ax) + dz_row * (py - ay)
    light = al + dl * (px - ax) + dl_row * (py - ay)
    red, green, blue = colour[0], colour[1], colour[2]
    start = top * canvas.stride + left
    for _ in range(top, bottom + 1):
        for x in range(0, right - left + 1, TRIANGLE_LANES):
            at = 4 * (start + x)
            smooth_triangle_block(
                canvas.colour + at, canvas.depth + at, x, z, dz, a, a_x, b, b_x, c, c_x, light, dl,
                red, green, blue,
            )  # fmt: skip
        a += a_y
        b += b_y
        c += c_y
        z += dz_row
        light += dl_row
        start += canvas.stride


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_cut_triangle(seen, v0, v1, v2, projection, corners, paint, grow, canvas):
    """Fills the part of a triangle that is beyond the near plane.

    Its corners are the columns v0, v1, v2 of `seen`, as `vertex_block` writes them. `corners`,
    float32 [3, 4], is overwritten.
    """
    focal, middle_x, middle_y = projection.focal, projection.middle_x, projection.middle_y
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
            canvas,
        )  # fmt: skip
