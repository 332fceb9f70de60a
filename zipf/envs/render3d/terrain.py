"""Draws a terrain: heights at the corners of a grid, two triangles to a cell.

Triangles are small and many, and nearer ground hides most of them. So the pixels of a triangle are
first filled with its number only. Then every pixel of the terrain is painted once: its position on
the ground follows from its depth, and its texel from that.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import address, cell_block, terrain_block, vertex_block
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import FADE2, MESH_DARK, MESH_SUN, NEAR, light_on
from zipf.envs.render3d.textures import SIZE
from zipf.envs.render3d.triangles import draw_cut_triangle, draw_triangle

_GROW = np.float32(1e-3)  # pixels: triangles that reach far outside the image are rounded more


def terrain_buffers(rows: int, columns: int) -> tuple[NDArray[Any], ...]:
    """The fields of `arrays.TerrainBuffers` for terrains of this many cells."""
    line = np.zeros((3, columns + 1 + LANES), np.float32)
    line[0] = np.arange(line.shape[1])
    return (
        line,
        np.zeros((6, 2 * line.shape[1]), np.float32),
        np.zeros(columns + LANES, np.int32),
        np.zeros(columns + 1, np.int32),
        np.zeros(2 * rows * columns, np.float32),
        np.zeros(2 * rows * columns, np.float32),
        np.zeros((3, 4), np.float32),
    )


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_terrain(
    heights, place, tint, sun, lamp, view, projection, texels, canvas, image, buffers
):  # fmt: skip
    """Draws a terrain where nothing has been drawn yet but the sky.

    Args:
        heights, place, tint: of `Terrains`, for one env.
        sun, lamp: of the env.
        view, projection, canvas: `View`, `Projection`, `Canvas`.
        texels: of the terrain's texture.
        image, buffers: `ImageBuffers` and `TerrainBuffers`, written.
    """
    eye_x, eye_y, eye_z, hx, hy = view.x, view.y, view.z, view.hx, view.hy
    c0, dc, a0, da = view.c0, view.dc, view.a0, view.da
    frame, focal = projection.frame, projection.focal
    middle_x, middle_y = projection.middle_x, projection.middle_y
    colour, depth = image.colour, image.depth
    line, seen, kinds, shown, light, area, corners = buffers
    rows, columns = heights.shape[0] - 1, heights.shape[1] - 1
    west, south = np.float64(place[0]), np.float64(place[1])
    size, repeat = np.float64(place[2]), np.float64(place[3])
    width, height = canvas.width, canvas.height
    stride = line.shape[1]
    side = (middle_x + 1.0) / focal
    per_texel = SIZE / repeat
    texels_each = per_texel * per_texel * da * da
    per_size = 1.0 / size
    dx, dz = west - eye_x, -eye_z
    line_at, seen_at, kinds_at = address(line), address(seen), address(kinds)
    for row in range(rows + 1):
        for column in range(columns + 1):
            line[2, column] = heights[row, column]
        dy = south + size * row - eye_y
        now, last = (row & 1) * stride, (~row & 1) * stride
        for k in range(0, columns + 1, LANES):
            vertex_block(
                line_at + 4 * k, line.strides[0], seen_at + 4 * (now + k), seen.strides[0],
                size * frame[0, 0], 0.0, 0.0, frame[0, 0] * dx + frame[0, 1] * dy,
                size * frame[1, 0], 0.0, frame[1, 2],
                frame[1, 0] * dx + frame[1, 1] * dy + frame[1, 2] * dz,
                size * frame[2, 0], 0.0, frame[2, 2],
                frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz,
                focal, middle_x, middle_y,
            )  # fmt: skip
        if row == 0:
            continue
        for k in range(0, columns, LANES):
            cell_block(
                seen_at + 4 * (last + k), seen_at + 4 * (now + k), seen.strides[0],
                kinds_at + 4 * k, width - 1, height - 1, NEAR, side,
            )  # fmt: skip
        count = 0
        for column in range(columns):
            shown[count] = column
            count += kinds[column] != 0
        for n in range(count):
            column = shown[n]
            cell = (row - 1) * columns + column
            low, low_east = heights[row - 1, column], heights[row - 1, column + 1]
            high_west, high = heights[row, column], heights[row, column + 1]
            for half in range(2):
                if half == 0:
                    a, b, c = last + column, last + column + 1, now + column + 1
                    east, north = (low_east - low) * per_size, (high - low_east) * per_size
                else:
                    a, b, c = last + column, now + column + 1, now + column
                    east, north = (high - high_west) * per_size, (high_west - low) * per_size
                # The height of the eye above the triangle's plane.
                above = eye_z - low + east * (dx + size * column) + north * (dy - size)
                if above <= 0.0:
                    continue
                number = 2 * cell + half
                area[number] = texels_each / above
                up = 1.0 / math.sqrt(1.0 + east * east + north * north)
                light[number] = light_on(-east * up, -north * up, up, MESH_DARK, MESH_SUN, sun)
                if kinds[column] == 2:
                    draw_cut_triangle(seen, a, b, c, projection, corners, number, _GROW, canvas)
                else:
                    draw_triangle(
                        seen[3, a], seen[4, a], seen[5, a], seen[3, b], seen[4, b], seen[5, b],
                        seen[3, c], seen[4, c], seen[5, c], number, _GROW, canvas,
                    )  # fmt: skip

    lines, depths = address(colour), address(depth)
    texels_at, light_at, area_at = address(texels), address(light), address(area)
    for y in range(height):
        c = c0 + dc * y
        for x in range(0, width, LANES):
            at = 4 * (y * colour.shape[1] + x)
            terrain_block(
                lines + at, depths + at, texels_at, x, light_at, area_at,
                -dx * per_texel, (hx * c + hy * a0) * per_texel, hy * da * per_texel,
                (eye_y - south) * per_texel, (hy * c - hx * a0) * per_texel, -hx * da * per_texel,
                FADE2, lamp[0] * tint[0] / 255, lamp[1] * tint[1] / 255, lamp[2] * tint[2] / 255,
            )  # fmt: skip
