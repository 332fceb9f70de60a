"""The paper's published numbers and the layout of its tables.

Source: Chan, Lampinen, Richemond and Hill (2022), "Zipfian environments for reinforcement
learning". ``paper_tables.json`` beside this file copies the tables whose LaTeX labels it lists,
``paper_layouts.json`` declares the paper's result tables, column by column: of which experiment, on
which level kind or group of train levels, and which statistic. What the copy leaves out or adds:

- "IMPALA + LSTM memory" repeats the numbers of "IMPALA" (the same runs): one condition here.
- "R2D2 without prioritised replay" stands in the text only, on putting, without an error.
- The gridworld row with vision and language reconstruction is as printed, although that
  environment has no language.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

from zipf.errors import UserError


@dataclass(frozen=True)
class PaperScore:
    """A published score. `error` is None where the paper prints none."""

    value: float
    error: float | None


@dataclass(frozen=True)
class PaperTable:
    """What the paper printed for one experiment.

    `error_kind` says in words what its ± is; `note` what a reader of the numbers has to know. A row
    has scores by level kind, or by the name of a group of train levels; `train_groups` says which
    levels, averaged, make such a group.
    """

    source: str
    error_kind: str
    note: str | None
    train_groups: Mapping[str, tuple[str, ...]]
    rows: Mapping[str, Mapping[str, PaperScore]]

    def score(self, condition: str, column: str) -> PaperScore | None:
        """The published score, or None where the paper has no such row or column."""
        return self.rows.get(condition, {}).get(column)


Statistic = Literal["score", "capped_score"]


@dataclass(frozen=True)
class PaperColumn:
    """A column of one of the paper's tables."""

    experiment: str  # by our key
    column: str  # a level kind, or a group of train levels
    # the column of `zipf.experiments.reporting.scores.score_frame` that it shows. Published scores
    # are beside `score` only.
    statistic: Statistic


@dataclass(frozen=True)
class PaperLayout:
    """One of the paper's tables of results, and those that go with it.

    `tables` are titles and, by heading, columns.
    """

    name: str
    tables: tuple[tuple[str, Mapping[str, PaperColumn]], ...]

    @property
    def experiments(self) -> tuple[str, ...]:
        """The experiments whose columns it has, in order."""
        used = [one.experiment for _, columns in self.tables for one in columns.values()]
        return tuple(dict.fromkeys(used))


def _read(name: str) -> Any:
    file = resources.files("zipf.experiments.records").joinpath(name)
    return json.loads(file.read_text(encoding="utf-8"))


@functools.cache
def _tables() -> Mapping[str, PaperTable]:
    data = _read("paper_tables.json")
    return {
        experiment: PaperTable(
            source=data["source"],
            error_kind=table["error"],
            note=table["note"],
            train_groups={
                group: tuple(levels) for group, levels in table.get("train_groups", {}).items()
            },
            rows={
                condition: {
                    column: PaperScore(score[0], score[1] if len(score) > 1 else None)
                    for column, score in row.items()
                }
                for condition, row in table["rows"].items()
            },
        )
        for experiment, table in data["experiments"].items()
    }


@functools.cache
def paper_titles() -> Mapping[str, str]:
    """The title of every condition for which the paper has a row, in the order of its tables."""
    return _read("paper_tables.json")["titles"]


def paper_table(experiment: str) -> PaperTable:
    """The paper's numbers for one of its experiments, by our key (for instance ``gridworld``).
    Raises UserError: the paper has no such experiment."""
    tables = _tables()
    if experiment not in tables:
        raise UserError(
            f"the paper has no experiment {experiment!r}; it has {', '.join(sorted(tables))}"
        )
    return tables[experiment]


def conditions_of_the_paper() -> set[str]:
    """The conditions that are a row of any of the paper's tables."""
    return {condition for table in _tables().values() for condition in table.rows}


@functools.cache
def paper_layouts() -> tuple[PaperLayout, ...]:
    """The paper's tables of results."""
    return tuple(
        PaperLayout(
            name,
            tuple(
                (title, {heading: PaperColumn(*column) for heading, column in columns.items()})
                for title, columns in tables.items()
            ),
        )
        for name, tables in _read("paper_layouts.json").items()
    )
