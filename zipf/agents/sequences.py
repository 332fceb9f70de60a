"""Cutting of unrolls and relabelled episodes into the sequences that R2D2's replay holds.

A sequence is a TensorDict: `steps` [burn_in + T + 1], the rows of one env; `memory`, the agent's
before them; and, where there is room for them, `final` [K], the observations that the unroll's
episodes were truncated at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

import gymnasium as gym
import torch
from tensordict import TensorDict

from zipf.agents.memory import State
from zipf.agents.unroll import FINAL, STEP, Unroll, no_observations


@dataclass(eq=False)
class Sequences:
    """Cuts what a collector gives into sequences, and keeps the burn-in of the next ones."""

    observation_space: gym.spaces.Dict  # of one env
    _: KW_ONLY
    num_envs: int  # B, the envs of an unroll
    unroll_length: int  # T
    burn_in: int  # rows of a sequence before its unroll
    final_observations: int  # K, for how many of these a sequence has room; 0: it has none
    weighted: bool  # whether steps have a weight
    draws: int = 0  # D, how many numbers an augmentation draws for an episode
    device: str = "cpu"  # of the sequences

    def __post_init__(self) -> None:
        self.rows = self.burn_in + self.unroll_length + 1
        self._fields = STEP | ({"weight": torch.float32} if self.weighted else {})
        self._names = ["observation", *self._fields, *(["draw"] if self.draws else [])]
        self._prefix: TensorDict | None = None  # [burn_in, B], the rows before the next unroll
        self._prefix_memory: State = {}  # before them

    def empty(self, memory: State) -> TensorDict:
        """A sequence of zeros; `memory` is that of a batch of one env."""
        item = {"steps": self._empty(self.rows, self._fields)}
        if self.final_observations:
            item["final"] = self._empty(self.final_observations, FINAL)
        of_env = {name: part[0].to(self.device) for name, part in memory.items()}
        return TensorDict({**item, "memory": TensorDict(of_env)})

    def of_unroll(self, unroll: Unroll) -> TensorDict | None:
        """The sequences [B] of an unroll; None for a run's first where there is a burn-in."""
        item = {}
        if self.final_observations:
            assert unroll.final is not None
            item["final"] = unroll.final.to(self.device).transpose(0, 1)
        steps = unroll.steps.select(*self._names)
        steps["reward"] = unroll.steps["reward"] + unroll.steps["bonus"]
        steps = steps.to(self.device)
        memory = unroll.memory
        if self.burn_in:
            prefix, memory = self._prefix, self._prefix_memory
            # The collector overwrites the rows of an unroll, and of tensor environments its memory.
            self._prefix = steps[self.unroll_length - self.burn_in : self.unroll_length].clone()
            assert unroll.late_memory is not None
            self._prefix_memory = {name: part.clone() for name, part in unroll.late_memory.items()}
            if prefix is None:
                return None
            steps = torch.cat([prefix, steps])
        item["steps"] = steps.transpose(0, 1)
        of_envs = {name: part.to(self.device) for name, part in memory.items()}
        item["memory"] = TensorDict(of_envs, self.num_envs)
        return TensorDict(item, self.num_envs)

    def of_episodes(
        self, episodes: TensorDict, memory: State, advance: Callable[[TensorDict, State], State]
    ) -> Iterator[TensorDict]:
        """The sequences [N] of relabelled episodes [L, E], those of their first frames first.

        The rows before an episode's first and behind its last are empty: an episode begins and is
        truncated in each of them, at an observation that is not there, so that they have no error.
        `advance` gives the memory after steps [rows, E] from that before them.
        """
        rows, count = episodes.shape
        length, burn_in = self.unroll_length, self.burn_in
        cuts = -(-rows // length)
        steps = self._empty(burn_in + cuts * length + 1, self._fields)
        steps["previous_action"].fill_(-1)
        steps["is_first"].fill_(True)
        steps["truncated"].fill_(True)
        steps = steps.unsqueeze(1).expand(len(steps), count).clone()
        if self.weighted:
            episodes = episodes.clone(recurse=False)
            episodes["weight"] = episodes["mask"].float()
        episodes = episodes.to(self.device)
        steps[burn_in : burn_in + rows] = episodes.select(*self._names)
        steps["truncated"][burn_in : burn_in + rows] |= ~episodes["mask"]
        lengths = episodes["mask"].sum(0)
        for cut in range(cuts):
            start = cut * length  # of the burn-in's rows, in `steps`
            there = (lengths > start).nonzero().flatten()
            if not len(there):  # a device has as many rows as the longest episode may have
                return
            item = {"steps": steps[start : start + self.rows, there].transpose(0, 1)}
            before = {name: part.to(self.device)[there] for name, part in memory.items()}
            item["memory"] = TensorDict(before, len(there))
            if self.final_observations:
                finals = self._empty(self.final_observations, FINAL)
                finals["step"].fill_(-1)
                shape = len(there), self.final_observations
                item["final"] = finals.unsqueeze(0).expand(shape).clone()
            yield TensorDict(item, len(there))
            following = steps[max(start, burn_in) : start + length]
            if cut + 1 < cuts and len(following):  # those until the next sequence's burn-in
                memory = advance(following, memory)

    def _empty(self, rows: int, fields: Mapping[str, torch.dtype]) -> TensorDict:
        """Zeros [rows] in the place of these fields and an observation."""
        zeros = TensorDict({name: torch.zeros(rows, dtype=t) for name, t in fields.items()}, rows)
        zeros["observation"] = TensorDict(no_observations(self.observation_space, rows), rows)
        if self.draws:
            zeros["draw"] = torch.zeros(rows, self.draws, dtype=torch.float64)
        return zeros.to(self.device)

    def carried(self) -> dict[str, Any]:
        """The burn-in of the next sequences of these envs."""
        if self._prefix is None:
            return {}
        return {"steps": self._prefix.to_dict(), "memory": dict(self._prefix_memory)}

    def carry(self, carried: dict[str, Any], device: str) -> None:
        """Goes on with what `carried()` gave; `{}`: the next unroll is taken as a run's first."""
        self._prefix, self._prefix_memory = None, {}
        if carried:
            steps = TensorDict(carried["steps"], (self.burn_in, self.num_envs))
            self._prefix = steps.to(self.device)
            self._prefix_memory = {k: v.to(device) for k, v in carried["memory"].items()}
