"""The meshes of Zipf's Labyrinth: their names, sizes, colours and file."""

import math
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
    mesh_of,
)

import zipf.envs
from zipf.envs.render3d import Renderer, Scenes, load_meshes, pack_textures, textures

FILE = Path(zipf.envs.__file__).parent / "labyrinth" / "meshes.npz"
ATLAS = load_meshes(FILE)

# Centimetres along x, y and z, from the models of DMLab-30.
SHAPES = {
    "apple2": (40, 39, 37), "ball": (36, 36, 36), "balloon": (45, 45, 60), "banana": (19, 62, 30),
    "bottle": (20, 19, 54), "cake": (53, 53, 23), "can": (40, 40, 51), "car": (48, 97, 44),
    "cassette": (68, 12, 43), "chair": (86, 55, 70), "cherries": (21, 43, 37), "cow": (25, 94, 57),
    "flower": (27, 19, 44), "fork": (2, 8, 52), "fridge": (28, 26, 60), "guitar": (56, 9, 165),
    "hair_brush": (59, 3, 109), "hammer": (10, 19, 32), "hat": (50, 63, 37),
    "ice_lolly": (28, 16, 62), "jug": (33, 28, 41), "key": (7, 35, 62), "knife": (1, 6, 53),
    "ladder": (50, 20, 106), "mug": (43, 32, 34), "pencil": (54, 11, 54), "pig": (23, 68, 39),
    "pincer": (2, 12, 45), "plant": (30, 34, 34), "saxophone": (37, 13, 64), "shoe": (60, 26, 35),
    "spoon": (4, 13, 51), "suitcase": (66, 28, 56), "tennis_racket": (4, 24, 60),
    "tomato": (34, 33, 27), "toothbrush": (41, 7, 74), "tree": (48, 48, 52), "tv": (57, 41, 71),
    "wine_glass": (25, 25, 54), "zebra": (18, 83, 75),
}  # fmt: skip
FORMS = {
    "barbell": (14, 14, 32), "coil": (18, 18, 33), "cone": (23, 23, 32), "crossbar": (31, 31, 32),
    "cube": (32, 32, 32), "cylinder": (18, 18, 49), "double_prism": (32, 15, 15),
    "glow_ball": (30, 30, 32), "potcone": (32, 32, 30), "prism_jack": (32, 32, 32),
    "sphere": (30, 30, 32), "toroid": (32, 6, 34),
}  # fmt: skip
PROPS = {
    "apple": (25, 25, 30), "goal": (25, 25, 33), "key_large": (10, 47, 82),
    "ice_lolly_large": (43, 23, 92), "mushroom": (19, 18, 25), "teleport_pad": (48, 48, 8),
    "item_stand": (50, 45, 8), "box": (32, 32, 32), "cactus": (50, 100, 300),
    "rock_0": (100, 90, 70), "rock_1": (100, 90, 70), "rock_2": (100, 90, 70),
    "bush_0": (100, 100, 60), "bush_1": (100, 100, 60),
    "platform": (128, 128, 94),
    "robot": (30, 30, 40), "robot_head": (26, 26, 23), "bolt": (60, 6, 6),
    "orb": (20, 20, 20), "beam_gadget": (30, 30, 20),
    "disc_gadget": (30, 30, 20), "orb_gadget": (30, 30, 20), "health_pack": (30, 30, 20),
    "armour_pack": (30, 30, 20), "puff": (40, 40, 40),
}  # fmt: skip
PATTERNED = {f"{form}_{pattern}": size for form, size in FORMS.items() for pattern in range(3)}
SIZES = SHAPES | PATTERNED | PROPS
THINNEST = 4
"""Centimetres. The models of fork, hair brush, knife and pincer are 1 to 3 thick, which would often
miss every pixel."""


def test_the_atlas_has_every_object_in_order():
    assert list(ATLAS.names) == list(SIZES)
    assert load_meshes(FILE) is ATLAS
    assert load_meshes().names[0] == "duck"


