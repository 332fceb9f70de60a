"""Draws one row of every episode, and writes it to the dictionary when the episode has ended.

The row is of a frame of the episode that is drawn uniformly (reservoir sampling: Vitter 1985), as
far as an update has learned from the episode's frames. Its key is made of the memory's output
there, and its value is that output, as in Ritter et al. 2018 and Fernandes et al. 2022. With
`outcome` it also has, for each action, whether it was taken (1 or 0) and, if so, the discounted
return that followed, squashed by sign(G) log(1 + |G|); a weighted mean of these over neighbours is
the return of each action in similar frames, times how often it was taken, as Pritzel et al. 2017
keep values for each action.

Rows of an episode are read in later episodes only: an unroll never finds its own future. (Episodes
that are kept and learned from again would; `hindsight.kept_per_goal` is refused with it.)
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor, nn

from zipf.agents.encoders import Encoder
from zipf.agents.episodic.dictionary import Dictionary
from zipf.agents.episodic.options import DictionarySizes


class Rows(NamedTuple):
    """Rows of episodes that have ended."""

    cores: Tensor  # float32 [N, size]
    values: Tensor  # float32 [N, value size]
    observations: dict[str, Tensor]  # {name: [N, ...]}


class Recorder(nn.Module):
    """The recorder of agents without episodic memory: it records nothing, and its loss is 0."""

    def forward(self, encoder: Encoder) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted loss of an update, float32 [], and metrics, [] each; its gradients reach
        `encoder`."""
        return torch.zeros((), device=next(encoder.parameters()).device), {}

    def record(
        self, dictionary: Dictionary | None, steps: TensorDict, core: Tensor, action: Tensor
    ) -> None:
        """Follows an optimiser step: writes the rows of the unroll's episodes that have ended, from
        its steps [T + 1, B], the memory's outputs there, [T + 1, B, size], and actions int64 [T +
        1, B]: what was done, or what a teacher says should have been."""

    def carried(self) -> dict[str, Tensor]:
        """A copy of what is kept of the episodes that the envs are in."""
        return {}

    def carry(self, carried: dict[str, Tensor]) -> None:
        """Goes on with other envs, of which this is what `carried()` was; empty: none of their
        episodes' frames has been learned from."""


