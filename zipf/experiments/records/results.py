"""Runs as data: what each is and what it measured, read from its files alone.

A run folder is a folder with a `run.json`; files that a run has not written yet count as empty. The
runs of a record (`zipf.experiments.records.record`) are in a few tables instead. docs/results.md
describes every file and column.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from pydantic import ValidationError

from zipf.errors import UserError
from zipf.experiments.records import record
from zipf.experiments.records.csv_files import Kind, read_bytes, read_texts, values_of
from zipf.experiments.records.descriptions import (
    LevelGroup,
    RunDescription,
    first_problem,
    read_description,
)
from zipf.experiments.records.learned_options import NOT_LEARNED, changes_nothing, flatten, is_among
from zipf.experiments.records.result_table import TABLES
from zipf.protocol import KINDS

# In which two seeds of a condition may differ.
BOOKKEEPING = (NOT_LEARNED - {"evaluation"}) | {"seed"}


@dataclass(frozen=True, eq=False)
class Run:
    """One run, as its files tell it."""

    folder: Path  # as the user gave it, plus the path below
    description: RunDescription
    # one row per (update, level_kind, level), in order of updates: `update`, `frames`, `seconds`,
    # `level_kind`, `level`, `episodes`, `score`, `success` (NaN where the level reports none),
    # `return`
    evaluations: pd.DataFrame
    # one row per (update, level_kind, situation): `update`, `level_kind`, the situation's ranks,
    # `episodes`, `successes` (NaN where the level reports none), `return_sum`; and where the run
    # has recorded them `visits` and `visits_<rank>`, see docs/results.md
    situations: pd.DataFrame
    # the situation's columns, e.g. ("map", "target"); ranks, 0 most frequent.
    situation_names: tuple[str, ...]
    # updates, frames, seconds: how far the run has come
    updates: int
    frames: int
    seconds: float
    options: Mapping[str, Any]  # what `config.yaml` holds; empty for an external run
    settings: Mapping[str, Any]  # the flattened options without bookkeeping
    notes: tuple[str, ...]  # what the reader of the files had to leave out
    _means: dict[Any, pd.DataFrame] = field(default_factory=dict, init=False, repr=False)

    @property
    def frames_before(self) -> int:
        """The frames of the run whose weights this one began with, and of those before that."""
        there = self.description.pretrained
        return there.frames if there else 0

    @property
    def label(self) -> str:
        """The run's folder, as messages show it."""
        return self.folder.as_posix()

    def evaluations_of(self, levels: LevelGroup) -> pd.DataFrame:
        """The rows of `evaluations` of these levels, of the updates at which all were scored."""
        rows = self.evaluations
        chosen = rows[
            (rows["level_kind"] == levels.level_kind) & rows["level"].isin(levels.weights)
        ]
        scored = chosen.groupby("update")["level"].transform("size")
        return chosen[scored == len(levels.weights)]

    def mean_scores(self, levels: LevelGroup) -> pd.DataFrame:
        """The levels' mean score at every update at which all of them were scored.

        Returns:
            One row per update, in their order: `update`, `frames`, `seconds`, `episodes` (of all
            levels), `score` (the weighted mean) and `plain_score` (the plain mean). The same frame
            each time, not to be changed.
        """
        # Tables, figures, claims and statistics all ask for the same means.
        key = levels.level_kind, tuple(levels.weights.items())
        if key not in self._means:
            self._means[key] = self._mean_scores(levels)
        return self._means[key]

    def _mean_scores(self, levels: LevelGroup) -> pd.DataFrame:
        rows = self.evaluations_of(levels)
        weights = rows["level"].map(dict(levels.weights)).astype(float)
        rows = rows.assign(weighted=rows["score"] * weights / sum(levels.weights.values()))
        by_update = rows.groupby("update")  # at once, by `agg`, takes several times as long
        means = by_update[["frames", "seconds"]].first()
        means[["episodes", "score"]] = by_update[["episodes", "weighted"]].sum()
        means["plain_score"] = by_update["score"].mean()
        means = means.reset_index()
        return means if levels.is_weighted else means.assign(score=means["plain_score"])


