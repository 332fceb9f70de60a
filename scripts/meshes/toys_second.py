"""The toys of ranks 26 to 50."""

from collections.abc import Callable

from .shapes import Mesh

TOYS: dict[str, Callable[[], Mesh]] = {}
