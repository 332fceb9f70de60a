"""Rollout workers: they collect unrolls and have each of them learned from.

With `collector.lag=1` a second thread collects while the first learns (`BackgroundRollouts`). Let
w_k be the weights before update k, counting from 0. While update k learns from unroll k and turns
w_k into w_k+1, unroll k+1 is played by w_k. So update k learns with w_k from what w_k-1 played (the
first with w_0 from what w_0 played), and its importance ratios are pi of w_k over pi of w_k-1.
Results do not depend on which thread is faster: they share no weights, no unroll and no random
generator, and each waits for the other once per update.

Both threads run PyTorch's operators on as many cores as `torch.get_num_threads()` says. Giving
each a share of the cores instead was not faster on 2 cores, because acting takes about half as long
as learning: with one core each, the first waits for the second half of the time. The surplus
threads sleep while they wait (`OMP_WAIT_POLICY` in `zipf/experiments/__init__.py`) and cost little.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor

from zipf.agents.learner import Learner
from zipf.agents.unroll import Unroll
from zipf.experiments.building.checkpoint import arrays
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.clock import DeviceClock
from zipf.experiments.training.host_collector import HostCollector, episode_metrics
from zipf.experiments.training.tensor_collector import Tally, TensorCollector

Learned = TypeVar("Learned")


class RolloutWorker(Protocol):
    """Collects unrolls and has each of them learned from."""

    @property
    def seconds(self) -> dict[str, float]:
        """Spent in `environment` and `inference`; the reader sets them to 0."""

    @property
    def visits(self) -> Visits:
        """How often each situation was met."""

    def open(self, tell: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Begins; called once before the first step. `tell` shows a line to the user, `stopping`
        says whether the run has to stop: then who waits for others in `step` raises `Stopped`.

        Raises:
            UserError: it cannot begin. Nothing is left to be closed.
        """

    @property
    def is_between_unrolls(self) -> bool:
        """Whether all that was collected for updates has been learned from, so that the state may
        be saved."""

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Calls `learn` with the next unroll or the next part of one, which the step after may
        overwrite; returns both."""

    def metrics(self) -> dict[str, float]:
        """Of the unrolls that were learned from since the last call."""

    def state_dict(self) -> dict[str, Any]:
        """What a run that goes on needs, beside the agent's state."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, after the agent has loaded its own."""

    def close(self) -> None:
        """Ends what was begun; may be called again."""


