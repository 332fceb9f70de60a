"""Environments of others that are not as they should be: read as they are, or refused in a line."""

import copy
import re
import textwrap
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import call
from gymnasium import spaces
from networks import compact

import zipf.envs
from zipf.agents.encoders import Encoder, is_image
from zipf.envs import GymnasiumVectorEnv, Mixture, family, floors
from zipf.evaluate import score
from zipf.experiments.building import feasibility
from zipf.experiments.options import config_files

EXPERIMENT = """
    choose: {environment: faulty, network: shallow, memory: mlp}
    updates: 2
    memory: {mlp: {size: 8}}
    network: {shallow: {size: 8, code_size: 8, vector_layers: [8]}}
    agent:
      impala: {learning_rate: 1e-3, max_gradient_norm: 1.0, adam_beta1: 0.9, adam_epsilon: 1e-8}
    collector: {num_envs: 3, unroll_length: 4}
    evaluation: {every: 2, episodes: 4, num_envs: 2}
    schedule: {window: [1, 2], log_every: 1, checkpoint_every: 1}
"""


class Faulty(gym.Env[Any, Any]):
    """Episodes of five steps.

    Args:
        space: of the observations.
        kind: of which of several environments this is.
        change: gets what `step` returns and the number of the step, and returns it otherwise.
        start: the same for `reset`.
    """

    def __init__(
        self,
        space: spaces.Space | None = None,
        kind: Any = 0,
        change: Any = lambda returned, step: returned,
        start: Any = lambda returned: returned,
    ) -> None:
        space = spaces.Box(-1, 1, (2,)) if space is None else space
        self.observation_space = copy.deepcopy(space)  # a space has a generator
        self.action_space = spaces.Discrete(3)
        self.change, self.start = change, start

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        self.steps = 0
        return self.start((self.observation_space.sample(), {}))

    def step(self, action: Any) -> Any:
        self.steps += 1
        seen = self.observation_space.sample()
        return self.change((seen, float(action == 1), self.steps >= 5, False, {}), self.steps)


class Endless(Faulty):
    def step(self, action: Any) -> Any:
        return self.observation_space.sample(), 0.0, False, False, {}


class Seedless(Faulty):
    def reset(self) -> Any:  # type: ignore[override]
        return self.observation_space.sample(), {}


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    monkeypatch.setattr(feasibility, "_tried", {})
    monkeypatch.setattr(config_files, "_user_folder", None)
    gym.register("Faulty-v0", Faulty, max_episode_steps=20)
    gym.register("Endless-v0", Endless)
    gym.register("Seedless-v0", Seedless, max_episode_steps=20)
    yield
    for id in ("Faulty-v0", "Endless-v0", "Seedless-v0"):
        del gym.registry[id]


def faulty(id: str = "Faulty-v0", over: Any = range(5), **options: Any) -> zipf.envs.Family:
    """A registered family of five of these environments."""
    made = {name: options.pop(name) for name in ("space", "change", "start") if name in options}
    return zipf.envs.register(
        zipf.envs.zipfian(id, over={"kind": over}, name="faulty", options=made, **options)
    )


def scored(**options: Any) -> dict[str, float]:
    return score(
        lambda seen: np.zeros(len(next(iter(seen.values()))), np.int64),
        "faulty",
        **{"episodes": 4, **options},
    )


def train(folder: Path, *overrides: str) -> Any:
    """The command of training, in this process."""
    configs = folder / "configs" / "experiments"
    configs.mkdir(parents=True, exist_ok=True)
    (configs / "faulty.yaml").write_text(textwrap.dedent(EXPERIMENT))
    arguments = "--config-dir", "configs", "experiment=faulty", "device=cpu", *overrides
    return call(*arguments, folder=folder)


def one_line(ended: Any, *parts: str) -> None:
    """A command ended with one line of error that has these parts."""
    assert ended.returncode == 2, ended.stdout
    lines = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    for part in parts:
        assert part in lines[0]


