"""Where configurations are: `configs/`, folders of the user's and of plugins.

`configs/` has a file for each group, with a block for each choice; a file for each experiment; one
for all conditions, one for all sweeps and one for searches. Hydra has a file for each choice, in a
folder for each group: so `nodes` makes of ours what Hydra would find in such folders. A folder of
the user's may be laid out in either way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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

_user_folders: list[Path] = []


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


def add_folder(folder: str | Path) -> None:
    """Adds a folder of the user's, laid out like `configs/` or as Hydra's folders are
    (`--config-dir`).

    Raises:
        UserError: there is no such folder.
    """
    try:
        path = Path(folder).expanduser().resolve()
        found = path.is_dir()
    except (OSError, RuntimeError):  # too long a name, or no such user's home
        found = False
    if not found:
        raise UserError(f"--config-dir {folder!s:.200}: there is no such folder")
    if path not in _user_folders:
        _user_folders.append(path)


def folders() -> list[Path]:
    """All folders; of equal names the first one that has it counts, but of a choice that is in ours
    a file in Hydra's layout."""
    return [CONFIG_DIR, *_user_folders, *plugins.config_folders()]


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
    """The groups that have files."""
    found = {path.name for folder in folders() for path in folder.iterdir() if path.is_dir()}
    # values are chosen by the other groups
    others = {"values", "sweep", "search", "hydra", "experiments"}
    return (found | {"experiment", "condition", *usual().values}) - others


def choices(group: str) -> set[str]:
    """The names in a group that are written in files."""
    found = {path.stem for folder in folders() for path in (folder / group).glob("*.yaml")}
    for folder in folders():
        found |= _written(folder, group).keys()
    return found | ({usual().values[group]} if group in parts() else set())


def find(group: str, name: str) -> Written | None:
    """How a choice is written; None for one that is in no file.

    Raises:
        UserError: its file is no configuration, or cannot be read.
    """
    if (file := find_file(group, name)) is not None:
        return read(file)
    for folder in folders():
        if name in (known := _written(folder, group)):
            return known[name]
    if group in parts() and usual().values[group] == name:
        return Written({"name": name}, {}, usual().places[group])
    return None


def find_file(group: str, name: str) -> Path | None:
    """The file of a configuration in Hydra's layout; None where there is none."""
    paths = (folder / group / f"{name}.yaml" for folder in folders())
    return next((path for path in paths if path.is_file()), None)


def _written(folder: Path, group: str) -> dict[str, Written]:
    """What a folder has of a group in our layout."""
    if group == "experiment":
        return {path.stem: read(path) for path in sorted(folder.glob("experiments/*.yaml"))}
    path = folder / f"{group}.yaml"
    if group not in ("condition", "sweep", "search", *usual().values) or not path.is_file():
        return {}
    found = blocks(path)
    if group in usual().values:
        named = {name: {"name": name, **(one.values or {})} for name, one in found.items()}
        found = {name: replace(one, values=named[name]) for name, one in found.items()}
    return found


def nodes() -> dict[str, Node]:
    """What is in our layout as Hydra would have it, by name, such as `agent/impala`.

    Raises:
        UserError: what is written is no configuration.
    """
    found: dict[str, Node] = {}
    for group in parts():
        usually = usual().values[group]
        written = {usually: find(group, usually)} | _all(group)
        for name, one in written.items():
            if one is not None:
                found[f"{group}/{name}"] = Node(one.values, None, one)
    for group in several():
        for name, one in _all(group).items():
            found[f"{group}/{name}"] = Node(one.values, package(group, name), one)
    for name, one in _all("condition").items():
        found |= _condition(name, one)
    experiments = _all("experiment")
    for name in experiments:
        found |= _experiment(name, experiments)
    found |= _inherited(found)
    return found | {PRIMARY: _primary(found)}


def _all(group: str) -> dict[str, Written]:
    found: dict[str, Written] = {}
    for folder in reversed(folders()):
        found |= _written(folder, group)
    return found


def _primary(found: dict[str, Node]) -> Node:
    """What all others are composed into.

    Values of an experiment, or a condition, for a choice come before its others, so that a file in
    Hydra's layout that includes it overrides both; but those for an agent after them, since they
    may change options that are not the agent's.
    """
    written = read(CONFIG_DIR / "train.yaml")
    values = {name: value for name, value in written.values.items() if name != "choose"}
    defaults = [
        "_self_",
        *({group: choice} for group, choice in usual().values.items()),
        *_by_choice("experiment", found),
        {"experiment": None},
        # Where files in Hydra's layout have them; ours are stored as if they were there.
        *({f"optional values@{one}": f"${{experiment}}/${{{one}}}"} for one in ("agent", "memory")),
        *_by_choice("condition", found),
        {"condition": None},
        {"override hydra/hydra_logging": "none"},
        {"override hydra/job_logging": "none"},
    ]
    return Node({"defaults": defaults, **values}, None, written)


