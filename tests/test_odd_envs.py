"""Odd environments, drawn at random: each is played, trained on and resumed as it is, or refused in
one line that names it."""

import copy
import textwrap
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from conftest import assert_equal, learned, untimed
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import zipf.envs
from zipf.envs import family
from zipf.errors import UserError
from zipf.evaluate import score
from zipf.experiments.building import feasibility, loading
from zipf.experiments.options import config_files
from zipf.experiments.training import runner

EXPERIMENT = """
    choose: {environment: odd, network: compact, memory: mlp}
    updates: 2
    memory: {mlp: {size: 4}}
    network:
      compact: {size: 4, channels: 2, code_size: 4, code_channels: 2, vector_layers: [4]}
    agent:
      impala: {learning_rate: 1e-3, max_gradient_norm: 1.0, adam_beta1: 0.9, adam_epsilon: 1e-8}
    collector: {num_envs: 2, unroll_length: 3}
    evaluation: {every: 100, episodes: 1, num_envs: 1}
    schedule: {window: [1, 2], log_every: 1, checkpoint_every: 100}
"""


@dataclass(frozen=True)
class Spec:
    """An environment.

    Attributes:
        space, actions: its spaces.
        length: of its episodes; None: they never end.
        limit: the time limit that it is registered with.
        odd: what is odd about it, by the place: a key of `ODD`.
        when: the step from which on it is.
        sound: whether seed and actions determine an episode.
    """

    space: spaces.Space
    actions: spaces.Space
    length: int | None
    limit: int | None
    odd: dict[str, str] = field(default_factory=dict)
    when: int = 1
    sound: bool = True


ODD: dict[str, dict[str, Any]] = {
    "reward": {
        "int": lambda reward: int(reward * 10),
        "float32": np.float32,
        "bool": lambda reward: reward > 0.5,
        "numpy bool": lambda reward: np.bool_(reward > 0.5),
        "array []": np.array,
        "array [1]": lambda reward: np.array([reward]),
        "array [2]": lambda reward: np.array([reward, 1]),
        "list": lambda reward: [reward],
        "none": lambda reward: None,
        "text": str,
        "complex": complex,
        "nan": lambda reward: np.nan,
        "inf": lambda reward: -np.inf,
        "huge": lambda reward: 10**400,
    },
    "ends": {
        "numpy": np.bool_,
        "int": int,
        "float": float,
        "none": lambda end: end or None,
        "array [1]": lambda end: np.array([end]),
        "array [2]": lambda end: np.array([end, end]),
        "dict": lambda end: {"agent": end},
    },
    "info": {
        "none": lambda info: None,
        "list": lambda info: [],
        "success": lambda info: {"success": True},
        "success array": lambda info: {"is_success": np.array([True, False])},
        "success float": lambda info: {"is_success": 1.0},
        "success none": lambda info: {"success": None},
        "numbers": lambda info: {3: 4},
    },
    "step": {
        "old": lambda returned: (*returned[:2], returned[2] or returned[3], returned[4]),
        "list": list,
        "long": lambda returned: (*returned, 0),
        "none": lambda returned: None,
        "observation": lambda returned: returned[0],
        "raises": lambda returned: returned[9],
        "raises nothing": lambda returned: (_ for _ in ()).throw(AssertionError),
    },
    "reset": {
        "no info": lambda returned: returned[0],
        "none": lambda returned: (returned[0], None),
        "list": list,
        "raises": lambda returned: returned["seed"],
    },
    "signature": {"no seed": None, "no options": None, "positional": None},
    "observation": {
        "none": lambda seen: None,
        "nan": lambda seen: _changed(seen, np.nan),
        "inf": lambda seen: _changed(seen, np.inf),
        "large": lambda seen: _changed(seen, 2.0**70),
        "negative": lambda seen: _changed(seen, -(2**62)),
        "shape": lambda seen: _deep(seen, lambda one: [one, one]),
        "object": lambda seen: _deep(seen, lambda one: np.array(one, object)),
        "text": lambda seen: _deep(seen, lambda one: "a b c d"),
        "list": lambda seen: _deep(seen, lambda one: getattr(one, "tolist", lambda: one)()),
        "less": lambda seen: {} if isinstance(seen, dict) else (),
        "more": lambda seen: {**seen, "more": 1} if isinstance(seen, dict) else seen,
    },
}


