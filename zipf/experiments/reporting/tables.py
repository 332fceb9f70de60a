"""The paper's tables as functions of runs.

The protocol, and what it leaves open (Chan et al. 2022, section on training and evaluation):

1. "We take the median run across the three runs, and report the median performance in a time
   window." A seed's score is the median of its evaluations inside the window, both ends included;
   the table shows the median of the seeds' scores, for each level kind by itself. For an odd
   number of seeds this is the window median of the median run; for an even number, where no run
   is the median one, it is the mean of the middle two.
2. What an evaluation measures on a kind of several levels is the mean of the levels' scores,
   weighted as the split says; the plain mean is kept beside it.
3. ± is what the split says. "Seeds": "± median absolute deviation across runs", the median of the
   seeds' distances from their median, unscaled. One seed has no deviation: none is shown. "Tasks":
   "an average or weighted average across tasks (± standard error across tasks)". There the medians
   of window and seeds are taken for each level by itself, then the weighted mean and its standard
   error across levels. One level has no such error.
   Where these levels' scores are normalised by a human's, a capped score stands beside: each
   level's median counts as at most 1, then mean and standard error are taken as before.
4. The window is part of the result. A run with no evaluation inside it has no score, and a note
   says so; it is never scored somewhere else unless the reader asks for another window. An external
   agent, which has no updates, is scored at its last evaluation.

`comparable.py` says which runs share a table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from zipf.experiments.reporting.comparable import group_runs, paper_of
from zipf.experiments.reporting.notes import notes
from zipf.experiments.reporting.paper import LEVEL_KINDS, PaperTable
from zipf.experiments.reporting.results import LevelGroup, Run, RunDescription
from zipf.experiments.reporting.statistics import (
    median_absolute_deviation,
    standard_error,
    weighted_mean,
)
from zipf.experiments.reporting.windows import (
    LastEvaluations,
    UpdateWindow,
    Window,
    evaluations_inside,
    window_of,
)
from zipf.experiments.reporting.wording import EXTERNAL_MARK
from zipf.references import REFERENCE_NAMES

CSV_COLUMNS = (
    "table",
    "experiment",
    "condition",
    "title",
    "external",
    "level_kind",
    "level",
    "levels",
    "seeds",
    "score",
    "error",
    "plain_score",
    "plain_error",
    "capped_score",
    "capped_error",
    "spread",
    "paper_value",
    "paper_error",
    *(f"{mean}{name}" for name in REFERENCE_NAMES for mean in ("", "plain_", "capped_")),
    "window",
    "evaluations",
    "episodes",
    "updates",
    "frames",
)


CAP = 1.0  # a human's score; DMLab-30's convention (Espeholt et al. 2018, IMPALA, section 5.3)


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a table: the runs of a condition, or of an external agent.

    Attributes:
        key: unique among the rows of a report.
        title: as tables and plots show it; an external agent's ends in a mark.
        external: whether it was recorded from outside this package.
        colour: as #rrggbb; None if it is to be assigned.
        line: "solid" or "dashed".
        runs: its seeds.
    """

    key: str
    title: str
    external: bool
    colour: str | None
    line: str
    runs: tuple[Run, ...]

    @property
    def condition(self) -> str:
        """The condition's name, or the external agent's."""
        return self.runs[0].description.condition


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """One experiment's table, before it is rendered.

    Attributes:
        name: unique among the tables of a report, and safe in file names.
        title: the experiment, and what sets the table apart from others of that experiment.
        description: of its first run, which is one of this package if there is any.
        rows: in the table's order.
        window: over which the scores are taken.
        own_window: whether that is the experiment's own.
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
        known = (
            level.references[name]
            for run in self.runs
            for level in run.description.levels
            if name in level.references
        )
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


def score_frame(
    rows: Sequence[Row],
    groups: Sequence[LevelGroup],
    window: Window,
    name: str,
    experiment: str,
    paper: PaperTable | None,
) -> pd.DataFrame:
    """The scores of comparable runs, one line per row and group of levels.

    Returns:
        The columns that docs/results.md describes for `report.csv`, and `row` and `column`, the
        keys of the row and of the group of levels. NaN is "none".
    """
    runs = [run for row in rows for run in row.runs]
    references = {levels.column: _references(runs, levels) for levels in groups}
    lines = []
    for row in rows:
        for levels in groups:
            published = (
                paper.score(row.condition, levels.name or levels.level_kind)
                if paper and not row.external
                else None
            )
            error = published.error if published else None
            lines.append(
                {
                    "row": row.key,
                    "column": levels.column,
                    "table": name,
                    "experiment": experiment,
                    "condition": row.condition,
                    "title": row.title,
                    "external": row.external,
                    "level_kind": levels.level_kind,
                    "level": levels.name,
                    "levels": len(levels.weights),
                    **_score(row.runs, levels, window),
                    "spread": row.runs[0].description.spread,
                    "paper_value": published.value if published else np.nan,
                    "paper_error": error if error is not None else np.nan,
                    **references[levels.column],
                    "window": str(window_of(row.runs[0], window)),
                }
            )
    frame = pd.DataFrame(lines, columns=["row", "column", *CSV_COLUMNS])
    whole = ["levels", "seeds", "evaluations", "episodes", "updates", "frames"]
    return frame.astype({column: "Int64" for column in whole})


def score_tables(runs: Sequence[Run], window: Window | None = None) -> list[ScoreTable]:
    """One table per experiment; more where runs of an experiment cannot be compared.

    Args:
        window: instead of each run's own.

    Raises:
        UserError: two runs of a table are the same condition and seed, or a run names a published
            experiment that the paper does not have.
    """
    tables: list[ScoreTable] = []
    for group in group_runs(runs, window):
        rows = _rows(group.runs)
        paper = paper_of(group.runs)
        description = group.runs[0].description
        used: Window = LastEvaluations(1)
        if not description.external:
            assert description.window is not None  # checked when it was read
            used = window or UpdateWindow(*description.window)
        kinds = tuple(description.levels_of(level_kind) for level_kind in LEVEL_KINDS)
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
                own_window=window is None or description.external is not None,
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


def _rows(runs: Sequence[Run]) -> tuple[Row, ...]:
    by_key: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: run.description.row_order):
        by_key.setdefault(run.description.row_key, []).append(run)
    rows = []
    for key, of_row in by_key.items():
        description = of_row[0].description
        external = description.external is not None
        rows.append(
            Row(
                key=key,
                title=description.row.title + (f" {EXTERNAL_MARK}" if external else ""),
                external=external,
                colour=description.row.colour,
                line=description.row.line,
                runs=tuple(of_row),
            )
        )
    return tuple(rows)


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


def _score(runs: Sequence[Run], levels: LevelGroup, window: Window) -> dict[str, Any]:
    """A row's score on these levels, and what is behind it."""
    inside = {run: _mean_scores_inside(run, levels, window) for run in runs}
    scored = {run: evaluations for run, evaluations in inside.items() if len(evaluations)}
    effort = {
        "seeds": len(scored),
        "evaluations": min((len(rows) for rows in scored.values()), default=0),
        "episodes": min((rows["episodes"].min() for rows in scored.values()), default=0),
        "updates": min((rows["update"].max() for rows in scored.values()), default=pd.NA),
        "frames": min((rows["frames"].max() for rows in scored.values()), default=pd.NA),
    }
    if not scored:
        measured = dict.fromkeys(("score", "error", "plain_score", "plain_error"), np.nan)
    elif runs[0].description.spread == "seeds":
        measured = _across_seeds(list(scored.values()))
    else:
        measured = _across_tasks(scored, levels)
    return effort | {"capped_score": np.nan, "capped_error": np.nan} | measured


