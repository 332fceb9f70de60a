"""Several levels in one batch are the levels' own batches, side by side."""

import itertools
import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from scipy.stats import chisquare

from zipf.envs import (
    Mixture,
    SingleEnv,
    Split,
    SplitLevel,
    ZipfVectorEnv,
    make,
    make_train,
    make_vec,
    pcg64,
    split,
)
from zipf.envs.distributions import zipfian
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.testing import check_vector_env

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
    """Of levels that are all the same, so that every env has the same single env."""
    level = "gridworld/zipf_1"
    makers = {str(number): partial(make_vec, level, **SMALL) for number in range(count)}
    check_vector_env(partial(Mixture, makers), partial(make, level, **SMALL))


def test_worlds_are_shared_evenly_in_blocks() -> None:
    env = mixture()
    assert env.level_names == LEVELS
    np.testing.assert_array_equal(env.levels_of_envs, [0, 0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(mixture(3).levels_of_envs, [0, 1, 2])


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


def test_a_state_is_of_its_levels() -> None:
    env = mixture()
    env.reset(seed=0)
    state = env.get_state()
    assert "gridworld/zipf_2:worlds" in state  # the levels have one engine
    with pytest.raises(ValueError, match="a state has the keys"):
        mixture(levels=LEVELS[::-1][:2]).set_state(state)
    # The last level refuses its part, after the first has taken over its own: nothing changes.
    hard = partial(make_vec, LEVELS[1], **{**SMALL, "max_steps": 5})
    levels: Any = {"easy": partial(make_vec, LEVELS[0], **SMALL), "hard": hard}
    other = [Mixture(levels, 4) for _ in range(2)]
    state = other[0].get_state()
    other[0].reset(seed=0)
    other[1].reset(seed=1)
    before = other[1].get_state()
    state = other[0].get_state()
    state["hard:worlds"] = state["hard:worlds"] + 1000
    with pytest.raises(ValueError, match="damaged"):
        other[1].set_state(state)
    np.testing.assert_equal(other[1].get_state(), before)


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
        np.testing.assert_array_equal(frame, batches[env.levels_of_envs[i]].render()[i])
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


@pytest.mark.parametrize(
    ("make_other", "message"),
    [
        (lambda n, **_: EASY["rare"](n - 1), "level 'b' must have the 4 envs .*, got 3"),
        (lambda n, **_: make("gridworld/rare"), "level 'b' must be a ZipfVectorEnv of 4 envs, g"),
    ],
)
def test_levels_must_be_the_batches_asked_for(make_other: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mixture({"a": EASY["rare"], "b": make_other}, 4)


def test_the_train_levels_of_a_split_share_the_worlds() -> None:
    several = Split("several", LEVELS[:2], *LEVELS[1:])
    assert make_vec(several.train, 5, **SMALL).level_names == LEVELS[:2]
    assert make_train(several, 5, **SMALL).level_names == LEVELS[:2]
    weighted = Split("weighted", [SplitLevel(LEVELS[0], 3.0), LEVELS[1]], *LEVELS[1:], "resets")
    env = make_train(weighted, 5, **SMALL)
    assert isinstance(env, Mixture)
    # The third level is only tested on: it has a rank, and is not drawn.
    np.testing.assert_allclose(env.probabilities, [0.75, 0.25, 0.0])


# A level drawn at every reset.

EASY: dict[str, Any] = {
    name: partial(make_vec, f"gridworld/{name}") for name in ("zipf_3", "zipf_2", "uniform", "rare")
}


def drawn(num_envs: int = 6, levels: Any = None, **options: Any) -> Mixture:
    options = {"draw": "resets", "exponent": 1.0, **options}
    return Mixture(levels or EASY, num_envs, **SMALL, **options)


class Counting(ZipfVectorEnv):
    """Counts to `last`; has an engine of its own and no situation. For levels that differ."""

    reports_success = False

    def __init__(self, num_envs: int, *, last: int = 3, **options: Any) -> None:
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(count=spaces.Box(0, 99, (), np.int64)),
            single_action_space=spaces.Discrete(2),
            situation={},
            **options,
        )
        self.last = last
        self.stepped = np.zeros(num_envs, np.int64)

    def _begin(self, mask: Any, forced: Any) -> None: ...

    def _advance(self, actions: Any, mask: Any) -> Any:
        self.stepped += mask
        ended = self._lengths >= self.last
        return actions * 1.0, ended, np.zeros_like(ended), ended

    def _observe(self, out: Any, mask: Any) -> None:
        out["count"][mask] = self._lengths[mask]

    def _situations(self) -> Any:
        return {}

    def _describe(self) -> Any:
        return {"last": np.full(self.num_envs, self.last)}

    def _get_env_states(self) -> Any:
        return {}

    def _set_env_states(self, state: Any) -> None: ...


COUNTING = {f"to_{last}": partial(Counting, last=last) for last in (2, 3, 5, 7, 9)}


@pytest.mark.parametrize(
    "levels",
    [
        EASY,
        {**EASY, "short": partial(make_vec, "gridworld/uniform", max_steps=4)},
        COUNTING,
    ],
    ids=["one engine", "two engines", "own engines"],
)
def test_drawn_levels_keep_the_contract(levels: Any) -> None:
    options: Any = {} if levels is COUNTING else {k: v for k, v in SMALL.items()}
    if "short" in levels:
        del options["max_steps"]
    make_env = partial(Mixture, levels, draw="resets", exponent=0.5, **options)
    check_vector_env(make_env, partial(SingleEnv, lambda n, **kw: make_env(n, **kw)))


def test_an_episode_takes_one_number_more_than_the_levels_own() -> None:
    env = drawn()
    env.reset(seed=5)
    streams = [pcg64.stream(5 + i) for i in range(6)]
    for i, stream in enumerate(streams):
        level = pcg64.choice(stream, pcg64.cumulative(env.probabilities))
        assert level == env.levels_of_envs[i]
        alone = make_vec(f"gridworld/{env.level_names[level]}", 1, **SMALL)
        alone.reset()
        alone._streams[0] = stream
        observation, info = alone.reset()
        for key, rows in env.observations().items():
            np.testing.assert_array_equal(rows[i], observation[key][0])
        assert env._situations()["target"][i] == info["target"][0]
        np.testing.assert_array_equal(alone._streams[0], env._streams[i])


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5])
def test_levels_are_drawn_by_the_law(exponent: float) -> None:
    env = Mixture(COUNTING, 500, draw="resets", exponent=exponent)
    counts = np.zeros(5)
    env.reset(seed=1)
    for _ in range(8):
        counts += np.bincount(env.reset()[1]["level"], minlength=5)
    expected = zipfian(5, exponent)
    np.testing.assert_array_equal(env.probabilities, expected)
    assert chisquare(counts, expected * counts.sum()).pvalue > 1e-3


