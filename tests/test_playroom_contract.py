"""The playroom as a Gymnasium environment: every level, bad input, states, pickles."""

import copy
import math
import pickle
import warnings
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import slow_but
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import env_render_passive_checker
from gymnasium.vector import AutoresetMode
from playroom_envs import KINDS

from zipf.envs import make, make_vec, split
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.playroom.playroom_env import PlayroomEnv
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.testing import check_vector_env

ID = "zipf/Playroom-v1"
SMALL: dict[str, Any] = {"image_size": (6, 8), "max_steps": 18}


@pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
def test_every_level_keeps_the_contract(level: str) -> None:
    name = f"playroom/{level}"
    check_vector_env(
        partial(make_vec, name, **SMALL), partial(make, name, **SMALL), num_envs=2, steps=45
    )


@pytest.mark.parametrize(
    "changed",
    [
        {"object_order": "alternate"},
        {"looks": "varied"},
        {"reach": 2.5, "near_failure": True, "frequent_exponent": 2.0},
    ],
)
def test_other_worlds_keep_the_contract(changed: dict[str, Any]) -> None:
    name, options = "playroom/put/put_on_bed_tray_all", {**SMALL, **changed}
    check_vector_env(
        partial(make_vec, name, **options), partial(make, name, **options), num_envs=2, steps=45
    )


def test_a_mixture_equals_its_levels() -> None:
    levels = split("playroom_put").levels("train")
    env = make_vec(levels, 5, **SMALL)
    singles = [make(levels[k].name, **SMALL) for k in (0, 0, 1, 1, 2)]
    observation, info = env.reset(seed=3)
    starts = [single.reset(seed=3 + i) for i, single in enumerate(singles)]
    rng = np.random.default_rng(0)
    for _ in range(80):
        for i, (image, told) in enumerate(starts):
            np.testing.assert_equal({key: rows[i] for key, rows in observation.items()}, image)
            assert {key: info[key][i] for key in told} == told
        actions = rng.integers(46, size=5)
        observation, *ends, info = env.step(actions)
        steps = [single.step(a) for single, a in zip(singles, actions, strict=True)]
        np.testing.assert_array_equal(np.transpose(ends), [step[1:4] for step in steps])
        starts = [
            single.reset() if step[2] or step[3] else (step[0], step[4])
            for single, step in zip(singles, steps, strict=True)
        ]


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf3", "playroom/put/put_on_bed_tray_all"])
def test_gymnasium_checks_the_environment(level: str) -> None:
    env = gym.make(ID, level=level)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
        env = gym.make(ID, level=level, render_mode="rgb_array")
        env.reset(seed=0)
        env_render_passive_checker(env.unwrapped)
    assert env.spec is not None
    assert env.observation_space["image"].shape == (72, 96, 3)
    assert env.action_space.n == 46


