"""Draws instances of meshes, triangle by triangle."""

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import address, light_block, vertex_block
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import FADE2, MESH_DARK, MESH_SUN, NEAR
from zipf.envs.render3d.triangles import draw_cut_triangle, draw_triangle


@compiled(error_model="numpy", fastmath=True)
def draw_instance(
    mesh, position, rotation, scale, meshes, palette, sun, eye, projection, canvas, buffers
):  # fmt: skip
    """Draws an instance of a mesh.

    Args:
        mesh, position, rotation, scale: of `Instances`.
        meshes: `Meshes`.
        palette: the colours of the mesh's parts in the light of the lamp, float32 [6, 3].
        sun: of the mesh's world.
        eye: a row of `Scenes.camera`.
        projection, canvas: `Projection`, `Canvas`.
        buffers: `MeshBuffers`, written.
    """
    frame, focal = projection.frame, projection.focal
    middle_x, middle_y = projection.middle_x, projection.middle_y
    slant_x, slant_y = projection.slant_x, projection.slant_y
    vertices, planes, triangles = meshes.vertices, meshes.planes, meshes.triangles
    seen, lit, front = buffers.seen, buffers.lit, buffers.front
    ball = meshes.balls[mesh]
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
    first, last = meshes.first_vertex[mesh], meshes.first_vertex[mesh + 1]
    source, target = address(vertices) + 4 * first, address(seen)
    for k in range(0, 4 * (last - first), 4 * LANES):
        vertex_block(
            source + k, vertices.strides[0], target + k, seen.strides[0], m[0, 0], m[0, 1], m[0, 2],
            m[0, 3], m[1, 0], m[1, 1], m[1, 2], m[1, 3], m[2, 0], m[2, 1], m[2, 2], m[2, 3], focal,
            middle_x, middle_y,
        )  # fmt: skip
    # The eye and the sun, in the mesh's own coordinates.
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
    sun_x = rotation[0, 0] * sun[0] + rotation[1, 0] * sun[1] + rotation[2, 0] * sun[2]
    sun_y = rotation[0, 1] * sun[0] + rotation[1, 1] * sun[1] + rotation[2, 1] * sun[2]
    sun_z = rotation[0, 2] * sun[0] + rotation[1, 2] * sun[1] + rotation[2, 2] * sun[2]
    fade = np.float32(1.0 / (1.0 + max(m[2, 3], np.float32(0.0)) ** 2 * FADE2))
    base, slope = fade * (MESH_DARK + 0.5 * MESH_SUN), fade * 0.5 * MESH_SUN
    first, last = meshes.first_triangle[mesh], meshes.first_triangle[mesh + 1]
    source, target = address(planes) + 4 * first, address(lit)
    for k in range(0, 4 * (last - first), 4 * LANES):
        light_block(
            source + k, planes.strides[0], target + k, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z,
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
                _paint(palette, meshes.parts[first + k], lit[k]), no_growth, canvas,
            )  # fmt: skip
        return
    corners = np.empty((3, 4), np.float32)
    for n in range(count):
        k = front[n]
        draw_cut_triangle(
            seen, triangles[first + k, 0], triangles[first + k, 1], triangles[first + k, 2],
            projection, corners, _paint(palette, meshes.parts[first + k], lit[k]), no_growth,
            canvas,
        )  # fmt: skip


@compiled(error_model="numpy", fastmath=True)
def _paint(palette, part, light):
    """The colour 0x00BBGGRR of a part of a mesh in a light of 0 .. 1."""
    red, green, blue = palette[part, 0], palette[part, 1], palette[part, 2]
    return np.int32(red * light) | np.int32(green * light) << 8 | np.int32(blue * light) << 16
