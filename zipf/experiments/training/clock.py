"""Where a run's time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch

PARTS = ("environment", "inference", "learning", "evaluation")


def shares(parts: Mapping[str, float], total: float, takes_turns: bool) -> dict[str, int]:
    """Where a run's elapsed seconds went, in percent, which add up to 100.

    Args:
        parts: seconds, as `Clock.parts` has them.
        total: elapsed seconds of training and evaluation.
        takes_turns: whether collection and learning do. Where collection goes on beside learning,
            what the learner's thread does is shown: it learns, evaluates, or waits for frames.
    """
    known = dict(parts)
    if not takes_turns:
        known = {part: parts[part] for part in ("learning", "evaluation")}
    rest = "other" if takes_turns else "waiting for frames"
    known[rest] = max(0.0, total - sum(known.values()))
    exact = {part: 100 * seconds / (sum(known.values()) or 1.0) for part, seconds in known.items()}
    found = {part: int(share) for part, share in exact.items()}
    by_loss = sorted(exact, key=lambda part: found[part] - exact[part])
    for part in by_loss[: round(sum(exact.values())) - sum(found.values())]:
        found[part] += 1
    return found


class DeviceClock:
    """Seconds that a CUDA device spends on parts of its work, without waiting for it."""

    def __init__(self) -> None:
        self._spans: list[tuple[str, torch.cuda.Event, torch.cuda.Event]] = []

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Measures what the block gives the device to do, for a part."""
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        yield
        end.record()
        self._spans.append((name, begin, end))

    def read(self) -> dict[str, float]:
        """Seconds by part since the last call; waits for the device."""
        torch.cuda.synchronize()
        seconds: dict[str, float] = {}
        for name, begin, end in self._spans:
            seconds[name] = seconds.get(name, 0.0) + begin.elapsed_time(end) / 1000
        self._spans.clear()
        return seconds


class Clock:
    """Seconds of a run, over all the processes it was continued in.

    Attributes:
        parts: seconds by part: `environment` (stepping the envs), `inference` (the agent acts),
            `learning` (updates) and `evaluation`. With `collector.lag=1` the first two happen
            beside `learning`, in a second thread; each part is measured by its thread's own wall
            clock, so that they add up to more than the elapsed time. With `runtime=ray` the first
            two are means over the actors; of several learners all are those of the first. With envs
            on a CUDA device all that collects counts as `inference`, and both are times of the
            device.
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