@pytest.mark.parametrize(
    ("space", "shape"),
    [
        (spaces.Box(0, 255, (4, 84, 84), np.uint8), (84, 84, 4)),
        (spaces.Box(0, 255, (84, 84, 4), np.uint8), (84, 84, 4)),
        (spaces.Box(0, 255, (84, 84), np.uint8), (84, 84, 1)),
        (spaces.Box(0, 255, (3, 30, 40), np.uint8), (30, 40, 3)),
        (spaces.Box(0, 255, (40, 30, 16), np.uint8), (40, 30, 16)),
        (spaces.Box(0, 1, (10, 10, 4), np.bool_), (10, 10, 4)),
        (spaces.Box(0, 1, (7, 12), np.bool_), (7, 12, 1)),
        (spaces.Box(0, 1, (5, 10, 10), np.uint8), (10, 10, 5)),
    ],
)
def test_images_have_their_channels_last(space: Any, shape: tuple[int, ...]) -> None:
    env = GymnasiumVectorEnv(2, "Faulty-v0", options={"space": space})
    (seen,) = env.single_observation_space.values()
    assert seen == spaces.Box(0, 255, shape, np.uint8)
    assert is_image(seen)
    (observation,) = env.reset(seed=0)[0].values()
    alone = gym.make("Faulty-v0", space=space)
    given = alone.reset(seed=int(env.get_state()["seeds"][0]))[0]
    if space.shape[0] < 7:
        given = np.moveaxis(given, 0, -1)
    white = 1 if space.high.max() == 255 else 255
    np.testing.assert_array_equal(observation[0], given.reshape(shape).astype(np.uint8) * white)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (spaces.Box(0, 255, (84, 3, 84), np.uint8), "'HCW'"),
        (spaces.Box(0, 255, (9, 9, 9), np.uint8), "'HWC'"),
        (spaces.Box(0, 255, (20, 84, 84), np.uint8), "'CHW'"),
        (spaces.Box(0, 1, (8, 8, 20), np.bool_), "'CHW'|'CWH'|'HCW'|'HWC'"),
        (spaces.Box(0, 255, (4, 84, 84, 3), np.uint8), "'CHWC'"),
    ],
)
def test_what_may_be_an_image_is_refused_until_an_option_decides(space: Any, message: str) -> None:
    make = partial(GymnasiumVectorEnv, 2, "Faulty-v0", options={"space": space})
    with pytest.raises(ValueError, match=r"Faulty-v0 .*: observation 'observation' is") as refused:
        make()
    found = re.search(r"image_axes={'observation': ('\w+')}", str(refused.value))
    assert found
    assert re.fullmatch(message, found[1])
    env = make(image_axes={"observation": found[1].strip("'")})
    assert is_image(env.single_observation_space["observation"])
    assert env.reset(seed=0)[0] in env.observation_space
    flat = make(image_axes={"observation": None}).single_observation_space["observation"]
    assert flat.shape == (np.prod(space.shape),)


def test_a_stack_of_colour_images_has_their_channels_one_after_another() -> None:
    space = spaces.Box(0, 255, (2, 8, 9, 3), np.uint8)
    options = {"space": space}
    env = GymnasiumVectorEnv(1, "Faulty-v0", options=options, image_axes={"observation": "CHWC"})
    seen = env.reset(seed=0)[0]["observation"][0]
    given = gym.make("Faulty-v0", **options).reset(seed=int(env.get_state()["seeds"][0]))[0]
    np.testing.assert_array_equal(seen, np.concatenate(list(given), -1))


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"observation": "HWX"}, "expected None or a letter for each axis of .4, 84, 84."),
        ({"observation": "HW"}, "expected None or a letter"),
        ({"observation": "HHW"}, "expected None or a letter"),
        ({"pixels": "HWC"}, r"has no observation \['pixels'\] for image_axes"),
        (3, "image_axes must be a mapping"),
    ],
)
def test_wrong_axes_are_refused(axes: Any, message: str) -> None:
    options = {"space": spaces.Box(0, 255, (4, 84, 84), np.uint8)}
    with pytest.raises(ValueError, match=message):
        GymnasiumVectorEnv(1, "Faulty-v0", options=options, image_axes=axes)
    floats = {"space": spaces.Box(0, 1, (4, 84, 84))}
    with pytest.raises(ValueError, match="images are uint8 or bool, and this is Box"):
        GymnasiumVectorEnv(1, "Faulty-v0", options=floats, image_axes={"observation": "CHW"})


