"""Run folders as data: what each run is and what it measured, read from its files alone.

A run folder is a folder with a `run.json`. Files that a run has not written yet count as empty.
A last line without its newline is what a crash leaves behind: it is dropped and noted. Any other
damage is an error that names the file and the line, because a score computed around a hole would
look like any other score.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from pydantic import BaseModel, ConfigDict, PositiveInt, ValidationError, model_validator

from zipf.experiments.errors import UserError
from zipf.experiments.reporting.paper import LEVEL_KINDS, condition_order

# Differences between two seeds of a condition that cannot change what was learned.
BOOKKEEPING = frozenset(
    {"seed", "condition", "updates", "run_root", "device", "compile", "resume", "schedule"}
)


class LevelDescription(BaseModel):
    """A level of a run, with the score of random actions there and over how many episodes that
    was measured; None where it is exact, or not known."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)

    level_kind: Literal["train", "uniform", "rare"]
    level: str
    chance: float | None
    chance_episodes: int | None


class RunDescription(BaseModel):
    """`run.json`: what a run is.

    `window` is in updates, both ends included; `situation` has the number of ranks of each of the
    situation's columns, None in files of a version that did not write it; nor did it write
    `levels`, and there was one of each kind.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)

    experiment: str
    condition: str
    seed: int
    split: str
    command: str
    commit: str | None
    version: str
    torch: str
    device: str
    precision: str
    window: tuple[int, int]
    num_updates: int
    chance: dict[Literal["train", "uniform", "rare"], float | None] | None
    levels: tuple[LevelDescription, ...] = ()
    environment: dict[str, Any]
    paper: str | None
    situation: dict[str, PositiveInt] | None = None

    @model_validator(mode="after")
    def _window_is_in_order(self) -> RunDescription:
        if self.window[0] > self.window[1]:
            raise ValueError(f"window {list(self.window)} ends before it starts")
        return self

    def names(self, level_kind: str) -> list[str]:
        """The levels of a kind; empty where the file does not tell."""
        return [one.level for one in self.levels if one.level_kind == level_kind]


@dataclass(frozen=True, eq=False)
class Run:
    """One run, as its files tell it.

    Attributes:
        folder: as the user gave it, plus the path below.
        evaluations: one row per (update, level_kind), a mean over the levels of that kind:
            `update`, `level_kind`, `frames`, `seconds`, `episodes` (of all levels), `score`.
        level_evaluations: one row per (update, level_kind, level); columns as in
            `evaluations.csv`.
        situations: one row per (update, level_kind, situation); columns as in `situations.csv`.
        situation_names: the situation's columns, e.g. ("map", "target"); ranks, 0 most frequent.
        updates, frames, seconds: how far the run has come.
        settings: the flattened `config.yaml` without bookkeeping; empty if there is none.
        notes: what the reader of the files had to leave out.
    """

    folder: Path
    description: RunDescription
    evaluations: pd.DataFrame
    level_evaluations: pd.DataFrame
    situations: pd.DataFrame
    situation_names: tuple[str, ...]
    updates: int
    frames: int
    seconds: float
    settings: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def label(self) -> str:
        """The run's folder, as messages show it."""
        return self.folder.as_posix()

    def mean_over(self, level_kind: str, levels: Collection[str]) -> pd.DataFrame:
        """As `evaluations`, of these levels of a kind alone."""
        rows = self.level_evaluations
        return _mean_over(rows[rows["level_kind"] == level_kind], levels)


def load_runs(folders: Iterable[str | Path]) -> list[Run]:
    """Every run at any depth under `folders`, in the order of tables.

    Raises:
        UserError: a folder does not exist, holds no run, or a run's files are damaged.
    """
    roots = [Path(folder) for folder in folders]
    found: dict[Path, Path] = {}
    for folder in roots:
        if not folder.is_dir():
            raise UserError(f"{folder.as_posix()}: no such folder")
        for path in folder.rglob("run.json"):
            found.setdefault(path.parent.resolve(), path.parent)
    if not found:
        where = ", ".join(folder.as_posix() for folder in roots)
        raise UserError(f"no run found under {where}: a run's folder has a run.json")
    runs = [load_run(folder) for folder in found.values()]
    return sorted(
        runs,
        key=lambda run: (
            run.description.experiment,
            condition_order(run.description.condition),
            run.description.seed,
            run.label,
        ),
    )


def load_run(folder: Path) -> Run:
    """The run in `folder`.

    Raises:
        UserError: one of its files is damaged.
    """
    description = _read_description(folder / "run.json")
    notes: list[str] = []

    level_evaluations = _read_table(
        folder / "evaluations.csv",
        {
            "update": int,
            "frames": int,
            "seconds": float,
            "level_kind": _level_kind,
            "level": str,
            "episodes": int,
            "score": float,
        },
        notes,
    )
    level_evaluations = _latest(level_evaluations, ["update", "level_kind", "level"])
    means = []
    for level_kind, rows in level_evaluations.groupby("level_kind"):
        found = sorted(rows["level"].unique())
        levels = description.names(str(level_kind)) or found[:1]
        if not set(found) <= set(levels):
            several = f"several {level_kind} levels" if len(found) > 1 else f"a {level_kind} level"
            raise UserError(
                f"{folder.as_posix()}/evaluations.csv: {several} ({', '.join(found)}); "
                f"the run has {', '.join(levels)}"
            )
        means.append(_mean_over(rows, levels))
    evaluations = pd.concat(means) if means else level_evaluations

    path = folder / "situations.csv"
    situation_names = _situation_names(path)
    situations = _read_table(
        path,
        {
            "update": int,
            "level_kind": _level_kind,
            **dict.fromkeys(situation_names, int),
            "episodes": int,
            "successes": int,
        },
        notes,
    )
    situations = _latest(situations, ["update", "level_kind", *situation_names])
    for name, size in (description.situation or {}).items():
        if name in situation_names and (situations[name] >= size).any():
            raise UserError(
                f"{path.as_posix()}: {name} {situations[name].max()}, but by run.json the ranks "
                f"are 0 to {size - 1}"
            )

    progress = {"update": 0.0, "frames": 0.0, "seconds": 0.0}
    metrics = _read_table(folder / "metrics.csv", dict.fromkeys(progress, float), notes)
    for frame in (level_evaluations, metrics):
        for column in progress:
            if len(frame):
                progress[column] = max(progress[column], float(frame[column].max()))

    return Run(
        folder=folder,
        description=description,
        evaluations=evaluations.sort_values("update", kind="stable").reset_index(drop=True),
        level_evaluations=level_evaluations,
        situations=situations,
        situation_names=situation_names,
        updates=int(progress["update"]),
        frames=int(progress["frames"]),
        seconds=progress["seconds"],
        settings=_read_settings(folder / "config.yaml"),
        notes=tuple(notes),
    )


