"""CSV files of a run as data frames, with the line of whatever is damaged.

A last line without its newline is what a crash leaves behind: it is dropped and noted. Any other
damage is an error that names file and line, because a score computed around a hole would look like
any other score. Lines are split here and not by pandas, which fills up a short line in silence.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from zipf.experiments.errors import UserError

Kind = Literal["count", "number", "number or empty", "text"]

EXPECTED: Mapping[Kind, str] = {
    "count": "a whole number",
    "number": "a finite number",
    "number or empty": "a finite number or nothing",
}


def read_table(path: Path, columns: Mapping[str, Kind], notes: list[str]) -> pd.DataFrame:
    """The named columns of a CSV file, in the order of its lines; no rows where it has none.

    Args:
        columns: what each holds: "count" is read as int64; "number" as float64, which has to be
            finite; "number or empty" likewise, with NaN for an empty field; "text" as str.
        notes: gains a sentence if the last line is torn.

    Returns:
        A frame whose index is the number of the line in the file, the header being line 1.

    Raises:
        UserError: the file cannot be read, a column is missing, or a line is damaged.
    """
    lines, torn = _complete_lines(path)
    if torn:
        notes.append(f"{path.as_posix()}: the last line is torn and was left out")
    header, *rows = _fields(path, lines) or [list(columns)]
    if missing := [name for name in columns if name not in header]:
        raise UserError(f"{path.as_posix()}, line 1: no column {', '.join(missing)}")
    texts = pd.DataFrame(rows, range(2, len(rows) + 2), header, dtype=str)
    return pd.DataFrame({name: _convert(path, texts[name], kind) for name, kind in columns.items()})


def read_header(path: Path) -> list[str]:
    """The names of the columns; empty where the file has no complete line."""
    lines, _ = _complete_lines(path)
    return _fields(path, lines[:1])[0] if lines else []


def read_bytes(path: Path) -> bytes:
    """The file's content.

    Raises:
        UserError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path.as_posix()}: cannot be read: {error.strerror}") from error


def _complete_lines(path: Path) -> tuple[list[str], bool]:
    """The lines that end in a newline, and whether there is a rest that does not."""
    if not path.exists():
        return [], False
    complete, _, torn = read_bytes(path).rpartition(b"\n")
    text = complete.decode("utf-8", errors="replace")
    return (text.split("\n") if text else []), bool(torn)


def _fields(path: Path, lines: list[str]) -> list[list[str]]:
    """Each line's fields, as many in every line."""
    rows: list[list[str]] = []
    reader = csv.reader(lines, strict=True)
    try:
        for row in reader:
            if reader.line_num != len(rows) + 1:
                raise csv.Error("a quoted field does not end")
            if rows and len(row) != len(rows[0]):
                raise csv.Error(f"{len(row)} fields where there are {len(rows[0])} columns")
            rows.append(row)
    except csv.Error as error:
        raise UserError(f"{path.as_posix()}, line {len(rows) + 1}: {error}") from error
    if rows and len(set(rows[0])) < len(rows[0]):
        raise UserError(f"{path.as_posix()}, line 1: two columns of the same name")
    return rows


def _convert(path: Path, texts: pd.Series, kind: Kind) -> pd.Series:
    if kind == "text":
        return texts
    values = pd.to_numeric(texts, errors="coerce").astype(float)
    good = np.isfinite(values.to_numpy())
    if kind == "count":
        good = texts.str.fullmatch("[0-9]{1,15}").to_numpy(bool)  # more are not exact as float64
    elif kind == "number or empty":
        good |= (texts == "").to_numpy(bool)
    if not good.all():
        line, text = next(iter(texts[~good].items()))
        shown = text if len(text) <= 40 else f"{text[:40]}..."
        raise UserError(
            f"{path.as_posix()}, line {line}: column {texts.name} has {shown!r}, "
            f"expected {EXPECTED[kind]}"
        )
    return values.astype(np.int64) if kind == "count" else values
