"""Draws by priority (Schaul et al. 2016): a sum tree, and samplers for TorchRL's buffer.

Importing this costs the second or so that importing TorchRL takes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler

from zipf.compiled import compiled

SMALLEST_PRIORITY = 1e-6  # so that an item whose error was 0 can still be drawn


class SumTree:
    """Numbers that can be changed, and drawn in proportion to their size, in O(log size) steps.

    A binary heap of float64: the numbers are its leaves, every node is the sum of its children.
    """

    def __init__(self, size: int):
        self.first_leaf = 1 << (size - 1).bit_length()
        self.nodes = np.zeros(2 * self.first_leaf)
        self.leaves = self.nodes[self.first_leaf : self.first_leaf + size]

    @property
    def total(self) -> float:
        """The sum of all."""
        return float(self.nodes[1])

    def set(self, index: NDArray[np.int64], value: NDArray[np.float64]) -> None:
        """Changes numbers; where an index occurs twice, its last value counts."""
        _set(self.nodes, self.first_leaf, index, value)

    def find(self, mass: NDArray[np.float64]) -> NDArray[np.int64]:
        """The index i of each mass with sum(numbers before i) <= mass < sum(numbers up to i)."""
        return _find(self.nodes, self.first_leaf, mass)


@compiled()
def _set(nodes, first_leaf, index, value):
    for i in range(len(index)):
        node = first_leaf + index[i]
        nodes[node] = value[i]
        while node > 1:
            node >>= 1
            nodes[node] = nodes[2 * node] + nodes[2 * node + 1]


@compiled()
def _find(nodes, first_leaf, mass):
    index = np.empty(len(mass), np.int64)
    for i in range(len(mass)):
        node, rest = 1, mass[i]
        while node < first_leaf:
            node *= 2
            # Even if the rest is off by rounding errors, a leaf that is 0 is never reached.
            if rest >= nodes[node] and nodes[node + 1] > 0:
                rest -= nodes[node]
                node += 1
        index[i] = node - first_leaf
    return index


class PrioritySampler(Sampler):
    """Draws slots of a ring in proportion to priority^exponent, one from each of `batch_size` equal
    parts of the sum (Schaul et al. 2016, appendix B.2.1); its random numbers are its own.

    At most the latest `capacity` items can be drawn. Item number k, from 0 on, is in slot k mod
    `slots`, and its priority in leaf k mod `capacity` of the tree: draws do not depend on how much
    larger the ring is.

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
    ):
        self.slots = slots
        self.capacity = capacity
        self.priority_exponent = priority_exponent
        self.importance_exponent = importance_exponent
        self.generator = torch.Generator().manual_seed(seed)
        self.inserted: int
        self.max_priority: float
        self.tree: SumTree
        self._empty()

    def __len__(self) -> int:
        return min(self.inserted, self.capacity)

    def extend(self, index: Tensor) -> None:
        """Slots int64 [N] were just written, in this order: N new items, which make as many too old
        to be drawn once the capacity is reached."""
        numbers = self.inserted + np.arange(len(index))
        newest = self.max_priority**self.priority_exponent
        self.tree.set(numbers % self.capacity, np.full(len(index), newest))
        self.inserted += len(index)

    def sample(self, storage: Any, batch_size: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Slots int64 [N], and `weight` float32 [N]."""
        offsets = torch.rand(batch_size, generator=self.generator, dtype=torch.float64).numpy()
        mass = (np.arange(batch_size) + offsets) * (self.tree.total / batch_size)
        leaves = self.tree.find(mass)
        probability = self.tree.leaves[leaves] / self.tree.total
        weight = (len(self) * probability) ** -self.importance_exponent
        weight = (weight / weight.max()).astype(np.float32)
        slots = self._latest(leaves, self.capacity) % self.slots
        return torch.from_numpy(slots), {"weight": torch.from_numpy(weight)}

    def update_priority(self, index: Any, priority: Any, *, storage: Any = None) -> None:
        """The priorities float [N] of slots int64 [N], of items that can be drawn."""
        priorities = np.maximum(priority.cpu().numpy().astype(np.float64), SMALLEST_PRIORITY)
        leaves = self._latest(index.numpy(), self.slots) % self.capacity
        self.tree.set(leaves, priorities**self.priority_exponent)
        self.max_priority = max(self.max_priority, float(priorities.max()))

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next draw depends on."""
        return {
            "inserted": self.inserted,
            "max_priority": self.max_priority,
            "leaves": torch.from_numpy(self.tree.leaves.copy()),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self._empty()
        self.inserted = state_dict["inserted"]
        self.max_priority = state_dict["max_priority"]
        self.tree.set(np.arange(self.capacity), state_dict["leaves"].numpy())
        self.generator.set_state(state_dict["generator"])

    def dumps(self, path: Any) -> None:
        """Writes a file into the folder `path`."""
        torch.save(self.state_dict(), Path(path) / "sampler.pt")

    def loads(self, path: Any) -> None:
        """Reads what `dumps` wrote."""
        self.load_state_dict(torch.load(Path(path) / "sampler.pt"))

    def _empty(self) -> None:
        self.inserted = 0
        self.max_priority = 1.0
        self.tree = SumTree(self.capacity)

    def _latest(self, places: NDArray[np.int64], length: int) -> NDArray[np.int64]:
        """The numbers of the latest items in these places of a ring of that length."""
        last = self.inserted - 1
        return last - (last - places) % length


class DeviceSampler(PrioritySampler):
    """The sampler of a ring without spare slots, on a device for which the host never waits: the
    same draws, up to rounding, and the same `state_dict()`."""

    def __init__(self, capacity: int, *, device: torch.device, **sampling: Any):
        self.device = device
        self.leaves: Tensor  # float64, up to a power of two
        self.largest: Tensor  # `max_priority`, float64 []
        super().__init__(capacity, capacity, **sampling)

    def extend(self, index: Tensor) -> None:
        self.leaves[index] = self.largest**self.priority_exponent
        self.inserted += len(index)

    def sample(self, storage: Any, batch_size: int) -> tuple[Tensor, dict[str, Tensor]]:
        levels = [self.leaves]
        while len(levels[-1]) > 1:
            levels.append(levels[-1].view(-1, 2).sum(-1))
        total = levels.pop()  # [1]
        parts = torch.arange(batch_size, device=self.device)
        rest = (parts + self._offsets(batch_size)) * (total / batch_size)
        node = torch.zeros_like(parts)
        for level in reversed(levels):
            left, right = level.view(-1, 2)[node].unbind(-1)
            is_right = (rest >= left) & (right > 0)
            rest = torch.where(is_right, rest - left, rest)
            node = 2 * node + is_right
        weight = (len(self) * self.leaves[node] / total) ** -self.importance_exponent
        return node, {"weight": (weight / weight.max()).float()}

    def update_priority(self, index: Any, priority: Any, *, storage: Any = None) -> None:
        priorities = priority.double().clamp(min=SMALLEST_PRIORITY)
        self.leaves[index] = priorities**self.priority_exponent
        self.largest.copy_(torch.maximum(self.largest, priorities.max()))

    def state_dict(self) -> dict[str, Any]:
        return {
            "inserted": self.inserted,
            "max_priority": float(self.largest),
            "leaves": self.leaves[: self.capacity].cpu().clone(),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.inserted = state_dict["inserted"]
        self.largest.fill_(state_dict["max_priority"])
        self.leaves[: self.capacity] = state_dict["leaves"].to(self.device)
        self.generator.set_state(state_dict["generator"])

    def _empty(self) -> None:
        size = 1 << (self.capacity - 1).bit_length()
        self.inserted = 0
        self.leaves = torch.zeros(size, dtype=torch.float64, device=self.device)
        self.largest = torch.ones((), dtype=torch.float64, device=self.device)

    def _offsets(self, count: int) -> Tensor:
        offsets = torch.rand(count, generator=self.generator, dtype=torch.float64)
        if self.device.type == "cpu":
            return offsets
        return offsets.pin_memory().to(self.device, non_blocking=True)
