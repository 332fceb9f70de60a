"""The language level with many kinds of tasks: pick an object, every one, one near another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zipf.envs.labyrinth.layouts import (
    FOUR_ROOMS,
    SIX_ROOMS,
    TWO_AREAS,
    TWO_ROOMS,
    Layout,
    random_theme,
)
from zipf.envs.labyrinth.levels.language import CONTEXT, LanguageEpisode, Task
from zipf.envs.labyrinth.tasks import (
    Context,
    CountingJudge,
    Group,
    Object,
    balanced,
    choice,
    common,
    counts,
    diff,
    draw_objects,
    place_anywhere,
    place_in_regions,
    random,
    same,
)
from zipf.envs.labyrinth.world import World

Words = Callable[[Object, Object, np.random.Generator], str]
"""An instruction about the first object of the first group and that of the second."""

_TWO, _FOUR, _SIX = (TWO_AREAS, TWO_ROOMS), (FOUR_ROOMS,), (SIX_ROOMS,)


@dataclass(frozen=True)
class Kind:
    """A kind of task."""

    weight: int  # how often there is such a task, of 19
    layouts: tuple[Layout, ...]  # any of these
    groups: tuple[Group, ...]  # rules; the first group are the goals
    # of the groups; None: two goals and two others at least, eight objects at most
    sizes: tuple[int, ...] | None
    words: Words  # the instruction
    every: bool = False  # whether all goals have to be taken

    @property
    def by_room(self) -> bool:
        """Whether objects stand in the rooms of their regions."""
        return "region" in self.groups[0]


def _form(words: str) -> Words:
    """An instruction with the attributes of the goal and of the other object filled in."""
    return lambda goal, other, rng: words.format(goal=goal, other=other)


_COLOUR_SHAPE = "{goal.colour} {goal.shape}"
_ANY_FORM = tuple(map(_form, ("{goal.colour}", "{goal.shape}", _COLOUR_SHAPE)))


def _pick(goal: Object, other: Object, rng: np.random.Generator) -> str:
    return choice(_ANY_FORM, rng)(goal, other, rng)


_UNLIKE: tuple[Group, ...] = ({}, {"colour": diff(1), "shape": diff(1)})
_HALF_ALIKE: tuple[Group, ...] = (
    {},
    {"colour": same(1), "shape": diff(1)},
    {"colour": diff(1), "shape": same(1)},
)
_ONE_SHAPE: tuple[Group, ...] = ({"shape": common}, {"shape": diff(1)})
_ONE_COLOUR: tuple[Group, ...] = ({"colour": common}, {"colour": diff(1)})
_NEAR_OF_TWO: tuple[Group, ...] = (
    {"region": random},
    {"region": same(1), "shape": diff(1)},
    {"region": diff(1), "shape": same(1)},
    {"region": same(3), "shape": diff(2)},
)
_SHAPE_NEAR_SHAPE: tuple[Group, ...] = (
    *_NEAR_OF_TWO,
    {"region": diff(1, 3), "shape": same(2)},
    {"region": same(5), "shape": diff(1)},
    {"region": diff(1, 3, 5), "shape": diff(1, 2)},
)
_SHAPE_NEAR_COLOUR: tuple[Group, ...] = (
    {"region": random},
    {"region": same(1), "colour": diff(1)},
    {"region": diff(1), "shape": same(1), "colour": diff(2)},
    {"region": same(3), "colour": diff(2)},
    {"region": diff(1, 3), "colour": same(2), "shape": diff(1)},
    {"region": same(5), "shape": diff(1)},
    {"region": diff(1, 3, 5), "shape": diff(1), "colour": diff(2)},
)
_COLOUR_NEAR_COLOUR: tuple[Group, ...] = (
    {"region": random},
    {"region": same(1), "colour": diff(1), "shape": same(1)},
    {"region": diff(1), "colour": same(1), "shape": same(1)},
    {"region": same(3), "colour": diff(2), "shape": same(1)},
    {"region": diff(1, 3), "colour": same(2), "shape": same(1)},
    {"region": same(5), "colour": diff(1), "shape": same(1)},
    {"region": diff(1, 3, 5), "colour": diff(1, 2), "shape": same(1)},
)
_EIGHT = (1, 1, 1, 1, 1, 1, 2)
_BOTH = _form(_COLOUR_SHAPE)
_EVERY_SHAPE, _EVERY_COLOUR = _form("Every {goal.shape}"), _form("Every {goal.colour} object")
_BY_SHAPES = _form("{goal.shape} near {other.shape}")
_BY_COLOUR = _form("{goal.shape} near {other.colour} object")
_BY_COLOURS = _form("{goal.colour} object near {other.colour} object")

KINDS = (
    Kind(2, _TWO, _UNLIKE, (1, 2), _pick),
    Kind(1, _FOUR, _UNLIKE, (1, 4), _pick),
    Kind(1, _SIX, _UNLIKE, (1, 8), _pick),
    Kind(2, _TWO, _HALF_ALIKE, (1, 1, 1), _BOTH),
    Kind(1, _FOUR, _HALF_ALIKE, (1, 3, 3), _BOTH),
    Kind(1, _SIX, _HALF_ALIKE, (1, 5, 5), _BOTH),
    Kind(2, _TWO, _ONE_SHAPE, (2, 2), _EVERY_SHAPE, every=True),
    Kind(1, _FOUR, _ONE_SHAPE, None, _EVERY_SHAPE, every=True),
    Kind(2, _TWO, _ONE_COLOUR, (2, 2), _EVERY_COLOUR, every=True),
    Kind(1, _FOUR, _ONE_COLOUR, None, _EVERY_COLOUR, every=True),
    Kind(2, _TWO, _NEAR_OF_TWO, (1, 1, 1, 1), _BY_SHAPES),
    Kind(1, _FOUR, _SHAPE_NEAR_SHAPE, _EIGHT, _BY_SHAPES),
    Kind(1, _FOUR, _SHAPE_NEAR_COLOUR, _EIGHT, _BY_COLOUR),
    Kind(1, _FOUR, _COLOUR_NEAR_COLOUR, _EIGHT, _BY_COLOURS),
)
_BY_WEIGHT = [kind for kind in KINDS for _ in range(kind.weight)]


class ExecuteRandomTask(LanguageEpisode):
    """Goal: do what the instruction says.

    Layout: the areas and rooms of the located level, with floors and walls that differ by room.
    Objects have one colour of six and any shape of forty.
    Rules: one of seven forms of instructions, for two, four or six rooms: pick an object by its
    colour, its shape or both; pick it by both where each alone would not do; take every object of
    a shape, or of a colour; take an object near another, that is in the same room, by shapes, by
    shape and colour, or by colours. A new map begins when the task is done or when a wrong object
    is taken.
    Rewards: +10 for an object to pick, -1 to -5 for a wrong one, so that choices at random are
    worth nothing. Where every object of a kind is to be taken, +1 for each and 10 more for the
    last, -2 to -8 for a wrong one.
    Approximated: looks of rooms are drawn once in an episode, pictures on walls for each map. An
    object's accent parts are darker than the rest.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.theme = random_theme("ABCDEF", rng)

    def draw(self, rng: np.random.Generator) -> Task:
        kind = choice(_BY_WEIGHT, rng)
        layout = choice(kind.layouts, rng)
        sizes = kind.sizes or counts(int(rng.integers(4, 9)), (2, 2), rng)
        context = Context(**CONTEXT, regions=layout.regions)
        groups = draw_objects(context, kind.groups, sizes, rng)
        objects = [one for group in groups for one in group]
        place = place_in_regions if kind.by_room else place_anywhere
        places = place(objects, layout.slot_regions, rng)
        goals, others = set(range(sizes[0])), len(objects) - sizes[0]
        judge = CountingJudge(goals, others) if kind.every else balanced(others)
        text = kind.words(groups[0][0], groups[1][0], rng)
        return Task(layout, self.theme, objects, places, text, judge)

    def likeliest(self, there: Sequence[int]) -> int:
        """An object that shares its colour with some and its shape with others; of an odd number,
        else one that shares neither; else of a shape that there are more of. And then those like
        it. Worth eight tenths of what reading is."""
        objects = self.task.objects
        taken = [one for number, one in enumerate(objects) if number not in there]
        for attribute in ("shape", "colour") if taken else ():
            value = getattr(taken[0], attribute)
            alike = [one for one in there if getattr(objects[one], attribute) == value]
            if alike:
                return alike[0]

        def evidence(number: int) -> tuple[int, bool, int]:
            one = objects[number]
            colour = sum(other.colour == one.colour for other in objects) - 1
            shape = sum(other.shape == one.shape for other in objects) - 1
            alone = len(objects) % 2 == 1 and colour == shape == 0
            return 2 * (colour > 0 and shape > 0) + alone, shape > 0, colour

        return max(there, key=evidence)
