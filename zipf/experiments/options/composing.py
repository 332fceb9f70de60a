"""Composes configurations with Hydra, from `configs/`, folders of the user's, and the registries.

What is registered in Python needs no file: the group `environment` has a choice for every family,
with the defaults of its options class; a group that has a registry (`zipf.registry`), such as
`agent`, has one for every registered choice whose options all have defaults.
"""

from __future__ import annotations

import copy
import re
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from zipf import envs, plugins
from zipf.errors import UserError
from zipf.experiments.options import config_files
from zipf.experiments.options.config_files import find
from zipf.experiments.options.written import Written
from zipf.options import Options
from zipf.registry import registries

_using_hydra = threading.Lock()
_SEED = re.compile(r"seed=\d{1,18}")

Files = tuple[tuple[Path, int], ...]
"""Files, and when they were last written, in nanoseconds."""


@dataclass(frozen=True)
class Composed:
    """A composed configuration.

    Attributes:
        values: the options, nested.
        choices: the choice in each group; `"None"` for no choice.
        overrides: what it was composed with.
    """

    values: dict[str, Any]
    choices: dict[str, str]
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layers:
    """What a configuration is composed of.

    Attributes:
        configs: names of configurations, such as `agent/impala`, each with the group of options
            that it has; "" for all. Later ones override earlier ones.
        chosen: the configuration that makes the choice in a group, unless an override does.
    """

    configs: list[tuple[str, str]]
    chosen: dict[str, str]


def load_plugins(modules: Iterable[str]) -> None:
    """Imports plugins, also those of installed packages, and adds what they registered to Hydra's
    choices.

    Raises:
        UserError: a plugin cannot be imported.
    """
    try:
        plugins.load(modules)
    except ImportError as error:
        raise UserError(f"plugins: cannot import {error}") from None
    _store()


def search_path() -> str:
    """The override that makes Hydra find configurations outside `configs/`; empty for none."""
    folders = ",".join(quoted(f"file://{folder}") for folder in config_files.folders()[:-1])
    return f"hydra.searchpath=[{folders}]" if folders else ""


def quoted(text: str) -> str:
    """A value as an override can carry it.

    Hydra takes a backslash as it is, but for those before a quote or the end.
    """
    escaped = re.sub(r"(\\*)('|\Z)", lambda m: 2 * m[1] + m[2].replace("'", "\\'"), text)
    return f"'{escaped}'"


def groups() -> list[str]:
    """The groups that have choices."""
    return sorted(config_files.groups() | _registered().keys())


def choices(group: str) -> list[str]:
    """The names that can be chosen in a group."""
    return sorted(config_files.choices(group) | _registered().get(group, {}).keys())


def composed(*overrides: str) -> Composed:
    """The configuration of these overrides.

    Raises:
        UserError: it cannot be composed; with Hydra's message.
    """
    return _resolved(_files(), search_path(), *overrides)


@cache
def _resolved(files: Files, search_path: str, *overrides: str) -> Composed:
    seeds = [override for override in overrides if _SEED.fullmatch(override)]
    if any(re.match(r"[+~]+seed\b", override) for override in overrides):
        seeds = []
    others = [override for override in overrides if override not in seeds]
    try:
        # Composing takes Hydra a third of a second; a sweep's jobs often differ in the seed alone.
        config, choices = _composed(files, search_path, *others)
        config = copy.deepcopy(config)
        if seeds:
            config["seed"] = int(seeds[-1].partition("=")[2])
        values = OmegaConf.to_container(config, resolve=True)
    except (HydraException, OmegaConfBaseException, YAMLError, ValueError, TypeError) as error:
        # The last three are of files of the user's.
        raise UserError(message_of(error)) from None
    assert isinstance(values, dict)
    return Composed({str(k): v for k, v in values.items()}, choices, overrides)


@cache
def _composed(files: Files, search_path: str, *overrides: str) -> tuple[DictConfig, dict[str, str]]:
    _store()
    with hydra_at_configs():
        given = [override for override in (search_path, *overrides) if override]
        config = compose(config_files.PRIMARY, given, return_hydra_config=True)
    choices = {k: str(v) for k, v in config.hydra.runtime.choices.items()}
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    return config, choices


@contextmanager
def hydra_at_configs(job_name: str = "app") -> Iterator[Any]:
    """Hydra at `configs/`, also while it runs the command. It is one for all threads, and
    afterwards as it was."""
    with _using_hydra:
        backup = GlobalHydra.instance().hydra
        GlobalHydra.instance().clear()
        try:
            place = str(config_files.CONFIG_DIR)
            with initialize_config_dir(place, job_name=job_name, version_base="1.3"):
                hydra = GlobalHydra.instance().hydra
                assert hydra is not None
                yield hydra
        finally:
            GlobalHydra.instance().hydra = backup


