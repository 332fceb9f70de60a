"""Draws instances of meshes, triangle by triangle."""

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import (
    TRIANGLE_LANES,
    address,
    light_block,
    pattern_block,
    vertex_block,
)
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import FADE2, MESH_DARK, MESH_SUN, NEAR, PATTERN
from zipf.envs.render3d.textures import SIZE
from zipf.envs.render3d.triangles import draw_cut_triangle, draw_smooth_triangle, draw_triangle

_PER_METRE = SIZE / PATTERN  # texels of a pattern
# Added to coordinates, so that no texel has a negative number, and a texture's middle is at x = 0
# and y = 0, where meshes have theirs.
_SHIFT = (16.5 * SIZE, 16.5 * SIZE, 16.0 * SIZE)


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_instance(
    mesh, position, rotation, scale, pattern, texels, meshes, palette, sun, eye, projection, canvas,
    buffers,
):  # fmt: skip
    """Draws an instance of a mesh.

    Args:
        mesh, position, rotation, scale, pattern: of `Instances`.
        texels: of `Assets`.
        meshes: `Meshes`.
        palette: the colours of the mesh's parts in the light of the lamp, float32 [6, 3].
        sun: of the mesh's env.
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
    m = buffers.matrix
    offset, middle = buffers.vectors[0], buffers.vectors[1]
    for i in range(3):
        offset[i] = position[i] - eye[i]
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
    if pattern < 0:
        # Normals at corners face the eye as far as is known: the last line of `corners` is -1.
        corner_lit = buffers.corner_lit
        source, target = address(meshes.corners) + 12 * first, address(corner_lit)
        zero = np.float32(0.0)
        for k in range(0, 12 * (last - first), 4 * LANES):
            light_block(
                source + k, meshes.corners.strides[0], target + k, zero, zero, zero, sun_x, sun_y,
                sun_z, base, slope,
            )  # fmt: skip
    no_growth = np.float32(0.0)
    count = 0
    for k in range(last - first):
        front[count] = k
        count += lit[k] > 0.0
    cut = middle[2] - radius <= NEAR
    if pattern >= 0:
        _measure(eye_x, eye_y, eye_z, scale, projection.focal, planes, first, front, count, buffers)
    x, y, inverse = seen[3], seen[4], seen[5]
    for n in range(count):
        k = front[n]
        a, b, c = triangles[first + k, 0], triangles[first + k, 1], triangles[first + k, 2]
        part = meshes.parts[first + k]
        if cut:
            paint = _paint(palette, part, lit[k], pattern, k)
            draw_cut_triangle(seen, a, b, c, projection, buffers.corners, paint, no_growth, canvas)
        elif pattern < 0 and meshes.smooth[first + k]:
            draw_smooth_triangle(
                x[a], y[a], inverse[a], corner_lit[3 * k], x[b], y[b], inverse[b],
                corner_lit[3 * k + 1], x[c], y[c], inverse[c], corner_lit[3 * k + 2],
                palette[part], canvas,
            )  # fmt: skip
        else:
            draw_triangle(
                x[a], y[a], inverse[a], x[b], y[b], inverse[b], x[c], y[c], inverse[c],
                _paint(palette, part, lit[k], pattern, k), no_growth, canvas,
            )  # fmt: skip
    if pattern >= 0:
        bounds = (0, canvas.width - 1, 0, canvas.height - 1)
        if not cut:
            vertex_count = meshes.first_vertex[mesh + 1] - meshes.first_vertex[mesh]
            bounds = _bounds(seen, vertex_count, canvas)
        _draw_pattern(
            address(texels) + 4 * texels.shape[1] * pattern, bounds, rotation, offset, palette,
            projection, canvas, buffers,
        )  # fmt: skip


@compiled(references=False, error_model="numpy", fastmath=True)
def _paint(palette, part, light, pattern, triangle):
    """The colour 0x00BBGGRR of a part of a mesh in a light of 0 .. 1.
    With a pattern, the number of the triangle for `pattern_block`, if the part has the pattern."""
    if pattern >= 0 and part < 2:
        return np.int32(triangle - (1 << 31))
    red, green, blue = palette[part, 0], palette[part, 1], palette[part, 2]
    return np.int32(red * light) | np.int32(green * light) << 8 | np.int32(blue * light) << 16


@compiled(references=False, error_model="numpy", fastmath=True)
def _measure(eye_x, eye_y, eye_z, scale, focal, planes, first, front, count, buffers):
    """Writes `axis` and `area` of the triangles that face the eye, in mesh coordinates."""
    for n in range(count):
        k = front[n]
        x, y, z = planes[0, first + k], planes[1, first + k], planes[2, first + k]
        axis, most = 0, abs(x)
        if abs(y) > most:
            axis, most = 1, abs(y)
        if abs(z) > most:
            axis, most = 2, abs(z)
        away = scale * (x * eye_x + y * eye_y + z * eye_z - planes[3, first + k])
        buffers.axis[k] = axis
        buffers.area[k] = most * (_PER_METRE / focal) ** 2 / max(away, np.float32(1e-6))


@compiled(references=False, error_model="numpy", fastmath=True)
def _bounds(seen, vertex_count, canvas):
    """First and last column and row of the pixels of a mesh that is ahead."""
    left, right, top, bottom = seen[3, 0], seen[3, 0], seen[4, 0], seen[4, 0]
    for k in range(1, vertex_count):
        left, right = min(left, seen[3, k]), max(right, seen[3, k])
        top, bottom = min(top, seen[4, k]), max(bottom, seen[4, k])
    return (
        max(np.int64(left), 0),
        min(np.int64(right) + 1, canvas.width - 1),
        max(np.int64(top), 0),
        min(np.int64(bottom) + 1, canvas.height - 1),
    )


@compiled(references=False, error_model="numpy", fastmath=True)
def _draw_pattern(texels, bounds, rotation, offset, palette, projection, canvas, buffers):
    """Paints the pixels that hold numbers of triangles. The pattern, whose address is `texels`,
    mixes the first two colours of `palette`; `offset` is the mesh's from the eye."""
    left, right, top, bottom = bounds
    frame, focal = projection.frame, projection.focal
    # In texels along the mesh's axes: the eye, and the rays of the first pixel and per pixel.
    eye, ray = buffers.vectors[2], buffers.vectors[3]
    across, down = buffers.vectors[4], buffers.vectors[5]
    for j in range(3):
        back, aside, up, ahead = 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            turned = _PER_METRE * rotation[i, j]
            back += turned * offset[i]
            aside += turned * frame[0, i]
            up += turned * frame[1, i]
            ahead += turned * frame[2, i]
        eye[j] = _SHIFT[j] - back
        across[j], down[j] = aside / focal, -up / focal
        ray[j] = ahead - projection.middle_x * across[j] - projection.middle_y * down[j]
    red, green, blue = palette[0, 0], palette[0, 1], palette[0, 2]
    to_red, to_green, to_blue = palette[1, 0] - red, palette[1, 1] - green, palette[1, 2] - blue
    lit, axis, area = address(buffers.lit), address(buffers.axis), address(buffers.area)
    for y in range(top, bottom + 1):
        row = np.float32(y)
        ray_x, ray_y = ray[0] + row * down[0], ray[1] + row * down[1]
        ray_z = ray[2] + row * down[2]
        # Triangles are filled in blocks, which may go beyond the image by some pixels.
        for x in range(left & -LANES, right + TRIANGLE_LANES, LANES):
            at = 4 * (y * canvas.stride + x)
            pattern_block(
                canvas.colour + at, canvas.depth + at, texels, x, lit, axis, area, eye[0], ray_x,
                across[0], eye[1], ray_y, across[1], eye[2], ray_z, across[2], red, green, blue,
                to_red, to_green, to_blue,
            )  # fmt: skip
