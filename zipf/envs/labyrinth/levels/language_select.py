"""The language levels with one object to select: by its shape, or by its colour and its room's."""

from __future__ import annotations

import math

import numpy as np

from zipf.envs.labyrinth.layouts import (
    FOUR_ROOMS,
    SIX_ROOMS,
    TWO_AREAS,
    TWO_ROOMS,
    Theme,
    random_theme,
    read,
)
from zipf.envs.labyrinth.levels.language import CONTEXT, LanguageEpisode, Task
from zipf.envs.labyrinth.patterns import PATTERNS
from zipf.envs.labyrinth.tasks import (
    ANY_REGION,
    Context,
    Group,
    Judge,
    balanced,
    choice,
    diff,
    draw_objects,
    literal,
    place_anywhere,
    place_in_regions,
    random,
    same,
)
from zipf.envs.labyrinth.words import COLOURS
from zipf.envs.labyrinth.world import World

_DESCRIBED = read(
    """
    ..O.O
    P....
    ..O.O
    """
)
_ALL_COLOURS = (
    *("black", "gray", "white", "red", "orange", "brown", "yellow", "green"),
    *("cyan", "blue", "purple", "magenta", "pink"),
)
_NO_THEME = Theme({}, {})


class SelectDescribedObject(LanguageEpisode):
    """Goal: take the object that the instruction names.

    Layout: a room of 3 x 5 cells with pictures on its walls. Two objects stand in two of four
    cells, and the player looks at them.
    Rules: the objects have different shapes, of five, and two colours of thirteen each, mixed by
    one of nine patterns. The instruction is the shape of one of them, such as "car". Taking either
    object begins a new map with new objects.
    Rewards: +10 for the object that is named, -10 for the other.
    Approximated: the bitmaps of the patterns are ours, and so is how they are laid on a mesh: along
    the axis that each of its triangles faces most. Pictures on walls are drawn anew for each map.
    """

    turn = math.radians(20)
    context = Context(_ALL_COLOURS, ("cake", "car", "cassette", "hat", "tv"), PATTERNS)

    def draw(self, rng: np.random.Generator) -> Task:
        (goal,), (other,) = draw_objects(self.context, [{}, {"shape": diff(1)}], [1, 1], rng)
        places = place_anywhere([goal, other], _DESCRIBED.slot_regions, rng)
        judge = Judge({0}, 10, -10)
        return Task(_DESCRIBED, _NO_THEME, [goal, other], places, goal.shape, judge)


class SelectLocatedObject(LanguageEpisode):
    """Goal: take the object of the colour that is named, in the room whose floor is named.

    Layout: two areas of a room, or two, four or six rooms around corridors. Each has two objects
    in its corners and a floor of its own colour, of six, drawn anew for each map.
    Rules: objects have one colour of six, and any shape of forty. The instruction is "Pick the
    <colour> object in the <floor's colour> room"; that room has one such object, and an object of
    that colour stands in another room, too. Taking any object begins a new map: two rooms in two
    cases of four, four or six in one each.
    Rewards: +10 for the object that is named. For any other -3 with two rooms, else -1.
    Approximated: walls of rooms are drawn once in an episode, pictures on them for each map. An
    object's accent parts are darker than the rest.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.theme = random_theme("ABCDEF", rng)

    def draw(self, rng: np.random.Generator) -> Task:
        rooms = choice((2, 2, 4, 6), rng)
        if rooms == 2:
            layout = choice((TWO_AREAS, TWO_ROOMS), rng)
        else:
            layout = FOUR_ROOMS if rooms == 4 else SIX_ROOMS
        words = [COLOURS[k] for k in rng.permutation(len(COLOURS)).tolist()]
        floors = dict(zip(layout.regions, words, strict=False))
        groups: list[Group] = [
            {"region": random},
            {"region": same(1), "colour": diff(1)},
            {"region": diff(1), "colour": same(1)},
            {"region": same(3) if rooms == 2 else literal(ANY_REGION), "colour": same(2)},
            {},
        ]
        sizes = [1, 1, 1, 1, {2: 0, 4: 4, 6: 8}[rooms]]
        context = Context(**CONTEXT, regions=layout.regions)
        drawn = draw_objects(context, groups, sizes, rng)
        objects = [one for group in drawn for one in group]
        places = place_in_regions(objects, layout.slot_regions, rng)
        goal = objects[0]
        theme = Theme(
            {letter: f"floor_{word}" for letter, word in floors.items()}, self.theme.walls
        )
        text = f"Pick the {goal.colour} object in the {floors[goal.region]} room"
        return Task(layout, theme, objects, places, text, balanced(len(objects) - 1))