def test_training_names_the_encoder_of_each_part(tmp_path: Path) -> None:
    faulty(
        space=spaces.Dict(
            screen=spaces.Box(0, 255, (4, 84, 84), np.uint8),
            arm=spaces.Dict(angle=spaces.Box(-1, 1, (2,))),
            tool=spaces.Discrete(3),
        )
    )
    ended = train(tmp_path)
    assert ended.returncode == 0, ended.stderr
    line = (
        "observations: screen uint8 [84, 84, 4] by network=shallow; tool int64 [] by embeddings of "
        "codes; arm.angle float32 [2] by an MLP"
    )
    assert line in ended.stdout
    assert line in (tmp_path / "runs/faulty/impala_mlp/seed0/train.log").read_text()


NAN = {"space": spaces.Dict(eye=spaces.Box(-1, 1, (2,)), ear=spaces.Discrete(3))}


def spoil(value: float, at: int) -> Any:
    def change(returned: Any, step: int) -> Any:
        if step == at:
            returned[0]["eye"][1] = value
        return returned

    return change


@pytest.mark.parametrize(("value", "at"), [(np.nan, 3), (np.inf, 5), (-np.inf, 4)])
def test_observations_that_are_not_finite_end_evaluations_and_training(
    value: float, at: int, tmp_path: Path
) -> None:
    faulty(change=spoil(value, at), **NAN)
    said = f"observation 'eye' has the value {value} after step {at} of an episode"
    with pytest.raises(ValueError, match=said) as refused:
        scored()
    assert "'Faulty-v0' with {" in str(refused.value)
    one_line(train(tmp_path, "evaluation.every=100"), "'Faulty-v0'", said)


def test_a_first_observation_that_is_not_finite_is_refused() -> None:
    def start(returned: Any) -> Any:
        returned[0]["eye"][0] = np.nan
        return returned

    faulty(start=start, **NAN)
    with pytest.raises(ValueError, match="'eye' has the value nan after step 0 of an episode"):
        scored()


