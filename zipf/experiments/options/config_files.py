"""Where configurations are: `configs/`, folders of the user's and of plugins.

Each has a file for each group, with a block for each choice; a file for each experiment; one for
all conditions and one for all sweeps. Hydra has a file for each choice, in a folder for each group:
so `nodes` makes of ours what Hydra would find in such folders.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import zipf
from zipf import plugins
from zipf.errors import UserError
from zipf.experiments.options.written import Place, Written, blocks, read

_PACKAGE = Path(zipf.__file__).parent
# In the wheel `configs/` lies inside the package; in a checkout it lies beside it.
CONFIG_DIR = next(
    path for path in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if path.is_dir()
)
PRIMARY = "zipf"
"""The configuration that all others are composed into, made of `configs/train.yaml`."""

_user_folder: Path | None = None


@dataclass(frozen=True)
class Node:
    """A configuration as Hydra stores it.

    Attributes:
        values: with a list of `defaults`.
        package: where its values go; None: where the list of defaults that has it says.
        written: how it is written.
    """

    values: dict[str, Any]
    package: str | None
    written: Written


def use_folder(folder: str | Path | None) -> None:
    """Reads a folder of the user's, laid out like `configs/` (`--config-dir`), in the place of the
    one before; None: no such folder.

    Raises:
        UserError: there is no such folder.
    """
    global _user_folder
    _user_folder = None
    if folder is None:
        return
    try:
        path = Path(folder).expanduser().resolve()
        found = path.is_dir()
    except (OSError, RuntimeError):  # too long a name, or no such user's home
        found = False
    if not found:
        raise UserError(f"--config-dir {folder!s:.200}: there is no such folder")
    _user_folder = path


def user_folder() -> Path | None:
    """The folder of the user's that is read; None for none."""
    return _user_folder


def folders() -> list[Path]:
    """All folders; of equal names the first one that has it counts, so ours are the last."""
    own = [] if _user_folder is None else [_user_folder]
    return [*own, *plugins.config_folders(), CONFIG_DIR]


@cache
def usual() -> Written:
    """The choice in each group where nothing else chooses."""
    return read(CONFIG_DIR / "train.yaml").part("choose")


def parts() -> list[str]:
    """The groups whose choices say how is learned: agent, memory, network and so on."""
    return [group for group in usual().values if group not in several()]


def several() -> list[str]:
    """The groups of which a run has any number of choices: loggers."""
    return [group for group, choice in usual().values.items() if isinstance(choice, list)]


def package(group: str, name: str) -> str | None:
    """Where the values of a choice go; None: to the options of its group."""
    return f"{group}.{name}" if group in several() else None


def groups() -> set[str]:
    """The groups that a run has choices of."""
    return {"experiment", "condition", "environment", *usual().values}


def choices(group: str) -> set[str]:
    """The names in a group that are written in files."""
    found = {usual().values[group]} if group in parts() else set()
    return found.union(*(_written(folder, group) for folder in folders()))


def find(group: str, name: str) -> Written | None:
    """How a choice is written; None for one that is in no file.

    Raises:
        UserError: its file is no configuration, or cannot be read.
    """
    for folder in folders():
        if name in (known := _written(folder, group)):
            return known[name]
    if group in parts() and usual().values[group] == name:
        return Written({"name": name}, {}, usual().places[group])
    return None


def _written(folder: Path, group: str) -> dict[str, Written]:
    """What a folder has of a group."""
    if group == "experiment":
        return {path.stem: read(path) for path in sorted(folder.glob("experiments/[!.]*.yaml"))}
    path = folder / f"{group}.yaml"
    if group not in {*groups(), "sweep"} or not path.is_file():
        return {}
    found = blocks(path)
    if group in ("environment", *usual().values):
        return {name: _part(group, name, one) for name, one in found.items()}
    return found


def _part(group: str, name: str, written: Written) -> Written:
    """The options of a choice; a family of environments has no name among them."""
    values = {} if written.values is None else written.values
    if not isinstance(values, dict):
        raise UserError(f"{written.place}: {name}: should be options, such as 'size: 64'")
    named = {} if group == "environment" else {"name": name}
    return replace(written, values={**named, **values})


