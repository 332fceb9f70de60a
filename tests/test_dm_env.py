"""Levels as dm_env environments: the library's own tests, and what an agent is told."""

import sys
from typing import Any

import dm_env
import numpy as np
import pytest
from absl import logging
from absl.testing import absltest
from dm_env import specs, test_utils
from gymnasium import spaces

from zipf import envs
from zipf.adapters.dm_env import (
    DmEnv,
    _spec,
    zipfs_gridworld,
    zipfs_labyrinth,
    zipfs_playroom,
)

# Where logging is configured anew, as by Submitit, absl's handler closes its stream, pytest's.
logging.get_absl_handler().python_handler.stream = sys.__stderr__

SMALL: dict[str, Any] = {"num_maps": 5, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 12}
SETTINGS = zipfs_playroom.EnvironmentSettings(
    seed=1, level_name="lift/lift_shape_zipf3", episode_length_seconds=1
)
MAKE = {
    "gridworld": lambda: DmEnv("gridworld/zipf_2", seed=0, **SMALL),
    "tiles": lambda: DmEnv("gridworld/uniform", seed=0, observation="tiles", **SMALL),
    "playroom": lambda: DmEnv("playroom/lift/lift_shape_uniform", seed=0, max_steps=6),
    "labyrinth": lambda: DmEnv("labyrinth/explore_goal_locations_small", seed=0, max_steps=6),
    "released gridworld": lambda: zipfs_gridworld.simple_builder("zipf_2", SMALL, seed=0),
    "released playroom": lambda: zipfs_playroom.load_from_docker(SETTINGS),
    "released labyrinth": lambda: zipfs_labyrinth(
        level_name="explore_goal_locations_small", seed=0, max_steps=6
    ),
}


@pytest.mark.parametrize("make", MAKE.values(), ids=MAKE)
def test_the_librarys_own_tests_pass(make):
    class Test(test_utils.EnvironmentTestMixin, absltest.TestCase):
        def make_object_under_test(self):
            return make()

    result = absltest.unittest.TestResult()
    absltest.unittest.defaultTestLoader.loadTestsFromTestCase(Test).run(result)
    assert result.testsRun >= 4
    assert not result.errors, result.errors[0][1]
    assert not result.failures, result.failures[0][1]


def test_steps_and_discounts_are_those_of_the_env():
    env, baseline = (
        DmEnv("gridworld/zipf_2", seed=3, **SMALL),
        envs.make("gridworld/zipf_2", **SMALL),
    )
    rng = np.random.default_rng(0)
    discounts = []
    expected, info = baseline.reset(seed=3)
    step = env.reset()
    for _ in range(300):
        np.testing.assert_array_equal(step.observation["image"], expected["image"])
        assert env.info == info
        action = rng.integers(8)
        step = env.step(action)
        if step.first():
            expected, info = baseline.reset()
            continue
        expected, reward, terminated, truncated, info = baseline.step(action)
        assert step.last() == (terminated or truncated)
        assert (step.reward, step.discount) == (reward, 0.0 if terminated else 1.0)
        if step.last():
            discounts.append(step.discount)
    assert {*discounts} == {0.0, 1.0}


def test_specs_name_and_bound_what_an_agent_sees():
    env = DmEnv("gridworld/uniform", observation="tiles", **SMALL)
    tiles, cue = (env.observation_spec()[name] for name in ("tiles", "cue"))
    assert tiles == specs.BoundedArray((7, 7), np.uint8, 0, tiles.maximum, "tiles")
    assert cue.shape == (1,)
    assert env.action_spec() == specs.DiscreteArray(8, name="action")
    text = DmEnv("playroom/lift/lift_shape_uniform").observation_spec()["instruction"]
    assert (text.shape, text.dtype) == ((6,), np.int64)
    codes = spaces.MultiDiscrete([3, 4], start=[-1, 2])
    for space in (codes, spaces.MultiBinary((2, 3)), spaces.Discrete(3, start=1)):
        spec = _spec("part", space)
        assert (spec.shape, spec.dtype) == (space.shape, space.dtype)
        spec.validate(space.sample())
    assert (_spec("part", codes).minimum.tolist(), _spec("part", codes).maximum.tolist()) == (
        [-1, 2],
        [1, 5],
    )


def test_the_released_names_show_what_the_release_shows():
    env = zipfs_gridworld.simple_builder(level_name="uniform_rare", seed=1234)
    (image,) = env.reset().observation
    expected = envs.make("gridworld/rare").reset(seed=1234)[0]["image"]
    assert image.dtype == np.float32
    np.testing.assert_array_equal(np.round(image * 255), expected)
    assert env.action_spec().name == "grid_actions"
    step = zipfs_playroom.load_from_docker(name="image", settings=SETTINGS).reset()
    assert step.observation["TEXT"].item().startswith("lift a ")
    assert step.observation["RGB_INTERLEAVED"].shape == (72, 96, 3)
    with pytest.raises(ValueError, match="num_action_repeats=1: an action lasts 4 frames here"):
        zipfs_playroom.load_from_docker(SETTINGS._replace(num_action_repeats=1))


def test_wrong_actions_and_levels_are_refused():
    env = DmEnv("gridworld/zipf_2", **SMALL)
    assert env.step("nothing runs yet").step_type is dm_env.StepType.FIRST
    with pytest.raises(ValueError, match="8"):
        env.step(8)
    with pytest.raises(TypeError, match="integer"):
        env.step(0.5)
    with pytest.raises(ValueError, match="unknown level 'zipf'"):
        zipfs_gridworld.simple_builder("zipf")
    with pytest.raises(ValueError, match="observation=tiles has no images"):
        zipfs_gridworld.simple_builder("zipf_2", {"observation": "tiles"})
