"""Textures and meshes, laid out as the compiled functions read them."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.meshes import MeshAtlas
from zipf.envs.render3d.textures import SIZE

FIXED_COLOURS = np.array(
    [(40, 40, 40), (235, 235, 235), (150, 105, 65), (70, 140, 60)], dtype=np.uint8
)
"""Colours of the parts of meshes from part 2 on: dark, light, wood, green."""


def pack_textures(textures: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Textures and their smaller versions as texels 0xAABBGGRR, uint32 [K, 2 * SIZE * SIZE].

    Version n is half as large as the one before it, and begins at texel SIZE * SIZE >> 2 * n. All
    are smoothed by a filter as wide as two of their texels, so that a pixel that covers two texels
    of a version may show any one of them. The colours are averages over what is not a hole.
    """
    packed = np.zeros((len(textures), 2 * SIZE * SIZE), np.uint32)
    alpha: Any = textures[..., 3:] / np.float32(255)
    colour: Any = textures[..., :3] * alpha
    size = SIZE
    while True:
        share = _smooth(alpha)
        rgb = np.round(_smooth(colour) / np.maximum(share, 1e-6)).astype(np.uint32)
        opaque = np.round(share[..., 0] * 255).astype(np.uint32)
        texels = rgb[..., 0] | rgb[..., 1] << 8 | rgb[..., 2] << 16 | opaque << 24
        packed[:, size * size : 2 * size * size] = texels.reshape(len(textures), -1)
        if size == 1:
            return packed
        size //= 2
        colour, alpha = (
            a.reshape(len(a), size, 2, size, 2, -1).mean((2, 4)) for a in (colour, alpha)
        )


def _smooth(image: NDArray[Any]) -> NDArray[Any]:
    """Every texel of images [K, H, W, C] mixed with its neighbours; images repeat."""
    for axis in (1, 2):
        image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image


_ROUND = np.cos(np.radians(50))
"""Between triangles whose normals differ by a larger angle there is an edge: a prism of eight sides
is round, one of six is not. Ours."""


@cache
def prepare_meshes(meshes: MeshAtlas) -> tuple[NDArray[Any], ...]:
    """An atlas as the fields of `arrays.Meshes`, which all its renderers share."""
    owner = np.repeat(np.arange(len(meshes.names)), np.diff(meshes.first_triangle))
    corners = meshes.vertices[meshes.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    planes = np.concatenate([normals, (normals * corners[:, 0]).sum(1, keepdims=True)], axis=1)
    rounded = _rounded_normals(meshes, normals, corners)
    balls = np.zeros((len(meshes.names), 4), np.float32)
    for ball, first, last in zip(
        balls, meshes.first_vertex[:-1], meshes.first_vertex[1:], strict=True
    ):
        own = meshes.vertices[first:last]
        ball[:3] = (own.min(0) + own.max(0)) / 2
        ball[3] = np.linalg.norm(own - ball[:3], axis=1).max()
    local = meshes.triangles - meshes.first_vertex[owner][:, None]
    return (
        _lines(meshes.vertices),
        np.ascontiguousarray(local, np.int32),
        _lines(planes),
        _lines(np.insert(rounded.reshape(-1, 3), 3, -1.0, axis=1)),
        (np.abs(rounded - normals[:, None]).max((1, 2)) > 1e-3).astype(np.uint8),
        np.ascontiguousarray(meshes.parts, np.uint8),
        np.ascontiguousarray(meshes.first_vertex, np.int32),
        np.ascontiguousarray(meshes.first_triangle, np.int32),
        balls,
    )


def _rounded_normals(
    meshes: MeshAtlas, normals: NDArray[Any], corners: NDArray[Any]
) -> NDArray[np.float64]:
    """The normals of round surfaces at the corners of triangles, [T, 3, 3]: at each the mean of the
    triangle's and its neighbours', weighted by their areas, but for those beyond an edge."""
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    vertex = meshes.triangles.ravel()
    corners_at = np.argsort(vertex, kind="stable")  # by vertex
    number = np.bincount(vertex)
    last = np.cumsum(number)[vertex]
    # Every corner with every triangle around its vertex.
    one = np.repeat(np.arange(len(vertex)), number[vertex])
    step = np.arange(len(one)) - np.repeat(np.cumsum(number[vertex]), number[vertex])
    other = corners_at[last[one] + step] // 3
    near = (normals[one // 3] * normals[other]).sum(1) > _ROUND
    rounded = np.zeros((len(normals), 3, 3))
    np.add.at(rounded.reshape(-1, 3), one[near], areas[other[near], None] * normals[other[near]])
    return rounded / np.maximum(np.linalg.norm(rounded, axis=2, keepdims=True), 1e-12)


def _lines(rows: NDArray[Any]) -> NDArray[np.float32]:
    """The columns of `rows` as lines, each with a block of LANES unused numbers at its end."""
    lines = np.zeros((rows.shape[1], len(rows) + LANES), np.float32)
    lines[:, : len(rows)] = rows.T
    return lines
