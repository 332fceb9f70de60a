"""The renderer against slow ray casting, and the meaning of its arguments."""

import math

import benchmark_render
import contact_sheet
import numpy as np
import pytest
from rays import (
    ATLAS,
    COLOURED,
    FENCE,
    HEIGHT,
    STACK,
    WIDTH,
    cast,
    inner,
    plain,
    random_rotation,
    random_scenes,
    view,
)

from zipf.envs.render3d import (
    FACES_DOWN,
    SCREEN,
    SEE_THROUGH,
    TILE_TEXTURE,
    TWO_SIDED,
    Renderer,
    Scenes,
    pack_textures,
    textures,
)
from zipf.envs.render3d.textures import SIZE


@pytest.mark.parametrize("seed", range(4))
def test_matches_rays(seed):
    """Away from edges, images agree except for pixels on the border of two texels."""
    scenes = random_scenes(seed)
    images = view(scenes).astype(float)
    for env in range(scenes.num_envs):
        image, shown = cast(scenes, env, STACK)
        off = abs(images[env] - image).max(-1)
        assert (off[inner(shown)] > 1.5).mean() < 0.01
        assert (off > 1.5).mean() < 0.03


def assert_patterns_match(scenes):
    """Where meshes are, away from edges. All else than textures' borders agrees."""
    images = view(scenes, atlas=COLOURED).astype(float)
    inside = []
    for env in range(scenes.num_envs):
        image, shown = cast(scenes, env, STACK, atlas=COLOURED)
        off = abs(images[env] - image).max(-1)
        inside.extend(off[inner(shown) & (shown > 0)])
        assert (off > 2.5).mean() < 0.04
    assert len(inside) > 2000
    assert (np.array(inside) > 2.5).mean() < 0.002


@pytest.mark.parametrize("seed", range(3))
def test_patterns_match_rays(seed):
    """Meshes in patterns of all textures, of which the red channel counts."""
    scenes = random_scenes(seed, envs=12, patterns=True)
    scenes.wall_count[:] = scenes.flat_count[:] = 0
    scenes.shadows[:] = 0
    scenes.scale[:] *= 2.5
    assert_patterns_match(scenes)


def test_patterns_around_the_eye():
    """Triangles with a pattern are cut at the near plane, too."""
    rng = np.random.default_rng(0)
    scenes = Scenes(40, instances=1)
    scenes.mesh[:] = rng.integers(0, 2, (40, 1))
    scenes.pattern[:] = rng.integers(0, len(STACK), (40, 1))
    scenes.scale[:] = 4
    for env in range(40):
        scenes.rotation[env, 0] = random_rotation(rng)
        scenes.position[env, 0] = rng.uniform(-1, 1, 3)
        scenes.camera[env, 3:] = rng.uniform((-3, -1), (3, 1))
    assert_patterns_match(scenes)


@pytest.mark.parametrize("size", [(1, 1), (25, 7), (33, 20)])
def test_patterns_in_images_of_any_size(size):
    """No number of a triangle is left in an image, wherever blocks of pixels end."""
    scenes = random_scenes(2, patterns=True)
    scenes.pattern[:] = 3
    images = view(scenes, plain(*[(255, 255, 255)] * len(STACK)), width=size[0], height=size[1])
    scenes.pattern[:] = -1
    scenes.colours[:, :, 0] = scenes.colours[:, :, 1]
    same = view(scenes, plain(*[(255, 255, 255)] * len(STACK)), width=size[0], height=size[1])
    assert abs(images.astype(int) - same).max() <= 1


def test_a_pattern_that_does_not_exist_is_refused():
    scenes = Scenes(2, instances=1)
    scenes.mesh[1] = 0
    scenes.pattern[1] = len(STACK)
    with pytest.raises(ValueError, match="env 1 shows a texture"):
        view(scenes)


