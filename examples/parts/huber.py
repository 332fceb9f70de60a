"""A critic of one's own: the mean return, learned by a Huber loss."""

from typing import Literal

import torch.nn.functional as F

from zipf.agents.critics import CRITICS, Critic
from zipf.options import Options


class HuberOptions(Options):
    name: Literal["huber"]
    delta: float = 1.0  # as in Mnih et al. 2015


class Huber(Critic):
    size = 1

    def __init__(self, options):
        super().__init__()
        self.delta = options.delta

    def mean(self, outputs):
        return outputs.squeeze(-1)

    def loss(self, outputs, targets):
        return F.huber_loss(self.mean(outputs), targets, reduction="none", delta=self.delta)


CRITICS.register(HuberOptions, Huber)
