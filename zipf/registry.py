"""Registries: the choices of a group of options, which plugins add to.

A choice is a class of options, whose `name: Literal["..."]` names it, and a function or class that
builds it. The group's module says what it is called with, and documents what comes out:

    from zipf.agents.memory import MEMORIES

    MEMORIES.register(MyOptions, MyMemory)  # called as MyMemory(options, inputs)

A choice whose options all have defaults needs no file: `memory=mine` finds it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field

from zipf.options import Options, name_of

Part = TypeVar("Part")

_registries: dict[str, Registry[Any]] = {}


class Registry(Generic[Part]):
    """The choices of one group, such as `memory`; there is one registry of a name. With `several` a
    run has any number of them, its options by name, and else one."""

    def __init__(self, group: str, *, several: bool = False):
        self.group = group
        self.several = several
        self._options: dict[str, type[Options]] = {}
        self._builds: dict[str, Callable[..., Part]] = {}
        _registries[group] = self

    @property
    def options(self) -> Mapping[str, type[Options]]:
        """Their classes of options by name, in the order in which they were registered."""
        return MappingProxyType(self._options)

    def register(self, options: type[Options], build: Callable[..., Part]) -> None:
        """Adds a choice, under the name in its options, a class with a field `name:
        Literal["..."]`. `build` makes the part from the options and what else the group's parts are
        made from. Raises ValueError: the options have no name, or the name is taken."""
        name = name_of(options)
        if name in self._options:
            raise ValueError(f"{self.group} {name!r} is already registered: {self._options[name]}")
        self._options[name], self._builds[name] = options, build

    def build(self, options: Any, *others: Any, **named: Any) -> Part:
        """The part that the options name. Raises ValueError: it does not fit the others."""
        return self._builds[options.name](options, *others, **named)

    def builds(self) -> Mapping[str, Callable[..., Part]]:
        """What builds each of the choices, by name."""
        return MappingProxyType(self._builds)

    def union(self) -> Any:
        """The type of the options of what is chosen from those registered now, for a pydantic
        model."""
        one: Any = Annotated[reduce(or_, self._options.values()), Field(discriminator="name")]
        return dict[str, one] if self.several else one


def registries() -> Mapping[str, Registry[Any]]:
    """All registries by their groups' names."""
    return MappingProxyType(_registries)
