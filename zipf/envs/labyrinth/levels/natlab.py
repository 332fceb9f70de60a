"""The natlab levels: gather mushrooms in a hilly desert."""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.steering import NAMES, WAIT, Ways, walk_to
from zipf.envs.labyrinth.terrain import Terrain, make_terrain
from zipf.envs.labyrinth.world import World

POOL = 100  # how many terrains the varying levels draw from
SMALL, LARGE = 2048.0, 3600.0
"""Sides of a terrain, units; that of the fixed one is inferred from a camera of the original."""
_CAP: tuple[Colour, Colour] = ((246, 238, 226), (214, 190, 160))
_PLANTS: dict[str, tuple[Colour, Colour]] = {
    "cactus": ((70, 130, 70), (110, 170, 90)),
    "rock": ((150, 116, 92), (120, 92, 74)),
    "bush": ((120, 130, 60), (90, 104, 50)),
}
DAYLIGHT: dict[str, tuple[Colour, tuple[Colour, Colour]]] = {
    "day": ((255, 255, 255), ((206, 226, 240), (115, 165, 220))),
    "dawn": ((228, 168, 150), ((240, 190, 150), (150, 130, 170))),
    "night": ((90, 92, 128), ((28, 34, 66), (8, 10, 26))),
}
"""Tint of the ground, colours of the sky at the horizon and overhead."""


class Natlab(Episode):
    """Goal: gather as many mushrooms as possible.

    Layout: a hilly desert of 2048 units with cacti, rocks and bushes, enclosed by invisible walls.
    Rules: slopes that are too steep cannot be climbed. The player starts in one of ten places,
    looking anywhere.
    Rewards: +1 for a mushroom.
    Approximated: terrains are drawn; their hills, plants and mushrooms have the statistics of those
    of the original that could be read.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.terrain, time = self.choose(rng)
        ground, sky = DAYLIGHT[time]
        world.add_terrain(self.terrain, "sand", tint=ground, sky=sky)
        for prop in self.terrain.props:
            main, accent = _PLANTS[prop.mesh.split("_")[0]]
            item = world.add_item(
                prop.mesh,
                colours=(_shaded(main, ground), _shaded(accent, ground)),
                scale=prop.scale,
                spins=False,
                seen_only=True,
            )
            world.put(item, prop.x, prop.y, self.terrain.height(prop.x, prop.y), yaw=prop.yaw)
            if prop.radius:
                world.add_pillar(prop.x, prop.y, prop.radius)
        self.mushrooms = {
            world.add_item("mushroom", colours=_CAP, spins=False): place
            for place in self.terrain.mushrooms
        }
        self.waits = self.draw_waits(rng)

    @abstractmethod
    def choose(self, rng: np.random.Generator) -> tuple[Terrain, str]:
        """The terrain of an episode and its time of day."""

    def draw_waits(self, rng: np.random.Generator) -> dict[int, tuple[float, np.random.Generator]]:
        """For each mushroom that comes back, its mean wait in seconds and what draws the rest."""
        return {}

    def begin_map(self, rng: np.random.Generator) -> None:
        for item, (x, y) in self.mushrooms.items():
            self.world.put(item, x, y, self.terrain.height(x, y))
        x, y = self.terrain.starts[int(rng.integers(len(self.terrain.starts)))]
        self.world.place_player(x, y, float(rng.uniform(0, 2 * np.pi)), self.terrain.height(x, y))

    def picked_up(self, item: int) -> None:
        self.world.reward(1)
        if item in self.waits:
            wait, rng = self.waits[item]
            self.world.let_return(item, wait + float(rng.uniform(-1, 1)) * wait / 2)

    def act(self, known: Knowledge) -> int:
        """Walks to the mushroom to which the way is shortest."""
        x, y, *_ = self.world.player
        freeing = known.free()
        if freeing is not None:
            return freeing
        there = [
            place
            for item, place in self.mushrooms.items()
            if self.world.is_there(item) and known.knows(item)
        ]
        solid = ~self.terrain.walkable
        if not there and known is EVERYTHING:
            return WAIT
        if not there:
            return known.explore(solid, size=self.terrain.size, margin=12.0)
        near = min(there, key=lambda place: math.dist(place, (x, y)))
        if math.dist(near, (x, y)) < 60:
            return walk_to(self.world, *near)
        believed = solid & known.seen(*solid.shape)
        ways = Ways(believed, [], size=self.terrain.size, margin=12.0)
        own = ways.cell_of(x, y)
        ways.add(own)
        cells = [ways.cell_of(*place) for place in there]
        reached = [k for k, cell in enumerate(cells) if ways.distances[own][cell] >= 0]
        if not reached:
            return walk_to(self.world, *near)
        best = min(reached, key=lambda k: ways.distances[own][cells[k]])
        ways.add(cells[best])
        return ways.walk_to(self.world, cells[best])

    def aside(self) -> int:
        return NAMES["strafe left" if len(self.mushrooms) % 2 else "strafe right"]


class FixedLargeMap(Natlab):
    """Goal: gather as many mushrooms as possible in a desert that is always the same.

    Layout: one hilly desert of 3600 units with 80 mushrooms, at dawn, by day or at night.
    Rules, rewards and what is approximated: as `Natlab`. Size and number of mushrooms are not
    known of the original.
    """

    def choose(self, rng: np.random.Generator) -> tuple[Terrain, str]:
        return make_terrain(0, LARGE, (80, 80)), list(DAYLIGHT)[int(rng.integers(3))]


class VaryingMapRegrowth(Natlab):
    """Goal: gather as many mushrooms as possible, and return where they grow again.

    Layout: one of 100 hilly deserts with 5 to 30 mushrooms.
    Rules: as `Natlab`; a mushroom grows again in the same place after 24 to 108 s.
    Rewards and what is approximated: as `Natlab`.
    """

    def choose(self, rng: np.random.Generator) -> tuple[Terrain, str]:
        number = int(rng.integers(POOL))
        return make_terrain(1 + number, SMALL, (5, 30)), _time_of_day(number)

    def draw_waits(self, rng: np.random.Generator) -> dict[int, tuple[float, np.random.Generator]]:
        return {item: (float(rng.uniform(48, 72)), rng) for item in self.mushrooms}


class VaryingMapRandomized(Natlab):
    """Goal: gather all mushrooms of an unknown desert.

    Layout: one of 100 hilly deserts with 10 to 75 mushrooms.
    Rules, rewards and what is approximated: as `Natlab`.
    """

    def choose(self, rng: np.random.Generator) -> tuple[Terrain, str]:
        number = int(rng.integers(POOL))
        return make_terrain(1001 + number, SMALL, (10, 75)), _time_of_day(number)


def _time_of_day(number: int) -> str:
    """Of a map: 40 % night, 35 % day, 25 % dawn, as in the maps that could be read."""
    return "night" if number % 20 < 8 else "day" if number % 20 < 15 else "dawn"


def _shaded(colour: Colour, light: Colour) -> Colour:
    red, green, blue = (int(c * t / 255) for c, t in zip(colour, light, strict=True))
    return red, green, blue
