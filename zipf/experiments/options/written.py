"""Configuration files as they are written: their values, each with its line and its comment.

A file is one configuration, or has a block for each of several: `configs/memory.yaml` has `lstm`.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from zipf.errors import UserError, reading


@dataclass(frozen=True)
class Place:
    """A line of a file, and its comment."""

    file: Path
    line: int
    comment: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True)
class Written:
    """A configuration, or a part of one, as a file has it.

    Attributes:
        values: what is written.
        places: where each option is, such as `collector.num_envs`.
        place: where it begins; its comment is what the file says about it.
    """

    values: Any
    places: dict[str, Place]
    place: Place

    def part(self, option: str) -> Written:
        """What is written below an option."""
        values = self.values
        for name in [option] if option in values else option.split("."):  # a block's may have dots
            values = values[name]
        below = f"{option}."
        places = {
            name.removeprefix(below): place
            for name, place in self.places.items()
            if name.startswith(below)
        }
        return Written(values, places, self.places[option])


def read(file: Path) -> Written:
    """A file as one configuration.

    Raises:
        UserError: it is no YAML, or cannot be read.
    """
    return _read(*_version(file))[0]


def blocks(file: Path) -> dict[str, Written]:
    """The blocks of a file by name; what is said about one is in the comment above it.

    Raises:
        UserError: it is no YAML, has no blocks, or cannot be read.
    """
    whole, above = _read(*_version(file))
    if not isinstance(whole.values, dict):
        raise UserError(
            f"{file}: should have a block for each choice, such as 'mine: {{size: 64}}'"
        )
    found = {}
    for name in whole.values:
        if not isinstance(name, str):
            raise UserError(f"{file}: {name!r} is no name of a block; quote it, or choose another")
        block = whole.part(name)
        found[name] = replace(block, place=replace(block.place, comment=above[name]))
    return found


def _version(file: Path) -> tuple[Path, int]:
    with reading(file):
        return file, file.stat().st_mtime_ns


@cache
def _read(file: Path, _: int) -> tuple[Written, dict[str, str]]:
    """A file, and the comments above its blocks."""
    try:
        with reading(file):
            lines = _Lines(file)
        places = dict(_places(lines.root, lines))
        whole = Written(lines.values(), places, Place(file, 1, lines.above(0)))
    except yaml.YAMLError as error:
        raise UserError(f"{file}: is not a configuration: {' '.join(str(error).split())}") from None
    except UnicodeDecodeError:
        raise UserError(f"{file}: is not UTF-8 text") from None
    blocks = whole.values if isinstance(whole.values, dict) else ()
    return whole, {
        name: lines.above(places[name].line - 1) for name in blocks if isinstance(name, str)
    }


class _Lines:
    """A file's lines and the tree of its values."""

    def __init__(self, file: Path):
        self.file = file
        text = file.read_text(encoding="utf-8-sig")  # Windows programs begin it with a mark
        self.lines = text.splitlines()
        self._loader = _Loader(text)
        self.root = self._loader.get_single_node()

    def values(self) -> Any:
        return None if self.root is None else self._loader.construct_document(self.root)

    def above(self, line: int) -> str:
        """The comment in the lines that begin or, of a block, precede it, as one line."""
        first = line
        while first and self.lines[first - 1].startswith("#"):
            first -= 1
        found = itertools.takewhile(lambda text: text.startswith("#"), self.lines[first:])
        return " ".join(text.removeprefix("#").strip() for text in found)

    def comment(self, line: int, column: int) -> str:
        """What follows an option whose value ends there, both counted from 0."""
        found = re.match(r"[^#]*?(?:(?<=\s)|^)#(.*)", self.lines[line][column:])
        if not found:
            return ""
        start = column + found.start(1) - 1
        parts = [found[1].strip()]
        for text in self.lines[line + 1 :]:  # it may go on below, in the same column
            if text.lstrip()[:1] != "#" or text.index("#") != start:
                break
            parts.append(text[start + 1 :].strip())
        comment = " ".join(parts)
        if comment == "same" and line:
            return self.comment(line - 1, self._end(line - 1))
        return comment

    def _end(self, line: int) -> int:
        """The column in which the values of a line end, or 0 where none does."""
        text = self.lines[line]
        return min((i for i in range(len(text)) if text[i:].lstrip().startswith("# ")), default=0)


def _places(
    node: Any, lines: _Lines, of: str = "", end: yaml.Mark | None = None
) -> Iterator[tuple[str, Place]]:
    """The options of a mapping; `end` is that of the braces around it, where it is in any."""
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        name = f"{of}{key.value}"
        scalar = isinstance(value, yaml.ScalarNode)
        below = value.style in ("|", ">") if scalar else not value.flow_style
        ends = end or (key if below else value).end_mark
        comment = lines.comment(ends.line, ends.column)
        yield name, Place(lines.file, key.start_mark.line + 1, comment)
        yield from _places(value, lines, f"{name}.", None if below else ends)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads values as OmegaConf does: `1e-3` is a number, a date is text, a name occurs once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
        keys: set[Any] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag.endswith(":null"):
                raise _wrong(node, "found a key that is no name", key.start_mark)
            if key.value in keys:
                raise _wrong(node, f"found duplicate key {key.value}", key.start_mark)
            keys.add(key.value)
        return super().construct_mapping(node, deep=deep)


def _wrong(node: yaml.MappingNode, problem: str, place: yaml.Mark) -> yaml.YAMLError:
    return yaml.constructor.ConstructorError(
        "while constructing a mapping", node.start_mark, problem, place
    )


for _tag in ("set", "omap", "pairs", "binary"):  # of which no option is
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", yaml.SafeLoader.construct_undefined)

_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in found if not tag.endswith(":timestamp")]
    for first, found in _Loader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:\d[\d_]*(?:\.[\d_]*)?|\.\d[\d_]*)[eE][-+]?\d+$"),
    list("-+0123456789."),
)
