"""How well the rows of a table do at each frequency rank of the situation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd

from zipf.experiments.reporting.statistics import Z_95, standard_error, wilson_interval
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import evaluations_inside, situations_inside

Measure = Literal["success", "return"]
LEVEL_RANK = "level"
"""The rank of a level that is drawn at a reset; see docs/results.md."""


def measure_of(table: ScoreTable) -> Measure:
    """Success if every run of the table reports it on the uniform levels, else the mean return."""
    shown = [_on_kind(situations_inside(run, table.window), "uniform") for run in table.runs]
    without = any(situations["successes"].isna().any() for situations in shown)
    return "return" if without else "success"


def situation_names(table: ScoreTable) -> list[str]:
    """The situation's ranks, in the order in which the runs have them."""
    return list(dict.fromkeys(name for run in table.runs for name in run.situation_names))


def rank_counts(table: ScoreTable) -> dict[str, int]:
    """How many ranks each of the situation's columns has."""
    return {name: size for run in table.runs for name, size in run.description.situation.items()}


def rates(table: ScoreTable, ranks: Sequence[str], measure: Measure = "success") -> pd.DataFrame:
    """Success or mean return at the named ranks of the situation, pooled over window and seeds.

    On the uniform levels: there every situation weighs the same, so that what is
    measured at one rank is not a mixture that follows the law of the others.

    Returns:
        One line per row of the table and combination of ranks that occurred: `row_key`, the ranks,
        `episodes`, `value`, and `low` and `high`, the ends of its 95 % interval. Of a
        success rate this is Wilson's, which covers the chance of the episodes, not the difference
        between seeds. Of a mean return it is 1.96 standard errors across evaluations (of all seeds,
        weighted by their episodes) to either side; NaN where there is only one evaluation.
    """
    keys = ["row_key", *ranks]
    summed = "successes" if measure == "success" else "return_sum"
    parts = []
    for number, run in enumerate(table.runs):
        if set(ranks) <= set(run.situation_names):
            situations = _on_kind(situations_inside(run, table.window), "uniform")
            parts.append(situations.assign(row_key=run.description.row_key, run_number=number))
    columns = [*keys, "run_number", "update", "episodes", summed]
    pooled = (
        pd.concat([part[columns] for part in parts]) if parts else pd.DataFrame(columns=columns)
    )
    return pool(pooled[pooled["episodes"] > 0], keys, measure)


def pool(pooled: pd.DataFrame, keys: list[str], measure: Measure) -> pd.DataFrame:
    """Success or mean return by `keys` of lines of situations, with 95 % intervals; see `rates`."""
    summed = "successes" if measure == "success" else "return_sum"
    found = pooled.groupby(keys, as_index=False)[["episodes", summed]].sum()
    found["value"] = found[summed] / found["episodes"]
    if measure == "success":
        found["low"], found["high"] = wilson_interval(found[summed], found["episodes"])
    else:
        each = pooled.groupby([*keys, "run_number", "update"], as_index=False)[
            ["episodes", summed]
        ].sum()
        errors = [
            standard_error(group[summed] / group["episodes"], group["episodes"])
            for _, group in each.groupby(keys)
        ]
        found["low"] = found["value"] - Z_95 * np.array(errors)
        found["high"] = found["value"] + Z_95 * np.array(errors)
    return found.drop(columns=summed)


def baseline_on_uniform(table: ScoreTable, measure: Measure, baseline: str) -> float | None:
    """A baseline on the uniform levels in the units of the measure; None where it is not known.

    Baselines are known as scores, which are the measure only where a level is not normalised and,
    for success, where returns are 0 or 1: where score and measure are the same in every evaluation.
    """
    known = table.baseline(baseline)
    if "uniform" not in known:
        return None
    shown = pd.concat([evaluations_inside(run, table.window) for run in table.runs])
    shown = _on_kind(shown, "uniform")
    same = bool(np.allclose(shown["score"], shown[measure], atol=1e-6))
    return known["uniform"] if same else None


def baseline_by_rank(
    table: ScoreTable, measure: Measure, baseline: str
) -> dict[str, Sequence[float]]:
    """The same at each value of a rank, by the rank's name; without ranks for which it is not
    known, and with several uniform levels for none."""
    if baseline_on_uniform(table, measure, baseline) is None:
        return {}
    levels = {
        level.level: level.baselines[baseline].by_rank
        for run in reversed(table.runs)  # of the first run, as the baseline itself is
        for level in run.description.levels
        if level.level_kind == "uniform" and baseline in level.baselines
    }
    known = next(iter(levels.values())) if len(levels) == 1 else {}
    counts = rank_counts(table)
    return {name: each for name, each in known.items() if len(each) == counts.get(name)}