def load_runs(folders: Iterable[str | Path]) -> list[Run]:
    """Every run at any depth under `folders`, in the order of tables: those of run folders, and
    those of records; a folder may be one within a record. Links are followed; a run that is found
    twice counts once. Raises UserError: a folder does not exist, cannot be read or holds no run, or
    a run's files are damaged."""
    roots = [Path(folder).expanduser() for folder in folders]
    found: dict[Path, Run | Path] = {}
    for folder in roots:
        try:
            real = folder.resolve()
            around = next((one for one in (folder, *real.parents) if record.is_there(one)), None)
            if around is None and not folder.is_dir():
                what = "is a file: give a run's folder, or one above it"
                raise UserError(
                    f"{folder.as_posix()}: {what if folder.is_file() else 'no such folder'}"
                )
            records = [around] if around is not None else []
            records += [one for one in _folders_with(record.RUNS, folder) if one != around]
            for run in (run for one in records for run in load_record(one, folder)):
                found.setdefault(run.folder.resolve(), run)
            for path in _folders_with("run.json", folder):
                found.setdefault(path.resolve(), path)
        except OSError as error:  # such as too long a name, or a folder that cannot be read
            where = error.filename or folder.as_posix()
            raise UserError(f"{where:.200}: {error.strerror}") from None
    if not found:
        where = ", ".join(folder.as_posix() for folder in roots)
        raise UserError(f"no run found under {where}: a run's folder has a run.json")
    runs = [one if isinstance(one, Run) else load_run(one) for one in found.values()]
    return sorted(
        runs,
        key=lambda run: (
            run.description.experiment,
            run.description.row_order,
            run.description.seed,
            run.label,
        ),
    )


def _folders_with(name: str, root: Path) -> Iterator[Path]:
    """The folders at any depth under a folder, if it is there, that have a file of this name.
    Raises OSError."""

    def fail(error: OSError) -> None:
        raise error

    if not root.is_dir():  # as a folder within a record may be
        return
    seen = set()
    for folder, inner, files in os.walk(root, followlinks=True, onerror=fail):
        real = os.path.realpath(folder)
        if real in seen:  # a link leads back
            inner.clear()
            continue
        seen.add(real)
        # Not into hidden ones, such as what an interrupted unpacking has left.
        inner[:] = sorted(one for one in inner if not one.startswith("."))
        if name in files:
            yield Path(folder)


def devices_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """What any of these runs was trained on, each device named once."""
    return tuple(dict.fromkeys(device for run in runs for device in run.description.devices))


