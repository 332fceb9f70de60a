"""The paper's tables as functions of runs.

The protocol, and what it leaves open (Chan et al. 2022, section on training and evaluation):

1. "We take the median run across the three runs, and report the median performance in a time
   window." A seed's score is the median of its evaluations inside the window, both ends included;
   the table shows the median of the seeds' scores, for each level kind by itself. For an odd
   number of seeds this is the window median of the median run; for an even number, where no run
   is the median one, it is the mean of the middle two.
2. "± median absolute deviation across runs": the median of the seeds' distances from their median,
   without the factor 1.4826 that would make it estimate a standard deviation, since the paper
   names none. One seed has no deviation: none is shown.
3. The window is part of the result. A run with no evaluation inside it has no score, and a note
   says so; it is never scored somewhere else unless the reader asks for another window.

Runs are pooled only if they can be compared: same experiment, split, environment options, window
and published counterpart. Others of the same experiment get a table of their own, whose title says
what differs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from zipf.experiments.errors import UserError
from zipf.experiments.reporting.paper import (
    LEVEL_KINDS,
    PaperTable,
    condition_name,
    condition_order,
    paper_table,
)
from zipf.experiments.reporting.results import Run

PROTOCOL_SEEDS = 3  # the paper trains three replicas per condition

SCORE_COLUMNS = (
    "table",
    "experiment",
    "condition",
    "level_kind",
    "seeds",
    "median",
    "mad",
    "paper_value",
    "paper_error",
    "chance",
    "window",
    "evaluations",
    "episodes",
    "updates",
    "frames",
)


@dataclass(frozen=True)
class UpdateWindow:
    """All evaluations at updates `start` to `end`, both included."""

    start: int
    end: int

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        return updates.between(self.start, self.end)

    def __str__(self) -> str:
        return f"{self.start}:{self.end}"


@dataclass(frozen=True)
class LastEvaluations:
    """The last `count` evaluations of each run, wherever they are."""

    count: int

    def select(self, updates: pd.Series) -> pd.Series:
        """Mask of the updates inside."""
        return updates.isin(np.unique(updates)[-self.count :])

    def __str__(self) -> str:
        return "last" if self.count == 1 else f"last:{self.count}"


Window = UpdateWindow | LastEvaluations

TrainGroups = Mapping[str, tuple[str, ...]]


def parse_window(text: str) -> Window:
    """The window that `text` names: `2000000:3000000`, `2M:3M`, `last` or `last:10`.

    Raises:
        UserError: none of these.
    """
    if match := re.fullmatch(r"last(?::([1-9]\d*))?", text):
        return LastEvaluations(int(match[1] or 1))
    if match := re.fullmatch(r"(\d+)([kM]?):(\d+)([kM]?)", text):
        factor = {"": 1, "k": 1_000, "M": 1_000_000}
        start, end = int(match[1]) * factor[match[2]], int(match[3]) * factor[match[4]]
        if start <= end:
            return UpdateWindow(start, end)
        raise UserError(f"window {text!r} ends before it starts")
    raise UserError(
        f"window {text!r} is neither START:END in updates (2000000:3000000, 2M:3M) "
        f"nor last or last:N (the last N evaluations of each run)"
    )


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """One experiment's table, before it is rendered.

    Attributes:
        name: unique among the tables of a report, and safe in file names.
        title: the experiment, and what sets the table apart from others of that experiment.
        window: over which the scores are taken.
        own_window: whether that is the experiment's own.
        paper: what was published; None where it has a number for none of the conditions.
        scores: one row per (condition, level kind), in the table's order; see `score_table`.
        train_groups: the train levels apart, or in the groups that the paper averages, by the
            group's name; empty where there is one train level.
        train_scores: as `scores`, with these groups in the place of level kinds.
        notes: what is missing or doubtful, one sentence each.
    """

    name: str
    title: str
    runs: tuple[Run, ...]
    window: Window
    own_window: bool
    paper: PaperTable | None
    scores: pd.DataFrame
    train_groups: TrainGroups
    train_scores: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def conditions(self) -> list[str]:
        """The table's rows, in order."""
        return list(dict.fromkeys(self.scores["condition"]))

    @property
    def chance(self) -> dict[str, float]:
        """Score of uniformly random actions by level kind; empty where it is not known."""
        known = self.scores.dropna(subset=["chance"])
        return dict(zip(known["level_kind"], known["chance"], strict=True))

    @property
    def chance_episodes(self) -> list[int]:
        """Over how many episodes the chance of each level was measured; empty where it is exact."""
        return [
            level.chance_episodes
            for run in self.runs
            for level in run.description.levels
            if level.chance_episodes is not None
        ]

    @property
    def episodes(self) -> list[int]:
        """How many episodes of a level are behind each evaluation inside the window."""
        return [
            int(count)
            for run in self.runs
            for count in run.level_evaluations["episodes"][
                self.window.select(run.level_evaluations["update"])
            ]
        ]

    @property
    def situation_sizes(self) -> dict[str, int]:
        """How many ranks each of the situation's columns has; empty where runs do not tell."""
        return {
            name: size
            for run in self.runs
            for name, size in (run.description.situation or {}).items()
        }