def test_an_environment_without_a_time_limit_is_warned_about(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.warns(UserWarning, match="Endless-v0 declares no time limit") as told:
        GymnasiumVectorEnv(1, "Endless-v0")
    assert len(str(told[0].message).splitlines()) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        GymnasiumVectorEnv(1, "Endless-v0", options={"max_episode_steps": 7})
        GymnasiumVectorEnv(1, "Endless-v0", wrap=lambda env: gym.wrappers.TimeLimit(env, 7))
        monkeypatch.setattr(Endless, "max_steps", property(lambda self: 7), raising=False)
        assert GymnasiumVectorEnv(1, "Endless-v0").time_limit == 7


@pytest.mark.filterwarnings("ignore:Endless-v0 declares no time limit")
def test_an_episode_that_never_ends_ends_an_evaluation(tmp_path: Path) -> None:
    faulty("Endless-v0", longest_episode=30)
    said = "an episode has not ended after 30 steps, so there is no score"
    with pytest.raises(ValueError, match=rf"'Endless-v0' with .*kind': 0}}, level kind_0: {said}"):
        scored()
    with pytest.raises(ValueError, match=said):
        zipf.envs.measure_chance("faulty/rare", episodes=3)
    one_line(train(tmp_path), "'Endless-v0'", said)
    arena = floors.Arena("faulty/uniform", rows=2)
    with pytest.raises(ValueError, match=said):
        floors.play(["actions 1"], arena, episodes=2)


def test_no_episode_that_a_declared_limit_allows_is_too_long() -> None:
    env = GymnasiumVectorEnv(
        1,
        "Endless-v0",
        options={"max_episode_steps": 50},
        wrap=lambda env: gym.wrappers.TimeLimit(env, 40),
        longest_episode=30,
    )
    assert env.longest_episode == 50
    returns = zipf.envs.measure_chance(lambda n, **options: env, episodes=1, num_envs=1)
    assert returns.score == 0


def returning(*values: Any) -> Any:
    """Replaces what `step` returns, where not ..., from the third step on."""

    def change(returned: Any, step: int) -> Any:
        if step < 3:
            return returned
        return tuple(b if a is ... else a for a, b in zip(values, returned, strict=True))

    return change


STEPS: list[tuple[Any, str]] = [
    (lambda returned, step: returned[:4], "it must return (observation, reward, terminated"),
    (lambda returned, step: None, "step raised TypeError"),
    (lambda returned, step: 1 / 0, "step raised ZeroDivisionError in test_gymnasium_faults.py"),
    (returning(..., None, ..., ..., ...), "a reward must be a number, got None"),
    (returning(..., "1", ..., ..., ...), "a reward must be a number, got '1'"),
    (returning(..., np.zeros(2), ..., ..., ...), "a reward must be a number, got array([0., 0.])"),
    (returning(..., 1j, ..., ..., ...), "a reward must be a number, got 1j"),
    (returning(..., np.nan, ..., ..., ...), "a reward must be a finite number, got nan"),
    (returning(..., ..., None, ..., ...), "terminated must be True or False, got None"),
    (returning(..., ..., ..., np.zeros(2), ...), "truncated must be True or False, got array"),
    (returning(..., ..., ..., ..., None), "info of step must be a dict, got None"),
    (returning({"eye": np.zeros(2)}, ..., ..., ..., ...), "an observation lacks 'ear'"),
    (returning(None, ..., ..., ..., ...), "an observation lacks 'eye'|'ear'"),
    (returning({"ear": 0, "eye": [[1], 2]}, ..., ..., ..., ...), "'eye' is [[1], 2], which is no"),
]


@pytest.mark.parametrize(("change", "message"), STEPS)
def test_what_a_step_returns_is_named(change: Any, message: str) -> None:
    faulty(change=change, **NAN)
    with pytest.raises(ValueError, match=r"Faulty-v0 with \{.*\}: ") as refused:
        scored()
    assert any(part in str(refused.value) for part in message.split("|"))
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("change", [STEPS[0][0], STEPS[2][0]])
def test_training_names_it_in_one_line(change: Any, tmp_path: Path) -> None:
    faulty(change=lambda returned, step: change(returned, step) if step > 2 else returned)
    one_line(train(tmp_path, "evaluation.every=100"), "Faulty-v0 with {", "}: step raised")


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (lambda returned: returned[0], "reset must return (observation, info), got {"),
        (lambda returned: (returned[0], None), "info of reset must be a dict, got None"),
        (lambda returned: 1 / 0, "reset raised ZeroDivisionError"),
    ],
)
def test_what_reset_returns_is_named(start: Any, message: str) -> None:
    faulty(start=start, **NAN)
    with pytest.raises(ValueError, match=f"Faulty-v0 with {{.*}}: {re.escape(message)}"):
        scored()


def test_a_reset_without_a_seed_is_named() -> None:
    faulty("Seedless-v0")
    with pytest.raises(ValueError, match=r"Seedless-v0 .*: reset raised .*seed=None, options=None"):
        scored()


@pytest.mark.parametrize("reward", [np.float32(1), np.ones(1), np.ones(()), True, 1])
def test_rewards_of_other_types_are_numbers(reward: Any) -> None:
    faulty(change=returning(..., reward, ..., ..., ...), **NAN)
    assert scored()["rare"] == 3


@pytest.mark.parametrize(
    ("space", "dtype"),
    [
        (spaces.Box(0, 9, (2,), np.uint64), np.int32),
        (spaces.Box(0, 9, (2,), np.uint32), np.int32),
        (spaces.MultiDiscrete([3, 4], dtype=np.uint64), np.int64),
        (spaces.Box(-1, 1, (2,), np.float16), np.float16),
    ],
)
def test_dtypes_that_pytorch_lacks_become_others(space: Any, dtype: Any, tmp_path: Path) -> None:
    faulty(space=space)
    env = zipf.envs.make_vec("faulty/uniform", 2)
    assert env.reset(seed=0)[0]["observation"].dtype == dtype
    assert train(tmp_path, "updates=1").returncode == 0


