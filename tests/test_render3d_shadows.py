"""Soft shadows: against slow ray casting, and what they lie on."""

import math

import numpy as np
import pytest
from rays import cast, inner, plain, view

from zipf.envs.render3d import FACES_DOWN, Scenes

STACK = plain((250, 250, 250), (120, 160, 200))


def blocks(seed: int, envs: int = 6) -> Scenes:
    """Upright boxes on a floor, with shadows on the floor and on the boxes."""
    rng = np.random.default_rng(seed)
    scenes = Scenes(envs, flats=1, instances=3, shadows=6)
    scenes.mesh[:] = 0
    for env in range(envs):
        scenes.add_flat(env, (-3, -3, 3, 3), 0, 0)
        scenes.camera[env] = 0, 0, rng.uniform(0.9, 2), *rng.uniform((-4, -1.4), (4, -0.2))
        for k in range(3):
            angle = scenes.camera[env, 3] + rng.uniform(-0.6, 0.6)
            x, y = rng.uniform(0.3, 2) * np.array([math.cos(angle), math.sin(angle)])
            turn, size = rng.uniform(-4, 4), rng.uniform(0.4, 1.4)
            cos, sin = math.cos(turn), math.sin(turn)
            scenes.position[env, k, :2] = x, y
            scenes.rotation[env, k, :2, :2] = (cos, -sin), (sin, cos)
            scenes.scale[env, k] = size
            for top, row in ((0.0, k), (0.4 * size, 3 + k)):
                scenes.shadows[env, row] = (
                    x, y, top, turn + rng.uniform(0, 1), *rng.uniform(0, 0.3, 2),
                    *rng.uniform((0.05, 0.2), (0.5, 1)),
                )  # fmt: skip
    return scenes


@pytest.mark.parametrize("seed", range(4))
def test_shadows_match_rays(seed: int) -> None:
    scenes = blocks(seed)
    images = view(scenes, STACK).astype(float)
    darker = np.zeros(2, np.int64)
    for env in range(scenes.num_envs):
        image, shown = cast(scenes, env, STACK)
        off = abs(images[env] - image).max(-1)
        assert off[inner(shown)].max() <= 1.5
        assert (off > 1.5).mean() < 0.03
    for rows in (slice(0, 3), slice(3, 6)):  # on the floor, and on the boxes
        kept = scenes.shadows[:, rows, 7].copy()
        scenes.shadows[:, rows, 7] = 0
        darker[rows.start // 3] = (view(scenes, STACK) > images).any(-1).sum()
        scenes.shadows[:, rows, 7] = kept
    assert (darker > 300).all()


def floor_and_ceiling() -> Scenes:
    scenes = Scenes(1, flats=2, shadows=1)
    scenes.add_flat(0, (-2, -2, 2, 2), 0, 0)
    scenes.add_flat(0, (-2, -2, 2, 2), 2, 0, flags=FACES_DOWN)
    scenes.camera[0] = 0, 0, 1, 0, -math.pi / 2
    return scenes


def test_a_shadow_takes_its_share_of_the_light_and_is_soft_at_its_edge() -> None:
    scenes = floor_and_ceiling()
    bright = view(scenes, STACK, 65, 65)[0, 32, :, 0].astype(float)
    scenes.shadows[0, 0] = 0, 0, 0, 0, 0.2, 0.2, 0.4, 0.6
    share = view(scenes, STACK, 65, 65)[0, 32, :, 0] / bright
    assert share[32] == pytest.approx(0.4, abs=0.01)
    middle = share[32:]  # 1 m is 32.5 pixels, at a focal length of 32.5 and a depth of 1
    assert (middle[:6] < 0.41).all()
    assert (np.diff(middle) > -0.01).all()
    assert np.abs(np.diff(middle)).max() < 0.1
    assert (middle[21:] > 0.99).all()


@pytest.mark.parametrize(
    ("height", "pitch"),
    [(0.01, -1.2), (1.99, 1.2), (1.5, 1.0), (2.0, 1.2)],
    ids=["above the floor", "below the ceiling", "above the eye", "on the ceiling"],
)
def test_a_shadow_is_seen_from_above_on_what_is_at_its_height(height: float, pitch: float) -> None:
    scenes = floor_and_ceiling()
    scenes.camera[0, 4] = pitch
    bright = view(scenes, STACK)
    scenes.shadows[0, 0] = 0, 0, height, 0, 3, 3, 0.4, 0.6
    assert (view(scenes, STACK) == bright).all()


def test_an_object_before_a_shadow_is_not_darkened() -> None:
    scenes = Scenes(1, flats=1, instances=1, shadows=1)
    scenes.add_flat(0, (-3, -3, 3, 3), 0, 0)
    scenes.sky[:] = 0
    scenes.camera[0] = 0, 0, 1, 0, -0.6
    scenes.mesh[0, 0] = 0
    scenes.position[0, 0] = 1.2, 0, 0.01
    scenes.colours[0, 0] = (200, 40, 40), (200, 40, 40)
    bright = view(scenes, STACK)[0].astype(int)
    scenes.shadows[0, 0] = 1.2, 0, 0, 0, 0.4, 0.4, 0.3, 0.7
    dark = view(scenes, STACK)[0].astype(int)
    floor = (bright == bright[..., :1]).all(-1)
    box = ~floor
    changed = (dark != bright).any(-1)
    assert box.sum() > 50
    assert (changed & floor).sum() > 100
    assert not changed[box].any()
