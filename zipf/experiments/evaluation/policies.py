"""What `score` takes, as policies of the evaluator."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf import envs
from zipf.experiments.evaluation.evaluator import Policy
from zipf.experiments.evaluation.scripted import ScriptedPolicy

_MAKERS = (
    "zipf.load_agent(folder) makes a policy of a run; policy(...) of zipf.adapters.onnx, "
    "torchscript, torchrl or stable_baselines3 one of an agent of another library"
)


def as_policy(
    policy: Any,
    observation_space: spaces.Dict,
    action_space: spaces.Discrete,
    *,
    batched: bool,
    seed: int,
) -> Policy:
    """What `zipf.evaluate.score` takes, as a policy of the evaluator.

    Args:
        policy: see `zipf.evaluate.score`.
        observation_space, action_space: of one environment, alike on all levels that are played.
        batched: False for a function that takes one observation.
        seed: of the policy's draws.

    Raises:
        ValueError: a path, a policy for other spaces, or `batched=False` with something else than
            a function.
        TypeError: the policy cannot be called.
    """
    special = hasattr(policy, "for_envs") or hasattr(policy, "start")
    if not batched and (special or isinstance(policy, str)):
        raise ValueError("batched=False: only for functions that take one observation")
    if isinstance(policy, str) and policy in envs.SCRIPTED:
        return ScriptedPolicy(policy)
    if isinstance(policy, str | Path):
        scripts = " or ".join(map(repr, envs.SCRIPTED))
        raise ValueError(f"policy={str(policy)!r}: should be a policy or {scripts}; {_MAKERS}")
    if hasattr(policy, "for_envs"):
        policy = policy.for_envs(observation_space, action_space, seed)
    # A TensorDict module can be called, but not with the observations of an evaluation.
    if not callable(policy) or hasattr(policy, "in_keys"):
        raise TypeError(
            f"policy is a {type(policy).__name__}; should be a function from observations to "
            f"actions; {_MAKERS}"
        )
    return policy if hasattr(policy, "start") else _Function(policy, batched)


def check_env_options(
    trained_with: Mapping[str, Any] | None,
    split: envs.Split,
    played: Mapping[str, Mapping[str, Any]],
) -> None:
    """Raises `ValueError` where a policy was trained with other constructor options than those that
    the split itself gives a level.

    Args:
        trained_with: the options that matter to the policy; None where it names none.
        split: the split that is played.
        played: the options of each of its levels.
    """
    own = {level.name: level.options for level in split.all_levels}
    differing = []
    for name, value in (trained_with or {}).items():
        for level, options in played.items():
            if name in own[level]:
                continue
            if name not in options:
                differing.append(f"{name}={value} of the policy, and {level} has no {name}")
                break
            if plain_option(value) != plain_option(options[name]):
                differing.append(f"{name}={value} of the policy, {options[name]} of {level}")
                break
    if differing:
        raise ValueError(
            f"the policy's env_options differ from those of split {split.name!r}: "
            f"{'; '.join(differing)}"
        )


def plain_option(value: Any) -> Any:
    """An option's value as configurations have it: lists in the place of tuples."""
    return list(value) if isinstance(value, tuple) else value


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