SHUFFLED = ("to_2", "to_9", "to_3", "to_7", "to_5")  # by seed 3, on every machine


def test_the_order_says_which_level_is_frequent() -> None:
    names = tuple(COUNTING)
    make_env = partial(Mixture, COUNTING, 50, draw="resets", exponent=8)
    for order, expected in (("forward", names), ("reversed", names[::-1])):
        env = make_env(order=order)
        assert env.level_names == expected
        info = env.reset(seed=0)[1]
        assert (info["level"] == 0).mean() > 0.9
        np.testing.assert_array_equal(info["level_name"], np.array(expected)[info["level"]])
    shuffled = make_env(order=3).level_names
    assert shuffled == make_env(order=3).level_names == SHUFFLED
    assert sorted(shuffled) == sorted(names)
    assert {make_env(order=seed).level_names for seed in range(5)} > {shuffled}


def test_levels_are_scored_one_at_a_time() -> None:
    """With all probability on one level, or by changing the probabilities of one batch."""
    env = drawn(autoreset_mode=AutoresetMode.SAME_STEP)
    rng = np.random.default_rng(0)
    for rank in (2, 0, 3):
        only = np.eye(4)[rank]
        other = drawn(exponent=None, probabilities=only)
        env.probabilities = 2 * only
        np.testing.assert_equal(env.reset(seed=9), other.reset(seed=9))
        for _ in range(30):
            actions = rng.integers(8, size=6)
            given, expected = env.step(actions), other.step(actions)
            np.testing.assert_equal(given[:4], expected[:4])
            assert (given[4]["level"] == rank).all()
            assert set(given[4]["level_name"]) == {env.level_names[rank]}


