"""What the language levels share: a task a map, its objects, and an expert that reads the judge."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.layouts import Layout, Theme, build_layout
from zipf.envs.labyrinth.patterns import SOLID, rgb, shaded
from zipf.envs.labyrinth.state import CELL, GRID
from zipf.envs.labyrinth.steering import Ways
from zipf.envs.labyrinth.tasks import Judge, Object
from zipf.envs.labyrinth.words import COLOURS, SHAPES

MEDIUM = {"car": 0.8, "cassette": 0.95, "chair": 0.84, "cow": 0.81}
"""Scales of shapes that are not of their own size when they are medium."""
CONTEXT = {"colours": COLOURS, "shapes": SHAPES}  # words of all levels but the described one


@dataclass(frozen=True)
class Task:
    """A task of one map."""

    layout: Layout  # of the map
    theme: Theme  # its look
    objects: Sequence[Object]  # all of them
    places: Sequence[int | None]  # the slot of each object; None: it is nowhere
    text: str  # the instruction
    judge: Judge  # by numbers of objects
    # numbers of the objects that cannot be taken
    seen_only: frozenset[int] = field(default=frozenset())
    # numbers of the objects that neither bob nor turn
    still: frozenset[int] = field(default=frozenset())


class LanguageEpisode(Episode):
    """Maps with a task each. Derived classes draw the tasks."""

    turn: float = 2 * math.pi
    """The player starts looking eastwards give or take half of this, radians."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Task:
        """The task of a new map."""

    def begin_map(self, rng: np.random.Generator) -> None:
        world = self.world
        self.task = task = self.draw(rng)
        layout = task.layout
        world.clear()
        build_layout(world, layout, task.theme, rng)
        self.items: dict[int, int] = {}  # the object of each item
        for number, (one, slot) in enumerate(zip(task.objects, task.places, strict=True)):
            if slot is not None:
                item = self._add(number, one, rng)
                self.items[item] = number
                world.put_in_cell(item, layout.slots[slot])
        start = layout.starts[int(rng.integers(len(layout.starts)))]
        world.place_player_in_cell(start, float(rng.uniform(-self.turn / 2, self.turn / 2)))
        world.say(task.text)

    def _add(self, number: int, one: Object, rng: np.random.Generator) -> int:
        first = rgb(one.colour, rng)
        return self.world.add_item(
            one.shape,
            colours=(first, shaded(first) if one.pattern == SOLID else rgb(one.colour2, rng)),
            scale=MEDIUM.get(one.shape, 1.0),
            spins=number not in self.task.still,
            seen_only=number in self.task.seen_only,
            pattern=one.pattern,
        )

    def picked_up(self, item: int) -> None:
        reward, over = self.task.judge.take(self.items[item])
        self.world.reward(reward)
        if over:
            self.world.finish_map()

    def act(self, known: Knowledge) -> int:
        """Walks to the nearest goal around the cells of other objects."""
        task = self.task
        blocked = task.layout.solid & known.seen(*task.layout.solid.shape)
        there = [number for item, number in self._there() if known.knows(item)]
        others = [one for one in there if one not in task.judge.goals]
        goals = [one for one in there if one in task.judge.goals and self._is_told(one, known)]
        if goals:
            return self._fetch(goals, others, blocked)
        self._block(blocked, others)
        return known.explore(blocked, size=CELL)

    def guess(self, number: int) -> int | None:
        """Fetches the likeliest object by what there is to see; there is no second answer."""
        if number:
            return None
        # In the order of their slots: that of their numbers would tell the goals, which are first.
        there = sorted((number for _, number in self._there()), key=self._slot)
        wanted = self.likeliest(there)
        there.remove(wanted)
        return self._fetch([wanted], there, self.task.layout.solid.copy())

    def likeliest(self, there: Sequence[int]) -> int:
        """What one takes who sees the objects, of which these are there, and cannot read."""
        return there[0]

    def _there(self) -> Iterator[tuple[int, int]]:
        """Items that can be taken, and the numbers of their objects."""
        for item, number in self.items.items():
            if self.world.is_there(item) and number not in self.task.seen_only:
                yield item, number

    def _fetch(
        self, wanted: Iterable[int], others: Iterable[int], blocked: NDArray[np.bool_]
    ) -> int:
        """Walks to the nearest of the wanted objects, of several the first, around the others."""
        self._block(blocked, others)
        cells = [self._cell(number) for number in wanted]
        ways = Ways(blocked, cells)
        return ways.walk_to(self.world, ways.nearest(self.world, cells))

    def _block(self, blocked: NDArray[np.bool_], objects: Iterable[int]) -> None:
        for number in objects:
            blocked[self._cell(number)] = True

    def _cell(self, number: int) -> Cell:
        return self.task.layout.slots[self._slot(number)]

    def _slot(self, number: int) -> int:
        slot = self.task.places[number]
        assert slot is not None
        return slot

    def renewed(self) -> Iterable[Cell]:
        return ((int(row), int(column)) for row, column in np.ndindex(GRID, GRID))

    def _is_told(self, number: int, known: Knowledge) -> bool:
        """Whether what has been seen tells that an object is a goal: itself, where the instruction
        is about what it looks like; what it may stand near, or what a question is about, where it
        is about these."""
        task = self.task
        others = [item for item, other in self.items.items() if other in task.seen_only]
        if " near " in task.text:
            slots, regions = task.places, task.layout.slot_regions
            own = slots[number]
            assert own is not None
            others = [
                item
                for item, other in self.items.items()
                if (slot := slots[other]) is not None and regions[slot] == regions[own]
            ]
        return all(known.has_seen(item) for item in others)