def test_gymnasium_makes_the_native_batch() -> None:
    env = gym.make_vec(ID, 7, level="supervised/find_shape_uniform", image_size=(6, 8))
    assert isinstance(env, PlayroomVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = env.reset(seed=0)
    assert observation["image"].shape == (7, 6, 8, 3)
    assert observation["instruction"].shape == (7, 6)
    assert set(info) == {"target", "other", "instruction", "side"}
    assert env.situation == {"target": 50, "other": 50}


@pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
def test_gymnasium_makes_every_level(level: str) -> None:
    env = gym.make(ID, level=level, **SMALL)
    _, info = env.reset(seed=0)
    assert info["instruction"].split()[0] == level.split("_")[0].split("/")[1]
    *_, info = env.step(0)
    assert set(info) == set(env.get_wrapper_attr("situation")) | {"instruction"} | (
        {"side"} if "find" in level else set()
    )


# Bad input.


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": "lift/lift_shape_zipf5"}, "did you mean 'lift/lift_shape_zipf"),
        ({"level": "put_on_bed_tray_all"}, "did you mean 'put/put_on_bed_tray_all'"),
        ({"level": "find_shape_zipf3"}, "did you mean 'supervised/find_shape_zipf3'"),
        ({"level": ""}, "unknown level '.*'.*: expected one of "),
        ({"image_size": (0, 96)}, r"image_size .*at least 1, got \(0, 96\)"),
        ({"image_size": (72, -1)}, r"image_size .*at least 1, got \(72, -1\)"),
        ({"image_size": (72, 96, 3)}, r"image_size must be \(rows, columns\).*got \(72, 96, 3\)"),
        ({"image_size": (72.5, 96)}, r"image_size .*whole number.*got \(72\.5, 96\)"),
        ({"image_size": 96}, r"image_size must be \(rows, columns\).*got 96"),
        ({"image_size": "ab"}, r"image_size must be \(rows, columns\), got 'ab'"),
        ({"image_size": (10**6, 10**6)}, "image_size must be at most 4096, got"),
        ({"object_order": "alternative"}, "'default' or 'alternate', got 'alternative'"),
        ({"object_order": ["default"]}, r"'default' or 'alternate', got \['default'\]"),
        ({"looks": "vary"}, "looks must be 'plain' or 'varied', got 'vary'"),
        ({"max_steps": 0}, "max_steps .*at least 1, got 0"),
        ({"max_steps": 10**12}, "max_steps must be at most 1000000, got 1000000000000"),
        ({"max_steps": 2.5}, r"max_steps .*whole number.*got 2\.5"),
        ({"max_steps": None}, "max_steps .*whole number.*got None"),
        ({"max_steps": True}, "max_steps .*whole number.*got True"),
        ({"reach": 1.4}, r"reach must be at least 1\.5, got 1\.4"),
        ({"reach": math.nan}, "reach must be a number, got nan"),
        ({"reach": "far"}, "reach must be a number, got 'far'"),
        ({"frequent_exponent": -1}, r"frequent_exponent must be at least 0\.0, got -1"),
        ({"frequent_exponent": None}, "frequent_exponent must be a number, got None"),
        ({"near_failure": 1}, "near_failure must be True or False, got 1"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str) -> None:
    level = options.get("level", "lift/lift_shape_zipf3")
    others = {key: value for key, value in options.items() if key != "level"}
    for attempt in (
        lambda: PlayroomEnv(**options),
        lambda: PlayroomVectorEnv(**options),
        lambda: make(f"playroom/{level}", **others),
        lambda: make_vec(f"playroom/{level}", 2, **others),
        lambda: gym.make(ID, **options),
        lambda: gym.make_vec(ID, 2, **options),
    ):
        with pytest.raises(ValueError, match=message):
            attempt()


@pytest.mark.parametrize("level", [3, None, ["lift/lift_shape_zipf3"]])
def test_a_level_that_is_no_name_is_refused(level: Any) -> None:
    for make_env in (PlayroomEnv, PlayroomVectorEnv):
        with pytest.raises(ValueError, match="level must be a name, got"):
            make_env(level=level)


def test_an_unknown_render_mode_is_refused() -> None:
    for make_env in (PlayroomEnv, PlayroomVectorEnv):
        with pytest.raises(ValueError, match=r"render_mode must be one of \['rgb_array'\] or None"):
            make_env(render_mode="human")
    assert PlayroomVectorEnv(2, **SMALL).render() is None


# States.


def played(level: str, steps: int, **options: Any) -> PlayroomVectorEnv:
    env = PlayroomVectorEnv(3, level, **{**SMALL, "max_steps": 200, **options})
    env.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(steps):
        env.step(rng.integers(46, size=3))
    return env


@pytest.mark.parametrize(
    ("level", "looks"),
    [("put/put_on_bed_tray_all", "plain"), ("put/lift_shape_many_zipf1", "varied")],
)
def test_stepping_continues_from_a_state(level: str, looks: str) -> None:
    """Including speeds, heights and orientations, which no observation shows."""
    env = played(level, 150, looks=looks)
    fresh = PlayroomVectorEnv(3, level, looks=looks, **{**SMALL, "max_steps": 200})
    fresh.set_state(env.get_state())
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env), fresh]
    rng = np.random.default_rng(1)
    for _ in range(60):
        actions = rng.integers(46, size=3)
        expected = env.step(actions)
        for other in copies:
            np.testing.assert_equal(other.step(actions), expected)
            for name in ("agents", "objects", "orientation", "status", "hands", "still", "lifted"):
                np.testing.assert_array_equal(getattr(other.envs, name), getattr(env.envs, name))


def test_an_episode_does_not_depend_on_those_before_it() -> None:
    """The physics uses the same bodies again."""
    options = {**SMALL, "max_steps": 60, "autoreset_mode": "Disabled"}
    env, fresh = (PlayroomVectorEnv(2, "put/lift_shape_many_zipf1", **options) for _ in range(2))
    rng = np.random.default_rng(0)
    for seed in range(8):
        env.reset(seed=seed)
        for _ in range(40):
            env.step(rng.choice([1, 1, 2, 3, 5, 17, 18, 24], size=2))
            env.reset(seed=100 + seed, options={"reset_mask": ~env._running})
    env.reset(seed=3)
    fresh.reset(seed=3)
    for _ in range(40):
        actions = rng.choice([1, 1, 1, 2, 3, 5], size=2)
        np.testing.assert_equal(env.step(actions), fresh.step(actions))
        for name in ("agents", "objects", "orientation", "status"):
            np.testing.assert_array_equal(getattr(env.envs, name), getattr(fresh.envs, name))
    assert (env.envs.objects[:, :, 3] >= 0).all()


