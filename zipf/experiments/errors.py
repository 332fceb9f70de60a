"""The exceptions that every command turns into one line and exit code 2."""

from __future__ import annotations

from zipf.envs.family import EngineError


class UserError(Exception):
    """One clear line for the user; commands print it and exit with code 2."""


TOLD = (UserError, EngineError)
"""What a command tells in one line, without a traceback."""
