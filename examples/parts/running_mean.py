"""A memory of one's own: a dense layer, and its moving average over the episode."""

from typing import Literal

import torch
from torch import nn

from zipf.agents.memory import MEMORIES
from zipf.options import Options


class RunningMeanOptions(Options):
    name: Literal["running_mean"]
    size: int = 128
    decay: float = 0.9  # ours: ten steps


class RunningMean(nn.Module):
    def __init__(self, options, inputs):
        super().__init__()
        self.size, self.decay = 2 * options.size, options.decay
        self.read = nn.Linear(inputs, options.size)

    def initial_state(self, batch):
        return {"mean": torch.zeros(batch, self.size // 2, device=self.read.weight.device)}

    def forward(self, inputs, is_first, state):
        read, mean, rows = self.read(inputs).relu(), state["mean"], []
        for now, begins in zip(read, is_first.unsqueeze(-1), strict=True):
            mean = self.decay * mean.masked_fill(begins, 0.0) + (1 - self.decay) * now
            rows.append(torch.cat([now, mean], -1))
        return torch.stack(rows), {"mean": mean.float()}


MEMORIES.register(RunningMeanOptions, RunningMean)
