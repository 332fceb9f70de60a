"""Lists of Gymnasium environments become families with train, uniform and rare levels."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from scipy.stats import chisquare

import zipf.envs
from zipf.envs import GymnasiumVectorEnv, family, make_vec, measure_chance
from zipf.envs.distributions import rare, uniform
from zipf.envs.distributions import zipfian as law
from zipf.envs.testing import check_vector_env


class Goal(gym.Env[Any, Any]):
    """Three tries to say which of ten goals it is. Another version of it shows nothing."""

    def __init__(self, goal: int = 0, tries: int = 3) -> None:
        self.observation_space = spaces.Discrete(10)
        self.action_space = spaces.Discrete(10)
        self.goal, self.tries = goal, tries

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.tried = 0
        return self.goal, {}

    def step(self, action: Any) -> Any:
        self.tried += 1
        success = bool(action == self.goal)
        return self.goal, float(success), success, self.tried >= self.tries, {"success": success}


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    ids = [f"Goal-{word}-v0" for word in ("One", "Two", "Three", "Four", "Five")]
    for goal, id in enumerate(ids):
        gym.register(id, Goal, kwargs={"goal": goal})
    gym.register("Goal-v1", Goal)
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    yield
    for id in (*ids, "Goal-v1"):
        del gym.registry[id]


IDS = [f"Goal-{word}-v0" for word in ("One", "Two", "Three", "Four", "Five")]


def over(count: int = 10, **options: Any) -> zipf.envs.Family:
    return zipf.envs.zipfian("Goal-v1", over={"goal": range(count)}, **options)


def test_a_family_may_be_called_as_the_namespace_of_its_environments() -> None:
    ids = [f"goals/{word}-v0" for word in ("One", "Two", "Three", "Four", "Five")]
    for goal, id in enumerate(ids):
        gym.register(id, Goal, kwargs={"goal": goal})
    try:
        assert zipf.envs.register(zipf.envs.zipfian(ids)).name == "goals"
        assert (make_vec("goals/goals/Three-v0", 2).reset()[0]["observation"] == 2).all()
        with pytest.raises(ValueError, match="unknown level 'goals/goals/Six-v0'"):
            make_vec("goals/goals/Six-v0", 2)
    finally:
        for id in ids:
            del gym.registry[id]


def test_a_list_of_ids() -> None:
    made = zipf.envs.register(zipf.envs.zipfian(IDS, exponent=2))
    assert made.name == "goal"
    assert made.levels == ("zipf_2", "uniform", "rare", "validation", *IDS)
    split = zipf.envs.split("goal")
    names = {kind: [level.name for level in split.levels(kind)] for kind in split.kinds}
    others = {kind: [f"goal/{kind}"] for kind in ("uniform", "rare", "validation")}
    assert names == {"train": ["goal/zipf_2"], **others}
    env = make_vec("goal/zipf_2", 40)
    assert env.situation == {"level": 5}
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation["observation"], info["level"])
    np.testing.assert_array_equal(info["level_name"], np.array(IDS)[info["level"]])
    alone = make_vec("goal/Goal-Three-v0", 2)
    assert isinstance(alone, GymnasiumVectorEnv)
    assert (alone.reset()[0]["observation"] == 2).all()


def test_a_list_of_options() -> None:
    made = zipf.envs.register(over(exponent=1.5, options={"tries": 2}))
    assert made.name == "goal"
    assert made.levels[:5] == ("zipf_1.5", "uniform", "rare", "validation", "goal_0")
    env = make_vec("goal/rare", 40)
    assert env.situation == {"goal": 10}
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation["observation"], info["goal"])
    assert set(info["goal"]) == {8, 9}
    assert info["goal_name"][0] == f"goal_{info['goal'][0]}"
    info = env.reset(options={"goal": 3})[1]
    assert (info["goal"] == 3).all()
    for _ in range(2):
        final = env.step(np.full(40, 9))[4]
    assert (final["final_info"]["length"] == 2).all()


@pytest.mark.parametrize(
    ("level", "expected"),
    [("zipf_1", law(10, 1)), ("zipf_3", law(10, 3)), ("uniform", uniform(10)), ("rare", rare(10))],
)
def test_levels_follow_their_distributions(level: str, expected: Any) -> None:
    env = over().make_batch(level, 1000)
    counts = sum(np.bincount(env.reset(seed=k)[1]["goal"], minlength=10) for k in (0, 5000))
    possible = expected > 0
    assert not counts[~possible].any()
    assert chisquare(counts[possible], expected[possible] * counts.sum()).pvalue > 1e-3


def test_the_order_is_that_of_all_levels() -> None:
    for order, ranked in (("reversed", range(9, -1, -1)), (4, None)):
        made = over(order=order)
        seen = []
        for level in ("zipf_1", "uniform", "rare"):
            env = made.make_batch(level, 10)
            seen.append(env.reset(options={"goal": np.arange(10)})[0]["observation"].tolist())
        assert seen[0] == seen[1] == seen[2]
        assert sorted(seen[0]) == list(range(10))
        assert seen[0] == list(ranked) if ranked else seen[0] != list(range(10))


def test_worlds_keep_the_contract() -> None:
    made = over(5)
    make_vec, make = (partial(made_by, "zipf_1") for made_by in (made.make_batch, made.make_single))
    check_vector_env(make_vec, make, num_envs=3, steps=60)


def test_chance_is_known_once_it_is_measured() -> None:
    zipf.envs.register(over())
    assert zipf.envs.baseline("chance", "goal/zipf_1") is None
    measured = measure_chance("goal/zipf_1", episodes=4000)
    assert measured.episodes == 4000
    assert measured.score == pytest.approx(1 - 0.9**3, abs=0.02)
    assert measure_chance("goal/zipf_1", episodes=4000) == measured
    assert measure_chance("goal/zipf_1", episodes=4000, seed=1) != measured
    zipf.envs.register(over(name="other", chance={"zipf_1": measured}))
    assert zipf.envs.baseline("chance", "other/zipf_1") == measured
    assert zipf.envs.baseline("chance", "other/zipf_1.0") == measured
    assert zipf.envs.baseline("chance", "other/uniform") is None


class Coin(Goal):
    """Action 0 ends the episode and pays, 1 does not pay and goes on for 100 steps."""

    def step(self, action: Any) -> Any:
        self.tried += 1
        first = self.tried == 1
        self.paid = action < 5 if first else self.paid
        return 0, float(first and self.paid), self.paid or self.tried == 100, False, {}


def test_chance_counts_episodes_as_they_start() -> None:
    """Counting the first to end, of which nearly all are short, would give nearly 1."""
    gym.register("Coin-v0", Coin)
    make = partial(GymnasiumVectorEnv, id="Coin-v0")
    chance = measure_chance(make, episodes=400, num_envs=100)
    assert chance.score == pytest.approx(0.5, abs=0.08)
    assert measure_chance(make, episodes=3).episodes == 3
    with pytest.raises(ValueError, match="episodes must be at least 1, got 0"):
        measure_chance(make, episodes=0)
    del gym.registry["Coin-v0"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ids": IDS[:4]}, "at least five environments, or its rarest fifth is empty: got 4"),
        ({"ids": [*IDS, IDS[1]]}, "every environment once, got Goal-Two-v0 twice"),
        ({"ids": "Goal-v1"}, r"zipfian\('Goal-v1'\) needs over={option: values} with one option"),
        ({"ids": "Goal-v1", "over": {"goal": [1], "tries": [2]}}, "with one option of the env"),
        ({"ids": IDS, "over": {"goal": range(9)}}, "needs a single id, got 5"),
        ({"ids": IDS, "exponent": -1}, "finite and >= 0, got -1"),
        ({"ids": IDS, "exponent": None}, "finite and >= 0, got None"),
        ({"ids": IDS, "exponent": "1"}, "finite and >= 0, got '1'"),
        *(
            ({"ids": IDS, "order": one}, f"order must be 'forward', 'reversed' or.*got {one!r}")
            for one in ("bogus", -1, True, 2.5, None)
        ),
        *(
            (
                {"ids": IDS, "name": one},
                f"name must be a string, not empty, without '/'; got {one!r}",
            )
            for one in ("a/b", "", 3)
        ),
        ({"ids": 3}, "ids must be a list, from the most frequent on, got 3"),
        ({"ids": set(IDS)}, "ids must be a list"),
        ({"ids": [*IDS, 3]}, "ids must be Gymnasium ids, which are strings, got"),
        ({"ids": "Goal-v1", "over": [1]}, r"with one option of the environment, got over=\[1\]"),
        ({"ids": "Goal-v1", "over": {"goal": 3}}, "the values of 'goal' must be a list.*got 3"),
        ({"ids": "Goal-v1", "over": {"goal": "abcde"}}, "'goal' must be a list.*got 'abcde'"),
        ({"ids": "Goal-v1", "over": {3: range(5)}}, "a rank cannot be called 3: expected a string"),
        *(
            ({"ids": "Goal-v1", "over": {one: range(1, 7)}}, f"called '{one}'.*reserved names")
            for one in ("length", "return", "_tries")
        ),
        (
            {"ids": "Goal-v1", "over": {"zipf": range(5)}},
            "environments cannot be called zipf_0, .*, zipf_4, as levels of distributions are",
        ),
        ({"ids": [*IDS, "uniform"]}, "environments cannot be called uniform, as"),
        ({"ids": IDS, "options": 3}, "options must be a mapping, got 3"),
        ({"ids": IDS, "chance": 3}, "chance must be a mapping, got 3"),
        ({"ids": IDS, "chance": {"unifrom": 0.1}}, "unknown level 'unifrom'"),
        ({"ids": IDS, "chance": {3: 0.1}}, "a level must be a name such as 'zipf_2', got 3"),
        ({"ids": IDS, "chance": {"zipf_1.0": 0.1}}, "'zipf_1.0': expected its usual name 'zipf_1'"),
        ({"ids": IDS, "chance": {"rare": 0.1}}, "chance of 'rare' must be a BaselineScore, got 0"),
        ({"ids": IDS, "code": {}}, r"unknown arguments \['code'\]: expected some of wrap, codes,"),
        ({"ids": ["A-v0", "B-v0", "C-v0", "D-v0", "E-v0"]}, "nothing in common.*: give name="),
    ],
)
def test_what_is_no_family_is_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        zipf.envs.zipfian(**arguments)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"id": "no id"}, "Gymnasium does not take the id 'no id': Malformed"),
        ({"id": 3}, "Gymnasium does not take the id 3"),
        ({"id": "zipf/Gridworld-v0"}, "has an environment 'zipf/Gridworld-v0' already"),
        ({"splits": over().splits * 2}, "there is a split 'goal' already"),
        ({"splits": over().splits[0]}, "splits of a family must be a tuple of Split, got Split"),
        ({"levels": "zipf_2"}, "levels of a family must be a tuple of str, got 'zipf_2'"),
        (
            {"make_vec": "goals.make"},
            "make_vec of a family must be .* 'module:attribute', got 'goa",
        ),
        ({"baselines": {"chance": "a"}}, "chance of a family must be an object or 'module:attrib"),
    ],
)
def test_a_family_is_registered_as_a_whole(wrong: Any, message: str) -> None:
    made = replace(over(name="whole"), **{"id": "Whole-v0", **wrong})
    gridworld = gym.spec("zipf/Gridworld-v0")
    with pytest.raises(ValueError, match=message):
        zipf.envs.register(made)
    assert "whole" not in zipf.envs.families()
    assert "Whole-v0" not in gym.registry
    assert gym.spec("zipf/Gridworld-v0") is gridworld


def test_unknown_levels_and_environments_are_named() -> None:
    made = over(name="goals")
    with pytest.raises(ValueError, match=r"unknown level 'uniforn' .*or one of goal_0, goal_1"):
        made.make_batch("uniforn", 2)
    broken = zipf.envs.zipfian([*IDS[:4], "Goal-Six-v0"])
    with pytest.raises(ValueError, match="environment 'Goal-Six-v0' cannot be made: NameNotFound"):
        broken.make_batch("zipf_1", 2)


@pytest.mark.parametrize(
    ("ids", "name"),
    [
        (["MiniGrid-DoorKey-5x5-v0", "MiniGrid-Empty-5x5-v0"], "minigrid"),
        (["minigrid:MiniGrid-DoorKey-5x5-v0", "MiniGrid-DoorKey-6x6-v0"], "minigrid_doorkey"),
        (["Foo-Apple-v0", "Foo-Apricot-v0"], "foo"),
        (["ALE/Pong-v5"], "ale_pong"),
    ],
)
def test_a_family_is_named_after_what_its_ids_have_in_common(ids: list[str], name: str) -> None:
    assert zipf.envs.gymnasium.zipfian._common_name(ids) == name


def paid(episode_return: float, terminated: bool, info: dict[str, Any]) -> bool:
    return episode_return > 0


def test_minigrid() -> None:
    pytest.importorskip("minigrid")
    names = ("Empty-5x5", "DoorKey-5x5", "Fetch-5x5-N2", "GoToDoor-5x5", "LavaGapS5")
    ids = [f"MiniGrid-{name}-v0" for name in names]
    made = zipf.envs.zipfian(ids, codes={"image": 11}, success=paid)
    env = made.make_batch("zipf_1", 4)
    assert made.name == "minigrid"
    assert env.reports_success
    assert list(env.single_observation_space) == ["direction", "image", "mission"]
    codes = spaces.MultiDiscrete(np.full((7, 7, 3), 11), np.uint8)
    assert env.single_observation_space["image"] == codes
    observation, info = env.reset(seed=0, options={"level": [0, 1, 2, 3]})
    assert info["level_name"].tolist() == ids[:4]
    words = (observation["mission"] > 0).sum(1).tolist()
    assert words[:2] == [6, 13]  # "get to the green goal square"
    rng = np.random.default_rng(0)
    for _ in range(30):
        env.step(rng.integers(7, size=4))
    other = made.make_batch("zipf_1", 4)
    assert not other.set_state(env.get_state()).any()
    for _ in range(100):
        actions = rng.integers(7, size=4)
        np.testing.assert_equal(other.step(actions)[:4], env.step(actions)[:4])
    make, make_one = partial(made.make_batch, "uniform"), partial(made.make_single, "uniform")
    check_vector_env(make, make_one, num_envs=2, steps=400)


def test_cartpole() -> None:
    made = zipf.envs.zipfian("CartPole-v1", over={"max_episode_steps": range(5, 31, 5)})
    assert made.name == "cartpole"
    env = made.make_batch("uniform", 200, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert not env.reports_success
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(2, size=(31, 200))
    longest = np.zeros(6, np.int64)
    for t in range(31):
        _, _, terminated, truncated, info = env.step(actions[t])
        if truncated.any():
            limit = info["length"][truncated]
            np.testing.assert_array_equal(limit, 5 * (info["max_episode_steps"][truncated] + 1))
            np.maximum.at(longest, info["max_episode_steps"][truncated], limit)
        assert not (terminated & truncated).any()
    assert (longest[:3] == [5, 10, 15]).all()
