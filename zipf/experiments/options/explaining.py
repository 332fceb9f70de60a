"""Where every option of a run comes from: `python -m zipf.train ... --explain`."""

from __future__ import annotations

import argparse
import inspect
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from zipf.errors import UserError
from zipf.experiments.options import command_line, composing, config_files
from zipf.experiments.options.composing import Composed
from zipf.experiments.options.config_files import find
from zipf.experiments.options.naming import RowName
from zipf.experiments.options.schema import Config, RowOptions
from zipf.experiments.options.written import Place, read
from zipf.experiments.records.learned_options import flatten
from zipf.options import Options


@dataclass(frozen=True)
class Origin:
    """Where the value of an option comes from.

    Attributes:
        place: the line of a file that has the value; None for what no file has.
        rule: what made the value, in addition to the line or in its place: "command line", or what
            becomes of a value such as `precision: auto`.
        comment: that of the line; of the command line, what it overrides.
    """

    option: str
    value: Any
    place: Place | None = None
    rule: str = ""
    comment: str = ""

    @property
    def where(self) -> str:
        """The line, and the rule."""
        return ", ".join(part for part in (self.place and shown(self.place), self.rule) if part)


def explain(overrides: list[str]) -> list[Origin]:
    """Every option of the run that a command line asks for.

    Raises:
        UserError: with one line for every mistake.
    """
    config, composed = command_line.read_composed(overrides)
    known = dict(_written(composed))
    options = flatten(config.model_dump())
    for word in overrides:
        known |= _given(word, known, list(options))
    known |= _without_instruction(composed)
    known["condition"] = _condition(known, config, composed)
    known |= {f"row.{part}": _row(part, known, composed) for part in RowOptions.model_fields}
    if composed.values["precision"] == "auto":
        known["precision"] = replace(known["precision"], rule="auto: what is fast on this device")
    if config.collector.lag is None:
        why = f"what agent={config.agent.name} corrects for"
        why = "runtime=ray" if config.runtime.name == "ray" else why
        known["collector.lag"] = replace(known["collector.lag"], rule=f"null: {why}")
        options["collector.lag"] = config.lag
    return [
        replace(known.get(option) or _default(config, option), option=option, value=value)
        for option, value in options.items()
    ]


def explain_run(config: Config, command: str, file: Path) -> list[Origin]:
    """Every option of a run that there is: as its command, given now, would have it or, where that
    differs, as the run's own file says. The command's folder of configurations is read, if it is
    there and no other one is.

    Args:
        file: the run's `config.yaml`.
    """
    lost = ""
    try:
        arguments = _arguments(command)
        own = arguments.config_dir
        if own and Path(own).is_dir() and config_files.user_folder() is None:
            config_files.use_folder(own)
        now = {one.option: one for one in explain(list(arguments.overrides))}
    except UserError as error:
        now, lost = {}, f"its command is none of this version: {str(error).splitlines()[0]}"
    written = read(file)
    origins = []
    for option, value in (flatten(config.model_dump()) | {"collector.lag": config.lag}).items():
        there = now.get(option)
        if there and there.value == value:
            origins.append(there)
            continue
        place = written.places.get(option)
        comment = f"now {_text(there.value)}, {there.where}" if there else lost
        rule = "" if place else "an option that was added since"
        origins.append(Origin(option, value, place, rule, comment))
    return origins


def report(origins: list[Origin], part: str = "", width: int | None = None) -> str:
    """A line for every option, or for those of a part.

    Args:
        part: a group or an option; "" for all.
        width: what a line is cut to, in characters; None: not at all.

    Raises:
        UserError: there is no such part.
    """
    inside = [one for one in origins if f"{one.option}.".startswith(f"{part}.") or not part]
    if not inside:
        names = [one.option for one in origins]
        parts = [name.partition(".")[0] for name in names]
        hint = command_line.nearest(part, list(dict.fromkeys([*parts, *names])))
        raise UserError(f"--explain {part:.200}: no such option; {hint}")
    rows = [(one.option, _text(one.value), one.where, one.comment) for one in inside]
    widths = [max(len(row[i]) for row in rows) for i in range(2)]
    place = min(max(len(row[2]) for row in rows), 48)
    lines = (
        f"{name:{widths[0]}}  {value:{widths[1]}}  {where:{place}}  {comment}".rstrip()
        for name, value, where, comment in rows
    )
    return "\n".join(
        line if width is None or len(line) <= width else f"{line[: width - 3]}..." for line in lines
    )


def shown(place: Place) -> str:
    """`configs/agent.yaml:12`: from the current folder if it is below that."""
    path, here = place.file, Path.cwd()
    path = path.relative_to(here) if path.is_relative_to(here) else path
    return f"{path.as_posix()}:{place.line}"


