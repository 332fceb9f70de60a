"""Score tables as text, before any markup: cells, and the caption below, how to read them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from zipf.experiments.records.descriptions import LevelGroup
from zipf.experiments.records.wording import (
    EXTERNAL_MARK,
    KIND_NAMES,
    NONE,
    PROTOCOL_SEEDS,
    count_text,
    range_text,
    score_text,
    seeds_text,
    short_name,
    updates_text,
)
from zipf.experiments.reporting.claim_checks import LEARNED
from zipf.experiments.reporting.claims import PUBLISHED_WINDOWS, ClaimLine
from zipf.experiments.reporting.comparable import PaperRow, Row
from zipf.experiments.reporting.scores import fewest_seeds, other_statistic
from zipf.experiments.reporting.side_by_side import SideBySide
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import OwnWindows, UpdateWindow, window_text
from zipf.protocol import BASELINES, Baseline

PLAIN_MEAN = "plain mean"
LAST_MARK = "*"
LEVEL = "Level"  # the first heading of a table whose lines are levels


def caption(table: ScoreTable) -> str:
    """What is a table's own: window, effort, the paper."""
    window = table.window
    what = window_text(window)
    if isinstance(window, OwnWindows):
        what = "the updates in the column Window"
    sentences = [f"{what[0].upper()}{what[1:]}."]
    if table.unreached is not None:
        what = window_text(table.unreached)
        sentences = [f"No run has reached its window, {what}: the last evaluation of each."]
    elif not table.own_window:
        sentences = [f"{sentences[0][:-1]} (not the experiment's own window)."]
    if table.episodes:
        sentences.append(f"Episodes per estimate: {range_text(table.episodes)}.")
    own = [run for row in table.rows if not row.external for run in row.runs]
    if own:
        sentences.append(
            f"Updates reached: {range_text([run.updates for run in own])}; "
            f"frames: {range_text([run.frames for run in own])}."
        )
    elif table.frames:
        sentences.append(f"Frames: {range_text(list(table.frames.values()))}.")
    if table.paper:
        sentences.append(f"Paper: {table.paper.source}, ± {table.paper.error_kind}.")
        if table.paper.note:
            sentences.append(table.paper.note)
    return " ".join(sentences)


def short_caption(table: ScoreTable) -> str:
    """The least that a table has to say by itself in a paper."""
    spread = (
        "standard error across tasks"
        if table.description.spread == "tasks"
        else "median absolute deviation across seeds"
    )
    if table.unreached is not None:
        return f"Last evaluations (window not reached); median over seeds ± {spread}."
    what = window_text(table.window)
    marked = f" {LAST_MARK}: last evaluation (window not reached)."
    return f"{what[0].upper()}{what[1:]}; median over seeds ± {spread}." + (
        marked if table.scores["marked"].any() else ""
    )


def legend(tables: Sequence[ScoreTable]) -> list[str]:
    """How to read tables: what they have in common, a sentence each."""
    sentences = []
    tasks = [table for table in tables if table.description.spread == "tasks"]
    seeds = [table for table in tables if table not in tasks]
    if seeds:
        sentences.append(
            "A score is the median over seeds of each seed's median over the evaluations in the "
            "window, ± median absolute deviation across seeds (unscaled)."
        )
        if any(len(levels.weights) > 1 for table in seeds for levels in table.kinds):
            sentences.append("The score of several levels is their mean, weighted by the split.")
    if tasks:
        of_tasks = f": {', '.join(table.title for table in tasks)}" if seeds else ""
        sentences.append(
            "A score is, for each level, the median over seeds of each seed's median over the "
            "evaluations in the window, then the mean over the levels of a kind, weighted by the "
            f"split, ± standard error across these levels (tasks){of_tasks}."
        )
    if any(levels.is_weighted for table in tables for levels in table.kinds):
        sentences.append(f"In a {PLAIN_MEAN} all levels have the same weight.")
    if any(table.is_capped for table in tables):
        sentences.append(
            "Capped: each level counts as at most 1, the score of a human, before the mean, as is "
            "the convention on DMLab-30 (Espeholt et al. 2018)."
        )
    if any((table.scores["seeds"] < PROTOCOL_SEEDS).any() for table in tables):
        sentences.append(f"n/{PROTOCOL_SEEDS}: fewer seeds than the protocol's {PROTOCOL_SEEDS}.")
    if any(table.scores["marked"].any() for table in tables):
        sentences.append(
            f"{LAST_MARK}: the window is not reached yet; the score is that of the last "
            f"evaluation, and not to be compared."
        )
    if any(table.budgets_differ for table in tables):
        sentences.append(
            "The column Frames has the training frames behind a row's scores, with those of the "
            "runs that it began with."
        )
    if any(row.external for table in tables for row in table.rows):
        sentences.append(
            f"{EXTERNAL_MARK}: recorded from outside this package and scored at its last "
            f"evaluation."
        )
    for one in BASELINES:
        if any(table.baseline(one.name) for table in tables):
            episodes = [n for table in tables for n in table.baseline_episodes(one.name)]
            measured = (
                f", measured over {range_text(episodes)} episodes of each level" if episodes else ""
            )
            sentences.append(f"{one.title}: {one.meaning}{measured}.")
    return sentences


