"""Agents from elsewhere as policies of the evaluator."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf import envs
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.compatibility import Worlds, check_geometry
from zipf.experiments.evaluation.evaluator import Policy
from zipf.experiments.evaluation.scripted import ScriptedPolicy


def as_policy(
    policy: Any, worlds: Worlds, *, batched: bool, deterministic: bool, seed: int
) -> Policy:
    """What `zipf.evaluate.score` takes, as a policy of the evaluator.

    Args:
        policy: see `zipf.evaluate.score`.
        worlds: what it is to play.
        batched: False for a function, or an object with `predict`, that takes one observation.
        deterministic: its most probable actions in the place of draws.
        seed: of the evaluation.

    Raises:
        ValueError: the policy has other spaces or another geometry, or cannot be played as the
            options say.
        TypeError: the policy is of no known kind.
        UserError: a run's folder from which no agent can be loaded.
    """
    if isinstance(policy, str) and policy in envs.SCRIPTED:
        _refuse(batched=batched)
        if deterministic:
            raise ValueError("deterministic=True: a script decides for itself how it acts")
        return ScriptedPolicy(policy)
    if isinstance(policy, str | Path):
        _refuse(batched=batched)
        return _from_path(Path(policy), worlds, deterministic, derive_seed(seed, "actions"))
    check_geometry(getattr(policy, "geometry", None), worlds)
    if _is_tensordict_module(policy):
        from zipf.experiments.evaluation.tensordict_policy import TensorDictPolicy

        _refuse(batched=batched)
        return TensorDictPolicy(
            policy, worlds.observation_space, worlds.action_space, deterministic=deterministic
        )
    if callable(getattr(policy, "predict", None)):
        return _Predictor(policy, worlds, batched, deterministic)
    if not callable(policy):
        raise TypeError(
            f"policy is a {type(policy).__name__}; should be a function from observations to "
            "actions, an object with `predict`, a TensorDict module, or the path of a .onnx file, "
            "a TorchScript file (.pt, .ts) or a run's folder"
        )
    if deterministic:
        raise ValueError("deterministic=True: a function decides for itself how it acts")
    if hasattr(policy, "start"):
        _refuse(batched=batched)
        return policy
    return _Function(policy, batched)


@contextmanager
def own_torch_draws(seed: int) -> Iterator[None]:
    """PyTorch's global generators begin at `seed` here, and afterwards are as they were before.

    Where PyTorch is not in use it is not imported.
    """
    if "torch" not in sys.modules:
        yield
        return
    import torch

    in_use = torch.cuda.is_initialized()
    with torch.random.fork_rng(devices=range(torch.cuda.device_count()) if in_use else ()):
        # `torch.manual_seed` would also seed a CUDA that is initialised later, for good.
        torch.default_generator.manual_seed(seed)
        if in_use:
            torch.cuda.manual_seed_all(seed)
        yield


def _refuse(*, batched: bool) -> None:
    if not batched:
        raise ValueError(
            "batched=False: only for functions and objects with `predict` that take one observation"
        )


def _from_path(path: Path, worlds: Worlds, deterministic: bool, seed: int) -> Policy:
    if path.is_dir():
        from zipf.experiments.evaluation.trained import agent_of_run

        if deterministic:
            raise ValueError("deterministic=True: agents of runs act as they do when evaluated")
        return agent_of_run(path, worlds, seed)
    from zipf.experiments.evaluation.network_files import FilePolicy, Network, network_of

    network: Network = network_of(path)
    check_geometry(network.geometry, worlds)
    return FilePolicy(
        str(path),
        network,
        worlds.observation_space,
        worlds.action_space,
        seed=seed,
        deterministic=deterministic,
    )


def _is_tensordict_module(policy: Any) -> bool:
    # Such an object can exist only where the library has been imported.
    library = sys.modules.get("tensordict.nn")
    return library is not None and isinstance(policy, library.TensorDictModuleBase)


class _Function:
    """A function from observations to actions."""

    def __init__(self, function: Callable[[Any], Any], batched: bool) -> None:
        self.function = function
        self.batched = batched

    def start(self, num_envs: int) -> None: ...

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        if self.batched:
            return self.function(observation)
        return np.asarray([self.function({name: part[0] for name, part in observation.items()})])


class _Predictor:
    """An object with `predict`, in the convention of Stable-Baselines3.

    Raises:
        ValueError: it declares other spaces than the worlds', or `predict` returns something else.
        TypeError: `predict` does not take these arguments.
    """

    def __init__(self, agent: Any, worlds: Worlds, batched: bool, deterministic: bool) -> None:
        self.predict = agent.predict
        self.batched = batched
        self.options = {"deterministic": True} if deterministic else {}
        given = {"state": None, "episode_start": None, **self.options}
        try:
            inspect.signature(self.predict).bind(None, **given)
        except TypeError as error:
            taken = ", ".join(f"{name}=..." for name in given)
            raise TypeError(
                f"the policy's predict must take (observation, {taken}): {error}"
            ) from None
        except ValueError:
            pass  # a compiled function that does not tell what it takes
        self.alone: str | None = None
        declared = getattr(agent, "observation_space", None)
        expected: spaces.Space = worlds.observation_space
        if declared is not None:
            if len(worlds.observation_space) == 1 and not isinstance(declared, spaces.Dict):
                self.alone = next(iter(worlds.observation_space))
                expected = worlds.observation_space[self.alone]
            if not _same_space(declared, expected):
                raise ValueError(
                    f"the policy's observation space, {declared}, differs from that of split "
                    f"{worlds.split!r}, {expected}"
                )
        actions = getattr(agent, "action_space", worlds.action_space)
        if actions != worlds.action_space:
            raise ValueError(
                f"the policy's action space, {actions}, differs from that of split "
                f"{worlds.split!r}, {worlds.action_space}"
            )

    def start(self, num_envs: int) -> None:
        self.state = None

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        given: Any = observation
        if not self.batched:
            given = {name: part[0] for name, part in observation.items()}
        if self.alone:
            given = given[self.alone]
        answer = self.predict(given, state=self.state, episode_start=is_first, **self.options)
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise ValueError(
                f"the policy's predict must return (actions, state), got a {type(answer).__name__}"
            )
        actions, self.state = answer
        return np.atleast_1d(actions)


def _same_space(declared: spaces.Space, expected: spaces.Space) -> bool:
    """Whether they are equal, or the declared one has an image's channels first.

    Stable-Baselines3 declares images so where they came with channels last, and transposes what
    `predict` is given.
    """
    if isinstance(declared, spaces.Dict) and isinstance(expected, spaces.Dict):
        return declared.keys() == expected.keys() and all(
            _same_space(declared[name], expected[name]) for name in expected
        )
    if isinstance(declared, spaces.Box) and len(declared.shape) == 3:
        low, high = (np.moveaxis(bound, 0, -1) for bound in (declared.low, declared.high))
        return expected in (declared, spaces.Box(low, high, dtype=declared.dtype.type))
    return declared == expected