@pytest.mark.parametrize("seed", range(4))
def test_shows_the_right_surfaces(seed):
    """With one colour for each surface, all pixels away from edges agree."""
    scenes = random_scenes(seed)
    rng = np.random.default_rng(seed)
    scenes.wall_looks[..., 0] = np.arange(10)
    scenes.wall_looks[..., 1] &= ~SEE_THROUGH
    scenes.flat_looks[..., 0] = np.arange(10, 14)
    there = scenes.tiles >= 0
    scenes.tiles[there] = scenes.tiles[there] & ~TILE_TEXTURE | 10
    scenes.wall_tint[:] = scenes.flat_tint[:] = 255
    stack = plain(*rng.integers(30, 256, (14, 3)))
    images = view(scenes, stack).astype(float)
    for env in range(scenes.num_envs):
        image, shown = cast(scenes, env, stack)
        off = abs(images[env] - image).max(-1)
        assert off[inner(shown)].max() <= 1.5


def test_meshes_around_the_eye():
    """Triangles that reach behind the near plane are cut there."""
    rng = np.random.default_rng(0)
    scenes = Scenes(40, instances=1)
    scenes.mesh[:] = rng.integers(0, 2, (40, 1))
    scenes.scale[:] = 4
    for env in range(40):
        scenes.rotation[env, 0] = random_rotation(rng)
        scenes.position[env, 0] = rng.uniform(-1, 1, 3)
        scenes.camera[env, 3:] = rng.uniform((-3, -1), (3, 1))
    images = view(scenes).astype(float)
    cut = 0
    for env in range(40):
        image, shown = cast(scenes, env, STACK)
        off = abs(images[env] - image).max(-1)
        assert off[inner(shown)].max(initial=0) <= 1.5
        cut += shown.any()
    assert cut > 20


def room(colours=((250, 0, 0), (0, 250, 0), (0, 0, 250), (250, 250, 0))):
    """East red, north green, west blue, south yellow; floor white, ceiling grey."""
    scenes = Scenes(1, walls=4, flats=2)
    corners = ((2, -2), (2, 2), (-2, 2), (-2, -2))
    for k in range(4):
        scenes.add_walls(0, corners[k] + corners[(k + 1) % 4], (0, 2), k)
    scenes.add_flat(0, (-2, -2, 2, 2), 0, 4)
    scenes.add_flat(0, (-2, -2, 2, 2), 2, 5, flags=FACES_DOWN)
    scenes.camera[0, 2] = 1
    return scenes, plain(*colours, (250, 250, 250), (120, 120, 120))