def _deep(seen: Any, change: Any) -> Any:
    """Changes every part of an observation."""
    if isinstance(seen, dict):
        return {key: _deep(one, change) for key, one in seen.items()}
    if isinstance(seen, tuple):
        return tuple(_deep(one, change) for one in seen)
    return change(seen)


def _changed(seen: Any, value: float) -> Any:
    return _deep(seen, lambda one: np.full(np.shape(one), value))


def _sample(space: spaces.Space) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _sample(one) for key, one in space.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(map(_sample, space))
    if space.dtype == np.longdouble:  # of which NumPy draws none
        return np.ones(space.shape or (), np.longdouble)
    return space.sample()


EPISODES: list[dict[str, Any]] = []
"""What every environment has played, in the order in which episodes began."""


class Odd(gym.Env[Any, Any]):
    def __init__(self, spec: Spec, kind: Any = 0) -> None:
        self.kind, self.odd = kind, spec.odd
        self.spec_of = spec
        self.observation_space = copy.deepcopy(spec.space)
        self.action_space = copy.deepcopy(spec.actions)

    def _begin(self, seed: int | None) -> Any:
        self.random = np.random.default_rng(seed if self.spec_of.sound else None)
        self.observation_space.seed(int(self.random.integers(2**31)))
        self.steps = 0
        self.episode = {"kind": self.kind, "seed": seed, "return": 0.0, "length": 0, "done": False}
        EPISODES.append(self.episode)
        return self._otherwise("reset", (self._seen(), {}))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return self._begin(seed)

    def _seen(self) -> Any:
        return self._otherwise("observation", _sample(self.observation_space))

    def _otherwise(self, place: str, value: Any) -> Any:
        odd = self.odd.get(place)
        late = self.steps >= self.spec_of.when
        return ODD[place][odd](value) if odd and (late or place == "reset") else value

    def step(self, action: Any) -> Any:
        self.steps += 1
        reward = float(self.random.random()) + float(action) * (float(action) < 5)
        end = self.steps == self.spec_of.length
        reward = self._otherwise("reward", reward)
        ends = self._otherwise("ends", end), self._otherwise("ends", False)
        returned = self._otherwise("step", (self._seen(), reward, *ends, {}))
        if isinstance(returned, tuple) and len(returned) == 5:
            returned = *returned[:4], self._otherwise("info", {})
        self.episode["length"] += 1
        self.episode["done"] = end or self.steps == self.spec_of.limit
        if np.size(reward) == 1 and np.asarray(reward).dtype.kind in "bif":
            self.episode["return"] += float(np.asarray(reward).item())
        return returned


class NoSeed(Odd):
    def reset(self) -> Any:  # type: ignore[override]
        return self._begin(None)


class NoOptions(Odd):
    def reset(self, seed: int | None = None) -> Any:  # type: ignore[override]
        return self._begin(seed)


class Positional(Odd):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:  # type: ignore[override]
        return self._begin(seed)


SIGNATURES = {"no seed": NoSeed, "no options": NoOptions, "positional": Positional}

SHAPES = [(), (1,), (3,), (2, 3), (8, 9), (3, 8, 9), (8, 9, 4), (8, 9, 8), (2, 8, 8, 3)]
FLOATS = [np.float16, np.float32, np.float64, np.longdouble]
INTEGERS = [np.uint8, np.int8, np.int16, np.int32, np.int64, np.uint16, np.uint32, np.uint64]


@st.composite
def boxes(draw: Any) -> spaces.Box:
    shape = (0,) if draw(st.integers(0, 30)) == 30 else draw(st.sampled_from(SHAPES))
    dtype = draw(st.sampled_from([*FLOATS, *INTEGERS, *INTEGERS[:1] * 6, np.bool_]))
    if dtype is np.bool_:
        return spaces.Box(0, 1, shape, dtype)
    low, high = draw(st.sampled_from([(0, 1), (0, 9), (0, 100), (1, 5), (None, None)]))
    if low is None:
        limits = (
            (-np.inf, np.inf) if dtype in FLOATS else (np.iinfo(dtype).min, np.iinfo(dtype).max)
        )
        low, high = limits
    return spaces.Box(low, high, shape, dtype)


