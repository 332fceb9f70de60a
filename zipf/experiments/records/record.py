"""A record: what many runs left, in a few compressed tables in the place of a folder each.

A record is a folder with `runs.csv.gz`. Every table but that of the levels begins with a column
`run`, which names the run's folder below the record's; the tables of results have the columns of
those in a run's folder after it.

| File | A row for each |
| :-- | :-- |
| `runs.csv.gz` | run: `run.json`, a column for each entry |
| `options.csv.gz` | run: `config.yaml`, a column for each option |
| `levels.csv.gz` | baseline of a level, and each value of a rank at which it is known |
| `evaluations.csv.gz`, `metrics.csv.gz` | row of a run's table |
| `situations.csv.gz` | row of a run's table, with the ranks of all families |

Cells of the first two hold JSON, and text without quotes where that cannot be misread; an empty one
is an entry that a run does not have. Every run's rows are compressed by themselves and without the
time, so that the same runs give the same bytes, and a further run with the same columns and levels
leaves those of others as they are.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from zipf.errors import UserError
from zipf.experiments.records.csv_files import read_texts
from zipf.experiments.records.learned_options import flatten
from zipf.experiments.records.replacing import replacing
from zipf.experiments.records.result_table import TABLES

SUFFIX = ".gz"
RUNS, OPTIONS, LEVELS = f"runs.csv{SUFFIX}", f"options.csv{SUFFIX}", f"levels.csv{SUFFIX}"
LEVEL_COLUMNS = ("level_kind", "level", "weight", "normalised")
BASELINE_COLUMNS = ("reference", "rank", "value", "score", "episodes", "policy")


@dataclass
class Record:
    """The contents of a record."""

    # what `run.json` holds, by the run's name
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    # what `config.yaml` holds, of those runs that have one
    options: dict[str, dict[str, Any]] = field(default_factory=dict)
    # of each run, by the name of the file, a table as text. Its index is the number of the line in
    # the record's table.
    tables: dict[str, dict[str, pd.DataFrame]] = field(default_factory=dict)


def is_there(folder: Path) -> bool:
    """Whether a folder is a record. Raises OSError."""
    return (folder / RUNS).is_file()


def read(folder: Path) -> Record:
    """The record in a folder. Raises UserError: a file cannot be read, or is damaged."""
    levels = _read_levels(folder / LEVELS)
    runs = {}
    for name, values in _read_nested(folder / RUNS).items():
        if str(values.get("levels")) not in levels:
            raise UserError(f"{(folder / RUNS).as_posix()}: {name} has levels that {LEVELS} lacks")
        runs[name] = {**values, "levels": levels[values["levels"]]}
    tables: dict[str, dict[str, pd.DataFrame]] = {name: {} for name in runs}
    for file in TABLES:
        path = folder / f"{file}{SUFFIX}"
        texts = _texts(path)
        for key, rows in texts.groupby("run", sort=False):
            name = str(key)
            if name not in runs:
                raise UserError(f"{path.as_posix()}, line {rows.index[0]}: {RUNS} has no {name}")
            rows = rows.drop(columns="run")
            if file == "situations.csv":  # ranks that its situations do not have
                rows = rows.loc[:, [bool(rows[one].any()) or one == "successes" for one in rows]]
            tables[name][file] = rows
    return Record(runs, _read_nested(folder / OPTIONS), tables)


def write(folder: Path, record: Record) -> None:
    """Writes a record. Raises OSError."""
    names = sorted(record.runs)
    levels: dict[str, list[dict[str, Any]]] = {}
    runs = {}
    for name in names:
        values = record.runs[name]
        runs[name] = {**values, "levels": _name_of_levels(values, levels)}
    _write_nested(folder / RUNS, runs)
    options = {name: record.options[name] for name in names if name in record.options}
    _write_nested(folder / OPTIONS, options)
    _write(
        folder / LEVELS,
        ["levels", *LEVEL_COLUMNS, *BASELINE_COLUMNS],
        (
            [[name, *row] for one in of_levels for row in _rows_of_level(one)]
            for name, of_levels in sorted(levels.items())
        ),
    )
    for file in TABLES:
        of_runs = {name: record.tables[name].get(file, pd.DataFrame()) for name in names}
        columns = _columns(file, of_runs.values())
        _write(
            folder / f"{file}{SUFFIX}",
            ["run", *columns],
            (
                [[name, *row] for row in table.reindex(columns=columns, fill_value="").to_numpy()]
                for name, table in of_runs.items()
            ),
        )


def _columns(file: str, tables: Iterable[pd.DataFrame]) -> list[str]:
    """The columns of all tables; those of situations with the ranks where the ranks are, and visits
    at the end."""
    names = list(dict.fromkeys(name for table in tables for name in table.columns))
    if file != "situations.csv":
        return names
    head, tail = ["update", "level_kind"], ["episodes", "successes", "return_sum"]
    visits = [name for name in names if name == "visits" or name.startswith("visits_")]
    ranks = [name for name in names if name not in (*head, *tail, *visits)]
    return [*head, *ranks, *tail, *visits]


def _name_of_levels(values: Mapping[str, Any], levels: dict[str, list[dict[str, Any]]]) -> str:
    """The name of a run's levels, which are added to `levels` if they are not there."""
    number = 1
    while True:
        name = f"{values['split']}-{number}"
        if levels.setdefault(name, values["levels"]) == values["levels"]:
            return name
        number += 1


