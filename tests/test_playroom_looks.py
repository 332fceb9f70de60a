"""The looks of the playroom: shadows below its objects, and what varies from episode to episode."""

from typing import Any

import numpy as np
import pytest
from playroom_envs import TRAY, act, arrange, look_at, playroom

from zipf.envs import baseline
from zipf.envs.playroom.constants import FURNITURE_SIZE
from zipf.envs.playroom.state import PITCH, Z
from zipf.envs.playroom.varied_looks import SMALLEST, VARIED_FLOORS, VARIED_WALLS
from zipf.envs.playroom.vector import PlayroomVectorEnv

LEVEL = "put/put_on_bed_tray_all"


def shadow(env: PlayroomVectorEnv, item: int) -> np.ndarray:
    """x, y, height, angle, half length, half width, softness, darkness."""
    env.observations()
    return env._view.scenes.shadows[0, item].astype(float)


@pytest.mark.parametrize(
    ("place", "height"),
    [((0.3, 1.7), 0.0), ((-1.0, 0.1), FURNITURE_SIZE[0, 2]), (TRAY[:2], FURNITURE_SIZE[1, 2])],
    ids=["floor", "bed", "tray"],
)
def test_a_shadow_lies_on_what_is_below_and_is_fainter_and_softer_the_higher(
    place: tuple[float, float], height: float
) -> None:
    env = playroom(LEVEL)
    shadows = []
    for above in (0.0, 0.3, 0.8):
        arrange(env, items={0: (*place, 0.7, height + above)}, names=["book"], task="on bed")
        shadows.append(shadow(env, 0))
    for there in shadows:
        np.testing.assert_allclose(there[:4], [*place, height, 0.7], atol=1e-6)
    rest, low, high = shadows
    size = env.envs.extents[env.envs.ranks[0, 0]]
    assert (rest[4:6] < size[:2] / 2).all()
    assert (rest[4:6] + rest[6] > size[:2] / 2).all()
    assert rest[7] > low[7] > high[7] > 0.1
    assert rest[6] < low[6] < high[6] < 0.5


def test_beside_the_bed_a_shadow_lies_on_the_floor() -> None:
    env = playroom(LEVEL)
    arrange(env, items={0: (-1.0, 0.1, 0.0, 0.1)}, names=["book"], task="on bed")  # inside it
    assert shadow(env, 0)[2] == 0
    arrange(env, items={0: (-0.4, 0.1, 0.0, 0.5)}, names=["book"], task="on bed")  # beside it
    assert shadow(env, 0)[2] == 0


def test_the_shadow_of_an_object_that_is_spun_is_that_of_its_pose() -> None:
    env = playroom("lift/lift_shape_uniform")
    arrange(env, items={0: (1.0, 0.0)}, names=["fork"])
    standing = shadow(env, 0)
    env.envs.orientation[0, 0] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # lies on its side
    lying = shadow(env, 0)
    height = env.envs.extents[env.envs.ranks[0, 0], 2]
    assert max(standing[4:6]) < 0.4 * height
    assert max(lying[4:6]) == pytest.approx(0.3 * height, rel=1e-3)
    assert min(lying[4:6]) < 0.1 * height


def test_a_shadow_is_seen_below_a_toy_that_is_lifted() -> None:
    env = playroom("lift/lift_shape_uniform", image_size=(72, 96))
    arrange(env, items={0: (1.0, 0.0)}, names=["ball"])
    look_at(env, 0)
    act(env, "GRAB", "GRAB_AND_LOOK_UP_FULL")
    assert env.envs.objects[0, 0, Z] > 0.05
    env.envs.agents[0, PITCH] = -0.6  # of the picture alone
    shaded = env.observations()["image"][0].astype(int)
    env._view.scenes.shadows = np.zeros((1, 0, 8), np.float32)
    draw = env._view.renderer.render
    bare = np.zeros((1, 72, 96, 3), np.uint8)
    draw(env._view.scenes, bare)
    darker = (shaded < bare[0]).all(-1)
    assert darker.sum() > 30
    assert not (shaded > bare[0]).any()


# Variation.


def test_chance_does_not_depend_on_looks() -> None:
    name = f"playroom/{LEVEL}"
    assert baseline("chance", name, looks="varied", max_steps=900) == baseline("chance", name)


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf3", LEVEL, "supervised/find_shape_uniform"])
def test_looks_change_the_images_and_nothing_else(level: str) -> None:
    options: dict[str, Any] = {"image_size": (18, 24), "max_steps": 25}
    plain, varied = (
        PlayroomVectorEnv(5, level, looks=looks, **options) for looks in ("plain", "varied")
    )
    results = [env.reset(seed=3) for env in (plain, varied)]
    rng = np.random.default_rng(0)
    different = 0
    for _ in range(60):
        (one, *rest), (other, *others) = results
        different += (one["image"] != other["image"]).any((1, 2, 3)).sum()
        np.testing.assert_array_equal(one["instruction"], other["instruction"])
        info, other_info = rest.pop(), others.pop()
        for told in (info, other_info):
            told.pop("final_obs", None)
        np.testing.assert_equal((rest, info), (others, other_info))
        for name, array in plain.envs._asdict().items():
            if name != "scenery":
                np.testing.assert_array_equal(getattr(varied.envs, name), array, err_msg=name)
        actions = rng.integers(46, size=5)
        results = [env.step(actions) for env in (plain, varied)]
    assert different == 60 * 5


def test_every_episode_has_its_own_looks() -> None:
    env = PlayroomVectorEnv(200, LEVEL, looks="varied", image_size=(1, 1))
    scenes = env._view.scenes
    env.reset(seed=0)
    walls, floors = scenes.wall_looks[:, :4, 0].copy(), scenes.flat_looks[:, 0, 0].copy()
    assert set(walls.ravel()) == set(VARIED_WALLS)
    assert set(floors) == set(VARIED_FLOORS)
    assert all(len(set(four)) == 4 for four in walls.tolist())
    sun, lamp, scale = scenes.sun.copy(), scenes.lamp.copy(), scenes.scale.copy()
    np.testing.assert_allclose(np.linalg.norm(sun, axis=1), 1, atol=1e-6)
    assert (abs(sun[:, :2].mean(0)) < 0.15).all()
    assert sun[:, 2].min() > 0.3
    assert lamp.min() > 0.4
    assert lamp.max() <= 1
    assert (lamp[:, 0] > lamp[:, 2]).mean() == pytest.approx(0.5, abs=0.15)
    toys = env.envs.ranks.shape[1]
    assert (scale[:, toys:] == 1).all()  # bed and tray, whose tops carry toys
    assert SMALLEST <= scale[:, :toys].min() < SMALLEST + 0.01
    assert 0.99 < scale[:, :toys].max() <= 1
    env.reset()
    assert (scenes.wall_looks[:, :4, 0] != walls).any(1).mean() > 0.9
    assert (scenes.sun != sun).any(1).all()


def test_a_toy_that_is_drawn_smaller_stands_on_the_floor() -> None:
    env = PlayroomVectorEnv(20, "lift/lift_shape_uniform", looks="varied", image_size=(1, 1))
    env.reset(seed=0)
    np.testing.assert_allclose(env._view.scenes.position[:, :, 2], 0, atol=1e-6)