def seed_scores(
    runs: Sequence[Run], window: Window, train_groups: TrainGroups | None = None
) -> pd.DataFrame:
    """Every run's score: the median of its evaluations inside the window.

    Args:
        train_groups: score these in the place of the level kinds.

    Returns:
        One row per run and level kind: `condition`, `seed`, `level_kind`, `evaluations` (how many
        lie inside the window), `episodes` (the fewest behind one of them) and `score`, NaN where
        there is none.
    """
    rows: list[dict[str, Any]] = []
    for run in runs:
        updates = run.level_evaluations["update"]
        updates = updates[window.select(updates)]
        for level_kind in train_groups or LEVEL_KINDS:
            if train_groups:
                evaluations = run.mean_over("train", train_groups[level_kind])
            else:
                evaluations = run.evaluations[run.evaluations["level_kind"] == level_kind]
            evaluations = evaluations[evaluations["update"].isin(updates)]
            rows.append(
                {
                    "condition": run.description.condition,
                    "seed": run.description.seed,
                    "level_kind": level_kind,
                    "evaluations": len(evaluations),
                    "episodes": evaluations["episodes"].min() if len(evaluations) else 0,
                    "score": evaluations["score"].median() if len(evaluations) else np.nan,
                }
            )
    return pd.DataFrame(rows)


def median_absolute_deviation(values: pd.Series) -> float:
    """Median distance from the median, unscaled; NaN for fewer than two values."""
    return float((values - values.median()).abs().median()) if len(values) > 1 else float("nan")


def score_table(
    runs: Sequence[Run],
    window: Window,
    *,
    name: str = "",
    paper: PaperTable | None = None,
    train_groups: TrainGroups | None = None,
) -> pd.DataFrame:
    """The scores of comparable runs, one row per condition and level kind.

    Args:
        train_groups: score these in the place of the level kinds.

    Returns:
        `SCORE_COLUMNS`: `seeds` counts the seeds that have a score; `median` and `mad` are over
        these; `evaluations` and `episodes` are the fewest behind one of their scores; `updates`
        and `frames` the fewest that a run of the condition has reached. NaN is "none".
    """
    scores = seed_scores(runs, window, train_groups)
    chance = _chance_of_groups(runs, train_groups) if train_groups else _chance(runs)
    rows: list[dict[str, Any]] = []
    for condition in sorted({run.description.condition for run in runs}, key=condition_order):
        of_condition = [run for run in runs if run.description.condition == condition]
        for level_kind in train_groups or LEVEL_KINDS:
            chosen = scores[
                (scores["condition"] == condition)
                & (scores["level_kind"] == level_kind)
                & scores["score"].notna()
            ]
            published = paper.score(condition, level_kind) if paper else None
            rows.append(
                {
                    "table": name,
                    "experiment": of_condition[0].description.experiment,
                    "condition": condition,
                    "level_kind": level_kind,
                    "seeds": len(chosen),
                    "median": chosen["score"].median() if len(chosen) else np.nan,
                    "mad": median_absolute_deviation(chosen["score"]),
                    "paper_value": published.value if published else np.nan,
                    "paper_error": (
                        published.error if published and published.error is not None else np.nan
                    ),
                    "chance": chance.get(level_kind, np.nan),
                    "window": str(window),
                    "evaluations": int(chosen["evaluations"].min()) if len(chosen) else 0,
                    "episodes": int(chosen["episodes"].min()) if len(chosen) else 0,
                    "updates": min(run.updates for run in of_condition),
                    "frames": min(run.frames for run in of_condition),
                }
            )
    return pd.DataFrame(rows, columns=list(SCORE_COLUMNS))