def _rows_of_level(one: Mapping[str, Any]) -> list[list[str]]:
    level = [_text(one[name]) for name in LEVEL_COLUMNS]
    rows = []
    for name, known in one["references"].items():
        episodes, policy = _text(known["episodes"]), known.get("policy") or ""
        rows.append([*level, name, "", "", _text(known["score"]), episodes, policy])
        for rank, scores in known["by_rank"].items():
            rows += [[*level, name, rank, str(i), _text(s), "", ""] for i, s in enumerate(scores)]
    return rows or [[*level, *[""] * len(BASELINE_COLUMNS)]]


def _read_levels(path: Path) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, dict[tuple[str, str], dict[str, Any]]] = {}
    for row in _texts(path, ("levels", *LEVEL_COLUMNS, *BASELINE_COLUMNS)).to_dict("records"):
        of_run = found.setdefault(row["levels"], {})
        level = {name: _value(row[name]) for name in LEVEL_COLUMNS}
        one = of_run.setdefault((row["level_kind"], row["level"]), {**level, "references": {}})
        if not row["reference"]:
            continue
        if not row["rank"]:
            one["references"][row["reference"]] = {
                "score": _value(row["score"]),
                "episodes": _value(row["episodes"]),
                "by_rank": {},
                **({"policy": row["policy"]} if row["policy"] else {}),
            }
        else:
            of_baseline = one["references"].setdefault(row["reference"], {"by_rank": {}})
            of_baseline["by_rank"].setdefault(row["rank"], []).append(_value(row["score"]))
    return {name: list(levels.values()) for name, levels in found.items()}


def _read_nested(path: Path) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for row in _texts(path).to_dict("records"):
        values: dict[str, Any] = {}
        for name, cell in row.items():
            if name != "run" and cell:
                *groups, last = str(name).split(".")
                inner = values
                for group in groups:
                    inner = inner.setdefault(group, {})
                    if not isinstance(inner, dict):
                        raise UserError(f"{path.as_posix()}: {row['run']}: {group} is no group")
                inner[last] = _value(cell)
        found[row["run"]] = values
    return found


def _write_nested(path: Path, of_runs: Mapping[str, Mapping[str, Any]]) -> None:
    flat = {name: flatten(values) for name, values in of_runs.items()}
    columns = list(dict.fromkeys(name for values in flat.values() for name in values))
    _write(
        path,
        ["run", *columns],
        (
            [[name, *(_text(values[one]) if one in values else "" for one in columns)]]
            for name, values in flat.items()
        ),
    )


def _text(value: Any) -> str:
    """A cell: text as it is, where it is not JSON as well; anything else as JSON."""
    if isinstance(value, str) and value.isprintable() and value and _value(value) is value:
        return value
    return json.dumps(value)


def _value(cell: str) -> Any:
    try:
        return json.loads(cell)
    except ValueError:
        return cell


def _texts(path: Path, columns: Sequence[str] = ("run",)) -> pd.DataFrame:
    """A table as text, which has at least these columns."""
    notes: list[str] = []
    texts = read_texts(path, notes)
    if notes or not len(texts.columns):
        raise UserError(f"{path.as_posix()}: is missing or cut; restore it from a copy")
    if missing := [name for name in columns if name not in texts]:
        raise UserError(f"{path.as_posix()}, line 1: no column {', '.join(missing)}")
    return texts


def _write(path: Path, columns: Sequence[str], parts: Iterable[Sequence[Sequence[Any]]]) -> None:
    with replacing(path) as file:
        for rows in ([columns], *parts):
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows(rows)
            file.write(gzip.compress(text.getvalue().encode(), mtime=0))
