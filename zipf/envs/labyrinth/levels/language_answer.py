"""The language level with questions: are all, is any, are most of the objects of that colour?"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from zipf.envs.labyrinth.layouts import Theme, random_theme, read
from zipf.envs.labyrinth.levels.language import CONTEXT, LanguageEpisode, Task
from zipf.envs.labyrinth.patterns import SOLID
from zipf.envs.labyrinth.tasks import (
    NOWHERE,
    Context,
    Group,
    Judge,
    Object,
    Rule,
    choice,
    common,
    counts,
    diff,
    draw_objects,
    literal,
    place_in_regions,
    same,
)
from zipf.envs.labyrinth.world import World

_LAYOUT = read(
    """
    .....O
    P..OO
    P..OO
    .....O
    """,
    """
    CCCCCA
    CCCDD
    CCCDD
    CCCCCB
    """,
)
_FLOORS = {"A": "floor_green", "B": "floor_red", "C": "floor_orange", "D": "floor_black"}
_YES, _NO = (Object(colour, colour, SOLID, region, "ball")
             for colour, region in (("white", "A"), ("black", "B")))  # fmt: skip
SHOWN = 4  # objects that a question is about

_IN_VIEW = {"region": literal("D")}


def _groups(*rules: dict[str, Rule]) -> tuple[Group, ...]:
    """Groups of objects to be seen, after one that only lends its words."""
    return {"region": literal(NOWHERE)}, *(_IN_VIEW | own for own in rules)


_ALL: tuple[Group, ...] = (
    _IN_VIEW | {"colour": common, "shape": common},
    _IN_VIEW | {"colour": diff(1), "shape": same(1)},
)
_SHAPES = _groups(
    {"colour": same(1), "shape": same(1)}, {"colour": diff(1), "shape": same(1)}, {"shape": diff(1)}
)
_THINGS = _groups({"colour": same(1)}, {"colour": diff(1)}, {"colour": diff(1)})
_MOSTLY = (
    ((1, 0, 0), (None, 0, None)),
    ((2, 0, 0), (None, 1, None)),
    ((3, 0, 0), (None, 1, None)),
    ((4, 0, 0), (None, 0, None)),
)
_NOT_MOSTLY = (
    ((0, 1, 0), (0, None, None)),
    ((0, 1, 0), (1, None, None)),
    ((0, 1, 0), (1, None, None)),
    ((0, 2, 0), (2, None, None)),
)
"""Least and most objects of the three groups, where most of the shape have the colour or not; all
as likely. As many of either count as not."""


def _all(rng: np.random.Generator, truth: bool) -> list[int]:
    return [SHOWN, 0] if truth else counts(SHOWN, (1, 1), rng)


def _some(rng: np.random.Generator, truth: bool) -> list[int]:
    if truth:
        return [1, *counts(SHOWN, (1, 0, 0), rng)]
    return [1, *counts(SHOWN, (0, 0, 0), rng, (0, None, None))]


def _most(rng: np.random.Generator, truth: bool) -> list[int]:
    least, most = choice(_MOSTLY if truth else _NOT_MOSTLY, rng)
    return [1, *counts(SHOWN, least, rng, most)]


Sizes = Callable[[np.random.Generator, bool], list[int]]
QUESTIONS: tuple[tuple[str, tuple[Group, ...], Sizes], ...] = (
    ("Are all {goal.shape} objects {goal.colour}?", _ALL, _all),
    ("Is any {goal.shape} {goal.colour}?", _SHAPES, _some),
    ("Is anything {goal.colour}?", _THINGS, _some),
    ("Are most {goal.shape} objects {goal.colour}?", _SHAPES, _most),
)
"""Words, groups and their sizes for the answers yes and no."""


class AnswerQuantitativeQuestion(LanguageEpisode):
    """Goal: answer the question: take the white ball for yes, the black one for no.

    Layout: a room with four objects on a black floor and two alcoves: in the one on the left, with
    a green floor, is a white ball, in the one on the right, with a red floor, a black one.
    Rules: the instruction is one of four questions, as likely each: are all, or most, of the
    objects of a shape of a colour, is any of a shape, is anything. As many as not is not most. Yes
    and no are as likely. The objects can be walked through. Either ball begins a new map with a
    new question.
    Rewards: +10 for the right answer, -10 for the wrong one.
    Approximated: the look of walls is drawn once in an episode, pictures on them for each map. An
    object's accent parts are darker than the rest.
    """

    turn = math.radians(20)

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.theme = Theme(_FLOORS, random_theme("ABCD", rng).walls)

    def draw(self, rng: np.random.Generator) -> Task:
        words, rules, sizes = choice(QUESTIONS, rng)
        truth = bool(rng.integers(2))
        context = Context(**CONTEXT, regions=_LAYOUT.regions)
        groups = draw_objects(context, rules, sizes(rng, truth), rng)
        objects = [_YES, _NO, *(one for group in groups for one in group)]
        places = place_in_regions(objects, _LAYOUT.slot_regions, rng)
        judge = Judge({0 if truth else 1}, 10, -10)
        return Task(
            _LAYOUT, self.theme, objects, places, words.format(goal=groups[0][0]), judge,
            seen_only=frozenset(range(2, len(objects))), still=frozenset((0, 1)),
        )  # fmt: skip

    def likeliest(self, there: Sequence[int]) -> int:
        """Yes where they all, or three of several shapes, have one colour: right in three questions
        of four."""
        shown = [one for one in self.task.objects[2:] if one.region != NOWHERE]
        same_colour = max(Counter(one.colour for one in shown).values())
        shapes = len({one.shape for one in shown})
        return 0 if same_colour == SHOWN or (same_colour == SHOWN - 1 and shapes > 1) else 1
