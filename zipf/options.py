"""The base of every options class: typed, closed and immutable."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import BaseModel, ConfigDict, Field

Size = Annotated[int, Field(ge=1)]
Pair = Annotated[list[Size], Field(min_length=2, max_length=2)]
"""(rows, columns)."""


class Options(BaseModel):
    """Options of one part of the system.

    Unknown names, wrong types and values out of range are errors; nothing is coerced. Numbers carry
    their bounds here and their sources in the YAML files of `configs/`.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def name_of(options: type[Options]) -> str:
    """The name in a class of options, from its field `name: Literal["..."]`.

    Raises:
        ValueError: there is no such field.
    """
    field = options.model_fields.get("name")
    names = get_args(field.annotation) if field else ()
    if len(names) != 1 or not isinstance(names[0], str):
        raise ValueError(f'{options.__name__}: should have a field `name: Literal["..."]`')
    return names[0]
