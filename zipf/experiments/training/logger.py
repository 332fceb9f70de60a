"""The result files of a run: CSV tables, a text log and TensorBoard events."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from zipf.errors import UserError
from zipf.experiments.evaluation.evaluator import Result, scores, situations
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.records.result_table import TABLES, ResultTable, check_table


class Logger:
    """Appends to `metrics.csv`, `evaluations.csv`, `situations.csv`, `train.log` and TensorBoard.

    Args:
        folder: the run's folder.
        resume_at: the update that the run goes on from; -1 for a new run.
        lengths: of the tables, `lengths()` at that update, to which they are cut; None for a new
            run.

    Raises (here and in every method):
        UserError: the disk is full or cannot be written, or a table is damaged.
    """

    def __init__(self, folder: Path, resume_at: int, lengths: Mapping[str, int] | None = None):
        self.folder = folder
        if lengths is not None:
            self.check(folder, resume_at, lengths)
        self._tables = {}
        for name in TABLES:
            with _writing(folder / name):
                self._tables[name] = ResultTable(folder / name, lengths[name] if lengths else 0)
        events = folder / "tensorboard"
        with _writing(events):
            events.mkdir(exist_ok=True)
            # TensorBoard's own writer writes in a thread, where nobody sees that the disk is full.
            # It reads the files in the order of their names, so they are numbered: the time of day
            # may stand still, or be set back.
            numbers = (path.name.rpartition(".")[2] for path in events.iterdir())
            number = 1 + max((int(text) for text in numbers if text.isdecimal()), default=0)
            name = f"events.out.tfevents.{number:08}"
            self._events = open(events / name, "xb")  # noqa: SIM115
        self._records = RecordWriter(self._events)
        self._event(file_version="brain.Event:2")
        # TensorBoard then hides the points that a resumed run writes again.
        self._event(step=resume_at + 1, session_log=SessionLog(status=SessionLog.START))

    @staticmethod
    def check(folder: Path, update: int, lengths: Mapping[str, int]) -> None:
        """Raises `UserError` where a table lacks rows that it had at a checkpoint."""
        for name in TABLES:
            check_table(folder / name, update, lengths[name])

    def lengths(self) -> dict[str, int]:
        """The tables' lengths in bytes, for a checkpoint; so much is on the disk on return."""
        with _writing(self.folder):
            return {name: table.length() for name, table in self._tables.items()}

    def metrics(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> None:
        """A row for each metric, of the update `when["update"]`."""
        rows = [{**when, "metric": name, "value": value} for name, value in metrics.items()]
        self._append("metrics.csv", rows)
        self._scalars(
            int(when["update"]),
            {f"train/{name}": value for name, value in {**when, **metrics}.items()},
        )

    def evaluation(self, when: Mapping[str, float], results: list[Result], visits: Visits) -> None:
        """The rows of an evaluation, and of the situations in it with how often training has met
        them."""
        update = int(when["update"])
        met = visits.beside(situations(results))
        met.insert(0, "update", update)
        self._append("situations.csv", met.to_dict("records"))
        self._append("evaluations.csv", [{**when, **result.row()} for result in results])
        of_levels = {f"score/{result.kind}/{result.level}": result.score for result in results}
        of_kinds = {f"score/{kind}": score for kind, score in scores(results).items()}
        several = len(of_levels) > len(of_kinds)
        self._scalars(update, {**of_kinds, **(of_levels if several else {})})

    def text(self, line: str) -> None:
        """One line of `train.log`."""
        path = self.folder / "train.log"
        with _writing(path), open(path, "a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")

    def close(self) -> None:
        """Closes TensorBoard's file."""
        self._events.close()

    def _append(self, name: str, rows: Sequence[Any]) -> None:
        with _writing(self.folder / name):
            self._tables[name].append(rows)

    def _scalars(self, update: int, values: Mapping[str, float]) -> None:
        summary = [Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()]
        self._event(step=update, summary=Summary(value=summary))

    def _event(self, **content: Any) -> None:
        event = Event(wall_time=time.time(), **content)
        with _writing(self.folder / "tensorboard"):
            self._records.write(event.SerializeToString())
            self._events.flush()


@contextmanager
def _writing(path: Path, kept: str = "; the last checkpoint is kept") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}{kept}") from None


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
        with _writing(path, kept=""):
            table.to_csv(path, index=False)
    return list(tables)
