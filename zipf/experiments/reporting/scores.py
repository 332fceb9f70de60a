"""The scores of a table's rows.

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
   says so. Of a row without any score the last evaluation is `shown`, marked; it is in no file and
   no statistic unless the reader asks for that window, or no row of the table has reached its own.
   An external agent, which has no updates, is scored at its last evaluation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from zipf.experiments.records.descriptions import BaselineDescription, LevelGroup
from zipf.experiments.records.paper import PaperTable
from zipf.experiments.records.results import Run
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.statistics import (
    median_absolute_deviation,
    standard_error,
    weighted_mean,
)
from zipf.experiments.reporting.windows import (
    LastEvaluations,
    Window,
    evaluations_inside,
    window_of,
)
from zipf.protocol import BASELINE_NAMES

CSV_COLUMNS = (
    "table", "experiment", "condition", "title", "external", "level_kind", "level", "levels",
    "seeds", "score", "error", "plain_score", "plain_error", "capped_score", "capped_error",
    "spread", "paper_value", "paper_error",
    *(f"{mean}{name}" for name in BASELINE_NAMES for mean in ("", "plain_", "capped_")),
    "window", "evaluations", "episodes", "updates", "frames",
)  # fmt: skip

KEYS = ("row", "column", "shown", "shown_error", "marked")

CAP = 1.0  # a human's score; DMLab-30's convention (Espeholt et al. 2018, IMPALA, section 5.3)


def score_frame(
    rows: Sequence[Row],
    groups: Sequence[LevelGroup],
    window: Window,
    name: str,
    experiment: str,
    paper: PaperTable | None,
) -> pd.DataFrame:
    """The scores of comparable runs, one line per row and group of levels.
    Returns the columns that docs/results.md describes for `report.csv`; `row` and `column`, the
    keys of the row and of the group of levels; `shown`, `shown_error` and `marked`: the score as a
    table shows it, and whether it is that of the last evaluation since none is inside the window.
    NaN is "none"."""
    runs = [run for row in rows for run in row.runs]
    of_others = {name: known_baselines(runs, name) for name in BASELINE_NAMES}
    lines = []
    for row in rows:
        baselines = {
            name: known | known_baselines(row.runs, name) for name, known in of_others.items()
        }
        for levels in groups:
            published = (
                paper.score(row.condition, levels.name or levels.level_kind)
                if paper and not row.external
                else None
            )
            error = published.error if published else None
            score = _score(row.runs, levels, window)
            last = score if score["seeds"] else _score(row.runs, levels, LastEvaluations(1))
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
                    **score,
                    "shown": last["score"],
                    "shown_error": last["error"],
                    "marked": last["seeds"] > score["seeds"],
                    "spread": row.runs[0].description.spread,
                    "paper_value": published.value if published else np.nan,
                    "paper_error": error if error is not None else np.nan,
                    **_baselines(baselines, levels, capped=_capped(runs, levels)),
                    "window": ", ".join({str(window_of(run, window)): run for run in row.runs}),
                }
            )
    frame = pd.DataFrame(lines, columns=[*KEYS, *CSV_COLUMNS])
    whole = ["levels", "seeds", "evaluations", "episodes", "updates", "frames"]
    return frame.astype({column: "Int64" for column in whole})


def _score(runs: Sequence[Run], levels: LevelGroup, window: Window) -> dict[str, Any]:
    inside = {run: means_inside(run, levels, window) for run in runs}
    scored = {run: evaluations for run, evaluations in inside.items() if len(evaluations)}
    effort = {
        "seeds": len(scored),
        "evaluations": min((len(rows) for rows in scored.values()), default=0),
        "episodes": min((rows["episodes"].min() for rows in scored.values()), default=0),
        "updates": min((rows["update"].max() for rows in scored.values()), default=pd.NA),
        "frames": min(
            (run.frames_before + rows["frames"].max() for run, rows in scored.items()),
            default=pd.NA,
        ),
    }
    if not scored:
        measured = dict.fromkeys(("score", "error", "plain_score", "plain_error"), np.nan)
    elif runs[0].description.spread == "seeds":
        measured = _across_seeds(list(scored.values()))
    else:
        measured = _across_tasks(list(scored), levels, window)
    return effort | {"capped_score": np.nan, "capped_error": np.nan} | measured


def means_inside(run: Run, levels: LevelGroup, window: Window) -> pd.DataFrame:
    """A run's `mean_scores` on these levels at the evaluations inside a window."""
    means = run.mean_scores(levels)
    return means[means["update"].isin(evaluations_inside(run, window)["update"])]


