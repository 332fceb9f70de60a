"""Prioritised replay (Schaul et al. 2016): TorchRL's buffer with a sum-tree sampler of our own.

Importing this costs the second or so that importing TorchRL takes.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers.samplers import Sampler

from zipf.compiled import compiled

SMALLEST_PRIORITY = 1e-6  # so that what was once predicted exactly can still be drawn


class SumTree:
    """Numbers that are changed, and drawn in proportion to their size, in O(log size) steps.

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
        """Changes numbers; where an index comes twice, its last value stays."""
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
            # Rounding may leave a rest that no leaf has; it never leads to a leaf that is 0.
            if rest >= nodes[node] and nodes[node + 1] > 0:
                rest -= nodes[node]
                node += 1
        index[i] = node - first_leaf
    return index


class PrioritySampler(Sampler):
    """Draws slots of a ring in proportion to priority^exponent, one from each of `batch_size`
    equal parts of the sum (Schaul et al. 2016, appendix B.2.1); its random numbers are its own.

    What is new gets the largest priority yet. An importance weight is (n P)^-exponent over the
    largest of its batch, with n the number of items.

    Args:
        slots: of the ring.
        capacity: the latest so many items are drawn from, at most `slots`.
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
        """Slots [N] were just written, in this order: N more items, and as many too old."""
        slots = index.numpy()
        self.tree.set((slots - self.capacity) % self.slots, np.zeros(len(slots)))
        newest = self.max_priority**self.priority_exponent
        self.tree.set(slots, np.full(len(slots), newest))
        self.inserted += len(slots)

    def sample(self, storage: Any, batch_size: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Slots int64 [N], ascending by strata, and `weight` float32 [N]."""
        offsets = torch.rand(batch_size, generator=self.generator, dtype=torch.float64).numpy()
        mass = (np.arange(batch_size) + offsets) * (self.tree.total / batch_size)
        index = self.tree.find(mass)
        probability = self.tree.leaves[index] / self.tree.total
        weight = (len(self) * probability) ** -self.importance_exponent
        weight = (weight / weight.max()).astype(np.float32)
        return torch.from_numpy(index), {"weight": torch.from_numpy(weight)}

    def update_priority(self, index: Any, priority: Any, *, storage: Any = None) -> None:
        """The priorities float [N] of slots int64 [N]."""
        priorities = np.maximum(priority.numpy().astype(np.float64), SMALLEST_PRIORITY)
        self.tree.set(index.numpy(), priorities**self.priority_exponent)
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
        self.tree.set(np.arange(self.slots), state_dict["leaves"].numpy())
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
        self.tree = SumTree(self.slots)