def side_by_side_caption(beside: SideBySide) -> str:
    """Where the columns come from."""
    sentences = [
        "Laid out as in the paper; the columns are those of the tables above, where episodes and "
        "notes stand."
    ]
    for table in beside.tables:
        assert table.description.paper is not None  # a layout has no others
        published = UpdateWindow(*PUBLISHED_WINDOWS[table.description.paper])
        of_paper = (
            "as in the paper"
            if table.window == published
            else (f"in the paper {window_text(published)}")
        )
        sentences.append(f"{table.title}: {window_text(table.window)}, {of_paper}.")
    if beside.missing:
        sentences.append(f"There is no run of {', '.join(beside.missing)}.")
    if any(isinstance(row, Row) and row.external for row in beside.rows):
        sentences.append(f"{EXTERNAL_MARK}: recorded from outside this package.")
    return " ".join(sentences)


def claims_caption(lines: Sequence[ClaimLine]) -> str:
    """How to read the claims, and which have no scores."""
    sentences = [
        f"A claim holds if its measure lies within bounds, which are ours. A score of fewer than "
        f"{PROTOCOL_SEEDS} seeds decides nothing, nor do compared scores of which none is "
        f"{LEARNED} above the floor, the higher one of chance and blind. By seed: least and "
        f"largest measure over all choices of a seed of each condition. Last column: the same "
        f"check of the numbers that the paper prints."
    ]
    known = {line.claim.id for line in lines if line.at_hand}
    without = dict.fromkeys(line.claim.id for line in lines if line.claim.id not in known)
    if without:
        sentences.append(f"Not enough data, with no score at hand: {', '.join(without)}.")
    return " ".join(sentences)


MOST_COLUMNS = 5  # of scores, as many as fit a page; more levels than that become lines
MOST_WITH_LEADING = 9  # columns of all kinds where levels are lines


@dataclass(frozen=True)
class Line:
    """A line of a grid: its leading cells, then one of `ours` and of `paper` for each column."""

    leading: list[str]
    ours: list[str]
    paper: list[str]


@dataclass(frozen=True)
class Grid:
    """A table's cells as text."""

    title: str  # of the table; of a grid of levels, which levels these are
    name: str  # unique among the grids of a report
    # the headings of the leading columns, the first of which is text, the rest numbers
    leading: list[str]
    columns: list[str]  # the headings of the columns of scores
    lines: list[Line]  # without the baselines
    # apart from the others; without those that are not known or not at the bottom
    baselines: list[Line]

    @cached_property
    def has_paper(self) -> tuple[bool, ...]:
        """For each column of scores whether the paper has a number in it."""
        return tuple(
            any(line.paper[place] != NONE for line in self.lines)
            for place in range(len(self.columns))
        )

    def cells(self, line: Line) -> list[str]:
        """A line's cells, the paper's beside ours in columns where there are any."""
        cells = [*line.leading]
        for ours, paper, published in zip(line.ours, line.paper, self.has_paper, strict=True):
            cells += [ours, paper] if published else [ours]
        return cells


def main_grid(table: ScoreTable) -> Grid:
    """A line for each row of the table, a column for each level kind."""
    columns, scores = _with_plain_means(table)
    parts = _by_row(table.rows, scores, columns, _budgets(table))
    return Grid(table.title, table.name, _leading(table), list(columns.values()), *parts)


def lower_grids(table: ScoreTable) -> Iterator[Grid]:
    """The tables below the main one: capped scores, where there are any, then the levels of every
    kind that has several, as columns, or as lines if they are too many."""
    if table.is_capped:
        columns = {levels.column: KIND_NAMES[levels.level_kind] for levels in table.kinds}
        capped = other_statistic(table.scores, "capped")
        parts = _by_row(table.rows, capped, columns, _budgets(table))
        name = f"{table.name}-capped"
        yield Grid("capped scores", name, _leading(table), list(columns.values()), *parts)
    for levels in table.kinds:
        groups = [group for group in table.groups if group.level_kind == levels.level_kind]
        if not groups:
            continue
        title = f"{levels.level_kind} levels"
        name = f"{table.name}-{levels.level_kind}"
        if len(groups) <= MOST_COLUMNS:
            columns = dict(zip((group.column for group in groups), _names(groups), strict=True))
            parts = _by_row(table.rows, table.group_scores, columns, _budgets(table))
            yield Grid(title, name, _leading(table), list(columns.values()), *parts)
        else:
            baselines = _known_baselines(table.group_scores, [group.column for group in groups])
            leading = len(baselines) + (2 if levels.is_weighted else 1)
            most = min(MOST_COLUMNS, MOST_WITH_LEADING - leading)
            for first in range(0, len(table.rows), most):
                part = "" if first == 0 else f"-{first // most + 1}"
                rows = table.rows[first : first + most]
                yield _by_level(rows, table, groups, levels, baselines, title, name + part)


