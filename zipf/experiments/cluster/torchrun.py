"""The learners of a run that torchrun has started (`runtime=torchrun`).

Every learner has a share of the envs and all of the weights, and they make the same updates
(`zipf.agents.averaging`). Their ranks count from 0. The first one alone writes files, shows the run
and evaluates. It collects what it needs of the others at fixed points of the program, where all
learners wait for each other.
"""

from __future__ import annotations

import hashlib
import io
import os
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import pandas as pd
import torch
import torch.distributed as dist

import zipf
from zipf.agents import averaging
from zipf.errors import UserError
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.options.runtime import TorchrunOptions
from zipf.experiments.training.runtime import (
    LearnerLost,
    OnlyLearner,
    Runtime,
    started_by_torchrun,
)

PATIENCE = timedelta(days=1)  # ours: the others wait for the first while it evaluates
MEETING = timedelta(minutes=10)  # ours: for the slowest of the machines to start its processes
HEAD_START = 10.0  # seconds; ours: torchrun ends the others of a machine sooner


class Learner(OnlyLearner):
    """One of several learners, which have joined.

    Every method raises `LearnerLost` where another learner has ended.
    """

    def __init__(self) -> None:
        self.rank = dist.get_rank()
        self.is_first = self.rank == 0
        self.stream = (self.rank,)

    def seed(self, seed: int) -> int:
        """Each its own."""
        return derive_seed(seed, "learner", self.rank)

    def agree(self, number: int) -> int:
        """The largest of the learners' numbers."""
        largest = torch.tensor(number)
        with _with_others():
            dist.all_reduce(largest, dist.ReduceOp.MAX)
        return int(largest)

    def mean(self, metrics: dict[str, float]) -> dict[str, float]:
        rows = self._gather(metrics) or [metrics]
        means = pd.DataFrame(rows).mean()  # without NaN
        return {str(name): float(mean) for name, mean in means.items()}

    def total(self, visits: Visits) -> Visits:
        everywhere = Visits(visits.ranks)
        for state in self._gather(visits.state_dict()) or [visits.state_dict()]:
            everywhere.add_those(state)
        return everywhere

    def gather(self, own: dict[str, Any]) -> dict[str, Any]:
        return {"learners": self._gather(own)}

    def receive(self, saved: dict[str, Any] | None) -> dict[str, Any] | None:
        """It is sent, so that machines need no shared disk."""
        common = saved and {name: part for name, part in saved.items() if name != "learners"}
        common = self.of_first(common)
        if common is None:
            return None
        own: list[Any] = [None]
        parts = [_packed(part) for part in saved["learners"]] if saved else None
        with _with_others():
            dist.scatter_object_list(own, parts, src=0)
        return common | _unpacked(own[0])

    def of_first(self, value: Any) -> Any:
        values = [_packed(value)]
        with _with_others():
            dist.broadcast_object_list(values, src=0)
        return _unpacked(values[0])

    def check_same(self, what: str, state: Any) -> None:
        """Raises `UserError` where learners differ in `what`."""
        digests = self.of_first(self._gather(_digest(state)))
        differing = [rank for rank, digest in enumerate(digests) if digest != digests[0]]
        if differing:
            raise UserError(
                f"runtime=torchrun: {what} of learner {differing[0]} of {len(digests)} (counted "
                "from 0) differs from that of learner 0"
            )

    def wait(self) -> None:
        """Returns when all learners have come here."""
        self.agree(0)

    def _gather(self, value: Any) -> list[Any] | None:
        """For the first, the values of all learners in the order of their ranks."""
        values: list[Any] | None = [None] * dist.get_world_size() if self.is_first else None
        with _with_others():
            dist.gather_object(_packed(value), values, dst=0)
        return values and [_unpacked(one) for one in values]


