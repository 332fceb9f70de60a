"""The benchmark: levels in which a task is drawn at every reset, and the splits made of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs import distributions
from zipf.envs.arguments import unknown
from zipf.envs.baselines import BaselineScore, measured
from zipf.envs.labyrinth.levels import LEVELS, by_name
from zipf.envs.splits import Normalisation, Split, SplitLevel
from zipf.protocol import PAPER_KINDS

if TYPE_CHECKING:
    from zipf.envs.vector import ZipfVectorEnv

MIXTURES: dict[str, tuple[str, str]] = {
    "forward_zipf": ("forward", "zipf_1"),
    "reversed_zipf": ("reversed", "zipf_1"),
    "uniform": ("forward", "uniform"),
    "forward_rare": ("forward", "rare"),
    "reversed_rare": ("reversed", "rare"),
    "forward_validation": ("forward", "validation"),
    "reversed_validation": ("reversed", "validation"),
}
"""Levels that draw a task at every reset: the order of the tasks, most frequent first, and the
distribution over it. `zipf<exponent>` is a further one for every exponent, in forward order."""
_RELEASED = {"uniform_rare": "forward_rare"}
"""What the released wrapper calls a level; its `zipf1` is one of `zipf<exponent>`."""


_ZIPF = re.compile(r"zipf_?([0-9]+(?:\.[0-9]+)?)")  # float() would take "1_5" and "1e400", too
_KNOWN = (*MIXTURES, "zipf<exponent>", *LEVELS)


def law(name: str) -> tuple[str, NDArray[np.float64]] | None:
    """The order of a level that draws tasks, and the probability of every rank; None for a task.
    The level's name may have `labyrinth/` before it. Raises ValueError: there is no such level."""
    if not isinstance(name, str):
        raise ValueError(f"level must be a name, got {name!r}: expected one of {', '.join(_KNOWN)}")
    name = name.removeprefix("labyrinth/")
    name = _RELEASED.get(name, name)
    if name in MIXTURES:
        order, distribution = MIXTURES[name]
    elif zipf := _ZIPF.fullmatch(name):
        order, distribution = "forward", f"zipf_{zipf[1]}"
    else:
        try:
            by_name(name)
        except ValueError:
            raise unknown("level", name, _KNOWN) from None
        return None
    try:
        return order, distributions.by_name(distribution)(len(LEVELS))
    except ValueError:
        raise unknown("level", name, _KNOWN) from None


def make_vec(
    num_envs: int, level: str = "explore_goal_locations_small", **options: Any
) -> ZipfVectorEnv:
    """`num_envs` envs of a level, with or without `labyrinth/` before it: of one task, or of tasks
    drawn at every reset. The options are those of `LabyrinthVectorEnv`, which all tasks have.
    Raises ValueError for an unknown level, or options out of range.
    """
    from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
    from zipf.envs.mixture import Mixture

    drawn = law(level)
    if drawn is None:
        return LabyrinthVectorEnv(num_envs, level, **options)
    order, probabilities = drawn
    # A mixture has arguments, such as `exponent`, that are no options of the tasks.
    common = ("autoreset_mode", "copy", "render_mode")
    of_mixture = {name: options.pop(name) for name in common if name in options}
    tasks = {
        f"labyrinth/{name}": partial(LabyrinthVectorEnv, level=name, **options) for name in LEVELS
    }
    return Mixture(
        tasks, num_envs, draw="resets", probabilities=probabilities, order=order, **of_mixture
    )


def mean_of_tasks(name: str) -> Callable[..., BaselineScore | None]:
    """A baseline, as `zipf.envs.baselines.measured` has it of the tasks; of a level that draws
    them their mean, with the score of each by the rank. Blind is never below chance."""
    known_as = ("blind", "chance") if name == "blind" else (name,)
    known_of = [measured("zipf.envs.labyrinth", one) for one in known_as]

    def measured_of(task: str, **options: Any) -> BaselineScore | None:
        found = [score for one in known_of if (score := one(task, **options)) is not None]
        if len(found) < len(known_of):
            return None
        return max(found, key=lambda one: one.score)

    def baseline(level: str, **options: Any) -> BaselineScore | None:
        drawn = law(level)
        if drawn is None:
            return measured_of(by_name(level).name, **options)
        order, probabilities = drawn
        of_tasks = [measured_of(task, **options) for task in _tasks(order)]
        known = [one for one in of_tasks if one is not None]
        if len(known) < len(of_tasks):
            return None
        scores = tuple(one.score for one in known)
        episodes = sum(one.episodes or 0 for one in known)
        errors = probabilities * [one.error or 0.0 for one in known]
        return BaselineScore(
            float(np.dot(probabilities, scores)),
            episodes,
            {"level": scores},
            float(np.linalg.norm(errors)),
        )

    return baseline


def _tasks(order: str) -> list[str]:
    return list(LEVELS)[:: -1 if order == "reversed" else 1]


EPISODES = 100
"""Default number of episodes of each task in an evaluation; the paper has 1000.

Over all tasks they take 6 million steps at most. The standard error that this number leaves, by the
returns of random actions and of the scripted experts in `baselines.json`, is 0.002 to 0.006 for
the uniform score, 0.002 to 0.016 for the rare one and 0.005 to 0.008 for the Zipf-weighted one, in
units of human scores; for a single task's score it is 0.008 to 0.023 on average, and at most 0.08.
"""


def _normalised(task: str, weight: float = 1.0) -> SplitLevel:
    normalisation = Normalisation(LEVELS[task].random, LEVELS[task].human)
    return SplitLevel(f"labyrinth/{task}", weight, normalisation=normalisation)


def _split(name: str, order: str, trained: str = "zipf_1", paper: str | None = None) -> Split:
    names = _tasks(order)

    def weighted(distribution: str) -> tuple[SplitLevel, ...]:
        probabilities = distributions.by_name(distribution)(len(names))
        return tuple(
            _normalised(task, float(p))
            for task, p in zip(names, probabilities, strict=True)
            if p > 0
        )

    return Split(
        name,
        weighted(trained),
        weighted("uniform"),
        weighted("rare"),
        draw="resets",
        episodes=dict.fromkeys(PAPER_KINDS, EPISODES),
        spread="tasks",
        paper=paper,
        validation=weighted("validation"),
    )


PAIR = ("rooms_collect_good_objects_train", "explore_object_locations_small")
"""The tasks of the split `labyrinth_pair`."""

SPLITS = (
    _split("labyrinth_forward", "forward", paper="labyrinth_forward"),
    _split("labyrinth_reversed", "reversed", paper="labyrinth_reversed"),
    _split("labyrinth_uniform", "forward", "uniform"),  # ours: uniform training, to compare with
    *(Split(f"labyrinth_{task}", _normalised(task)) for task in LEVELS),  # ours: one task alone
    # Ours: two tasks that are learned alone, each in half of the environments.
    Split("labyrinth_pair", tuple(_normalised(task) for task in PAIR)),
)
"""Human-normalised scores of the tasks, averaged by their weights: Zipf's law in training (the
third trains evenly), evenly over all tasks, over the rarest fifth, and over the middle fifth. Then
a split for each task, which trains on it alone and has no other levels, and one for two of them."""
