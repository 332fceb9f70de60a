"""Several levels in one batch are the levels' own batches, side by side."""

import itertools
import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from zipf.envs import Mixture, Split, make, make_vec, split
from zipf.envs.check import check_vector_env
from zipf.envs.gridworld.vector import GridworldVectorEnv

SMALL: dict[str, Any] = {
    "num_maps": 6,
    "num_rooms": (2, 2),
    "num_objects": 5,
    "max_steps": 9,
    "observation": "tiles",
}
LEVELS = ("gridworld/zipf_2", "gridworld/uniform", "gridworld/rare")
SIZES = (3, 2, 2)


def mixture(num_envs: int = 7, levels: tuple[str, ...] = LEVELS, **options: Any) -> Any:
    return make_vec(levels, num_envs, **SMALL, **options)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_it_keeps_the_contract(count: int) -> None:
    """Of levels that are all the same, so that every world has the same single world."""
    level = "gridworld/zipf_1"
    makers = {str(number): partial(make_vec, level, **SMALL) for number in range(count)}
    check_vector_env(partial(Mixture, makers), partial(make, level, **SMALL))


def test_worlds_are_shared_evenly_in_blocks() -> None:
    env = mixture()
    assert env.level_names == LEVELS
    np.testing.assert_array_equal(env.levels_of_worlds, [0, 0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(mixture(3).levels_of_worlds, [0, 1, 2])


def parts(value: Any) -> list[Any]:
    """A result of the mixture as its levels' results."""
    ends = np.cumsum((0, *SIZES))
    blocks = [slice(a, b) for a, b in itertools.pairwise(ends)]

    def cut(value: Any, block: slice) -> Any:
        if isinstance(value, dict):
            return {key: cut(item, block) for key, item in value.items()}
        if isinstance(value, tuple):
            return tuple(cut(item, block) for item in value)
        return value[block]

    return [cut(value, block) for block in blocks]


def test_each_block_is_its_levels_own_batch() -> None:
    env = mixture()
    batches = [make_vec(level, n, **SMALL) for level, n in zip(LEVELS, SIZES, strict=True)]
    given = parts(env.reset(seed=5))
    firsts = np.cumsum((0, *SIZES))
    expected = [batch.reset(seed=5 + int(i)) for batch, i in zip(batches, firsts, strict=False)]
    np.testing.assert_equal(given, expected)
    rng = np.random.default_rng(0)
    ended = np.zeros(3, np.int64)
    for _ in range(100):
        actions = rng.integers(8, size=7)
        given = parts(env.step(actions))
        for i, (batch, block) in enumerate(zip(batches, parts(actions), strict=True)):
            observation, *rest, info = batch.step(block)
            np.testing.assert_equal(given[i][:4], (observation, *rest))
            done = info.get("_final_info", np.zeros(SIZES[i], bool))
            for name in env.situation:
                np.testing.assert_array_equal(given[i][4][name], info[name])
            if not done.any():
                assert not given[i][4].get("_final_info", done).any()
                continue
            ended[i] += done.sum()
            for what in ("final_info", "final_obs"):
                np.testing.assert_array_equal(given[i][4][f"_{what}"], done)
                for key, rows in info[what].items():
                    np.testing.assert_array_equal(given[i][4][what][key][done], rows[done])
    assert ended.min() > 10


def test_ranks_are_forced_and_worlds_reset_across_levels() -> None:
    env = mixture(autoreset_mode=AutoresetMode.DISABLED)
    info = env.reset(seed=0, options={"map": np.arange(7) % 6, "target": 4})[1]
    np.testing.assert_array_equal(info["map"], np.arange(7) % 6)
    np.testing.assert_array_equal(info["target"], 4)
    mask = np.array([0, 1, 0, 0, 1, 1, 0], np.bool_)
    info = env.reset(options={"target": 0, "reset_mask": mask})[1]
    np.testing.assert_array_equal(info["target"], np.where(mask, 0, 4))


def test_a_state_is_of_its_levels() -> None:
    env = mixture()
    env.reset(seed=0)
    state = env.get_state()
    assert "gridworld/zipf_2:worlds" in state  # the levels have one engine
    with pytest.raises(ValueError, match="a state has the keys"):
        mixture(levels=LEVELS[::-1][:2]).set_state(state)
    # The last level refuses its part, after the first has taken over its own: nothing changes.
    levels: Any = {"easy": partial(make_vec, LEVELS[0]), "hard": partial(make_vec, LEVELS[1])}
    other = [
        Mixture(levels, 4, **SMALL, level_options={"hard": {"max_steps": 5}}) for _ in range(2)
    ]
    state = other[0].get_state()
    other[0].reset(seed=0)
    other[1].reset(seed=1)
    before = other[1].get_state()
    state = other[0].get_state()
    state["hard:worlds"] = state["hard:worlds"] + 1000
    with pytest.raises(ValueError, match="damaged"):
        other[1].set_state(state)
    np.testing.assert_equal(other[1].get_state(), before)


def test_a_pickled_one_draws_from_its_own_streams() -> None:
    env = mixture()
    env.reset(seed=0)
    other = pickle.loads(pickle.dumps(env))
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(8, size=7)
        np.testing.assert_equal(other.step(actions)[:4], env.step(actions)[:4])


def test_a_family_whose_state_is_what_was_done_is_mixed() -> None:
    """The playroom plays its episodes again, for which it needs to know how long they are."""
    env = make_vec(split("playroom_put").train, 4, image_size=(12, 16), max_steps=15)
    info = env.reset(seed=0)[1]
    assert [text.split()[0] for text in info["instruction"]] == ["lift", "lift", "put", "put"]
    rng = np.random.default_rng(0)
    for _ in range(10):
        env.step(rng.integers(46, size=4))
    pickled = pickle.loads(pickle.dumps(env))
    set_ = make_vec(split("playroom_put").train, 4, image_size=(12, 16), max_steps=15)
    set_.set_state(env.get_state())
    for _ in range(20):
        actions = rng.integers(46, size=4)
        expected = env.step(actions)
        for other in (pickled, set_):
            np.testing.assert_equal(other.step(actions)[:4], expected[:4])


def test_it_draws_and_closes_every_level() -> None:
    env = mixture(render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 7
    batches = [make_vec(level, 7, **SMALL, render_mode="rgb_array") for level in LEVELS]
    for batch in batches:
        batch.reset(seed=0)
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame, batches[env.levels_of_worlds[i]].render()[i])
    assert mixture().render() is None
    env.close()
    assert all(batch.closed for batch in env.batches)


class Other(GridworldVectorEnv):
    def __init__(self, num_envs: int, **options: Any) -> None:
        super().__init__(num_envs, **{**options, "num_maps": 5})


def test_what_cannot_be_mixed_is_refused() -> None:
    with pytest.raises(ValueError, match=r"num_envs must be at least 3.*gridworld/zipf_2.*got 2"):
        mixture(2)
    with pytest.raises(ValueError, match=r"situation, but .*'map': 6.* in gridworld/rare and .*5"):
        make_vec(["gridworld/rare", Other], 2, **SMALL)
    with pytest.raises(ValueError, match="every level once, got gridworld/rare, gridworld/rare"):
        make_vec(["gridworld/rare", "gridworld/rare"], 2)
    with pytest.raises(ValueError, match="at least one level"):
        make_vec([], 2)
    with pytest.raises(ValueError, match="did you mean 'gridworld/rare'"):
        make_vec(["gridworld/uniform", "gridwrld/rare"], 2)


def test_a_split_names_one_train_level_or_several() -> None:
    one = Split("one", *LEVELS)
    assert [one.levels(kind) for kind in ("train", "uniform", "rare")] == [(x,) for x in LEVELS]
    several = Split("several", LEVELS[:2], *LEVELS[1:])
    assert several.levels("train") == LEVELS[:2]
    assert make_vec(several.train, 5, **SMALL).level_names == LEVELS[:2]
