"""The labyrinth as an environment: batches, states, mixtures, arguments and pictures of it."""

import copy
import pickle
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import slow_but
from gymnasium.vector import AutoresetMode
from labyrinth_levels import KINDS, batch
from numpy.typing import NDArray

from zipf.envs import Mixture, make, make_vec
from zipf.envs.labyrinth import topdown
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.testing import check_vector_env

ALL = pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
SMALL = {"image_size": (9, 12)}
MAKERS = {level: partial(make_vec, f"labyrinth/{level}") for level in LEVELS}


def mixture(num_envs: int, **options: Any) -> Mixture:
    """All levels, drawn at resets, with short time limits."""
    env = Mixture(MAKERS, num_envs, draw="resets", exponent=0.0, **{**SMALL, **options})
    return env


@pytest.mark.parametrize(
    ("level", "action_repeat"),
    slow_but(
        [
            ("rooms_select_nonmatching_object", 60),
            ("rooms_keys_doors_puzzle", 400),
            ("natlab_fixed_large_map", 600),
        ],
        ("rooms_select_nonmatching_object", 60),
    ),
)
def test_levels_keep_the_contract(level: str, action_repeat: int) -> None:
    """With long steps, for episodes of ten or so."""
    name, options = f"labyrinth/{level}", {**SMALL, "action_repeat": action_repeat}
    check_vector_env(
        partial(make_vec, name, **options), partial(make, name, **options), num_envs=3, steps=50
    )


@ALL
def test_a_batch_is_its_worlds(level: str) -> None:
    """And masks are respected, and the same seeds and actions give the same."""
    name = f"labyrinth/{level}"
    env, singles = make_vec(name, 3, **SMALL), [make(name, **SMALL) for _ in range(3)]
    first, _ = env.reset(seed=5)
    for i, single in enumerate(singles):
        observation, _ = single.reset(seed=5 + i)
        np.testing.assert_equal(observation["instruction"], first["instruction"][i])
        assert (observation["image"] == first["image"][i]).all()
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.integers(15, size=3)
        observed, reward, terminated, truncated, _ = env.step(actions)
        for i, single in enumerate(singles):
            one, r, over, out_of_time, _ = single.step(actions[i])
            assert (r, over, out_of_time) == (reward[i], terminated[i], truncated[i])
            np.testing.assert_equal(one["instruction"], observed["instruction"][i])
            assert (one["image"] == observed["image"][i]).all()
    again = make_vec(name, 3, **SMALL)
    again.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(40):
        repeated = again.step(rng.integers(15, size=3))
    assert (repeated[0]["image"] == observed["image"]).all()


@ALL
def test_episodes_are_saved_restored_and_pickled(level: str) -> None:
    env = batch(level, 4, **SMALL)
    env.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(120):
        env.step(rng.choice([0, 0, 10, 11, 12, 13, 7], size=4))
    other = batch(level, 4, **SMALL)
    other.reset(seed=9)
    other.set_state(env.get_state())
    pickled = pickle.loads(pickle.dumps(env))
    observed = env.observations()
    for one in (other, pickled):
        np.testing.assert_equal(one.observations(), observed)
        np.testing.assert_equal(one.envs.bodies, env.envs.bodies)
    for _ in range(40):
        actions = rng.integers(15, size=4)
        expected = env.step(actions)
        for one in (other, pickled):
            np.testing.assert_equal(one.step(actions)[:4], expected[:4])


def test_ten_thousand_random_steps_of_all_levels() -> None:
    env = mixture(36)
    env.reset(seed=0)
    engine = env.batches[0]
    assert isinstance(engine, LabyrinthVectorEnv)
    # Late in their episodes, so that many end and other levels begin.
    rng = np.random.default_rng(0)
    levels, total = set(env.levels_of_envs.tolist()), 0.0
    for t in range(280):
        if t % 20 == 0:
            engine.envs.clock[:] = np.maximum(engine.envs.clock, engine.envs.limit - 130)
        observation, reward, *_ = env.step(rng.integers(15, size=36))
        assert np.isfinite(reward).all()
        assert np.isfinite(engine.envs.bodies).all()
        assert observation["image"].shape == (36, 9, 12, 3)
        levels |= set(env.levels_of_envs.tolist())
        total += float(reward.sum())
    assert levels == set(range(len(LEVELS)))
    assert total > 0


def test_a_mixture_of_all_levels_steps_as_one() -> None:
    env = mixture(8)
    assert set(env.engines.tolist()) == {0}
    assert all(one.envs is env.batches[0].envs for one in env.batches)
    assert [one.level.name for one in env.batches] == list(LEVELS)
    env.reset(seed=0)
    # Each env is as in a batch of its own level: the level is drawn before the episode.
    for i, level in enumerate(env.levels_of_envs.tolist()):
        assert env.batches[0].episodes[i].__class__ is LEVELS[list(LEVELS)[level]].load()


