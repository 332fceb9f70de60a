"""The window of a table: which evaluations of a run its score is taken from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from zipf.errors import UserError
from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import updates_text


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
    """The last `count` evaluations of each run, at whatever updates; that of the untrained agent,
    at update 0, only where there is no other."""

    count: int

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        every = np.unique(updates)
        trained = every[every > 0]
        return updates.isin((trained if len(trained) else every)[-self.count :])

    def __str__(self) -> str:
        return "last" if self.count == 1 else f"last:{self.count}"


@dataclass(frozen=True)
class ScaledWindow:
    """Updates `start` to `end`, at the same fractions of each run that is shorter than `end`.

    A run whose last evaluation is at update `u < end` is scored over updates `start * u / end` to
    `u`, both included; a longer one over `start` to `end`.
    """

    start: int
    end: int

    def inside(self, last: int) -> tuple[float, int]:
        """The first and the last update of the window in a run whose last evaluation is `last`."""
        return (self.start * last / self.end, last) if last < self.end else (self.start, self.end)

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        return updates.between(*self.inside(int(updates.max()))) if len(updates) else updates > 0

    def __str__(self) -> str:
        return f"scaled:{self.start}:{self.end}"


@dataclass(frozen=True)
class OwnWindows:
    """Each run's own window, for tables whose runs have different windows."""

    def __str__(self) -> str:
        return "own"


Window = UpdateWindow | LastEvaluations | ScaledWindow | OwnWindows
Asked = UpdateWindow | LastEvaluations | OwnWindows | Literal["scaled"]
"""What a reader may ask for: a window; each experiment's own, scaled to each run; or each run's
own, whether or not the other runs of its table have the same."""


def used_window(own: tuple[int, int], asked: Asked | None) -> Window:
    """The window of an experiment whose own is `own`, in updates; None asks for that."""
    if asked == "scaled":
        return ScaledWindow(*own)
    return asked or UpdateWindow(*own)


def table_window(runs: Sequence[Run], asked: Asked | None) -> tuple[Window, bool]:
    """The window of a table of these runs, and whether it is their experiment's own, also where
    it was asked for in another way. External agents alone have their last evaluation."""
    ours = [run for run in runs if not run.description.external]
    windows = dict.fromkeys(run.description.window for run in ours)
    own = [UpdateWindow(*window) for window in windows if window is not None]
    if not own:
        return LastEvaluations(1), True
    used = used_window((own[0].start, own[0].end), asked)
    if isinstance(used, ScaledWindow):
        lasts = [run.evaluations["update"].max() for run in ours if len(run.evaluations)]
        if all(last >= used.end for last in lasts):
            used = own[0]
    elif isinstance(used, OwnWindows) and len(own) == 1:
        used = own[0]
    return used, isinstance(used, OwnWindows) or own == [used]


def parse_window(text: str) -> Asked:
    """The window that `text` names: `2000000:3000000`, `2M:3M`, `last`, `last:10`, `scaled` or
    `own`. Raises UserError: none of these."""
    if text == "scaled":
        return "scaled"
    if text == "own":
        return OwnWindows()
    if match := re.fullmatch(r"last(?::([1-9][0-9]{0,8}))?", text):
        return LastEvaluations(int(match[1] or 1))
    if match := re.fullmatch(r"([0-9]{1,12})([kM]?):([0-9]{1,12})([kM]?)", text):
        factor = {"": 1, "k": 1_000, "M": 1_000_000}
        start, end = int(match[1]) * factor[match[2]], int(match[3]) * factor[match[4]]
        if start <= end:
            return UpdateWindow(start, end)
        raise UserError(f"window {text!r} ends before it starts")
    raise UserError(
        f"window {text!r} is neither START:END in updates (2000000:3000000, 2M:3M), nor last or "
        f"last:N (the last N evaluations of each run), nor scaled (the experiment's own window, at "
        f"the same fractions of a shorter run), nor own (that of each run, in one table)"
    )


def window_text(window: Window) -> str:
    """The window in words."""
    if isinstance(window, OwnWindows):
        return "each run's own window"
    if isinstance(window, UpdateWindow):
        return f"updates {updates_text(window.start, window.end)}"
    if isinstance(window, ScaledWindow):
        share = 100 * window.start / max(window.end, 1)
        return (
            f"{share:.3g} to 100 % of each run, which are the fractions of updates "
            f"{updates_text(window.start, window.end)}"
        )
    return f"the last {window.count} evaluations" if window.count > 1 else "the last evaluation"


def window_of(run: Run, window: Window) -> UpdateWindow | LastEvaluations | ScaledWindow:
    """The window that a run of a table is scored over: an external agent's last evaluation."""
    if run.description.external:
        return LastEvaluations(1)
    if isinstance(window, OwnWindows):
        assert run.description.window is not None  # checked when it was read
        return UpdateWindow(*run.description.window)
    return window


def evaluations_inside(run: Run, window: Window) -> pd.DataFrame:
    """The rows of a run's evaluations that its score in a table is taken from."""
    return run.evaluations[window_of(run, window).select(run.evaluations["update"])]


def situations_inside(run: Run, window: Window) -> pd.DataFrame:
    """The rows of a run's situations at the updates of `evaluations_inside`."""
    inside = evaluations_inside(run, window)["update"]
    return run.situations[run.situations["update"].isin(inside)]
