"""Observations that episodes were truncated at, in the sequences that an agent learns from."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor

from zipf.agents import fixed
from zipf.agents.network import Inputs


class Finals:
    """Observations that episodes were cut at, [K, B] as `Unroll` has them, as rows of the sequences
    of T + 1 rows that they belong to.

    Each stands behind the row before the cut, where the memory is that of its episode; the row
    behind it begins another episode, and nothing of it remains.

    In fixed shapes (`zipf.agents.fixed`) there are K of these rows whatever is in use, else as many
    as the env that has most of them uses; below K stands for either.
    """

    def __init__(self, final: TensorDict, rows: int):
        most = len(final)
        if not fixed.shapes(final["step"]):
            most = int((final["step"] >= 0).sum(0).max())  # those not in use are the last
        self.final = final[:most]
        self.step = step = self.final["step"]  # [K, B]
        self.used = step >= 0
        t = torch.arange(rows, device=step.device)
        earlier = (self.used & (step < t.view(-1, 1, 1))).sum(1)  # [T + 1, B]
        place = torch.arange(most, device=step.device).unsqueeze(-1)
        self.rows = t.unsqueeze(-1) + earlier  # of the sequences' rows among all rows, [T + 1, B]
        self.places = torch.where(self.used, step + 1, rows) + place  # of the others, [K, B]
        self.envs = torch.arange(step.shape[1], device=step.device)

    def insert(self, inputs: Inputs) -> Inputs:
        """`[T + 1, B]` -> `[T + 1 + K, B]`; the last rows repeat row T where a
        env has fewer observations than others."""
        if not len(self.places):
            return inputs

        def merged(rows: Tensor, finals: Tensor) -> Tensor:
            every = rows.new_empty(len(rows) + len(finals), *rows.shape[1:])
            every[self.rows, self.envs] = rows
            used = self.used.view(*self.used.shape, *[1] * (rows.ndim - 2))
            every[self.places, self.envs] = torch.where(used, finals, rows[-1])
            return every

        cut = Inputs.of(self.final)
        observation = {
            name: merged(part, cut.observation[name]) for name, part in inputs.observation.items()
        }
        pairs = zip(inputs[1:], cut[1:], strict=True)
        return Inputs(observation, *(merged(*pair) for pair in pairs))

    def without(self, rows: Tensor) -> Tensor:
        """`[T + 1 + K, B, ...]` -> `[T + 1, B, ...]`, the sequences' rows."""
        return rows if not len(self.places) else rows[self.rows, self.envs]

    def by_step(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """From values [T + 1 + K, B]: after which steps there was an observation, bool [T, B], and
        its value there, else 0, [T, B]."""
        steps, batch = len(self.rows) - 1, len(self.envs)
        at = torch.where(self.used, self.step, steps)  # those not in use: a row that is dropped
        known = torch.zeros(steps + 1, batch, dtype=torch.bool, device=values.device)
        found = values.new_zeros(steps + 1, batch)
        known.scatter_(0, at, self.used)
        found.scatter_(0, at, values[self.places, self.envs])
        return known[:-1], found[:-1]
