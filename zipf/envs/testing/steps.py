"""Assertions that the environment checks share: results of reset and step, and expected errors."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray


def visible(step: Any) -> Any:
    """A copy of a step's result in which rows outside the masks are zero."""
    observation, reward, terminated, truncated, info = copied(step)
    for key, value in info.items():
        mask = info.get(f"_{key}")
        if mask is not None:
            for array in value.values() if isinstance(value, dict) else [value]:
                array[~mask] = 0
    return observation, reward, terminated, truncated, info


def copied(value: Any) -> Any:
    """A copy of nested dictionaries, tuples and lists of arrays; lists become tuples."""
    if isinstance(value, dict):
        return {key: copied(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return tuple(copied(item) for item in value)
    return np.array(value)


def arrays_in(value: Any) -> Iterator[NDArray[Any]]:
    """All arrays in nested dictionaries, tuples and lists."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict | list | tuple):
        for item in value.values() if isinstance(value, dict) else value:
            yield from arrays_in(item)


def stacked(rows: list[Any]) -> Any:
    """Results of single envs, as a batch."""
    if isinstance(rows[0], dict):
        return {key: stacked([row[key] for row in rows]) for key in rows[0]}
    if isinstance(rows[0], tuple):
        return tuple(stacked([row[i] for row in rows]) for i in range(len(rows[0])))
    return np.stack(rows)


def first_step(start: Any) -> Any:
    """What `reset` returned, as the step that an autoreset makes of it."""
    observation, info = start
    return observation, 0.0, False, False, info


def row_of(batch: Any, i: int) -> Any:
    """What a batch's result has for env `i`."""
    if isinstance(batch, dict):
        return {key: row_of(value, i) for key, value in batch.items()}
    if isinstance(batch, tuple):
        return tuple(row_of(value, i) for value in batch)
    return batch[i]


def differences(given: Any, expected: Any, path: str = "") -> Iterator[str]:
    """Where two nested values differ, a line for each place."""
    if isinstance(expected, dict):
        if not isinstance(given, dict) or given.keys() != expected.keys():
            keys = sorted(given) if isinstance(given, dict) else type(given)
            yield f"{path or 'keys'}: {keys}, expected {sorted(expected)}"
            return
        for key in expected:
            yield from differences(given[key], expected[key], f"{path}[{key!r}]")
    elif isinstance(expected, tuple | list):
        if len(given) != len(expected):
            yield f"{path or 'length'}: {len(given)} entries, expected {len(expected)}"
            return
        for i, (one, other) in enumerate(zip(given, expected, strict=True)):
            yield from differences(one, other, f"{path}[{i}]")
    elif isinstance(expected, np.ndarray | np.generic | float | int):
        one, other = np.asarray(given), np.asarray(expected)
        if one.shape != other.shape:
            yield f"{path or 'shape'}: shape {one.shape}, expected {other.shape}"
        elif not np.array_equal(one, other):
            first = tuple(np.argwhere(np.atleast_1d(one != other))[0].tolist())
            at = f" at {first}" if one.shape else ""
            one, other = np.atleast_1d(one), np.atleast_1d(other)
            yield f"{path or 'value'}: {one[first]}{at}, expected {other[first]}"
    elif given != expected:
        yield f"{path or 'value'}: {given}, expected {expected}"


def are_equal(given: Any, expected: Any) -> bool:
    """Whether two nested values have no differences."""
    return next(differences(given, expected), None) is None


def require(condition: Any, message: str) -> None:
    """Raises AssertionError with the message unless the condition holds."""
    # An assert statement would be gone under `python -O`.
    if not condition:
        raise AssertionError(message)


def require_same(given: Any, expected: Any, where: str) -> None:
    """Raises AssertionError with the first difference of two nested values, if there is one."""
    difference = next(differences(given, expected), None)
    require(difference is None, f"{where} differs: {difference}")


def require_dtype(array: Any, dtype: Any, shape: tuple[int, ...], where: str) -> None:
    """Raises AssertionError unless this is an array of this dtype and shape."""
    require(isinstance(array, np.ndarray), f"{where} must be an array, got {type(array)}")
    require(
        array.dtype == dtype and array.shape == shape,
        f"{where} must be {np.dtype(dtype)} {shape}, got {array.dtype} {array.shape}",
    )


@contextmanager
def must_raise(error: type[Exception], what: str) -> Iterator[None]:
    """Raises AssertionError unless its block raises this error, with a message."""
    try:
        yield
    except error as raised:
        require(str(raised), f"{what} must raise {error.__name__} with a message")
    except Exception as raised:
        raise AssertionError(
            f"{what} must raise {error.__name__}, raised {type(raised).__name__}: {raised}"
        ) from raised
    else:
        raise AssertionError(f"{what} must raise {error.__name__}, and was accepted")
