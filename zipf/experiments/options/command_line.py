"""From a command line to a configuration: Hydra's overrides, checked against the schema."""

from __future__ import annotations

import argparse
import difflib
import json
import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any, NoReturn, TypeVar

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from pydantic import ValidationError

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.options import composing, config_files
from zipf.experiments.options.catalogue import condition_row
from zipf.experiments.options.composing import Composed, choices, composed, groups
from zipf.experiments.options.naming import RowName
from zipf.experiments.options.schema import (
    DEVICE_PATTERN,
    NAME_PATTERN,
    Config,
    schema,
    with_precision,
)
from zipf.experiments.records.descriptions import LINE_PATTERN
from zipf.experiments.records.learned_options import affects_learning, flatten
from zipf.options import Options

AnyOptions = TypeVar("AnyOptions", bound=Options)


def read(overrides: list[str]) -> Config:
    """The configuration of these overrides; whether its options fit each other is not checked
    here (`zipf.experiments.building.loading`).

    Raises:
        UserError: with one line for every unknown or mistyped option.
    """
    return read_composed(overrides)[0]


def read_composed(overrides: list[str]) -> tuple[Config, Composed]:
    """As `read`, with what the configuration was made from."""
    parsed = parse(overrides)
    composing.load_plugins(plugins_of(overrides))
    known, problems = _known(parsed)
    if not any(one.key_or_group == "experiment" for one in parse(known)):
        raise UserError("\n".join(problems))
    if problems and not any(_is_of_a_part(one) for one in parse(known)):
        raise UserError("\n".join([*problems, *_mistyped(known)]))
    composed = _compose_condition(*known)
    values = dict(composed.values)
    name = values.pop("name")
    row = row_name(composed) if name is None else RowName(name, {})
    values["condition"] = row.folder if name is None else name
    named = isinstance(values["condition"], str) and values["condition"]
    values["row"] = _row(row) if named else {"title": "unnamed"}
    values["row"] |= _asked_of_row(parsed, composed)
    del values["without_instruction"]
    try:
        config = with_precision(schema().model_validate(values))
    except ValidationError as error:
        raise UserError("\n".join([*problems, *_explain(error, values)])) from None
    if problems:
        raise UserError("\n".join(problems))
    return config, composed


def _is_of_a_part(override: Override) -> bool:
    """Whether an override has a value for a part, which the part's class checks: with PyTorch."""
    group, _, option = override.key_or_group.partition(".")
    return group in config_files.parts() and (bool(option) or isinstance(override.value(), dict))


def _mistyped(known: list[str]) -> Iterator[str]:
    """Mistakes in the options of no group. Of all others, which need PyTorch, nothing is said while
    names are wrong."""
    values = dict(composed(*known).values)
    name = values.pop("name")
    values |= {"condition": "unnamed" if name is None else name, "row": {"title": "unnamed"}}
    del values["without_instruction"]
    try:
        Config.model_validate(values)
    except ValidationError as error:
        yield from _explain(error, values)


def check_names(overrides: list[str]) -> None:
    """Whether there are options and choices of these names.

    Raises:
        UserError: with one line for every one that there is not.
    """
    parsed = parse(overrides)
    named = any(one.key_or_group == "experiment" for one in parsed)
    if problems := _known(parsed if named else [*parsed, *parse(["experiment=demo"])])[1]:
        raise UserError("\n".join(problems))


def plugins_of(overrides: list[str]) -> list[str]:
    """The modules in the override `plugins=[...]`.

    Raises:
        UserError: an override cannot be parsed, or `plugins` is not a list of names.
    """
    own = [one for one in parse(overrides) if one.key_or_group == "plugins"]
    if own and own[-1].is_sweep_override():
        raise UserError(f"{own[-1].input_line}: should be a list: plugins=[my_module,another]")
    found = [one.value() for one in own]
    names = found[-1] if found else []
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UserError(f"plugins={names}: should be a list of modules: plugins=[my_module]")
    return names