def _misplaced(folder: Path) -> Iterator[str]:
    """A line for each file that is laid out as Hydra's are, or named almost as one that is read:
    what it should be."""
    experiments = folder / "experiments"
    if folder != CONFIG_DIR:
        yield from _misnamed(folder)
    for group in sorted(groups() | {"sweep"}):
        for path in sorted((folder / group).glob("[!.]*.yaml")):
            if group == "experiment":
                yield f"{path}: should be {experiments / path.name}"
            else:
                yield f"{path}: should be the block '{path.stem}' of {folder / group}.yaml"


def _misnamed(folder: Path) -> Iterator[str]:
    if (path := folder / "train.yaml").is_file():
        yield f"{path}: is read from zipf's own folder alone; should be a file of experiments/"
    for path in sorted(folder.glob("experiments/[!.]*.yml")):
        yield f"{path}: should be {path.with_suffix('.yaml').name}"
    names = sorted({*groups(), "sweep"} - {"experiment"})
    for path in sorted([*folder.glob("[!.]*.yaml"), *folder.glob("[!.]*.yml")]):
        close = difflib.get_close_matches(path.stem, names, n=1, cutoff=0.8)
        if close and path.name != f"{close[0]}.yaml":
            yield f"{path}: should be {close[0]}.yaml"


def nodes() -> dict[str, Node]:
    """What is written as Hydra would have it, by name, such as `agent/impala`.

    Raises:
        UserError: what is written is no configuration, or a folder has Hydra's layout.
    """
    if misplaced := [line for folder in folders() for line in _misplaced(folder)]:
        raise UserError("\n".join(misplaced))
    found: dict[str, Node] = {}
    for group in ("environment", *usual().values):
        for name in sorted(choices(group)):
            if one := find(group, name):
                found[f"{group}/{name}"] = Node(one.values, package(group, name), one)
    for name, one in _all("condition").items():
        found |= _condition(name, one)
    experiments = _all("experiment")
    for name in experiments:
        found |= _experiment(name, experiments)
    return found | {PRIMARY: _primary(found)}


def _all(group: str) -> dict[str, Written]:
    found: dict[str, Written] = {}
    for folder in reversed(folders()):
        found |= _written(folder, group)
    return found


def _primary(found: dict[str, Node]) -> Node:
    """What all others are composed into.

    What an experiment, or a condition, has for a choice comes after its others, since it may
    change options that are not the choice's.
    """
    written = read(CONFIG_DIR / "train.yaml")
    values = {name: value for name, value in written.values.items() if name != "choose"}
    defaults = [
        "_self_",
        *({group: choice} for group, choice in usual().values.items()),
        {"experiment": None},
        *_by_choice("experiment", found),
        {"condition": None},
        *_by_choice("condition", found),
        {"override hydra/hydra_logging": "none"},
        {"override hydra/job_logging": "none"},
    ]
    return Node({"defaults": defaults, **values}, None, written)


def _by_choice(of: str, found: dict[str, Node]) -> list[dict[str, str]]:
    """The defaults for groups that an experiment, or a condition, has values of."""
    having = {path.split("/")[3] for path in found if path.startswith(f"by_choice/{of}/")}
    return [
        {f"optional by_choice/{of}@{group}": f"${{{of}}}/{group}/${{{group}}}"}
        for group in parts()
        if group in having
    ]


def _condition(name: str, written: Written) -> dict[str, Node]:
    values, sections = _without_sections(written)
    found = {
        f"by_choice/condition/{name}/{group}/{choice}": Node(part.values, None, part)
        for (group, choice), part in sections.items()
    }
    defaults = [*_overrides(values.pop("choose", {})), "_self_"]
    values = {"defaults": defaults, "condition": name, **values}
    return found | {f"condition/{name}": Node(values, "_global_", written)}