def _by_choice(of: str, found: dict[str, Node]) -> list[dict[str, str]]:
    """The defaults for groups that an experiment, or a condition, has values of."""
    paths = (path.split("/") for path in found if path.startswith(f"by_choice/{of}/"))
    return [
        {f"optional by_choice/{of}@{group}": f"${{{of}}}/{group}/${{{group}}}"}
        for group in dict.fromkeys(path[3] for path in paths)
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
        here = {key: value for key, value in part.values.items() if not key.startswith("/")}
        if elsewhere := {key[1:]: part.values[key] for key in part.values.keys() - here.keys()}:
            places = {option.removeprefix("/"): place for option, place in part.places.items()}
            defaults.append(f"/{path}_elsewhere@_global_")
            found[f"{path}_elsewhere"] = Node(
                elsewhere, None, Written(elsewhere, places, part.place)
            )
        part = Written(here, part.places, part.place)
        found[path] = Node({"defaults": [*defaults, "_self_"], **here}, None, part)
        if group == "memory":  # as a file in Hydra's layout may name it
            found[f"values/{name}/{choice}"] = Node({"defaults": [f"/{path}@_here_"]}, None, part)
    choose = dict(values.pop("choose", {}))
    defaults = [parent] if parent else []
    if "environment" in choose and not parent:  # which has none that one could override
        defaults.append({"/environment": choose.pop("environment")})
    defaults += [*_overrides(choose), "_self_"]
    values = {"defaults": defaults, "experiment": name, **values}
    return found | {f"experiment/{name}": Node(values, "_global_", written)}


def _path(experiment: str, group: str, choice: str) -> str:
    """The configuration with what an experiment has for a choice."""
    if group == "agent":
        return f"values/{experiment}/{choice}"
    return f"by_choice/experiment/{experiment}/{group}/{choice}"


def _overrides(choose: dict[str, str]) -> list[dict[str, str]]:
    return [{f"override /{group}": choice} for group, choice in choose.items()]


def _sections_of(name: str | None, known: dict[str, Written]) -> list[tuple[str, str]]:
    """The choices that an experiment, or one that it is like, has values for."""
    found: dict[tuple[str, str], None] = {}
    seen = []
    while name in known:
        if name in seen:
            raise UserError(f"{_shown(known[name].place)}: like: {name} would be like itself")
        seen.append(name)
        values, sections = _without_sections(known[name])
        found |= dict.fromkeys(sections)
        name = values.get("like")
    return list(found)


def _without_sections(written: Written) -> tuple[dict[str, Any], dict[tuple[str, str], Written]]:
    """The options of no group, and the values of groups: those for each choice.

    Raises:
        UserError: values of a group do not say for which choice they are.
    """
    if not isinstance(written.values, dict):
        raise UserError(f"{_shown(written.place)}: should be options, such as 'updates: 100'")
    values, sections = dict(written.values), {}
    for group in parts():
        section = values.pop(group, {})
        for choice in section if isinstance(section, dict) else [section]:
            if not isinstance(section, dict) or not isinstance(section[choice], dict):
                raise UserError(
                    f"{_shown(written.places[group])}: {group}: values of a group are those for a "
                    f"choice, such as '{group}: {{{usual().values[group]}: {{...}}}}'"
                )
            sections[group, choice] = written.part(f"{group}.{choice}")
    return values, sections


def _shown(place: Place) -> str:
    return f"{place.file}:{place.line}"


def _inherited(ours: dict[str, Node]) -> dict[str, Node]:
    """What experiments in Hydra's layout have for choices since they include one of ours."""
    files = [path for folder in folders() for path in sorted(folder.glob("experiment/*.yaml"))]
    found: dict[str, Node] = {}
    for _ in files:  # one may include another
        for path in files:
            for parent in _includes(path):
                above = f"by_choice/experiment/{parent}/"
                for name, node in (ours | found).items():
                    if name.startswith(above):
                        child = f"by_choice/experiment/{path.stem}/{name.removeprefix(above)}"
                        written = Written({}, {}, node.written.place)
                        found[child] = Node({"defaults": [f"/{name}@_here_"]}, None, written)
    return found


def _includes(path: Path) -> list[str]:
    """The experiments that a file in Hydra's layout includes."""
    try:
        values = read(path).values
    except UserError:  # Hydra tells, where it is chosen
        return []
    defaults = values.get("defaults") if isinstance(values, dict) else None
    entries = defaults if isinstance(defaults, list) else []
    return [one.removeprefix("/experiment/") for one in entries if isinstance(one, str)]
