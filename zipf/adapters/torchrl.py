"""TorchRL: a batch as its environment, and its actors as policies."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.data.utils import numpy_to_torch_dtype_dict
from torchrl.envs import GymWrapper
from torchrl.envs.gym_like import BaseInfoDictReader
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule

from zipf.adapters.networks import NetworkPolicy
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
    """The envs of a batch as a TorchRL environment of batch size [N].

        env = torchrl_env(make_vec("gridworld/zipf_2", 64, autoreset_mode="Disabled"))

    Actions, and observations from a `Discrete` space, are indices (int64 [N]), not one-hot.
    Observations stand at the root of its TensorDicts by their names. Beside them, and after a step
    in "next", stand as tensors [N, 1]:

    - the ranks of the situation (int64), by their names, of the episode that is played;
    - `success` (bool; only where the environment reports it), `return` (float32) and `length`
      (int64) of the episode, where `("next", "done")` is True; zero elsewhere.

    Args:
        env: a batch in `AutoresetMode.DISABLED`, as TorchRL resets the envs that are done itself,
            with `copy=True`.
        device: where TorchRL puts the tensors.

    Raises:
        ValueError: `env` is no batch of ours, has another autoreset mode, reuses the arrays of its
            observations, or a rank or a part of
            its observations has the name of something else in a TensorDict or a dtype that TorchRL
            has not.
    """
    if not isinstance(env, ZipfVectorEnv):
        raise ValueError(f"env must be what zipf.envs.make_vec makes, got {type(env).__name__}")
    if env.autoreset_mode is not AutoresetMode.DISABLED:
        raise ValueError(
            "autoreset_mode must be DISABLED for TorchRL (make_vec(..., "
            f'autoreset_mode="Disabled")), got {env.autoreset_mode.name}'
        )
    if not env.copy:
        raise ValueError("copy must be True for TorchRL, which keeps observations after a step")
    names = [*_TAKEN, *env.single_observation_space, *env.situation]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(
            f"{twice[0]!r} cannot be both an observation or a rank of these envs and another "
            "entry of TorchRL's TensorDicts: give it another name"
        )
    for name, space in env.single_observation_space.items():
        if space.dtype not in numpy_to_torch_dtype_dict:
            raise ValueError(
                f"observation {name!r} is {space.dtype}, of which TorchRL has no tensors: give it "
                "as int64 or float64"
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
                # Outcomes come with a mask of the envs whose episodes have ended.
                entry = np.where(info.get(f"_{name}", True), info[name], 0)
                value = torch.as_tensor(entry, dtype=spec.dtype, device=tensordict.device)
                tensordict.set(name, value.unsqueeze(-1))
            else:
                tensordict.set(name, spec.zero())
        return tensordict


def policy(module: TensorDictModuleBase, *, deterministic: bool = False) -> NetworkPolicy:
    """A TensorDict module, such as an actor of TorchRL, as a policy.

    The module is given a TensorDict of batch size [N] with its inputs at the root, which are those
    of `zipf.adapters.networks`. A recurrent state is an input `name` that it writes to
    `("next", name)`, as TorchRL's `LSTMModule` does; it begins at what the module's
    `make_tensordict_primer` declares, mostly zeros, and again where an episode begins. The module
    writes `action`, an index (integers [N] or [N, 1]) or one-hot ([N, actions]).

    Args:
        module: played in evaluation mode, without gradients, on its parameters' device. Its
            attribute `env_options`, where you give it one, names the constructor options that it
            was trained with.
        deterministic: TorchRL's `ExplorationType.DETERMINISTIC` in the place of `RANDOM`; always
            for a module with an `EGreedyModule`, which explores by a schedule.

    Raises:
        TypeError: `module` is no such module.
        ValueError: it writes no action.
    """
    if not isinstance(module, TensorDictModuleBase):
        raise TypeError(f"module is a {type(module).__name__}; should be a TensorDictModule")
    if "action" not in module.out_keys:
        raise ValueError(f"the policy writes {module.out_keys}; should write 'action'")
    return _ModulePolicy(module, deterministic)


class _ModulePolicy(NetworkPolicy):
    def __init__(self, module: TensorDictModuleBase, deterministic: bool) -> None:
        self.module = module
        parameter = next(module.parameters(), None)
        self.device = torch.device("cpu") if parameter is None else parameter.device
        trained_with = getattr(module, "env_options", None)
        explores = any(isinstance(part, EGreedyModule) for part in module.modules())
        super().__init__("the policy", module.in_keys, trained_with, deterministic or explores)

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> NetworkPolicy:
        declared = _declared_actions(self.module)
        if declared not in (None, action_space.n):
            raise ValueError(
                f"the policy's spec has {declared} actions, and the action space is {action_space}"
            )
        return super().for_envs(observation_space, action_space, seed)

    def initial_state(self, num_envs: int) -> list[NDArray]:
        initial = _primers(self.module)
        for key in self.states:
            if ("next", key) not in self.module.out_keys:
                raise ValueError(
                    f"the policy reads {key!r}, which is no observation, not 'is_init', and no "
                    f"recurrent state that it writes to ('next', {key!r})"
                )
            if key not in initial:
                raise ValueError(
                    f"the policy's recurrent state {key!r} has no declared shape; give its module "
                    "a make_tensordict_primer, as TorchRL's LSTMModule has"
                )
        return [initial[key].expand(num_envs, *initial[key].shape).numpy() for key in self.states]

    def run(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        kind = ExplorationType.DETERMINISTIC if self.deterministic else ExplorationType.RANDOM
        given = {name: torch.from_numpy(part).to(self.device) for name, part in inputs.items()}
        was_training = [(part, part.training) for part in self.module.modules()]
        self.module.eval()
        try:
            with torch.no_grad(), set_exploration_type(kind):
                output = self.module(TensorDict(given, batch_size=[len(self.action)]))
        finally:
            for part, training in was_training:
                part.training = training
        written = [output["action"], *(output["next", key] for key in self.states)]
        return [one.cpu().numpy() for one in written]

    def choose(self, output: NDArray) -> NDArray:
        if output.ndim == 2 and output.shape[1] == self.actions > 1:
            if not (((output == 0) | (output == 1)).all() and (output.sum(-1) == 1).all()):
                raise ValueError(
                    f"the policy returned actions of shape {output.shape} that are not one-hot; "
                    "should be indices [N] or one-hot [N, actions]"
                )
            return output.argmax(-1)
        return output[:, 0] if output.ndim == 2 and output.shape[1] == 1 else output


def _primers(module: TensorDictModuleBase) -> dict[str, Tensor]:
    """The recurrent states with which an episode begins, for one environment."""
    initial = {}
    for part in module.modules():
        if hasattr(part, "make_tensordict_primer"):
            primer: Any = part.make_tensordict_primer()
            for key, spec in primer.primers.items(True, True):
                default = primer.default_value
                value = default.get(key) if isinstance(default, Mapping) else default
                value = value() if callable(value) else value
                zero = spec.zero()
                if value is not None:
                    zero = zero + torch.as_tensor(value, dtype=zero.dtype, device=zero.device)
                initial[key] = zero
    return initial


def _declared_actions(module: TensorDictModuleBase) -> int | None:
    """The number of actions by the policy's spec; None where it has none."""
    spec = getattr(module, "spec", None)
    if spec is not None and hasattr(spec, "keys"):
        spec = spec["action"] if "action" in spec.keys() else None
    return getattr(getattr(spec, "space", None), "n", None)