def _experiment(name: str, known: dict[str, Written]) -> dict[str, Node]:
    written = known[name]
    values, sections = _without_sections(written)
    found = {}
    parent = values.pop("like", None)
    inherited = _sections_of(parent, known)
    for group, choice in dict.fromkeys((*inherited, *sections)):
        part = sections.get((group, choice), Written({}, {}, written.place))
        path = _path(name, group, choice)
        defaults: list[Any] = []
        if (group, choice) in inherited:
            defaults.append(f"/{_path(parent, group, choice)}@_here_")
        here = {key: value for key, value in part.values.items() if not str(key).startswith("/")}
        if elsewhere := {key[1:]: part.values[key] for key in part.values.keys() - here.keys()}:
            places = {option.removeprefix("/"): place for option, place in part.places.items()}
            defaults.append(f"/{path}_elsewhere@_global_")
            found[f"{path}_elsewhere"] = Node(
                elsewhere, None, Written(elsewhere, places, part.place)
            )
        part = Written(here, part.places, part.place)
        found[path] = Node({"defaults": [*defaults, "_self_"], **here}, None, part)
    choose = dict(values.pop("choose", {}))
    defaults = [parent] if parent else []
    if "environment" in choose and not parent:  # which has none that one could override
        defaults.append({"/environment": choose.pop("environment")})
    defaults += [*_overrides(choose), "_self_"]
    values = {"defaults": defaults, "experiment": name, **values}
    return found | {f"experiment/{name}": Node(values, "_global_", written)}


def _path(experiment: str, group: str, choice: str) -> str:
    """The configuration with what an experiment has for a choice."""
    return f"by_choice/experiment/{experiment}/{group}/{choice}"


def _overrides(choose: dict[str, str]) -> list[dict[str, str]]:
    return [{f"override /{group}": choice} for group, choice in choose.items()]


def sections(of: str, name: str) -> dict[tuple[str, str], Place]:
    """The choices that an experiment or a condition has values for, and where it has them, also in
    what it is like."""
    return _sections_of(name, _all(of))


def _sections_of(name: str | None, known: dict[str, Written]) -> dict[tuple[str, str], Place]:
    found: dict[tuple[str, str], Place] = {}
    seen = []
    while name in known:
        if name in seen:
            raise UserError(f"{known[name].place}: like: {name} would be like itself")
        seen.append(name)
        values, sections = _without_sections(known[name])
        for choice, part in sections.items():
            found.setdefault(choice, part.place)
        name = values.get("like")
    return found


def _without_sections(written: Written) -> tuple[dict[str, Any], dict[tuple[str, str], Written]]:
    """The options of no group, and the values of groups: those for each choice.

    Raises:
        UserError: values of a group do not say for which choice they are, or choices are none.
    """
    if not isinstance(written.values, dict):
        raise UserError(f"{written.place}: should be options, such as 'updates: 100'")
    values, sections = dict(written.values), {}
    for option, accepted in _CHOOSING.items():
        if option in values and not _chooses(option, values[option]):
            raise UserError(f"{written.places[option]}: {option}: {accepted}")
    groups = [*usual().values, "environment"]
    for group in values.get("choose", ()):
        if group not in groups:
            raise UserError(
                f"{written.places[f'choose.{group}']}: choose: {group} is no group; should be one "
                f"of {', '.join(groups)}"
            )
    for group in parts():
        section = values.pop(group, {})
        for choice in section if isinstance(section, dict) else [section]:
            if not isinstance(section, dict) or not isinstance(section[choice], dict):
                raise UserError(
                    f"{written.places[group]}: {group}: values of a group are those for a "
                    f"choice, such as '{group}: {{{usual().values[group]}: {{...}}}}'"
                )
            sections[group, choice] = written.part(f"{group}.{choice}")
    return values, sections


_CHOOSING = {
    "experiment": "is the name of the file that has it",
    "condition": "is chosen on the command line, or in a sweep",
    "defaults": "are Hydra's; 'choose: {memory: mlp}' and 'like: demo' take their place",
    "choose": "should be names of choices, such as 'choose: {memory: mlp}'",
    "like": "should be the name of an experiment, such as 'like: demo'",
}


def _chooses(option: str, value: Any) -> bool:
    """Whether an option of a configuration can say what it is composed of."""
    match option, value:
        case "choose", dict():
            return all(isinstance(one, str | list) for one in value.values())
        case "like", str():
            return True
    return False
