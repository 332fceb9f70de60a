"""The distributions a situation is drawn from, as probability vectors over frequency ranks."""

import difflib
import math
import re
from collections.abc import Callable
from numbers import Real

import numpy as np
from numpy.typing import NDArray

Distribution = Callable[[int], NDArray[np.float64]]

_LAW = re.compile(r"zipf_((0|[1-9][0-9]*)(\.[0-9]+)?)")
"""Exponents as people write them. Python's `float` also reads `1_5`, as fifteen."""


def zipfian(n: int, exponent: float) -> NDArray[np.float64]:
    """Zipf's law: `p(rank) ~ 1 / (rank + 1) ** exponent`.

    Args:
        n: how many ranks, at least 1.
        exponent: the skew, finite and >= 0; 0 is the uniform distribution.

    Returns:
        float64 [n], decreasing, summing to 1.

    Raises:
        ValueError: for an `n` or `exponent` outside these bounds.
    """
    _check_size(n)
    number = isinstance(exponent, Real) and not isinstance(exponent, bool)
    try:
        skew = float(exponent) if number else math.nan
    except OverflowError:
        skew = math.inf
    if not math.isfinite(skew) or skew < 0:
        raise ValueError(f"the exponent of Zipf's law must be finite and >= 0, got {exponent!r}")
    with np.errstate(over="ignore"):  # 1 / inf is the 0 that is meant
        weights = 1.0 / np.arange(1, n + 1, dtype=np.float64) ** skew
    return weights / weights.sum()


def uniform(n: int) -> NDArray[np.float64]:
    """Every rank is equally likely. Returns float64 [n]; raises `ValueError` for an `n` that is
    no whole number or below 1."""
    _check_size(n)
    return np.full(n, 1.0 / n)


def rare(n: int) -> NDArray[np.float64]:
    """Uniform over the rarest fifth, the last `n // 5` ranks.

    Returns:
        float64 [n], zero but for the last `n // 5` entries.

    Raises:
        ValueError: if `n < 5`, where the rarest fifth is empty.
    """
    return _fifth(n, "rarest", "rare")


def validation(n: int) -> NDArray[np.float64]:
    """Uniform over the middle fifth, `n // 5` ranks: those to choose agents on.

    Returns:
        float64 [n], zero but for the ranks from `(n - n // 5) // 2` on: 8 to 11 of 20.

    Raises:
        ValueError: if `n < 5`, where the middle fifth is empty.
    """
    return _fifth(n, "middle", "validation")


def _fifth(n: int, which: str, name: str) -> NDArray[np.float64]:
    _check_size(n)
    size = n // 5
    if size == 0:
        raise ValueError(f"the {which} fifth of {n} is empty: the {name} distribution needs n >= 5")
    first = n - size if which == "rarest" else (n - size) // 2
    probabilities = np.zeros(n)
    probabilities[first : first + size] = 1.0 / size
    return probabilities


def by_name(name: str) -> Distribution:
    """The distribution a level is named after, as a function of the number of ranks.

    Args:
        name: `uniform`, `rare` (or `uniform_rare`, its name in the paper), `validation`, or
            `zipf_<exponent>` with an exponent >= 0 such as `zipf_2` or `zipf_1.5`, without sign,
            underscores or powers of ten.

    Raises:
        ValueError: if the name is none of these.
    """
    if not isinstance(name, str):
        raise ValueError(f"a level must be a name such as 'zipf_2', got {name!r}")
    if name == "uniform":
        return uniform
    if name in ("rare", "uniform_rare"):
        return rare
    if name == "validation":
        return validation
    if name.startswith("zipf_"):
        try:
            exponent = float(name.removeprefix("zipf_"))
        except ValueError:
            pass
        else:
            zipfian(1, exponent)  # refuses a bad exponent now rather than at the first draw
            if _LAW.fullmatch(name):
                return lambda n: zipfian(n, exponent)
    known = ["zipf_2", "uniform", "rare", "uniform_rare", "validation"]
    nearest = difflib.get_close_matches(name, known, n=2)
    hint = f" (did you mean {' or '.join(map(repr, nearest))}?)" if nearest else ""
    raise ValueError(
        f"unknown level {name!r}{hint}: expected 'zipf_<exponent>' with an exponent >= 0 such as 2 "
        "or 1.5, 'uniform', 'rare' or 'validation'"
    )


def law_name(exponent: float) -> str:
    """The name of Zipf's law with this exponent, for `by_name`: `zipf_2` for 2.0.

    Raises:
        ValueError: the exponent is not finite and >= 0.
    """
    zipfian(1, exponent)
    return f"zipf_{np.format_float_positional(abs(float(exponent)), trim='-')}"


def usual_name(name: str) -> str:
    """The shortest of a distribution's names: `zipf_2` for `zipf_2.0`, `rare` for `uniform_rare`.

    Names that are not those of a distribution are returned as they are.
    """
    if name == "uniform_rare":
        return "rare"
    written = _LAW.fullmatch(name)
    return law_name(float(written[1])) if written else name


def _check_size(n: int) -> None:
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise ValueError(
            f"a distribution needs at least one rank, a whole number of them, got n = {n!r}"
        )