KEYS = ["a", "b.c", "a b", "keys", "image", "instruction", "return", "a_b", "0"]
REFUSED = [
    spaces.Sequence(spaces.Discrete(2)),
    spaces.Graph(spaces.Discrete(2), None),
    spaces.OneOf([spaces.Discrete(2), spaces.Discrete(3)]),
    spaces.Discrete(10**13),
    spaces.Dict(),
    spaces.Dict({"": spaces.Discrete(2)}),
    spaces.Dict({"x\ny": spaces.Discrete(2)}),
]
LEAVES = st.one_of(
    *[boxes()] * 4,
    st.builds(spaces.Discrete, st.integers(1, 9), start=st.integers(-3, 300)),
    st.builds(spaces.MultiDiscrete, st.lists(st.integers(1, 4), min_size=1, max_size=3)),
    st.builds(
        lambda n, start: spaces.MultiDiscrete([[n, n + 1]], start=[[start, 0]]),
        st.integers(1, 9),
        st.integers(-5, 5),
    ),
    st.builds(spaces.MultiBinary, st.sampled_from([1, 4, (2, 3), (8, 8)])),
    st.builds(spaces.Text, st.sampled_from([1, 8, 60]), charset=st.sampled_from(["ab", "a b,"])),
)
SPACES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.dictionaries(st.sampled_from(KEYS), inner, min_size=1, max_size=3).map(spaces.Dict),
        st.lists(inner, min_size=1, max_size=2).map(lambda parts: spaces.Tuple(tuple(parts))),
    ),
    max_leaves=4,
)
ACTIONS = st.one_of(
    st.builds(spaces.Discrete, st.integers(1, 5), start=st.integers(-2, 7)),
    st.builds(spaces.Discrete, st.integers(1, 5)),
    st.sampled_from([spaces.Box(-1, 1, (2,)), spaces.MultiDiscrete([2, 3]), spaces.MultiBinary(2)]),
)


@st.composite
def specs(draw: Any) -> Spec:
    places = draw(st.lists(st.sampled_from([*ODD]), max_size=draw(st.integers(0, 2)), unique=True))
    return Spec(
        space=draw(st.sampled_from(REFUSED) if draw(st.integers(0, 15)) == 15 else SPACES),
        actions=draw(ACTIONS if draw(st.integers(0, 5)) == 0 else st.just(spaces.Discrete(3))),
        length=draw(st.sampled_from([2, 3, 4, 5, 5, 6, None])),
        limit=draw(st.sampled_from([None, 4])),
        odd={place: draw(st.sampled_from([*ODD[place]])) for place in places},
        when=draw(st.integers(0, 3)),
        sound=draw(st.integers(0, 9)) > 0,
    )


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    (folder / "experiments").mkdir()
    (folder / "experiments" / "odd.yaml").write_text(textwrap.dedent(EXPERIMENT))
    return folder


@pytest.fixture(autouse=True)
def _own(monkeypatch: pytest.MonkeyPatch, configs: Path) -> Iterator[None]:
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    monkeypatch.setattr(feasibility, "_tried", {})
    monkeypatch.setattr(config_files, "_user_folder", None)
    config_files.use_folder(configs)
    yield
    gym.registry.pop("Odd-v0", None)


def register(spec: Spec) -> None:
    made = SIGNATURES.get(spec.odd.get("signature", ""), Odd)
    gym.registry.pop("Odd-v0", None)
    gym.register("Odd-v0", made, max_episode_steps=spec.limit)
    family._FAMILIES.pop("odd", None)
    feasibility._tried.clear()
    options = {"spec": replace(spec, odd={k: v for k, v in spec.odd.items() if k != "signature"})}
    zipf.envs.register(
        zipf.envs.zipfian(
            "Odd-v0", over={"kind": range(5)}, name="odd", options=options, longest_episode=30
        )
    )


