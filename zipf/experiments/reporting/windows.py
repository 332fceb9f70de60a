"""The window of a table: which evaluations of a run its score is taken from."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zipf.experiments.errors import UserError
from zipf.experiments.reporting.results import Run
from zipf.experiments.reporting.wording import count_text


@dataclass(frozen=True)
class UpdateWindow:
    """All evaluations at updates `start` to `end`, both included."""

    start: int
    end: int

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        return updates.between(self.start, self.end)

    def __str__(self) -> str:
        return f"{self.start}:{self.end}"


@dataclass(frozen=True)
class LastEvaluations:
    """The last `count` evaluations of each run, at whatever updates."""

    count: int

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        return updates.isin(np.unique(updates)[-self.count :])

    def __str__(self) -> str:
        return "last" if self.count == 1 else f"last:{self.count}"


Window = UpdateWindow | LastEvaluations


def parse_window(text: str) -> Window:
    """The window that `text` names: `2000000:3000000`, `2M:3M`, `last` or `last:10`.

    Raises:
        UserError: none of these.
    """
    if match := re.fullmatch(r"last(?::([1-9][0-9]{0,8}))?", text):
        return LastEvaluations(int(match[1] or 1))
    if match := re.fullmatch(r"([0-9]{1,12})([kM]?):([0-9]{1,12})([kM]?)", text):
        factor = {"": 1, "k": 1_000, "M": 1_000_000}
        start, end = int(match[1]) * factor[match[2]], int(match[3]) * factor[match[4]]
        if start <= end:
            return UpdateWindow(start, end)
        raise UserError(f"window {text!r} ends before it starts")
    raise UserError(
        f"window {text!r} is neither START:END in updates (2000000:3000000, 2M:3M) "
        f"nor last or last:N (the last N evaluations of each run)"
    )


def window_text(window: Window) -> str:
    """The window in words."""
    if isinstance(window, UpdateWindow):
        return f"updates {count_text(window.start)} to {count_text(window.end)}"
    return f"the last {window.count} evaluations" if window.count > 1 else "the last evaluation"


def window_of(run: Run, window: Window) -> Window:
    """The window that a run of a table is scored over: an external agent's last evaluation."""
    return LastEvaluations(1) if run.description.external else window


def evaluations_inside(run: Run, window: Window) -> pd.DataFrame:
    """The rows of a run's evaluations that its score in a table is taken from."""
    return run.evaluations[window_of(run, window).select(run.evaluations["update"])]


def situations_inside(run: Run, window: Window) -> pd.DataFrame:
    """The rows of a run's situations at the updates of `evaluations_inside`."""
    return run.situations[window_of(run, window).select(run.situations["update"])]
