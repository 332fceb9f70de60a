"""Statistics beside the paper's: intervals across seeds, and how often training met what is rare.

They follow the tables of the paper's protocol and take scores from the same windows.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zipf.experiments.records.descriptions import LevelGroup
from zipf.experiments.records.wording import KIND_NAMES, NONE, count_text, score_text, seeds_text
from zipf.experiments.reporting.claim_checks import LEARNED
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.grids import Grid, Line
from zipf.experiments.reporting.scores import fewest_seeds, floor, level_medians
from zipf.experiments.reporting.statistics import (
    FEWEST_SEEDS,
    RESAMPLES,
    SEED,
    Interval,
    improvement,
    interquartile_mean,
)
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import situations_inside

STATISTICS_COLUMNS = (
    "table", "experiment", "condition", "title", "external", "level_kind", "statistic", "against",
    "value", "low", "high", "seeds", "levels",
)  # fmt: skip
AT_FLOOR = "at the floor"
MOST_SITUATIONS = 20  # ours: more columns are read by nobody
TOO_FEW = f"needs {FEWEST_SEEDS} seeds"
IQM, IMPROVEMENT = "interquartile mean", "probability of improvement"


@dataclass(frozen=True)
class SeedStatistics:
    """Further statistics of a table."""

    table: ScoreTable
    frame: pd.DataFrame  # see `statistics_frame`
    # as they are shown; none where no row has two seeds and no run has counted visits
    grids: tuple[Grid, ...]
    sentences: tuple[str, ...]  # how to read them


def seed_scores(row: Row, levels: LevelGroup, table: ScoreTable) -> NDArray[np.float64]:
    """A row's scores [seeds, levels]: of each seed the median over the window on each level.
    Without the seeds that have no score in the window, as in the table."""
    medians = [level_medians(run, levels, table.window) for run in row.runs]
    found = [one[list(levels.weights)] for one in medians if len(one)]
    return np.array(found, float).reshape(len(found), len(levels.weights))


def statistics_frame(table: ScoreTable) -> pd.DataFrame:
    """All statistics of a table that have two seeds, in the columns of `statistics.csv`.

    A probability of improvement has the row that is the better one in `condition` and the other in
    `against`, its condition, with † for an external agent; every pair of rows stands there once.
    """
    lines = []

    def add(
        row: Row, levels: LevelGroup, statistic: str, against: str, seeds: int, found: Interval
    ) -> None:
        of_row = (table.name, table.description.experiment, row.condition, row.title, row.external)
        estimate = (found.value, found.low, found.high)
        counts = (seeds, len(levels.weights))
        lines.append((*of_row, levels.level_kind, statistic, against, *estimate, *counts, row.key))

    for levels in table.kinds:
        known = {row: seed_scores(row, levels, table) for row in table.rows}
        known = {row: scores for row, scores in known.items() if len(scores) >= FEWEST_SEEDS}
        for row, scores in known.items():
            add(row, levels, IQM, "", len(scores), interquartile_mean(scores))
        learned = above_floor(table, levels)
        for (first, theirs), (row, scores) in itertools.combinations(known.items(), 2):
            if learned.isdisjoint((row.key, first.key)):
                continue  # which of them is better says nothing
            seeds = min(len(scores), len(theirs))
            add(row, levels, IMPROVEMENT, first.key, seeds, improvement(scores, theirs))
    return pd.DataFrame(lines, columns=[*STATISTICS_COLUMNS, "row"])


def above_floor(table: ScoreTable, levels: LevelGroup) -> set[str]:
    """The keys of the rows that are at least `LEARNED` above chance and blind on a kind of levels;
    of all where neither is known."""
    scores = table.scores[table.scores["level_kind"] == levels.level_kind]
    return set(scores["row"][~(scores["score"] < floor(scores) + LEARNED)])


def seed_statistics(table: ScoreTable) -> SeedStatistics:
    """The statistics of a table."""
    frame, grids, sentences = statistics_frame(table), [], []
    if len(frame):
        grids.append(_means(table, frame))
        sentences.append(
            "Interquartile mean: the mean of the middle half of all scores of seeds and levels, "
            "every level alike. In brackets, 95 % intervals of a stratified bootstrap over seeds "
            "(Agarwal et al. 2021); of two or three seeds they are too narrow."
        )
        if (better := _improvements(table, frame)) is not None:
            grids.append(better)
            sentences.append(
                "Probability of improvement: that a seed of the row is better than one of the "
                "other, ties counting half; at 0.5 neither is. Not of two that are less than "
                f"{LEARNED:g} above the floor, the higher one of chance and blind."
            )
    if (rare := _rare_situations(table)) is not None:
        grids.append(rare)
        sentences.append(
            "Success in rare situations: in each, numbered by its ranks, of every seed over the "
            "window. Mean: of all of these; from two seeds on with the 95 % interval of a "
            "bootstrap that draws seeds, situations and episodes."
        )
    if (met := _visits(table)) is not None:
        grids.append(met)
        sentences.append(
            "Met in training: how often the situation of an episode of the rare levels, or the one "
            "rank of it, had been met in training by the time of the evaluation; median over "
            "episodes, lowest to highest. At least: without those of the run whose weights the "
            "agent began with."
        )
    return SeedStatistics(table, frame, tuple(grids), tuple(sentences))


def reading(found: Sequence[SeedStatistics]) -> list[str]:
    """How to read the statistics of several tables, each sentence once, and which have none."""
    sentences = list(dict.fromkeys(text for one in found for text in one.sentences))
    titles = [one.table.title for one in found if not one.grids]
    if titles:
        sentences.append(
            f"Not of {', '.join(titles)}: an interquartile mean {TOO_FEW} of a condition, and how "
            f"often training met a situation was not recorded."
        )
    return sentences


def csv_statistics(found: Sequence[SeedStatistics]) -> str:
    """`statistics.csv`: the lines of all tables."""
    frames = [one.frame for one in found]
    every = pd.concat([frame for frame in frames if len(frame)] or list(frames))
    return every[list(STATISTICS_COLUMNS)].to_csv(
        index=False, float_format="%.10g", lineterminator="\n"
    )


def estimate_text(value: float, low: float, high: float) -> str:
    """`0.69 [0.64, 0.75]`."""
    return f"{score_text(value)} [{score_text(low)}, {score_text(high)}]"


def _means(table: ScoreTable, frame: pd.DataFrame) -> Grid:
    found = frame[frame["statistic"] == IQM]
    lines = [
        _line(
            [row.title, seeds_text(_seeds(table, row))],
            _texts(found[found["row"] == row.key]),
            row,
            table,
        )
        for row in table.rows
    ]
    return _grid(table, IQM, "iqm", ["Condition", "Seeds"], lines)


def _improvements(table: ScoreTable, frame: pd.DataFrame) -> Grid | None:
    """Every row against the first that has two seeds."""
    found = frame[frame["statistic"] == IMPROVEMENT]
    if not len(found):
        return None
    (baseline,) = (row for row in table.rows if row.key == found["against"].iloc[0])
    found = found[found["against"] == baseline.key]
    learned = {levels.level_kind: above_floor(table, levels) for levels in table.kinds}
    lines = []
    for row in table.rows:
        if row is not baseline:
            low = {
                kind: AT_FLOOR
                for kind, keys in learned.items()
                if keys.isdisjoint((row.key, baseline.key))
            }
            enough = _seeds(table, row) >= FEWEST_SEEDS
            texts = {**(low if enough else {}), **_texts(found[found["row"] == row.key])}
            lines.append(_line([row.title], texts, row, table))
    title = f"{IMPROVEMENT} on {baseline.title}"
    return _grid(table, title, "improvement", ["Condition"], lines)


def _rare_situations(table: ScoreTable) -> Grid | None:
    """Success in each situation of the rare levels, of the rows that met all that any row did; None
    where there is no such row."""
    rates = {row: success_by_situation(row, table) for row in table.rows}
    names = sorted({name for found in rates.values() for name in found.columns})
    if not 1 < len(names) <= MOST_SITUATIONS:
        return None
    lines = []
    for row, found in rates.items():
        if set(found.columns) == set(names):
            value, low, high = bootstrap_of_situations(found)
            enough = len(found) >= FEWEST_SEEDS
            mean = estimate_text(value, low, high) if enough else score_text(value)
            each = ["/".join(score_text(p) for p, _ in found[name]) for name in names]
            lines.append(Line([row.title, mean], each, [NONE] * len(names)))
    if not lines:
        return None
    ranks = ", ".join(table.runs[0].situation_names[: len(names[0])])
    shown = ["–".join(map(str, name)) for name in names]
    title = f"success in rare situations ({ranks})"
    return Grid(title, f"{table.name}-rare-situations", ["Condition", "Mean"], shown, lines, [])


def success_by_situation(row: Row, table: ScoreTable) -> pd.DataFrame:
    """Success in each situation of the rare levels over the window: a line for each seed, a column
    for each situation (the tuple of its ranks), pairs of success and episodes. Where there are more
    than `MOST_SITUATIONS`, for each value of the first rank. Without seeds that have none in the
    window; empty where one of the others has not met them all, or does not report success."""
    lines = {}
    for run in row.runs:
        inside = situations_inside(run, table.window)
        rare = inside[inside["level_kind"] == "rare"]
        ranks = [*run.situation_names]
        if not len(rare):
            continue
        if not ranks or rare["successes"].isna().any():
            return pd.DataFrame()
        if len(rare.groupby(ranks)) > MOST_SITUATIONS:
            ranks = ranks[:1]
        summed = rare.groupby(ranks)[["successes", "episodes"]].sum()
        lines[run.description.seed] = {
            name if isinstance(name, tuple) else (name,): (won / played, int(played))
            for name, won, played in summed.itertuples()
        }
    found = pd.DataFrame.from_dict(lines, orient="index")
    return pd.DataFrame() if found.empty or found.isna().any(axis=None) else found


def bootstrap_of_situations(found: pd.DataFrame) -> tuple[float, float, float]:
    """The mean of a `success_by_situation`, and the ends of its 95 % interval: of resamples in
    which seeds, situations, and the episodes of each are drawn."""
    rates = np.array([[p for p, _ in line] for line in found.to_numpy()])
    counts = np.array([[n for _, n in line] for line in found.to_numpy()])
    rng = np.random.default_rng(SEED)
    seeds = rng.integers(len(rates), size=(RESAMPLES, len(rates), 1))
    situations = rng.integers(rates.shape[1], size=(RESAMPLES, 1, rates.shape[1]))
    drawn = rng.binomial(counts[seeds, situations], rates[seeds, situations])
    means = (drawn / counts[seeds, situations]).mean(axis=(1, 2))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(rates.mean()), float(low), float(high)


def _visits(table: ScoreTable) -> Grid | None:
    """How often training met what the rare episodes asked for; None where no run counted it."""
    if all(levels.level_kind != "rare" for levels in table.kinds):
        return None
    columns: dict[str, str] = {}
    lines = []
    for row in table.rows:
        parts = [situations_inside(run, table.window) for run in row.runs]
        rare = pd.concat([part[part["level_kind"] == "rare"] for part in parts])
        found = [name for name in rare.columns if name.split("_")[0] == "visits"]
        for name in found:
            rank = name.removeprefix("visits_").replace("_", " ")
            columns[name] = "Situation met" if name == "visits" else f"{rank.capitalize()} met"
        scores = table.scores[table.scores["row"] == row.key].set_index("level_kind")
        leading = [
            row.title,
            seeds_text(_seeds(table, row)),
            score_text(scores["score"]["rare"], scores["error"]["rare"]),
        ]
        # The visits of the run whose weights an agent began with are not known here.
        least = "at least " if any(run.description.pretrained for run in row.runs) else ""
        lines.append((leading, {name: _met(rare[name], rare["episodes"], least) for name in found}))
    if not columns:
        return None
    shown = [
        Line(leading, [texts.get(name, NONE) for name in columns], [NONE] * len(columns))
        for leading, texts in lines
    ]
    name = f"{table.name}-visits"
    leading = ["Condition", "Seeds", "Rare score"]
    return Grid("met in training", name, leading, list(columns.values()), shown, [])


def _met(visits: pd.Series, episodes: pd.Series, least: str) -> str:
    known = visits.notna() & (episodes > 0)
    if not known.any():
        return NONE
    each = np.repeat(visits[known].to_numpy(int), episodes[known].to_numpy(int))
    low, middle, high = (count_text(int(one)) for one in (each.min(), np.median(each), each.max()))
    return f"{least}{middle} ({low} to {high})"


def _seeds(table: ScoreTable, row: Row) -> int:
    return fewest_seeds(table.scores[table.scores["row"] == row.key]["seeds"])


def _texts(found: pd.DataFrame) -> dict[str, str]:
    return {
        line["level_kind"]: estimate_text(line["value"], line["low"], line["high"])
        for line in found.to_dict("records")
    }


def _line(leading: list[str], texts: Mapping[str, str], row: Row, table: ScoreTable) -> Line:
    scores = table.scores[table.scores["row"] == row.key].set_index("level_kind")
    ours = [
        (texts.get(levels.level_kind) or TOO_FEW) if scores["seeds"][levels.level_kind] else NONE
        for levels in table.kinds
    ]
    return Line(leading, ours, [NONE] * len(ours))


def _grid(table: ScoreTable, title: str, name: str, leading: list[str], lines: list[Line]) -> Grid:
    columns = [KIND_NAMES[levels.level_kind] for levels in table.kinds]
    return Grid(title, f"{table.name}-{name}", leading, columns, lines, [])
