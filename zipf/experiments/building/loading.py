"""From a command line to a configuration that can be run here, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from zipf.errors import UserError
from zipf.experiments.options import command_line
from zipf.experiments.options.schema import Config


def load(overrides: list[str]) -> Config:
    """The configuration of these overrides, checked.
    Raises UserError with one line for every unknown or mistyped option; where there are none, for
    those that do not fit each other, the environments or this machine."""
    config = read(overrides)
    check(config)
    return config


def check(config: Config, coming: Collection[Path] = ()) -> None:
    """Raises `UserError` where options do not fit each other, the environments or this machine.

    `coming` are the folders of runs that will be there when this one begins."""
    from zipf.experiments.building import feasibility  # here: it imports PyTorch

    if problems := list(feasibility.problems(config, coming)):
        raise UserError("\n".join(problems))


def read(overrides: list[str]) -> Config:
    """The configuration of these overrides; whether they fit each other is left to `check`.
    Raises UserError with one line for every unknown or mistyped option."""
    return command_line.read(overrides)
