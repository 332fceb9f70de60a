"""Statistics of tables and figures: functions of numbers, with no notion of runs.

Those of a few seeds have their uncertainty (Agarwal et al. 2021, "Deep reinforcement learning at
the edge of the statistical precipice", NeurIPS): scores are a matrix [seeds, levels], and an
interval is the percentile interval of a stratified bootstrap, which draws seeds with replacement
for each level by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Z_95 = 1.959964  # 97.5 % quantile of the normal distribution


def median_absolute_deviation(values: pd.Series) -> float:
    """Median distance from the median, unscaled; NaN for fewer than two values.

    Without the factor 1.4826 that would make it estimate a standard deviation: the paper says
    "median absolute deviation" and names no factor.
    """
    return float((values - values.median()).abs().median()) if len(values) > 1 else float("nan")


def weighted_mean(values: ArrayLike, weights: ArrayLike) -> float:
    """The mean of `values` [n] in proportion to `weights` [n], which are positive."""
    return float(np.average(np.asarray(values, float), weights=np.asarray(weights, float)))


def standard_error(values: ArrayLike, weights: ArrayLike) -> float:
    """Standard error of the weighted mean of `values` [n]; NaN for fewer than two.

    With w_i = weights_i / sum(weights) and m the weighted mean:

        sqrt(n / (n - 1) * sum(w_i^2 * (values_i - m)^2))

    (Cochran's approximation in the form of Gatz and Smith 1995, Atmospheric Environment 29(11),
    for weights that are no estimates). With equal weights this is the usual sd / sqrt(n).
    """
    x, w = np.asarray(values, float), np.asarray(weights, float)
    if len(x) < 2:
        return float("nan")
    w = w / w.sum()
    deviations = w * (x - weighted_mean(x, w))
    return float(np.sqrt(len(x) / (len(x) - 1) * np.sum(deviations**2)))


def wilson_interval(successes: Any, episodes: Any) -> tuple[Any, Any]:
    """95 % interval of a success rate (Wilson 1927, without continuity correction); of numbers, or
    of series of them."""
    rate = successes / episodes
    centre = (rate + Z_95**2 / (2 * episodes)) / (1 + Z_95**2 / episodes)
    half = (
        Z_95
        / (1 + Z_95**2 / episodes)
        * np.sqrt(rate * (1 - rate) / episodes + Z_95**2 / (4 * episodes**2))
    )
    return np.maximum(centre - half, 0), np.minimum(centre + half, 1)


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
    Raises ValueError: fewer than two seeds.
    """
    return bootstrap(_middle, [*scores.T])


def improvement(scores: NDArray[np.float64], others: NDArray[np.float64]) -> Interval:
    """The probability that a seed of `scores` [seeds, levels] is better than one of `others` [other
    seeds, levels] on a level drawn at random; a tie counts half.
    Raises ValueError: fewer than two seeds of either."""
    return bootstrap(_better, [*scores.T, *others.T])


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


def bootstrap(
    statistic: Callable[..., NDArray[np.float64]], samples: list[NDArray[np.float64]]
) -> Interval:
    """A statistic of several samples [n], a function of arrays along `axis`, and its percentile
    interval; the same for the same numbers. Raises ValueError: fewer than two of a sample."""
    if min(len(sample) for sample in samples) < FEWEST_SEEDS:
        raise ValueError(f"an interval needs {FEWEST_SEEDS} seeds")
    drawn: Any = stats.bootstrap(
        samples,
        statistic,
        n_resamples=RESAMPLES,
        # Ours: megabytes, where a sample has many episodes. Of several it would change the draws.
        batch=100 if len(samples) == 1 else None,
        method="percentile",
        vectorized=True,
        axis=-1,
        rng=np.random.default_rng(SEED),
    )
    ends = drawn.confidence_interval
    return Interval(float(statistic(*samples, axis=-1)), float(ends.low), float(ends.high))