def _read_description(path: Path) -> RunDescription:
    try:
        return RunDescription.model_validate_json(_read_bytes(path))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        problem = f"{where}: {first['msg']}" if where else first["msg"]
        raise UserError(f"{path.as_posix()}: not a run's description: {problem}") from error


def _read_settings(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        tree = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except Exception as error:  # the YAML library's errors have no common, documented base
        raise UserError(f"{path.as_posix()}: not a YAML file") from error

    def flatten(node: Any, prefix: str) -> dict[str, Any]:
        if not isinstance(node, dict):
            return {prefix: node}
        return {
            key: value
            for name, child in node.items()
            for key, value in flatten(child, f"{prefix}.{name}" if prefix else str(name)).items()
        }

    flat = flatten(tree, "")
    return {key: value for key, value in flat.items() if key.split(".")[0] not in BOOKKEEPING}


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path.as_posix()}: cannot be read: {error.strerror}") from error


def _lines(path: Path) -> tuple[list[str], bool]:
    """The file's complete lines, and whether a torn one was left out."""
    if not path.exists():
        return [], False
    complete, _, torn = _read_bytes(path).rpartition(b"\n")
    text = complete.decode("utf-8", errors="replace")
    return (text.split("\n") if text else []), bool(torn)


def _situation_names(path: Path) -> tuple[str, ...]:
    lines, _ = _lines(path)
    header = lines[0].rstrip("\r").split(",") if lines else []
    if "level_kind" not in header or "episodes" not in header:
        return ()
    return tuple(header[header.index("level_kind") + 1 : header.index("episodes")])


def _level_kind(text: str) -> str:
    if text not in LEVEL_KINDS:
        raise ValueError(text)
    return text


def _read_table(
    path: Path, columns: Mapping[str, Callable[[str], Any]], notes: list[str]
) -> pd.DataFrame:
    """The named columns of a CSV file, in file order; `notes` gains what was left out.

    Raises:
        UserError: naming file and line, for anything but a torn last line.
    """
    lines, torn = _lines(path)
    if torn:
        notes.append(f"{path.as_posix()}: the last line is torn and was left out")
    if not lines:
        return pd.DataFrame({name: [] for name in columns})
    header, *rows = csv.reader(io.StringIO("\n".join(lines)), quoting=csv.QUOTE_NONE)
    missing = [name for name in columns if name not in header]
    if missing:
        raise UserError(f"{path.as_posix()}, line 1: no column {', '.join(missing)}")
    for number, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise UserError(
                f"{path.as_posix()}, line {number}: {len(row)} fields where there are "
                f"{len(header)} columns"
            )
    return pd.DataFrame(
        {
            name: _convert(path, name, kind, [row[header.index(name)] for row in rows])
            for name, kind in columns.items()
        }
    )


def _convert(path: Path, name: str, kind: Callable[[str], Any], texts: Sequence[str]) -> list[Any]:
    values = []
    for number, text in enumerate(texts, start=2):
        try:
            value = kind(text)
            if kind is float and not np.isfinite(value):
                raise ValueError(text)
        except ValueError as error:
            raise UserError(
                f"{path.as_posix()}, line {number}: column {name} has {text!r}, "
                f"expected {_EXPECTED[kind]}"
            ) from error
        values.append(value)
    return values


_EXPECTED: Mapping[Callable[[str], Any], str] = {
    int: "a whole number",
    float: "a finite number",
    _level_kind: f"one of {', '.join(LEVEL_KINDS)}",
}


def _mean_over(evaluations: pd.DataFrame, levels: Collection[str]) -> pd.DataFrame:
    """The mean score over levels of a kind, at every update at which all of them were scored."""
    chosen = evaluations[evaluations["level"].isin(levels)]
    scored = chosen.groupby("update")["level"].transform("size")
    return (
        chosen[scored == len(levels)]
        .groupby(["update", "level_kind"], as_index=False)
        .agg({"frames": "first", "seconds": "first", "episodes": "sum", "score": "mean"})
    )


def _latest(frame: pd.DataFrame, key: list[str]) -> pd.DataFrame:
    """One row per key, in order of updates.

    A run that was killed and resumed repeats the evaluations after its last checkpoint, with the
    same outcome because resuming is exact; the later row is kept.
    """
    frame = frame.drop_duplicates(key, keep="last")
    return frame.sort_values("update", kind="stable").reset_index(drop=True)
