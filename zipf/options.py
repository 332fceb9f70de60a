"""The base of every options class: typed, closed and immutable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import BaseModel, ConfigDict, Field

Size = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Fraction = Annotated[float, Field(gt=0, le=1)]
BelowOne = Annotated[float, Field(ge=0, lt=1)]
Pair = Annotated[list[Size], Field(min_length=2, max_length=2)]
"""(rows, columns)."""


@dataclass(frozen=True)
class Context:
    """What options are used with, for their own checks (`Options.problems`).

    Attributes:
        family: the name of the envs' family.
        has_goals: whether its envs say what an episode asks for.
        num_envs, unroll_length: B and T of the unrolls that an agent learns from.
        chosen: the options of other groups, by the groups' names.
        updates_per_unroll: how many updates are made from each unroll, of parts of its envs.
    """

    family: str
    has_goals: bool
    num_envs: int
    unroll_length: int
    chosen: Mapping[str, Any]
    updates_per_unroll: int = 1


class Options(BaseModel):
    """Options of one part of the system.

    Unknown names, wrong types and values out of range are errors; nothing is coerced. Numbers carry
    their bounds here and their sources in the YAML files of `configs/`.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    def problems(self, context: Context) -> Iterator[str]:
        """What is wrong with these options there, a line for each problem; shown with all others
        before a run begins."""
        yield from ()


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