@pytest.mark.parametrize(("repeat", "fps"), [(4, 15), (1, 60)])
def test_pictures_are_as_fast_as_the_world(repeat: int, fps: int) -> None:
    env = mixture(2, action_repeat=repeat)
    assert env.metadata["render_fps"] == env.batches[0].metadata["render_fps"] == fps


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": 3}, "level must be a name, got 3: expected one of rooms_collect"),
        ({"level": "rooms_water_maze"}, "did you mean 'rooms_watermaze'"),
        ({"image_size": (72,)}, r"image_size must be \(rows, columns\), got \(72,\)"),
        ({"image_size": (0, 96)}, "image_size must be"),
        ({"image_size": (7.5, 96)}, "image_size must be"),
        ({"image_size": (10**6, 10**6)}, "image_size must be at most 4096"),
        ({"num_actions": 7}, "num_actions must be 15 or 9, got 7"),
        ({"action_repeat": 0}, "action_repeat must be at least 1, got 0"),
        ({"action_repeat": 10**20}, "action_repeat must be at most 1000000, got"),
        ({"action_repeat": 2.5}, "action_repeat must be a whole number"),
        ({"max_steps": 0}, "max_steps must be at least 1, got 0"),
        ({"max_steps": 2.5}, "max_steps must be a whole number"),
        ({"render_mode": "human"}, "render_mode must be one of"),
    ],
)
def test_wrong_arguments(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LabyrinthVectorEnv(1, **options)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("seeds", 1.0),
        ("seeds", -0.1),
        ("seeds", np.nan),
        ("actions", 15),
        ("lengths", -1),
        ("lengths", 1351),
        ("lengths", 1350),
    ],
)
def test_damaged_states_are_refused(key: str, value: float) -> None:
    env = batch("explore_goal_locations_small", 2)
    env.reset(seed=0)
    env.step(np.zeros(2, np.int64))
    before = env.get_state()
    bodies = env.envs.bodies.copy()
    damaged = {name: array.copy() for name, array in before.items()}
    damaged[key].reshape(-1)[0] = value
    with pytest.raises(ValueError, match="damaged"):
        env.set_state(damaged)
    np.testing.assert_equal(env.get_state(), before)
    assert (env.envs.bodies == bodies).all()


def test_it_is_registered_with_gymnasium() -> None:
    env = gym.make("zipf/Labyrinth-v1", level="rooms_watermaze")
    image = env.observation_space["image"]
    assert image.shape == (72, 96, 3)
    assert image.dtype == np.uint8
    assert env.observation_space["instruction"].shape == (16,)
    assert env.action_space == gym.spaces.Discrete(15)
    env.reset(seed=0)
    *_, info = env.step(0)
    assert info == {"instruction": ""}
    many = gym.make_vec("zipf/Labyrinth-v1", num_envs=2, level="rooms_watermaze", num_actions=9)
    assert isinstance(many, LabyrinthVectorEnv)
    assert many.single_action_space.n == 9
    assert many.autoreset_mode is AutoresetMode.SAME_STEP


def test_the_end_of_an_episode_is_reported() -> None:
    env = make("labyrinth/rooms_select_nonmatching_object", **SMALL)
    env.reset(seed=0)
    info: dict[str, Any] = {}
    for _ in range(180):
        assert "return" not in info
        *_, terminated, truncated, info = env.step(14)
    assert (terminated, truncated) == (False, True)
    assert info["length"] == 180
    assert info["return"] == 0
    assert "success" not in info


# Pictures.


@ALL
def test_frames_show_the_view_and_the_map(level: str) -> None:
    env = batch(level, 2, render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert frames is not None
    assert len(frames) == 2
    for frame in frames:
        assert frame.shape == (288, 672, 3)
        assert frame.dtype == np.uint8
        map_ = frame[:, 384:].reshape(-1, 3)
        assert len(np.unique(map_, axis=0)) > 20
    assert (frames[0] != frames[1]).any()
    assert batch(level, 1).render() is None


def test_batches_do_not_share_the_renderer_of_frames() -> None:
    """It draws without the GIL in buffers of its own, and batches may be in different threads."""
    one, other = (batch("rooms_watermaze", 1, render_mode="rgb_array") for _ in range(2))
    for env in (one, other):
        env.reset(seed=0)
        env.render()
    assert one._scenery._large is not other._scenery._large
    for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
        np.testing.assert_equal(again.render(), one.render())
        assert again._scenery._large is not one._scenery._large


def is_empty(frame: NDArray[np.uint8]) -> bool:
    assert frame.shape == (288, 672, 3)
    return len(np.unique(frame[:, 384:].reshape(-1, 3), axis=0)) == 1


@ALL
def test_worlds_that_have_not_begun_are_drawn_empty(level: str) -> None:
    env = batch(level, 2, render_mode="rgb_array", autoreset_mode="Disabled")
    assert [is_empty(frame) for frame in env.render() or ()] == [True, True]
    env.reset(seed=0, options={"reset_mask": np.array([False, True])})
    assert [is_empty(frame) for frame in env.render() or ()] == [True, False]


def test_worlds_of_several_engines_are_drawn() -> None:
    """In a batch of an engine the envs of others have no episodes."""
    names = ("rooms_watermaze", "psychlab_visual_search", "explore_goal_locations_small")
    makers = {name: partial(MAKERS[name], max_steps=5 + k) for k, name in enumerate(names)}
    env = Mixture(makers, 3, render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    assert len(set(env.engines)) == 3
    assert [is_empty(frame) for frame in env.render() or ()] == [False] * 3


def test_the_map_shows_where_the_player_is() -> None:
    env = batch("explore_goal_locations_small", 1, render_mode="rgb_array")
    env.reset(seed=0)
    page = topdown._Page(topdown._bounds(env.envs, env._scenery, 0))
    for _ in range(3):
        x, y = env.envs.bodies[0, :2].tolist()
        left, top = page.at(x, y)
        column, row = round(left / 2), round(top / 2)
        frames = env.render()
        assert frames is not None
        near = frames[0][row - 1 : row + 2, 384 + column - 1 : 384 + column + 2]
        assert (near > 200).all(-1).any()  # the white of the arrow
        for _ in range(15):
            env.step(np.array([0]))