def test_long_doubles_are_doubles() -> None:
    space = spaces.Box(-1, 1, (2,), np.longdouble)

    def wrap(env: gym.Env) -> gym.Env:
        return gym.wrappers.TransformObservation(env, lambda _: np.ones(2, np.longdouble), space)

    env = GymnasiumVectorEnv(1, "Faulty-v0", wrap=wrap)
    assert env.reset(seed=0)[0]["observation"].dtype == np.float64


def test_what_cannot_be_kept_is_refused() -> None:
    for space, message in (
        (spaces.Box(0, 2**64 - 1, (2,), np.uint64), "whole numbers up to 2.63 - 1"),
        (spaces.Box(0, 1, (0,)), "which has no entries"),
        (spaces.Dict(), "there is nothing to read"),
        (spaces.Dict({"a\nb": spaces.Discrete(3)}), "give the parts names of one line"),
    ):
        with pytest.raises(ValueError, match=f"Faulty-v0 .*: .*{message}"):
            GymnasiumVectorEnv(1, "Faulty-v0", options={"space": space})


class Wordy(gym.ObservationWrapper[Any, Any, Any]):
    """Says more in an episode with a seed of 6 modulo 7."""

    def __init__(self, env: Any, rare: int = 7) -> None:
        super().__init__(env)
        self.observation_space = spaces.Text(100)
        self.rare = rare

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        self.long = seed % self.rare == self.rare - 1
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> Any:
        return "go to the very long corridor" if self.long else "go"


def test_texts_are_tried_when_a_batch_is_made() -> None:
    with pytest.raises(ValueError, match="Faulty-v0: observation 'observation': 'go to the very l"):
        GymnasiumVectorEnv(1, "Faulty-v0", wrap=Wordy, text_length=5)


@pytest.mark.slow
def test_a_run_that_a_text_was_too_long_for_goes_on_when_texts_are_cut(tmp_path: Path) -> None:
    wrap = partial(Wordy, rare=101)
    faulty(wrap=wrap, text_length=5)
    ended = train(tmp_path, "updates=200", "evaluation.every=100")
    one_line(ended, "has 6 words, more than text_length=5", "cut_texts=True", "Faulty-v0")
    del family._FAMILIES["faulty"]
    faulty(wrap=wrap, text_length=5, cut_texts=True)
    ended = train(tmp_path, "updates=200", "evaluation.every=100")
    assert ended.returncode == 0, ended.stderr
    assert "resumes at update" in ended.stdout


ALIVE: set[int] = set()


