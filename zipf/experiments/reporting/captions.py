"""The text below a table: how to read its numbers."""

from __future__ import annotations

from collections.abc import Sequence

from zipf.experiments.records.wording import EXTERNAL_MARK, PROTOCOL_SEEDS, range_text
from zipf.experiments.reporting.claim_checks import LEARNED
from zipf.experiments.reporting.claims import PUBLISHED_WINDOWS, ClaimLine
from zipf.experiments.reporting.rows import Row
from zipf.experiments.reporting.side_by_side import SideBySide
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import OwnWindows, ScaledWindow, UpdateWindow, window_text
from zipf.protocol import REFERENCES

PLAIN_MEAN = "plain mean"


def caption(table: ScoreTable) -> str:
    """Window, statistics, effort, references, the paper."""
    sentences = _statistics(table)
    if (table.scores["seeds"] < PROTOCOL_SEEDS).any():
        sentences.append(f"n/{PROTOCOL_SEEDS}: fewer seeds than the protocol's {PROTOCOL_SEEDS}.")
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
    if table.budgets_differ:
        sentences.append("The column Frames has the training frames behind a row's scores.")
    if any(row.external for row in table.rows):
        sentences.append(
            f"{EXTERNAL_MARK}: recorded from outside this package and scored at its last "
            f"evaluation."
        )
    for one in REFERENCES:
        if table.reference(one.name):
            measured = ""
            if episodes := table.reference_episodes(one.name):
                measured = f", measured over {range_text(episodes)} episodes of each level"
            sentences.append(f"{one.title}: {one.meaning}{measured}.")
    if table.paper:
        sentences.append(f"Paper: {table.paper.source}, ± {table.paper.error_kind}.")
        if table.paper.note:
            sentences.append(table.paper.note)
    return " ".join(sentences)


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
        f"{LEARNED} above chance. By seed: least and largest measure over all choices of a seed "
        f"of each condition. Last column: the same check of the numbers that the paper prints."
    ]
    known = {line.claim.id for line in lines if line.at_hand}
    without = dict.fromkeys(line.claim.id for line in lines if line.claim.id not in known)
    if without:
        sentences.append(f"Not enough data, with no score at hand: {', '.join(without)}.")
    return " ".join(sentences)


def _statistics(table: ScoreTable) -> list[str]:
    window = table.window
    what = window_text(window)
    if isinstance(window, UpdateWindow | ScaledWindow):
        what = f"Median over the evaluations at {what}"
    elif isinstance(window, OwnWindows):
        what = "Median over the evaluations at the updates in the column Window"
    elif window.count > 1:
        what = f"Median over {what}"
    what = f"{what[0].upper()}{what[1:]}"
    own = "" if table.own_window else " (not the experiment's own window)"
    weighted = any(levels.is_weighted for levels in table.kinds)
    mean = "weighted mean" if weighted else "mean"
    if table.description.spread == "tasks":
        sentences = [
            f"{what} of the median seed{own} for each level, then the {mean} over the levels of a "
            f"kind, ± standard error across these levels (tasks)."
        ]
    else:
        sentences = [
            f"{what} of the median seed{own}, ± median absolute deviation across seeds (unscaled)."
        ]
        if any(len(levels.weights) > 1 for levels in table.kinds):
            sentences.append(f"The score of several levels is their {mean}.")
    if weighted:
        sentences.append(f"In a {PLAIN_MEAN} all levels have the same weight.")
    if table.is_capped:
        sentences.append(
            "Capped: each level counts as at most 1, the score of a human, before the mean, as is "
            "the convention on DMLab-30 (Espeholt et al. 2018)."
        )
    return sentences