def score_tables(runs: Sequence[Run], window: Window | None = None) -> list[ScoreTable]:
    """One table per experiment; more where runs of an experiment cannot be compared.

    Args:
        window: instead of each run's own.

    Raises:
        UserError: two runs of a table are the same condition and seed, or a run names a published
            experiment that the paper does not have.
    """
    groups: dict[str, list[Run]] = {}
    for run in runs:
        identity = _identity(run, window)
        key = json.dumps([run.description.experiment, identity], sort_keys=True)
        groups.setdefault(key, []).append(run)

    tables: list[ScoreTable] = []
    for key in sorted(groups):
        group = groups[key]
        _refuse_duplicates(group)
        description = group[0].description
        siblings = [
            _identity(other[0], window)
            for other in groups.values()
            if other[0].description.experiment == description.experiment
        ]
        name = _unused_name(description.experiment, [table.name for table in tables])
        used = window or UpdateWindow(*description.window)
        paper = _paper(group)
        scores = score_table(group, used, name=name, paper=paper)
        train_groups = _train_groups(group, paper)
        tables.append(
            ScoreTable(
                name=name,
                title=_title(description.experiment, _identity(group[0], window), siblings),
                runs=tuple(group),
                window=used,
                own_window=window is None,
                paper=paper if scores["paper_value"].notna().any() else None,
                scores=scores,
                train_groups=train_groups,
                train_scores=(
                    score_table(group, used, name=name, paper=paper, train_groups=train_groups)
                    if train_groups
                    else scores[:0]
                ),
                notes=_notes(group, used),
            )
        )
    return tables


def wilson_interval(successes: pd.Series, episodes: pd.Series) -> tuple[pd.Series, pd.Series]:
    """95 % interval of a success rate (Wilson 1927, without continuity correction)."""
    z = 1.959964
    rate = successes / episodes
    centre = (rate + z**2 / (2 * episodes)) / (1 + z**2 / episodes)
    half = (
        z / (1 + z**2 / episodes) * np.sqrt(rate * (1 - rate) / episodes + z**2 / (4 * episodes**2))
    )
    return (centre - half).clip(lower=0), (centre + half).clip(upper=1)


def success_rates(
    table: ScoreTable, ranks: Sequence[str], level_kind: str = "uniform"
) -> pd.DataFrame:
    """Success by the named ranks of the situation, pooled over window and seeds.

    On the uniform level, by default: there every situation weighs the same, so that the success
    at one rank is not a mixture that follows the law of the others.

    Returns:
        One row per condition and combination of ranks that occurred: `condition`, the ranks,
        `episodes`, `successes`, `success`, and `low` and `high`, its 95 % Wilson interval. The
        interval covers the chance of the episodes, not the difference between seeds.
    """
    parts = []
    for run in table.runs:
        if not set(ranks) <= set(run.situation_names):
            continue
        inside = run.situations[table.window.select(run.situations["update"])]
        inside = inside[inside["level_kind"] == level_kind]
        parts.append(inside.assign(condition=run.description.condition))
    keys = ["condition", *ranks]
    columns = [*keys, "episodes", "successes"]
    pooled = (
        pd.concat([part[columns] for part in parts]) if parts else pd.DataFrame([], None, columns)
    )
    rates = pooled.groupby(keys, as_index=False)[["episodes", "successes"]].sum()
    rates = rates[rates["episodes"] > 0].reset_index(drop=True)
    rates["success"] = rates["successes"] / rates["episodes"]
    rates["low"], rates["high"] = wilson_interval(rates["successes"], rates["episodes"])
    return rates


def count_text(count: int) -> str:
    """A count as captions show it: 12,345,678 below ten million, 12.3 billion above."""
    for size, word in ((10**9, "billion"), (10**6, "million")):
        if count >= max(size, 10**7):
            return f"{count / size:.3g} {word}"
    return f"{count:,}"


def window_text(window: Window) -> str:
    """The window in words."""
    if isinstance(window, UpdateWindow):
        return f"updates {count_text(window.start)} to {count_text(window.end)}"
    return f"the last {window.count} evaluations" if window.count > 1 else "the last evaluation"


def _identity(run: Run, window: Window | None) -> dict[str, Any]:
    """What runs of one table have in common, beside the experiment."""
    description = run.description
    return {
        "split": description.split,
        "paper": description.paper,
        "window": str(window or UpdateWindow(*description.window)),
        **{f"environment.{name}": value for name, value in description.environment.items()},
    }


def _title(experiment: str, identity: dict[str, Any], siblings: list[dict[str, Any]]) -> str:
    names = sorted({name for sibling in siblings for name in sibling})
    differing = [
        f"{name.removeprefix('environment.')} {identity.get(name, 'as by default')}"
        for name in names
        if any(sibling.get(name) != siblings[0].get(name) for sibling in siblings)
    ]
    return f"{experiment} ({', '.join(differing)})" if differing else experiment


