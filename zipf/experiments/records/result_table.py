"""A table of results: a CSV file that grows row by row, checked when its run goes on."""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zipf.errors import UserError
from zipf.experiments.records.checksums import hash_rows, row_bytes
from zipf.experiments.records.csv_files import read_fields, read_lines
from zipf.experiments.records.replacing import replace_text


class ResultTable:
    """A CSV file whose rows begin with their `update`, in order.

    A checkpoint has hashes of the rows so far (`state_dict`), so that a run never goes on beside a
    file that was changed, cut or emptied.

    The evaluation at the last of `updates`, if it is not one of every so many, is a *closing* row.
    A run that goes on beyond drops it, and equals one that had that many updates from the start.

    Args:
        path: of the file; whatever is there is removed.

    Attributes:
        rows: how many there are.
    """

    def __init__(self, path: Path):
        self.path = path
        self.columns: list[str] = []
        self.rows = 0
        self._all, self._regular = hashlib.sha256(), hashlib.sha256()
        path.unlink(missing_ok=True)
        self._kept: str | None = None

    @classmethod
    def resumed(
        cls, path: Path, update: int, saved: Mapping[str, str], *, keep_closing: bool
    ) -> ResultTable:
        """The table as it was at a checkpoint of this update; `drop_later_rows` is to be called.

        Args:
            saved: `state_dict()` at the checkpoint.
            keep_closing: leave rows that were closing ones: they are regular now.

        Raises:
            UserError: the file does not hold these rows.
        """
        table = cls.__new__(cls)
        table.path = path
        table._kept = None
        columns, rows, lines, torn = _read(path)
        kept = sum(int(row[0]) <= update for row in rows)
        hashed = hash_rows(columns, rows[:kept])
        if saved["all"] != saved["regular"] and not keep_closing:
            before = sum(int(row[0]) < update for row in rows)
            # The closing rows are gone already if the run was killed before its next checkpoint.
            if hashed.hexdigest() == saved["all"] or kept == before:
                kept, hashed = before, hash_rows(columns, rows[:before])
                saved = {"all": saved["regular"]}
        if hashed.hexdigest() != saved["all"]:
            raise _damaged(path, update)
        table.columns = columns if kept else []
        table.rows = kept
        table._all, table._regular = hashed, hashed.copy()
        if kept < len(rows) or torn:
            table._kept = "".join(f"{line}\n" for line in lines[: 1 + kept if kept else 0])
        return table

    def drop_later_rows(self) -> None:
        """Cuts the file to the rows that there were at the checkpoint."""
        if self._kept is not None:
            replace_text(self.path, self._kept)
        self._kept = None

    @staticmethod
    def check(path: Path, update: int, saved: Mapping[str, str]) -> None:
        """Raises `UserError` if the file holds other rows than at the checkpoint, or more."""
        columns, rows, _, torn = _read(path)
        if torn or hash_rows(columns, rows).hexdigest() != saved["all"]:
            raise _damaged(path, update)

    def append(self, rows: Sequence[Mapping[str, Any]], *, closing: bool = False) -> None:
        """Adds rows; columns may come and go."""
        new = [name for row in rows for name in row if name not in self.columns]
        new = list(dict.fromkeys(new))
        if self.columns and new:
            self._add_columns(new)
        text = io.StringIO()
        columns = [*self.columns, *new]
        writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
        if not self.columns:
            writer.writeheader()
        start = text.tell()
        writer.writerows(rows)
        with open(self.path, "a", newline="", encoding="utf-8") as file:
            file.write(text.getvalue())
        self.columns = columns
        self.rows += len(rows)
        for row in csv.reader(text.getvalue()[start:].splitlines()):
            self._all.update(row_bytes(columns, row))
            if not closing:
                self._regular.update(row_bytes(columns, row))

    def state_dict(self) -> dict[str, str]:
        """Hashes of the rows so far, which are on the disk when this returns."""
        if self.path.exists():
            with open(self.path, "rb") as file:
                os.fsync(file.fileno())
        return {"all": self._all.hexdigest(), "regular": self._regular.hexdigest()}

    def _add_columns(self, new: list[str]) -> None:
        """Adds empty columns to the file."""
        columns, rows, _, _ = _read(self.path)
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*columns, *new])
        writer.writerows([*row, *([""] * len(new))] for row in rows)
        replace_text(self.path, text.getvalue())


def last_update(path: Path) -> str | None:
    """The update of the last row of a table that may be damaged, as it stands there; None where
    there is no row."""
    lines, _ = read_lines(path)
    return lines[-1].split(",")[0] if len(lines) > 1 else None


def _read(path: Path) -> tuple[list[str], list[list[str]], list[str], bool]:
    """Columns, rows, complete lines (the header's first), and whether a torn line follows.

    Raises:
        UserError: a line is damaged.
    """
    lines, torn = read_lines(path)
    if not lines:
        return [], [], [], torn
    columns, *rows = read_fields(path, lines)
    if columns[:1] != ["update"]:
        raise UserError(f"{path}, line 1: should begin with the column 'update'")
    for number, row in enumerate(rows, 2):
        if not (row[0].isascii() and row[0].isdigit() and len(row[0]) <= 15):
            raise UserError(
                f"{path}, line {number}: should begin with an update, not {row[0][:40]!r}"
            )
    return columns, rows, lines, torn


def _damaged(path: Path, update: int) -> UserError:
    what = "does not hold the rows" if path.exists() else "is missing, and had rows at the time"
    return UserError(
        f"{path}: {what} of the checkpoint of update {update}; restore it from a copy, or remove "
        "the run's folder to train anew"
    )
