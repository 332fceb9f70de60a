"""Tasks in words: objects drawn by rules, their places, an instruction, and what a choice is worth.

A task has groups of objects in an order. Its objects are drawn group after group, and within a
group one after another; the attributes of an object in the order of `ATTRIBUTES`, each by a rule,
which may look at the objects drawn before. The objects then take slots of a map. Groups are counted
from 1. The original's attributes of reward and size are left out: no level draws them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from zipf.envs.labyrinth.patterns import SOLID

T = TypeVar("T")

ATTRIBUTES = ("colour", "colour2", "pattern", "region", "shape")
ANY_REGION, NOWHERE = "any", "nowhere"
"""Regions of objects that take any slot, and of those that only lend their words."""


@dataclass(frozen=True)
class Object:
    """An object: its shape, the two colours that its pattern mixes, and the region of its slot."""

    colour: str
    colour2: str
    pattern: str
    region: str
    shape: str


@dataclass(frozen=True)
class Context:
    """The values that attributes are drawn from."""

    colours: Sequence[str]
    shapes: Sequence[str]
    patterns: Sequence[str] = (SOLID,)
    regions: Sequence[str] = ()

    def values(self, attribute: str) -> Sequence[str]:
        """Those of an attribute."""
        if attribute in ("colour", "colour2"):
            return self.colours
        return {"pattern": self.patterns, "region": self.regions, "shape": self.shapes}[attribute]


@dataclass(frozen=True)
class Drawing:
    """What a rule may look at."""

    attribute: str  # the one whose value is asked for
    values: Sequence[str]  # what it is drawn from
    # the objects drawn so far, by group; the last one is the object's own
    groups: list[list[Object]]
    rng: np.random.Generator


Rule = Callable[[Drawing], str]  # picks the value of an attribute
Group = Mapping[str, Rule]
"""The rules of a group's objects, by attribute. Other regions are ANY_REGION, others random."""


def choice(values: Sequence[T], rng: np.random.Generator) -> T:
    """One of the values."""
    return values[int(rng.integers(len(values)))]


def literal(value: str) -> Rule:
    """That value."""
    return lambda drawing: value


def random(drawing: Drawing) -> str:
    """Any of the attribute's values."""
    return choice(drawing.values, drawing.rng)


def same(group: int) -> Rule:
    """The value of the first object of a group."""
    return lambda drawing: getattr(drawing.groups[group - 1][0], drawing.attribute)


def diff(*groups: int) -> Rule:
    """Any value that no object of these groups has."""

    def pick(drawing: Drawing) -> str:
        used = {
            getattr(one, drawing.attribute) for group in groups for one in drawing.groups[group - 1]
        }
        return choice([value for value in drawing.values if value not in used], drawing.rng)

    return pick


def common(drawing: Drawing) -> str:
    """Any value for the first object of the group, the same for the others."""
    own = drawing.groups[-1]
    return getattr(own[0], drawing.attribute) if own else random(drawing)


_DEFAULTS: Group = {name: random for name in ATTRIBUTES} | {"region": literal(ANY_REGION)}


def draw_objects(
    context: Context, groups: Sequence[Group], sizes: Sequence[int], rng: np.random.Generator
) -> list[list[Object]]:
    """The objects of a task by group, as the rules and the sizes of the groups say."""
    drawn: list[list[Object]] = []
    for rules, size in zip(groups, sizes, strict=True):
        drawn.append([])
        for _ in range(size):
            values = {}
            for name in ATTRIBUTES:
                drawing = Drawing(name, context.values(name), drawn, rng)
                values[name] = rules.get(name, _DEFAULTS[name])(drawing)
            drawn[-1].append(Object(**values))
    return drawn


def counts(
    total: int,
    least: Sequence[int],
    rng: np.random.Generator,
    most: Sequence[int | None] | None = None,
) -> list[int]:
    """Sizes of groups that sum to `total`.

    Each group has `least` at first. The groups are visited in one random order, again and again,
    and each gets a random share of what is left, up to `most` (None: any).
    """
    sizes = list(least)
    limits = [total if limit is None else limit for limit in most or [None] * len(sizes)]
    left = total - sum(sizes)
    if left < 0 or sum(limits) < total:
        raise ValueError(f"no sizes from {least} to {most} sum to {total}")
    order = rng.permutation(len(sizes)).tolist()
    while left:
        for k in order:
            highest = max(min(sizes[k] + left, limits[k]), sizes[k])
            size = int(rng.integers(sizes[k], highest + 1))
            left -= size - sizes[k]
            sizes[k] = size
    return sizes


# Placers: the slot of each object, of slots in the order of reading; None: it is nowhere.


def place_anywhere(
    objects: Sequence[Object], regions: Sequence[str], rng: np.random.Generator
) -> list[int | None]:
    """Any slots, whose regions these are, for objects in the order of their groups."""
    return rng.permutation(len(regions)).tolist()[: len(objects)]


def place_in_regions(
    objects: Sequence[Object], regions: Sequence[str], rng: np.random.Generator
) -> list[int | None]:
    """Any slots in the objects' regions; arguments as of `place_anywhere`."""
    free = list(range(len(regions)))
    places: list[int | None] = []
    for one in objects:
        if one.region == NOWHERE:
            places.append(None)
            continue
        fitting = [slot for slot in free if one.region in (ANY_REGION, regions[slot])]
        slot = choice(fitting, rng)
        free.remove(slot)
        places.append(slot)
    return places


# Judges.


@dataclass
class Judge:
    """What taking an object is worth: a goal `right`, any other `wrong`. Either ends the task."""

    goals: set[int]  # numbers of the objects that are right and still there
    right: int
    wrong: int

    def take(self, taken: int) -> tuple[int, bool]:
        """The reward of taking an object, and whether the task is over."""
        return (self.right if taken in self.goals else self.wrong), True


def balanced(others: int) -> Judge:
    """A judge by whom choices at random are worth about nothing: the goal, which is the first
    object, is worth 10, and there are so many others."""
    return Judge({0}, 10, -math.floor(10 / others + 0.5))


class CountingJudge(Judge):
    """Each goal is worth 1, the last one 10 more; it and any other object end the task."""

    LAST = 10

    def __init__(self, goals: set[int], others: int) -> None:
        super().__init__(goals, 1, -math.floor((len(goals) + self.LAST) / others + 0.5))

    def take(self, taken: int) -> tuple[int, bool]:
        if taken not in self.goals:
            return self.wrong, True
        self.goals.remove(taken)
        return (self.right, False) if self.goals else (self.right + self.LAST, True)
