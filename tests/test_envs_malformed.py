"""Arguments of the wrong kind are ValueErrors in every kind of batch, and change nothing."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from zipf.envs import GymnasiumVectorEnv, Mixture, ZipfVectorEnv, make_vec
from zipf.envs.gridworld.level import Level
from zipf.envs.vector import COLUMNS, RESERVED

SMALL = {"num_maps": 2, "num_objects": 3}
BATCHES: dict[str, Callable[[Any], ZipfVectorEnv]] = {
    "gridworld": lambda n: make_vec("gridworld/uniform", n, **SMALL),
    "mixture": lambda n: Mixture(
        {name: partial(make_vec, f"gridworld/{name}", **SMALL) for name in ("uniform", "zipf_2")},
        n,
        draw="resets",
        exponent=1.0,
    ),
    "gymnasium": lambda n: GymnasiumVectorEnv(n, "CartPole-v1"),
}


@pytest.fixture(params=BATCHES)
def env(request: pytest.FixtureRequest) -> ZipfVectorEnv:
    batch = BATCHES[request.param](3)
    batch.reset(seed=0)
    return batch


@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize("num_envs", [0, -1, 2.0, "3", None, True, float("nan"), [3]])
def test_numbers_of_worlds(name: str, num_envs: Any) -> None:
    with pytest.raises(ValueError, match="num_envs must be"):
        BATCHES[name](num_envs)


@pytest.mark.parametrize("name", [*RESERVED, "_length", 3])
def test_names_that_every_batch_uses(name: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    make = BATCHES["gridworld"]
    with monkeypatch.context() as changed:
        changed.setattr(Level, "situation", {name: 2, "target": 3})
        with pytest.raises(ValueError, match=f"a rank cannot be called {name!r}.*reserved names"):
            make(3)
    env = make(3)
    monkeypatch.setattr(env, "_describe", lambda: {name: np.zeros(3)})
    with pytest.raises(ValueError, match=f"an entry of info cannot be called {name!r}"):
        env.reset()


@pytest.mark.parametrize("name", COLUMNS)
def test_ranks_are_not_called_as_columns_of_evaluations(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Level, "situation", {name: 2, "target": 3})
    with pytest.raises(ValueError, match=f"a rank cannot be called {name!r}: evaluations have"):
        BATCHES["gridworld"](3)


def test_a_rank_is_not_described_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    env = BATCHES["gridworld"](3)
    monkeypatch.setattr(env, "_describe", lambda: {"map": np.zeros(3)})
    with pytest.raises(ValueError, match="both a rank and another entry 'map'"):
        env.reset()


@pytest.mark.parametrize(
    "arguments",
    [
        {"seed": 1.5},
        {"seed": "0"},
        {"seed": True},
        {"seed": -1},
        {"seed": [0, 1]},
        {"seed": [0, 1, 1.5]},
        {"seed": [0, 1, "2"]},
        {"seed": [0, 1, -2]},
        {"seed": np.zeros((3, 2), np.int64)},
        {"seed": {"a": 1}},
        {"options": 5},
        {"options": ["reset_mask"]},
        {"options": {1: 2, "x": 3}},
        {"options": {"reset_mask": [1, 0, 1]}},
        {"options": {"reset_mask": None}},
        {"options": {"reset_mask": [True, [False], True]}},
        {"out": 5},
        {"out": ["image"]},
        {"out": {"nothing": np.zeros(3)}},
    ],
)
def test_arguments_of_reset(env: ZipfVectorEnv, arguments: dict[str, Any]) -> None:
    before = env.get_state()
    with pytest.raises(ValueError, match=r".+"):
        env.reset(**arguments)
    np.testing.assert_equal(env.get_state(), before)


@pytest.mark.parametrize("of_array", [lambda array: array.tolist(), lambda array: None, bytes])
@pytest.mark.parametrize("name", ["out", "final_out"])
def test_buffers_that_are_no_arrays(
    env: ZipfVectorEnv, name: str, of_array: Callable[[Any], Any]
) -> None:
    buffers = {key: of_array(array) for key, array in env.allocate().items()}
    before = env.get_state()
    with pytest.raises(ValueError, match=name):
        env.step(np.zeros(3, np.int64), **{name: buffers})
    np.testing.assert_equal(env.get_state(), before)


@pytest.mark.parametrize("given", ["both", "own"])
def test_buffers_that_share_memory(env: ZipfVectorEnv, given: str) -> None:
    env.copy = False
    out = env.allocate() if given == "both" else env.step(np.zeros(3, np.int64))[0]
    buffers = {"out": out, "final_out": out} if given == "both" else {"final_out": out}
    before = env.get_state()
    with pytest.raises(ValueError, match=r"final_out\['\w+'\] must not share memory"):
        env.step(np.zeros(3, np.int64), **buffers)
    np.testing.assert_equal(env.get_state(), before)
    both = {key: np.zeros((2, *array.shape), array.dtype) for key, array in out.items()}
    halves = [{key: array[i] for key, array in both.items()} for i in range(2)]
    env.step(np.zeros(3, np.int64), out=halves[0], final_out=halves[1])


@pytest.mark.parametrize("method", ["_advance", "_begin"])
def test_worlds_are_reset_after_an_error(
    env: ZipfVectorEnv, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> Any:
        raise RuntimeError("the engine is gone")

    def steps() -> None:  # several, for `_begin` is called when an episode ends
        for _ in range(200):
            env.step(np.zeros(3, np.int64))

    with monkeypatch.context() as changed:
        changed.setattr(env, method, fails)
        with pytest.raises(RuntimeError, match="the engine is gone"):
            steps()
    with pytest.raises(ResetNeeded, match=r"reset envs \[0, 1, 2\] first"):
        env.step(np.zeros(3, np.int64))
    env.reset()
    env.step(np.zeros(3, np.int64))
    env.set_state(env.get_state())


@pytest.mark.parametrize("mode", ["SameStep", "NextStep", "Disabled"])
def test_no_mode_begins_episodes_after_an_error(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> Any:
        raise RuntimeError("the engine is gone")

    env = make_vec("gridworld/uniform", 3, autoreset_mode=mode, **SMALL)
    env.reset(seed=0)
    with monkeypatch.context() as changed:
        changed.setattr(env, "_advance", fails)
        with pytest.raises(RuntimeError, match="the engine is gone"):
            env.step(np.zeros(3, np.int64))
    with pytest.raises(ResetNeeded, match=r"reset envs \[0, 1, 2\] first"):
        env.step(np.zeros(3, np.int64))


def test_who_replaces_observations_does_not_replace_buffers() -> None:
    env = make_vec("gridworld/uniform", 3, copy=False, **SMALL)
    seen, _ = env.reset(seed=0)
    kept = seen["image"]
    seen["image"] = kept[:, ::9, ::9]
    for _ in range(3):
        seen, *_ = env.step(np.zeros(3, np.int64))
        assert seen["image"] is kept


def test_a_state_of_the_wrong_kind(env: ZipfVectorEnv) -> None:
    """Every entry: of another type, shape or dtype, and missing."""
    before = env.get_state()
    wrong: list[Any] = [None, 5, [], {}, list(before)]
    for key, value in before.items():
        for other in (None, 5, "x", value.tolist(), value[None], value.astype(object)):
            wrong.append({**before, key: other})
        wrong.append({k: v for k, v in before.items() if k != key})
    for key, value in (("lengths", -1), ("returns", np.nan), ("seeded", False)):
        changed = before[key].copy()
        changed[0] = value
        wrong.append({**before, key: changed})
    for state in wrong:
        with pytest.raises(ValueError, match="state"):
            env.set_state(state)
    np.testing.assert_equal(env.get_state(), before)


def test_a_seed_that_no_episode_has() -> None:
    env = BATCHES["gymnasium"](2)
    env.reset(seed=0)
    state = env.get_state()
    state["seeds"][0] = 2**40
    with pytest.raises(ValueError, match="out of range"):
        env.set_state(state)


@pytest.mark.parametrize(
    "options",
    [
        {"options": 5},
        {"codes": ["image"]},
        {"codes": {"observation": "many"}},
        {"text_length": "long"},
        {"vocabulary": 2.5},
        {"id": 5},
    ],
)
def test_arguments_of_gymnasium_worlds(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r".+"):
        GymnasiumVectorEnv(2, **{"id": "CartPole-v1", **options})


@pytest.mark.parametrize(
    "options",
    [
        {"levels": ["uniform"]},
        {"probabilities": "many"},
        {"probabilities": [[1.0], 2.0]},
        {"exponent": "steep"},
    ],
)
def test_arguments_of_mixtures(options: dict[str, Any]) -> None:
    levels = {
        name: partial(make_vec, f"gridworld/{name}", **SMALL) for name in ("uniform", "zipf_2")
    }
    law = {} if "probabilities" in options or "exponent" in options else {"exponent": 1.0}
    with pytest.raises(ValueError, match=r".+"):
        Mixture(**{"levels": levels, "num_envs": 2, "draw": "resets", **law, **options})
