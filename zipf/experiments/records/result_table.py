"""A table of results: a CSV file that grows at its end, and is cut where its run goes on."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zipf.errors import UserError
from zipf.experiments.records.csv_files import plain, read_fields, read_header, read_lines

TABLES = ("metrics.csv", "evaluations.csv", "situations.csv")


class ResultTable:
    """A CSV file whose rows begin with their `update`; its header is that of the first rows.

    A checkpoint knows how long the file was (`length`). A run that goes on keeps so many bytes of
    it (`check_table`) and cuts what came later.
    """

    def __init__(self, path: Path, kept: int = 0):
        self.path = path
        self._columns: list[str] = []
        if kept:
            content = path.read_bytes()
            if (as_written := plain(path, content)) != content:
                path.write_bytes(as_written)
            os.truncate(path, kept)
            self._columns = read_header(path)
        else:
            path.unlink(missing_ok=True)

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds rows, all of them or none.

        Raises:
            ValueError: one has a column that the header lacks.
            OSError: they cannot be written.
        """
        if not rows:
            return
        text = io.StringIO()
        columns = self._columns or list(rows[0])
        writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
        if not self._columns:
            writer.writeheader()
        writer.writerows(rows)
        before = self.path.stat().st_size if self._columns else 0
        try:
            with open(self.path, "a", newline="", encoding="utf-8") as file:
                file.write(text.getvalue())
        except OSError:
            if self.path.exists():
                os.truncate(self.path, before)
            raise
        self._columns = columns

    def length(self) -> int:
        """The file's length in bytes, which are on the disk when this returns."""
        if not self._columns:
            return 0
        with open(self.path, "rb") as file:
            os.fsync(file.fileno())
            return os.fstat(file.fileno()).st_size


def check_table(path: Path, update: int, length: int) -> None:
    """Raises `UserError` where a table does not begin with the rows that it had at the checkpoint
    of `update`, when it was `length` bytes long: it is shorter, no row ends there, a row is
    malformed or of a later update."""
    if length == 0:
        return
    try:
        content = plain(path, path.read_bytes())[:length]
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; {_remedy(update)}") from None
    if len(content) < length or not content.endswith(b"\n"):
        raise UserError(f"{path}: lacks rows, or has others; {_remedy(update)}")
    lines = content.decode(errors="replace").removesuffix("\n").split("\n")
    columns, *rows = read_fields(path, lines)
    if columns[0] != "update":
        raise UserError(f"{path}, line 1: should begin with the column 'update'")
    for number, row in enumerate(rows, 2):
        first = row[0]
        if not (first.isascii() and first.isdigit() and len(first) <= 15 and int(first) <= update):
            raise UserError(
                f"{path}, line {number}: should begin with an update up to {update}, not "
                f"{first[:40]!r}; {_remedy(update)}"
            )
        if "\ufffd" in lines[number - 1]:
            raise UserError(f"{path}, line {number}: is not UTF-8 text; {_remedy(update)}")


def check_tables(folder: Path, update: int, lengths: Mapping[str, int]) -> None:
    """`check_table` of all tables of a run; `lengths` are those that its checkpoint knows."""
    for name in TABLES:
        check_table(folder / name, update, lengths[name])


def last_update(path: Path) -> str | None:
    """The update of the last row of a table that may be damaged, as it stands there; None where
    there is no row."""
    lines, _ = read_lines(path)
    return lines[-1].split(",")[0] if len(lines) > 1 else None


def ends_at(path: Path, update: int) -> bool:
    """Whether the last row of a table that may be damaged is whole and of this update."""
    lines, torn = read_lines(path)
    return not torn and len(lines) > 1 and lines[-1].split(",")[0] == str(update)


def _remedy(update: int) -> str:
    return (
        f"the run goes on from its checkpoint of update {update} only beside the rows of that time:"
        " restore the file from a copy, or remove the run's folder to train anew"
    )
