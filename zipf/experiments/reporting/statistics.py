"""Statistics of tables and figures: functions of numbers, with no notion of runs."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

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


def wilson_interval(successes: pd.Series, episodes: pd.Series) -> tuple[pd.Series, pd.Series]:
    """95 % interval of a success rate (Wilson 1927, without continuity correction)."""
    rate = successes / episodes
    centre = (rate + Z_95**2 / (2 * episodes)) / (1 + Z_95**2 / episodes)
    half = (
        Z_95
        / (1 + Z_95**2 / episodes)
        * np.sqrt(rate * (1 - rate) / episodes + Z_95**2 / (4 * episodes**2))
    )
    return (centre - half).clip(lower=0), (centre + half).clip(upper=1)
