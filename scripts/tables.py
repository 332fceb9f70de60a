"""Markdown tables, and the docstrings of classes as sections of a page."""

import inspect
import re
from collections.abc import Collection, Iterable


def code(text: str) -> str:
    return f"`{text}`"


def markdown(
    heading: tuple[str, ...], rows: Iterable[tuple[str, ...]], right: Collection[str] = ()
) -> list[str]:
    """A table's lines. `right`: the columns that are aligned to the right."""
    dashes = tuple("--:" if name in right else ":--" for name in heading)
    return [f"| {' | '.join(cells)} |" for cells in (heading, dashes, *rows)]


def described(documented: object, *, without_title: bool = False) -> list[str]:
    """The lines of a docstring, without the lists of arguments and errors at its end."""
    text = inspect.getdoc(documented) or ""
    text = re.split(r"^(?:Args|Attributes|Raises|Returns):\n", text, flags=re.MULTILINE)[0]
    if without_title:
        text = text.partition("\n\n")[2]
    return text.strip().splitlines()


def comments(options: type) -> dict[str, str]:
    """What the comment beside each field of a class says."""
    source = inspect.getsource(options)
    return dict(re.findall(r"^    (\w+):.*?  # (.+)$", source, re.MULTILINE))
