"""Names of rows and of their folders, from what differs from a condition."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

LONGEST = 100  # characters of a row's folder; ours: readable, and far below the 255 of file systems
_HASH = 6  # hexadecimal digits; ours: two of a thousand names are alike once in thirty
_PLAIN = re.compile(r"\w+(\.\w+)*", re.ASCII)


@dataclass(frozen=True)
class RowName:
    """The name of a row of tables.

    Attributes:
        base: a condition, a name that a user gave, or the names of an agent's parts.
        changes: the groups and options that differ from the base's, such as `agent.discount`, with
            their values.
        options: all options of the run; the last word of one is its name where no other has it.
    """

    base: str
    changes: Mapping[str, Any]
    options: tuple[str, ...] = ()

    @property
    def words(self) -> list[str]:
        """The changes as on a command line, but for spaces and slashes."""
        changes = self.changes.items()
        return [
            f"{name}={str(value).replace(' ', '').replace('/', '_')}" for name, value in changes
        ]

    @property
    def folder(self) -> str:
        """The name of the row's folder, which no shell needs quotes for: `impala-discount_0.9`.

        Long ones are cut, and those with values that cannot be shown as they are changed: both end
        with a hash of the whole name, so that other values have another folder.
        """
        last = [option.rpartition(".")[2] for option in self.options]
        shown = [self.base]
        exact = True
        for name, value in self.changes.items():
            text, is_exact = _shown(value)
            exact &= is_exact
            short = name.rpartition(".")[2]
            if name == "pretrained.run":
                short = "pretrained"
            elif last.count(short) > 1:
                short = name
            shown.append(f"{short}_{text}")
        folder = "-".join(shown)
        if exact and len(folder) <= LONGEST:
            return folder
        changes = (f"{name}={value}" for name, value in self.changes.items())
        return with_hash(folder, ",".join([self.base, *changes]))


def with_hash(name: str, whole: str) -> str:
    """A name, cut if it is long, and a hash of all that it stands for."""
    digest = hashlib.sha256(whole.encode()).hexdigest()[:_HASH]
    return f"{name[: LONGEST - _HASH - 1].rstrip('-_.+')}-{digest}"


def _shown(value: Any) -> tuple[str, bool]:
    """A value in a folder's name, and whether no other value is shown so."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value], True
    if isinstance(value, list) and value and not any(isinstance(one, list) for one in value):
        shown = [_shown(one) for one in value]
        return "+".join(text for text, _ in shown), all(exact for _, exact in shown)
    text = str(value)
    if isinstance(value, int | float) or _PLAIN.fullmatch(text):
        return text, True
    return re.sub(r"[^\w.+-]+", "_", text, flags=re.ASCII).strip("_.") or "empty", False
