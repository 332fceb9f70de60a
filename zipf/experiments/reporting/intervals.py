"""Statistics of a few seeds, with their uncertainty (Agarwal et al. 2021).

"Deep reinforcement learning at the edge of the statistical precipice", NeurIPS. Scores are a matrix
[seeds, levels]. An interval is the percentile interval of a stratified bootstrap: seeds are drawn
with replacement for each level by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

FEWEST_SEEDS = 2  # one has no spread
RESAMPLES = 2000  # of the authors' 50,000: ends of intervals are shown with two decimals
SEED = 0  # the same scores give the same interval


@dataclass(frozen=True)
class Interval:
    """An estimate and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: NDArray[np.float64]) -> Interval:
    """The mean of the middle half of all scores [seeds, levels], every level alike.

    A quarter of the scores, rounded down, is left out at either end: of fewer than four, none is.

    Raises:
        ValueError: fewer than two seeds.
    """
    return _with_interval(_middle, [*scores.T])


def improvement(scores: NDArray[np.float64], others: NDArray[np.float64]) -> Interval:
    """The probability that a seed of `scores` [seeds, levels] is better than one of `others`
    [other seeds, levels] on a level drawn at random; a tie counts half.

    Raises:
        ValueError: fewer than two seeds of either, or not as many levels.
    """
    if scores.shape[1] != others.shape[1]:
        raise ValueError(f"{scores.shape[1]} levels against {others.shape[1]}")
    return _with_interval(_better, [*scores.T, *others.T])


def _middle(*levels: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    return stats.trim_mean(np.concatenate(levels, axis), 0.25, axis)


def _better(*levels: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The first half of `levels` against the second; seeds are on the last axis."""
    assert axis == -1
    half = len(levels) // 2
    of_levels = []
    for mine, theirs in zip(levels[:half], levels[half:], strict=True):
        difference = np.sign(mine[..., :, None] - theirs[..., None, :])
        of_levels.append(0.5 + 0.5 * difference.mean((-2, -1)))
    return np.mean(of_levels, axis=0)


def _with_interval(
    statistic: Callable[..., NDArray[np.float64]], levels: list[NDArray[np.float64]]
) -> Interval:
    if min(len(level) for level in levels) < FEWEST_SEEDS:
        raise ValueError(f"an interval needs {FEWEST_SEEDS} seeds")
    drawn: Any = stats.bootstrap(
        levels,
        statistic,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=True,
        axis=-1,
        rng=np.random.default_rng(SEED),
    )
    ends = drawn.confidence_interval
    return Interval(float(statistic(*levels, axis=-1)), float(ends.low), float(ends.high))