def test_yaw_turns_to_the_left():
    scenes, stack = room()
    for yaw, channels in ((0, (0,)), (math.pi / 2, (1,)), (math.pi, (2,)), (-math.pi / 2, (0, 1))):
        scenes.camera[0, 3] = yaw
        middle = view(scenes, stack)[0, HEIGHT // 2, WIDTH // 2]
        assert tuple(np.flatnonzero(middle > 30)) == channels
    scenes.camera[0, 3] = math.pi / 4 - 0.3  # the corner of east and north is now to the left
    image = view(scenes, stack)[0, HEIGHT // 2]
    corner = np.flatnonzero(image[:, 0] > 30)[0]
    assert (image[:corner, 1] > 30).all()
    assert corner == pytest.approx(WIDTH / 2 - math.tan(0.3) * WIDTH / 2, abs=1)


def test_positive_pitch_looks_up():
    scenes, stack = room()
    scenes.camera[0, 4] = 1.2
    up = view(scenes, stack)[0, HEIGHT // 2, WIDTH // 2].astype(int)
    scenes.camera[0, 4] = -1.2
    down = view(scenes, stack)[0, HEIGHT // 2, WIDTH // 2].astype(int)
    assert np.ptp(up) <= 1
    assert np.ptp(down) <= 1
    assert up[0] < 120 < down[0]
    scenes.camera[0, 4] = 0.2
    level = view(scenes, stack)[0, :, WIDTH // 2, 0]
    assert (level[:5] < level[-5:]).all()


def test_views_straight_up_and_down():
    scenes, stack = room()
    for pitch in (math.pi / 2, -math.pi / 2, 1.5):
        scenes.camera[0, 4] = pitch
        image, shown = cast(scenes, 0, stack)
        assert abs(view(scenes, stack)[0] - image)[inner(shown)].max() <= 1.5


def test_walls_are_visible_from_their_left_and_not_mirrored():
    stack = plain((10, 10, 10))
    half = SIZE // 2
    stack[0, :half, :half, :3] = 250, 0, 0  # top left
    stack[0, :half, half:, :3] = 0, 250, 0  # top right
    scenes = Scenes(1, walls=1)
    scenes.sky[:] = 0
    scenes.add_walls(0, (1, -1, 1, 1), (-1, 1), 0)
    image = view(scenes, stack, 64, 64)[0]
    assert image[16, 16, 0] > 100
    assert image[16, 48, 1] > 100
    assert image[48, 16].max() < 20
    scenes.walls[0, 0, :4] = 1, 1, 1, -1
    assert not view(scenes, stack).any()
    scenes.wall_looks[0, 0, 1] = TWO_SIDED
    assert view(scenes, stack).any()
    scenes.wall_looks[0, 0, 0] = -1
    assert not view(scenes, stack).any()


def test_rows_of_a_patchwork_run_north():
    scenes = Scenes(1, flats=1, tile_cells=8)
    scenes.sky[:] = 0
    tiles = np.array([[0, 1], [2, -1]])
    scenes.add_flat(0, (-2, -2, 2, 2), 0, 0, tiles=tiles)
    scenes.camera[0] = 0, 0, 2, math.pi / 2, -math.pi / 2  # from above, north on top
    image = view(scenes, plain((250, 0, 0), (0, 250, 0), (0, 0, 250)), 40, 40)[0]
    assert [int(image[r, c].argmax()) for r, c in ((30, 10), (30, 30), (10, 10))] == [0, 1, 2]
    assert not image[10, 30].any()


def test_holes_are_transparent():
    scenes, stack = room()
    fence = STACK[FENCE][None].copy()
    fence[..., :3] = 0, 250, 250
    scenes.walls = np.concatenate([scenes.walls, np.float32([[[1, -1, 1, 1, 0, 2]]])], 1)
    scenes.wall_looks = np.concatenate([scenes.wall_looks, np.int32([[[6, SEE_THROUGH]]])], 1)
    scenes.wall_repeat = np.zeros((1, 5), np.float32)
    scenes.wall_tint = np.full((1, 5, 3), 255, np.uint8)
    scenes.wall_face = np.full((1, 5), -1, np.int32)
    for order in ((0, 1, 2, 3, 4), (4, 0, 1, 2, 3)):
        for name in ("walls", "wall_looks"):
            getattr(scenes, name)[:] = getattr(scenes, name)[:, list(order)]
        scenes.wall_count[0] = 5
        image = view(scenes, np.concatenate([stack, fence]))[0, 16:30, 20:44].reshape(-1, 3)
        bars, wall = (image[:, 1] > 100).mean(), (image[:, 0] > 100).mean()
        assert bars + wall == 1
        assert 0.2 < bars < 0.7


def test_a_screen_shows_its_worlds_image():
    scenes = Scenes(2, walls=1, screen=(4, 6))
    rng = np.random.default_rng(0)
    scenes.screen[:] = rng.integers(0, 256, scenes.screen.shape)
    for env in range(2):
        scenes.add_walls(env, (1, -1, 1, 1), (-1, 1), SCREEN)
    images = view(scenes, width=48, height=48)
    assert (images == scenes.screen[..., :3].repeat(12, 1).repeat(8, 2)).all()


def test_screens_of_twice_the_size_are_averaged():
    """A pixel is the mean of two of the four texels that it covers."""
    scenes = Scenes(1, walls=1, screen=(96, 96))
    rng = np.random.default_rng(0)
    scenes.screen[:] = rng.integers(0, 256, scenes.screen.shape)
    scenes.add_walls(0, (1, -1, 1, 1), (-1, 1), SCREEN)
    image = view(scenes, width=48, height=48)[0]
    texels = scenes.screen[0, ..., :3].astype(float)
    assert abs(image - (texels[::2, ::2] + texels[1::2, 1::2]) / 2).max() <= 0.5


def test_a_screen_seen_from_aside_is_where_a_wall_would_be():
    """Its picture too: a texture as large, without the light on it, differs in few pixels."""
    picture = np.zeros((1, 64, 64, 4), np.uint8)
    picture[..., 3] = 255
    picture[0, 20:50, 8:40] = 200
    scenes = Scenes(1, walls=1, screen=(64, 64))
    scenes.screen[0] = picture[0]
    scenes.sky[:] = 0
    scenes.camera[0] = 0.1, 0.2, 0.05, 0.4, -0.2
    scenes.add_walls(0, (1, -1, 1, 1), (-1, 1), 0)
    texture = picture.repeat(SIZE // 64, 1).repeat(SIZE // 64, 2)
    wall = view(scenes, texture, width=96, height=72)[0, ..., 0] > 40
    scenes.wall_looks[0, 0, 0] = SCREEN
    screen = view(scenes, texture, width=96, height=72)[0, ..., 0] > 100
    assert wall.sum() > 500
    assert (wall != screen).sum() < 0.05 * wall.sum()


def test_overlays_lie_over_the_view():
    scenes = Scenes(1, overlays=3)
    scenes.sky[:] = 100
    scenes.overlays[0] = (0, 0, 0.5, 0.25), (0.25, 0, 1, 1), (0, 0, 1, 1)
    scenes.overlay_colours[0] = (200, 10, 10, 255), (0, 200, 0, 128), (0, 0, 0, 255)
    scenes.overlay_count[0] = 2
    image = view(scenes, width=8, height=8)[0].astype(int)
    assert (image[:2, :2] == (200, 10, 10)).all()
    assert abs(image[:2, 2:4] - (100, 105, 5)).max() <= 1
    assert abs(image[2:, 2:] - (50, 150, 50)).max() <= 1
    assert (image[2:, :2] == 100).all()
    scenes.overlays[0, 0] = -1, -1, 3, 3
    assert (view(scenes, width=8, height=8)[0, :, 0] == (200, 10, 10)).all()


def maze(seed, envs=30):
    """Random solid cells with a wall on every face, and a camera in a random free cell."""
    rng = np.random.default_rng(seed)
    size = (9, 12)
    scenes = Scenes(envs, walls=400, flats=1, grid=size)
    ways = (
        (0, 1, (1, 1, 1, 0)),
        (1, 0, (0, 1, 1, 1)),
        (0, -1, (0, 0, 0, 1)),
        (-1, 0, (1, 0, 0, 0)),
    )
    for env in range(envs):
        solid = rng.random(size) < rng.uniform(0.05, 0.5)
        solid[0] = solid[-1] = solid[:, 0] = solid[:, -1] = True
        solid[4, 5] = False
        scenes.solid[env] = solid
        scenes.grid[env] = -3, 2, 0.5
        for row, column in np.argwhere(solid):
            for side, (down, right, ends) in enumerate(ways):
                r, c = row + down, column + right
                if 0 <= r < size[0] and 0 <= c < size[1] and not solid[r, c]:
                    ends = np.array(ends) + (column, row, column, row)
                    scenes.add_walls(
                        env, ends * 0.5 + (-3, 2, -3, 2), (0, 0.5), int(rng.integers(20)),
                        faces=(row * size[1] + column) * 4 + side,
                    )  # fmt: skip
        free = np.argwhere(~solid)
        y, x = free[rng.integers(len(free))] + rng.uniform(0.1, 0.9, 2)
        pitch = rng.choice([0, rng.uniform(-0.6, 0.6), rng.uniform(-1.5, 1.5)])
        scenes.camera[env] = -3 + x / 2, 2 + y / 2, 0.25, rng.uniform(-4, 4), pitch
    return scenes


@pytest.mark.parametrize("seed", range(3))
def test_the_grid_skips_only_hidden_walls(seed):
    scenes = maze(seed)
    by_grid = view(scenes)
    faces = scenes.wall_face.copy()
    scenes.wall_face[:] = -1
    assert (by_grid == view(scenes)).all()
    scenes.wall_face[:] = faces
    scenes.wall_face[:, 50] = 0  # a face that is not visible
    scenes.camera[:, :2] = -3 + 0.2, 2 + 0.2  # in a solid cell
    assert (view(scenes)[..., 0] != scenes.sky[0, 0, 0]).any()


def test_grid_skips_hidden_faces():
    scenes = Scenes(1, walls=1, grid=(3, 3))
    scenes.sky[:] = 0
    scenes.solid[0] = True
    scenes.solid[0, 1, 1] = False
    scenes.grid[0] = 0, 0, 1
    scenes.camera[0] = 1.5, 1.5, 0.5, 0, 0
    east = (1 * 3 + 2) * 4 + 2
    scenes.add_walls(0, (2, 1, 2, 2), (0, 1), 0, faces=east)
    assert view(scenes).any()
    scenes.wall_face[0, 0] = east - 2  # its back
    assert not view(scenes).any()


def test_images_are_the_same_at_every_address():
    """Where lines begin at multiples of 16 bytes they are written past the caches."""
    scenes = random_scenes(1, envs=7, overlays=1)
    scenes.overlays[2], scenes.overlay_colours[2] = (0.1, 0.2, 0.6, 0.9), (10, 20, 30, 200)
    scenes.overlay_count[2] = 1
    renderer = Renderer(ATLAS, pack_textures(STACK), width=48, height=20)
    images = []
    for shift in (0, 1, 16):
        room = np.full(7 * 20 * 48 * 3 + 32, 7, np.uint8)
        start = -room.ctypes.data % 16 + shift
        out = room[start : start + 7 * 20 * 48 * 3].reshape(7, 20, 48, 3)
        renderer.render(scenes, out)
        assert (room[:start] == 7).all()
        assert (room[start + out.size :] == 7).all()
        images.append(out)
    assert images[0].std() > 10
    assert (images[0] == images[1]).all()
    assert (images[0] == images[2]).all()


def test_no_background_between_surfaces():
    """The sky is not visible from inside a closed room."""
    rng = np.random.default_rng(3)
    scenes = Scenes(1000, walls=12, flats=4, tile_cells=8)
    scenes.sky[:] = 255, 0, 255
    angles = np.linspace(0, 2 * math.pi, 7)
    for env in range(1000):
        x, y = 3 * np.cos(angles), 3 * np.sin(angles)
        for k in range(6):
            for heights in ((0, 0.8), (0.8, 2)):
                scenes.add_walls(env, (x[k], y[k], x[k + 1], y[k + 1]), heights, 0)
        for west in (-3, 0):
            scenes.add_flat(env, (west, -3, west + 3, 3), 0, 0)
            scenes.add_flat(env, (west, -3, west + 3, 3), 2, 0, flags=FACES_DOWN)
        scenes.camera[env] = (
            *rng.uniform((-1.7, -1.7, 0.2), (1.7, 1.7, 1.8)),
            *rng.uniform(-1.5, 1.5, 2),
        )
    images = view(scenes, plain((200, 200, 200)))
    assert (images[..., 0] == images[..., 1]).all()


def test_sky():
    scenes = Scenes(1)
    scenes.sky[0] = (10, 20, 30), (200, 200, 200)
    image = view(scenes)[0]
    assert (image[HEIGHT // 2 :] == (10, 20, 30)).all()
    assert (np.diff(image[: HEIGHT // 2, 0, 0].astype(int)) <= 0).all()
    assert image[0, 0, 0] > 60
    scenes.camera[0, 4] = math.pi / 2
    assert (view(scenes)[0, 0] == 200).all()


def test_textures():
    stack = textures.stack()
    assert stack.shape == (len(textures.NAMES), SIZE, SIZE, 4)
    assert stack.dtype == np.uint8
    assert (stack == textures.stack()).all()
    assert (stack[..., 3] == 255).all()
    assert textures.index("planks") == textures.NAMES.index("planks")
    with pytest.raises(ValueError, match="no texture 'velvet'"):
        textures.index("velvet")


def test_the_smallest_version_of_a_texture_is_its_mean():
    packed = pack_textures(STACK)
    for k, image in enumerate(STACK):
        if (image[..., 3] == 255).all():
            mean = image[..., :3].reshape(-1, 3).mean(0)
            last = packed[k, 1]
            assert [last & 255, last >> 8 & 255, last >> 16 & 255] == pytest.approx(mean, abs=0.51)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0}, "width must be 1 or more, not 0"),
        ({"height": -3}, "height must be 1 or more, not -3"),
        ({"fov": 180}, "fov must be from 1 to 170 degrees, not 180"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(ValueError, match=message):
        Renderer(ATLAS, pack_textures(STACK), **options)


def test_bad_arrays():
    packed = pack_textures(STACK)
    for wrong in (STACK, packed.astype(np.int64), packed[:, 1:]):
        with pytest.raises(ValueError, match="textures must be packed by pack_textures, not"):
            Renderer(ATLAS, wrong)
    renderer = Renderer(ATLAS, packed, width=8, height=4)
    scenes = Scenes(3)
    out = np.zeros((3, 4, 8, 3), np.uint8)
    for wrong in (out[:2], out.astype(np.int32), np.zeros((3, 8, 4, 3), np.uint8), out[:, ::-1]):
        with pytest.raises(ValueError, match="out must be C-contiguous uint8"):
            renderer.render(scenes, wrong)
    for wrong in (np.ones(2, bool), np.ones(3, np.int64)):
        with pytest.raises(ValueError, match="mask must be bool"):
            renderer.render(scenes, out, wrong)


def test_textures_meshes_and_screens_that_do_not_exist():
    scenes = Scenes(2, walls=1, flats=1, instances=1)
    scenes.wall_count[:] = scenes.flat_count[:] = 1
    for array in (scenes.wall_looks[1, 0], scenes.flat_looks[1, 0], scenes.mesh[1]):
        array[0] = 99
        with pytest.raises(ValueError, match="env 1 shows a texture from 20 on, a mesh from 2"):
            view(scenes)
        array[0] = -1
    scenes.wall_looks[1, 0, 0] = SCREEN
    with pytest.raises(ValueError, match="env 1 shows"):
        view(scenes)


def test_scripts_draw_their_scenes(monkeypatch):
    monkeypatch.setattr(benchmark_render, "ENVS", 2)
    for scenes in (
        benchmark_render.maze(pitched=True, ceiling=True),
        benchmark_render.room(objects=5, pitched=True),
        benchmark_render.hills(pitched=True),
    ):
        benchmark_render.row("", scenes).run(1)
    assert np.asarray(contact_sheet.sheet()).std() > 10


def test_capacities():
    scenes = Scenes(1, walls=1, flats=1, tile_cells=3)
    scenes.add_walls(0, (0, 0, 1, 0), (0, 1), 0)
    with pytest.raises(ValueError, match="env 0 has room for 1 walls"):
        scenes.add_walls(0, (0, 0, 1, 0), (0, 1), 0)
    with pytest.raises(ValueError, match="4 tiles in an env with room for 3"):
        scenes.add_flat(0, (0, 0, 1, 1), 0, 0, tiles=np.zeros((2, 2), int))
    scenes.flat_count[0] = 1
    with pytest.raises(ValueError, match="env 0 has room for 1 flats"):
        scenes.add_flat(0, (0, 0, 1, 1), 0, 0)
