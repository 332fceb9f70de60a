"""CSV files of a run as data frames, with the line of whatever is damaged.

A last line without its newline is what a crash leaves behind: it is dropped and noted. Any other
damage is an error that names file and line, because a score computed around a hole would look like
any other score. `csv` reads them in strict mode: pandas fills up short lines without a word.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from zipf.errors import UserError, reading

if TYPE_CHECKING:
    import pandas as pd

Kind = Literal["count", "count or empty", "number", "number or empty", "text"]

EXPECTED: Mapping[Kind, str] = {
    "count": "a whole number",
    "count or empty": "a whole number or nothing",
    "number": "a finite number",
    "number or empty": "a finite number or nothing",
}


def read_texts(path: Path, notes: list[str]) -> pd.DataFrame:
    """A CSV file, compressed if its name ends in .gz, as text in the order of its lines; no columns
    where it has no line. `notes` gains a sentence if the last line is torn.

    Returns a frame of str whose index is the number of the line in the file, the header being line
    1. Raises UserError: the file cannot be read, or a line is damaged.
    """
    lines, torn = read_lines(path)
    if torn:
        notes.append(f"{path.as_posix()}: the last line is torn and was left out")
    import pandas as pd  # here: the options of a run, which import this module, read no table

    if not lines:
        return pd.DataFrame()
    header, *rows = read_fields(path, lines)
    return pd.DataFrame(rows, pd.RangeIndex(2, len(rows) + 2), header, dtype=str)


def values_of(path: Path, texts: pd.DataFrame, columns: Mapping[str, Kind]) -> pd.DataFrame:
    """The values of columns of a table, or of some of its rows.
    Raises UserError: a column is missing, or has something else.

    Args:
        path: of the file, for messages.
        texts: as `read_texts` reads them.
        columns: what each holds: "count" is read as int64; "number" as float64, which has to be
            finite; "number or empty" likewise, with NaN for an empty field; "text" as str.
    """
    import pandas as pd

    if not len(texts.columns):
        texts = pd.DataFrame(columns=list(columns), dtype=str)
    if missing := [name for name in columns if name not in texts]:
        raise UserError(f"{path.as_posix()}, line 1: no column {', '.join(missing)}")
    return pd.DataFrame({name: _convert(path, texts[name], kind) for name, kind in columns.items()})


def read_header(path: Path) -> list[str]:
    """The names of the columns; empty where the file has no complete line."""
    lines, _ = read_lines(path)
    return read_fields(path, lines[:1])[0] if lines else []


def read_bytes(path: Path) -> bytes:
    """The file's content. Raises UserError: it cannot be read."""
    with reading(path):
        return path.read_bytes()


def plain(path: Path, content: bytes) -> bytes:
    """A text file's content as we write it: programs of Windows put a mark before it, and end its
    lines with a carriage return, too.

    Raises:
        UserError: it is UTF-16, as those programs also write.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise UserError(f"{path.as_posix()}: is UTF-16 text; should be UTF-8")
    return content.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n")


def read_lines(path: Path) -> tuple[list[str], bool]:
    """The lines that end in a newline, without it, and whether there is a rest that does not; no
    lines where there is no file. Raises UserError: the file cannot be read."""
    if not path.exists():
        return [], False
    content = read_bytes(path)
    if path.suffix == ".gz":
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise UserError(f"{path.as_posix()}: is damaged ({error})") from None
    complete, end, torn = plain(path, content).rpartition(b"\n")
    text = complete.decode("utf-8", errors="replace")
    return (text.split("\n") if end else []), bool(torn)


def read_fields(path: Path, lines: list[str]) -> list[list[str]]:
    """The fields of each line, those of the header first; the path is for messages. Raises
    UserError: a line has another number of fields than the header, or other damage."""
    reader = csv.reader(lines, strict=True)
    found: list[list[str]] = []
    try:
        for fields in reader:
            if reader.line_num != len(found) + 1:
                raise csv.Error("a quoted field does not end")
            if "\r" in lines[len(found)]:
                raise csv.Error("a carriage return inside the line")
            if not found and not fields:
                raise csv.Error("is empty")
            if found and len(fields) != len(found[0]):
                raise csv.Error(f"{len(fields)} fields where there are {len(found[0])} columns")
            found.append(fields)
    except csv.Error as error:
        raise UserError(f"{path.as_posix()}, line {len(found) + 1}: {error}") from error
    if len(set(found[0])) < len(found[0]):
        raise UserError(f"{path.as_posix()}, line 1: two columns of the same name")
    return found


def _convert(path: Path, texts: pd.Series, kind: Kind) -> pd.Series:
    if kind == "text":
        return texts
    import pandas as pd

    values = pd.to_numeric(texts, errors="coerce").astype(float)
    good = np.isfinite(values.to_numpy())
    if kind.startswith("count"):
        good = texts.str.fullmatch("[0-9]{1,15}").to_numpy(bool)  # more are not exact as float64
    if kind.endswith("or empty"):
        good = good | (texts == "").to_numpy(bool)
    if not good.all():
        line, text = next(iter(texts[~good].items()))
        shown = text if len(text) <= 40 else f"{text[:40]}..."
        raise UserError(
            f"{path.as_posix()}, line {line}: column {texts.name} has {shown!r}, "
            f"expected {EXPECTED[kind]}"
        )
    return values.astype(np.int64) if kind == "count" else values
