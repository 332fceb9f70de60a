"""The exception that every command turns into one line and exit code 2."""

from __future__ import annotations


class UserError(Exception):
    """One clear line for the user; commands print it and exit with code 2."""
