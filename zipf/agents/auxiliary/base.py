"""What an auxiliary loss is: its base class and the registry of all of them.

To add one, derive from `Auxiliary` and register its options with a function that builds it:

    class MyOptions(AuxiliaryOptions):
        name: Literal["mine"]
        weight: float

    def build(options, space, network, torso, seed):
        return MyLoss(...)

    AUXILIARIES.register(MyOptions, build)
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.encoders import Encoder
from zipf.agents.network import Inputs
from zipf.options import Options
from zipf.registry import Registry

Fraction = Annotated[float, Field(gt=0, le=1)]


class AuxiliaryOptions(Options):
    """Options of an auxiliary loss; each derived class has a name of its own."""

    name: str


class NoAuxiliaryOptions(AuxiliaryOptions):
    """No auxiliary loss."""

    name: Literal["none"]


NO_AUXILIARY = NoAuxiliaryOptions(name="none")


class Auxiliary(nn.Module):
    """The base of all auxiliary losses; its own loss is 0.

    What an update draws at random follows from `seed` and the number of updates before it, which is
    in `state_dict()`: a resumed run draws what the uninterrupted one draws.
    """

    def __init__(self, seed: int):
        super().__init__()
        self.seed = seed
        self.updates = 0

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted loss of an unroll, float32 [], and metrics to log, [] each.

        The loss is a mean over time and batch, as all losses here (`zipf.agents.agent`), from
        `inputs` of T + 1 steps of B envs and the memory's output there, `core` [T + 1, B, size].
        """
        return torch.zeros((), device=core.device), {}

    def learned(self) -> list[nn.Parameter]:
        """The parameters that gradients reach."""
        return [parameter for parameter in self.parameters() if parameter.requires_grad]

    def begin_with(self, encoder: Encoder) -> None:
        """The agent's encoder has taken other weights, before the first update."""
        return

    def after_update(self, encoder: Encoder) -> None:
        """Follows an optimiser step that changed the agent's encoder."""
        self.updates += 1

    def generator(self) -> torch.Generator:
        """Of this update's draws; on the CPU, so that a run can move between devices."""
        return torch.Generator().manual_seed(self.seed + self.updates)

    def get_extra_state(self) -> int:
        """The part of `state_dict()` that is no tensor."""
        return self.updates

    def set_extra_state(self, state: int) -> None:
        """Continues from `get_extra_state()`."""
        self.updates = state


def sample(n: int, fraction: float, generator: torch.Generator) -> Tensor:
    """That fraction of 0 .. n - 1, at least one, in random order."""
    return torch.randperm(n, generator=generator)[: max(1, round(fraction * n))]


AUXILIARIES: Registry[Auxiliary] = Registry("auxiliary")
"""Each is built from its options, the space of an agent's observations, the options of its encoder,
its encoder and memory (a `Torso`), which stay its own, and the seed of what the loss draws;
it raises ValueError where the observations lack what the loss needs."""

build_auxiliary = AUXILIARIES.build

AUXILIARIES.register(
    NoAuxiliaryOptions, lambda options, space, network, torso, seed: Auxiliary(seed)
)