def test_a_damaged_state_is_refused_and_changes_nothing() -> None:
    env = played("put/put_on_bed_tray_all", 30)
    before = env.get_state()
    kept = {
        name: getattr(env.envs, name).copy() for name in ("agents", "objects", "status", "ranks")
    }
    expected = copy.deepcopy(env).step(np.array([1, 2, 3]))

    def change(key: str, index: Any, value: Any) -> dict[str, np.ndarray]:
        state = env.get_state()
        state["returns"] += 1
        state[key][index] = value
        return state

    damaged = {
        "an action too high": change("actions", (1, 7), 46),
        "a rank too high": change("forced", (0, 1), 50),
        "a task too high": change("forced", (3, 1), 5),
        "a rank too low": change("forced", (1, 0), -2),
        "a length below 0": change("lengths", 2, -1),
        "a length above the limit": change("lengths", 2, 201),
        "an episode that should have ended": change("lengths", 2, 200),
        "an episode that never began": change("seeded", 1, False),
        "a key too few": {k: v for k, v in before.items() if k != "began"},
        "actions of another limit": {**before, "actions": before["actions"][:, :18]},
    }
    for state in damaged.values():
        with pytest.raises(ValueError, match="state"):
            env.set_state(state)
        np.testing.assert_equal(env.get_state(), before)
        for name, value in kept.items():
            np.testing.assert_array_equal(getattr(env.envs, name), value)
    np.testing.assert_equal(env.step(np.array([1, 2, 3])), expected)


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf4", "put/put_on_bed_tray_rare"])
def test_any_state_in_range_is_accepted(level: str) -> None:
    """Other streams, ranks that a level never draws, actions after the end of an episode."""
    env = played(level, 10)
    rng = np.random.default_rng(2)
    for fill in (0, None, np.iinfo(np.uint64).max):
        state = env.get_state()
        for key in ("streams", "began"):
            state[key][:] = (
                rng.integers(2**64, size=(3, 4), dtype=np.uint64) if fill is None else fill
            )
        state["forced"][:] = np.array([0, 0, 49, 4])[: len(state["forced"]), None]
        state["actions"][:] = rng.integers(46, size=state["actions"].shape)
        state["lengths"][:] = 199, 0, 120
        env.set_state(state)
        np.testing.assert_array_equal(env.envs.ranks, [[0, 0, 49]] * 3)
        *_, truncated, _ = env.step(np.zeros(3, np.int64))
        assert truncated[0]
        assert np.isfinite(env.envs.objects).all()


def test_worlds_without_an_episode_can_be_observed() -> None:
    env = PlayroomVectorEnv(3, "put/put_on_bed_tray_all", autoreset_mode="Disabled", **SMALL)
    mask = np.array([False, True, False])
    observation, info = env.reset(seed=0, options={"reset_mask": mask})
    assert (info["instruction"] != "").tolist() == mask.tolist()
    other = PlayroomVectorEnv(3, "put/put_on_bed_tray_all", autoreset_mode="Disabled", **SMALL)
    other.set_state(env.get_state())
    np.testing.assert_equal(other.observations(), observation)
    np.testing.assert_equal(pickle.loads(pickle.dumps(env)).observations(), observation)


# Frames.


def test_frames_are_larger_and_show_the_instruction() -> None:
    batch = PlayroomVectorEnv(2, "put/put_on_bed_tray_all", render_mode="rgb_array", **SMALL)
    batch.reset(seed=4)
    frames = batch.render()
    assert frames is not None
    for i, frame in enumerate(frames):
        assert frame.dtype == np.uint8
        assert frame.shape == (288, 384, 3)
        assert len(np.unique(frame[240:])) > 2
        single = PlayroomEnv("put/put_on_bed_tray_all", render_mode="rgb_array", **SMALL)
        single.reset(seed=4 + i)
        np.testing.assert_array_equal(single.render(), frame)
    assert (frames[0] != frames[1]).any()


def test_batches_do_not_share_the_renderer_of_frames() -> None:
    """It draws without the GIL in buffers of its own, and batches may be in different threads."""
    level = "put/put_on_bed_tray_all"
    one, other = (PlayroomVectorEnv(1, level, render_mode="rgb_array", **SMALL) for _ in range(2))
    for env in (one, other):
        env.reset(seed=0)
        env.render()
    assert one._view._large is not other._view._large
    for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
        np.testing.assert_array_equal(again.render(), one.render())
        assert again._view._large is not one._view._large


def test_the_image_size_does_not_change_the_episodes() -> None:
    sizes = [(1, 1), (5, 3), (72, 96)]
    envs = [PlayroomVectorEnv(4, "put/lift_shape_uniform", image_size=size) for size in sizes]
    for env in envs:
        env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(46, size=4)
        results = [env.step(actions)[1:] for env in envs]
        for env, result in zip(envs[1:], results[1:], strict=True):
            np.testing.assert_equal(result[:3], results[0][:3])
            np.testing.assert_array_equal(env.envs.objects, envs[0].envs.objects)
