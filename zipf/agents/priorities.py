"""Draws by priority (Schaul et al. 2016): a sampler for TorchRL's buffer.

Importing this costs the second or so that importing TorchRL takes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler

SMALLEST_PRIORITY = 1e-6  # so that an item whose error was 0 can still be drawn


class PrioritySampler(Sampler):
    """Draws slots of a ring in proportion to priority^exponent, one from each of `batch_size` equal
    parts of the sum (Schaul et al. 2016, appendix B.2.1); its random numbers are its own.

    At most the latest `capacity` items can be drawn. Item number k, from 0 on, is in slot k mod
    `slots`, and its priority in leaf k mod `capacity`: draws do not depend on how much larger the
    ring is. Shapes are fixed, and the host does not wait for a device.

    New items get the largest priority so far, at least 1. An importance weight is (n P)^-exponent
    divided by the largest of its batch, with n the number of items and P the probability of the
    draw.
    """

    def __init__(
        self,
        slots: int,
        capacity: int,
        *,
        priority_exponent: float,
        importance_exponent: float,
        seed: int,
        device: torch.device | str = "cpu",
    ):
        self.slots = slots
        self.capacity = capacity
        self.priority_exponent = priority_exponent
        self.importance_exponent = importance_exponent
        self.generator = torch.Generator().manual_seed(seed)
        self.device = torch.device(device)
        self.inserted: int
        self.leaves: Tensor  # priority^exponent, float64 [capacity]
        self.largest: Tensor  # priority so far, float64 []
        self._empty()

    def __len__(self) -> int:
        return min(self.inserted, self.capacity)

    def extend(self, index: Tensor) -> None:
        """Slots int64 [N] were just written, in this order: N new items, which make as many too old
        to be drawn once the capacity is reached."""
        numbers = torch.arange(self.inserted, self.inserted + len(index), device=self.device)
        self.leaves[numbers % self.capacity] = self.largest**self.priority_exponent
        self.inserted += len(index)

    def sample(self, storage: Any, batch_size: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Slots int64 [N], and `weight` float32 [N]."""
        # Whole numbers, whose cumulative sums are exact, and deterministic on CUDA; those of items
        # that can be drawn are at least 1.
        sizes = (self.leaves * (2.0**40 / self.leaves.max())).ceil().to(torch.int64)
        ends = sizes.cumsum(0)
        parts = torch.arange(batch_size, device=self.device)
        mass = (parts + self._offsets(batch_size)) * (ends[-1].double() / batch_size)
        mass = torch.minimum(mass.to(torch.int64), ends[-1] - 1)  # which rounding may pass
        leaf = torch.searchsorted(ends, mass, right=True)
        probability = self.leaves[leaf] / self.leaves.sum()
        weight = (len(self) * probability) ** -self.importance_exponent
        slots = self._latest(leaf, self.capacity) % self.slots
        return slots, {"weight": (weight / weight.max()).float()}

    def update_priority(self, index: Any, priority: Any, *, storage: Any = None) -> None:
        """The priorities float [N] of slots int64 [N], of items that can be drawn."""
        priorities = priority.double().clamp(min=SMALLEST_PRIORITY)
        leaves = self._latest(index, self.slots) % self.capacity
        self.leaves[leaves] = priorities**self.priority_exponent
        self.largest.copy_(torch.maximum(self.largest, priorities.max()))

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next draw depends on."""
        return {
            "inserted": self.inserted,
            "max_priority": float(self.largest),
            "leaves": self.leaves.cpu().clone(),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.inserted = state_dict["inserted"]
        self.largest.fill_(state_dict["max_priority"])
        self.leaves.copy_(state_dict["leaves"])
        self.generator.set_state(state_dict["generator"])

    def dumps(self, path: Any) -> None:
        """Writes a file into the folder `path`."""
        torch.save(self.state_dict(), Path(path) / "sampler.pt")

    def loads(self, path: Any) -> None:
        """Reads what `dumps` wrote."""
        self.load_state_dict(torch.load(Path(path) / "sampler.pt"))

    def _empty(self) -> None:
        self.inserted = 0
        self.leaves = torch.zeros(self.capacity, dtype=torch.float64, device=self.device)
        self.largest = torch.ones((), dtype=torch.float64, device=self.device)

    def _latest(self, places: Tensor, length: int) -> Tensor:
        """The numbers of the latest items in these places of a ring of that length."""
        last = self.inserted - 1
        return last - (last - places) % length

    def _offsets(self, count: int) -> Tensor:
        offsets = torch.rand(count, generator=self.generator, dtype=torch.float64)
        if self.device.type == "cpu":
            return offsets
        return offsets.pin_memory().to(self.device, non_blocking=True)
