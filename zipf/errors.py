"""Exceptions that commands print as `error:` lines, without a traceback, with exit code 2."""

from __future__ import annotations

import sys

from zipf.envs.errors import EngineError


class UserError(Exception):
    """What the user should change, a line for each mistake."""


EXPECTED = (UserError, EngineError)
"""What commands print without a traceback."""


def tell(error: Exception) -> None:
    """Prints the lines of an error to stderr."""
    for line in str(error).splitlines():
        print(f"error: {line}", file=sys.stderr)
