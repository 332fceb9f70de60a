from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zipf.envs import pcg64
from zipf.envs.distributions import (
    by_name,
    law_name,
    rare,
    uniform,
    usual_name,
    validation,
    zipfian,
)


def test_zipfian_follows_the_law() -> None:
    p = zipfian(4, 2)
    np.testing.assert_allclose(p / p[0], [1, 1 / 4, 1 / 9, 1 / 16])
    np.testing.assert_array_equal(zipfian(7, 0), uniform(7))


def test_rare_is_the_last_fifth() -> None:
    np.testing.assert_array_equal(np.flatnonzero(rare(20)), [16, 17, 18, 19])
    np.testing.assert_array_equal(np.flatnonzero(rare(9)), [8])


@pytest.mark.parametrize(
    ("n", "first", "last"), [(20, 8, 11), (50, 20, 29), (30, 12, 17), (5, 2, 2)]
)
def test_validation_is_the_middle_fifth(n: int, first: int, last: int) -> None:
    assert np.flatnonzero(validation(n)).tolist() == list(range(first, last + 1))


@given(n=st.integers(5, 200), exponent=st.floats(0, 1e6))
def test_distributions_are_probabilities(n: int, exponent: float) -> None:
    for p in (zipfian(n, exponent), uniform(n), rare(n), validation(n)):
        assert p.dtype == np.float64
        assert p.shape == (n,)
        assert (p >= 0).all()
        assert p.sum() == pytest.approx(1)


@pytest.mark.parametrize("exponent", [-0.1, float("nan"), float("inf"), 10**400, None, "2", True])
def test_bad_exponents_are_refused(exponent: Any) -> None:
    with pytest.raises(ValueError, match="exponent"):
        zipfian(20, exponent)


def test_exponents_of_other_types_are_numbers() -> None:
    np.testing.assert_array_equal(zipfian(3, Fraction(3, 2)), zipfian(3, 1.5))


def test_empty_distributions_are_refused() -> None:
    for distribution in (uniform, rare, by_name("zipf_2")):
        with pytest.raises(ValueError, match="at least one rank"):
            distribution(0)
        with pytest.raises(ValueError, match="a whole number of them, got n = 2"):
            distribution(2.5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="n >= 5"):
        rare(4)
    with pytest.raises(ValueError, match="middle fifth of 4 is empty"):
        validation(4)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("zipf_2", zipfian(20, 2)),
        ("zipf_0", uniform(20)),
        ("zipf_1.5", zipfian(20, 1.5)),
        ("uniform", uniform(20)),
        ("rare", rare(20)),
        ("uniform_rare", rare(20)),
        ("validation", validation(20)),
    ],
)
def test_distributions_by_name(name: str, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(by_name(name)(20), expected)


ODD = ("1_5", "+2", " 2", "2 ", "02", "2e0", ".5", "2.", "\u0662", "2\n")
"""What Python reads as a number, and nobody means as an exponent."""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("zipf_", "unknown level 'zipf_'"),
        ("zipf_two", "zipf_<exponent>"),
        ("unifrom", "did you mean 'uniform'"),
        ("zipf_-1", "finite and >= 0"),
        ("zipf_nan", "finite and >= 0"),
        ("zipf_inf", "finite and >= 0"),
        *((f"zipf_{one}", "unknown level.*such as 2 or 1.5") for one in ODD),
        ("", "unknown level"),
        (3, "a level must be a name such as 'zipf_2', got 3"),
    ],
)
def test_unknown_names_say_what_would_do(name: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        by_name(name)


@given(exponent=st.floats(0, 1e6))
def test_every_exponent_has_a_name(exponent: float) -> None:
    name = law_name(exponent)
    assert float(name.removeprefix("zipf_")) == exponent
    np.testing.assert_array_equal(by_name(name)(5), zipfian(5, exponent))
    assert usual_name(name) == name


def test_usual_names() -> None:
    names = ("zipf_2.0", "zipf_2", "zipf_1.50", "uniform_rare", "uniform", "zipf_1_5", "a/b")
    usual = ("zipf_2", "zipf_2", "zipf_1.5", "rare", "uniform", "zipf_1_5", "a/b")
    assert tuple(map(usual_name, names)) == usual


@pytest.mark.parametrize("seed", [0, 1, 1234, 2**31, 2**63 + 5])
def test_compiled_streams_are_those_of_numpy(seed: int) -> None:
    stream, rng = pcg64.stream(seed), np.random.default_rng(seed)
    assert [pcg64.next_double(stream) for _ in range(2000)] == rng.random(2000).tolist()


@pytest.mark.parametrize("name", ["zipf_2", "zipf_0.3", "uniform", "rare"])
def test_compiled_choice_is_that_of_numpy(name: str) -> None:
    p = by_name(name)(20)
    stream, rng = pcg64.stream(7), np.random.default_rng(7)
    cumulative = pcg64.cumulative(p)
    drawn = [pcg64.choice(stream, cumulative) for _ in range(500)]
    assert drawn == [rng.choice(20, p=p) for _ in range(500)]


def test_streams_without_a_seed_differ() -> None:
    assert (pcg64.stream(None) != pcg64.stream(None)).any()