class Kept(gym.Wrapper[Any, Any, Any, Any]):
    """Counts how many of it are open."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        ALIVE.add(id(self))

    def close(self) -> None:
        ALIVE.discard(id(self))
        super().close()


def test_a_mixture_has_few_more_environments_than_it_plays() -> None:
    ALIVE.clear()
    levels = {
        str(k): partial(GymnasiumVectorEnv, id="Faulty-v0", options={"kind": k}, wrap=Kept)
        for k in range(30)
    }
    env = Mixture(levels, 10, draw="resets", exponent=0.0)
    pure = Mixture(
        {k: partial(GymnasiumVectorEnv, id="Faulty-v0", options={"kind": k}) for k in levels},
        10,
        draw="resets",
        exponent=0.0,
    )
    np.testing.assert_equal(env.reset(seed=0), pure.reset(seed=0))
    rng = np.random.default_rng(0)
    for _ in range(100):
        actions = rng.integers(3, size=10)
        np.testing.assert_equal(env.step(actions), pure.step(actions))
        assert len(ALIVE) <= 20
    other = Mixture(levels, 10, draw="resets", exponent=0.0)
    assert not other.set_state(env.get_state()).any()
    actions = rng.integers(3, size=10)
    np.testing.assert_equal(other.step(actions)[:4], env.step(actions)[:4])
    env.close()
    other.close()
    assert not ALIVE


class Value:
    """Its text is its place in memory."""


@pytest.mark.parametrize(
    "values",
    [
        [np.full((3, 3), k) for k in range(5)],
        [Value() for _ in range(5)],
        [partial(int, k) for k in range(5)],
        [{str(k), "a", "b"} for k in range(5)],
        [f"{k}\n{k}" for k in range(5)],
        [f"{k}" * 200 for k in range(5)],
        ["a", "b", "c", "d", Value()],
        [[k, np.ones(2)] for k in range(5)],
    ],
    ids=["arrays", "objects", "functions", "sets", "lines", "long", "mixed", "nested"],
)
def test_values_without_a_text_are_called_by_their_ranks(values: Any, tmp_path: Path) -> None:
    made = faulty(over=values, order="reversed", space=spaces.Discrete(2))
    assert made.levels[4:] == tuple(f"kind_{k}" for k in (4, 3, 2, 1, 0))
    env = zipf.envs.make_vec("faulty/uniform", 20)
    info = env.reset(seed=0)[1]
    assert info["kind_name"].tolist() == [f"kind_{k}" for k in info["kind"]]
    if not isinstance(values[0], np.ndarray):
        return
    assert train(tmp_path, "updates=1").returncode == 0
    del family._FAMILIES["faulty"]
    faulty(over=[one.copy() for one in values], order="reversed", space=spaces.Discrete(2))
    ended = train(tmp_path)
    assert "resumes at update 1" in ended.stdout, ended.stderr
    reported = call("runs", module="zipf.report", folder=tmp_path)
    assert reported.returncode == 0, reported.stderr


def test_values_with_a_text_are_called_by_it() -> None:
    values = [0.5, "a, b", (5, 5), np.int64(3), ["SF", "FG"]]
    named = [f"kind_{one}" for one in ("0.5", "a, b", "(5, 5)", "3", "['SF', 'FG']")]
    assert list(faulty(over=values).levels[4:]) == named


NESTED = spaces.Dict(
    arm=spaces.Dict(angle=spaces.Box(-1, 1, (2,)), on=spaces.Box(0, 1, (3,), np.bool_)),
    pair=spaces.Tuple((spaces.Discrete(3), spaces.Discrete(4))),
    keys=spaces.Box(-1, 1, (1,)),
)


def test_stable_baselines3_reads_nested_observations() -> None:
    adapter = pytest.importorskip("zipf.adapters.stable_baselines3")
    from stable_baselines3 import PPO

    faulty(space=NESTED)
    env = adapter.ZipfVecEnv(zipf.envs.make_vec("faulty/zipf_1", 2))
    assert set(env.observation_space) == {"arm_angle", "arm_on", "keys_", "pair_0", "pair_1"}
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, device="cpu")
    model.learn(16)
    assert 0 <= score(adapter.policy(model), "faulty", episodes=4)["rare"] <= 5
    observation = env.reset()
    assert observation.keys() == env.observation_space.keys()
    ended = next(info for _ in range(6) for info in [env.step([0, 0])[3][0]] if info)
    assert ended["terminal_observation"].keys() == env.observation_space.keys()


def test_normalising_leaves_the_batchs_own_spaces() -> None:
    adapter = pytest.importorskip("zipf.adapters.stable_baselines3")
    from stable_baselines3.common.vec_env import VecNormalize

    faulty(space=spaces.Dict(eye=spaces.Box(0, 255, (36, 36, 3), np.uint8)))
    env = zipf.envs.make_vec("faulty/zipf_1", 2)
    before = copy.deepcopy(env.single_observation_space), copy.deepcopy(env.observation_space)
    wrapped = VecNormalize(adapter.ZipfVecEnv(env))
    assert wrapped.observation_space != before[0]
    assert (env.single_observation_space, env.observation_space) == before


def test_torchscript_reads_nested_observations(tmp_path: Path) -> None:
    from zipf.adapters import torchscript

    class Reads(torch.nn.Module):
        def forward(self, arm_angle: torch.Tensor, pair_0: torch.Tensor) -> torch.Tensor:
            assert arm_angle.shape[1] == 2
            return torch.stack([arm_angle[:, 0] * 0 + pair_0 * 0 + k for k in (0, 99, 0)], 1)

    torch.jit.script(Reads()).save(tmp_path / "reads.pt")
    faulty(space=NESTED)
    assert score(torchscript.policy(tmp_path / "reads.pt"), "faulty", episodes=4)["rare"] == 5


def test_names_that_are_the_same_with_underscores_are_refused() -> None:
    from zipf.adapters.networks import with_underscores

    with pytest.raises(ValueError, match=r"the observations 'a.b', 'a_b' would have the same name"):
        with_underscores(["a.b", "a_b", "c"], r"\.")


class Wide(zipf.envs.ZipfVectorEnv):
    """A family's own batch with an odd part."""

    def __init__(self, num_envs: int, space: spaces.Space, **options: Any) -> None:
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(part=space),
            single_action_space=spaces.Discrete(2),
            situation={},
            **options,
        )

    def _begin(self, mask: Any, forced: Any) -> None: ...

    def _advance(self, actions: Any, mask: Any) -> Any:
        none = np.zeros(self.num_envs, np.bool_)
        return np.zeros(self.num_envs), none, self._lengths >= 3, none

    def _observe(self, out: Any, mask: Any) -> None: ...

    def _situations(self) -> Any:
        return {}

    def _get_env_states(self) -> Any:
        return {}

    def _set_env_states(self, state: Any) -> None: ...


