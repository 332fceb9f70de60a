"""Exceptions that commands print as `error:` lines, without a traceback, with exit code 2."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zipf.envs.errors import EngineError


class UserError(Exception):
    """What the user should change, a line for each mistake."""

    def _render_traceback_(self) -> list[str]:
        """What a notebook shows in the place of a traceback."""
        return [f"error: {line}" for line in str(self).splitlines()]


@contextmanager
def writing(path: Path, kept: str = "") -> Iterator[None]:
    """Raises `UserError` where the system cannot write `path`: the disk is full, for example.

    Args:
        kept: how the message ends, such as what there still is.
    """
    try:
        yield
    except OSError as error:
        raise UserError(f"{path.as_posix()}: cannot be written: {error.strerror}{kept}") from None


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raises `UserError` where the system cannot read `path`."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{path.as_posix()}: cannot be read: {error.strerror}") from None


EXPECTED = (UserError, EngineError)
"""What commands print without a traceback."""


def tell(error: Exception) -> None:
    """Prints the lines of an error to stderr."""
    for line in str(error).splitlines():
        print(f"error: {line}", file=sys.stderr)
