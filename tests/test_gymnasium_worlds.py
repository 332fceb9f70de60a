"""Existing Gymnasium environments keep the contract of batched envs."""

import copy
import pickle
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from zipf.envs import GymnasiumVectorEnv, Mixture, SingleEnv
from zipf.envs.gymnasium import replayed, vector
from zipf.envs.testing import check_vector_env

EVERYTHING = spaces.Dict(
    image=spaces.Box(0, 255, (4, 5, 3), np.uint8),
    kinds=spaces.Box(0, 249, (2, 3), np.uint8),
    kind=spaces.Box(0, 255, (), np.int64),
    arm=spaces.Dict(angle=spaces.Box(-1, 1, (2,), np.float32), on=spaces.MultiBinary(3)),
    pair=spaces.Tuple((spaces.Discrete(4, start=-1), spaces.MultiDiscrete([3, 5], start=[1, 2]))),
    words=spaces.Text(30, charset="abcde, "),
)


class Everything(gym.Env[Any, Any]):
    """Shows samples of a space. Action 4 wins if the episode is an odd one, action 5 loses.

    Args:
        space: what it shows.
        outcome: the name in the last info that says whether the episode was won.
        always: whether this name is in every step's info.
        sound: False: draws from a generator that no seed resets.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012

    def __init__(
        self,
        space: spaces.Space = EVERYTHING,
        actions: spaces.Space | None = None,
        outcome: str = "is_success",
        always: bool = True,
        sound: bool = True,
        render_mode: str | None = None,
    ) -> None:
        self.observation_space = copy.deepcopy(space)  # a space has a generator
        self.action_space = spaces.Discrete(3, start=3) if actions is None else actions
        self.outcome, self.always, self.sound = outcome, always, sound
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        assert seed is not None
        if self.sound:
            self.observation_space.seed(seed)
        self.odd = bool(self.np_random.integers(2))
        self.seed = seed
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        assert action in self.action_space
        won = self.odd and action == 4
        info = {self.outcome: won} if self.always or won or action == 5 else {}
        reward = float(won) - 0.5
        return self.observation_space.sample(), reward, won or action == 5, False, info

    def render(self) -> Any:
        return np.full((6, 7, 3), self.seed % 256, np.uint8)


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    gym.register("Everything-v0", Everything, max_episode_steps=20)
    yield
    del gym.registry["Everything-v0"]
    replayed._NOT_DETERMINISTIC.clear()


CODES = {"kinds": 250, "kind": 256}


def everything(num_envs: int = 3, **options: Any) -> GymnasiumVectorEnv:
    options = {"codes": CODES, "text_length": 30, **options}
    return GymnasiumVectorEnv(num_envs, "Everything-v0", **options)


def single(make: Callable[..., Any]) -> Callable[[], SingleEnv]:
    return partial(SingleEnv, lambda n, **options: make(n, **options))


def test_every_kind_of_observation_keeps_the_contract() -> None:
    check_vector_env(everything, single(everything), num_envs=3, steps=80)


@pytest.mark.parametrize("id", ["CartPole-v1", "Blackjack-v1", "FrozenLake-v1"])
def test_gymnasiums_own_environments_keep_the_contract(id: str) -> None:
    make = partial(GymnasiumVectorEnv, id=id)
    check_vector_env(make, single(make), num_envs=3, steps=120)


def test_observations_become_flat_dicts() -> None:
    env = everything()
    assert dict(env.single_observation_space.items()) == {
        "image": EVERYTHING["image"],
        "kinds": spaces.MultiDiscrete(np.full((2, 3), 250), dtype=np.uint8),
        "kind": spaces.Discrete(256),
        "arm.angle": EVERYTHING["arm"]["angle"],
        "arm.on": EVERYTHING["arm"]["on"],
        "pair.0": spaces.Discrete(4),
        "pair.1": spaces.MultiDiscrete([3, 5]),
        "words": spaces.Box(0, 999, (30,), np.int64),
    }
    assert env.single_action_space == spaces.Discrete(3)


@pytest.mark.parametrize(
    ("space", "names"),
    [
        (spaces.Box(-1, 1, (4,)), ["observation"]),
        (spaces.Box(0, 255, (8, 8, 3), np.uint8), ["image"]),
        (spaces.Box(0, 255, (8, 8, 1), np.uint8), ["observation"]),
        (spaces.Box(0, 1, (8, 8, 3)), ["observation"]),
        (spaces.Discrete(5, start=2), ["observation"]),
        (
            spaces.Tuple((spaces.Discrete(5), spaces.Discrete(3))),
            ["observation.0", "observation.1"],
        ),
    ],
)
def test_other_spaces_become_a_dict_of_one_part(space: Any, names: list[str]) -> None:
    env = everything(options={"space": space}, codes={})
    assert list(env.single_observation_space) == names
    assert env.reset(seed=0)[0] in env.observation_space


@pytest.mark.parametrize(
    ("space", "dtype"),
    [
        (spaces.Box(0, 65535, (4,), np.uint16), np.int32),
        (spaces.Box(0, 2**32 - 1, (4,), np.uint32), np.int64),
        (spaces.MultiDiscrete([300, 65535], dtype=np.uint16), np.int32),
    ],
)
def test_integers_that_pytorch_does_not_calculate_with_are_kept_as_others(
    space: Any, dtype: Any
) -> None:
    env = everything(options={"space": space}, codes={})
    (kept,) = env.single_observation_space.values()
    assert kept.dtype == dtype
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert observation["observation"].max() > 0


def test_values_are_those_of_the_environment() -> None:
    env = everything(1)
    observation, _ = env.reset(seed=3)
    alone = gym.make("Everything-v0").unwrapped
    expected, _ = alone.reset(seed=int(env.get_state()["seeds"][0]))
    for _ in range(10):
        shown = {key: rows[0] for key, rows in observation.items()}
        words = shown.pop("words")
        assert (words > 0).sum() == len(expected["words"].replace(",", " , ").split())
        np.testing.assert_equal(
            shown,
            {
                "image": expected["image"],
                "kinds": expected["kinds"],
                "kind": expected["kind"],
                "arm.angle": expected["arm"]["angle"],
                "arm.on": expected["arm"]["on"],
                "pair.0": expected["pair"][0] + 1,
                "pair.1": expected["pair"][1] - [1, 2],
            },
        )
        observation = env.step(np.zeros(1, np.int64))[0]
        expected = alone.step(3)[0]


def test_words_have_stable_codes() -> None:
    words = vector.Words(6, 1000)
    np.testing.assert_array_equal(words.encode("Open the door."), [70, 925, 587, 354, 0, 0])
    assert words.encode("open the, DOOR")[3] == 587
    with pytest.raises(ValueError, match="'a b c d e f g' has 7 words, more than text_length=6"):
        words.encode("a b c d e f g")


class Reported(gym.Wrapper[Any, Any, Any, Any]):
    """Calls what happened by another name."""

    def step(self, action: Any) -> Any:
        *step, info = self.env.step(action)
        return *step, {"won": info["is_success"]}


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"options": {"outcome": "success"}},
        {"options": {"always": False, "outcome": "end"}, "success": "end"},
        {"wrap": Reported, "success": "won"},
        {"success": lambda episode_return, terminated, info: terminated and info["is_success"]},
    ],
    ids=["is_success", "success", "at the end", "wrapped", "rule"],
)
def test_success_is_what_the_environment_or_a_rule_says(how: dict[str, Any]) -> None:
    """Action 1 wins half of the episodes; the others are lost by action 2."""
    env = everything(64, **how)
    assert env.reports_success
    env.reset(seed=0)
    info = env.step(np.ones(64, np.int64))[4]
    won = info["_final_info"]
    assert 16 < won.sum() < 48
    assert info["final_info"]["success"][won].all()
    info = env.step(np.full(64, 2))[4]
    assert info["_final_info"].all()
    assert not info["final_info"]["success"].any()


def test_the_rule_is_told_return_end_and_info() -> None:
    told: list[Any] = []

    def rule(episode_return: float, terminated: bool, info: dict[str, Any]) -> bool:
        told.append((episode_return, terminated, info))
        return False

    env = everything(1, success=rule, options={"max_episode_steps": 3})
    env.reset(seed=0)
    for action in (0, 0, 0, 0, 2):
        env.step(np.array([action]))
    assert told == [(-1.5, False, {"is_success": False}), (-1.0, True, {"is_success": False})]


def test_without_success_none_is_reported() -> None:
    env = everything(2, options={"always": False})
    assert not env.reports_success
    env.reset(seed=0)
    final = env.step(np.full(2, 2))[4]["final_info"]
    assert set(final) == {"return", "length"}


def test_termination_comes_before_truncation() -> None:
    env = everything(1, options={"max_episode_steps": 1})
    env.reset(seed=0)
    _, _, terminated, truncated, _ = env.step(np.full(1, 2))
    assert (terminated[0], truncated[0]) == (True, False)


def test_environments_are_made_when_needed() -> None:
    made = []

    def wrap(env: gym.Env) -> gym.Env:
        made.append(env)
        return env

    levels = {name: partial(everything, wrap=wrap) for name in ("a", "b", "c")}
    env = Mixture(levels, 20, draw="resets", exponent=1.0)
    assert len(made) == 3  # one each, for the spaces
    env.reset(seed=0, options={"level": 1})
    assert len(made) == 3 + 19
    env.reset(options={"level": 1})
    assert len(made) == 3 + 19
    env.close()


def test_a_mixture_keeps_the_contract() -> None:
    levels = {
        str(steps): partial(everything, options={"max_episode_steps": steps}) for steps in (3, 9)
    }
    make = partial(Mixture, levels, draw="resets", exponent=1.0)
    check_vector_env(make, single(make), num_envs=3, steps=60)


def test_it_equals_gymnasiums_own_vector_env() -> None:
    """With the seeds that the envs draw; Gymnasium's goes on with the environment's own."""
    env = GymnasiumVectorEnv(3, "CartPole-v1", autoreset_mode=AutoresetMode.DISABLED)
    other = SyncVectorEnv(
        [partial(gym.make, "CartPole-v1")] * 3, autoreset_mode=AutoresetMode.DISABLED
    )
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    expected, _ = other.reset(seed=env.get_state()["seeds"].tolist())
    for _ in range(100):
        np.testing.assert_array_equal(observation["observation"], expected)
        actions = rng.integers(2, size=3)
        observation, *ends, _ = env.step(actions)
        expected, *expected_ends, _ = other.step(actions)
        np.testing.assert_equal(ends, expected_ends)
        done = ends[1] | ends[2]
        if done.any():
            options = {"reset_mask": done}
            observation, _ = env.reset(options=dict(options))
            expected, _ = other.reset(seed=env.get_state()["seeds"].tolist(), options=dict(options))


def play(env: Any, steps: int, seed: int = 0) -> list[Any]:
    rng = np.random.default_rng(seed)
    n = int(env.single_action_space.n)
    return [env.step(rng.integers(n, size=env.num_envs))[:4] for _ in range(steps)]


def test_states_and_pickles_replay_the_episodes() -> None:
    env = everything(4)
    env.reset(seed=0)
    play(env, 13)
    state = env.get_state()
    assert state["actions"].dtype == np.uint8
    assert len(state["actions"]) == state["lengths"].sum()
    other = everything(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not other.set_state(state).any()
        pickled = pickle.loads(pickle.dumps(env))
    rest = play(env, 30, seed=1)
    np.testing.assert_equal(play(other, 30, seed=1), rest)
    np.testing.assert_equal(play(pickled, 30, seed=1), rest)


def test_what_is_not_deterministic_is_said_once_and_begins_again() -> None:
    env, other = (everything(4, options={"sound": False}) for _ in range(2))
    env.reset(seed=0)
    play(env, 5)
    state = env.get_state()
    state["running"][:] = True
    with pytest.warns(UserWarning, match="'Everything-v0' is not deterministic") as warned:
        restarted = other.set_state(state)
    assert len(warned) == 1
    assert restarted.all()
    assert not other.get_state()["lengths"].any()
    assert not other.get_state()["returns"].any()
    np.testing.assert_array_equal(other.get_state()["streams"], state["streams"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert other.set_state(state).all()
    play(other, 30)


def test_in_a_mixture_only_its_own_worlds_begin_again() -> None:
    levels = {
        name: partial(everything, options={"sound": sound})
        for name, sound in (("sound", True), ("unsound", False))
    }
    env, other = (Mixture(levels, 4, draw="resets", exponent=0.0) for _ in range(2))
    env.reset(seed=0, options={"level": [0, 1, 1, 0]})
    env.step(np.zeros(4, np.int64))
    with pytest.warns(UserWarning, match="not deterministic"):
        restarted = other.set_state(env.get_state())
    np.testing.assert_array_equal(restarted, [False, True, True, False])
    np.testing.assert_array_equal(other.get_state()["lengths"], [1, 0, 0, 1])
    pickled = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(pickled.get_state()["lengths"], [1, 0, 0, 1])


class Counted(gym.Wrapper[Any, Any, Any, Any]):
    resets = 0

    def reset(self, **options: Any) -> Any:
        Counted.resets += 1
        return self.env.reset(**options)


def test_an_unpickled_mixture_replays_every_world_once() -> None:
    levels = {name: partial(everything, wrap=Counted) for name in ("a", "b")}
    env = Mixture(levels, 4, draw="resets", exponent=0.0)
    env.reset(seed=0)
    pickled = pickle.dumps(env)
    Counted.resets = 0
    pickle.loads(pickled)
    assert Counted.resets == 4


def test_an_ended_episode_that_cannot_be_replayed_begins_again() -> None:
    env, other = (
        everything(2, options={"sound": False}, autoreset_mode="Disabled") for _ in range(2)
    )
    env.reset(seed=0)
    env.step(np.array([0, 2]))
    with pytest.warns(UserWarning, match="not deterministic"):
        assert other.set_state(env.get_state()).all()
    other.step(np.zeros(2, np.int64))


@pytest.mark.parametrize("key", ["seeds", "counts", "actions"])
def test_damaged_states_are_refused(key: str) -> None:
    env = everything(2)
    env.reset(seed=0)
    play(env, 3)
    state = env.get_state()
    state[key] = state[key] + 3 if key != "seeds" else -1 - state[key]
    before = env.get_state()
    with pytest.raises(ValueError, match="another environment, or damaged"):
        env.set_state(state)
    np.testing.assert_equal(env.get_state(), before)


def test_it_draws_what_the_environment_draws() -> None:
    env = everything(3, render_mode="rgb_array")
    env.reset(seed=0)
    seeds = env.get_state()["seeds"]
    for frame, seed in zip(env.render() or (), seeds, strict=True):
        assert frame.shape == (6, 7, 3)
        assert (frame == seed % 256).all()
    assert env.metadata["render_fps"] == 5
    assert everything().render() is None
    env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"id": "Nothing-v0"}, "'Nothing-v0' cannot be made: NameNotFound: "),
        ({"options": {"goal": 3}}, r"'Everything-v0' with {'goal': 3} cannot be made: TypeError: "),
        ({"options": {"actions": spaces.Box(-1, 1, (2,))}}, r"are Box.*only Discrete actions"),
        ({"codes": {"kinds": 11, "sound": 3}}, r"no observation \['sound'\] for codes, only \['im"),
        (
            {"codes": {"arm.angle": 3}},
            r"codes={'arm.angle': 3} of Everything-v0: expected.*float32",
        ),
        ({"codes": {"kinds": True}}, "codes={'kinds': True} of Everything-v0: expected a number"),
        (
            {"options": {"space": spaces.Sequence(spaces.Discrete(2))}},
            "'observation' is Seq",
        ),
        ({"render_mode": "human"}, "render_mode must be 'rgb_array' or None"),
        ({"text_length": 0}, "text_length must be at least 1"),
        ({"vocabulary": 1}, "vocabulary must be at least 2"),
    ],
)
def test_what_cannot_be_used_is_refused(options: dict[str, Any], message: str) -> None:
    if "space" in options.get("options", {}):
        options["codes"] = {}
    with pytest.raises(ValueError, match=message):
        GymnasiumVectorEnv(2, **{"id": "Everything-v0", "codes": CODES, **options})


def test_values_outside_what_was_declared_are_refused() -> None:
    with pytest.raises(ValueError, match=r"'kinds' has the value \d+, .* codes says 2: .* 0 .. 1"):
        everything(20, codes={"kinds": 2}).reset()
    env = everything(2, success="no such name")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"success='no such name', but Everything-v0 has no such"):
        env.step(np.full(2, 2))

    class Wide(gym.ObservationWrapper[Any, Any, Any]):
        def observation(self, observation: Any) -> Any:
            return {**observation, "image": observation["image"][:2]}

    with pytest.raises(ValueError, match=r"'image' has shape \(2, 5, 3\), its space \(4, 5, 3\)"):
        everything(1, wrap=Wide).reset()


def shown(space: spaces.Space, value: Any, **options: Any) -> Any:
    """What a batch shows of an environment with this space that returns this value."""

    def show(env: gym.Env) -> gym.Env:
        return gym.wrappers.TransformObservation(env, lambda _: value, space)

    env = GymnasiumVectorEnv(1, "Everything-v0", wrap=show, **options)
    env.reset(seed=0)
    return env.step(np.zeros(1, np.int64))[0]["observation"][0]


PIXELS = spaces.Box(0, 255, (2,), np.uint8)


@pytest.mark.parametrize(
    ("space", "value", "message"),
    [
        (
            PIXELS,
            [300, -1],
            r"has the value 300, out of range: its space is Box\(0, 255, \(2,\), u",
        ),
        (PIXELS, [44, -1], "has the value -1, out of range"),
        (PIXELS, [0.7, 25.5], "has the value 0.7, no whole number"),
        (PIXELS, [0.7, 300.5], "has the value 300.5, out of range"),
        (PIXELS, [3.0, np.nan], "has the value nan, out of range"),
        (PIXELS, ["a", "b"], "has the value a, no number"),
        (spaces.Box(0, 9, (2,), np.uint8), np.uint8([9, 10]), "has the value 10, out of range"),
        (spaces.Box(-5, 5, (), np.int64), -6, "has the value -6, out of range"),
        (
            spaces.Box(-(2**63), 2**63 - 1, (), np.int64),
            np.uint64(2**64 - 1),
            "has the value 18446744073709551615, out of range",
        ),
        (spaces.Discrete(4, start=-1), 3, r"has the value 3, .* Discrete\(4, start=-1\)"),
        (spaces.Discrete(4, start=-1), -2, "has the value -2, out of range"),
        (spaces.Discrete(4), 1.5, "has the value 1.5, no whole number"),
        (spaces.MultiDiscrete([3, 5], start=[1, 2]), [3, 7], "has the value 7, out of range"),
        (spaces.MultiBinary(2), [1, 2], "has the value 2, out of range"),
        (spaces.Box(-1, 1, (1,), np.float32), [None], "has the value None, no number"),
        (spaces.Text(5), 3, "'observation' is 3, which is no text"),
    ],
)
def test_observations_that_are_not_in_their_space_are_refused(
    space: Any, value: Any, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        shown(space, value)


def test_codes_are_whole_numbers() -> None:
    with pytest.raises(ValueError, match=r"value 0.5, no whole number: codes says 3: .* 0 .. 2"):
        shown(PIXELS, [1, 0.5], codes={"observation": 3})
    assert shown(PIXELS, [1, 2.0], codes={"observation": 3}).tolist() == [1, 2]


@pytest.mark.parametrize(
    ("space", "value"),
    [
        (PIXELS, [0, 255]),
        (PIXELS, np.array([0.0, 255.0])),
        (spaces.Discrete(4), np.float64(3)),
        (spaces.Discrete(2), True),
        (spaces.MultiBinary(2), np.array([True, False])),
        (spaces.Box(-1, 1, (2,), np.float32), np.array([0.1, 1.2])),
        (spaces.Box(-1, 1, (2,), np.float32), [0, 1]),
        (spaces.Box(-1, 1, (), np.float64), 0.1),
    ],
)
def test_observations_of_other_dtypes_are_kept_where_they_fit(space: Any, value: Any) -> None:
    given = shown(space, value)
    assert given.dtype == space.dtype
    np.testing.assert_array_equal(given, np.asarray(value).astype(space.dtype))
