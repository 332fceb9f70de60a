"""TensorDict modules, such as TorchRL's actors, as policies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type


class TensorDictPolicy:
    """A module that reads observations from a TensorDict and writes `action` to it.

    It is given a TensorDict of batch size [N] with the observations at its root by their names
    (where there is only one, also as `observation`), `is_init` (bool [N, 1]) and its recurrent
    states. A state is an input `name` that the module writes to `("next", name)`, as TorchRL's
    `LSTMModule` does; it begins at what the module's `make_tensordict_primer` declares, mostly
    zeros, and again where an episode begins.

    `action` is an index (integers [N] or [N, 1]) or one-hot ([N, actions]).

    Args:
        module: the policy; played in evaluation mode, without gradients, on its parameters' device.
        observation_space, action_space: of one world.
        deterministic: TorchRL's `ExplorationType.DETERMINISTIC` in the place of `RANDOM`.

    Raises:
        ValueError: the module reads something else than these, or declares another action space.
    """

    def __init__(
        self,
        module: TensorDictModuleBase,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        *,
        deterministic: bool,
    ) -> None:
        self.module = module
        self.actions = int(action_space.n)
        kind = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
        self.exploration = kind
        parameter = next(module.parameters(), None)
        self.device = torch.device("cpu") if parameter is None else parameter.device
        self.alone = next(iter(observation_space)) if len(observation_space) == 1 else None

        if "action" not in module.out_keys:
            raise ValueError(f"the policy writes {module.out_keys}; should write 'action'")
        declared = _declared_actions(module)
        if declared not in (None, self.actions):
            raise ValueError(
                f"the policy's spec has {declared} actions, and the action space is {action_space}"
            )
        known = {*observation_space, "is_init", *(["observation"] if self.alone else [])}
        self.initial = _primers(module)
        self.states = [key for key in module.in_keys if key not in known]
        for key in self.states:
            if ("next", key) not in module.out_keys:
                raise ValueError(
                    f"the policy reads {key!r}, which is no observation "
                    f"({', '.join(observation_space)}), not 'is_init', and no recurrent state that "
                    f"it writes to ('next', {key!r})"
                )
            if key not in self.initial:
                raise ValueError(
                    f"the policy's recurrent state {key!r} has no declared shape; give its module "
                    "a make_tensordict_primer, as TorchRL's LSTMModule has"
                )

    def start(self, num_envs: int) -> None:
        self.state = {
            key: self.initial[key].to(self.device).expand(num_envs, *self.initial[key].shape)
            for key in self.states
        }

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        first = torch.from_numpy(is_first).to(self.device)
        given = {name: torch.from_numpy(part).to(self.device) for name, part in observation.items()}
        if self.alone:
            given["observation"] = given[self.alone]
        for key, value in self.state.items():
            mask = first.view(-1, *[1] * (value.ndim - 1))
            given[key] = torch.where(mask, self.initial[key].to(self.device), value)
        given["is_init"] = first.unsqueeze(-1)
        was_training = self.module.training
        self.module.eval()
        try:
            with torch.no_grad(), set_exploration_type(self.exploration):
                output = self.module(TensorDict(given, batch_size=[len(is_first)]))
        finally:
            self.module.train(was_training)
        self.state = {key: output["next", key] for key in self.states}
        return self._index(output["action"])

    def _index(self, action: Tensor) -> NDArray:
        chosen = action.cpu().numpy()
        if chosen.ndim == 2 and chosen.shape[1] == self.actions > 1:
            if not (((chosen == 0) | (chosen == 1)).all() and (chosen.sum(-1) == 1).all()):
                raise ValueError(
                    f"the policy returned actions of shape {chosen.shape} that are not one-hot; "
                    "should be indices [N] or one-hot [N, actions]"
                )
            return chosen.argmax(-1)
        if chosen.ndim == 2 and chosen.shape[1] == 1:
            return chosen[:, 0]
        return chosen


def _primers(module: TensorDictModuleBase) -> dict[str, Tensor]:
    """The recurrent states with which an episode begins, for one world."""
    initial = {}
    for part in module.modules():
        if hasattr(part, "make_tensordict_primer"):
            primer: Any = part.make_tensordict_primer()
            for key, spec in primer.primers.items(True, True):
                default = primer.default_value
                value = default.get(key, 0.0) if isinstance(default, Mapping) else default
                initial[key] = torch.full_like(spec.zero(), value or 0.0)
    return initial


def _declared_actions(module: TensorDictModuleBase) -> int | None:
    """The number of actions by the policy's spec; None where it has none."""
    spec = getattr(module, "spec", None)
    if spec is not None and hasattr(spec, "keys"):
        spec = spec["action"] if "action" in spec.keys() else None
    return getattr(getattr(spec, "space", None), "n", None)