def split(words: list[str]) -> argparse.Namespace:
    """Hydra's flags and the overrides, in any order; `flags` are all words of the flags.

    Raises:
        UserError: a flag is none of Hydra's, lacks its value, or is shortened: `--experiment` is no
            rerun.
    """
    parser = get_args_parser()
    parser.allow_abbrev = False
    parser.error = _refuse  # type: ignore[method-assign]
    # It would take an override that follows it for what to show.
    words = ["--info=all" if _is_bare_info(*pair) else pair[0] for pair in pairwise([*words, "-"])]
    arguments, unknown = parser.parse_known_intermixed_args(words)
    if unknown:
        raise UserError(without_dashes(unknown[0]))
    arguments.flags = [word for word in words if word not in arguments.overrides]
    return arguments


def _refuse(message: str) -> NoReturn:
    raise UserError(message)


def _is_bare_info(word: str, following: str) -> bool:
    return word in ("--info", "-i") and ("=" in following or following.startswith("-"))


def parse(overrides: list[str]) -> list[Override]:
    """Overrides as Hydra reads them.

    Raises:
        UserError: with one line for each that cannot be read.
    """
    parser = OverridesParser.create()
    parsed, problems = [], []
    for text in overrides:
        try:
            parsed.append(parser.parse_override(text))
        except HydraException:
            problems.append(_advice(parser, text))
    if problems:
        raise UserError("\n".join(problems))
    return parsed


def read_options(options_class: type[AnyOptions], arguments: list[str]) -> AnyOptions:
    """The options of a small command, from `name=value` arguments.

    Raises:
        UserError: with one line for every unknown, missing or mistyped option.
    """
    accepted = list(options_class.model_fields)
    problems: list[str] = []
    values: dict[str, str] = {}
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if argument.startswith("-"):
            problems.append(without_dashes(argument))
        elif not equals:
            folder = "run" in accepted and Path(argument).is_dir()
            hint = f"; did you mean run={argument}?" if folder else ""
            problems.append(f"{argument}: not of the form option=value{hint}")
        elif name not in accepted:
            problems.append(f"{name}: no such option; {nearest(name, accepted)}")
        elif name in values:
            problems.append(f"{name}={values[name]} and {argument}: choose one")
        else:
            values[name] = value
    try:
        options = options_class.model_validate_strings(values)
    except ValidationError as error:
        problems += _explain(error, values)
    if problems:
        raise UserError("\n".join(problems))
    return options


def without_dashes(flag: str) -> str:
    """What to say of a flag that there is not."""
    name, _, value = flag[:200].lstrip("-").partition("=")
    return (
        f"{flag:.200}: no such flag; options have no dashes: {name}={value or '<value>'} "
        "(--help shows them)"
    )


def nearest(name: str, accepted: list[str]) -> str:
    """The end of an error message: the same name in other groups, the most similar names, or all
    that are accepted."""
    group, dot, option = name.rpartition(".")
    within = [other for other in accepted if other.rpartition(".")[0] == group]
    if dot and within:  # the group is right: compare the rest only
        close = difflib.get_close_matches(option, [other.rpartition(".")[2] for other in within])
        close = [f"{group}.{other}" for other in close]
        accepted = within
    else:
        close = [other for other in accepted if other.rpartition(".")[2] == name]
        close = close or difflib.get_close_matches(name, accepted, n=3)
        # The options of all groups would be a hundred names.
        accepted = list({other.partition(".")[0] + ".*" * ("." in other) for other in accepted})
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"should be one of {', '.join(sorted(accepted))}"


def _compose_condition(*overrides: str) -> Composed:
    """As `composed`, with a condition's `without_instruction` where envs have no instruction."""
    result = composed(*overrides)
    other = result.values["without_instruction"]
    if other is not None and not isinstance(other, dict):
        raise UserError(
            f"without_instruction={other!s:.40}: should be choices of groups, as in "
            "'without_instruction={auxiliary: vision}', or null"
        )
    if other and not has_instruction(result.values["environment"]):
        chosen = {override.partition("=")[0] for override in overrides}
        other = [f"{group}={choice}" for group, choice in other.items() if group not in chosen]
        result = composed(*overrides, *other)
    return result


_instructed: dict[str, bool] = {}


