"""Modules that import a name when it is first asked for, and modules that can be called."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any


def lazily(
    module: str, places: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a module, which shows `__all__` and no name that it only uses.

    Args:
        module: its name.
        places: for each name that is imported when it is first asked for, the module that has it,
            or that it is.
    """

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        found = import_module(places[name])
        return found if places[name] == f"{module}.{name}" else getattr(found, name)

    def names() -> list[str]:
        known = vars(sys.modules[module])
        return sorted({*known["__all__"], *(name for name in known if name.startswith("__"))})

    return get, names


def callable_as(module: str, function: Callable[..., Any]) -> None:
    """Lets a module be called as a function of its own is.

    Importing `zipf.report`, by whatever name in it, makes `zipf.report` the module. So the module
    itself is the function, too, and `zipf.report("runs/")` does not depend on what was imported.
    """

    class Called(ModuleType):
        __call__ = staticmethod(function)

    sys.modules[module].__class__ = Called
    vars(sys.modules[module])["__signature__"] = inspect.signature(function)
