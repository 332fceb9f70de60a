"""The unroll: the data that an agent learns from in one update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.capture import mapped
from zipf.agents.memory import State

STEP = {
    "previous_action": torch.int64,
    "previous_reward": torch.float32,
    "is_first": torch.bool,
    "action": torch.int64,
    "reward": torch.float32,
    "terminated": torch.bool,
    "truncated": torch.bool,
}
"""The fields of a step that every agent needs, beside the observation; see `Unroll`."""
FINAL = {
    "step": torch.int64,
    "previous_action": torch.int64,
    "previous_reward": torch.float32,
    "is_first": torch.bool,
}
"""The fields of an observation that an episode was cut at, beside the observation."""


class Augmentation(Protocol):
    """Changes what an agent sees of an episode, as numbers say that were drawn for it.

    Attributes:
        size: how many numbers, D. All zero, of rows that stand for no frame, they change nothing.
        on_device: whether it is called with tensors of the agent's device, as a part of an update
            that may be captured (`zipf.agents.capture`); else with those in RAM.
    """

    size: int
    on_device: bool

    def __call__(self, observation: Mapping[str, Tensor], draw: Tensor | None) -> dict[str, Tensor]:
        """Changed copies of observations {name: [*batch, ...]}, with their `draw`, float64
        [*batch, D]; None where steps have none."""
        ...


def changed(steps: TensorDict, augmentation: Augmentation) -> TensorDict:
    """Steps [...] with their observations as their `draw` changes them, None where nothing was
    drawn; all else is shared."""
    observation = dict(steps["observation"].items())
    seen = steps.clone(recurse=False)
    seen["observation"] = TensorDict(
        augmentation(observation, steps.get("draw", None)), steps.batch_size
    )
    return seen


def no_observations(space: gym.spaces.Dict, rows: int) -> dict[str, Tensor]:
    """Zeros in the place of observations of a space, {name: [rows, ...]}.

    Raises:
        ValueError: a part has a dtype of which PyTorch cannot pick and replace rows.
    """
    zeros = {}
    for name, part in space.items():
        if part.dtype in (np.uint16, np.uint32, np.uint64):
            raise ValueError(
                f"{name!r} of the observations is {part.dtype}, which cannot be kept: expected "
                "bool, uint8, a signed integer or a float"
            )
        zeros[name] = torch.from_numpy(np.zeros((rows, *(part.shape or ())), part.dtype))
    return zeros


@dataclass(frozen=True)
class Needs:
    """What an agent needs of unrolls beyond what all have.

    Attributes:
        burn_in: rows at an unroll's end that are also the prefix of the next; where it is not 0
            an unroll holds the memory before them (`Unroll.late_memory`).
        final_observations: of each env an unroll holds up to so many of the observations at
            which episodes were truncated (`Unroll.final`), for agents that compute their values
            when they learn; those agents need no `value`.
        teacher: name of the scripted policy of the envs that labels every step of an unroll with
            the action that it would take (`zipf.envs.SCRIPTED`); None: no labels.
        teacher_share: the probability that the teacher acts in a step in the agent's place.
    """

    burn_in: int = 0
    final_observations: int = 0
    teacher: Literal["expert", "generalist"] | None = None
    teacher_share: float = 0.0


@dataclass
class Unroll:
    """T steps of B envs, time-major; row T is the first row of the next unroll.

    `steps`, a TensorDict [T + 1, B], holds in row t
        observation: {name: [T + 1, B, ...]} as the envs show it, in their dtypes
        previous_action: int64, the action that led here, -1 where an episode begins
        previous_reward: float32, the task reward that came with it, 0 where an episode begins
        is_first: bool, an episode begins here
        action: int64, the agent's action
        reward: float32, the task reward that followed
        bonus: float32, the exploration bonus that followed, 0 without exploration
        terminated: bool, the episode ended for good after the action
        truncated: bool, the episode was cut after the action
        label: int64, the teacher's action; only for agents with a `teacher`
        weight: float32, of the frame in the loss; only with `reweighting`
        draw: float64 [T + 1, B, D], how the augmentation changes the observation; only with one
        truncation_value: float32, the behaviour's value of the observation it was cut at, else 0
        and what the agent's `act` returned beside the action (IMPALA: `logits` float32 [actions])
    In row T only the first four and `draw` are valid; the others are in row 0 of the next unroll.

    `memory` is the agent's memory before row 0, {name: [B, ...]}, and `late_memory` that before row
    T - burn_in, for agents that learn from the last `burn_in` rows and the next unroll together.

    `final`, a TensorDict [K, B] for agents that ask for K `final_observations`, holds the inputs of
    the observations that episodes were cut at, the first K of each env:
        step: int64, after the action of which row the episode was cut, ascending; -1: not in use
        observation: {name: [K, B, ...]}
        previous_action: int64, the action of that row
        previous_reward: float32, the task reward of that row
        is_first: bool, False
        draw: float64 [K, B, D], that of the episode

    `episodes`, a TensorDict [L, E] with hindsight, holds episodes that ended in the unroll, or with
    a memory of goals earlier ones, relabelled with what they achieved; None where there are none.
    With a memory and a teacher some are as they were asked for, with its labels as `action`. Row 0
    is the first frame, or with `hindsight.length` the first of so many last ones:
        observation, previous_action, previous_reward, action, reward, draw, as in `steps`
        mask: bool, False behind the end of an episode that is shorter than L
        is_first: bool, row 0 and behind the end
        terminated: bool, the last step
        truncated: bool, False
        region: float32 [L, E, 4], with a matching cost: the part of the image that the action
            points at, as `ZipfVectorEnv.action_regions`
        achieved: bool, with a memory of goals: whether the episode achieved what it asks for
    """

    steps: TensorDict
    memory: State
    late_memory: State | None = None
    final: TensorDict | None = None
    episodes: TensorDict | None = None

    def state_dict(self) -> dict[str, Any]:
        """The same as nested dictionaries of tensors; `final` and `episodes` are {} for None."""
        return {
            "steps": self.steps.to_dict(),
            "memory": dict(self.memory),
            "late_memory": self.late_memory,
            "final": {} if self.final is None else self.final.to_dict(),
            "episodes": {} if self.episodes is None else self.episodes.to_dict(),
        }

    @classmethod
    def of_state(cls, state: dict[str, Any]) -> Unroll:
        """The unroll of a `state_dict()`."""
        steps = TensorDict(state["steps"], state["steps"]["reward"].shape)
        final = episodes = None
        if state["final"]:
            final = TensorDict(state["final"], state["final"]["step"].shape)
        if state["episodes"]:
            episodes = TensorDict(state["episodes"], state["episodes"]["mask"].shape)
        return cls(steps, state["memory"], state["late_memory"], final, episodes)

    def changed(self, augmentation: Augmentation | None) -> Unroll:
        """The same as the agent sees it; None: there is no augmentation."""
        if augmentation is None:
            return self

        def seen(part: TensorDict | None) -> TensorDict | None:
            return None if part is None else changed(part, augmentation)

        steps = changed(self.steps, augmentation)
        return replace(self, steps=steps, final=seen(self.final), episodes=seen(self.episodes))

    def part(self, k: int, parts: int) -> Unroll:
        """Every `parts`-th env, from env k on, and as many of the relabelled episodes; shares
        memory."""

        def some(part: TensorDict | None) -> TensorDict | None:
            chosen = None if part is None else part[:, k::parts]
            return chosen if chosen is not None and chosen.shape[1] else None

        memory = {name: value[k::parts] for name, value in self.memory.items()}
        late = self.late_memory and {n: v[k::parts] for n, v in self.late_memory.items()}
        return Unroll(self.steps[:, k::parts], memory, late, some(self.final), some(self.episodes))

    def clone(self) -> Unroll:
        """A copy that shares nothing."""
        copy: Unroll = mapped(self, lambda _, tensor: tensor.clone())
        return copy

    def to(self, device: str) -> Unroll:
        """The same on another device."""
        moved: Unroll = mapped(self, lambda _, tensor: tensor.to(device, non_blocking=True))
        return moved


def weighted(losses: Tensor, steps: TensorDict) -> Tensor:
    """Losses of the frames [T, B] of an unroll's `steps`, times their weights if they have any."""
    return losses * steps["weight"] if "weight" in steps.keys() else losses