def test_a_forced_level_begins_once() -> None:
    env = drawn(exponent=None, probabilities=[1, 0, 0, 0], autoreset_mode="Disabled")
    forced = {"level": np.array([0, 1, 2, 3, 3, 1]), "target": 2}
    info = env.reset(seed=0, options=forced)[1]
    np.testing.assert_array_equal(info["level"], forced["level"])
    assert (info["target"] == 2).all()
    assert (env.reset()[1]["level"] == 0).all()


def test_only_worlds_of_a_level_are_stepped_by_it() -> None:
    env = Mixture(COUNTING, 8, draw="resets", exponent=0.0)
    env.reset(seed=0, options={"level": [0, 0, 1, 1, 1, 2, 3, 3]})
    env.step(np.zeros(8, np.int64))
    stepped = np.stack([batch.stepped for batch in env.batches])
    np.testing.assert_array_equal(stepped.sum(0), 1)
    np.testing.assert_array_equal(stepped.sum(1), [2, 3, 1, 2, 0])


def test_what_levels_do_not_share_is_left_out() -> None:
    def other(num_envs: int, **options: Any) -> ZipfVectorEnv:
        env = Counting(num_envs, **options)
        env.situation, env.reports_success = {"parity": 2}, True
        env._describe = lambda: {}  # type: ignore[method-assign]
        return env

    assert Mixture(COUNTING, 3, draw="resets", exponent=1).reset()[1].keys() == {
        "level",
        "level_name",
        "last",
    }
    env = Mixture({"a": Counting, "b": other}, 3, draw="resets", exponent=1, rank="course")
    assert env.situation == {"course": 2}
    assert env.reset()[1].keys() == {"course", "course_name"}
    assert not env.reports_success
    assert drawn().situation == {"level": 4, "map": 6, "target": 5}


def test_levels_share_their_arrays_as_soon_as_they_are_made() -> None:
    """So that not all of them have arrays of their own at the same time."""
    made: list[Any] = []

    def making(num_envs: int, **options: Any) -> ZipfVectorEnv:
        assert all(batch._envs is made[0]._envs for batch in made)
        made.append(make_vec("gridworld/uniform", num_envs, **options))
        return made[-1]

    env = drawn(levels=dict.fromkeys("abcd", making))
    assert env.engines.tolist() == [0] * 4
    assert env.time_limit == 9


def test_levels_of_one_engine_may_have_other_time_limits() -> None:
    names = ("rooms_select_nonmatching_object", "rooms_watermaze", "lasertag_one_opponent_small")
    levels = {name: partial(make_vec, f"labyrinth/{name}", image_size=(3, 4)) for name in names}
    env = Mixture(levels, 3)
    assert env.engines.tolist() == [0] * 3
    assert env.time_limit == max(make(1).time_limit or 0 for make in levels.values())


PLAYROOM: Any = {
    "lift": partial(make_vec, "playroom/put/lift_shape_zipf2"),
    "near": partial(make_vec, "playroom/put/put_near_bed_tray_frequent"),
    "long": partial(make_vec, "playroom/put/put_on_bed_tray_all", max_steps=23),
}


def test_drawn_levels_of_the_playroom_keep_the_contract() -> None:
    levels = {name: partial(make, image_size=(6, 8)) for name, make in PLAYROOM.items()}
    make_env = partial(Mixture, levels, draw="resets", exponent=0.0, max_steps=11)
    levels["long"] = partial(levels["long"], max_steps=18)
    check_vector_env(
        make_env, partial(SingleEnv, lambda n, **kw: make_env(n, **kw)), num_envs=3, steps=45
    )