def _unused_name(experiment: str, used: list[str]) -> str:
    name = re.sub(r"[^\w.-]", "_", experiment)
    numbered = (f"{name}-{number}" for number in range(2, len(used) + 3))
    return name if name not in used else next(other for other in numbered if other not in used)


def _refuse_duplicates(runs: Sequence[Run]) -> None:
    seen: dict[tuple[str, int], Run] = {}
    for run in runs:
        key = (run.description.condition, run.description.seed)
        if key in seen:
            raise UserError(
                f"{seen[key].label} and {run.label} are the same run twice: experiment "
                f"{run.description.experiment}, condition {key[0]}, seed {key[1]}"
            )
        seen[key] = run


def _paper(runs: Sequence[Run]) -> PaperTable | None:
    key = runs[0].description.paper
    if key is None:
        return None
    try:
        return paper_table(key)
    except UserError as error:
        raise UserError(f"{runs[0].label}/run.json: paper: {error}") from error


def _chance(runs: Sequence[Run]) -> dict[str, float]:
    """The first known value for each level kind."""
    chance: dict[str, float] = {}
    for run in runs:
        for level_kind, value in (run.description.chance or {}).items():
            if value is not None:
                chance.setdefault(level_kind, value)
    return chance


def _chance_of_groups(runs: Sequence[Run], groups: TrainGroups) -> dict[str, float]:
    """The mean over each group's levels, of the first known values."""
    known: dict[str, float] = {}
    for level in (level for run in runs for level in run.description.levels):
        if level.chance is not None:
            known.setdefault(level.level, level.chance)
    return {
        name: float(np.mean([known[level] for level in levels]))
        for name, levels in groups.items()
        if known.keys() >= set(levels)
    }


def _train_groups(runs: Sequence[Run], paper: PaperTable | None) -> TrainGroups:
    """The groups that the paper averages, then every other train level; empty if there is one."""
    names = next((names for run in runs if (names := run.description.names("train"))), [])
    if len(names) < 2:
        return {}
    groups = dict(paper.train_groups) if paper else {}
    alone = [(name,) for name in names]
    return groups | {levels[0]: levels for levels in alone if levels not in groups.values()}


def _notes(runs: Sequence[Run], window: Window) -> tuple[str, ...]:
    notes: list[str] = []
    for run in runs:
        notes += run.notes
        notes += _window_notes(run, window)
    chances = {json.dumps(run.description.chance, sort_keys=True): run for run in reversed(runs)}
    if len(chances) > 1:
        names = " and ".join(sorted(run.label for run in chances.values())[:2])
        notes.append(f"{names} disagree about chance: the first known value is shown.")
    for condition in dict.fromkeys(run.description.condition for run in runs):
        notes += _settings_notes([run for run in runs if run.description.condition == condition])
    return tuple(notes)


def _window_notes(run: Run, window: Window) -> list[str]:
    if not len(run.evaluations):
        return [f"{run.label}: no evaluation yet; not counted."]
    inside = window.select(run.evaluations["update"])
    if isinstance(window, UpdateWindow) and not inside.any():
        last = count_text(int(run.evaluations["update"].max()))
        return [
            f"{run.label}: no evaluation at {window_text(window)} (the last is at update {last}); "
            f"not counted. --window last shows it."
        ]
    notes = []
    missing = set(LEVEL_KINDS) - set(run.evaluations.loc[inside, "level_kind"])
    if missing:
        notes.append(
            f"{run.label}: no evaluation of {', '.join(sorted(missing))}; not counted there."
        )
    if isinstance(window, UpdateWindow) and run.updates < window.end:
        evaluations = run.evaluations.loc[inside, "update"].nunique()
        notes.append(
            f"{run.label}: at update {count_text(run.updates)}, before the window's end: scored "
            f"over the {evaluations} evaluations so far."
        )
    return notes


def _settings_notes(runs: Sequence[Run]) -> list[str]:
    """Seeds of a condition should differ in nothing else."""
    known = [run for run in runs if run.settings]
    names = sorted({name for run in known for name in run.settings})
    differing = [name for name in names if len({repr(run.settings.get(name)) for run in known}) > 1]
    if not differing:
        return []
    shown = ", ".join(differing[:5]) + (" and more" if len(differing) > 5 else "")
    condition = condition_name(runs[0].description.condition)
    return [f"The seeds of {condition} were not trained with the same settings: {shown} differ."]