class Replay:
    """The latest `capacity` items, drawn by priority.

    In memory, `state_dict()` holds the items. On disk it does not: they stay in the files of
    `folder`, a ring with room for `spare` items more than the capacity. So long as no more than
    that arrive between two checkpoints, what the last checkpoint can draw from is never written
    over, and a run that is cut anywhere goes on from there as if nothing had come after. Every item
    carries its number, by which loading finds files that are not those of the checkpoint.

    Args:
        item: what every item looks like, a TensorDict without batch axes.
        capacity: items to draw from.
        folder: where the items are kept; None for memory.
        spare: items that arrive between two checkpoints, at most.
        seed: of the draws.

    Raises:
        ValueError: they fit into neither; nothing has been set aside by then.
    """

    def __init__(
        self,
        item: TensorDict,
        *,
        capacity: int,
        priority_exponent: float,
        importance_exponent: float,
        folder: Path | None,
        spare: int,
        seed: int,
    ):
        number = torch.zeros((), dtype=torch.int64)
        # TorchRL writes an `index` of its own beside every item.
        self.item = item.clone().update({"number": number, "index": number.clone()})
        self.capacity = capacity
        self.folder = folder
        self.spare = spare if folder else 0
        self.sampling: dict[str, Any] = {
            "priority_exponent": priority_exponent,
            "importance_exponent": importance_exponent,
            "seed": seed,
        }
        self.item_bytes = sum(leaf.nbytes for leaf in self.item.values(True, True))
        self.bytes = (capacity + self.spare) * self.item_bytes
        self._check_room()
        self._buffer: TensorDictReplayBuffer | None = None
        self._items: TensorDict

    def __len__(self) -> int:
        return len(self._buffer.sampler) if self._buffer else 0

    def insert(self, items: TensorDict) -> None:
        """Adds items [N], N <= capacity, with the largest priority yet; the oldest go.

        Raises:
            OSError: these are the first, and there is no room for the files any more.
        """
        if self._buffer is None:
            self._open(self.capacity + self.spare, new=True)
            assert self._buffer is not None
        first = self._buffer.sampler.inserted
        items["number"] = torch.arange(first, first + len(items))
        self._buffer.extend(items)

    def sample(self, batch_size: int) -> tuple[TensorDict, Tensor, Tensor]:
        """Items [N] drawn with replacement, where they lie, int64 [N], and importance weights,
        float32 [N]."""
        assert self._buffer is not None, "there is nothing to draw"
        items = self._buffer.sample(batch_size)
        return items, items["index"], items["weight"]

    def update_priorities(self, index: Tensor, priorities: Tensor) -> None:
        """New priorities, float [N], of what was just drawn."""
        assert self._buffer is not None, "nothing was drawn"
        self._buffer.update_priority(index, priorities)

    def state_dict(self) -> dict[str, Any]:
        """Everything but, on disk, the items, which are in their files when this returns."""
        if self._buffer is None:
            return {}
        state = {
            "slots": len(self._items),
            "sampler": self._buffer.sampler.state_dict(),
            "writer": self._buffer.writer.state_dict(),
        }
        if self.folder:
            for path in self.folder.rglob("*.memmap"):
                with open(path, "r+b") as file:
                    os.fsync(file.fileno())
        else:
            state["items"] = _leaves(self._items[: len(self)])
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`.

        Raises:
            OSError: the files on disk are gone, or not those of this state.
        """
        if not state:
            self._buffer = None
            return
        self._open(state["slots"], new=self.folder is None)
        assert self._buffer is not None
        if self.folder is None:
            for name, leaf in state["items"].items():
                self._items[tuple(name.split("/"))][: len(leaf)] = leaf
        self._buffer.sampler.load_state_dict(state["sampler"])
        self._buffer.writer.load_state_dict(state["writer"])
        inserted = self._buffer.sampler.inserted
        numbers = np.arange(inserted - len(self), inserted)
        if (self._items["number"].numpy()[numbers % state["slots"]] != numbers).any():
            raise OSError(f"{self.folder}: these files hold another replay than the checkpoint's")

    def _open(self, slots: int, *, new: bool) -> None:
        """Sets aside room for `slots` items, or opens the files that have it."""
        if self.folder is None:
            self._items = torch.empty_like(self.item.expand(slots))
        elif new:
            self._items = self._new_files(slots)
        else:
            self._items = self._existing_files(slots)
        self._buffer = TensorDictReplayBuffer(
            storage=TensorStorage(self._items),
            sampler=PrioritySampler(slots, self.capacity, **self.sampling),
        )

    def _new_files(self, slots: int) -> TensorDict:
        assert self.folder is not None
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            items = self.item.expand(slots).memmap_like(self.folder)
            # Files grow as they are filled; where the disk is full by then, the process is killed.
            if hasattr(os, "posix_fallocate"):
                for path in self.folder.rglob("*.memmap"):
                    with open(path, "r+b") as file:
                        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise OSError(f"{self.folder}: cannot be written: {error.strerror}") from None
        return items

    def _existing_files(self, slots: int) -> TensorDict:
        if slots < self.capacity + self.spare:
            raise OSError(
                f"{self.folder}: has room for {slots - self.capacity} items between two "
                f"checkpoints, and {self.spare} would come; write checkpoints as often as before"
            )
        try:
            items = TensorDict.load_memmap(self.folder)
        except (OSError, RuntimeError, ValueError) as error:
            first = str(error).splitlines()[0]
            raise OSError(f"{self.folder}: the replay's files cannot be read ({first})") from None
        for name, leaf in self.item.items(True, True):
            if items[name].shape != (slots, *leaf.shape):
                raise OSError(f"{self.folder}: these files hold another replay's items")
        return items

    def _check_room(self) -> None:
        each = f"{self.capacity} items of {in_words(self.item_bytes)}"
        if self.folder is None:
            free = free_memory()
            # What a checkpoint holds is in memory beside it while it is read.
            if 2 * self.bytes > free:
                raise ValueError(
                    f"the replay's {each} take {in_words(self.bytes)} of memory, and as much again "
                    f"while a checkpoint is read, and {in_words(free)} are free: "
                    f"agent.replay_capacity={free // (2 * self.item_bytes)} fits, and "
                    "agent.storage=memmap keeps them on disk"
                )
            return
        free = free_disk(self.folder)
        if self.bytes > free:
            fit = max(free // self.item_bytes - self.spare, 0)
            raise ValueError(
                f"the replay's {each}, and room for {self.spare} between checkpoints, take "
                f"{in_words(self.bytes)} of disk in {self.folder}, and {in_words(free)} are free: "
                f"agent.replay_capacity={fit} fits, and a smaller schedule.checkpoint_every needs "
                "less room"
            )


def free_memory() -> int:
    """Bytes that can still be had of this machine and of the control groups that bound us."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        groups = Path("/proc/self/cgroup").read_text().splitlines()
    except FileNotFoundError:  # not Linux
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    sizes = {name: int(rest.split()[0]) for name, rest in (line.split(":") for line in lines)}
    free = sizes["MemAvailable"] * 1024
    for line in groups:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = Path("/sys/fs/cgroup"), ("memory.max", "memory.current")
        elif controllers == "memory":
            root = Path("/sys/fs/cgroup/memory")
            names = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        leaf = root / path.strip("/")
        for group in (leaf, *leaf.parents):
            try:
                limit, used = ((group / name).read_text().strip() for name in names)
                statistics = dict(
                    line.split() for line in (group / "memory.stat").read_text().splitlines()
                )
            except FileNotFoundError:
                continue
            if limit != "max":  # what the kernel keeps of files it would give back
                files = int(statistics["inactive_file"]) + int(statistics["active_file"])
                free = min(free, max(int(limit) - int(used) + files, 0))
    return free


def free_disk(folder: Path) -> int:
    """Bytes that files in `folder`, which need not be there yet, can have: those of its own files,
    which are to be used again or replaced, and what is free."""
    own = sum(p.stat().st_blocks * 512 for p in folder.rglob("*") if p.is_file())
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return own + shutil.disk_usage(there).free


def in_words(size: float) -> str:
    """12_300_000 -> "12.3 MB"."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    power = min(max(len(str(int(size))) - 1, 0) // 3, len(units) - 1)
    return f"{size / 1000**power:.{0 if power == 0 else 1}f} {units[power]}"


def _leaves(items: TensorDict) -> dict[str, Tensor]:
    """{"steps/action": [N, ...], ...}; what is saved of a slice is the slice."""
    return {
        "/".join((name,) if isinstance(name, str) else name): torch.from_numpy(leaf.numpy())
        for name, leaf in items.items(True, True)
    }