def rare_ranks(table: ScoreTable, name: str) -> list[int]:
    """The ranks that the rare levels have: those that occurred on them in any evaluation of any
    run, ascending; none where the uniform levels have no others."""

    def visited(level_kind: str) -> set[int]:
        seen = [_on_kind(run.situations, level_kind) for run in table.runs]
        return {int(rank) for rows in seen if name in rows for rank in rows[name]}

    rare = visited("rare")
    return sorted(rare) if visited("uniform") - rare else []


def spans(ranks: Sequence[int]) -> list[tuple[int, int]]:
    """The first and the last rank of each stretch of ascending ranks without a gap."""
    found: list[tuple[int, int]] = []
    for rank in ranks:
        if found and found[-1][1] == rank - 1:
            found[-1] = found[-1][0], rank
        else:
            found.append((rank, rank))
    return found


def shares(table: ScoreTable, rank: str) -> pd.DataFrame:
    """Of the episodes of a level kind, the share at each value of a rank.

    As the evaluations of all runs met them; where the rank is that of a level, of which evaluations
    play each equally often, the level's weight. Without kinds of other levels with unequal weights.

    Returns:
        One line per level kind and value: `level_kind`, the rank, `share`.
    """
    (train,) = (levels for levels in table.kinds if levels.level_kind == "train")
    places = {name: place for place, name in enumerate(train.weights)}
    by_level = len(places) > 1 and rank == LEVEL_RANK
    lines: list[tuple[str, int, float]] = []
    for levels in table.kinds:
        if by_level and levels.weights.keys() <= places.keys():
            total = sum(levels.weights.values())
            found = {places[name]: weight / total for name, weight in levels.weights.items()}
        elif levels.is_weighted:
            continue
        else:
            runs = [run for run in table.runs if rank in run.situation_names]
            rows = [_on_kind(run.situations, levels.level_kind) for run in runs]
            episodes = pd.concat(rows).groupby(rank)["episodes"].sum() if rows else pd.Series()
            met = episodes[episodes > 0] / max(episodes.sum(), 1)
            found = dict(zip(met.index.astype(int), met.tolist(), strict=True))
        lines += [(levels.level_kind, int(value), found[value]) for value in sorted(found)]
    return pd.DataFrame(lines, columns=["level_kind", rank, "share"])


def visit_names(table: ScoreTable) -> list[str]:
    """The columns in which runs have counted how often training met a situation."""
    names = [name for run in table.runs for name in run.situations.columns]
    return [name for name in dict.fromkeys(names) if name.split("_")[0] == "visits"]


def rates_by_visits(table: ScoreTable, visits: str, measure: Measure = "success") -> pd.DataFrame:
    """Success or mean return on the uniform levels by how often training had met the situation.

    Numbers of times are taken together by powers of two: 0, 1, 2 to 3, 4 to 7 and so on.

    Args:
        visits: one of `visit_names`.

    Returns:
        One line per row of the table and group: `row_key`, `met` (the mean over its episodes),
        `episodes`, `value`, and `low` and `high`, as `rates` has them.
    """
    parts = []
    for number, run in enumerate(table.runs):
        rows = _on_kind(situations_inside(run, table.window), "uniform")
        if visits in rows and len(rows):
            group = np.ceil(np.log2(rows[visits].to_numpy(float) + 1))
            parts.append(
                rows.assign(
                    row_key=run.description.row_key,
                    run_number=number,
                    group=group,
                    met=rows[visits] * rows["episodes"],
                )
            )
    if not parts:
        return pd.DataFrame(columns=["row_key", "met", "episodes", "value", "low", "high"])
    pooled = pd.concat(parts)
    pooled = pooled[pooled["episodes"] > 0]
    found = pool(pooled, ["row_key", "group"], measure)
    met = pooled.groupby(["row_key", "group"])["met"].sum().to_numpy() / found["episodes"]
    return found.assign(met=met).drop(columns="group")


def _on_kind(rows: pd.DataFrame, level_kind: str) -> pd.DataFrame:
    return rows[rows["level_kind"] == level_kind]