class TorchrunRuntime(Runtime):
    """`runtime=torchrun`: learners that torchrun has started, each with a share of the envs."""

    @contextmanager
    def learner(self) -> Iterator[OnlyLearner]:
        """This process as the learner that it is, until the end.

        Raises:
            UserError: torchrun has not started this process, or with another number of learners;
                or learners were started with different options or versions.
        """
        config, options = self.config, self.config.runtime
        assert isinstance(options, TorchrunOptions)
        started = started_by_torchrun()
        command = f"torchrun --nproc-per-node={options.learners} -m zipf.train"
        if not started:
            raise UserError(f"runtime=torchrun: start it with {command} ...")
        if started != options.learners:
            raise UserError(
                f"runtime.learners={options.learners}: torchrun has started {started} processes; "
                f"should be {started}, or start it with {command} ..."
            )
        # Tensors in RAM, such as what is written to files, take another way than those on GPUs.
        cuda = config.torch_device.startswith("cuda")
        with _with_others():
            store, rank, count = next(dist.rendezvous("env://", timeout=MEETING))
            dist.init_process_group(
                "cpu:gloo,cuda:nccl" if cuda else "gloo",
                store=of_these(store, rank, count),
                rank=rank,
                world_size=count,
                timeout=PATIENCE,
            )
        try:
            assert dist.group.WORLD is not None
            averaging.join(dist.group.WORLD)
            learner = Learner()
            here = {**config.model_dump(), "version": zipf.__version__}
            for of_machine in ("run_root", "device"):
                del here[of_machine]
            learner.check_same("the version or an option", here)
            yield learner
        finally:
            averaging.leave()
            dist.destroy_process_group()


def let_others_tell(error: Exception) -> None:
    """Delays this process's error message so that the responsible learner reports first: learner 0
    a mistake that all find, a learner that ends its own end. Torchrun ends the others meanwhile."""
    late = 2 * isinstance(error, LearnerLost)
    if started_by_torchrun() and os.environ["RANK"] != "0":
        late += 1
    time.sleep(late * HEAD_START)


def of_these(store: dist.Store, rank: int, count: int) -> dist.Store:
    """A part of torchrun's store that only this start of the learners uses. After a restart the
    store still holds entries of the learners before, such as the addresses at which they listened.

    Raises:
        RuntimeError: some of them have not come.
    """
    name = uuid.uuid4().hex
    store.set(f"learners/{rank}", name)
    late = time.monotonic() + MEETING.total_seconds()
    while time.monotonic() < late:
        names = [store.get(f"learners/{other}").decode() for other in range(count)]
        together = "/".join(names)
        store.set(f"learners/of/{name}", together)
        known = [f"learners/of/{one}" for one in names]
        if store.check(known) and all(store.get(key).decode() == together for key in known):
            return dist.PrefixStore(hashlib.sha256(together.encode()).hexdigest(), store)
        time.sleep(0.05)
    raise RuntimeError(f"torchrun's processes did not meet within {MEETING}")


@contextmanager
def _with_others() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:  # PyTorch's, whichever class its backend raises
        raise LearnerLost(averaging.lost(error)) from None


def _packed(value: Any) -> bytes:
    """As bytes; pickle alone cannot write tensors of every type."""
    packed = io.BytesIO()
    torch.save(value, packed)
    return packed.getvalue()


def _unpacked(packed: bytes) -> Any:
    """What another learner has packed: a process of the same user's run."""
    return torch.load(io.BytesIO(packed), map_location="cpu", weights_only=False)


def _digest(state: Any) -> str:
    """A checksum of nested dictionaries and lists of tensors, numbers and text."""
    sha = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, Mapping):
            for key, item in value.items():
                sha.update(repr(key).encode())
                add(item)
        elif isinstance(value, list | tuple):
            sha.update(b"[")
            for item in value:
                add(item)
        elif isinstance(value, torch.Tensor):
            flat = value.detach().cpu().contiguous().flatten()
            sha.update(repr((value.dtype, value.shape)).encode())
            sha.update(flat.view(torch.uint8).numpy().data)
        else:
            sha.update(repr(value).encode())

    add(state)
    return sha.hexdigest()