def _written(composed: Composed) -> Iterator[tuple[str, Origin]]:
    """What configurations have; of several that have an option the last counts."""
    layers = composing.layers(*composed.overrides)
    for config, package in layers.configs:
        group, _, name = config.rpartition("/")
        values, written = composing.config(config)
        for option, value in flatten(values).items():
            if value == "???" or option.startswith(("defaults", "hydra.")):
                continue
            full = f"{package}.{option}" if package else option
            if option == "name" and package in (group, config_files.package(group, name)):
                by = layers.chosen.get(group, "")
                if group in config_files.several():  # of which Hydra does not tell
                    by = [one for one, _ in layers.configs if _chooses(one, group)][-1]
                yield full, _chosen(group, name, by)
            elif written is None:
                yield full, _registered(group, name, option, value)
            else:
                place = written.places.get(option, written.place)
                yield full, Origin(full, value, place, comment=place.comment)


def _chooses(config: str, group: str) -> bool:
    """Whether a configuration has the choices of a group."""
    written = composing.config(config)[1]
    return written is not None and f"choose.{group}" in written.places


def _chosen(group: str, choice: str, by: str) -> Origin:
    """The choice of a group, by a configuration or ("") by a word that is not known here."""
    written = find(group, choice)
    comment = written.place.comment if written else ""
    if not by:
        return Origin(group, choice, comment=comment)
    _, chooser = composing.config(by)
    assert chooser is not None
    place = chooser.places[f"choose.{group}"]
    return Origin(group, choice, place, comment=place.comment or comment)


def _registered(group: str, name: str, option: str, value: Any) -> Origin:
    """An option of a choice that a family, or a plugin, registers in Python."""
    if group == "environment" and option == "split":
        return Origin(option, value, rule=f"the first split of {name}")
    return replace(_of_class(composing.options_class(group, name), option), value=value)


def _default(config: Config, option: str) -> Origin:
    """An option that no configuration has."""
    *parts, name = option.split(".")
    of: Any = config
    for part in parts:
        of = of[part] if isinstance(of, dict) else getattr(of, part)
    return _of_class(type(of), name)


def _of_class(options: type[Options], name: str) -> Origin:
    """The default of a class of options."""
    rule = f"default of {options.__name__}"
    for one in options.__mro__:
        if name not in vars(one).get("__annotations__", {}):
            continue
        rule = f"default of {one.__name__}"
        try:
            lines, first = inspect.getsourcelines(one)
            file = inspect.getsourcefile(one)
        except (OSError, TypeError):  # a class that was made without a file
            break
        for number, line in enumerate(lines, start=first):
            if file and re.match(rf"\s+{name}\s*:", line):
                comment = line.partition("  #")[2].strip()
                return Origin(name, None, Place(Path(file), number, comment), rule, comment)
    return Origin(name, None, rule=rule)


def _given(word: str, known: dict[str, Origin], options: list[str]) -> dict[str, Origin]:
    """What a word of the command line says, about one option or about those below it."""
    (override,) = command_line.parse([word])
    key, value = override.key_or_group, override.value()
    if isinstance(value, dict):
        keys = [f"{key}.{option}" for option in flatten(value)]
    elif key in config_files.parts():
        keys = [f"{key}.name"]
    elif key in config_files.several():
        chosen = value if isinstance(value, list) else [value]
        keys = [f"{key}.{name}.name" for name in chosen] or [key]
    else:
        keys = ["condition" if key == "name" else key]
    found = {}
    for option in set(keys) & set(options):
        before = known.get(option)
        if before is None or key in composing.groups():
            comment = before.comment if before else ""
        else:
            comment = f"instead of {_text(before.value)}, {before.where}"
        found[option] = Origin(option, value, rule=f"command line: {word}", comment=comment)
    return found


def _without_instruction(composed: Composed) -> Iterator[tuple[str, Origin]]:
    """The choices of a condition for environments without an instruction, where they were made."""
    written = find("condition", composed.choices["condition"])
    for group, choice in (composed.values["without_instruction"] or {}).items():
        place = written.places.get(f"without_instruction.{group}") if written else None
        if place and f"{group}={choice}" in composed.overrides:
            rule = "there is no instruction"
            yield f"{group}.name", Origin(group, choice, place, rule, place.comment)


def _condition(known: dict[str, Origin], config: Config, composed: Composed) -> Origin:
    """The row's name."""
    if composed.values["name"] is not None:  # the command line's, or a file's
        return known.get("condition") or known["name"]
    if config.condition == composed.choices["condition"]:
        return known["condition"]
    return Origin("condition", None, rule="name: null, from the choices and what differs from them")


def _row(part: str, known: dict[str, Origin], composed: Composed) -> Origin:
    """How tables show the row."""
    option = f"row.{part}"
    if option in known and known[option].rule.startswith("command line"):
        return known[option]
    name = composed.values["name"]
    row = RowName(name, {}) if name is not None else command_line.row_name(composed)
    written = find("condition", row.base)
    if written is not None and (place := written.places.get(option)):
        rule = "and what differs" if part == "title" and row.changes else ""
        return Origin(option, None, place, rule, place.comment)
    return Origin(option, None, rule="name") if part == "title" else _of_class(RowOptions, part)


def _arguments(command: str) -> argparse.Namespace:
    """The flags and overrides in the command of a run."""
    words = shlex.split(command)
    words = words[words.index("zipf.train") + 1 :] if "zipf.train" in words else words
    return command_line.split(words)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
