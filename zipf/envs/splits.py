"""Splits: which levels train and which test a benchmark, and how a level's returns are scored."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from zipf.envs.arguments import mapping, whole
from zipf.protocol import KINDS, PAPER_KINDS

Level = str | Callable[..., Any]
"""A level's full name (`"gridworld/rare"`), or a function that makes a batch of its envs,
called as `make(num_envs, autoreset_mode=..., **options)`."""


@dataclass(frozen=True)
class Normalisation:
    """A return as a fraction of what a human scores above random actions.

    `(return - random) / (human - random)`, at most `cap` where there is one.

    Raises:
        ValueError: `human` and `random` are equal.
    """

    random: float
    human: float
    cap: float | None = None

    def __post_init__(self) -> None:
        if self.random == self.human:
            raise ValueError(f"random and human must differ, both are {self.random}")

    def __call__(self, mean_return: float) -> float:
        score = (mean_return - self.random) / (self.human - self.random)
        return score if self.cap is None else min(score, self.cap)


@dataclass(frozen=True)
class SplitLevel:
    """A level in a split.

    Attributes:
        level: its full name, or a function that makes it.
        weight: its share in the score of its kind and, where levels are drawn at resets, how
            often it is played; relative to the others of its kind.
        options: constructor options of this level alone, on top of those of the whole split.
        normalisation: how its mean return becomes its score; None: the score is the mean return.

    Raises:
        ValueError: the level is neither, the weight not positive and finite, or the options no
            mapping.
    """

    level: Level
    weight: float = 1.0
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    normalisation: Normalisation | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.level, str) or callable(self.level)):
            raise ValueError(
                f"a level must be a name or a function that makes it, got {self.level!r}"
            )
        number = isinstance(self.weight, Real) and not isinstance(self.weight, bool)
        if not (number and np.isfinite(self.weight) and self.weight > 0):
            raise ValueError(f"the weight of {self.name} must be positive, got {self.weight!r}")
        mapping(f"options of {self.name}", self.options)

    @property
    def name(self) -> str:
        """The level's name, in result files and tables."""
        return level_name(self.level)

    def normalised(self, mean_return: float) -> float:
        """The score of a mean return."""
        return mean_return if self.normalisation is None else self.normalisation(mean_return)

    def score(self, returns: ArrayLike) -> float:
        """The score of the returns of episodes [n]."""
        return float(self.normalised(float(np.asarray(returns).mean())))


def level_name(level: Level) -> str:
    """A level's name; of a function its `__qualname__`, or what `str` says without addresses in
    memory, which are others in every process."""
    if isinstance(level, str):
        return level
    name: str | None = getattr(level, "__qualname__", None)
    return name or re.sub(" at 0x[0-9a-fA-F]+", "", str(level))


Levels = Level | SplitLevel | Sequence[Level | SplitLevel]


@dataclass(frozen=True)
class Split:
    """A benchmark: weighted levels to train on and to test on.

    The levels of a kind may be given as a level, a `SplitLevel` or a sequence of these; they are
    kept as tuples of `SplitLevel`.

    Attributes:
        name: unique among all splits.
        train, uniform, rare: the levels of each kind. A split of what has no tail, such as one task
            alone, has train levels and no others.
        validation, fresh: the same of the kinds that not every split has; empty where it has none.
        draw: how envs share several train levels: "worlds": evenly, each env has one level for
            good; "resets": at every reset an env draws its level in proportion to the weights.
        episodes: of each level of a kind, in an evaluation that is not told otherwise; for
            "validation" and "fresh", where they are not named, those of "uniform".
        spread: what the +- of a table is: "seeds": the median absolute deviation across seeds;
            "tasks": the standard error across levels.
        paper: which of the paper's experiments this repeats, a key of `paper_tables.json`, with
            the options' defaults; None: none of them.

    Raises:
        ValueError: there is no train level, a kind has one level twice, or two levels have the
            same name.
    """

    name: str
    train: Any
    uniform: Any = ()
    rare: Any = ()
    draw: Literal["worlds", "resets"] = "worlds"
    episodes: Mapping[str, int] = field(
        default_factory=lambda: dict.fromkeys(PAPER_KINDS, 1000),  # the paper's
        hash=False,
    )
    spread: Literal["seeds", "tasks"] = "seeds"
    paper: str | None = None
    validation: Any = ()
    fresh: Any = ()

    def __post_init__(self) -> None:
        for kind in KINDS:
            levels = split_levels(getattr(self, kind))
            names = [one.name for one in levels]
            if not names and kind == "train":
                raise ValueError(f"split {self.name!r} has no train level")
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"split {self.name!r} has the {kind} level {twice[0]} twice")
            object.__setattr__(self, kind, levels)
        named: dict[str, str] = {}
        for one in self.all_levels:
            if named.setdefault(one.name, str(one.level)) != str(one.level):
                raise ValueError(
                    f"split {self.name!r} has two levels called {one.name}: give their functions "
                    "different names"
                )
        if self.draw not in ("worlds", "resets"):
            raise ValueError(f"draw must be 'worlds' or 'resets', got {self.draw!r}")
        if self.spread not in ("seeds", "tasks"):
            raise ValueError(f"spread must be 'seeds' or 'tasks', got {self.spread!r}")
        given = set(mapping("episodes", self.episodes))
        if not set(PAPER_KINDS) <= given <= set(KINDS):
            raise ValueError(
                f"episodes must have a number for each of {', '.join(PAPER_KINDS)}, and may have "
                f"one for {' and '.join(KINDS[len(PAPER_KINDS) :])}; got {dict(self.episodes)}"
            )
        for kind in given:
            whole(f"episodes[{kind!r}]", self.episodes[kind], 1)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of which there are levels, in the order of `KINDS`."""
        return tuple(kind for kind in KINDS if self.levels(kind))

    @property
    def only_trains(self) -> bool:
        """Whether it has levels to train on and no others."""
        return self.kinds == ("train",)

    def levels(self, kind: str) -> tuple[SplitLevel, ...]:
        """The levels of a kind, of `KINDS`; empty where the split has none."""
        return getattr(self, kind)

    def episodes_of(self, kind: str) -> int:
        """How many episodes of each level of a kind an evaluation plays."""
        return self.episodes.get(kind, self.episodes["uniform"])

    @property
    def all_levels(self) -> tuple[SplitLevel, ...]:
        """The levels of all kinds, in the order of `KINDS`."""
        return tuple(level for kind in KINDS for level in self.levels(kind))


def split_levels(given: Levels) -> tuple[SplitLevel, ...]:
    """One level or several, as a split holds them."""
    levels = given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    return tuple(one if isinstance(one, SplitLevel) else SplitLevel(one) for one in levels)