def test_mixtures_are_levels_of_mixtures() -> None:
    inner = {
        "few": partial(drawn, levels={"zipf_2": EASY["zipf_2"], "rare": EASY["rare"]}),
        "many": partial(drawn, levels={"rare": EASY["rare"], "uniform": EASY["uniform"]}),
    }
    make_env = partial(Mixture, inner, draw="resets", exponent=1.0, rank="group")
    assert make_env(2).situation == {"group": 2, "level": 2, "map": 6, "target": 5}
    check_vector_env(make_env, partial(SingleEnv, lambda n, **kw: make_env(n, **kw)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"draw": "steps"}, "draw must be 'worlds' or 'resets', got 'steps'"),
        ({"exponent": None}, "draw='resets' needs either exponent or probabilities"),
        ({"probabilities": [1, 1, 1, 1]}, "needs either exponent or probabilities"),
        ({"exponent": -1}, "exponent of Zipf's law must be finite and >= 0, got -1"),
        ({"draw": "worlds"}, "exponent, probabilities and order need draw='resets'"),
        ({"exponent": None, "probabilities": [1, 1]}, r"must be 4 finite numbers >= 0, got \[1, 1"),
        ({"exponent": None, "probabilities": [1, 1, -1, 1]}, "must be 4 finite numbers >= 0"),
        ({"exponent": None, "probabilities": [0] * 4}, "probabilities must not all be 0"),
        ({"order": "backwards"}, "'forward', 'reversed' or an integer >= 0.*got 'backwards'"),
        ({"order": -1}, "order must be 'forward'.*got -1"),
        ({"order": True}, "order must be 'forward'.*got True"),
        ({"rank": "target"}, "the levels have a rank 'target' themselves: choose another name"),
        ({"rank": "length"}, "levels' rank cannot be called 'length'.*reserved names achieved, "),
        ({"rank": "_level"}, "levels' rank cannot be called '_level'"),
        ({"rank": 3}, "levels' rank cannot be called 3: expected a string"),
    ],
)
def test_wrong_laws_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drawn(**options)


def test_probabilities_are_changed_as_a_whole() -> None:
    env = drawn()
    with pytest.raises(ValueError, match="read-only"):
        env.probabilities[0] = 1.0
    env.probabilities = [1e308] * 4
    np.testing.assert_array_equal(env.probabilities, [0.25] * 4)


def test_a_rank_that_the_levels_describe_is_refused() -> None:
    def told(num_envs: int, **options: Any) -> ZipfVectorEnv:
        env = EASY["rare"](num_envs, **options)
        env._describe = lambda: {"task_name": np.zeros(num_envs)}  # type: ignore[method-assign]
        return env

    for rank in ("task_name", "task"):
        with pytest.raises(ValueError, match=f"the levels have an entry '{rank}' or '{rank}_name'"):
            Mixture({"a": told, "b": told}, 2, draw="resets", exponent=1.0, rank=rank)


def test_what_actions_point_at_is_kept_where_the_levels_agree() -> None:
    def pointing(num_envs: int, **options: Any) -> ZipfVectorEnv:
        env = EASY["rare"](num_envs, **options)
        env.action_regions = np.eye(4, dtype=np.float32)
        return env

    alike = Mixture({"a": pointing, "b": pointing}, 2, draw="resets", exponent=1.0)
    np.testing.assert_array_equal(alike.action_regions, np.eye(4))
    other = Mixture({"a": pointing, "b": EASY["rare"]}, 2, draw="resets", exponent=1.0)
    assert other.action_regions is None


def test_levels_with_other_observations_or_actions_are_named() -> None:
    with pytest.raises(ValueError, match=r"space, but 'cue' is Box.* in zipf_3 and absent in rare"):
        Mixture(
            {
                "zipf_3": partial(EASY["zipf_3"], **SMALL),
                "rare": partial(EASY["rare"], **{**SMALL, "observation": "image"}),
            },
            2,
        )
    with pytest.raises(ValueError, match=r"same single_observation_space, but 'count' is Box"):
        Mixture({"count": Counting, "grid": EASY["rare"]}, 2, draw="resets", exponent=1)

    def other(num_envs: int, **options: Any) -> ZipfVectorEnv:
        env = Counting(num_envs, **options)
        env.single_action_space = spaces.Discrete(3)
        return env

    with pytest.raises(ValueError, match=r"action_space, but it is Discrete\(2\) in one and D"):
        Mixture({"one": Counting, "other": other}, 2)


def test_a_state_of_other_levels_is_refused() -> None:
    env = drawn()
    env.reset(seed=0)
    state = env.get_state()
    state["levels"] = state["levels"] + 4
    before = env.get_state()
    with pytest.raises(ValueError, match="levels out of range"):
        env.set_state(state)
    np.testing.assert_equal(env.get_state(), before)
