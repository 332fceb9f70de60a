"""CSV files of a run as data frames, with the line of whatever is damaged.

A last line without its newline is what a crash leaves behind: it is dropped and noted. Any other
damage is an error that names file and line, because a score computed around a hole would look like
any other score. pandas reads the files; that every line has as many fields as the header is checked
before, because pandas fills up short lines without a word.
"""

from __future__ import annotations

import csv
import io
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
    header = _check_fields(path, lines) or list(columns)
    if missing := [name for name in columns if name not in header]:
        raise UserError(f"{path.as_posix()}, line 1: no column {', '.join(missing)}")
    texts = pd.read_csv(
        io.StringIO("\n".join(lines)),
        header=0 if lines else None,
        names=header,
        usecols=list(columns),
        dtype=str,
        na_filter=False,
        skip_blank_lines=False,
    )
    texts.index += 2
    return pd.DataFrame({name: _convert(path, texts[name], kind) for name, kind in columns.items()})


def read_header(path: Path) -> list[str]:
    """The names of the columns; empty where the file has no complete line."""
    lines, _ = _complete_lines(path)
    return _check_fields(path, lines[:1])


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


def _check_fields(path: Path, lines: list[str]) -> list[str]:
    """The header, empty where there is no line; raises `UserError` at a line with another number of
    fields."""
    header: list[str] = []
    reader = csv.reader(lines, strict=True)
    checked = 0
    try:
        for fields in reader:
            if reader.line_num != checked + 1:
                raise csv.Error("a quoted field does not end")
            if "\r" in lines[checked].removesuffix("\r"):
                raise csv.Error("a carriage return inside the line")
            header = header or fields
            if len(fields) != len(header):
                raise csv.Error(f"{len(fields)} fields where there are {len(header)} columns")
            checked += 1
    except csv.Error as error:
        raise UserError(f"{path.as_posix()}, line {checked + 1}: {error}") from error
    if len(set(header)) < len(header):
        raise UserError(f"{path.as_posix()}, line 1: two columns of the same name")
    return header


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
