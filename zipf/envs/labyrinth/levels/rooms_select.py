"""Two rooms: see an object in the first, take the other one in the second."""

from __future__ import annotations

import numpy as np

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.steering import walk_to
from zipf.envs.labyrinth.world import World

HEIGHT = 128.0
_FORMS = (
    "barbell coil cone crossbar cube cylinder double_prism glow_ball potcone prism_jack sphere "
    "toroid"
)
OBJECTS = tuple(f"{form}_{look}" for form in _FORMS.split() for look in range(3))
_COLOURS: tuple[tuple[Colour, Colour], ...] = (
    ((230, 60, 50), (250, 230, 90)),
    ((60, 190, 90), (240, 240, 240)),
    ((250, 150, 40), (70, 40, 120)),
)
"""Colours of the three looks of a form."""
_BLUE: Colour = (150, 185, 255)
_SAMPLES = ((40.0, 64.0), (40.0, -192.0))
_CHOICES = ((600.0, 64.0), (600.0, -192.0))
_PAD = (64.0, -64.0)
_ARRIVAL = (288.0, -64.0)


class SelectNonmatchingObject(Episode):
    """Goal: take the object that is not the one shown before.

    Layout: a room with a pad and, behind an invisible wall, an object on one of two stands; and a
    second room with two objects.
    Rules: stepping on the pad leads to the second room. One object there is the one shown, the
    other another of 36; the one shown stays the same for the whole episode. Taking either begins a
    new map, in the first room.
    Rewards: +1 for the pad, +10 for the other object, -10 for the one shown.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        for low, high in (
            ((-256.0, -256.0), (128.0, 128.0)),
            ((256.0, -128.0), (384.0, 0.0)),
            ((384.0, -248.0), (640.0, 128.0)),
        ):
            world.add_floor(low, high, "floor_11")
        world.add_room((-256.0, -256.0), (128.0, 128.0), HEIGHT, "wall_7", tint=_BLUE)
        world.add_room((384.0, -248.0), (640.0, 128.0), HEIGHT, "wall_7", tint=_BLUE,
                       open_sides="west")  # fmt: skip
        world.add_room((256.0, -128.0), (384.0, 0.0), HEIGHT, "wall_7", tint=_BLUE,
                       open_sides="east")  # fmt: skip
        for south, north in ((-288.0, -128.0), (0.0, 168.0)):
            world.add_block((344.0, south, 0), (384.0, north, HEIGHT), "wall_7", tint=_BLUE)
        for south, north in ((24.0, 104.0), (-232.0, -152.0)):
            world.add_block((0.0, south, 0), (80.0, north, 80.0), None)
        for place in (*_SAMPLES, *_CHOICES):
            stand = world.add_item(
                "item_stand", colours=((120, 120, 126), (80, 80, 86)), spins=False, seen_only=True
            )
            world.put(stand, *place)
        pad = world.add_item(
            "teleport_pad", colours=((250, 210, 40), (200, 60, 30)), spins=False, seen_only=True
        )
        world.put(pad, *_PAD)
        self.pad = world.add_zone((40.0, -88.0, 8.0), (88.0, -40.0, 48.0))
        self.match = int(rng.integers(len(OBJECTS)))
        colours = _COLOURS[0]
        self.sample = world.add_item(OBJECTS[self.match], colours=colours, seen_only=True)
        self.same, self.other = (world.add_item("cube_0", colours=colours) for _ in range(2))

    def begin_map(self, rng: np.random.Generator) -> None:
        other = int(rng.integers(len(OBJECTS) - 1))
        other += other >= self.match
        shown = (self.sample, self.match), (self.same, self.match), (self.other, other)
        for item, kind in shown:
            self.world.set_mesh(item, OBJECTS[kind])
            self.world.set_colours(item, _COLOURS[kind % 3])
        side, order = rng.integers(2, size=2).tolist()
        self.choices = _CHOICES[order], _CHOICES[1 - order]
        self.world.put(self.sample, *_SAMPLES[side], 8.0)
        self.world.put(self.same, *self.choices[0], 8.0)
        self.world.put(self.other, *self.choices[1], 8.0)
        self.world.place_player(-232.0, -64.0, 0.0)

    def entered(self, zone: int) -> None:
        self.world.reward(1)
        self.world.teleport(*_ARRIVAL, 0.0)

    def picked_up(self, item: int) -> None:
        self.world.reward(10 if item == self.other else -10)
        self.world.finish_map()

    def act(self, known: Knowledge) -> int:
        """Looks at the object that is shown, goes to the pad and takes the other one."""
        x, *_ = self.world.player
        if x < 200:
            seen = known.has_seen(self.sample)
            return walk_to(self.world, *_PAD) if seen else known.search()
        if not known.knows(self.same) and not known.knows(self.other):
            return known.search()
        return walk_to(self.world, *self.choices[1])

    def guess(self, number: int) -> int:
        x, *_ = self.world.player
        return walk_to(self.world, *(_PAD if x < 200 else _CHOICES[number]))
