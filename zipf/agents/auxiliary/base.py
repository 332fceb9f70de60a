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

from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from zipf.agents.encoders import Encoder
from zipf.agents.network import Inputs
from zipf.options import Options
from zipf.registry import Registry


class AuxiliaryOptions(Options):
    """Options of an auxiliary loss; each derived class has a name of its own.

    With `averages` the loss itself averages over several learners, which no CUDA graph can hold.
    """

    averages: ClassVar[bool] = False
    name: str


class NoAuxiliaryOptions(AuxiliaryOptions):
    """No auxiliary loss."""

    name: Literal["none"]


NO_AUXILIARY = NoAuxiliaryOptions(name="none")


class Auxiliary(nn.Module):
    """The base of all auxiliary losses; its own loss is 0.

    What an update draws at random follows from `seed`, the number of updates before it, which is in
    `state_dict()`, and the kind of device: a resumed run draws what the uninterrupted one draws.
    """

    def __init__(self, seed: int):
        super().__init__()
        self.seed = seed
        self.updates = 0
        self._generator: torch.Generator | None = None  # on a device other than the CPU

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
        """Follows an optimiser step that changed the agent's encoder; `count` comes after it."""
        return

    def count(self, updates: int) -> None:
        """So many updates were made. On the host, and never captured."""
        self.updates = updates
        for generator in self.generators():
            generator.manual_seed(self.seed + updates)

    def generator(self) -> torch.Generator:
        """Of this update's draws, on the device of the parameters, the CPU where there are none; to
        be called once an update."""
        device = self._device()
        if device.type == "cpu":
            return torch.Generator().manual_seed(self.seed + self.updates)
        if self._generator is None:
            self._generator = torch.Generator(device)
            self._generator.manual_seed(self.seed + self.updates)
        return self._generator

    def generators(self) -> list[torch.Generator]:
        """Those that updates draw from on a device other than the CPU, always the same objects: a
        CUDA graph has to know them. `count` seeds them for the next update."""
        return [] if self._device().type == "cpu" else [self.generator()]

    def _device(self) -> torch.device:
        parameter = next(self.parameters(), None)
        return torch.device("cpu") if parameter is None else parameter.device

    def get_extra_state(self) -> int:
        """The part of `state_dict()` that is no tensor."""
        return self.updates

    def set_extra_state(self, state: int) -> None:
        """Continues from `get_extra_state()`."""
        self.count(state)


def sample(n: int, fraction: float, generator: torch.Generator) -> Tensor:
    """That fraction of 0 .. n - 1, at least one, in random order, on the generator's device."""
    order = torch.randperm(n, generator=generator, device=generator.device)
    return order[: max(1, round(fraction * n))]


AUXILIARIES: Registry[Auxiliary] = Registry("auxiliary")
"""Each is built from its options, the space of an agent's observations, the options of its encoder,
its encoder and memory (a `Torso`), which stay its own, and the seed of what the loss draws;
it raises ValueError where the observations lack what the loss needs."""

build_auxiliary = AUXILIARIES.build

AUXILIARIES.register(
    NoAuxiliaryOptions, lambda options, space, network, torso, seed: Auxiliary(seed)
)
