"""The meshes of the playroom: their conventions, their differences and their file."""

import math
from itertools import pairwise
from pathlib import Path

import build_meshes
import numpy as np
import pytest
from conftest import naming
from surfaces import (
    assert_closed_and_outward,
    assert_is,
    assert_no_shared_plane,
    assert_outlines_differ,
    inside,
    mesh_of,
)

from zipf.envs.playroom.constants import EYE, FURNITURE_SIZE
from zipf.envs.playroom.levels import OBJECTS, SUPPORTS
from zipf.envs.playroom.view import FIELD_OF_VIEW
from zipf.envs.render3d import load_meshes

ROOT = Path(__file__).parent.parent
FILE = ROOT / "zipf" / "envs" / "render3d" / "meshes.npz"
NAMES = [*OBJECTS, *SUPPORTS]
ATLAS = load_meshes()


def mesh(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return mesh_of(ATLAS, name)


def test_the_atlas_has_every_object_by_rank_and_the_furniture():
    assert list(ATLAS.names) == NAMES
    assert [ATLAS.index(name) for name in ("duck", "pyramid", "tray")] == [0, 49, 51]
    with pytest.raises(KeyError, match="no mesh 'unicorn'; there are duck, ball"):
        ATLAS.index("unicorn")


def test_the_atlas_is_loaded_once_and_its_arrays_are_as_documented():
    assert load_meshes() is ATLAS
    v, t, n = len(ATLAS.vertices), len(ATLAS.triangles), len(NAMES)
    for field, dtype, shape in (
        ("vertices", np.float32, (v, 3)),
        ("triangles", np.int32, (t, 3)),
        ("parts", np.uint8, (t,)),
        ("first_vertex", np.int32, (n + 1,)),
        ("first_triangle", np.int32, (n + 1,)),
        ("extent", np.float32, (n, 3)),
    ):
        array = getattr(ATLAS, field)
        assert (array.dtype, array.shape) == (dtype, shape), field
        assert not array.flags.writeable, field
    assert (ATLAS.first_vertex[0], ATLAS.first_vertex[-1]) == (0, v)
    assert (ATLAS.first_triangle[0], ATLAS.first_triangle[-1]) == (0, t)
    assert ATLAS.parts.max() <= 5


def test_a_mesh_stands_on_its_origin():
    for name in NAMES:
        with naming(name):
            vertices, triangles, _ = mesh(name)
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            assert low[2] == 0
            np.testing.assert_allclose((low + high)[:2], 0, atol=2e-5)
            np.testing.assert_allclose(ATLAS.extent[ATLAS.index(name)], high - low, atol=1e-6)
            assert sorted(set(triangles.ravel())) == list(range(len(vertices)))
            assert 60 <= len(triangles) <= 260


def test_a_toy_is_larger_than_another_where_the_thing_it_stands_for_is():
    longest = dict(zip(ATLAS.names, ATLAS.extent.max(axis=1).tolist(), strict=True))
    for smaller, larger in pairwise(
        ("dice", "apple", "key", "mug", "fork", "ball", "teapot", "hammer", "basket", "pillow",
         "chair", "guitar", "piano", "bed")
    ):  # fmt: skip
        assert longest[smaller] < 0.99 * longest[larger], (smaller, larger)


def test_a_toy_is_large_enough_to_see_and_small_enough_for_the_tray():
    for name in OBJECTS:
        with naming(name):
            width, depth, height = ATLAS.extent[ATLAS.index(name)].tolist()
            focal = 96 / 2 / math.tan(math.radians(FIELD_OF_VIEW) / 2)
            pixels = max(width, depth, height) * focal / math.hypot(2.0, EYE)  # from 2 m away
            assert pixels > 6.5
            assert min(width, depth) < 2 * FURNITURE_SIZE[1, 1]
            assert max(width, depth) < 2 * FURNITURE_SIZE[1, 0]


def test_a_mesh_is_made_of_closed_surfaces_that_face_outwards():
    for name in NAMES:
        with naming(name):
            assert_closed_and_outward(*mesh(name)[:2])


@pytest.mark.slow
def test_no_two_colours_lie_in_one_plane():
    """The depth buffer could not decide between them."""
    for name in NAMES:
        with naming(name):
            assert_no_shared_plane(*mesh(name))


def heights(name: str, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """The height of the topmost surface at each (x, y): [len(xs) * len(ys)]."""
    vertices, triangles, _ = mesh(name)
    corners = vertices[triangles]
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    found = np.full(len(points), -np.inf)
    for triangle, hit in zip(corners, inside(points, corners[:, :, :2]), strict=True):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
        if hit.any():
            slope = np.linalg.solve([(bx - ax, by - ay), (cx - ax, cy - ay)], [bz - az, cz - az])
            found[hit] = np.maximum(found[hit], az + (points[hit] - (ax, ay)) @ slope)
    return found


def test_the_tops_of_bed_and_tray_are_level():
    bed = heights("bed", np.linspace(-0.301, 0.631, 23), np.linspace(-0.403, 0.401, 17))
    np.testing.assert_allclose(bed, 0.35, atol=1e-6)
    tray = heights("tray", np.linspace(-0.241, 0.243, 23), np.linspace(-0.161, 0.163, 17))
    np.testing.assert_allclose(tray, 0.03, atol=1e-6)
    np.testing.assert_allclose(ATLAS.extent[[50, 51], :2], [(1.4, 0.9), (0.6, 0.45)], atol=1e-5)
    assert ATLAS.extent[51, 2] == pytest.approx(0.06)
    vertices, _, _ = mesh("bed")
    top = vertices[vertices[:, 2] == vertices[:, 2].max()]
    assert (top[:, 0] < -0.55).all()  # the headboard


@pytest.mark.slow
def test_no_two_toys_are_alike():
    assert_outlines_differ(ATLAS, OBJECTS, step=30, above=30, pixels=32)


@pytest.mark.slow
def test_the_file_is_what_the_command_builds():
    assert_is(ATLAS, build_meshes.pack(build_meshes.build()))
    assert FILE.stat().st_size < 5e6