def has_instruction(environment: dict[str, Any]) -> bool:
    """Whether the envs of a split, with these options, have an instruction; True if they cannot
    be made, or none are chosen."""
    key = json.dumps(environment, sort_keys=True, default=str)
    if key not in _instructed:
        try:
            options = {name: value for name, value in environment.items() if name != "split"}
            env = envs.make_vec(envs.split(environment["split"]).train[0], 1, **options)
            _instructed[key] = "instruction" in env.single_observation_space.spaces
            env.close()
        except (AttributeError, LookupError, ValueError, TypeError, MemoryError):
            _instructed[key] = True
    return _instructed[key]


def _row(name: RowName) -> dict[str, Any]:
    """How tables show a row: as the condition's file says, with changed options after the title."""
    known = name.base in choices("condition")
    row = condition_row(name.base).model_dump(exclude_unset=True) if known else {"title": name.base}
    return {**row, "title": ", ".join([row["title"], *name.words])}


def _asked_of_row(overrides: list[Override], composed: Composed) -> dict[str, Any]:
    """What the command line says of the row: `row.title="..."`, or `row={title: "..."}`."""
    row = composed.values["row"]
    if not isinstance(row, dict):
        return {}
    asked = {one.key_or_group for one in overrides}
    for one in overrides:
        whole = one.value() if one.key_or_group == "row" else None
        asked |= {f"row.{part}" for part in whole} if isinstance(whole, dict) else set()
    return {part: value for part, value in row.items() if f"row.{part}" in asked}


def _advice(parser: OverridesParser, text: str) -> str:
    """What to write in the place of an override that cannot be parsed."""
    name, equals, value = text.partition("=")
    shown = text if len(text) <= 200 else f"{text[:200]}..."
    if not equals:
        found = [f"{group}={text}" for group in groups() if text in choices(group)]
        hint = f"; did you mean {' or '.join(found)}?" if found else ""
        return f"{shown}: not of the form option=value{hint}"
    if value.endswith(","):
        return f"{shown}: ends in a comma"
    quoted = f'{name}="{value}"'
    balanced = all(value.count(a) == value.count(b) for a, b in ("()", "[]", "{}"))
    try:
        if balanced and parser.parse_override(quoted).value() == value:
            return f"{shown}: needs quotes within quotes: '{quoted}'"
    except HydraException:
        pass
    return f"{shown}: cannot be read; check its quotes and brackets"


def _known(overrides: list[Override]) -> tuple[list[str], list[str]]:
    """The overrides with a known name, and a line about each of the others."""
    available = groups()
    known, problems, options = [], [], []
    experiment = None
    for override in overrides:
        key, text = override.key_or_group, str(override.input_line)
        if override.is_delete():
            problems.append(f"{text}: options cannot be deleted; give another value")
        elif key in config_files.several():
            value = override.value()
            chosen = [str(one) for one in (value if isinstance(value, list) else [value])]
            for one in chosen:
                if one not in choices(key):
                    hint = f"{nearest(one, choices(key))}; {key}=[] for none"
                    problems.append(f"{key}=[{one}]: no such {key.removesuffix('s')}; {hint}")
            known += [text] if set(chosen) <= set(choices(key)) else []
        elif key in available:
            value = str(override.value())
            if key == "experiment" and experiment not in (None, value):
                problems.append(
                    f"experiment={experiment} and experiment={value}: choose one; for both, a "
                    f"sweep: -m experiment={experiment},{value}"
                )
            elif value in choices(key):
                known.append(text)
                experiment = value if key == "experiment" else experiment
            else:
                own = " (a name of your own: name=<name>)" if key == "condition" else ""
                hint = nearest(value, choices(key))
                problems.append(f"{key}={value}: no such {key}{own}; {hint}")
        else:
            options.append(override)
    if experiment is None:
        hints = _misspelt([override.key_or_group for override in options])
        problems += [f"{key}: no such option; did you mean {hint}?" for key, hint in hints.items()]
        keys = {override.key_or_group for override in overrides}
        if "sweep" in keys:
            problems.append("sweep: is of many runs: python -m zipf.train -m sweep=<name>")
        if not {*keys, *hints.values()} & {"experiment", "sweep"}:
            experiments = "|".join(choices("experiment"))
            problems.append(
                f"experiment is not set; choose one: experiment={experiments}, or write one of "
                "your own and give its folder: --config-dir"
            )
        return known, problems
    problems += _unknown_sections(known)
    values = composed(*known).values
    accepted = list(flatten(values))
    parents = {name.rsplit(".", 1)[0] for name in accepted if "." in name}
    for override in options:
        key = override.key_or_group
        if key == "row" and not isinstance(override.value(), dict):
            problems.append(f"{override.input_line}: should be row.title=<what tables show>")
        elif key in accepted or key in parents or key.startswith(("hydra.", "hydra/")):
            known.append(str(override.input_line))
        else:
            group = key.partition(".")[0]
            part = values.get(group)
            if name := _not_chosen(key, values):
                hint = f"choose it: {group}=[{','.join([*(part or {}), name])}]"
            elif group in ("search", "sweep"):
                hint = "what makes many runs goes with python -m zipf.train -m"
            elif owners := _owners(key):
                hint = f"{group}={'|'.join(owners)} has it"
            elif isinstance(part, dict) and list(part) == ["name"]:  # a choice such as none
                chosen = part["name"]
                others = "|".join(one for one in choices(group) if one != chosen)
                hint = f"{group}={chosen} has none; choose {group}={others}"
            else:
                hint = nearest(key, [*accepted, "sweep", "search"])
            problems.append(f"{key}: no such option; {hint}")
    return known, problems


