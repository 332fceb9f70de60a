"""What a hook is: something else that happens around the steps of a collector.

A hook sees every step of all envs as tensors on the device of the envs; on the host they share
memory with the environment's arrays. Hooks of tensor environments are in `tensor.py`. It may write
to the step's fields, such as the bonus, and add fields of its own to unrolls (`columns`). What it
keeps is part of the collector's saved state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zipf.agents.unroll import STEP, Unroll

Parts = dict[str, Tensor]
OF_EPISODES = {k: STEP[k] for k in ("previous_action", "previous_reward", "action", "reward")}
"""The fields of a step that hindsight keeps, with their dtypes."""


@dataclass
class Row:
    """A step of N envs; valid until the hook returns."""

    # {name: [N, ...]}, which the envs showed before it. Here and below nothing is augmented.
    observation: Parts
    fields: Parts  # {name: [N]}, those of the unroll's row; written to in place
    reward: Tensor  # float64 [N], the task's; of tensor environments float32
    # {name: [N, ...]}, which they show after it: where an episode has ended, the first observation
    # of the next
    following: Parts
    final: Parts  # {name: [N, ...]}, where an episode has ended its last observation
    ended: Tensor  # bool [N]
    any_ended: bool  # whether there are any; True where the host does not know
    # {name: [N, ...]}, where an episode has ended its ranks, `return` and so on; empty where none
    # has
    outcome: Parts


class Hook:
    """The base of hooks; it does nothing."""

    name: ClassVar[str]  # of its entry in a collector's saved state
    # Fields that it adds to the steps of unrolls, by name: an empty tensor of the shape and dtype
    # that a field has in one env.
    columns: Mapping[str, Tensor] = {}

    def begin(self, observation: Parts, mask: Tensor) -> None:
        """Episodes begin where `mask` [N], with these observations {name: [N, ...]}; at the start
        in all envs, and after `load_state_dict` in those that could not be restored."""

    def show(self, fields: Parts) -> None:
        """The envs have shown the observation of a row, whose fields {name: [N, ...]} may be
        written to; called for every row, after `begin`."""

    def act(self, fields: Parts, generator: torch.Generator) -> None:
        """The agent has chosen the step's `action`, int64 [N], which may be replaced; draws are
        from the generator of the agent's actions."""

    def step(self, row: Row) -> None:
        """The envs have made a step. Where episodes have ended `begin` follows."""

    def finish(self, unroll: Unroll) -> None:
        """An unroll is complete; the hook may write to it."""

    def state_dict(self) -> dict[str, Any]:
        """Everything that later calls depend on."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, in which arrays stand in the place of tensors."""

    def tensors(self) -> Parts:
        """With tensor environments, all that it writes in place and that later calls depend on, by
        the names that it is saved by; called in the place of `state_dict`."""
        return {}


def arrays(parts: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The same memory as arrays, for code that has no other form: on a CPU alone."""
    return {name: np.asarray(part) for name, part in parts.items()}
