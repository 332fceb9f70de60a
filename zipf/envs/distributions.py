"""The distributions a situation is drawn from, as probability vectors over frequency ranks."""

import difflib
import math
from collections.abc import Callable
from numbers import Real

import numpy as np
from numpy.typing import NDArray

Distribution = Callable[[int], NDArray[np.float64]]


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
    if not isinstance(exponent, Real) or not math.isfinite(exponent) or exponent < 0:
        raise ValueError(f"the exponent of Zipf's law must be finite and >= 0, got {exponent}")
    with np.errstate(over="ignore"):  # 1 / inf is the 0 that is meant
        weights = 1.0 / np.arange(1, n + 1, dtype=np.float64) ** exponent
    return weights / weights.sum()


def uniform(n: int) -> NDArray[np.float64]:
    """Every rank is equally likely. Returns float64 [n]; raises `ValueError` if `n < 1`."""
    _check_size(n)
    return np.full(n, 1.0 / n)


def rare(n: int) -> NDArray[np.float64]:
    """Uniform over the rarest fifth, the last `n // 5` ranks.

    Returns:
        float64 [n], zero but for the last `n // 5` entries.

    Raises:
        ValueError: if `n < 5`, where the rarest fifth is empty.
    """
    _check_size(n)
    size = n // 5
    if size == 0:
        raise ValueError(f"the rarest fifth of {n} is empty: the rare distribution needs n >= 5")
    probabilities = np.zeros(n)
    probabilities[-size:] = 1.0 / size
    return probabilities


def by_name(name: str) -> Distribution:
    """The distribution a level is named after, as a function of the number of ranks.

    Args:
        name: `uniform`, `rare` (or `uniform_rare`, its name in the paper), or `zipf_<exponent>`
            with an exponent >= 0 such as `zipf_2` or `zipf_1.5`.

    Raises:
        ValueError: if the name is none of these.
    """
    if name == "uniform":
        return uniform
    if name in ("rare", "uniform_rare"):
        return rare
    if name.startswith("zipf_"):
        try:
            exponent = float(name.removeprefix("zipf_"))
        except ValueError:
            pass
        else:
            zipfian(1, exponent)  # refuses a bad exponent now rather than at the first draw
            return lambda n: zipfian(n, exponent)
    nearest = difflib.get_close_matches(name, ["zipf_2", "uniform", "rare", "uniform_rare"], n=2)
    hint = f" (did you mean {' or '.join(map(repr, nearest))}?)" if nearest else ""
    raise ValueError(
        f"unknown level {name!r}{hint}: expected 'zipf_<exponent>' with an exponent >= 0, "
        "'uniform' or 'rare'"
    )


def _check_size(n: int) -> None:
    if n < 1:
        raise ValueError(f"a distribution needs at least one rank, got n = {n}")
