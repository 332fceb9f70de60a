"""Where a run's time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

PARTS = ("environment", "inference", "learning", "evaluation")


class Clock:
    """Seconds of a run, over all the processes it was continued in.

    Attributes:
        parts: seconds by part: `environment` (stepping the envs), `inference` (the agent acts),
            `learning` (updates) and `evaluation`. With `collector.lag=1` the first two happen
            beside `learning`, in a second thread; each part is measured by its thread's own wall
            clock, so that they add up to more than the elapsed time. With `runtime=ray` the first
            two are means over the actors; of several learners all are those of the first.
        training: elapsed seconds of collecting and learning.
    """

    def __init__(self) -> None:
        self.parts = dict.fromkeys(PARTS, 0.0)
        self.training = 0.0

    @property
    def total(self) -> float:
        """Elapsed seconds of training and evaluation."""
        return self.training + self.parts["evaluation"]

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Adds the time that the block takes to a part."""
        start = time.perf_counter()
        yield
        self.parts[name] += time.perf_counter() - start

    @contextmanager
    def train(self) -> Iterator[None]:
        """Adds the time that the block takes to `training`."""
        start = time.perf_counter()
        yield
        self.training += time.perf_counter() - start

    def move(self, measured: dict[str, float]) -> None:
        """Adds seconds by part, and sets those given to 0."""
        for name, seconds in measured.items():
            self.parts[name] += seconds
            measured[name] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """All seconds so far."""
        return {"parts": dict(self.parts), "training": self.training}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.parts, self.training = dict(state["parts"]), state["training"]
