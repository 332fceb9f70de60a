"""Plans of rooms, keys and doors in which the order of things matters.

After DeepMind Lab's generator, from its description. Approximated: at the last step a door goes
on the newest room if no step before has left room for a trap.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

Position = tuple[int, int]

COLOURS = {
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
    "white": (255, 255, 255),
    "black": (0, 0, 0),
}
SIDE = 3
"""Rows and columns of the lattice that rooms lie on."""
_EMPTY_ROOM = {1: 0.8, 2: 0.5, 3: 0.0}
_OBJECTS = 2  # of a room, at most


class _NoPlace(Exception):
    """The plan cannot be completed: begin anew."""


@dataclass
class Plan:
    """Rooms, what is in them, and how they are connected."""

    rooms: list[Position]  # the lattice position of each room, the start first
    keys: list[tuple[int, str]] = field(default_factory=list)  # room and colour of each key
    goal: int = 0  # the room with the goal
    # pairs of rooms, and the colour of the door between them or None
    links: dict[tuple[int, int], str | None] = field(default_factory=dict)


class _Planner:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        row, column = rng.integers(SIDE, size=2).tolist()
        self.plan = Plan([(row, column)])
        self.colours = [list(COLOURS)[k] for k in rng.permutation(len(COLOURS)).tolist()]
        self.traps: set[int] = set()  # rooms that the way to the goal does not lead through
        self.core: list[str] = []  # the colours of the doors on the way to the goal, in order
        self.entered: dict[int, int] = {}  # rooms behind these doors, and the place of the colour
        self.last = 0  # the room that the next door on the way is beside, or may be
        self.competitors: list[int] = []  # rooms whose door a trap may have, too
        self.has_empty = self.has_herring = self.has_trap = False

    def free_position(self, room: int) -> Position | None:
        """The free place beside a room that is nearest to the start."""
        row, column = self.plan.rooms[room]
        beside = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        free = [
            place
            for place in beside
            if 0 <= place[0] < SIDE and 0 <= place[1] < SIDE and place not in self.plan.rooms
        ]
        return self.nearest(free, free)

    def nearest(self, values: list, places: list[Position]):  # type: ignore[no-untyped-def]
        """The value whose place is nearest to the start; ties are drawn."""
        if not values:
            return None
        row, column = self.plan.rooms[0]
        far = np.array([(3 * (r - row)) ** 2 + (4 * (c - column)) ** 2 for r, c in places])
        return values[int(self.rng.choice(np.flatnonzero(far == far.min())))]

    def room_with_space(self, excluded: set[int]) -> int:
        rooms = [r for r in range(len(self.plan.rooms)) if r not in excluded]
        places = {room: place for room in rooms if (place := self.free_position(room))}
        found = self.nearest(list(places), list(places.values()))
        if found is None:
            raise _NoPlace
        return int(found)

    def add_room(self, beside: int, door: str | None) -> int:
        place = self.free_position(beside)
        if place is None:
            raise _NoPlace
        self.plan.rooms.append(place)
        room = len(self.plan.rooms) - 1
        self.plan.links[beside, room] = door
        return room

    def objects(self, room: int) -> int:
        return sum(where == room for where, _ in self.plan.keys) + (room == self.plan.goal > 0)

    def add_key(self, colour: str, rooms: list[int]) -> None:
        rooms = [room for room in rooms if self.objects(room) < _OBJECTS]
        if not rooms:
            raise _NoPlace
        self.plan.keys.append((int(self.rng.choice(rooms)), colour))

    def build(self) -> Plan:
        """Draws rooms, keys and doors; the plan may have no solution.
        Raises _NoPlace: the lattice has no room for what was drawn."""
        rng, plan = self.rng, self.plan
        length = int(rng.integers(1, 4))
        easy, useless, openable = rng.integers(0, 2, 3).tolist()
        self.core, free = self.colours[:length], self.colours[length:]
        for step in range(length):
            self.add_core_room(step)
        plan.goal = self.last
        for competitor in self.competitors:
            self.try_trap(competitor)
        try:
            for _ in range(easy):
                door = free[int(rng.integers(len(free)))]
                self.traps.add(self.add_room(self.room_with_space(set()), door))
            if not self.has_herring:
                self.add_herring()
        except _NoPlace:
            pass  # the lattice is full
        ways_in = set(plan.links)
        self.add_doors(free, openable)
        unopenable = {colour for link, colour in plan.links.items() if link not in ways_in}
        unused = [colour for colour in free if colour not in unopenable]
        space = [r for r in range(len(plan.rooms)) if self.objects(r) < _OBJECTS]
        if useless and unused and space:
            colour = unused[int(rng.integers(len(unused)))]
            plan.keys.append((space[int(rng.integers(len(space)))], colour))
        return plan

    def add_core_room(self, step: int) -> None:
        """A room of the way to the goal behind the next door, the key of that door, and sometimes
        what leads astray."""
        rng, colour, length = self.rng, self.core[step], len(self.core)
        empty = rng.random() < _EMPTY_ROOM[length]
        if empty and not self.has_empty and self.free_position(self.last):
            self.last, self.has_empty = self.add_room(self.last, None), True
        herring = rng.random() < 0.5 and not self.has_herring
        before = rng.random() < 0.5
        if herring and before:
            self.add_herring()
        others = [room for room in range(len(self.plan.rooms)) if room not in self.traps]
        if rng.random() < 0.5 and self.free_position(self.last):
            beside = self.last
            self.add_key(colour, others)
        else:
            self.add_key(colour, [self.last])
            # Without this door no later step could have the trap.
            needed = step == length - 1 and length > 1 and not (self.has_trap or self.competitors)
            if needed and self.free_position(self.last):
                beside = self.last
            else:
                beside = self.room_with_space(self.traps)
        room = self.add_room(beside, colour)
        if beside == self.last and self.entered:
            competitor = max(self.entered)  # the newest core room; `last` may be the empty one
            self.competitors.append(competitor)
            if not self.has_trap and rng.random() < 0.5:
                self.try_trap(competitor)
        self.entered[room] = step
        self.last = room
        if herring and not before:
            self.add_herring()

    def add_herring(self) -> None:
        """An empty room behind a door that takes a key of the way to the goal."""
        room = self.room_with_space(set())
        self.traps.add(self.add_room(room, self.core[int(self.rng.integers(len(self.core)))]))
        self.has_herring = True

    def try_trap(self, competitor: int) -> None:
        """A room with the same door as the competitor's, and a key that is needed later; nothing if
        there is one, or no place for it."""
        if self.has_trap:
            return
        step = self.entered[competitor]
        later = self.core[step + 1 :]
        older = [
            room
            for room in range(competitor)
            if room not in self.traps and self.free_position(room)
        ]
        if not older or not later:
            return
        trap = self.add_room(int(self.rng.choice(older)), self.core[step])
        self.plan.keys.append((trap, later[int(self.rng.integers(len(later)))]))
        self.traps.add(trap)
        self.has_trap = True

    def add_doors(self, free: list[str], openable: int) -> None:
        """Doors between rooms that lie side by side and are not connected yet."""
        plan = self.plan
        pairs = [
            (a, b)
            for a in range(len(plan.rooms))
            for b in range(a + 1, len(plan.rooms))
            if sum(abs(x - y) for x, y in zip(plan.rooms[a], plan.rooms[b], strict=True)) == 1
            and (a, b) not in plan.links
            and (b, a) not in plan.links
        ]
        drawn = [pairs[k] for k in self.rng.permutation(len(pairs)).tolist()]
        choices = [free, free, *[self.core] * openable]
        for pair, colours in zip(drawn, choices, strict=False):
            plan.links[pair] = colours[int(self.rng.integers(len(colours)))]


def random_plan(rng: np.random.Generator) -> Plan:
    """Draws a plan that can be solved."""
    while True:
        try:
            plan = _Planner(rng).build()
        except _NoPlace:
            continue
        if solve(plan):
            return plan


Step = tuple[str, int]
"""What to do next: take the "key" of that number, go through the "door" of that link, or take the
"goal"."""
GOAL_REWARD = 50


def solve(plan: Plan) -> tuple[int, list[Step]] | None:
    """The highest return of a plan and how to get it; None where the goal cannot be reached.

    Every key and every opened door is worth 1. Among ways to the same return, one with few steps.
    """
    links = list(plan.links.items())
    start = (0, 0, "", 0)  # room, keys taken, colour carried, doors opened
    came: dict[tuple, tuple[tuple, Step] | None] = {start: None}
    queue = deque([start])
    best: tuple[int, tuple] | None = None
    while queue:
        state = queue.popleft()
        room, taken, carried, opened = state
        if room == plan.goal:
            value = GOAL_REWARD + bin(taken).count("1") + bin(opened).count("1")
            if best is None or value > best[0]:
                best = value, state
        following: list[tuple[tuple, Step]] = []
        for k, (where, colour) in enumerate(plan.keys):
            if where == room and not taken >> k & 1:
                following.append(((room, taken | 1 << k, colour, opened), ("key", k)))
        for k, ((a, b), door) in enumerate(links):
            if room not in (a, b):
                continue
            other = b if room == a else a
            if door is None or opened >> k & 1:
                following.append(((other, taken, carried, opened), ("door", k)))
            elif door == carried:
                following.append(((other, taken, "", opened | 1 << k), ("door", k)))
        for state_after, step in following:
            if state_after not in came:
                came[state_after] = state, step
                queue.append(state_after)
    if best is None:
        return None
    value, state = best
    steps: list[Step] = [("goal", 0)]
    while (arrived := came[state]) is not None:
        state, step = arrived
        steps.append(step)
    return value, steps[::-1]
