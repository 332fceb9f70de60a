"""A batch of worlds as an environment of TorchRL."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from tensordict import TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import GymWrapper
from torchrl.envs.gym_like import BaseInfoDictReader

from zipf.envs.vector import ZipfVectorEnv

_TAKEN = (
    "action",
    "done",
    "length",
    "next",
    "return",
    "reward",
    "success",
    "terminated",
    "truncated",
)
"""Entries of its TensorDicts beside observations and ranks."""


def torchrl_env(env: ZipfVectorEnv, *, device: str | None = None) -> GymWrapper:
    """The worlds of a batch as a TorchRL environment of batch size [N].

        env = torchrl_env(make_vec("gridworld/zipf_2", 64, autoreset_mode="Disabled"))

    Actions, and observations from a `Discrete` space, are indices (int64 [N]), not one-hot.
    Observations stand at the root of its TensorDicts by their names. Beside them, and after a step
    in "next", stand as tensors [N, 1]:

    - the ranks of the situation (int64), by their names, of the episode that is played;
    - `success` (bool; only where the environment reports it), `return` (float32) and `length`
      (int64) of the episode, where `("next", "done")` is True; zero elsewhere.

    Args:
        env: a batch in `AutoresetMode.DISABLED`: TorchRL resets the worlds that are done itself.
        device: where TorchRL puts the tensors.

    Raises:
        ValueError: `env` is no batch of ours, has another autoreset mode, or a rank or a part of
            its observations has the name of something else in a TensorDict.
    """
    if not isinstance(env, ZipfVectorEnv):
        raise ValueError(f"env must be what zipf.envs.make_vec makes, got {type(env).__name__}")
    if env.autoreset_mode is not AutoresetMode.DISABLED:
        raise ValueError(
            "autoreset_mode must be DISABLED for TorchRL (make_vec(..., "
            f'autoreset_mode="Disabled")), got {env.autoreset_mode.name}'
        )
    names = [*_TAKEN, *env.single_observation_space, *env.situation]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(
            f"{twice[0]!r} cannot be both an observation or a rank of these worlds and another "
            "entry of TorchRL's TensorDicts: give it another name"
        )
    with warnings.catch_warnings():
        # The bounds of the observation space are views; TorchRL only reads them.
        warnings.filterwarnings("ignore", message="The given NumPy array is not writable")
        wrapped = GymWrapper(env, categorical_action_encoding=True, device=device)
    return wrapped.set_info_dict_reader(_EpisodeReader(env))


class _EpisodeReader(BaseInfoDictReader):
    """Copies ranks and outcomes from `info` to TensorDicts."""

    def __init__(self, env: ZipfVectorEnv) -> None:
        shape = (env.num_envs, 1)
        specs: dict[str, Any] = {
            name: Bounded(0, size - 1, shape, dtype=torch.int64)
            for name, size in env.situation.items()
        }
        if env.reports_success:
            specs["success"] = Binary(1, shape=shape, dtype=torch.bool)
        specs["return"] = Unbounded(shape, dtype=torch.float32)
        specs["length"] = Unbounded(shape, dtype=torch.int64)
        self._spec = Composite(specs, shape=(env.num_envs,))

    @property
    def info_spec(self) -> Composite:
        return self._spec

    def __call__(self, info: dict[str, Any], tensordict: TensorDictBase) -> TensorDictBase:
        for name, spec in self._spec.items():
            if name in info:
                # Outcomes come with a mask of the worlds whose episodes have ended.
                told = np.where(info.get(f"_{name}", True), info[name], 0)
                value = torch.as_tensor(told, dtype=spec.dtype, device=tensordict.device)
                tensordict.set(name, value.unsqueeze(-1))
            else:
                tensordict.set(name, spec.zero())
        return tensordict
