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

from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, Protocol, TypeVar

import torch

from zipf.agents.learner import Learner
from zipf.agents.unroll import Unroll
from zipf.experiments.building.checkpoint import arrays
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.collector import Collector, episode_metrics

Learned = TypeVar("Learned")


class RolloutWorker(Protocol):
    """Collects unrolls and has each of them learned from."""

    @property
    def seconds(self) -> dict[str, float]:
        """Spent in `environment` and `inference`; the reader sets them to 0."""

    @property
    def visits(self) -> Visits:
        """How often each situation was met."""

    def open(self, tell: Callable[[str], None]) -> None:
        """Begins; called once before the first step. `tell` shows a line to the user.

        Raises:
            UserError: it cannot begin. Nothing is left to be closed.
        """

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Calls `learn` with the next unroll, which the step after may overwrite; returns both."""

    def metrics(self) -> dict[str, float]:
        """Of the unrolls that were learned from since the last call."""

    def state_dict(self) -> dict[str, Any]:
        """What a run that goes on needs, beside the agent's state."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, after the agent has loaded its own."""

    def close(self) -> None:
        """Ends what was begun; may be called again."""


class SynchronousRollouts:
    """Collection and learning take turns."""

    def __init__(self, collector: Collector):
        self.collector = collector

    @property
    def seconds(self) -> dict[str, float]:
        """The collector's."""
        return self.collector.seconds

    @property
    def visits(self) -> Visits:
        """The collector's."""
        return self.collector.visits

    def open(self, tell: Callable[[str], None]) -> None:
        """There is nothing to begin."""

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Collects an unroll and calls `learn` with it; the next step overwrites it."""
        unroll = self.collector.collect()
        return unroll, learn(unroll)

    def metrics(self) -> dict[str, float]:
        """See `Collector.episode_metrics`."""
        return self.collector.episode_metrics()

    def state_dict(self) -> dict[str, Any]:
        """The collector's."""
        return {"collector": self.collector.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.collector.load_state_dict(state["collector"])

    def close(self) -> None:
        """There is nothing to end."""


class BackgroundRollouts(SynchronousRollouts):
    """Collects the next unroll while one is learned from.

    Between steps the agent acts with the weights that it has learned, and the second thread idles.

    Args:
        collector: made with `lag=1`; nobody else calls its `collect`.
        agent: acts in the second thread and learns in the calling one.
    """

    def __init__(self, collector: Collector, agent: Learner):
        super().__init__(collector)
        self.agent = agent
        agent.separate_acting()
        # Of the unrolls that were learned from; the collector's are of the pending one.
        self._visits = Visits(collector.visits.ranks)
        self._episodes: defaultdict[str, list[float]] = defaultdict(list)
        self._pending: Unroll | None = None  # collected and not yet learned from
        self._thread = ThreadPoolExecutor(1, "collector", initializer=_separate_autocast)
        self._stream: torch.cuda.Stream | None = None
        if collector.device.startswith("cuda"):
            self._stream = torch.cuda.Stream(collector.device)

    @property
    def visits(self) -> Visits:
        """How often each situation was met in the unrolls that were learned from."""
        return self._visits

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Calls `learn` with an unroll while the next one is collected, and publishes the weights.

        Returns the unroll, which the next step overwrites, and what `learn` returned. Raises what
        `learn` or the collector raises; the second thread has stopped then, for good.
        """
        if self._pending is None:
            self._pending = self.collector.collect()
        unroll = self._pending
        visits, episodes = self.collector.take_visits(), self.collector.take_episodes()
        if self._stream is not None:  # the published weights have arrived
            torch.cuda.synchronize(self._stream.device)
        collecting = self._thread.submit(self._collect)
        try:
            learned = learn(unroll)
            self._pending = collecting.result()
        except BaseException:
            self.collector.abandon()
            wait([collecting])
            raise
        self.agent.publish()
        self._visits.add_those(visits.state_dict())
        for name, values in episodes.items():
            self._episodes[name].extend(values)
        return unroll, learned

    def metrics(self) -> dict[str, float]:
        """As `Collector.episode_metrics`, of the unrolls that were learned from since the last
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
        if "visits" in state:  # in older checkpoints of this version the collector has them all
            self._visits.load_state_dict(arrays(state["visits"]))
            self._episodes = defaultdict(list, {k: list(v) for k, v in state["episodes"].items()})
        self._pending = None
        if state["pending"]:
            self._pending = Unroll.of_state(state["pending"]).to(self.collector.device)


def _separate_autocast() -> None:
    """Keeps autocast in this thread from the cache of cast weights, which all threads share.

    Leaving the outermost autocast of any thread clears the cache. Cleared in the middle of another
    thread's forward pass, it makes that thread cast a weight twice and add up two gradients in
    another order: results would depend on timing. In this thread no autocast is the outermost.
    """
    torch.autocast_increment_nesting()
    torch.set_autocast_cache_enabled(False)
