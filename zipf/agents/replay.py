"""Prioritised replay (Schaul et al. 2016): TorchRL's buffer in RAM, on a device or in files; saved
and resumed.

Importing this costs the second or so that importing TorchRL takes.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer, TensorStorage

from zipf.agents.free_space import free_disk, free_on, free_ram, in_words
from zipf.agents.priorities import PrioritySampler


class Replay:
    """The latest `capacity` items, drawn by priority.

    In RAM, `state_dict()` holds the items. On disk it does not: they stay in the files of `folder`,
    a ring with room for `spare` items more than the capacity. As long as no more than that are
    inserted between two checkpoints, no item that the last checkpoint can draw is overwritten, and
    a run that is killed at any time resumes from there. A file holds numbers and nothing else, one
    for each part of an item. Every item has its number and is hashed as it is inserted; the state
    has the hashes, and loading checks every item that can be drawn, which reads all files once.
    Raises ValueError: the items do not fit into RAM, onto the device or the disk; nothing is
    allocated yet.

    Args:
        item: an example of an item, a TensorDict without batch axes, on the device that keeps them.
        capacity: items to draw from.
        folder: where the items are kept; None for RAM, or the device of `item`.
        spare: items that are inserted between two checkpoints, at most.
        seed: of the draws.
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
        self.device = next(iter(item.values(True, True))).device
        number = torch.zeros((), dtype=torch.int64, device=self.device)
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
        self._contents: list[NDArray[np.uint8]]  # on disk: the parts of `_items`, [slots, bytes]
        self._digests: NDArray[np.int64]  # on disk: of each slot

    def __len__(self) -> int:
        return len(self._buffer.sampler) if self._buffer else 0

    def insert(self, items: TensorDict) -> Tensor:
        """Adds items [N], N <= capacity, with the largest priority so far; they replace the oldest.

        Returns their slots, int64 [N].
        Raises OSError: the files, which the first call makes, do not fit onto the disk.
        """
        if self._buffer is None:
            self._open(self.capacity + self.spare, new=True)
            assert self._buffer is not None
        first = self._buffer.sampler.inserted
        items = items.to(self.device)  # and TorchRL then makes the index of its slots there
        items["number"] = torch.arange(first, first + len(items), device=self.device)
        slots = self._buffer.extend(items)
        if self.folder:
            for slot in slots.tolist():
                self._digests[slot] = self._digest(slot)
        return slots

    def sample(self, batch_size: int) -> tuple[TensorDict, Tensor, Tensor]:
        """Items [N] drawn with replacement, their slots int64 [N], and importance weights float32
        [N]."""
        assert self._buffer is not None, "the replay is empty"
        items = self._buffer.sample(batch_size)
        return items, items["index"], items["weight"]

    def update_priorities(self, index: Tensor, priorities: Tensor) -> None:
        """New priorities, float [N], of the slots that were just drawn."""
        assert self._buffer is not None, "the replay is empty"
        self._buffer.update_priority(index, priorities)

    def state_dict(self) -> dict[str, Any]:
        """Everything but, on disk, the items: they are in their files when this returns."""
        if self._buffer is None:
            return {}
        state = {
            "slots": len(self._items),
            "sampler": self._buffer.sampler.state_dict(),
            "writer": self._buffer.writer.state_dict(),
        }
        if self.folder:
            state["digests"] = torch.from_numpy(self._digests.copy())
            for path, _ in self._files(len(self._items)):
                with open(path, "r+b") as file:
                    os.fsync(file.fileno())
        else:
            state["items"] = _leaves(self._items[: len(self)])
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`.
        Raises OSError: the files on disk are missing or damaged, or are not those of this state."""
        self._buffer = None
        if not state:
            return
        self._open(state["slots"], new=self.folder is None)
        assert self._buffer is not None
        if self.folder is None:
            for name, leaf in self._items.items(True, True):
                saved = state["items"][_joined(name)]
                leaf[: len(saved)] = saved
        self._buffer.sampler.load_state_dict(state["sampler"])
        self._buffer.writer.load_state_dict(state["writer"])
        inserted = self._buffer.sampler.inserted
        numbers = np.arange(inserted - len(self), inserted)
        slots = numbers % state["slots"]
        if (self._items["number"].cpu().numpy()[slots] != numbers).any():
            raise OSError(f"{self.folder}: these files hold another replay than the checkpoint's")
        if self.folder:
            self._digests = state["digests"].numpy().copy()
            damaged = [slot for slot in slots.tolist() if self._digest(slot) != self._digests[slot]]
            if damaged:
                raise OSError(
                    f"{self.folder}: is damaged: {len(damaged)} of {len(slots)} items are not what "
                    "was written; restore it from a copy, or remove the run's folder to train anew"
                )

    def _open(self, slots: int, *, new: bool) -> None:
        """Allocates `slots` items, or opens the files that have them."""
        if self.folder is None:
            self._items = torch.empty_like(self.item.expand(slots))
        else:
            if new:
                self._make_files(slots)
            else:
                self._check_files(slots)
            self._map_files(slots)
        self._buffer = TensorDictReplayBuffer(
            storage=TensorStorage(
                self._items, device=self.device, compilable=self.device.type != "cpu"
            ),
            sampler=PrioritySampler(slots, self.capacity, **self.sampling, device=self.device),
        )

    def _files(self, slots: int) -> Iterator[tuple[Path, int]]:
        """The file of each part of the items, and its size in bytes."""
        for name, leaf in self.item.items(True, True):
            yield self._file(name), slots * leaf.nbytes

    def _file(self, name: str | tuple[str, ...]) -> Path:
        assert self.folder is not None
        return self.folder / f"{_joined(name)}.memmap"

    def _make_files(self, slots: int) -> None:
        assert self.folder is not None
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            for path, size in self._files(slots):
                path.parent.mkdir(parents=True, exist_ok=True)
                with open(path, "xb") as file:
                    if hasattr(os, "posix_fallocate"):
                        # Otherwise files grow as they are filled, and on a full disk the process
                        # is killed.
                        os.posix_fallocate(file.fileno(), 0, size)
                    else:
                        file.truncate(size)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise OSError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def _check_files(self, slots: int) -> None:
        if slots < self.capacity + self.spare:
            raise OSError(
                f"{self.folder}: has room for {slots - self.capacity} items between two "
                f"checkpoints, and {self.spare} are needed; write checkpoints as often as before"
            )
        for path, size in self._files(slots):
            if path.is_symlink() or not path.is_file():
                raise OSError(f"{path}: this file of the replay is missing")
            if (found := path.stat().st_size) != size:
                raise OSError(
                    f"{path}: has {found} bytes, and the checkpoint's replay {size}: it is damaged "
                    "or of another replay"
                )

    def _map_files(self, slots: int) -> None:
        """Opens the files as `_items`. Types and shapes are those of `item`: files do not tell."""

        def mapped(name: Any, leaf: Tensor) -> Tensor:
            try:
                array = np.memmap(self._file(name), leaf.numpy().dtype, "r+", shape=leaf.shape)
            except OSError as error:
                raise OSError(f"{self._file(name)}: cannot be read: {error.strerror}") from None
            self._contents.append(array.reshape(slots, -1).view(np.uint8))
            return torch.from_numpy(array)

        self._contents = []
        self._items = self.item.expand(slots).named_apply(mapped, nested_keys=True)
        self._digests = np.zeros(slots, np.int64)

    def _digest(self, slot: int) -> int:
        """A hash of all parts of the item in a slot, 64 bits."""
        digest = hashlib.sha256()
        for part in self._contents:
            digest.update(part[slot])
        return int.from_bytes(digest.digest()[:8], "little", signed=True)

    def _check_room(self) -> None:
        each = f"{self.capacity} items of {in_words(self.item_bytes)}"
        if self.device.type != "cpu":
            free = free_on(self.device)
            if self.bytes > free:
                raise ValueError(
                    f"the replay's {each} take {in_words(self.bytes)} of {self.device}, and "
                    f"{in_words(free)} are free: {_fits(free // self.item_bytes)}"
                    "collector.envs=host keeps them in RAM, then agent.storage=memmap on disk"
                )
        elif self.folder is None:
            free = free_ram()
            # The contents of a checkpoint are in RAM beside the replay while it is read.
            if 2 * self.bytes > free:
                raise ValueError(
                    f"the replay's {each} take {in_words(self.bytes)} of RAM, and as much again "
                    f"while a checkpoint is read, and {in_words(free)} are free: "
                    f"{_fits(free // (2 * self.item_bytes))}agent.storage=memmap keeps them on disk"
                )
        else:
            free = free_disk(self.folder)
            if self.bytes > free:
                raise ValueError(
                    f"the replay's {each}, and room for {self.spare} between checkpoints, take "
                    f"{in_words(self.bytes)} of disk in {self.folder}, and {in_words(free)} are "
                    f"free: {_fits(free // self.item_bytes - self.spare)}a smaller "
                    "schedule.checkpoint_every needs less room"
                )


def _fits(capacity: int) -> str:
    """Says that a replay of this capacity fits, if it can have any."""
    return f"agent.replay_capacity={capacity} fits, and " if capacity > 0 else ""


def _leaves(items: TensorDict) -> dict[str, Tensor]:
    """{"steps/action": [N, ...], ...}, as tensors whose storage is written without the rest of the
    buffer."""
    leaves = items.items(True, True)
    return {_joined(name): torch.from_numpy(leaf.cpu().numpy()) for name, leaf in leaves}


def _joined(name: str | tuple[str, ...]) -> str:
    return name if isinstance(name, str) else "/".join(name)
