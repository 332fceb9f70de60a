"""Checksums of a run's files, by which a report knows that they are as the run left them.

`checksums.json` covers `run.json`, `config.yaml`, and the rows that the tables had at the last
checkpoint: a run that goes on has more.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zipf.errors import UserError
from zipf.experiments.records.csv_files import read_bytes, read_fields, read_lines
from zipf.experiments.records.replacing import replace_text

NAME = "checksums.json"
FILES = ("run.json", "config.yaml")
TABLES = ("metrics.csv", "evaluations.csv", "situations.csv")

Sum = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Checksums(BaseModel):
    """The contents of `checksums.json`; sums are SHA-256.

    Attributes:
        update: of the last rows that `tables` covers; -1 where there are none.
        files: of whole files; those that are not named are not there.
        tables: of the rows of every table, see `row_bytes`.
        rows: of every table, how many of the rows up to that update are covered: those of the
            evaluation that ends a run may follow. None, as in files of earlier versions: all.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    update: int
    files: dict[str, Sum]
    tables: dict[str, Sum]
    rows: dict[str, Annotated[int, Field(ge=0)]] | None = None


def row_bytes(columns: Sequence[str], row: Sequence[str]) -> bytes:
    """What is hashed of a row of a table. An empty cell counts as none: rows stay the same when a
    column is added to the file."""
    cells = {name: cell for name, cell in zip(columns, row, strict=True) if cell}
    return json.dumps(cells).encode() + b"\n"


def hash_rows(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Any:
    """A sha256 object that was given these rows."""
    hashed = hashlib.sha256()
    for row in rows:
        hashed.update(row_bytes(columns, row))
    return hashed


def write(folder: Path, update: int, tables: Mapping[str, tuple[str, int]] | None = None) -> None:
    """Writes `checksums.json`.

    Args:
        folder: the run's folder.
        update: of the last rows that are covered.
        tables: of every table, the hash of its rows up to it and their number; None: of those
            that are there.

    Raises:
        OSError: it cannot be written.
    """
    if tables is None:
        tables = {name: _rows_until(folder / name, update) for name in TABLES}
    sums = Checksums(
        update=update,
        files=_files(folder),
        tables={name: hashed for name, (hashed, _) in tables.items()},
        rows={name: count for name, (_, count) in tables.items()},
    )
    replace_text(folder / NAME, sums.model_dump_json(indent=2) + "\n")


def check(folder: Path) -> str | None:
    """Whether the files of a run are as the run left them.

    Returns a note where that is not known, because there is no `checksums.json`.

    Raises:
        UserError: a file was changed, or `checksums.json` is damaged.
    """
    path = folder / NAME
    if not path.exists():
        return f"{folder.as_posix()}: has no {NAME}: whether its files were changed is not known"
    try:
        sums = Checksums.model_validate_json(read_bytes(path))
    except ValidationError:
        raise UserError(f"{path.as_posix()}: is damaged; restore it from a copy") from None
    files = _files(folder)
    tables = {}
    for name in TABLES:
        covered = None if sums.rows is None else sums.rows.get(name)
        tables[name], _ = _rows_until(folder / name, sums.update, covered)
    for there, now in ((sums.files, files), (sums.tables, tables)):
        for name in sorted(there.keys() | now.keys()):
            if there.get(name) != now.get(name):
                raise UserError(
                    f"{(folder / name).as_posix()}: is not as the run left it (by {NAME}); restore "
                    "it from a copy"
                )
    return None


def _files(folder: Path) -> dict[str, str]:
    there = (name for name in FILES if (folder / name).exists())
    return {name: hashlib.sha256(read_bytes(folder / name)).hexdigest() for name in there}


def _rows_until(path: Path, update: int, most: int | None = None) -> tuple[str, int]:
    """The hash of a table's rows up to an update, and their number.

    Where there are more than `most`, the others are left out if they are of that update and no
    row before them is.
    """
    lines, _ = read_lines(path)
    if not lines:
        return hash_rows([], []).hexdigest(), 0
    columns, *rows = read_fields(path, lines)
    where = columns.index("update")
    covered = [row for row in rows if row[where].isdecimal() and int(row[where]) <= update]
    if most is not None:
        before, after = covered[:most], covered[most:]
        if {int(row[where]) for row in after} == {update} and not any(
            int(row[where]) == update for row in before
        ):
            covered = before
    return hash_rows(columns, covered).hexdigest(), len(covered)
