"""What a logger is, and the registry of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zipf.registry import Registry


@dataclass(frozen=True)
class Start:
    """A run that starts or goes on.

    Attributes:
        folder: the run's; the result tables in it end at `update`.
        name: the run's, for people.
        is_new: whether it starts rather than goes on from a checkpoint.
        update, frames: those made so far.
        options: all options of the run, nested: {"agent": {"discount": 0.99, ...}, ...}.
        kinds: the kinds of levels that evaluations score, such as "rare".
    """

    folder: Path
    name: str
    is_new: bool
    update: int
    frames: int
    options: Mapping[str, Any]
    kinds: tuple[str, ...]


@dataclass(frozen=True)
class End:
    """How a command ended.

    Attributes:
        update: updates made.
        finished: whether the run has nothing left to do.
        film: records a failure of the agent in the rarest situation and returns the GIF's file;
            None where it has not failed there. It plays the checkpoint, and raises `UserError`
            where envs report no success or draw no pictures.
    """

    update: int
    finished: bool
    film: Callable[[], Path | None]


class Logger:
    """Is called as a run goes on; a method that is not needed is left out.

    `when` has the `update`, the `frames` so far and the `seconds` of training and evaluation. What
    a method returns, if not None, is why the run is to stop: it ends with a checkpoint and goes on
    where the same command is given again. Nothing that a logger does changes what is learned, as
    long as it draws no random numbers from PyTorch's global generator.

    An error in `on_start` ends the run before it begins. Later ones switch the logger off, which is
    said at once and at the end, and the run goes on.
    """

    def on_start(self, run: Start) -> str | None:
        """The command starts or goes on with a run."""

    def on_update(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> str | None:
        """An update was made and is logged, as `schedule.log_every` says."""

    def on_evaluation(self, when: Mapping[str, float], scores: Mapping[str, float]) -> str | None:
        """The agent was scored: "rare" is the score of a kind of levels, "rare/<level>" that of a
        level where a kind has several. The run's `evaluations.csv` has these rows already."""

    def on_end(self, end: End) -> None:
        """The command ends, also by an error."""


LOGGERS: Registry[Logger] = Registry("loggers", several=True)
"""Each is built from its options."""
