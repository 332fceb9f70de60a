"""The base of every options class: typed, closed and immutable."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Options(BaseModel):
    """Options of one part of the system.

    Unknown names, wrong types and values out of range are errors; nothing is coerced. Numbers carry
    their bounds here and their sources in the YAML files of `configs/`.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