def _mean_scores_inside(run: Run, levels: LevelGroup, window: Window) -> pd.DataFrame:
    means = run.mean_scores(levels)
    return means[means["update"].isin(evaluations_inside(run, window)["update"])]


def _across_seeds(scored: Sequence[pd.DataFrame]) -> dict[str, float]:
    score = pd.Series([evaluations["score"].median() for evaluations in scored])
    plain = pd.Series([evaluations["plain_score"].median() for evaluations in scored])
    return {
        "score": float(score.median()),
        "error": median_absolute_deviation(score),
        "plain_score": float(plain.median()),
        "plain_error": median_absolute_deviation(plain),
    }


def _across_tasks(scored: Mapping[Run, pd.DataFrame], levels: LevelGroup) -> dict[str, float]:
    of_seeds = []  # by level
    for run, means in scored.items():
        rows = run.evaluations_of(levels)
        rows = rows[rows["update"].isin(means["update"])]
        of_seeds.append(rows.groupby("level")["score"].median())
    of_levels = pd.concat(of_seeds, axis=1).median(axis=1)[list(levels.weights)]
    weights, equal = list(levels.weights.values()), np.ones(len(levels.weights))
    found = {
        "score": weighted_mean(of_levels, weights),
        "error": standard_error(of_levels, weights),
        "plain_score": weighted_mean(of_levels, equal),
        "plain_error": standard_error(of_levels, equal),
    }
    if _capped(next(iter(scored)), levels):
        capped = np.minimum(of_levels, CAP)
        found["capped_score"] = weighted_mean(capped, weights)
        found["capped_error"] = standard_error(capped, weights)
    return found


def _capped(run: Run, levels: LevelGroup) -> bool:
    """Whether levels have capped scores: a human's score is 1 on each of them."""
    return run.description.spread == "tasks" and all(
        level.normalised
        for level in run.description.levels
        if level.level_kind == levels.level_kind and level.level in levels.weights
    )


def _references(runs: Sequence[Run], levels: LevelGroup) -> dict[str, float]:
    """For each reference the first known values of each level, averaged by their weights, with the
    same weights and capped; NaN where a level's is not known."""
    weights = list(levels.weights.values())
    found = {}
    for name in REFERENCE_NAMES:
        known: dict[str, float] = {}
        for level in (level for run in runs for level in run.description.levels):
            if level.level_kind == levels.level_kind and name in level.references:
                known.setdefault(level.level, level.references[name].score)
        values = np.array([known.get(one, np.nan) for one in levels.weights])
        found[name] = weighted_mean(values, weights)
        found[f"plain_{name}"] = weighted_mean(values, np.ones(len(values)))
        capped = np.minimum(values, CAP) if _capped(runs[0], levels) else values * np.nan
        found[f"capped_{name}"] = weighted_mean(capped, weights)
    return found
