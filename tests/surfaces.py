"""Checks of meshes that hold for every atlas."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from zipf.envs.render3d import MeshAtlas


def mesh_of(atlas: MeshAtlas, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles (indices into just these vertices) and parts of one mesh."""
    i = atlas.index(name)
    vertices = slice(atlas.first_vertex[i], atlas.first_vertex[i + 1])
    triangles = slice(atlas.first_triangle[i], atlas.first_triangle[i + 1])
    return (
        atlas.vertices[vertices].astype(np.float64),
        atlas.triangles[triangles] - atlas.first_vertex[i],
        atlas.parts[triangles],
    )


def solids(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """For each triangle the number of the connected surface that it belongs to."""
    label = np.arange(len(vertices))
    while True:
        lowest = label[triangles].min(axis=1)
        spread = label.copy()
        np.minimum.at(spread, triangles.ravel(), lowest.repeat(3))
        if np.array_equal(spread, label):
            return label[triangles[:, 0]]
        label = spread


def inside(points: np.ndarray, corners: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Which points [P, 2] lie in which triangles [T, 3, 2]: bool [T, P]."""
    a, b, c = corners.transpose(1, 0, 2)[:, :, None]

    def side(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (v[..., 0] - u[..., 0]) * (points[:, 1] - u[..., 1]) - (v[..., 1] - u[..., 1]) * (
            points[:, 0] - u[..., 0]
        )

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    return (sides > margin).all(axis=0) | (sides < -margin).all(axis=0)


def assert_closed_and_outward(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Every edge has a triangle on either side, and no surface is inside out."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = {tuple(edge) for edge in edges.tolist()}
    assert len(there) == len(edges)
    assert there == {(b, a) for a, b in there}

    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normals, axis=1).min() > 1e-8
    surface = solids(vertices, triangles)
    for label in np.unique(surface):
        own = corners[surface == label] - corners[surface == label].mean(axis=(0, 1))
        volume = np.einsum("ti,ti->", own[:, 0], np.cross(own[:, 1], own[:, 2])) / 6
        assert volume > 1e-8


def assert_no_shared_plane(vertices: np.ndarray, triangles: np.ndarray, parts: np.ndarray) -> None:
    """No two colours lie in one plane: the depth buffer could not decide between them."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offset = np.einsum("ti,ti->t", normals, corners[:, 0])
    # [i, j]: the largest distance of triangle j from the plane of triangle i.
    far = np.abs(np.einsum("ik,jck->ijc", normals, corners) - offset[:, None, None]).max(axis=2)
    together = (far < 3e-5) & (normals @ normals.T > 0.999) & (parts[:, None] != parts)
    together &= normals[:, 2:] > -0.99  # the underside is never visible
    weights = np.array([(a, b, 6 - a - b) for a in range(1, 5) for b in range(1, 6 - a)]) / 6
    for i, j in zip(*np.nonzero(together), strict=True):
        axes = np.delete(np.arange(3), np.abs(normals[i]).argmax())
        shared = inside((weights @ corners[j])[:, axes], corners[i][None, :, axes], 1e-8)
        assert not shared.any(), (corners[i], corners[j])


def outlines(
    atlas: MeshAtlas, name: str, yaws: np.ndarray, *, above: float, pixels: int
) -> np.ndarray:
    """The outlines of a mesh from so many degrees above, by yaw: bool [yaws, pixels, pixels]."""
    vertices, triangles, _ = mesh_of(atlas, name)
    axis = ((np.arange(pixels) + 0.5) / pixels - 0.5) * 1.25 * atlas.extent[atlas.index(name)].max()
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    tilt = np.radians(above)
    views = []
    for yaw in yaws:
        c, s = np.cos(yaw), np.sin(yaw)
        right = vertices[:, 0] * c - vertices[:, 1] * s
        away = vertices[:, 0] * s + vertices[:, 1] * c
        up = vertices[:, 2] * np.cos(tilt) + away * np.sin(tilt)
        flat = np.stack([right, up], axis=1)
        flat -= (flat.min(axis=0) + flat.max(axis=0)) / 2
        views.append(inside(points, flat[triangles]).any(axis=0).reshape(pixels, pixels))
    return np.array(views)


def assert_outlines_differ(
    atlas: MeshAtlas, names: Sequence[str], *, step: int, above: float, pixels: int
) -> None:
    """From most sides, the outline of a mesh differs from all outlines of the others, even at the
    same size.

    The difference of two outlines is one minus the ratio of their intersection to their union. Two
    meshes differ by the median, over the yaws of one, which are `step` degrees apart, of the least
    difference over those of the other.
    """
    yaws = np.radians(np.arange(0, 360, step) + 10)
    views = {name: outlines(atlas, name, yaws, above=above, pixels=pixels) for name in names}
    for one, other in combinations(names, 2):
        a, b = views[one][:, None], views[other][None]
        difference = 1 - (a & b).sum(axis=(2, 3)) / (a | b).sum(axis=(2, 3))
        told = max(np.median(difference.min(axis=1)), np.median(difference.min(axis=0)))
        assert told > 0.15, (one, other, told)


def assert_is(atlas: MeshAtlas, packed: dict[str, np.ndarray]) -> None:
    """An atlas has the arrays of what was built anew."""
    fresh = MeshAtlas(tuple(packed.pop("names").tolist()), **packed)
    assert fresh.names == atlas.names
    for field in ("triangles", "parts", "first_vertex", "first_triangle"):
        np.testing.assert_array_equal(getattr(fresh, field), getattr(atlas, field), err_msg=field)
    for field in ("vertices", "extent"):
        np.testing.assert_allclose(
            getattr(fresh, field), getattr(atlas, field), atol=2e-5, err_msg=field
        )
