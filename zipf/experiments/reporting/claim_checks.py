"""Checks of scores: whether an expression lies within its bounds, and the numbers behind it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Literal

import pandas as pd

from zipf.experiments.records.paper import paper_table
from zipf.experiments.records.wording import NONE, PROTOCOL_SEEDS, count_text, updates_text
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.scores import floor, seed_means
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import UpdateWindow

Outcome = Literal["holds", "fails", "not enough data"]
Place = tuple[str, str]  # a condition and a column
UNDECIDED: Outcome = "not enough data"

LEARNED = 0.05
"""How far above the floor a score is, at least, that tells something about an agent; ours: what the
checks take for "the same"."""

ROUNDING = 1e-9  # sums and quotients of published decimals are off by their rounding


# --- what is known of an experiment ----------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """A score."""

    score: float
    # seeds, episodes: over how many it is known; episodes are the fewest of an evaluation
    seeds: int
    episodes: int
    # what policies score there that are not told what is asked for; NaN where that is not known
    floor: float = math.nan
    # the score of each seed; empty where they are not known
    by_seed: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Results:
    """What is known of an experiment."""

    scores: Mapping[Place, Measured]  # by condition and column
    every: Sequence[str]  # the conditions of which the paper has a row
    titles: Mapping[str, str] = field(default_factory=dict)  # of conditions
    # from which the scores are, in updates; None for another kind of window
    window: tuple[int, int] | None = None
    # by condition and column, the median score over seeds by update, and how many seeds
    curves: Mapping[Place, tuple[pd.Series, int]] = field(default_factory=dict)
    printed: bool = False  # whether these are the paper's own numbers


def results_of(table: ScoreTable) -> Results:
    """What a table knows, without agents from outside the package."""
    rows = [row for row in table.rows if not row.external]
    scores = pd.concat([table.scores, table.group_scores])
    scores = scores[~scores["external"].astype(bool)]
    curves, by_seed = {}, {}
    for row in rows:
        for levels in table.kinds:
            means = [run.mean_scores(levels) for run in row.runs]
            curves[row.condition, levels.level_kind] = _curve(means)
        for levels in (*table.kinds, *table.groups):
            column = levels.name or levels.level_kind
            by_seed[row.condition, column] = seed_means(row, levels, table.window)
    measured = {}
    for line in scores.assign(floor=floor(scores)).to_dict("records"):
        place = line["condition"], line["level"] or line["level_kind"]
        measured[place] = Measured(
            float(line["score"]),
            int(line["seeds"]),
            int(line["episodes"]),
            float(line["floor"]),
            by_seed[place],
        )
    experiment = table.description.paper
    return Results(
        scores=measured,
        every=list(paper_table(experiment).rows) if experiment else [],
        titles={row.condition: row.title for row in rows},
        window=_window(table, rows),
        curves=curves,
    )


def published_results(experiment: str) -> Results:
    """What the paper prints of one of its experiments."""
    rows = paper_table(experiment).rows
    scores = {
        (condition, column): Measured(score.value, PROTOCOL_SEEDS, 0)
        for condition, row in rows.items()
        for column, score in row.items()
    }
    return Results(scores, every=[*rows], printed=True)


def _window(table: ScoreTable, rows: Sequence[Row]) -> tuple[int, int] | None:
    """The updates that scores were taken from, as far as all runs have come; None for another kind
    of window."""
    if not isinstance(table.window, UpdateWindow):
        return None
    reached = [run.updates for row in rows for run in row.runs]
    scored = [updates for updates in reached if updates >= table.window.start]
    return table.window.start, min([table.window.end, *scored])


def _curve(seeds: Sequence[pd.DataFrame]) -> tuple[pd.Series, int]:
    """The median over seeds by update, of the updates with as many seeds as any has, or as the
    protocol asks for; and how many seeds that are."""
    by_update = pd.concat(seeds).groupby("update")["score"]
    counts = by_update.count()
    most = int(counts.max()) if len(counts) else 0
    most = min(most, PROTOCOL_SEEDS)
    return by_update.median()[counts >= most], most


# --- checks ----------------------------------------------------------------------------------

_AT_FLOOR = f"none is {LEARNED} above the floor"


def _none_has_learned(scores: Iterable[Measured]) -> bool:
    """Whether no score is so far above the floor that it tells something."""
    return all(one.score < one.floor + LEARNED - ROUNDING for one in scores)


@dataclass(frozen=True)
class Verdict:
    """The outcome of a check."""

    outcome: Outcome
    bounds: str  # when it would hold
    numbers: tuple[str, ...]  # what the outcome rests on, one text each
    at_hand: bool  # whether any score that it needs is known, however few its seeds


@dataclass(frozen=True)
class Expression:
    """A score, or how it compares to others, and between which bounds it has to lie, both included.

    `t["impala", "rare"] - t["impala", "uniform"] <= -0.005`; `t` is `SCORES`.
    """

    places: tuple[Place, ...]  # of the score s, and of those that it is compared to: a and b
    # "" is s; "difference", s - a; "relative change", s / a - 1;
    # "share of the improvement", (s - b) / (a - b)
    measure: str = ""
    at_least: float = -math.inf
    at_most: float = math.inf
    but: tuple[str, ...] = ()  # conditions that `EVERY` leaves out

    def __sub__(self, other: Expression) -> Expression:
        return Expression(self.places + other.places, DIFFERENCE)

    def __ge__(self, bound: float) -> Expression:
        return replace(self, at_least=bound)

    def __le__(self, bound: float) -> Expression:
        return replace(self, at_most=bound)

    def between(self, low: float, high: float) -> Expression:
        """Both bounds; a chained comparison would keep the second only."""
        return replace(self, at_least=low, at_most=high)

    def without(self, *conditions: str) -> Expression:
        """Not of these conditions."""
        return replace(self, but=conditions)

    def judge(self, results: Results) -> Verdict:
        """Whether it holds.

        A score of fewer seeds than the protocol's three is shown and decides nothing. Nor do scores
        that are compared and none of which is `LEARNED` above the floor, the higher one of chance
        and blind: they are of agents that have not learned what the level asks for. A check of
        several conditions fails where one of them fails it, and holds where every one is known and
        holds.
        """
        condition = self.places[0][0]
        if condition != EVERY:
            chosen = sorted({one for one, _ in results.scores if fnmatchcase(one, condition)})
            parts = [self._judge_row(one, results) for one in chosen or [condition]]
            texts = tuple(text for _, text in parts if text)
            return Verdict(together([one for one, _ in parts]), self.bounds, texts, bool(texts))
        chosen = [one for one in results.every if one not in self.but]
        parts = [self._judge_row(one, results) for one in chosen]
        held = sum(outcome == "holds" for outcome, _ in parts)
        few = sum(outcome == UNDECIDED and text != "" for outcome, text in parts)
        failing = [f"not {text}" for outcome, text in parts if outcome == "fails"]
        short = f", {few} undecided" if few else ""
        numbers = (f"{held} of {len(chosen)} rows hold{short}", *failing)
        known = any(text for _, text in parts)
        return Verdict(together([one for one, _ in parts]), self.bounds, numbers, known)

    @property
    def bounds(self) -> str:
        """When it holds: `relative change at least +6 %`."""
        low, high = self._text(self.at_least), self._text(self.at_most)
        bounds = f"{low} to {high}"
        if math.isinf(self.at_most):
            bounds = f"at least {low}"
        elif math.isinf(self.at_least):
            bounds = f"at most {high}"
        return f"{self.measure} {bounds}".strip()

    def _judge_row(self, condition: str, results: Results) -> tuple[Outcome, str]:
        """The outcome for one condition and the numbers behind it; no text where none is known."""
        first = self.places[0][0]
        places = [(condition if name == first else name, column) for name, column in self.places]
        known = {place: results.scores[place] for place in places if place in results.scores}
        known = {place: score for place, score in known.items() if score.seeds}
        texts = [
            f"{results.titles.get(place[0], place[0])} {place[1]} {score.score:z.2f}"
            + ("" if score.seeds >= PROTOCOL_SEEDS else f" ({score.seeds}/{PROTOCOL_SEEDS} seeds)")
            for place, score in known.items()
        ]
        text = ", ".join(texts)
        if len(known) < len(places):
            return UNDECIDED, text
        value = self._value([known[place].score for place in places])
        if self.measure:
            text += f": {self._text(value)}"
        if math.isnan(value) or any(score.seeds < PROTOCOL_SEEDS for score in known.values()):
            return UNDECIDED, text
        if self.measure:
            text += self._over_seeds(places, known)
            if _none_has_learned(known.values()):
                return UNDECIDED, f"{text}; {_AT_FLOOR}"
        inside = self.at_least - ROUNDING <= value <= self.at_most + ROUNDING
        return "holds" if inside else "fails", text

    def _over_seeds(self, places: Sequence[Place], known: Mapping[Place, Measured]) -> str:
        """The least and largest value over all choices of a seed of each condition, in brackets;
        nothing where scores of seeds are not known."""
        of_condition = {
            condition: set.intersection(*({*known[p].by_seed} for p in places if p[0] == condition))
            for condition, _ in places
        }
        values = []
        for seeds in itertools.product(*of_condition.values()):
            chosen = dict(zip(of_condition, seeds, strict=True))
            values.append(self._value([known[p].by_seed[chosen[p[0]]] for p in places]))
        if not values or any(map(math.isnan, values)):
            return ""
        return f" (by seed {self._text(min(values))} to {self._text(max(values))})"

    def _value(self, scores: Sequence[float]) -> float:
        """NaN where it would be a fraction of nothing, or of less."""
        score, *others = scores
        if self.measure == DIFFERENCE:
            return score - others[0]
        if self.measure == CHANGE:
            return score / others[0] - 1 if others[0] > 0 else math.nan
        if self.measure == SHARE:
            improvement = others[0] - others[1]
            return (score - others[1]) / improvement if improvement > 0 else math.nan
        return score

    def _text(self, value: float) -> str:
        if math.isnan(value):
            return NONE
        if self.measure in (CHANGE, SHARE):
            return f"{100 * value:{'+' if self.measure == CHANGE else ''}z.0f} %"
        digits = 2 if math.isclose(value, round(value, 2), abs_tol=1e-9) else 3
        return f"{value:{'+' if self.measure else ''}z.{digits}f}"


DIFFERENCE, CHANGE, SHARE = "difference", "relative change", "share of the improvement"
EVERY = "*"  # every condition of which the paper has a row


class _Scores:
    def __getitem__(self, place: Place) -> Expression:
        return Expression((place,))


SCORES = _Scores()
"""`SCORES[condition, column]` is a score. A condition may be a pattern (`r2d2,*`), as `fnmatch` has
it, or `EVERY`: then the check is made for each, with the same condition wherever it stands again.
"""


def change(score: Expression, against: Expression) -> Expression:
    """`score / against - 1`."""
    return Expression(score.places + against.places, CHANGE)


def share(score: Expression, against: Expression, base: Expression) -> Expression:
    """What `score` has of the improvement of `against` on `base`."""
    return Expression(score.places + against.places + base.places, SHARE)


@dataclass(frozen=True)
class CurvesCheck:
    """The median learning curves of two conditions differ by at most so much: the mean absolute
    difference of the scores at updates at which both were evaluated, but for update 0."""

    conditions: tuple[str, str]
    column: str
    at_most: float

    def judge(self, results: Results) -> Verdict:
        """Whether it holds."""
        bounds = f"mean difference at most {self.at_most:g}"
        places = [(condition, self.column) for condition in self.conditions]
        known = [results.curves[place] for place in places if place in results.curves]
        known = [(curve, seeds) for curve, seeds in known if len(curve)]
        if len(known) < 2:
            return Verdict(UNDECIDED, bounds, (), bool(known))
        (first, _), (second, _) = known
        common = first.index.intersection(second.index)
        common = common[common > 0]
        if not len(common):
            return Verdict(UNDECIDED, bounds, ("no update in common",), True)
        value = float((first[common] - second[common]).abs().mean())
        names = " and ".join(results.titles.get(one, one) for one in self.conditions)
        text = f"{names}, {self.column}: {value:.2f} over {len(common)} evaluations"
        fewest = min(seeds for _, seeds in known)
        if fewest < PROTOCOL_SEEDS:
            text = f"{text} ({fewest}/{PROTOCOL_SEEDS} seeds)"
            return Verdict(UNDECIDED, bounds, (text,), True)
        scores = [results.scores[place] for place in places if place in results.scores]
        if scores and _none_has_learned(scores):
            return Verdict(UNDECIDED, bounds, (f"{text}; {_AT_FLOOR}",), True)
        return Verdict("holds" if value <= self.at_most else "fails", bounds, (text,), True)


@dataclass(frozen=True)
class WindowCheck:
    """Scores are taken from this window, in updates."""

    window: tuple[int, int]

    def judge(self, results: Results) -> Verdict:
        """Whether it holds."""
        bounds = f"updates {updates_text(*self.window)}"
        if results.printed or not any(one.seeds for one in results.scores.values()):
            return Verdict(UNDECIDED, bounds, (), False)
        used = updates_text(*results.window) if results.window else "another kind of window"
        kept = results.window == self.window
        return Verdict("holds" if kept else "fails", bounds, (used,), True)


@dataclass(frozen=True)
class EffortCheck:
    """Every score of every row has at least so many seeds and episodes."""

    seeds: int
    episodes: int

    def judge(self, results: Results) -> Verdict:
        """Whether it holds."""
        bounds = f"{self.seeds} seeds, {count_text(self.episodes)} episodes"
        known = [one for one in results.scores.values() if one.seeds]
        if results.printed or not known:
            return Verdict(UNDECIDED, bounds, (), False)
        seeds, episodes = min(one.seeds for one in known), min(one.episodes for one in known)
        kept = seeds >= self.seeds and episodes >= self.episodes
        fewest = f"fewest: {seeds} seed{'s' if seeds > 1 else ''}, {count_text(episodes)} episodes"
        return Verdict("holds" if kept else "fails", bounds, (fewest,), True)


Check = Expression | CurvesCheck | WindowCheck | EffortCheck


def together(outcomes: Sequence[Outcome]) -> Outcome:
    """The outcome of several checks that all have to hold."""
    if "fails" in outcomes:
        return "fails"
    return UNDECIDED if UNDECIDED in outcomes or not outcomes else "holds"
