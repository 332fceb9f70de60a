"""The result files of a run: CSV tables, a text log and TensorBoard events."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from zipf.experiments.errors import UserError
from zipf.experiments.running.evaluator import Result, scores, situations


class Logger:
    """Appends to `metrics.csv`, `evaluations.csv`, `situations.csv`, `train.log` and TensorBoard.

    Args:
        folder: the run's folder.
        resume_at: rows of later updates are dropped; -1 for a new run.

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
            # TensorBoard's own writer writes in a thread, where nobody sees that the disk is full.
            name = f"events.out.tfevents.{time.time_ns()}"
            self._events = open(events / name, "wb")  # noqa: SIM115
        self._records = RecordWriter(self._events)
        self._event(file_version="brain.Event:2")
        # TensorBoard then hides the points that a resumed run writes again.
        self._event(step=resume_at + 1, session_log=SessionLog(status=SessionLog.START))

    def metrics(self, update: int, metrics: Mapping[str, float]) -> None:
        """One row, a column for each metric; metrics may come and go."""
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
        path = self.folder / name
        columns = _columns(path)
        new = [column for column in rows[0] if column not in columns]
        if columns and new:
            with _writing(path):
                _add_columns(path, new)
        text = io.StringIO()
        writer = csv.DictWriter(text, [*columns, *new], restval="", lineterminator="\n")
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
    """The columns of a table; none before its first row."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return next(csv.reader(file), [])


def _add_columns(path: Path, columns: list[str]) -> None:
    """Adds empty columns to a table."""
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    replacement = path.with_name(path.name + ".new")
    table.assign(**dict.fromkeys(columns, "")).to_csv(replacement, index=False)
    replacement.replace(path)


def _forget_after(path: Path, update: int) -> None:
    """Drops the rows that a resumed run will write again, and a last line that a crash cut."""
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