def side_by_side_grids(beside: SideBySide) -> list[Grid]:
    """The tables of one of the paper's layouts."""
    grids = []
    for number, (title, headings, scores) in enumerate(beside.parts):
        columns = {heading: heading for heading in headings}
        parts = _by_row(beside.rows, scores, columns, {})
        name = f"{beside.name}-{number}"
        grids.append(Grid(title, name, ["Condition", "Seeds"], list(headings), *parts))
    return grids


def _with_plain_means(table: ScoreTable) -> tuple[dict[str, str], pd.DataFrame]:
    """The headings of the level kinds and their scores, a plain mean after a weighted one."""
    columns: dict[str, str] = {}
    parts = [table.scores]
    for levels in table.kinds:
        kind = levels.level_kind
        columns[kind] = KIND_NAMES[kind]
        if levels.is_weighted:
            column = f"{kind}, {PLAIN_MEAN}"
            columns[column] = column.capitalize()
            of_kind = table.scores[table.scores["level_kind"] == kind]
            parts.append(other_statistic(of_kind, "plain").assign(column=column))
    return columns, pd.concat(parts)


def _budgets(table: ScoreTable) -> dict[str, dict[str, str]]:
    """By heading, a cell for each row's key: the frames behind a row's score, and the window that
    it is taken from. What is the same for all rows has no column."""
    budgets = {}
    if table.budgets_differ:
        budgets["Frames"] = {key: count_text(frames) for key, frames in table.frames.items()}
    if isinstance(table.window, OwnWindows):
        budgets["Window"] = {row.key: _windows(row) for row in table.rows if not row.external}
    return budgets


def _windows(row: Row) -> str:
    found = {run.description.window for run in row.runs if run.description.window}
    return ", ".join(updates_text(*window) for window in sorted(found))


def _leading(table: ScoreTable) -> list[str]:
    return ["Condition", "Seeds", *_budgets(table)]


def _by_row(
    rows: Sequence[Row | PaperRow],
    frame: pd.DataFrame,
    columns: Mapping[str, str],
    budgets: Mapping[str, Mapping[str, str]],
) -> tuple[list[Line], list[Line]]:
    """A line for each row that has scores in these columns, which are headings by the frame's
    `column`; and the last lines, of the baselines that are known."""
    frame = frame[frame["column"].isin(columns)]
    lines = []
    for row in rows:
        scores = frame[frame["row"] == row.key].set_index("column").reindex(list(columns))
        if scores["seeds"].isna().all():
            continue  # a row of another table than the columns'
        leading = [row.title, seeds_text(fewest_seeds(scores["seeds"]))]
        leading += [cells.get(row.key, NONE) for cells in budgets.values()]
        lines.append(_line(leading, scores))
    baselines = []
    for one in _known_baselines(frame, list(columns)):
        known = frame.groupby("column")[one.name].first().reindex(list(columns))
        leading = [one.title, *[""] * (1 + len(budgets))]
        texts = [score_text(value) for value in known]
        baselines.append(Line(leading, texts, [""] * len(columns)))
    return lines, baselines


def _by_level(
    rows: Sequence[Row],
    table: ScoreTable,
    groups: Sequence[LevelGroup],
    levels: LevelGroup,
    baselines: Sequence[Baseline],
    title: str,
    name: str,
) -> Grid:
    """A line for each group of levels, a column for each row of the table."""
    leading = [LEVEL]
    if levels.is_weighted:
        leading.append("Weight")
    leading += [one.title for one in baselines]
    known = table.group_scores.groupby("column").first()
    total = sum(levels.weights.values())
    lines = []
    for group, shown in zip(groups, _names(groups), strict=True):
        cells = {
            LEVEL: shown,
            "Weight": f"{sum(group.weights.values()) / total:.3f}",
            **{one.title: score_text(known[one.name][group.column]) for one in baselines},
        }
        scores = table.group_scores[table.group_scores["column"] == group.column]
        scores = scores.set_index("row").reindex([row.key for row in rows])
        lines.append(_line([cells[heading] for heading in leading], scores))
    return Grid(title, name, leading, [row.title for row in rows], lines, [])


def _names(groups: Sequence[LevelGroup]) -> list[str]:
    """Short names of the groups, or the full ones if two short ones are the same."""
    short = [short_name(group.name) for group in groups]
    return short if len(set(short)) == len(short) else [group.name for group in groups]


def _line(leading: list[str], scores: pd.DataFrame) -> Line:
    marked = scores["marked"].eq(True) & scores["shown"].notna()
    ours = zip(scores["shown"], scores["shown_error"], marked, strict=True)
    paper = zip(scores["paper_value"], scores["paper_error"], strict=True)
    return Line(
        leading,
        [score_text(score, error) + f" {LAST_MARK}" * mark for score, error, mark in ours],
        [score_text(*pair) for pair in paper],
    )


def _known_baselines(scores: pd.DataFrame, columns: Sequence[str]) -> list[Baseline]:
    """The baselines that are known in one of these columns, which are values of `column`."""
    shown = scores[scores["column"].isin(columns)]
    return [one for one in BASELINES if shown[one.name].notna().any()]
