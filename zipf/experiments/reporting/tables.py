"""The paper's tables as functions of runs.

`scores.py` has the protocol. `comparable.py` says which runs share a table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.records.descriptions import LevelGroup, RunDescription
from zipf.experiments.records.paper import PaperTable
from zipf.experiments.records.results import Run
from zipf.experiments.reporting.comparable import group_runs, paper_of
from zipf.experiments.reporting.notes import notes
from zipf.experiments.reporting.rows import Row, rows_of
from zipf.experiments.reporting.scores import CSV_COLUMNS, known_references, score_frame
from zipf.experiments.reporting.windows import (
    Asked,
    Window,
    evaluations_inside,
    table_window,
)
from zipf.protocol import KINDS


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """One experiment's table, before it is rendered.

    Attributes:
        name: unique among the tables of a report, and safe in file names.
        title: the experiment, and what sets the table apart from others of that experiment.
        description: of its first run, which is one of this package if there is any.
        rows: in the table's order.
        window: over which the scores are taken.
        own_window: whether that is the experiment's own, see `table_window`.
        paper: what was published; None where it has a number for none of the rows.
        kinds: the levels of each kind.
        scores: one line per row and level kind; see `score_frame`.
        groups: the levels of every kind that has several: those that the paper averages together,
            then each by itself.
        group_scores: as `scores`, one line per row and group.
        notes: what is missing or doubtful, one sentence each.
    """

    name: str
    title: str
    description: RunDescription
    rows: tuple[Row, ...]
    window: Window
    own_window: bool
    paper: PaperTable | None
    kinds: tuple[LevelGroup, ...]
    scores: pd.DataFrame
    groups: tuple[LevelGroup, ...]
    group_scores: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def runs(self) -> list[Run]:
        """All runs, in the order of rows."""
        return [run for row in self.rows for run in row.runs]

    def reference(self, name: str) -> dict[str, float]:
        """Score of a player that does not learn by level kind, without those not known."""
        known = self.scores.dropna(subset=[name])
        return dict(zip(known["level_kind"], known[name], strict=True))

    def reference_episodes(self, name: str) -> list[int]:
        """Over how many episodes a reference was measured on each level, without those on which it
        is exact or not known."""
        known = known_references(self.runs, name).values()
        return [one.episodes for one in known if one.episodes is not None]

    @property
    def is_capped(self) -> bool:
        """Whether there are capped scores beside the others."""
        return bool(self.scores["capped_score"].notna().any())

    @property
    def episodes(self) -> list[int]:
        """How many episodes of a level are behind each evaluation inside the window."""
        return [
            int(count)
            for run in self.runs
            for count in evaluations_inside(run, self.window)["episodes"]
        ]

    @property
    def frames(self) -> dict[str, int]:
        """The frames behind each row's score, by the row's key; without rows that have none."""
        return {
            str(key): int(frames)
            for key, frames in self.scores.groupby("row", sort=False)["frames"].min().items()
            if not pd.isna(frames)
        }

    @property
    def budgets_differ(self) -> bool:
        """Whether the rows' scores were reached after different numbers of frames."""
        return len(set(self.frames.values())) > 1


def score_tables(runs: Sequence[Run], window: Asked | None = None) -> list[ScoreTable]:
    """One table per experiment; more where runs of an experiment cannot be compared.

    Args:
        window: instead of each run's own; "scaled" for that at the same fractions of shorter runs;
            "own" for each run's own, with those that differ in one table.

    Raises:
        UserError: two runs of a table are the same condition and seed, or a run names a published
            experiment that the paper does not have.
    """
    tables: list[ScoreTable] = []
    for group in group_runs(runs, window):
        rows = rows_of(group.runs)
        paper = paper_of(group.runs)
        description = group.runs[0].description
        used, is_own = table_window(group.runs, window)
        kinds = tuple(_kinds(group.runs))
        groups = tuple(part for levels in kinds for part in _parts(levels, paper))
        whole = score_frame(rows, kinds, used, group.name, description.experiment, paper)
        parts = score_frame(rows, groups, used, group.name, description.experiment, paper)
        tables.append(
            ScoreTable(
                name=group.name,
                title=group.title,
                description=description,
                rows=rows,
                window=used,
                own_window=is_own,
                paper=paper if whole["paper_value"].notna().any() else None,
                kinds=kinds,
                scores=whole,
                groups=groups,
                group_scores=parts,
                notes=notes(group.runs, used),
            )
        )
    return tables


def csv_report(tables: Sequence[ScoreTable]) -> str:
    """`report.csv`: one line per row and level kind, at full precision, empty for none.

    Where a kind has several levels, lines for each level and for the paper's groups of levels
    follow those of the table.
    """
    parts = [part for table in tables for part in (table.scores, table.group_scores)]
    return pd.concat([part for part in parts if len(part)])[list(CSV_COLUMNS)].to_csv(
        index=False, float_format="%.10g", lineterminator="\n"
    )


def _kinds(runs: Sequence[Run]) -> Iterator[LevelGroup]:
    """The levels of each kind that one of the runs has: of the first that has it."""
    for kind in KINDS:
        known = (run.description.levels_of(kind) for run in runs)
        if first := next((levels for levels in known if levels.weights), None):
            yield first


def _parts(levels: LevelGroup, paper: PaperTable | None) -> list[LevelGroup]:
    """The groups that the paper averages, then every other level; empty for a single level."""
    if len(levels.weights) < 2:
        return []
    published = paper.train_groups if paper and levels.level_kind == "train" else {}
    named = {
        name: names for name, names in published.items() if levels.weights.keys() >= set(names)
    }
    alone = {name: (name,) for name in levels.weights if (name,) not in named.values()}
    return [
        LevelGroup(levels.level_kind, name, {one: levels.weights[one] for one in names})
        for name, names in (named | alone).items()
    ]
