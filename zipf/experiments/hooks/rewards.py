"""What an agent learns of rewards and time limits, where it is not what the envs say."""

from __future__ import annotations

import torch
from torch import Tensor

from zipf.experiments.hooks.hook import Hook, Row


class SoftAsymmetric(Hook):
    """Rewards that are learned from are squashed (see `soft_asymmetric`); the previous rewards in
    the agent's input and episodes' returns stay as they are."""

    name = "reward_clipping"

    def step(self, row: Row) -> None:
        row.fields["reward"][:] = soft_asymmetric(row.reward.double())


def soft_asymmetric(reward: Tensor) -> Tensor:
    """Rewards, float64 [N], squashed to -1.5 .. 5, bad ones to a third of what good ones of their
    size are.

    `5 tanh(r / 5)`, times 0.3 where r < 0, as the code of Espeholt et al. 2018 has it; the paper
    prints it without the division.
    """
    squashed = (reward / 5.0).tanh()
    return 5.0 * torch.where(reward < 0, 0.3 * squashed, squashed)


class TimeLimitsEnd(Hook):
    """A time limit counts as the end of the task: no value is expected beyond it."""

    name = "time_limits"

    def step(self, row: Row) -> None:
        if row.any_ended:
            row.fields["terminated"][:] = row.ended
            row.fields["truncated"].zero_()
