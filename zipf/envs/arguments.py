"""Checks of arguments that the worlds have in common."""

import difflib
import operator
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np


def whole(name: str, value: Any, least: int, most: int | None = None, *, given: Any = None) -> int:
    """An argument that has to be a whole number, as an int.

    Args:
        given: what the message shows, where the number is part of something.

    Raises:
        ValueError: it is none, or not in `least .. most`.
    """
    got = repr(value) if given is None else repr(given)
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise ValueError(f"{name} must be a whole number, got {got}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {got}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be at most {most}, got {got}")
    return int(value)


def pair(name: str, value: Any, most: int | None = None) -> tuple[int, int]:
    """An argument that has to be (rows, columns), whole numbers from 1 on.

    Raises:
        ValueError: it is something else, or one is above `most`.
    """
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ValueError(f"{name} must be (rows, columns), got {value!r}")
    rows, columns = (whole(name, number, 1, most, given=value) for number in value)
    return rows, columns


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """An argument that has to be a mapping; an empty one for None.

    Raises:
        ValueError: it is something else.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping, got {value!r}")
    return value


def own_engine(family: str) -> Callable[[Any], Any]:
    """A check of the option `backend`, which had other values than "own" before the original
    engines became a plugin: `family` of `examples/original_engines`. It returns its argument.

    Raises:
        ValueError: it is not "own".
    """

    def check(backend: Any) -> Any:
        if backend != "own":
            raise ValueError(
                f"backend must be 'own', got {backend!r}: the original engine is the family "
                f"{family} of examples/original_engines"
            )
        return backend

    return check


def unknown(kind: str, name: str, known: Iterable[str]) -> ValueError:
    """The error for a name that there is not: says the nearest of the known ones, and all."""
    known = list(known)
    nearest = difflib.get_close_matches(name, known, n=2, cutoff=0.4)
    hint = f" (did you mean {' or '.join(map(repr, nearest))}?)" if nearest else ""
    return ValueError(f"unknown {kind} {name!r}{hint}: expected one of {', '.join(known)}")


def reset_options(value: Any, known: Collection[str]) -> Mapping[str, Any]:
    """The options of `reset`, which may have these names; an empty mapping for None.

    Raises:
        ValueError: it is no mapping, or has other names.
    """
    options = mapping("options", value)
    if unknown := options.keys() - set(known):
        raise ValueError(
            f"unknown reset options {sorted(map(str, unknown))}: expected {list(known)}"
        )
    return options


def single_action(action: Any, count: int) -> int:
    """The action of one world as an int; whether it is in range is not checked.

    Args:
        count: how many actions there are, for the message.

    Raises:
        TypeError: it is no integer.
    """
    try:
        return operator.index(action)
    except TypeError:
        raise TypeError(
            f"the action must be an integer in 0 .. {count - 1}, got {action!r}"
        ) from None
