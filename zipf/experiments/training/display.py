"""What a run shows while it trains."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from zipf import output
from zipf.envs import KINDS
from zipf.experiments.evaluation.evaluator import Result, scores
from zipf.experiments.records.wording import duration_text
from zipf.experiments.training.clock import PARTS, shares


class Display:
    """Shows a run's progress: a live panel on a terminal, elsewhere a line after every evaluation
    and every half minute.

    Args:
        name: the run's.
        updates: to reach.
        update: those made already.
        frames_per_update: frames that one consumes.
        takes_turns: whether collection and learning do, see `shares`.
        console: where to print; by default standard output, unless `zipf.output.is_quiet`.
    """

    def __init__(
        self,
        name: str,
        updates: int,
        update: int,
        *,
        frames_per_update: int,
        takes_turns: bool = True,
        console: Console | None = None,
    ):
        self.console = console or output.console()
        self._is_muted = console is not None and console.quiet
        self.name = name
        self.updates = updates
        self.update = update
        self.frames_per_update = frames_per_update
        self.takes_turns = takes_turns
        self.live = self.console.is_terminal and not self.console.quiet
        self.scores: dict[str, float] = {}
        self.metrics: dict[str, float] = {}
        self.evaluation: tuple[int, int] | None = None  # episodes that have ended, of how many
        self.progress = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("updates"),
            TimeRemainingColumn(),
        )
        self.task = self.progress.add_task("", total=updates, completed=update)
        self._live = Live(console=self.console, get_renderable=self._panel, refresh_per_second=4)
        self._printed = time.monotonic()

    def start(self) -> None:
        """Shows the live panel on a terminal."""
        if self.live:
            self._live.start()

    def stop(self) -> None:
        """Takes the live panel down."""
        if self.live:
            self._live.stop()

    def say(self, line: str) -> None:
        """Prints a line, above the panel on a terminal."""
        self.console.print(line, soft_wrap=True, markup=False)

    def warn(self, line: str) -> None:
        """Prints a line that is not left out where others are, then to standard error; not by those
        learners that print nothing."""
        if output.is_quiet() and not self._is_muted:
            print(line, file=sys.stderr)
        else:
            self.say(line)

    def advance(self, update: int) -> None:
        """An update was made."""
        self.update = update
        self.progress.update(self.task, completed=update)

    def show_metrics(self, metrics: Mapping[str, float]) -> None:
        """The latest row of metrics."""
        self.metrics = dict(metrics)
        if not self.live and time.monotonic() - self._printed > 30:
            self._print([f"return {metrics['episode_return']:.3f} in training"])

    def show_evaluation(self, ended: int, episodes: int) -> None:
        """How far the evaluation under way is."""
        self.evaluation = ended, episodes
        if not self.live and time.monotonic() - self._printed > 30:
            self._print([f"evaluating: {ended:,} of {episodes:,} episodes"])

    def show_scores(self, results: list[Result]) -> None:
        """The latest scores."""
        self.scores = scores(results)
        self.evaluation = None
        if not self.live:
            self._print([f"{kind} {score:.3f}" for kind, score in self.scores.items()])

    def _print(self, shown: list[str]) -> None:
        self._printed = time.monotonic()
        update = f"update {self.update}/{self.updates}"
        self.say("  ".join([update, *self._speed(), *self._left(), *shown]))

    def _speed(self) -> list[str]:
        if not self.metrics:
            return []
        return [
            f"{self.update * self.frames_per_update:,} frames",
            f"{self.metrics['frames_per_second']:,.0f} frames/s",
        ]

    def _left(self) -> list[str]:
        if not self.metrics or self.update >= self.updates:
            return []
        frames = (self.updates - self.update) * self.frames_per_update
        return [f"{duration_text(frames / self.metrics['frames_per_second'])} left"]

    def _panel(self) -> Group:
        scores = Table.grid(padding=(0, 3))
        m = self.metrics
        cells = [f"{k} [bold]{self.scores[k]:.3f}[/]" for k in KINDS if k in self.scores]
        cells += self._speed()
        if not cells and self.update == 0 and not self.evaluation:
            cells = ["[dim]evaluating before the first update[/]"]
        if self.evaluation:
            cells.append("[dim]evaluating: {:,} of {:,} episodes[/]".format(*self.evaluation))
        scores.add_row(*cells)
        name = Text(self.name, style="bold", no_wrap=True, overflow="ellipsis")
        if not m:
            return Group(name, self.progress, scores)
        seconds = {part: m[f"time_{part}"] for part in PARTS}
        known = shares(seconds, m["seconds"], self.takes_turns)
        split = "  ".join(f"{part} {share}%" for part, share in known.items())
        return Group(name, self.progress, scores, f"[dim]time: {split}[/]")
