"""Exceptions that commands print as `error:` lines, without a traceback, with exit code 2."""

from __future__ import annotations

import sys

from zipf.envs.errors import EngineError


class UserError(Exception):
    """What the user should change, a line for each mistake."""

    def _render_traceback_(self) -> list[str]:
        """What a notebook shows in the place of a traceback."""
        return [f"error: {line}" for line in str(self).splitlines()]


EXPECTED = (UserError, EngineError)
"""What commands print without a traceback."""


def tell(error: Exception) -> None:
    """Prints the lines of an error to stderr."""
    for line in str(error).splitlines():
        print(f"error: {line}", file=sys.stderr)