def aligned(seeds: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """The seeds' `mean_scores` with places in common, so that a median over seeds can be taken.

    Where no two seeds were evaluated at the same update, as agents from outside the package may be,
    the k-th evaluation of each is at the median of the places of all their k-th ones.
    """
    updates = pd.concat([seed["update"] for seed in seeds])
    trained = updates[updates > 0]
    if len(seeds) < 2 or trained.duplicated().any():
        return list(seeds)
    numbered = pd.concat([seed.assign(number=range(len(seed))) for seed in seeds])
    columns = ["update", "frames", "seconds"]
    places = numbered.groupby("number")[columns].median()
    return [
        seed.assign(**{name: places[name].to_numpy()[: len(seed)] for name in columns})
        for seed in seeds
    ]


def load_run(folder: Path) -> Run:
    """The run in `folder`. Raises UserError: one of its files is damaged."""
    description = read_description(folder / "run.json")
    notes: list[str] = []
    read = {name: (folder / name, read_texts(folder / name, notes)) for name in TABLES}
    path = folder / "config.yaml"
    options = _read_options(path, description)
    return _run(folder, description, options, _settings(path, description, options), read, notes)


def load_record(folder: Path, within: Path | None = None) -> list[Run]:
    """The runs of the record in `folder`; only those within another folder if one is named, which
    may be a link or hold the record. Raises UserError: one of its files is damaged."""
    kept = record.read(folder)
    real, within = folder.resolve(), (within or folder).resolve()
    runs = []
    for name, values in kept.runs.items():
        if not (real / name).is_relative_to(within):
            continue
        try:
            description = RunDescription.model_validate_json(json.dumps(values))
        except ValidationError as error:
            where = f"{(folder / record.RUNS).as_posix()}: {name}"
            raise UserError(f"{where}: {first_problem(error)}") from None
        options = kept.options.get(name, {})
        settings = _settings(folder / record.OPTIONS, description, options)
        read = {
            file: (folder / f"{file}{record.SUFFIX}", kept.tables[name].get(file, pd.DataFrame()))
            for file in TABLES
        }
        runs.append(_run(folder / name, description, options, settings, read, []))
    return runs


def _run(
    folder: Path,
    description: RunDescription,
    options: dict[str, Any],
    settings: dict[str, Any],
    read: Mapping[str, tuple[Path, pd.DataFrame]],
    notes: Sequence[str],
) -> Run:
    """The run that these tables tell of; `read` has where each was read, for messages, and its
    texts, by the name of its file."""
    evaluations = _evaluations(*read["evaluations.csv"], description)
    situations, situation_names = _situations(*read["situations.csv"], description)
    reached = dict.fromkeys(("update", "frames", "seconds"), 0.0)
    metrics = values_of(*read["metrics.csv"], dict.fromkeys(reached, "number"))
    for frame in (evaluations, metrics):
        for column in reached:
            if len(frame):
                reached[column] = max(reached[column], float(frame[column].max()))
    return Run(
        folder=folder,
        description=description,
        evaluations=evaluations,
        situations=situations,
        situation_names=situation_names,
        updates=int(reached["update"]),
        frames=int(reached["frames"]),
        seconds=reached["seconds"],
        options=options,
        settings=settings,
        notes=tuple(notes),
    )


def _evaluations(path: Path, texts: pd.DataFrame, description: RunDescription) -> pd.DataFrame:
    columns: dict[str, Kind] = {
        "update": "count",
        "frames": "count",
        "seconds": "number",
        "level_kind": "text",
        "level": "text",
        "episodes": "count",
        "score": "number",
        "success": "number or empty",
        "return": "number",
    }
    rows = values_of(path, texts, columns)
    _check_kinds(path, rows)
    for level_kind in KINDS:
        known = description.levels_of(level_kind).weights
        of_kind = rows[rows["level_kind"] == level_kind]
        for where, row in _first(path, of_kind[~of_kind["level"].isin(known)]):
            raise UserError(
                f"{where}: {level_kind} level {row['level']!r}; by run.json the run has "
                f"{', '.join(known) or 'none of this kind'}"
            )
    for where, row in _first(path, rows[rows.duplicated(["update", "level_kind", "level"])]):
        raise UserError(f"{where}: {row['level']} at update {row['update']} a second time")
    return _in_order(rows)


def _situations(
    path: Path, texts: pd.DataFrame, description: RunDescription
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    header = list(texts.columns)
    names: tuple[str, ...] = ()
    if "level_kind" in header and "episodes" in header:
        names = tuple(header[header.index("level_kind") + 1 : header.index("episodes")])
    columns: dict[str, Kind] = {
        "update": "count",
        "level_kind": "text",
        **{name: "count" for name in names},
        "episodes": "count",
        "successes": "number or empty",
        "return_sum": "number",
    }
    visits = ("visits", *(f"visits_{name}" for name in names))
    columns |= dict.fromkeys([name for name in visits if name in header], "count or empty")
    rows = values_of(path, texts, columns)
    _check_kinds(path, rows)
    for name in names:
        size = description.situation.get(name)
        if size is None:
            raise UserError(
                f"{path.as_posix()}, line 1: column {name}, but run.json's situation has "
                f"{', '.join(description.situation) or 'no rank'}"
            )
        for where, row in _first(path, rows[rows[name] >= size]):
            raise UserError(
                f"{where}: {name} {row[name]}, but by run.json the ranks are 0 to {size - 1}"
            )
    for where, row in _first(path, rows[rows["successes"] > rows["episodes"]]):
        raise UserError(f"{where}: {row['successes']:g} successes of {row['episodes']} episodes")
    return _in_order(rows), names


def _check_kinds(path: Path, rows: pd.DataFrame) -> None:
    for where, row in _first(path, rows[~rows["level_kind"].isin(KINDS)]):
        raise UserError(
            f"{where}: column level_kind has {row['level_kind']!r}, "
            f"expected one of {', '.join(KINDS)}"
        )


def _first(path: Path, wrong: pd.DataFrame) -> Iterator[tuple[str, dict[Any, Any]]]:
    """Where the first of these rows of a file is, and what it has; nothing where there is none."""
    for line, row in wrong.head(1).to_dict("index").items():
        yield f"{path.as_posix()}, line {line}", row


def _in_order(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.sort_values("update", kind="stable").reset_index(drop=True)


def _read_options(path: Path, description: RunDescription) -> dict[str, Any]:
    """The options of a run of this package. An external agent has none: a configuration in its
    folder would be that of somebody else's training."""
    if description.external:
        if path.exists():
            raise UserError(f"{path.as_posix()}: by run.json the agent is external and has none")
        return {}
    content = read_bytes(path)
    try:
        options = yaml.safe_load(content)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{path.as_posix()}: not a YAML file") from error
    if not isinstance(options, dict) or "schedule" not in options:  # the last of them
        raise UserError(f"{path.as_posix()}: is no run's options, or cut")
    return options


def _settings(path: Path, description: RunDescription, options: dict[str, Any]) -> dict[str, Any]:
    """The flattened options without bookkeeping."""
    if description.external:
        return {}
    described = {
        "experiment": description.experiment,
        "condition": description.condition,
        "seed": description.seed,
        "environment": {"split": description.split, **description.environment},
    }
    if differing := [name for name in described if options.get(name) != described[name]]:
        raise UserError(
            f"{path.as_posix()}: has options of another run than run.json ({', '.join(differing)})"
        )
    flat = flatten(options)
    if there := description.pretrained:  # in which folder it was, and of which seed, is no setting
        flat["pretrained.run"] = f"{there.experiment} {there.condition}"
    else:
        flat = {key: value for key, value in flat.items() if not key.startswith("pretrained.")}
    return {
        key: value
        for key, value in flat.items()
        if not is_among(key, BOOKKEEPING) and not changes_nothing(key, value)
    }
