"""In which options runs differ."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import NONE


@dataclass(frozen=True)
class Differences:
    """The options in which runs differ.

    Attributes:
        columns: for each set of options that several runs may share, its runs.
        lines: for each option that differs its name and its value in every column, those of a
            group together.
    """

    columns: tuple[tuple[Run, ...], ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]


def differences(runs: Sequence[Run]) -> Differences:
    """The options in which these runs differ, without those that cannot change what is learned.

    External agents, which have no options, are left out.
    """
    shared: dict[str, list[Run]] = {}
    for run in runs:
        if not run.description.external:
            shared.setdefault(json.dumps(run.settings, sort_keys=True, default=str), []).append(run)
    columns = tuple(tuple(of_column) for of_column in shared.values())
    names = list(dict.fromkeys(name for column in columns for name in column[0].settings))
    groups = list(dict.fromkeys(name.split(".")[0] for name in names))
    lines = []
    for name in sorted(names, key=lambda name: groups.index(name.split(".")[0])):
        texts = tuple(_text(column[0], name) for column in columns)
        if len(set(texts)) > 1:
            lines.append((name, texts))
    return Differences(columns, tuple(lines))


def _text(run: Run, name: str) -> str:
    return value_text(run.settings[name]) if name in run.settings else NONE


def value_text(value: Any) -> str:
    """An option's value as a command line has it."""
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{','.join(value_text(item) for item in value)}]"
    return str(value)
