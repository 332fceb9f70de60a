"""What a run leaves behind: plain files and TensorBoard, and what it shows while it goes."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import pandas as pd
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from zipf.envs import KINDS
from zipf.experiments.errors import UserError
from zipf.experiments.running.evaluator import Result, scores, situations


class Logger:
    """Appends to `metrics.csv`, `evaluations.csv`, `situations.csv`, `train.log` and TensorBoard.

    Args:
        folder: the run's folder.
        resume_at: forget what was written after this update; -1 for a new run.

    Raises (here and in every method):
        UserError: the disk is full or cannot be written.
    """

    def __init__(self, folder: Path, resume_at: int):
        self.folder = folder
        for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
            with _writing(folder / name):
                _forget_after(folder / name, resume_at)
        events = folder / "tensorboard"
        with _writing(events):
            events.mkdir(exist_ok=True)
            # Written here and now: TensorBoard's own writer does so in a thread, where a full disk
            # goes unheard.
            name = f"events.out.tfevents.{time.time_ns()}"
            self._events = open(events / name, "wb")  # noqa: SIM115
        self._records = RecordWriter(self._events)
        self._event(file_version="brain.Event:2")
        # Hides what was shown of the steps that a resumed run takes again.
        self._event(step=resume_at + 1, session_log=SessionLog(status=SessionLog.START))

    def metrics(self, update: int, metrics: Mapping[str, float]) -> None:
        """One wide row; the columns are those of the first row ever written."""
        self._append("metrics.csv", [{"update": update, **metrics}])
        self._scalars(update, {f"train/{name}": value for name, value in metrics.items()})

    def evaluation(self, when: Mapping[str, float], results: list[Result]) -> None:
        """The rows of an evaluation, and of the situations in it."""
        update = int(when["update"])
        met = situations(results)
        met.insert(0, "update", update)
        self._append("situations.csv", met.to_dict("records"))
        self._append("evaluations.csv", [{**when, **result.row()} for result in results])
        of_levels = {f"score/{result.kind}/{result.level}": result.score for result in results}
        of_kinds = {f"score/{kind}": score for kind, score in scores(results).items()}
        several = len(of_levels) > len(of_kinds)
        self._scalars(update, {**of_kinds, **(of_levels if several else {})})

    def text(self, line: str) -> None:
        """One line of `train.log`."""
        self._write("train.log", f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")

    def close(self) -> None:
        """Closes TensorBoard's file."""
        self._events.close()

    def _append(self, name: str, rows: list[Any]) -> None:
        columns = _columns(self.folder / name)
        text = io.StringIO()
        writer = csv.DictWriter(text, columns or list(rows[0]), restval="", extrasaction="ignore")
        if not columns:
            writer.writeheader()
        writer.writerows(rows)
        self._write(name, text.getvalue())

    def _write(self, name: str, text: str) -> None:
        path = self.folder / name
        with _writing(path), open(path, "a", newline="") as file:
            file.write(text)

    def _scalars(self, update: int, values: Mapping[str, float]) -> None:
        summary = [Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()]
        self._event(step=update, summary=Summary(value=summary))

    def _event(self, **content: Any) -> None:
        event = Event(wall_time=time.time(), **content)
        with _writing(self.folder / "tensorboard"):
            self._records.write(event.SerializeToString())
            self._events.flush()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(
            f"{path}: cannot be written: {error.strerror}; the last checkpoint is kept"
        ) from None


def _columns(path: Path) -> list[str]:
    """The columns of a table that has been begun."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return next(csv.reader(file), [])


def _forget_after(path: Path, update: int) -> None:
    """Drops the rows that a resumed run will write again, and a last line cut short by a crash."""
    if not path.exists():
        return
    header, *rows = path.read_text().splitlines(keepends=True) or [""]
    if not header.endswith("\n"):
        path.unlink()
        return
    kept = []
    for number, row in enumerate(rows, 2):
        first = row.split(",")[0]
        if not row.endswith("\n"):
            continue
        if not first.isdigit():
            raise UserError(f"{path}, line {number}: should begin with an update, not {first!r}")
        if int(first) <= update:
            kept.append(row)
    replacement = path.with_name(path.name + ".new")
    replacement.write_text("".join([header, *kept]))
    replacement.replace(path)


def write_results(stem: Path, results: list[Result]) -> list[Path]:
    """Writes the results of one evaluation to `<stem>.csv` and `<stem>-situations.csv`.

    Raises:
        UserError: the disk is full or cannot be written.
    """
    tables = {
        stem.with_name(f"{stem.name}.csv"): pd.DataFrame([r.row() for r in results]),
        stem.with_name(f"{stem.name}-situations.csv"): situations(results),
    }
    for path, table in tables.items():
        with _writing(path):
            table.to_csv(path, index=False)
    return list(tables)


class Display:
    """Shows a run as it goes: a live panel on a terminal, now and then a line elsewhere."""

    def __init__(self, name: str, updates: int, update: int, console: Console | None = None):
        self.console = console or Console(highlight=False)
        self.name = name
        self.updates = updates
        self.live = self.console.is_terminal
        self.scores: dict[str, float] = {}
        self.metrics: dict[str, float] = {}
        self.progress = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("updates"),
            TimeRemainingColumn(),
        )
        self.task = self.progress.add_task("", total=updates, completed=update)
        self._live = Live(console=self.console, get_renderable=self._panel, refresh_per_second=4)
        self._printed = time.monotonic()

    def __enter__(self) -> Display:
        if self.live:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.live:
            self._live.stop()

    def say(self, line: str) -> None:
        """Prints a line, above the panel where there is one."""
        self.console.print(line, soft_wrap=True, markup=False)

    def advance(self, update: int) -> None:
        """An update was made."""
        self.progress.update(self.task, completed=update)

    def show_metrics(self, update: int, metrics: Mapping[str, float]) -> None:
        """The latest row of metrics."""
        self.metrics = dict(metrics)
        if not self.live and time.monotonic() - self._printed > 30:
            self._print(update)

    def show_scores(self, update: int, results: list[Result]) -> None:
        """The latest scores."""
        self.scores = scores(results)
        if not self.live:
            self._print(update)

    def _print(self, update: int) -> None:
        self._printed = time.monotonic()
        parts = [f"update {update}/{self.updates}"]
        if "frames" in self.metrics:
            parts.append(f"{int(self.metrics['frames']):,} frames")
            parts.append(f"{self.metrics['frames_per_second']:,.0f} frames/s")
        parts += [f"{kind} {score:.3f}" for kind, score in self.scores.items()]
        self.say("  ".join(parts))

    def _panel(self) -> Group:
        scores = Table.grid(padding=(0, 3))
        m = self.metrics
        cells = [f"{k} [bold]{self.scores[k]:.3f}[/]" for k in KINDS if k in self.scores]
        if m:
            cells += [f"{int(m['frames']):,} frames", f"{m['frames_per_second']:,.0f} frames/s"]
        scores.add_row(*cells or ["[dim]evaluating before the first update[/]"])
        parts = ("environment", "inference", "learning", "evaluation")
        seconds = {part: m.get(f"time_{part}", 0.0) for part in parts}
        total = sum(seconds.values()) or 1.0
        split = "  ".join(f"{part} {spent / total:.0%}" for part, spent in seconds.items())
        name = Text(self.name, style="bold", no_wrap=True, overflow="ellipsis")
        return Group(name, self.progress, scores, f"[dim]time: {split}[/]" if m else "")
