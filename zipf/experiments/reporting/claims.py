"""What the paper claims, and whether scores bear it out.

`claims.json` beside this file has every claim with the checks that it comes down to, each of one
experiment. A check is one of three forms:

- `score`: a score, or how it compares to another, lies between bounds;
- `curves`: two learning curves differ by so little on average;
- `window` and `effort`: the scores were taken as the protocol says.

The bounds are ours, as the paper states effects and no bounds; the note of a claim says how they
were chosen.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from importlib import resources
from typing import Annotated, Literal

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, model_validator

from zipf.experiments.records.wording import NONE, PROTOCOL_SEEDS, count_text, updates_text

Outcome = Literal["holds", "fails", "not enough data"]
Measure = Literal["value", "difference", "change", "share"]
Place = tuple[str, str]  # a condition and a column: a level kind, or a group of levels
MEASURES: Mapping[Measure, str] = {
    "value": "",
    "difference": "difference",
    "change": "relative change",
    "share": "share of the improvement",
}
EVERY = "*"  # every condition for which the paper has a row


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    experiment: str


class ScoreCheck(_Form):
    """A score lies between `at_least` and `at_most`, where they are given; both included.

    Attributes:
        measure: what is between the bounds. With the scores s of `score`, a of `against` and b of
            `base`: "value", s; "difference", s - a; "change", s / a - 1; "share",
            (s - b) / (a - b), what s has of a's improvement on b.
        score: of which condition, and which column. A condition may be a pattern (`r2d2,*`), or `*`
            for every row of the paper: then the check is made for each.
        against: where its condition is `*`, the same as that of `score`.
        without: conditions that `*` leaves out.
    """

    form: Literal["score"]
    measure: Measure
    score: Place
    against: Place | None = None
    base: Place | None = None
    at_least: float = -math.inf
    at_most: float = math.inf
    without: tuple[str, ...] = Field((), alias="except")

    @model_validator(mode="after")
    def _is_complete(self) -> ScoreCheck:
        if (self.against is None) != (self.measure == "value"):
            raise ValueError(f"against: not as the measure {self.measure} needs it")
        if (self.base is None) != (self.measure != "share"):
            raise ValueError(f"base: not as the measure {self.measure} needs it")
        return self


class CurvesCheck(_Form):
    """The median learning curves of two conditions differ by at most so much: the mean absolute
    difference of the scores at updates at which both were evaluated, but for update 0."""

    form: Literal["curves"]
    conditions: tuple[str, str]
    column: str
    at_most: float


class WindowCheck(_Form):
    """Scores are taken from this window, in updates."""

    form: Literal["window"]
    window: tuple[int, int]


class EffortCheck(_Form):
    """Every score of every row has at least so many seeds and episodes."""

    form: Literal["effort"]
    seeds: int
    episodes: int


Check = Annotated[ScoreCheck | CurvesCheck | WindowCheck | EffortCheck, Field(discriminator="form")]


class Claim(BaseModel):
    """What the paper claims.

    Attributes:
        id: unique.
        source: where the paper does.
        note: how the bounds were chosen.
        unchecked: why there are no checks; None where there are some.
        checks: all of an experiment have to hold.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: str
    statement: str
    source: str
    note: str | None = None
    unchecked: str | None = None
    checks: tuple[Check, ...]


LEARNED = 0.05
"""How far above chance a score is, at least, that tells something about an agent; ours: what the
checks take for "the same"."""

ROUNDING = 1e-9  # sums and quotients of published decimals are off by their rounding


