"""The paper's tables as functions of runs, with notes on what is missing or doubtful in them.

`scores.py` has the protocol. `comparable.py` says which runs share a table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.records.descriptions import LevelGroup, RunDescription
from zipf.experiments.records.paper import PaperTable
from zipf.experiments.records.results import Run, devices_of
from zipf.experiments.records.wording import count_text, seeds_list
from zipf.experiments.reporting.comparable import Row, group_runs, paper_of, rows_of
from zipf.experiments.reporting.scores import CSV_COLUMNS, known_baselines, score_frame
from zipf.experiments.reporting.windows import (
    Asked,
    LastEvaluations,
    ScaledWindow,
    UpdateWindow,
    Window,
    evaluations_inside,
    table_window,
    window_of,
    window_text,
)
from zipf.protocol import BASELINE_NAMES, KINDS, PAPER_KINDS, says_little


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """One experiment's table, before it is rendered."""

    name: str  # unique among the tables of a report, and safe in file names
    title: str  # the experiment, and what sets the table apart from others of that experiment
    description: RunDescription  # of its first run, which is one of this package if there is any
    rows: tuple[Row, ...]  # in the table's order
    window: Window  # over which the scores are taken
    own_window: bool  # whether that is the experiment's own, see `table_window`
    # the window that was meant and that no run has reached yet: scores are of the last evaluations
    unreached: Window | None
    paper: PaperTable | None  # what was published; None where it has a number for none of the rows
    kinds: tuple[LevelGroup, ...]  # the levels of each kind
    scores: pd.DataFrame  # one line per row and level kind; see `score_frame`
    # the levels of every kind that has several: those that the paper averages together, then each
    # by itself
    groups: tuple[LevelGroup, ...]
    group_scores: pd.DataFrame  # as `scores`, one line per row and group
    notes: tuple[str, ...]  # what is missing or doubtful, one sentence each

    @property
    def runs(self) -> list[Run]:
        """All runs, in the order of rows."""
        return [run for row in self.rows for run in row.runs]

    def baseline(self, name: str) -> dict[str, float]:
        """Score of a policy that does not learn by level kind, the first row's that has one;
        without those not known."""
        known = self.scores.groupby("level_kind", sort=False)[name].first().dropna()
        return {str(kind): float(score) for kind, score in known.items()}

    def baseline_episodes(self, name: str) -> list[int]:
        """Over how many episodes a baseline was measured on each level, without those on which it
        is exact or not known."""
        known = known_baselines(self.runs, name).values()
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


def score_tables(
    runs: Sequence[Run], window: Asked | None = None, order: Sequence[str] = ()
) -> list[ScoreTable]:
    """One table per experiment; more where runs of an experiment cannot be compared.
    Raises UserError: two runs of a table are the same condition and seed, or a run names a
    published experiment that the paper does not have.

    Args:
        window: instead of each run's own; "scaled" for that at the same fractions of shorter runs;
            `OwnWindows` for each run's own, with those that differ in one table.
        order: conditions whose rows come first, in this order.
    """
    tables: list[ScoreTable] = []
    for group in group_runs(runs, window):
        rows = rows_of(group.runs, group.title, order)
        paper = paper_of(group.runs)
        description = group.runs[0].description
        used, is_own = table_window(group.runs, window)
        unreached = None if _is_reached(group.runs, used) else used
        if unreached is not None:
            used, is_own = LastEvaluations(1), False
        kinds = tuple(_kinds(group.runs))
        groups = tuple(part for levels in kinds for part in _parts(levels, paper))
        whole = score_frame(rows, kinds, used, group.name, description.experiment, paper)
        parts = score_frame(rows, groups, used, group.name, description.experiment, paper)
        if unreached is not None:
            whole, parts = (one.assign(marked=~one["external"]) for one in (whole, parts))
        tables.append(
            ScoreTable(
                name=group.name,
                title=group.title,
                description=description,
                rows=rows,
                window=used,
                own_window=is_own,
                unreached=unreached,
                paper=paper if whole["paper_value"].notna().any() else None,
                kinds=kinds,
                scores=whole,
                groups=groups,
                group_scores=parts,
                notes=notes(rows, used),
            )
        )
    return tables


def _is_reached(runs: Sequence[Run], window: Window) -> bool:
    """Whether one of these runs has an evaluation inside; also where none has any anywhere."""
    ours = [run for run in runs if not run.description.external and len(run.evaluations)]
    return not ours or any(len(evaluations_inside(run, window)) for run in ours)


def report_frame(tables: Sequence[ScoreTable]) -> pd.DataFrame:
    """The columns of `report.csv`: one line per row and level kind, NaN for none.

    Where a kind has several levels, lines for each level and for the paper's groups of levels
    follow those of the table.
    """
    parts = [part for table in tables for part in (table.scores, table.group_scores)]
    together = pd.concat([part for part in parts if len(part)], ignore_index=True)
    return together[list(CSV_COLUMNS)]


def csv_report(tables: Sequence[ScoreTable]) -> str:
    """`report.csv`: `report_frame` at full precision, empty for none."""
    return report_frame(tables).to_csv(index=False, float_format="%.10g", lineterminator="\n")


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