def config(name: str) -> tuple[dict[str, Any], Written | None]:
    """A configuration of `layers`, such as `agent/impala`: its values, and how it is written; None
    for one that is registered in Python."""
    group, _, choice = name.rpartition("/")
    if node := _nodes().get(name):
        return node.values, node.written
    return _registered()[group][choice], None


def layers(*overrides: str) -> Layers:
    """What the configuration of these overrides, which can be composed, is composed of."""
    _store()
    with hydra_at_configs() as hydra:
        loader = hydra.config_loader
        given = [override for override in (search_path(), *overrides) if override]
        found = loader.compute_defaults_list(config_files.PRIMARY, given, RunMode.RUN)
    configs = [
        (one.config_path, "" if one.package in (None, "_global_") else one.package)
        for one in found.defaults
        if one.config_path is not None and not one.config_path.startswith("hydra/")
    ]
    made = found.overrides.override_metadata
    chosen = {
        group: made[group].containing_config_path or "" if group in made else one.parent
        for one in found.defaults
        if (group := one.override_key) and (group in made or one.parent)
    }
    return Layers(configs, chosen)


def message_of(error: Exception) -> str:
    """What Hydra has to say, on one line."""
    message = " ".join(str(error).split()).partition(" Config search path:")[0]
    if re.search(f"Could not find '({'|'.join(['environment', *config_files.parts()])})/", message):
        message += "; one of your own has to be registered by a plugin: plugins=[<module>]"
    if "hydra/launcher" in message:
        message += (
            ' (joblib and submitit come with an extra: pip install ".[sweep]" in a clone of zipf)'
        )
    return message


def options_class(group: str, name: str) -> type[Options]:
    """The class of options of a choice that is registered in Python."""
    if group == "environment":
        return envs.families()[name].options_class
    return registries()[group].options[name]


def _registered() -> dict[str, dict[str, dict[str, Any]]]:
    """The registered choices by group and name, with their default values. Those of the package
    itself are in `configs/`, so that they are known before their modules are imported."""
    return {
        "environment": {
            name: {"split": family.splits[0].name, **_defaults(family.options_class)}
            for name, family in envs.families().items()
            if family.splits
        },
        **{
            group: {
                name: {"name": name, **_defaults(options)}
                for name, options in registry.options.items()
                if _has_defaults(options)
            }
            for group, registry in registries().items()
        },
    }


# Hydra copies the whole store, which is one for all, for each configuration that it composes, and
# copies each part again as it takes it. The first took two fifths of the time.
ConfigStore.__deepcopy__ = lambda self, _: self  # type: ignore[attr-defined]


def _store() -> None:
    """Stores what is written, and what is registered, where Hydra finds it."""
    global _stored
    store, nodes = ConfigStore.instance(), _nodes()
    if nodes is not _stored:
        for path in _stored.keys() - nodes.keys():
            _forget(path)
        for path, node in nodes.items():
            group, _, name = path.rpartition("/")
            store.store(group=group or None, name=name, node=node.values, package=node.package)
        _stored = nodes
    for group, known in _registered().items():
        for name, values in known.items():
            if find(group, name) is None:
                place = config_files.package(group, name)
                store.store(group=group, name=name, node=values, package=place)


def _forget(path: str) -> None:
    """Takes a configuration from where Hydra finds it."""
    *groups, name = path.split("/")
    known = ConfigStore.instance().repo
    for group in groups:
        known = known.get(group, {})
    known.pop(f"{name}.yaml", None)


_stored: dict[str, config_files.Node] = {}  # what was stored last


def _files() -> Files:
    """All files of configurations. A link to nowhere is told where it is read; a hidden one, of an
    editor, is not."""
    places = ("*.yaml", "*/*.yaml")
    folders = config_files.folders()
    files = (path for folder in folders for one in places for path in sorted(folder.glob(one)))
    return tuple((path, path.stat().st_mtime_ns) for path in files if path.exists())


def _nodes() -> dict[str, config_files.Node]:
    return _nodes_of(tuple(config_files.folders()), _files())


@cache
def _nodes_of(folders: tuple[Path, ...], files: Files) -> dict[str, config_files.Node]:
    """The configurations in these folders, with files of these times."""
    return config_files.nodes()


def _has_defaults(options: type[Options]) -> bool:
    fields = options.model_fields.items()
    return all(name == "name" or not field.is_required() for name, field in fields)


def _defaults(options: type[Options]) -> dict[str, Any]:
    return {
        name: field.get_default(call_default_factory=True)
        for name, field in options.model_fields.items()
        if name != "name"
    }