def _unknown_sections(known: list[str]) -> Iterator[str]:
    """Values that the experiment or the condition has for a choice that there is not."""
    for override in parse(known):
        if (of := override.key_or_group) in ("experiment", "condition"):
            sections = config_files.sections(of, str(override.value()))
            known_of = {group: choices(group) for group, _ in sections}
            for (group, choice), place in sections.items():
                if choice not in known_of[group]:
                    hint = nearest(choice, known_of[group])
                    yield f"{place}: {group}: there is no {choice}; {hint}"


def _not_chosen(option: str, values: dict[str, Any]) -> str:
    """Of a group with several choices the one whose option this is; empty where it is chosen."""
    group, _, option = option.partition(".")
    name = option.partition(".")[0]
    there = group in config_files.several() and name in choices(group)
    return name if there and name not in (values.get(group) or {}) else ""


def _misspelt(keys: Iterable[str]) -> dict[str, str]:
    """Of options that are like one that there is in every experiment, that one."""
    names = [*groups(), *Config.model_fields, "name", "sweep", "search", "hydra"]
    hints = {}
    for key in keys:
        name = key.partition(".")[0].partition("/")[0]
        if name not in names and (close := difflib.get_close_matches(name, names, n=1)):
            hints[key] = key.replace(name, close[0], 1)
    return hints


def _owners(option: str) -> list[str]:
    """The choices of the option's group that have it."""
    group, _, name = option.partition(".")
    if group not in ("environment", *config_files.parts()):
        return []
    known = {choice: composing.config(f"{group}/{choice}")[0] for choice in choices(group)}
    return [choice for choice, values in known.items() if name in flatten(values)]


_IN_WORDS = {
    NAME_PATTERN: "should be usable as a folder's name (not empty, no '/', no leading '.')",
    LINE_PATTERN: "should be one line",
    DEVICE_PATTERN: "should be auto, cpu, cuda or cuda:<number>",
    "string_type": "should be text (quote it if it looks like a number)",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "should be a whole number"),
    "list_type": "should be a list in square brackets, such as [1,2]",
    "tuple_type": "should be a list in square brackets, such as [1,2]",
    "string_too_short": "should not be empty",
    "string_too_long": "is too long for a folder's name; use name=<name>",
}


