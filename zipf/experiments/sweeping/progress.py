"""What a sweep shows: a line when a job begins or ends, a bar on a terminal, and when all will be
done."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.text import Text

from zipf import output
from zipf.experiments.records.wording import duration_text
from zipf.experiments.sweeping.job import Job, Outcome

REPORT_EVERY = 120  # seconds; ours: where there is no terminal, a job of an hour has thirty lines


class SweepProgress:
    """Shows the jobs of a sweep. As a context manager it has a bar at the bottom of a terminal.

    Args:
        jobs: how many the sweep has.
        console: where to print; by default standard output, unless `zipf.output.is_quiet`.
    """

    def __init__(self, jobs: int, console: Console | None = None):
        self.console = console or output.console()
        self.jobs = jobs
        self._ended = 0
        self._at_once = 1  # jobs that were seen to run side by side, at most
        self._seconds: list[float] = []  # that jobs took from their begin to their end
        self._began: dict[Job, float] = {}  # those that run
        self._text: dict[Job, str] = {}  # how far they are
        self._reported: dict[Job, float] = {}
        self._bar = Progress(
            BarColumn(), MofNCompleteColumn(), TextColumn("jobs"), TextColumn("{task.description}")
        )
        self._task = self._bar.add_task("", total=jobs)
        self._live = Live(
            console=self.console, get_renderable=self._panel, refresh_per_second=2, transient=True
        )

    def __enter__(self) -> SweepProgress:
        if self.console.is_terminal and not self.console.quiet:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.console.is_terminal and not self.console.quiet:
            self._live.stop()

    def say(self, line: str) -> None:
        """Prints a line, above the bar on a terminal."""
        self.console.print(line, soft_wrap=True, markup=False)

    def show(self, job: Job, outcome: Outcome) -> None:
        """What has become of a job."""
        now = time.monotonic()
        if outcome.state == "running":
            self._text[job] = outcome.text
            last = self._reported.get(job, self._began.setdefault(job, now))
            if self.console.is_terminal or now - last < REPORT_EVERY:
                return
        elif outcome.state == "begun":
            self._began.setdefault(job, now)
            self._at_once = max(self._at_once, len(self._began))
        else:
            self._ended += 1
            if (began := self._began.pop(job, None)) is not None and outcome.state == "finished":
                self._seconds.append(now - began)
            self._bar.update(self._task, completed=self._ended)
        self._reported[job] = now
        left = self._left() if outcome.state == "finished" else None
        when = ""
        if left is not None and left >= 60 and not self.console.is_terminal:
            when = f"; {_when(left)}"
        self.say(f"{job.number}/{job.of} {job.name}: {outcome.text}{when}")

    def _left(self) -> float | None:
        """Seconds that the jobs that have not ended will take, if they take as long as those that
        have finished; None where none has, or none is left."""
        open_jobs = self.jobs - self._ended
        if not self._seconds or open_jobs <= 0:
            return None
        now = time.monotonic()
        mean = sum(self._seconds) / len(self._seconds)
        running = sum(max(mean - (now - began), 0.0) for began in self._began.values())
        waiting = mean * (open_jobs - len(self._began))
        return (running + waiting) / min(self._at_once, open_jobs)

    def _panel(self) -> Group:
        left = self._left()
        self._bar.update(self._task, description="" if left is None else _when(left))
        lines: Sequence[Text] = [
            Text(f"{job.name}: {self._text[job]}", style="dim", no_wrap=True, overflow="ellipsis")
            for job in list(self._began)
            if job in self._text
        ]
        return Group(*lines, self._bar)


def _when(left: float) -> str:
    day = "%a " if left > 43_200 else ""  # seconds; ours: half a day
    until = time.strftime(f"{day}%H:%M", time.localtime(time.time() + left))
    return f"about {duration_text(left)} left, until {until}"
