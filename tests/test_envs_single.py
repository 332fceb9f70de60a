"""One env from a batch of one is the environment that Gymnasium's users expect."""

import warnings
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from zipf.envs import SingleEnv, make
from zipf.envs.gridworld.gridworld_env import GridworldEnv
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.testing import check_vector_env

SMALL: dict[str, Any] = {"num_maps": 3, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 9}


def small(**options: Any) -> SingleEnv:
    return SingleEnv(GridworldVectorEnv, level="uniform", **SMALL, **options)


def test_it_equals_a_world_written_by_itself() -> None:
    env, other = small(observation="tiles"), GridworldEnv("uniform", **SMALL, observation="tiles")
    rng = np.random.default_rng(0)
    assert env.situation == other.situation
    for episode in range(20):
        seed = None if episode % 2 else episode
        given, expected = env.reset(seed=seed), other.reset(seed=seed)
        np.testing.assert_equal(given, expected)
        ended = False
        while not ended:
            action = rng.integers(8)
            step, expected_step = env.step(action), other.step(action)
            np.testing.assert_equal(step, expected_step)
            kinds = {key: type(value) for key, value in expected_step[4].items()}
            assert {key: type(value) for key, value in step[4].items()} == kinds
            ended = step[2] or step[3]


SINGLES = [small, partial(GridworldEnv, "uniform", **SMALL)]


@pytest.mark.parametrize("make_single", SINGLES)
def test_seeds_may_be_numpys(make_single: Any) -> None:
    env = make_single()
    expected = env.reset(seed=3)
    np.testing.assert_equal(env.reset(seed=np.int64(3)), expected)


@pytest.mark.parametrize("make_single", SINGLES)
@pytest.mark.parametrize("seed", [-1, 1.5, "3", True])
def test_a_wrong_seed_changes_nothing(make_single: Any, seed: Any) -> None:
    env, other = make_single(), make_single()
    for one in (env, other):
        one.reset(seed=0)
    with pytest.raises(ValueError, match="seed must be"):
        env.reset(seed=seed)
    np.testing.assert_equal(env.step(1), other.step(1))
    np.testing.assert_equal(env.reset(), other.reset())


class Named(GridworldVectorEnv):
    def _describe(self) -> dict[str, Any]:
        ranks = self._situations()
        name = [f"object {rank}" for rank in ranks["target"]]
        return {"name": np.array(name), "words": np.array(name, object)}


def test_it_tells_what_the_batch_tells_about_an_episode() -> None:
    env = SingleEnv(Named, level="uniform", **SMALL)
    info = env.reset(seed=0, options={"target": 3})[1]
    assert type(info["name"]) is str
    assert info["name"] == info["words"] == "object 3"
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(0)
        assert info["name"] == "object 3"
        ended = terminated or truncated


def test_it_serves_as_the_single_world_of_the_check() -> None:
    check_vector_env(
        partial(GridworldVectorEnv, level="uniform", observation="tiles", **SMALL),
        partial(small, observation="tiles"),
        steps=60,
    )


def test_gymnasium_accepts_it() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(small(), skip_render_check=True)


def test_gymnasium_makes_it() -> None:
    spec = gym.envs.registration.EnvSpec(
        "Small-v0",
        entry_point=partial(SingleEnv, GridworldVectorEnv),
        kwargs={"level": "zipf_1", **SMALL},
    )
    env = gym.make(spec)
    assert env.reset(seed=3)[1] == make("gridworld/zipf_1", **SMALL).reset(seed=3)[1]


def test_it_draws_what_the_batch_draws() -> None:
    env = small(render_mode="rgb_array")
    env.reset(seed=0)
    other = GridworldEnv("uniform", **SMALL, render_mode="rgb_array")
    other.reset(seed=0)
    np.testing.assert_array_equal(env.render(), other.render())
    assert small().render() is None


def test_what_cannot_be_done_is_refused() -> None:
    env = small()
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ValueError, match="must be at least 0"):
        env.reset(seed=-1)
    with pytest.raises(ValueError, match=r"must be in 0 \.\. 2"):
        env.reset(options={"map": 3})
    with pytest.raises(ValueError, match=r"\['reset_mask'\]: expected \['map', 'target'\]"):
        env.reset(options={"reset_mask": np.array([False])})
    env.reset()
    with pytest.raises(ValueError, match=r"must be in 0 \.\. 7"):
        env.step(8)
    with pytest.raises(TypeError, match=r"the action must be an integer in 0 \.\. 7, got 1\.0"):
        env.step(1.0)
    env.close()
    with pytest.raises(ClosedEnvironmentError):
        env.step(0)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((3, 1), np.int64), r"integers of shape \(3,\).* got int64 of shape \(3, 1\)"),
        (np.zeros(3), r"integers of shape \(3,\).* got float64 of shape \(3,\)"),
        (np.int64(5), r"integers of shape \(3,\), one for each env, got a single one"),
    ],
)
def test_actions_of_another_shape_are_explained(actions: Any, message: str) -> None:
    env = GridworldVectorEnv(3)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(actions)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_batch_reports_what_gymnasiums_own_vector_env_reports(mode: AutoresetMode) -> None:
    """Where Gymnasium has an object array of dicts, `final_obs` is a dict of arrays here."""
    options = {"level": "uniform", "observation": "tiles", **SMALL}
    other = gym.make_vec(
        "zipf/Gridworld-v0",
        4,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **options,
    )
    env = GridworldVectorEnv(4, autoreset_mode=mode, **options)
    assert env.metadata["autoreset_mode"] == other.metadata["autoreset_mode"]
    rng = np.random.default_rng(0)
    compare(env.reset(seed=7), other.reset(seed=7))
    ended = 0
    for _ in range(80):
        actions = rng.integers(8, size=4)
        given, expected = env.step(actions), other.step(actions)
        compare(given, expected)
        done = given[2] | given[3]
        ended += done.sum()
        if mode is AutoresetMode.DISABLED and done.any():
            compare(
                env.reset(options={"reset_mask": done}),
                other.reset(options={"reset_mask": done}),
            )
    assert ended > 10


def compare(given: Any, expected: Any) -> None:
    np.testing.assert_equal(given[:-1], expected[:-1])
    compare_infos(given[-1], expected[-1])


def compare_infos(given: dict[str, Any], expected: dict[str, Any]) -> None:
    """The same entries where Gymnasium's masks are set; a mask of ours is the same as its."""
    names = {name for name in expected if not name.startswith("_")}
    assert {name for name in given if not name.startswith("_")} == names
    for name in names:
        mask = expected[f"_{name}"]
        if name in ("map", "target"):
            assert f"_{name}" not in given
        elif f"_{name}" in given:
            np.testing.assert_array_equal(given[f"_{name}"], mask)
        if name == "final_info":
            compare_infos(given[name], expected[name])
        elif name == "final_obs":
            for i in np.flatnonzero(mask):
                row = {key: rows[i] for key, rows in given[name].items()}
                np.testing.assert_equal(row, expected[name][i])
        else:
            np.testing.assert_array_equal(given[name][mask], expected[name][mask])