@dataclass(frozen=True)
class Measured:
    """A score.

    Attributes:
        seeds, episodes: over how many it is known; episodes are the fewest of an evaluation.
        chance: what random actions score there; NaN where that is not known.
        by_seed: the score of each seed; empty where they are not known.
    """

    score: float
    seeds: int
    episodes: int
    chance: float = math.nan
    by_seed: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Results:
    """What is known of an experiment.

    Attributes:
        scores: by condition and column.
        every: the conditions that `*` means.
        titles: of conditions.
        window: from which the scores are, in updates; None for another kind of window.
        curves: by condition and column, the median score over seeds by update, and how many seeds.
    """

    scores: Mapping[Place, Measured]
    every: Sequence[str]
    titles: Mapping[str, str] = field(default_factory=dict)
    window: tuple[int, int] | None = None
    curves: Mapping[Place, tuple[pd.Series, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """The outcome of a check.

    Attributes:
        bounds: when it would hold.
        numbers: what the outcome rests on, one text each.
        at_hand: whether any score that it needs is known, however few its seeds.
    """

    outcome: Outcome
    bounds: str
    numbers: tuple[str, ...]
    at_hand: bool


@functools.cache
def claims() -> tuple[Claim, ...]:
    """What the paper claims."""
    file = resources.files("zipf.experiments.reporting").joinpath("claims.json")
    return tuple(Claim.model_validate(one) for one in json.loads(file.read_text("utf-8"))["claims"])


def published_window(experiment: str) -> tuple[int, int]:
    """The window, in updates, from which the paper takes the scores of one of its experiments."""
    (window,) = (
        check.window
        for claim in claims()
        for check in claim.checks
        if isinstance(check, WindowCheck) and check.experiment == experiment
    )
    return window


def judge(check: Check, results: Results) -> Verdict:
    """Whether a check holds.

    A score of fewer seeds than the protocol's three is shown and decides nothing. Nor do scores
    that are compared and none of which is `LEARNED` above chance: they are of agents that have not
    learned what the level asks for. A check that is made for every row fails where one row fails
    it, and holds where every row is known and holds.
    """
    match check:
        case ScoreCheck():
            return _judge_scores(check, results)
        case CurvesCheck():
            return _judge_curves(check, results)
        case WindowCheck():
            bounds = f"updates {updates_text(*check.window)}"
            if not any(one.seeds for one in results.scores.values()):
                return Verdict("not enough data", bounds, (), False)
            used = updates_text(*results.window) if results.window else "another kind of window"
            kept = results.window == check.window
            return Verdict("holds" if kept else "fails", bounds, (used,), True)
        case EffortCheck():
            return _judge_effort(check, results)


def together(outcomes: Sequence[Outcome]) -> Outcome:
    """The outcome of several checks that all have to hold."""
    if "fails" in outcomes:
        return "fails"
    return "not enough data" if "not enough data" in outcomes or not outcomes else "holds"


def bounds_text(check: ScoreCheck) -> str:
    """When a check of scores holds: `relative change at least +6 %`."""
    low = _text(check.at_least, check.measure)
    high = _text(check.at_most, check.measure)
    if math.isinf(check.at_most):
        bounds = f"at least {low}"
    elif math.isinf(check.at_least):
        bounds = f"at most {high}"
    else:
        bounds = f"{low} to {high}"
    return f"{MEASURES[check.measure]} {bounds}".strip()


def _judge_scores(check: ScoreCheck, results: Results) -> Verdict:
    condition = check.score[0]
    bounds = bounds_text(check)
    if condition == EVERY:
        chosen = [one for one in results.every if one not in check.without]
        parts = [_judge_row(check, one, results) for one in chosen]
        held = sum(outcome == "holds" for outcome, _ in parts)
        failing = [f"not {text}" for outcome, text in parts if outcome == "fails"]
        few = sum(outcome == "not enough data" and text != "" for outcome, text in parts)
        short = f", {few} undecided" if few else ""
        numbers = (f"{held} of {len(chosen)} rows hold{short}", *failing)
        known = any(text for _, text in parts)
        return Verdict(together([outcome for outcome, _ in parts]), bounds, numbers, known)
    matching = {one for one, _ in results.scores if fnmatchcase(one, condition)}
    parts = [_judge_row(check, one, results) for one in sorted(matching) or [condition]]
    texts = tuple(text for _, text in parts if text)
    return Verdict(together([outcome for outcome, _ in parts]), bounds, texts, bool(texts))


def _judge_row(check: ScoreCheck, condition: str, results: Results) -> tuple[Outcome, str]:
    """The outcome for one condition and the numbers behind it; no text where none is known."""
    places: list[Place] = [(condition, check.score[1])]
    if check.against is not None:
        name, column = check.against
        places.append((condition if name == EVERY else name, column))
    if check.base is not None:
        places.append(check.base)
    known = {place: results.scores[place] for place in places if place in results.scores}
    known = {place: score for place, score in known.items() if score.seeds}
    texts = [
        f"{results.titles.get(place[0], place[0])} {place[1]} {score.score:z.2f}"
        + ("" if score.seeds >= PROTOCOL_SEEDS else f" ({score.seeds}/{PROTOCOL_SEEDS} seeds)")
        for place, score in known.items()
    ]
    text = ", ".join(texts)
    if len(known) < len(places):
        return "not enough data", text
    value = _measure(check.measure, [known[place].score for place in places])
    if check.measure != "value":
        text += f": {_text(value, check.measure)}"
    if math.isnan(value) or any(score.seeds < PROTOCOL_SEEDS for score in known.values()):
        return "not enough data", text
    if check.measure != "value":
        text += _over_seeds(check.measure, places, known)
        if all(score.score < score.chance + LEARNED - ROUNDING for score in known.values()):
            return "not enough data", f"{text}; none is {LEARNED} above chance"
    inside = check.at_least - ROUNDING <= value <= check.at_most + ROUNDING
    return "holds" if inside else "fails", text


def _over_seeds(measure: Measure, places: Sequence[Place], known: Mapping[Place, Measured]) -> str:
    """The least and largest value over all choices of a seed of each condition, in brackets;
    nothing where scores of seeds are not known."""
    conditions = dict.fromkeys(condition for condition, _ in places)
    of_condition = {
        condition: set.intersection(*(set(known[p].by_seed) for p in places if p[0] == condition))
        for condition in conditions
    }
    values = []
    for seeds in itertools.product(*of_condition.values()):
        chosen = dict(zip(conditions, seeds, strict=True))
        values.append(_measure(measure, [known[p].by_seed[chosen[p[0]]] for p in places]))
    if not values or any(map(math.isnan, values)):
        return ""
    return f" (by seed {_text(min(values), measure)} to {_text(max(values), measure)})"


def _measure(measure: Measure, scores: Sequence[float]) -> float:
    """NaN where it would be a fraction of nothing, or of less."""
    if measure == "value":
        return scores[0]
    score, against = scores[:2]
    if measure == "difference":
        return score - against
    if measure == "change":
        return score / against - 1 if against > 0 else math.nan
    improvement = against - scores[2]
    return (score - scores[2]) / improvement if improvement > 0 else math.nan


def _text(value: float, measure: Measure) -> str:
    if math.isnan(value):
        return NONE
    if measure in ("change", "share"):
        return f"{100 * value:{'+' if measure == 'change' else ''}z.0f} %"
    digits = 2 if math.isclose(value, round(value, 2), abs_tol=1e-9) else 3
    return f"{value:{'+' if measure == 'difference' else ''}z.{digits}f}"


def _judge_curves(check: CurvesCheck, results: Results) -> Verdict:
    bounds = f"mean difference at most {check.at_most:g}"
    places = [(condition, check.column) for condition in check.conditions]
    known = [results.curves[place] for place in places if place in results.curves]
    known = [(curve, seeds) for curve, seeds in known if len(curve)]
    if len(known) < 2:
        return Verdict("not enough data", bounds, (), bool(known))
    (first, _), (second, _) = known
    common = first.index.intersection(second.index)
    common = common[common > 0]
    if not len(common):
        return Verdict("not enough data", bounds, ("no update in common",), True)
    value = float((first[common] - second[common]).abs().mean())
    names = " and ".join(results.titles.get(one, one) for one in check.conditions)
    text = f"{names}, {check.column}: {value:.2f} over {len(common)} evaluations"
    fewest = min(seeds for _, seeds in known)
    if fewest < PROTOCOL_SEEDS:
        return Verdict(
            "not enough data", bounds, (f"{text} ({fewest}/{PROTOCOL_SEEDS} seeds)",), True
        )
    return Verdict("holds" if value <= check.at_most else "fails", bounds, (text,), True)


def _judge_effort(check: EffortCheck, results: Results) -> Verdict:
    bounds = f"{check.seeds} seeds, {count_text(check.episodes)} episodes"
    known = [one for one in results.scores.values() if one.seeds]
    if not known:
        return Verdict("not enough data", bounds, (), False)
    seeds, episodes = min(one.seeds for one in known), min(one.episodes for one in known)
    kept = seeds >= check.seeds and episodes >= check.episodes
    fewest = f"fewest: {seeds} seed{'s' if seeds > 1 else ''}, {count_text(episodes)} episodes"
    return Verdict("holds" if kept else "fails", bounds, (fewest,), True)
