"""Morris's water maze: find the hidden platform, then come back to it."""

from __future__ import annotations

import math

import numpy as np

from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.steering import walk_to
from zipf.envs.labyrinth.world import World

APOTHEM, SIDES, HEIGHT = 760.0, 16, 192.0
STARTS, START_RADIUS = 8, 710.0
PLATFORM, RADIUS, RISE = 128.0, 580.0, 94.0
"""Side of the platform, how far from the middle it may be, how high it rises."""
FIRST_TICK, TICK, TICKS = 0.2, 0.4, 6
"""Seconds to the first point and from one to the next; with the last tick a new map begins."""
_CIRCLES = tuple(
    (radius * math.cos(2 * math.pi * k / 16), radius * math.sin(2 * math.pi * k / 16))
    for radius in (560.0, 450.0, 340.0, 230.0, 120.0, 10.0)
    for k in range(16)
)
"""The way of a player that looks for the platform: a path as wide as it is from the wall to the
middle."""


class Watermaze(Episode):
    """Goal: reach the hidden platform as often as possible; it stays where it is.

    Layout: a large round room with blue water. Eight different pictures hang on the wall.
    Rules: the platform is invisible until the player steps on it. Then the platform rises and holds
    the player for about two seconds, which pays five points. After that a new map begins: the
    player is put at one of eight places along the wall, facing a random way. Only the time limit
    ends the episode.
    Rewards: +1, five times for each visit of the platform.
    Approximated: points come every 0.4 s (the original's timer is irregular), and the player is
    held at once. The floor has the water's colour: there is no sheet of it above, and no ceiling.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        world.add_ring(APOTHEM, SIDES, HEIGHT, "wall_7", tint=(150, 185, 255))
        side = APOTHEM + 40
        world.add_floor((-side, -side), (side, side), "floor_4", tint=(120, 170, 255), repeat=200)
        for k in range(STARTS):
            angle = 2 * math.pi * k / STARTS
            picture = materials.index("picture_0") + k * 11 % materials.PICTURES
            world.add_picture(APOTHEM - 3, angle, 96.0, 130.0, picture)
        self.platform = world.add_item(
            "platform", colours=((225, 220, 190), (150, 140, 110)), spins=False, seen_only=True
        )
        angle, radius = rng.uniform(0, 2 * np.pi), RADIUS * math.sqrt(rng.random())
        self.place = radius * math.cos(angle), radius * math.sin(angle)
        self.found = False
        x, y = self.place
        half = PLATFORM / 2 - 15.0  # a zone is entered by the edge of the player's box
        world.add_zone((x - half, y - half, 0.0), (x + half, y + half, 60.0))

    def begin_map(self, rng: np.random.Generator) -> None:
        self.world.take(self.platform)
        angle = 2 * math.pi * int(rng.integers(STARTS)) / STARTS
        start = START_RADIUS * math.cos(angle), START_RADIUS * math.sin(angle)
        self.world.place_player(*start, float(rng.uniform(0, 2 * np.pi)))
        self.points = 0

    def entered(self, zone: int) -> None:
        self.found = True
        x, y = self.place
        self.world.hold_player(x, y, RISE)
        self.world.put(self.platform, x, y)
        self.world.set_timer(FIRST_TICK)

    def went_off(self) -> None:
        self.points += 1
        if self.points == TICKS:
            self.world.finish_map()
            return
        self.world.reward(1)
        self.world.set_timer(TICK)

    def act(self, known: Knowledge) -> int:
        """Walks to the platform, or in circles until it is found."""
        if known is EVERYTHING or self.found:
            return walk_to(self.world, *self.place)
        return known.tour(_CIRCLES)
