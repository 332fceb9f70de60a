"""Plugins: modules whose import registers families, agents, their parts and configurations.

A module becomes a plugin by an entry point of the group `zipf.plugins` in its package's metadata,

    [project.entry-points."zipf.plugins"]
    my_worlds = "my_package.worlds"

or, without packaging, by being named on the command line: `plugins=[my_module]`. It registers by
calling `zipf.envs.register`, `zipf.agents.register`, `register_configs`, and the `register` of a
group's registry (`zipf.registry`), such as `zipf.agents.memory.MEMORIES.register`.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path

GROUP = "zipf.plugins"

_config_folders: list[Path] = []
_installed_are_loaded = False


def load(modules: Iterable[str]) -> None:
    """Imports these modules and those of installed packages' entry points, each once.

    Raises:
        ImportError: a module cannot be imported; names it and says why.
    """
    global _installed_are_loaded
    if "" not in sys.path and os.getcwd() not in sys.path:  # a sweep's worker process
        sys.path.insert(0, os.getcwd())
    if not _installed_are_loaded:
        for entry in entry_points(group=GROUP):
            _import(entry.value)
        _installed_are_loaded = True
    for module in modules:
        _import(module)


def register_configs(folder: str | Path) -> None:
    """Adds a folder laid out like `configs/`: its experiments, conditions and so on can be chosen.

    Raises:
        ValueError: there is no such folder.
    """
    path = Path(folder).resolve()
    if not path.is_dir():
        raise ValueError(f"register_configs: there is no folder {path}")
    if path not in _config_folders:
        _config_folders.append(path)


def config_folders() -> list[Path]:
    """The folders that were added by `register_configs`."""
    return list(_config_folders)


def _import(module: str) -> None:
    if not module or module.startswith(".") or module.endswith(".py") or "/" in module:
        raise ImportError(f"{module!r}: should be a module's name: my_module, not ./my_module.py")
    try:
        importlib.import_module(module)
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        inside = [frame for frame in frames if "importlib" not in frame.filename]
        where = f" ({inside[-1].filename}, line {inside[-1].lineno})" if len(inside) > 1 else ""
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            where = "; it should be in the current folder, or installed"
        raise ImportError(f"{module}: {type(error).__name__}: {error}{where}") from error
