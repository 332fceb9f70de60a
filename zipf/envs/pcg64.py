"""NumPy's default random generator (PCG64) inside numba kernels.

An env's stream is four uint64: state high, state low, increment high, increment low. It gives
the same doubles as `numpy.random.default_rng(seed)`, so that episodes can begin inside a kernel
and still be those of an env that draws with NumPy.

Source: M. E. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms
for Random Number Generation", 2014 (the XSL-RR 128/64 member), as in NumPy.
"""

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled

_LOW_64 = (1 << 64) - 1
_LOW_32 = np.uint64(0xFFFFFFFF)
_MULTIPLIER_HIGH = np.uint64(0x2360ED051FC65DA4)
_MULTIPLIER_LOW = np.uint64(0x4385DF649FCCF645)
_SHIFT_11, _SHIFT_32, _SHIFT_58 = np.uint64(11), np.uint64(32), np.uint64(58)
_SIXTY_FOUR, _SIXTY_THREE = np.uint64(64), np.uint64(63)


def stream(seed: int | None) -> NDArray[np.uint64]:
    """The stream of `numpy.random.default_rng(seed)` at its beginning: uint64 [4].
    `None` takes entropy from the operating system."""
    state = np.random.PCG64(seed).state["state"]
    words = [state["state"] >> 64, state["state"] & _LOW_64, state["inc"] >> 64]
    return np.array([*words, state["inc"] & _LOW_64], dtype=np.uint64)


@compiled()
def next_double(stream):
    """What `Generator.random()` returns next; advances `stream` (uint64 [4]) in place."""
    high, low = stream[0], stream[1]
    low_a, low_b = low & _LOW_32, low >> _SHIFT_32
    factor_a, factor_b = _MULTIPLIER_LOW & _LOW_32, _MULTIPLIER_LOW >> _SHIFT_32
    aa, ab, ba, bb = low_a * factor_a, low_a * factor_b, low_b * factor_a, low_b * factor_b
    middle = (aa >> _SHIFT_32) + (ab & _LOW_32) + (ba & _LOW_32)
    carry = (middle >> _SHIFT_32) + (ab >> _SHIFT_32) + (ba >> _SHIFT_32)
    product_high = bb + carry + high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH
    product_low = low * _MULTIPLIER_LOW
    low = product_low + stream[3]
    high = product_high + stream[2]
    if low < product_low:
        high += np.uint64(1)
    stream[0], stream[1] = high, low
    word = high ^ low
    rotation = high >> _SHIFT_58
    word = (word >> rotation) | (word << ((_SIXTY_FOUR - rotation) & _SIXTY_THREE))
    return np.float64(word >> _SHIFT_11) * (1.0 / 9007199254740992.0)


@compiled()
def between(stream, low, high):
    """A float drawn uniformly from low .. high."""
    return low + (high - low) * next_double(stream)


@compiled()
def below(stream, n):
    """An integer drawn uniformly from 0 .. n - 1."""
    return min(int(next_double(stream) * n), n - 1)


@compiled()
def choice(stream, cumulative):
    """What `Generator.choice(len(p), p=p)` returns next, for `cumulative` = `cumulative(p)`."""
    return np.searchsorted(cumulative, next_double(stream), side="right")


def cumulative(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """The running sum of `probabilities`, closed at exactly 1 as `Generator.choice` does."""
    sums = probabilities.cumsum()
    return sums / sums[-1]