class SynchronousRollouts:
    """Collection and learning take turns.

    Args:
        collector: collects.
        parts: how many updates each unroll gives. Update k learns from the envs k, k + parts,
            k + 2 parts, ..., so that every part has envs of all levels, and the part that comes
            first changes with every unroll.
    """

    collector: Any

    def __init__(self, collector: HostCollector | TensorCollector, parts: int = 1):
        self.collector = collector
        self.parts = parts
        self.updates = 0  # made since the run began, where there are parts
        self._unroll: Unroll | None = None  # that the parts are of

    @property
    def is_between_unrolls(self) -> bool:
        """Whether all of an unroll has been learned from, so that the state may be saved."""
        return self.updates % self.parts == 0

    def _part(self, unroll: Unroll) -> Unroll:
        """The part of an unroll that the next update learns from."""
        if self.parts == 1:
            return unroll
        k = self.updates + self.updates // self.parts
        self.updates += 1
        return unroll.part(k % self.parts, self.parts)

    @property
    def seconds(self) -> dict[str, float]:
        """The collector's."""
        return self.collector.seconds

    @property
    def visits(self) -> Visits:
        """The collector's."""
        return self.collector.visits

    def open(self, tell: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """There is nothing to begin."""

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Collects an unroll, where the last one is used up, and calls `learn` with it or its next
        part; the next step overwrites it."""
        if self.is_between_unrolls:
            self._unroll = self._next()
        assert self._unroll is not None
        part = self._part(self._unroll)
        return part, learn(part)

    def _next(self) -> Unroll:
        """The next unroll to learn from."""
        return self.collector.collect()

    def metrics(self) -> dict[str, float]:
        """See `HostCollector.episode_metrics`."""
        return self.collector.episode_metrics()

    def state_dict(self) -> dict[str, Any]:
        """The collector's, between unrolls."""
        assert self.is_between_unrolls
        return {"collector": self.collector.state_dict(), "updates": self.updates}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, or with new episodes from that of `TensorRollouts`."""
        self.updates = state["updates"]
        if "tensor_envs" in state:
            tables = state["tensor_envs"]["hooks"]
            self.collector.begin_with(arrays(state["tally"]["visits"]), arrays(tables))
        else:
            self.collector.load_state_dict(state["collector"])

    def close(self) -> None:
        """There is nothing to end."""


SWITCH_SECONDS = 1e-4
"""Ours: how long a thread that computes in Python keeps the GIL while others wait for it, Python's
5 ms otherwise. Those that step envs need it after every call of compiled code, for microseconds:
beside a thread that never lets go they made four times as many steps."""


class BackgroundRollouts(SynchronousRollouts):
    """Collects the next unroll while one is learned from.

    Between steps the agent acts with the weights that it has learned, and the second thread idles.

    Args:
        collector: made with `lag=1`; nobody else calls its `collect`.
        agent: acts in the second thread and learns in the calling one.
    """

    def __init__(self, collector: HostCollector, agent: Learner, parts: int = 1):
        super().__init__(collector, parts)
        self.agent = agent
        agent.separate_acting()
        self._switched_before = sys.getswitchinterval()
        # Of the unrolls that were learned from; the collector's are of the pending one.
        self._visits = Visits(collector.visits.ranks)
        self._episodes: defaultdict[str, list[float]] = defaultdict(list)
        self._pending: Unroll | None = None  # collected and not yet learned from
        self._collecting: Future[Unroll] | None = None
        self._thread = ThreadPoolExecutor(1, "collector", initializer=_separate_autocast)
        self._stream: torch.cuda.Stream | None = None
        if collector.device.startswith("cuda"):
            self._stream = torch.cuda.Stream(collector.device)

    def open(self, tell: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """From now on threads take turns as often as `SWITCH_SECONDS` says."""
        sys.setswitchinterval(SWITCH_SECONDS)

    @property
    def visits(self) -> Visits:
        """How often each situation was met in the unrolls that were learned from."""
        return self._visits

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Calls `learn` with an unroll, or its next part, while the next one is collected, and
        publishes the weights where all of it was learned from.

        Returns what was learned from, which the next step overwrites, and what `learn` returned.
        Raises what `learn` or the collector raises; the second thread has stopped then, for good.
        """
        if self.is_between_unrolls:
            self._begin()
        assert self._unroll is not None
        assert self._collecting is not None
        part = self._part(self._unroll)
        try:
            learned = learn(part)
            if self.is_between_unrolls:
                self._pending = self._collecting.result()
        except BaseException:
            self.collector.abandon()
            wait([self._collecting])
            raise
        if self.is_between_unrolls:
            self.agent.publish()
            self._visits.add_those(self._learned_from[0].state_dict())
            for name, values in self._learned_from[1].items():
                self._episodes[name].extend(values)
        return part, learned

    def _begin(self) -> None:
        """Takes the unroll that is there, and begins to collect the next."""
        if self._pending is None:
            self._pending = self.collector.collect()
        self._unroll = self._pending
        self._learned_from = self.collector.visits.take(), self.collector.take_episodes()
        if self._stream is not None:  # the published weights have arrived
            torch.cuda.current_stream(self._stream.device).synchronize()
        self._collecting = self._thread.submit(self._collect)

    def metrics(self) -> dict[str, float]:
        """As `HostCollector.episode_metrics`, of the unrolls that were learned from since the last
        call."""
        metrics = episode_metrics(self._episodes)
        self._episodes.clear()
        return metrics

    def _collect(self) -> Unroll:
        with torch.cuda.stream(self._stream):  # without a stream this does nothing
            unroll = self.collector.collect()
        if self._stream is not None:  # the unroll and its memory have arrived
            self._stream.synchronize()
        return unroll

    def close(self) -> None:
        """Ends the second thread."""
        self._thread.shutdown()
        sys.setswitchinterval(self._switched_before)

    def state_dict(self) -> dict[str, Any]:
        """The collector's, the unroll that is yet to be learned from, and what the earlier ones
        met."""
        return {
            **super().state_dict(),
            "pending": {} if self._pending is None else self._pending.state_dict(),
            "visits": self._visits.state_dict(),
            "episodes": dict(self._episodes),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, after the agent has loaded its own."""
        super().load_state_dict(state)
        self.agent.publish()
        if "tensor_envs" in state:
            self._visits = self.collector.visits.take()
            self._pending = None
            return
        self._visits.load_state_dict(arrays(state["visits"]))
        self._episodes = defaultdict(list, {k: list(v) for k, v in state["episodes"].items()})
        self._pending = None
        if state["pending"]:
            pending = Unroll.of_state(state["pending"])
            moved = pending.to(self.collector.device)  # as collected: memory alone is on the device
            memory, late = moved.memory, moved.late_memory
            self._pending = replace(pending, memory=memory, late_memory=late)


class TensorRollouts(SynchronousRollouts):
    """Collects in tensor environments, on the device that learns, in one thread: the device is kept
    busy, since nothing waits for it.

    With lag 1 an unroll is played before the one before it is learned from, so that updates learn
    from what they would learn from with `BackgroundRollouts`.

    Attributes:
        clock: of a CUDA device, which works on while the host goes on; else None.
    """

    collector: TensorCollector

    def __init__(self, collector: TensorCollector, parts: int = 1, lag: int = 0):
        super().__init__(collector, parts)
        self.lag = lag
        self.clock = DeviceClock() if collector.device.startswith("cuda") else None
        self._tally = Tally(collector)
        self._pending: tuple[Unroll, Tensor, Tensor] | None = None  # collected, not learned from

    @property
    def visits(self) -> Visits:
        """How often each situation was met in the unrolls that were learned from."""
        return self._tally.visits

    @property
    def seconds(self) -> dict[str, float]:
        """The collector's, where no clock of the device counts them."""
        return self.collector.seconds if self.clock is None else {}

    def _next(self) -> Unroll:
        with self.clock.part("inference") if self.clock else nullcontext():
            if self.lag == 0:
                unroll = self.collector.collect()
                outcomes, met = self.collector.outcomes, self.collector.met
            else:
                unroll, outcomes, met = self._pending or self._collected()
                self._pending = self._collected()
        self._tally.add(outcomes, met)
        return unroll

    def _collected(self) -> tuple[Unroll, Tensor, Tensor]:
        """An unroll that the next one does not overwrite, with what its episodes came to."""
        unroll = self.collector.collect()
        return unroll.clone(), self.collector.outcomes.clone(), self.collector.met.clone()

    def metrics(self) -> dict[str, float]:
        """Means over the episodes that ended in the unrolls learned from since the last call."""
        return self._tally.metrics()

    def state_dict(self) -> dict[str, Any]:
        """The collector's, the unroll that is yet to be learned from, and what the earlier ones
        came to; between unrolls."""
        assert self.is_between_unrolls
        pending: dict[str, Any] = {}
        if self._pending is not None:
            unroll, outcomes, met = self._pending
            pending = {"unroll": unroll.state_dict(), "outcomes": outcomes, "met": met}
        return {
            "tensor_envs": self.collector.state_dict(),
            "pending": pending,
            "tally": self._tally.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, or with new episodes from that of other rollouts, after
        the agent has loaded its own."""
        device = self.collector.device
        self.updates = state["updates"]
        self._pending = None
        if "tensor_envs" not in state:
            self._tally.begin_with(state.get("visits", state["collector"]["visits"]))
            self.collector.begin_with(state["collector"])
            return
        self.collector.load_state_dict(state["tensor_envs"])
        self._tally.load_state_dict(state["tally"])
        if pending := state["pending"]:
            unroll = Unroll.of_state(pending["unroll"]).to(device)
            self._pending = unroll, pending["outcomes"].to(device), pending["met"].to(device)


def _separate_autocast() -> None:
    """Keeps autocast in this thread from the cache of cast weights, which all threads share.

    Leaving the outermost autocast of any thread clears the cache. Cleared in the middle of another
    thread's forward pass, it makes that thread cast a weight twice and add up two gradients in
    another order: results would depend on timing. In this thread no autocast is the outermost.
    """
    torch.autocast_increment_nesting()
    torch.set_autocast_cache_enabled(False)