@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, np.uint64, np.longdouble])
def test_torchrl_names_dtypes_that_it_has_not(dtype: Any) -> None:
    adapter = pytest.importorskip("zipf.adapters.torchrl")
    env = Wide(2, spaces.Box(0, 9, (2,), dtype), autoreset_mode="Disabled")
    with pytest.raises(ValueError, match=f"observation 'part' is {np.dtype(dtype)}, of which"):
        adapter.torchrl_env(env)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (spaces.Box(0, 255, (4, 84, 84), np.uint8), "give an image as uint8"),
        (spaces.Box(0, 255, (84, 84), np.uint8), "give an image as uint8"),
        (spaces.Box(0, 1, (10, 10, 4), np.bool_), "give an image as uint8"),
        (spaces.Box(0, 9, (2,), np.uint64), "which is uint64: give it as one of bool, uint8"),
    ],
)
def test_agents_refuse_what_they_would_read_otherwise(space: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Encoder(spaces.Dict(part=space), compact())


@pytest.mark.parametrize(
    ("space", "part"),
    [
        (spaces.Discrete(10**12), "'observation' is Discrete(1000000000000)"),
        (spaces.Discrete(2**62), "'observation' is Discrete("),
        (spaces.MultiDiscrete([3, 10**12]), "'observation' is MultiDiscrete("),
    ],
)
def test_it_is_said_which_observation_has_too_many_codes(
    space: Any, part: str, tmp_path: Path
) -> None:
    faulty(space=space)
    one_line(train(tmp_path), part, "embeddings of so many codes take")


def test_it_is_said_that_there_are_too_many_actions(tmp_path: Path) -> None:
    def wrap(env: gym.Env) -> gym.Env:
        return gym.wrappers.TransformAction(env, lambda action: action, spaces.Discrete(10**12))

    faulty(wrap=wrap)
    one_line(train(tmp_path), "Discrete(1000000000000) are too many actions")


@pytest.mark.parametrize("id", ["zipf/Gridworld-v0", "zipf/Playroom-v1"])
def test_make_vec_takes_gymnasiums_time_limit(id: str) -> None:
    env = gym.make_vec(id, num_envs=2, max_episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.int64))[2:4] for _ in range(3)]
    assert np.any(ends, (0, 1)).all()
    assert gym.make_vec(id, num_envs=2, max_episode_steps=-1).time_limit > 3
    assert gym.make_vec(id, max_episode_steps=3, max_steps=np.int64(50)).time_limit == 3
    with pytest.raises(ValueError, match="max_episode_steps must be a whole number"):
        gym.make_vec(id, max_episode_steps="3")
    assert gym.spec(id).to_json()
