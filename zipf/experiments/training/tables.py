"""The result files of a run: CSV tables and a text log."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from zipf.errors import writing
from zipf.experiments.evaluation.evaluator import Result, situations
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.records.result_table import TABLES, ResultTable, check_tables

KEPT = "; the last checkpoint is kept"


class Tables:
    """Appends to `metrics.csv`, `evaluations.csv`, `situations.csv` and `train.log`.

    Args:
        folder: the run's folder.
        update: the one that the run goes on from.
        lengths: of the tables, `lengths()` at that update, to which they are cut; None for a new
            run.

    Raises (here and in every method):
        UserError: the disk is full or cannot be written, or a table is damaged.
    """

    def __init__(self, folder: Path, update: int, lengths: Mapping[str, int] | None = None):
        self.folder = folder
        if lengths is not None:
            check_tables(folder, update, lengths)
        self._tables = {}
        for name in TABLES:
            with writing(folder / name, KEPT):
                self._tables[name] = ResultTable(folder / name, lengths[name] if lengths else 0)

    def lengths(self) -> dict[str, int]:
        """The tables' lengths in bytes, for a checkpoint; so much is on the disk on return."""
        with writing(self.folder, KEPT):
            return {name: table.length() for name, table in self._tables.items()}

    def metrics(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> None:
        """A row for each metric, of the update `when["update"]`."""
        rows = [{**when, "metric": name, "value": value} for name, value in metrics.items()]
        self._append("metrics.csv", rows)

    def evaluation(self, when: Mapping[str, float], results: list[Result], visits: Visits) -> None:
        """The rows of an evaluation, and of the situations in it with how often training has met
        them."""
        met = visits.beside(situations(results))
        met.insert(0, "update", int(when["update"]))
        self._append("situations.csv", met.to_dict("records"))
        self._append("evaluations.csv", [{**when, **result.row()} for result in results])

    def text(self, line: str) -> None:
        """One line of `train.log`."""
        path = self.folder / "train.log"
        with writing(path, KEPT), open(path, "a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")

    def _append(self, name: str, rows: Sequence[Any]) -> None:
        with writing(self.folder / name, KEPT):
            self._tables[name].append(rows)


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
        with writing(path):
            table.to_csv(path, index=False)
    return list(tables)
