"""Terrains against slow ray casting, and the meaning of their arrays."""

import math

import numpy as np
import pytest
from rays import ATLAS, HEIGHT, STACK, WIDTH, cast, inner, plain, random_scenes, view

from zipf.envs.render3d import Renderer, Scenes, optics, pack_textures

ROWS, COLUMNS = 7, 19


def hills(rng, rows=ROWS, columns=COLUMNS, rough=0.25):
    """Waves with some noise, float32 [rows + 1, columns + 1]."""
    y, x = np.mgrid[: rows + 1, : columns + 1]
    waves = np.sin(x * rng.uniform(0.3, 0.8) + rng.uniform(0, 6))
    waves = waves + np.cos(y * rng.uniform(0.3, 0.8) + rng.uniform(0, 6))
    return (0.4 * waves + rough * rng.uniform(-1, 1, x.shape)).astype(np.float32)


def over(scenes, env, x, y):
    """The height of the ground at x, y."""
    west, south, size, _ = scenes.terrain[env]
    c, r = (x - west) / size, (y - south) / size
    column, row = int(c), int(r)
    c, r = c - column, r - row
    (sw, se), (nw, ne) = scenes.heights[env, row : row + 2, column : column + 2].astype(float)
    if c > r:
        return sw + c * (se - sw) + r * (ne - se)
    return sw + r * (nw - sw) + c * (ne - nw)


def add_terrain(scenes, rng, textures, eye=(0.1, 1.5), pitch=0.8):
    """Adds hills in one of so many textures, with every env's camera above them."""
    shape = np.subtract(scenes.heights.shape[1:], 1)
    for env in range(scenes.num_envs):
        corner, size = rng.uniform(-3, 0, 2), rng.uniform(0.3, 0.6)
        scenes.set_terrain(
            env, corner, size, hills(rng, *shape), rng.integers(textures),
            repeat=rng.uniform(0.3, 1), tint=rng.integers(150, 256, 3),
        )  # fmt: skip
        x, y = corner + size * rng.uniform((0, 0), shape[::-1])
        north, east = corner[::-1] + size * shape / 2 - (y, x)
        scenes.camera[env] = (
            x,
            y,
            over(scenes, env, x, y) + rng.uniform(*eye),
            math.atan2(north, east) + rng.uniform(-1, 1),
            rng.uniform(-pitch, pitch),
        )


def furnished(seed, envs=3):
    """Random scenes of rooms, with hills."""
    scenes = random_scenes(seed, envs, terrain=(ROWS, COLUMNS))
    add_terrain(scenes, np.random.default_rng(seed), len(STACK))
    return scenes


@pytest.mark.parametrize("seed", range(4))
def test_matches_rays(seed):
    """With walls, floors and meshes; pixels on the border of two texels may differ."""
    scenes = furnished(seed)
    images = view(scenes).astype(float)
    for env in range(scenes.num_envs):
        image, shown = cast(scenes, env, STACK)
        off = abs(images[env] - image).max(-1)
        assert (off[inner(shown)] > 1.5).mean() < 0.02
        assert (off > 1.5).mean() < 0.04


@pytest.mark.parametrize("seed", range(4))
def test_shows_the_right_triangles(seed):
    """In one colour, which slopes show lighter or darker, all pixels away from edges agree."""
    rng = np.random.default_rng(seed)
    scenes = Scenes(4, terrain=(ROWS, COLUMNS))
    stack = plain((250, 240, 230))
    add_terrain(scenes, rng, textures=1)
    images = view(scenes, stack).astype(float)
    ground = 0
    for env in range(4):
        image, shown = cast(scenes, env, stack)
        off = abs(images[env] - image).max(-1)
        assert off[inner(shown)].max() <= 1.5
        assert (off > 1.5).mean() < 0.02
        ground += (shown > 0).mean() / 4
    assert ground > 0.2


@pytest.mark.parametrize("size", [(1, 1), (7, 5), (33, 20), (130, 90)])
def test_any_size(size):
    scenes = furnished(9, envs=2)
    images = view(scenes, width=size[0], height=size[1]).astype(float)
    for env in range(2):
        image, _ = cast(scenes, env, STACK, *size)
        off = abs(images[env] - image).max(-1)
        assert (off > 1.5).mean() <= 0.06