class DictionaryRecorder(Recorder):
    """Draws a row of every episode and writes it when the episode ends. All draws follow from the
    seed and the number of updates, which is saved. `observations` {name: zeros [B, ...]} are the
    parts of observations that rows have."""

    updates: Tensor
    age: Tensor
    core: Tensor
    action: Tensor
    return_: Tensor
    factor: Tensor

    def __init__(
        self,
        options: DictionarySizes,
        envs: int,
        core_size: int,
        actions: int,
        seed: int,
        observations: dict[str, Tensor] | None = None,
    ):
        super().__init__()
        self.options = options
        self.actions = actions
        self.seed = seed
        self.register_buffer("updates", torch.zeros((), dtype=torch.int64))
        # Of the episode that each env is in: its frames so far, and the row drawn among them.
        self.register_buffer("age", torch.zeros(envs, dtype=torch.int64))
        self.register_buffer("core", torch.zeros(envs, core_size))
        self.register_buffer("action", torch.zeros(envs, dtype=torch.int64))
        self.register_buffer("return_", torch.zeros(envs))  # from that row on
        self.register_buffer("factor", torch.ones(envs))  # the discount of the next reward
        self.observations = sorted(observations or {})
        self._register("observation", observations or {})

    @torch.no_grad()
    def record(
        self, dictionary: Dictionary | None, steps: TensorDict, core: Tensor, action: Tensor
    ) -> None:
        assert dictionary is not None
        device = self.core.device
        length, envs = len(core) - 1, core.shape[1]
        draws = torch.rand(length, envs, generator=self.generator()).to(device)
        ends = (steps["terminated"] | steps["truncated"])[:-1]
        age, return_, factor = self.age, self.return_, self.factor
        source = torch.full((envs,), -1, device=device)  # the row's frame; -1: before the unroll
        sources, returns = [], []
        for t in range(length):
            age = age.masked_fill(steps["is_first"][t], 0) + 1
            drawn = draws[t] * age < 1  # with probability 1 / age
            source = torch.where(drawn, t, source)
            factor = factor.masked_fill(drawn, 1.0)
            return_ = return_.masked_fill(drawn, 0.0) + factor * steps["reward"][t]
            factor = factor * self.options.discount
            sources.append(source)
            returns.append(return_)
        t, env = ends.nonzero(as_tuple=True)
        source_t, return_t = torch.stack(sources)[t, env], torch.stack(returns)[t, env]
        rows = self._rows(source_t, env, return_t, steps, core, action)
        self.write(dictionary, rows)
        everywhere = torch.arange(envs, device=device)
        self.core.copy_(pick(self.core, core.float(), source, everywhere))
        self.action.copy_(pick(self.action, action, source, everywhere))
        for name, pending in self._registered("observation").items():
            pending.copy_(pick(pending, steps["observation", name], source, everywhere))
        self.age.copy_(age.masked_fill(ends[-1], 0))
        self.return_.copy_(return_)
        self.factor.copy_(factor)
        self.updates += 1

    def carried(self) -> dict[str, Tensor]:
        return {name: getattr(self, name).clone() for name in self._of_episodes()}

    def carry(self, carried: dict[str, Tensor]) -> None:
        if not carried:  # the age of an episode says whether the rest is in use
            self.age.zero_()
        for name, value in carried.items():
            getattr(self, name).copy_(value)

    def _register(self, prefix: str, parts: dict[str, Tensor]) -> None:
        """Registers buffers of observations by number: a part's name may have a dot, a buffer's may
        not."""
        for k, name in enumerate(self.observations):
            self.register_buffer(f"{prefix}_{k}", parts[name])

    def _registered(self, prefix: str) -> dict[str, Tensor]:
        """These buffers by the parts' names."""
        return {name: getattr(self, f"{prefix}_{k}") for k, name in enumerate(self.observations)}

    def _of_episodes(self) -> list[str]:
        pending = [f"observation_{k}" for k in range(len(self.observations))]
        return ["age", "core", "action", "return_", "factor", *pending]

    def write(self, dictionary: Dictionary, rows: Rows) -> None:
        """Writes rows to the dictionary, which keeps the latest."""
        priorities = self.updates.double().expand(len(rows.cores))
        dictionary.write(rows.cores, rows.values, priorities)

    def generator(self) -> torch.Generator:
        """Of this update's draws; on the CPU, so that a run can move between devices."""
        return torch.Generator().manual_seed(self.seed + int(self.updates))

    def _rows(
        self,
        source: Tensor,
        env: Tensor,
        return_: Tensor,
        steps: TensorDict,
        core: Tensor,
        action: Tensor,
    ) -> Rows:
        cores = pick(self.core, core, source, env).float()
        values = cores
        if self.options.outcome:
            taken = F.one_hot(pick(self.action, action, source, env), self.actions).float()
            squashed = return_.sign() * return_.abs().log1p()
            values = torch.cat([cores, taken, taken * squashed.unsqueeze(-1)], -1)
        observations = {
            name: pick(pending, steps["observation", name], source, env)
            for name, pending in self._registered("observation").items()
        }
        return Rows(cores, values, observations)


def pick(before: Tensor, unroll: Tensor, source: Tensor, env: Tensor) -> Tensor:
    """`unroll[source, env]` of unroll [T + 1, B, ...], or `before[env]` [B, ...] where `source` is
    -1."""
    inside = (source >= 0).view(-1, *[1] * (before.ndim - 1))
    return torch.where(inside, unroll[source.clamp(min=0), env], before[env])