def notes(rows: Sequence[Row], window: Window) -> tuple[str, ...]:
    """The notes of a table of these rows."""
    runs = [run for row in rows for run in row.runs]
    found = [note for run in runs for note in run.notes]
    for row in rows:
        texts: dict[str, list[int]] = {}
        for run in row.runs:
            for text in _window_notes(run, window_of(run, window)):
                texts.setdefault(text, []).append(run.description.seed)
        title = row.runs[0].description.row.title
        found += [f"{title}, {seeds_list(seeds)}: {text}" for text, seeds in texts.items()]
    devices = devices_of(runs)
    if len(devices) > 1:
        found.append(
            f"Runs were on {'; '.join(devices)}: their times are not compared, so that there is no "
            "figure of scores against time."
        )
    found += [note for name in BASELINE_NAMES for note in _baseline_notes(runs, name)]
    found += _floor_notes(runs)
    for row in rows:
        found += _seeds_notes(row.runs) + _pretrained_notes(row.runs)
    return tuple(found)


def _window_notes(run: Run, window: Window) -> list[str]:
    if not len(run.evaluations):
        return ["no evaluation yet; not counted."]
    inside = evaluations_inside(run, window)
    if isinstance(window, UpdateWindow) and not len(inside):
        last = count_text(int(run.evaluations["update"].max()))
        return [
            f"no evaluation at {window_text(window)} (the last is at update {last}); not counted."
        ]
    found = []
    number = inside["update"].nunique()
    if isinstance(window, LastEvaluations) and number < window.count:
        beside = " beside that at update 0" if len(inside) < len(run.evaluations) else ""
        found.append(
            f"has {number} evaluation{'s' if number > 1 else ''}{beside}, not "
            f"{window.count}: scored over what there is."
        )
    known = {level.level_kind for level in run.description.levels}
    missing = known.intersection(PAPER_KINDS) - set(inside["level_kind"])
    if missing:
        found.append(f"no evaluation of {', '.join(sorted(missing))}; not counted there.")
    if isinstance(window, ScaledWindow) and inside["update"].max() < window.end:
        start, end = window.inside(int(inside["update"].max()))
        found.append(
            f"ends at update {count_text(end)}, before update "
            f"{count_text(window.end)}: scored over updates {count_text(math.ceil(start))} to "
            f"{count_text(end)}, a scaled window."
        )
    if isinstance(window, UpdateWindow) and run.updates < window.end:
        found.append(
            f"at update {count_text(run.updates)}, before the window's end: scored "
            f"over the {number} evaluation{'s' if number > 1 else ''} so far."
        )
    return found


def _baseline_notes(runs: Sequence[Run], name: str) -> list[str]:
    first: dict[tuple[str, str], tuple[float, Run]] = {}
    for run in runs:
        for level in run.description.levels:
            if name not in level.baselines:
                continue
            score = level.baselines[name].score
            known, other = first.setdefault((level.level_kind, level.level), (score, run))
            if not math.isclose(known, score, rel_tol=1e-9, abs_tol=1e-12):  # of other machines
                return [
                    f"{other.label} and {run.label} disagree about {name} "
                    f"({known:.2f} and {score:.2f} on {level.level}): the first is shown."
                ]
    return []


def _floor_notes(runs: Sequence[Run]) -> list[str]:
    """Levels on which a policy that is not told what is asked for does well."""
    names: list[str] = []
    for run in runs:
        for level in run.description.levels:
            blind, expert = (level.baselines.get(name) for name in ("blind", "expert"))
            scores = [one.score if one else None for one in (blind, expert)]
            if says_little(*scores) and level.level not in names:
                names.append(level.level)
    if not names:
        return []
    shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    return [
        f"Says little about reading: {shown}. A policy that is not told what is asked for has more "
        "than half of the expert's score there."
    ]


def _seeds_notes(runs: Sequence[Run]) -> list[str]:
    """Seeds of a condition should differ in nothing else."""
    titles = list(dict.fromkeys(run.description.row.title for run in runs))
    found = []
    if len(titles) > 1:
        found.append(
            f"The seeds of {runs[0].description.condition} have different titles "
            f"({', '.join(titles)}): the first is shown."
        )
    versions = sorted({str(run.description.version) for run in runs})
    if len(versions) > 1:
        found.append(f"The seeds of {titles[0]} are of versions {' and '.join(versions)}.")
    names = sorted({name for run in runs for name in run.settings})
    differing = [name for name in names if len({repr(run.settings.get(name)) for run in runs}) > 1]
    if differing:
        shown = ", ".join(differing[:5]) + (" and more" if len(differing) > 5 else "")
        found.append(
            f"The seeds of {titles[0]} were not trained with the same settings: {shown} differ."
        )
    return found


def _pretrained_notes(runs: Sequence[Run]) -> list[str]:
    """Which other runs the seeds of a condition began with."""
    alike: dict[tuple[str, str, str], list[int]] = {}
    for run in runs:
        seed, there = run.description.seed, run.description.pretrained
        if there is not None:
            other = "the same seed" if there.seed == seed else f"seed {there.seed}"
            frames = count_text(there.frames)
            where = f"{', '.join(there.parts)} of {there.experiment} {there.condition}"
            alike.setdefault((where, other, frames), []).append(seed)
    return [
        f"{seeds_list(seeds).capitalize()} of {runs[0].description.row.title} began with the "
        f"{where}, {other}, trained on {frames} frames, which are counted here, too."
        for (where, other, frames), seeds in alike.items()
    ]