def test_ground_around_the_eye():
    """Slopes just below the eye reach behind the near plane and are cut there."""
    rng = np.random.default_rng(5)
    scenes = Scenes(12, terrain=(ROWS, COLUMNS))
    stack = plain((250, 240, 230))
    add_terrain(scenes, rng, textures=1, eye=(0.005, 0.05), pitch=1.5)
    images = view(scenes, stack).astype(float)
    near = 0
    for env in range(12):
        image, shown = cast(scenes, env, stack)
        off = abs(images[env] - image).max(-1)
        assert off[inner(shown)].max(initial=0) <= 1.5
        assert (off > 1.5).mean() < 0.03
        near += (shown[-1] > 0).any()
    assert near > 5


def test_looking_up_from_a_valley():
    stack = plain((240, 240, 240))
    scenes = Scenes(3, terrain=(8, 8))
    scenes.sky[:] = 255, 0, 255
    y, x = np.mgrid[:9, :9]
    for env, pitch in enumerate((math.pi / 2, 0.7, 0.0)):
        bowl = np.float32(0.3 * ((x - 4) ** 2 + (y - 4) ** 2))
        scenes.set_terrain(env, (-4, -4), 1, bowl, 0, repeat=1)
        scenes.camera[env] = 0, 0, 0.5, 0.4, pitch
    up, slope, level = view(scenes, stack)
    sky = [(image == (255, 0, 255)).all(-1) for image in (up, slope, level)]
    assert sky[0][12:-12, 20:-20].all()
    assert sky[1][0, 20:-20].all()
    assert not sky[1][-1].any()
    assert not sky[2][HEIGHT // 2 :].any()
    for env, image in enumerate((up, slope, level)):
        expected, shown = cast(scenes, env, stack)
        assert abs(image - expected)[inner(shown)].max() <= 1.5


def test_level_ground_looks_like_a_flat():
    rng = np.random.default_rng(1)
    for repeat in (0.8, 1.5):
        ground = Scenes(8, terrain=(6, 9))
        floor = Scenes(8, flats=1)
        for env in range(8):
            ground.set_terrain(env, (-3, -2), 0.8, np.full((7, 10), 0.3), 4, repeat=repeat)
            floor.add_flat(env, (-3, -2, 4.2, 2.8), 0.3, 4, repeat=repeat)
            place = rng.uniform((-3, -2, 0.4, -4, -1), (4, 2.5, 2, 4, 0.3))
            ground.camera[env] = floor.camera[env] = place
        sun = np.array(optics.SUN)[2] * 0.5 + 0.5
        darker = (optics.MESH_DARK + optics.MESH_SUN * sun) / (
            optics.SURFACE_DARK + optics.SURFACE_SUN * sun
        )
        hills, flat = view(ground).astype(float), view(floor).astype(float)
        is_sky = flat[..., 2] > 180
        flat[~is_sky] *= darker
        assert (~is_sky).mean() > 0.2
        assert (abs(hills - flat).max(-1) > 2).mean() < 0.01


def test_rows_run_north_and_columns_east():
    scenes = Scenes(1, terrain=(2, 2))
    heights = np.zeros((3, 3))
    heights[0, 2] = 0.9  # a peak in the south-east
    scenes.set_terrain(0, (-1, -1), 1, heights, 0, repeat=1)
    scenes.camera[0] = 0, 0, 1, math.pi / 2, -math.pi / 2  # from above, north on top
    image = view(scenes, plain((250, 250, 250)), 40, 40)[0].astype(int)
    level = image[10, 10]
    off = [abs(image[r, c] - level).max() > 5 for r, c in ((10, 30), (30, 10), (30, 30))]
    assert off == [False, False, True]


def test_slopes_that_face_the_sun_are_brighter():
    scenes = Scenes(3, terrain=(1, 1))
    scenes.sky[:] = 0
    for env, slope in enumerate((-0.5, 0, 0.5)):
        heights = slope * np.array([[-0.5, 0.5], [-0.5, 0.5]])
        scenes.set_terrain(env, (-0.5, -0.5), 1, heights, 0, repeat=1)
    scenes.camera[:, 2:] = 2, 0, -math.pi / 2
    middle = view(scenes, plain((250, 250, 250)))[:, HEIGHT // 2, WIDTH // 2, 0].astype(int)
    assert middle[0] > middle[1] + 5 > middle[2] + 20


def test_terrains_are_invisible_from_below():
    scenes = Scenes(1, terrain=(2, 2))
    scenes.set_terrain(0, (-1, -1), 1, np.zeros((3, 3)), 0, repeat=1)
    scenes.camera[0] = 0, 0, -1, 0, 1
    below = view(scenes)
    scenes.terrain[:] = 0
    assert (below == view(scenes)).all()


def test_no_background_between_cells():
    """From inside a bowl no sky is visible through the ground."""
    rng = np.random.default_rng(3)
    envs = 300
    scenes = Scenes(envs, terrain=(24, 24))
    scenes.sky[:] = 255, 0, 255
    y, x = np.mgrid[:25, :25]
    rim = np.maximum(abs(x - 12), abs(y - 12)) == 12
    for env in range(envs):
        heights = np.where(rim, 30, rng.uniform(0, 0.3, x.shape))
        scenes.set_terrain(env, (0, 0), 0.33, heights, 0, repeat=1)
        x0, y0 = rng.uniform(1, 7, 2)
        z = over(scenes, env, x0, y0) + rng.uniform(0.05, 1)
        scenes.camera[env] = x0, y0, z, *rng.uniform(-1.5, (1.5, 0))
    images = view(scenes, plain((200, 200, 200)))
    assert (images[..., 0] == images[..., 1]).all()


def test_pixels_do_not_depend_on_other_worlds_or_mask():
    scenes = furnished(1, envs=7)
    renderer = Renderer(ATLAS, pack_textures(STACK), width=50, height=20)
    out = np.zeros((7, 20, 50, 3), np.uint8)
    renderer.render(scenes, out)
    some = np.full_like(out, 7)
    mask = np.array([True, False, False, True, False, True, False])
    renderer.render(scenes, some, mask)
    assert (some[mask] == out[mask]).all()
    assert (some[~mask] == 7).all()
    bare = np.zeros((6, 20, 50, 3), np.uint8)
    alone = Scenes(
        1, walls=10, flats=4, instances=5, tile_cells=12, shadows=6, terrain=(ROWS, COLUMNS)
    )
    for env in range(7):
        renderer.render(random_scenes(env), bare)
        for name, array in vars(alone).items():
            if isinstance(array, np.ndarray):
                array[:] = getattr(scenes, name)[env]
        one = np.zeros((1, 20, 50, 3), np.uint8)
        renderer.render(alone, one)
        assert (one[0] == out[env]).all()


@pytest.mark.parametrize("terrain", [(0, 3), (3, 0), (-1, 4), (-1, -1)])
def test_bad_sizes(terrain):
    with pytest.raises(ValueError, match="terrain must be rows and columns of 1 or more"):
        Scenes(1, terrain=terrain)


def test_bad_terrains():
    scenes = Scenes(1, terrain=(2, 3))
    heights = np.zeros((3, 4))
    for wrong in (heights.T, heights[:2], heights[0]):
        with pytest.raises(ValueError, match=r"heights must be \(3, 4\), not"):
            scenes.set_terrain(0, (0, 0), 1, wrong, 0, repeat=1)
    for size, repeat in ((0, 1), (-1, 1), (1, 0)):
        with pytest.raises(ValueError, match="size and repeat must be positive"):
            scenes.set_terrain(0, (0, 0), size, heights, 0, repeat=repeat)
    with pytest.raises(ValueError, match=r"heights must be \(1, 1\), not"):
        Scenes(1).set_terrain(0, (0, 0), 1, heights, 0, repeat=1)
    for texture in (len(STACK), -1):
        scenes.set_terrain(0, (0, 0), 1, heights, texture, repeat=1)
        with pytest.raises(ValueError, match="env 0 shows a texture from 20 on"):
            view(scenes)
