"""Checks of arguments that the envs have in common."""

import difflib
import operator
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from zipf.options import Options

ImageSize = Annotated[
    list[Annotated[int, Field(ge=1, le=4096)]],  # ours: at most 4096
    Field(min_length=2, max_length=2),
]
"""(height, width) in pixels."""

AnyOptions = TypeVar("AnyOptions", bound=Options)


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """An argument that has to be a whole number, as an int.
    Raises ValueError: it is none, or not in `least .. most`."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise ValueError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be at most {most}, got {value!r}")
    return int(value)


def checked(options: type[AnyOptions], given: Mapping[str, Any]) -> AnyOptions:
    """Constructor options as their class has them. Sequences are taken for lists, and NumPy's
    numbers for Python's. Raises ValueError with a line for each mistake."""
    try:
        return options(**{name: _plain(value) for name, value in given.items()})
    except ValidationError as error:
        lines = [_explained(problem, options, given) for problem in error.errors()]
        raise ValueError("\n".join(dict.fromkeys(lines))) from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(one) for one in value]
    return value


_MUST_BE = {
    "int_type": "a whole number",
    "float_type": "a number",
    "finite_number": "a number",
    "bool_type": "True or False",
    "literal_error": "{expected}",
    "greater_than_equal": "at least {ge}",
    "less_than_equal": "at most {le}",
    **dict.fromkeys(("list_type", "too_short", "too_long"), "(rows, columns)"),
}


def _explained(problem: Any, options: type[Options], given: Mapping[str, Any]) -> str:
    name, kind, context = problem["loc"][0], problem["type"], problem.get("ctx", {})
    if kind == "extra_forbidden":
        return str(unknown("option", name, options.model_fields))
    if kind == "value_error":
        return str(context["error"])
    return f"{name} must be {_MUST_BE[kind].format(**context)}, got {given[name]!r}"


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """An argument that has to be a mapping; an empty one for None.
    Raises ValueError: it is something else."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping, got {value!r}")
    return value


def unknown(kind: str, name: str, known: Iterable[str]) -> ValueError:
    """The error for a name that there is not: says the nearest of the known ones, and the first
    twenty."""
    known = list(known)
    nearest = difflib.get_close_matches(name, known, n=2, cutoff=0.4)
    hint = f" (did you mean {' or '.join(map(repr, nearest))}?)" if nearest else ""
    shown = ", ".join(known[:20]) + (f" and {len(known) - 20} more" if len(known) > 20 else "")
    return ValueError(f"unknown {kind} {name!r}{hint}: expected one of {shown}")


def reset_options(value: Any, known: Collection[str]) -> Mapping[str, Any]:
    """The options of `reset`, which may have these names; an empty mapping for None.
    Raises ValueError: it is no mapping, or has other names."""
    options = mapping("options", value)
    if unknown := options.keys() - set(known):
        raise ValueError(
            f"unknown reset options {sorted(map(str, unknown))}: expected {list(known)}"
        )
    return options


def single_action(action: Any, count: int) -> int:
    """The action of one env as an int; whether it is one of `count`, which the message names, is
    not checked. Raises TypeError: it is no integer."""
    try:
        return operator.index(action)
    except TypeError:
        raise TypeError(
            f"the action must be an integer in 0 .. {count - 1}, got {action!r}"
        ) from None