class InTurn:
    """Takes the actions in turn, from the first in every episode."""

    def for_envs(self, observations: spaces.Dict, actions: spaces.Discrete, seed: int) -> "InTurn":
        self.spaces, self.count = observations, int(actions.n)
        return self

    def start(self, num_envs: int) -> None:
        self.steps = np.zeros(num_envs, np.int64)

    def __call__(self, observation: Any, reward: Any, is_first: NDArray[np.bool_]) -> Any:
        for name, space in self.spaces.items():
            seen = observation[name][0]
            assert seen.dtype == space.dtype
            assert seen.shape == (space.shape or ())
        self.steps[is_first] = 0
        self.steps += 1
        return (self.steps - 1) % self.count


def alone(spec: Spec, episode: dict[str, Any], episodes: int) -> tuple[float, int]:
    """Return and length of an episode in a plain loop."""
    env = gym.make("Odd-v0", disable_env_checker=True, spec=spec, kind=episode["kind"])
    assert isinstance(env.action_space, spaces.Discrete)
    env.reset(seed=episode["seed"])
    total, length, ended = 0.0, 0, False
    while not ended:
        action = env.action_space.start + length % env.action_space.n
        _, reward, terminated, truncated, _ = env.step(action)
        total, length, ended = (
            total + float(np.asarray(reward).item()),
            length + 1,
            bool(terminated),
        )
        ended = ended or bool(truncated)
    return total, length


def scored_as_alone(spec: Spec) -> None:
    EPISODES.clear()
    evaluation = score(InTurn(), "odd", episodes=3, num_envs=1, details=True)
    played = [one for one in EPISODES if one["done"]]
    rows = evaluation.episodes
    assert len(played) == len(rows)
    for episode, (_, row) in zip(played, rows.iterrows(), strict=True):
        assert (episode["kind"], episode["length"]) == (row["kind"], row["length"])
        assert episode["return"] == pytest.approx(row["return"], rel=1e-6)
        if spec.sound:
            total, length = alone(spec, episode, len(rows))
            assert (pytest.approx(total, rel=1e-9), length) == (row["return"], row["length"])


def trained_and_resumed(spec: Spec, folder: Path) -> None:
    def config(name: str, updates: int) -> Any:
        overrides = ["experiment=odd", "device=cpu", f"run_root={folder / name}"]
        return loading.load([*overrides, f"updates={updates}"])

    whole, cut = config("whole", 2), config("cut", 2)
    assert runner.train(whole) == 0
    for updates in (1, 2):
        assert runner.train(config("cut", updates)) == 0
    if spec.sound:
        assert_equal(learned(whole.folder), learned(cut.folder))
        for table in ("metrics.csv", "evaluations.csv"):
            one, other = (untimed(run.folder / table) for run in (whole, cut))
            pd.testing.assert_frame_equal(one, other)


def ordinary(spec: Spec) -> bool:
    """Whether it must not be refused."""

    def known(space: spaces.Space) -> bool:
        if isinstance(space, spaces.Dict):
            named = all(key not in ("", "x\ny") for key in space)
            return named and bool(len(space)) and all(map(known, space.values()))
        if isinstance(space, spaces.Tuple):
            return all(map(known, space))
        if isinstance(space, spaces.Box):
            large = space.dtype == np.uint64 and space.high.max() > 100 if space.low.size else 0
            bytes_ = space.dtype in (np.uint8, np.bool_)
            unclear = bytes_ and space.shape in ((8, 9, 8), (2, 8, 8, 3))
            return bool(space.low.size) and not unclear and not large
        return isinstance(
            space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary
        ) and not (isinstance(space, spaces.Discrete) and space.n > 1000)

    return (
        not spec.odd
        and isinstance(spec.actions, spaces.Discrete)
        and (spec.length is not None or spec.limit is not None)
        and known(spec.space)
    )


def check(spec: Spec, folder: Path) -> None:
    for what in (scored_as_alone, lambda spec: trained_and_resumed(spec, folder)):
        try:
            register(spec)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                what(spec)
        except (UserError, ValueError) as error:
            text = str(error)
            assert "Odd-v0" in text, text
            assert len(text.splitlines()) == 1, text
            assert not ordinary(spec), text


@settings(max_examples=25, deadline=None, derandomize=True)
@given(spec=specs())
def test_odd_environments(spec: Spec, tmp_path_factory: pytest.TempPathFactory) -> None:
    check(spec, tmp_path_factory.mktemp("run"))
