"""Sources: where the unrolls that a run learns from come from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from zipf.agents.unroll import Unroll
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.collector import Collector

Learned = TypeVar("Learned")


class Source(Protocol):
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


class InTurn:
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
