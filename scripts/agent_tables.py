"""Sections of the pages about parts of agents, from the classes of options and `configs/`."""

import sys
from collections.abc import Mapping
from typing import get_args

from tables import code, described, markdown

from zipf.experiments.options import composing, config_files
from zipf.experiments.options.config_files import CONFIG_DIR
from zipf.experiments.options.schema import schema
from zipf.options import Options, name_of


def groups(folder: str) -> list[str]:
    """All parts of an agent, each with its choices and a link to its page in `folder`."""
    return markdown(
        ("Part", "Choices"),
        (
            (f"[{code(group)}]({folder}/{group}.md)", ", ".join(map(code, choices)))
            for group, choices in ((one, classes(one)) for one in config_files.parts())
        ),
    )


def parts(group: str) -> list[str]:
    """Every choice of a group: what its code says about it, and its values with their sources."""
    found = classes(group)
    lines = []
    for name, options in found.items():
        module = sys.modules[options.__module__]
        shared = sum(one.__module__ == options.__module__ for one in found.values()) > 1
        own = name == "none" or shared  # the module of `none` is about the others
        lines += [f"## {code(name)}", "", *described(options if own else module), ""]
        lines += [*_values(group, name), ""]
    return lines[:-1]


def _values(group: str, name: str) -> list[str]:
    """What `configs/` has for a choice, with the comment above it."""
    written = config_files.find(group, name)
    assert written is not None
    place = written.place
    text = place.file.read_text(encoding="utf-8").splitlines()
    first, last = place.line - 1, place.line
    while first and text[first - 1].startswith("#"):
        first -= 1
    while last < len(text) and text[last].startswith("  ") and not text[first].startswith(" "):
        last += 1
    title = place.file.relative_to(CONFIG_DIR.parent).as_posix()
    return [f'```yaml title="{title}"', *text[first:last], "```"]


def classes(group: str) -> Mapping[str, type[Options]]:
    """The classes of options of a group by name, those that do nothing last."""
    field = schema().model_fields[group]
    found = {name_of(one): one for one in get_args(field.annotation)}
    missing = set(composing.choices(group)) ^ set(found)
    assert not missing, f"{group}: a file or a class is missing for {missing}"
    return dict(sorted(found.items(), key=lambda item: item[0] == "none"))
