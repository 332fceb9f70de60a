"""Sections of the pages about parts of agents, from the classes of options and `configs/`."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from tables import code, described, markdown

from zipf.experiments.options import command_line, composing
from zipf.experiments.options.schema import schema
from zipf.options import Options, name_of

CONFIGS = Path(__file__).parent.parent / "configs"


def groups(folder: str) -> list[str]:
    """All parts of an agent, each with its choices and a link to its page in `folder`."""
    return markdown(
        ("Part", "Choices"),
        (
            (f"[{code(group)}]({folder}/{group}.md)", ", ".join(map(code, choices)))
            for group, choices in ((one, classes(one)) for one in command_line.parts())
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
        values = (CONFIGS / group / f"{name}.yaml").read_text(encoding="utf-8").rstrip()
        lines += [f'```yaml title="configs/{group}/{name}.yaml"', *values.splitlines(), "```", ""]
    return lines[:-1]


def classes(group: str) -> Mapping[str, type[Options]]:
    """The classes of options of a group by name, those that do nothing last."""
    field = schema().model_fields[group]
    found = {name_of(one): one for one in get_args(field.annotation)}
    missing = set(composing.choices(group)) ^ set(found)
    assert not missing, f"{group}: a file or a class is missing for {missing}"
    return dict(sorted(found.items(), key=lambda item: item[0] == "none"))