def level_medians(run: Run, levels: LevelGroup, window: Window) -> pd.Series:
    """The median of a run's scores on each of these levels, by level, over the evaluations inside a
    window that scored them all; empty where there is none."""
    rows = run.evaluations_of(levels)
    rows = rows[rows["update"].isin(evaluations_inside(run, window)["update"])]
    return rows.groupby("level")["score"].median()


def seed_means(row: Row, levels: LevelGroup, window: Window) -> dict[int, float]:
    """A row's scores by seed: what the table would have of that seed alone. Without the seeds that
    have no score in the window. Across seeds the table takes their median. Across tasks it takes
    the median of each level first, so the row's score can be below or above those of all seeds."""
    scores = {run.description.seed: _score([run], levels, window) for run in row.runs}
    return {seed: float(score["score"]) for seed, score in scores.items() if score["seeds"]}


def _across_seeds(scored: Sequence[pd.DataFrame]) -> dict[str, float]:
    score = pd.Series([evaluations["score"].median() for evaluations in scored])
    plain = pd.Series([evaluations["plain_score"].median() for evaluations in scored])
    return {
        "score": float(score.median()),
        "error": median_absolute_deviation(score),
        "plain_score": float(plain.median()),
        "plain_error": median_absolute_deviation(plain),
    }


def _across_tasks(runs: Sequence[Run], levels: LevelGroup, window: Window) -> dict[str, float]:
    of_seeds = [level_medians(run, levels, window) for run in runs]
    of_levels = pd.concat(of_seeds, axis=1).median(axis=1)[list(levels.weights)]
    weights, equal = list(levels.weights.values()), np.ones(len(levels.weights))
    found = {
        "score": weighted_mean(of_levels, weights),
        "error": standard_error(of_levels, weights),
        "plain_score": weighted_mean(of_levels, equal),
        "plain_error": standard_error(of_levels, equal),
    }
    if _capped(runs, levels):
        capped = np.minimum(of_levels, CAP)
        found["capped_score"] = weighted_mean(capped, weights)
        found["capped_error"] = standard_error(capped, weights)
    return found


def _capped(runs: Sequence[Run], levels: LevelGroup) -> bool:
    """Whether levels have capped scores: a human's score is 1 on each of them. Some runs may lack
    the kind, but not all."""
    return runs[0].description.spread == "tasks" and all(
        level.normalised
        for run in runs
        for level in run.description.levels
        if level.level_kind == levels.level_kind and level.level in levels.weights
    )


def known_baselines(runs: Sequence[Run], name: str) -> dict[tuple[str, str], BaselineDescription]:
    """The first known values of a baseline, by level kind and level."""
    known: dict[tuple[str, str], BaselineDescription] = {}
    for level in (level for run in runs for level in run.description.levels):
        if name in level.baselines:
            known.setdefault((level.level_kind, level.level), level.baselines[name])
    return known


def _baselines(
    baselines: Mapping[str, Mapping[tuple[str, str], BaselineDescription]],
    levels: LevelGroup,
    *,
    capped: bool,
) -> dict[str, float]:
    """For each baseline its `known_baselines` on each level, averaged by their weights, with the
    same weights and capped; NaN where a level's is not known."""
    weights = list(levels.weights.values())
    found = {}
    for name, known in baselines.items():
        places = ((levels.level_kind, one) for one in levels.weights)
        values = np.array([known[one].score if one in known else np.nan for one in places])
        found[name] = weighted_mean(values, weights)
        found[f"plain_{name}"] = weighted_mean(values, np.ones(len(values)))
        values = np.minimum(values, CAP) if capped else values * np.nan
        found[f"capped_{name}"] = weighted_mean(values, weights)
    return found


def floor(scores: pd.DataFrame) -> pd.Series:
    """The higher one of chance and blind, of lines of `score_frame`; NaN where neither is known."""
    return scores[["chance", "blind"]].astype(float).max(axis=1)


def fewest_seeds(seeds: pd.Series) -> int:
    """Of the numbers of seeds that a row's scores have: 0 only where there is no score. Runs of
    before lack kinds of levels."""
    counts = seeds[seeds > 0]
    return int(counts.min()) if len(counts) else 0


def other_statistic(scores: pd.DataFrame, mean: str) -> pd.DataFrame:
    """Lines of `score_frame` with another mean over the levels, "plain" or "capped", in the place
    of the weighted one, and no published scores."""
    names = ["score", "error", *BASELINE_NAMES]
    return scores.assign(
        **{name: scores[f"{mean}_{name}"] for name in names},
        shown=scores[f"{mean}_score"],
        shown_error=scores[f"{mean}_error"],
        marked=False,
        paper_value=np.nan,
        paper_error=np.nan,
    )
