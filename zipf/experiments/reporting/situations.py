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


def rates(
    table: ScoreTable,
    ranks: Sequence[str],
    level_kind: str = "uniform",
    measure: Measure = "success",
) -> pd.DataFrame:
    """Success or mean return at the named ranks of the situation, pooled over window and seeds.

    On the uniform levels, by default: there every situation weighs the same, so that what is
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
            situations = _on_kind(situations_inside(run, table.window), level_kind)
            parts.append(situations.assign(row_key=run.description.row_key, run_number=number))
    columns = [*keys, "run_number", "update", "episodes", summed]
    pooled = (
        pd.concat([part[columns] for part in parts]) if parts else pd.DataFrame(columns=columns)
    )
    pooled = pooled[pooled["episodes"] > 0]
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


def reference_on_uniform(table: ScoreTable, measure: Measure, reference: str) -> float | None:
    """A reference on the uniform levels in the units of the measure; None where it is not known.

    References are known as scores, which are the measure only where a level is not normalised and,
    for success, where returns are 0 or 1: where score and measure are the same in every evaluation.
    """
    known = table.reference(reference)
    if "uniform" not in known:
        return None
    shown = pd.concat([evaluations_inside(run, table.window) for run in table.runs])
    shown = _on_kind(shown, "uniform")
    same = bool(np.allclose(shown["score"], shown[measure], atol=1e-6))
    return known["uniform"] if same else None


def reference_by_rank(
    table: ScoreTable, measure: Measure, reference: str
) -> dict[str, Sequence[float]]:
    """The same at each value of a rank, by the rank's name; without ranks for which it is not
    known, and with several uniform levels for none."""
    if reference_on_uniform(table, measure, reference) is None:
        return {}
    levels = {
        level.level: level.references[reference].by_rank
        for run in reversed(table.runs)  # of the first run, as the reference itself is
        for level in run.description.levels
        if level.level_kind == "uniform" and reference in level.references
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


def _on_kind(rows: pd.DataFrame, level_kind: str) -> pd.DataFrame:
    return rows[rows["level_kind"] == level_kind]