def _explain(error: ValidationError, values: dict[str, Any]) -> Iterator[str]:
    for problem in error.errors():
        node: Any = values
        path: list[str] = []
        for part in problem["loc"]:  # without the tags that pydantic adds for alternatives
            if isinstance(node, dict) and part not in node and part != problem["loc"][-1]:
                continue
            if path and isinstance(part, str) and not isinstance(node, dict | list):
                continue
            path.append(str(part))
            node = node.get(part) if isinstance(node, dict) else node
        name = ".".join(path)
        if name == "condition":  # a chosen condition is right, so this is the user's own name
            name = "name"
        if problem["type"] == "missing" or problem["input"] == "???":
            yield f"{name}: is not set"
        elif problem["type"] == "union_tag_not_found":
            option = problem["ctx"]["discriminator"].strip("'")
            yield f"{name}.{option}: is not set"
        elif problem["type"] == "union_tag_invalid":
            tag = problem["ctx"]
            option = tag["discriminator"].strip("'")
            yield f"{name}.{option}={tag['tag']}: should be one of {tag['expected_tags']}"
        elif problem["type"] == "extra_forbidden":
            group = str(problem["loc"][0])
            chosen = values.get(group)
            if group == "environment" and isinstance(chosen, dict) and "split" in chosen:
                yield (
                    f"{name}: the envs of split={chosen['split']} have no such option"
                    + _experiments_own(name, values)
                )
            else:
                yield f"{name}: no such option here"
        else:
            kind = problem.get("ctx", {}).get("pattern", problem["type"])
            message = _IN_WORDS.get(kind, problem["msg"])
            message = message.removeprefix("Input ").removeprefix("Value error, ")
            given = problem["input"]
            shown = str(given)
            if problem["type"] in ("int_type", "float_type") and _is_number(given):
                shown, message = repr(given), f"is text; {message}, without quotes"
            elif len(shown.splitlines()) > 1:
                shown = repr(shown)
            yield f"{name}={shown:.200}: {message}"


def _is_number(given: Any) -> bool:
    """Whether this is text that a number is in."""
    return isinstance(given, str) and bool(re.fullmatch(r"[-+]?\d[\d.e+-]*", given))


def _experiments_own(option: str, values: dict[str, Any]) -> str:
    """What to do about an option of other envs that the experiment sets, not the user."""
    chosen = f"experiment={values['experiment']}"
    if option not in flatten(composed(chosen).values):
        return ""
    return f"; {chosen}, which is for other envs, sets it: choose another experiment"


def row_name(composed: Composed) -> RowName:
    """The name of a row: the condition, or agent, memory, auxiliary loss, critic and episodic
    memory; then all options that differ from theirs. Those of the paper's plain agent are left out.
    """
    chosen = composed.choices
    base = chosen["condition"]
    if base == "None":
        base = chosen["agent"]
        for group, plain in _PLAIN.items():
            if chosen[group] != plain:
                base += f"_{_IN_NAMES.get(chosen[group], chosen[group])}"
    start = [f"experiment={chosen['experiment']}"]
    compared = [part for part in config_files.parts() if part not in ("agent", *_PLAIN)]
    if base in choices("condition"):
        start.append(f"condition={base}")
        compared += ["agent", *_PLAIN]
    usual = _compose_condition(*start).choices
    other = [group for group in config_files.parts() if chosen[group] != usual[group]]
    there = flatten(_compose_condition(*start, *(f"{g}={chosen[g]}" for g in other)).values)
    changes: dict[str, Any] = {group: chosen[group] for group in compared if group in other}
    here = flatten(composed.values)
    for option, value in here.items():
        if option.split(".")[0] in ("seed", "experiment", "name", "without_instruction"):
            continue
        if option == "precision" and there[option] == "auto":
            continue  # the same run goes on with it on another machine; its checkpoint checks it
        if affects_learning(option) and value != there.get(option):
            changes[option] = _of_seeds(value) if option == "pretrained.run" else value
    return RowName(base, changes, tuple(filter(affects_learning, here)))


def _of_seeds(folder: Any) -> str:
    """The experiment and the condition in the name of a run's folder: seeds that begin with other
    seeds of the same condition are in one row."""
    return "_".join(PurePath(str(folder)).parts[-3:-1]) or str(folder)


_PLAIN = {"memory": "lstm", "auxiliary": "none", "critic": "scalar", "episodic": "none"}  # paper
_IN_NAMES = {"gtrxl": "transformer"}  # as the paper calls it
