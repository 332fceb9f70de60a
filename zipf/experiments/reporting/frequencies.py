"""How often situations are met in training.

Counted, where `situations.csv` says how often training has met each. Otherwise estimated: their
shares are those of the evaluations on the train levels, which draw them by the same law, and the
number of training episodes follows from the frames and the mean length of an episode in
`metrics.csv`.
"""

from __future__ import annotations

import pandas as pd

from zipf.experiments.records.csv_files import read_table
from zipf.experiments.records.results import Run
from zipf.experiments.reporting.situations import LEVEL_RANK, rank_counts
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import evaluations_inside


def rank_shares(table: ScoreTable, name: str) -> pd.Series:
    """The share of training episodes at each value of a rank.

    Over the evaluations of all runs of the table on the train levels. Where levels are drawn at
    resets, evaluations play every level equally often, and the levels' shares are their weights.

    Returns:
        float64 by rank, from 0 on, with 0 for ranks that did not occur; empty where the runs have
        no situations on the train levels.
    """
    parts = []
    for run in table.runs:
        rows = run.situations[run.situations["level_kind"] == "train"]
        if name in rows and len(rows):
            parts.append(rows.assign(share=_shares(run, rows)))
    if not parts:
        return pd.Series(dtype=float)
    summed = pd.concat(parts).groupby(name)["share"].sum()
    return (summed / summed.sum()).reindex(range(rank_counts(table)[name]), fill_value=0.0)


def episodes_behind(table: ScoreTable) -> int:
    """Over how many episodes `rank_shares` were counted."""
    train = [run.situations[run.situations["level_kind"] == "train"] for run in table.runs]
    return int(sum(rows["episodes"].sum() for rows in train))


def times_met(table: ScoreTable, name: str) -> dict[str, pd.Series]:
    """How often the agents of a table have met each value of a rank until their last evaluation.

    Returns:
        By row float64 by rank, the mean over seeds, without ranks of which it is not known; without
        rows of which nothing is known, as of external agents.
    """
    shares = rank_shares(table, name)
    found = {}
    for row in table.rows:
        of_seeds = [counted_visits(run, table, name) for run in row.runs]
        if any(visits is None for visits in of_seeds):
            episodes = [training_episodes(run, table) for run in row.runs]
            of_seeds = [None if count is None else shares * count for count in episodes]
        known = [visits for visits in of_seeds if visits is not None and len(visits)]
        if known:
            found[row.key] = pd.concat(known, axis=1).mean(axis=1)
    return found


def counted_visits(run: Run, table: ScoreTable, name: str) -> pd.Series | None:
    """How often training had met each value of a rank at a run's last evaluation in the table's
    window, by rank, for ranks that occurred there; None where it was not counted."""
    column = f"visits_{name}" if len(run.situation_names) > 1 else "visits"
    rows = run.situations
    inside = evaluations_inside(run, table.window)
    if column not in rows or not len(inside):
        return None
    rows = rows[rows["update"] == inside["update"].max()]
    return rows.groupby(name)[column].max().astype(float) if len(rows) else None


def training_episodes(run: Run, table: ScoreTable) -> float | None:
    """About how many episodes a run has trained on until its last evaluation in the table's window.

    The frames between two lines of `metrics.csv` divided by the mean length of the episodes that
    ended there; where none did, by that of the lines beside. None where it is not known.
    """
    inside = evaluations_inside(run, table.window)
    path = run.folder / "metrics.csv"
    if run.description.external or not len(inside) or not path.exists():
        return None
    metrics = read_table(
        path,
        {"update": "number", "frames": "number", "episode_length": "number or empty"},
        [],
    )
    # A run of version 0.1.0 that was killed and resumed has lines twice.
    metrics = metrics.drop_duplicates("update", keep="last").sort_values("update")
    metrics = metrics[metrics["update"] <= inside["update"].max()]
    lengths = metrics["episode_length"].ffill().bfill()
    if not len(metrics) or lengths.isna().any() or (lengths <= 0).any():
        return None
    frames = metrics["frames"].diff().fillna(metrics["frames"])
    return float((frames / lengths).sum())


def _shares(run: Run, rows: pd.DataFrame) -> pd.Series:
    levels = run.description.levels_of("train")
    if LEVEL_RANK not in rows or not levels.is_weighted:
        return rows["episodes"].astype(float)
    weights = sorted(levels.weights.values(), reverse=True)
    law = {rank: weight / sum(weights) for rank, weight in enumerate(weights)}
    of_level = rows.groupby(LEVEL_RANK)["episodes"].transform("sum")
    return rows["episodes"] / of_level * rows[LEVEL_RANK].map(law).fillna(0.0)