def test_a_mesh_stands_on_its_origin_at_its_size():
    """An object faces +x, so its two horizontal sizes may stand in the other order."""
    for name in SIZES:
        with naming(name):
            vertices, triangles, _ = mesh_of(ATLAS, name)
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            assert low[2] == 0
            np.testing.assert_allclose((low + high)[:2], 0, atol=2e-5)
            x, y, z = (high - low) * 100
            length, width, height = (max(side, THINNEST) for side in SIZES[name])
            np.testing.assert_allclose(sorted((x, y)), sorted((length, width)), rtol=0.1)
            assert z == pytest.approx(height, rel=0.1)
            assert sorted(set(triangles.ravel())) == list(range(len(vertices)))
            assert len(triangles) <= 250


def test_a_mesh_is_made_of_closed_surfaces_that_face_outwards():
    for name in SIZES:
        with naming(name):
            assert_closed_and_outward(*mesh_of(ATLAS, name)[:2])


@pytest.mark.slow
def test_no_two_colours_lie_in_one_plane():
    for name in SIZES:
        with naming(name):
            assert_no_shared_plane(*mesh_of(ATLAS, name))


@pytest.fixture(scope="module")
def shares() -> dict[str, np.ndarray]:
    """Of each mesh, from eight sides: the shares of main and accent among its pixels, [8, 2].

    The eye is 0.5 m high, as in the levels."""
    scenes = Scenes(8 * len(ATLAS.names), instances=1)
    scenes.colours[:] = (255, 0, 0), (0, 255, 0)
    scenes.sky[:] = 0, 0, 255
    for world in range(scenes.num_envs):
        mesh, side = divmod(world, 8)
        scenes.mesh[world, 0] = mesh
        yaw = (side + 0.3) * math.pi / 4
        away = 0.5 + 1.2 * float(ATLAS.extent[mesh].max())
        pitch = math.atan2(float(ATLAS.extent[mesh, 2]) / 2 - 0.5, away)
        place = (-away * math.cos(yaw), -away * math.sin(yaw), 0.5, yaw, pitch)
        scenes.camera[world] = place
    images = np.zeros((scenes.num_envs, 72, 96, 3), np.uint8)
    Renderer(ATLAS, pack_textures(textures.stack())).render(scenes, images)
    red, green, blue = np.moveaxis(images.astype(int), -1, 0)
    thing = blue < np.maximum(red, green).clip(200)
    main, accent = (red > green + blue) & thing, (green > red + blue) & thing
    pixels = (blue < 200).sum(axis=(1, 2))
    counts = np.stack([main.sum(axis=(1, 2)), accent.sum(axis=(1, 2))], axis=1)
    return dict(zip(ATLAS.names, (counts / pixels[:, None]).reshape(-1, 8, 2), strict=True))


@pytest.mark.slow
def test_both_colours_are_visible_from_every_side(shares):
    """Tasks name the forty objects by two colours, so those show much of both."""
    for name in SIZES:
        with naming(name):
            least_main, least_accent = (0.35, 0.25) if name in SHAPES else (0.1, 0.1)
            main, accent = shares[name].T
            assert main.mean() > least_main
            assert accent.mean() > least_accent
            assert min(main.min(), accent.min()) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("names", [list(SHAPES), [f"{form}_0" for form in FORMS]])
def test_no_two_outlines_are_alike(names):
    assert_outlines_differ(ATLAS, names, step=45, above=15, pixels=24)


def test_the_patterns_of_a_form_have_one_shape_and_differ_in_their_colours():
    for form in FORMS:
        with naming(form):
            (v0, t0, p0), (v1, t1, p1), (v2, t2, p2) = (
                mesh_of(ATLAS, f"{form}_{pattern}") for pattern in range(3)
            )
            for vertices, triangles in ((v1, t1), (v2, t2)):
                np.testing.assert_array_equal(vertices, v0)
                np.testing.assert_array_equal(triangles, t0)
            for a, b in ((p0, p1), (p0, p2), (p1, p2)):
                # Neither alike nor alike with the colours swapped.
                assert 0.15 < (a != b).mean() < 0.85


@pytest.mark.slow
def test_the_file_is_what_the_command_builds():
    assert_is(ATLAS, build_meshes.pack(build_meshes.ATLASES[FILE]()))
