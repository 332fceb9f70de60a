"""What every score is taken by: kinds of levels, and baselines.

Baselines are policies that do not learn, whose scores tables show below those of agents.
`BASELINES` is the only list of them: a `zipf.envs.Family` states the score of each, and run.json,
tables, captions, plots and report.csv have those that are known.
"""

from __future__ import annotations

from dataclasses import dataclass

PAPER_KINDS = ("train", "uniform", "rare")
"""What levels are for: to train on (Zipfian), and to test on, uniformly and on the rarest fifth.
Every split has these."""

KINDS = (*PAPER_KINDS, "validation", "fresh")
"""A split may also have levels to choose on (the middle fifth of the ranks, uniformly), and levels
whose situations nobody trains on, reported and never chosen on."""


@dataclass(frozen=True)
class Baseline:
    """A policy that does not learn.

    Attributes:
        name: in `Family.baselines`, in run.json, and of its column of report.csv.
        title: in tables.
        meaning: what it does, for captions: a sentence without its subject, verb and full stop.
    """

    name: str
    title: str
    meaning: str


BASELINES = (
    Baseline("chance", "Chance", "uniformly random actions"),
    Baseline(
        "blind",
        "Blind",
        "the best known policy that is not told what an episode asks for: scripts that guess it, "
        "and actions played without a look",
    ),
    Baseline(
        "generalist",
        "Generalist",
        "a scripted policy that acts only on what it has seen in the episode, and knows no map",
    ),
    Baseline(
        "expert",
        "Expert",
        "a scripted policy that reads the whole state of the env",
    ),
)
"""All baselines, in the order of tables."""

BASELINE_NAMES = tuple(baseline.name for baseline in BASELINES)


def says_little(blind: float | None, expert: float | None) -> bool:
    """Whether a level says little about reading and looking: a policy that does neither has more
    than half of the expert's score. False where one of the two is not known."""
    return blind is not None and expert is not None and blind > expert / 2
