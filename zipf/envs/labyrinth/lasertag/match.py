"""A match of laser tag in one env, as the rules of a level and its expert see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zipf.envs import pcg64
from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.lasertag.arena import (
    FIGHTERS,
    GADGET,
    HEALTH,
    LOADED,
    NOTHING,
    SUPPLIES,
    TAGGED_AT,
    clear_combat,
)
from zipf.envs.labyrinth.lasertag.fight import respawn
from zipf.envs.labyrinth.lasertag.sight import in_view
from zipf.envs.labyrinth.lasertag.view import COLOURS, SUPPLY_MESHES, opponents_colours
from zipf.envs.labyrinth.state import ITEMS, VX, VY, X, Y
from zipf.envs.labyrinth.world import World


@dataclass(frozen=True)
class Supply:
    """A gadget or supply that lies there."""

    item: int  # its number
    kind: int  # ORB, BEAM, DISC, HEALTH_PACK or ARMOUR_PACK
    x: float
    y: float


class Match:
    """Lets the player and some opponents fight each other in a text map without items.

    Args:
        spawns: cells where fighters begin.
        supplies: kinds and cells.
        hue: of the opponents, degrees.
        seed: of all that is random.
    """

    def __init__(
        self,
        world: World,
        opponents: int,
        spawns: list[Cell],
        supplies: list[tuple[int, Cell]],
        hue: int,
        seed: int,
    ) -> None:
        self._env, self._i = world, world._number
        self._envs = world._envs
        self.combat = combat = self._envs.combat
        i = self._i
        clear_combat(combat, i)
        combat.fighters[i] = 1 + opponents
        combat.stream[i] = pcg64.stream(seed)
        combat.spawn_count[i] = len(spawns)
        combat.spawns[i, : len(spawns)] = spawns
        for k in range(SUPPLIES):
            kind, cell = supplies[k] if k < len(supplies) else (NOTHING, None)
            shown = kind if kind != NOTHING else len(COLOURS) - 1
            item = world.add_item(SUPPLY_MESHES[shown], colours=COLOURS[shown], seen_only=True)
            combat.kinds[i, k] = kind
            if cell is not None:
                world.put_in_cell(item, cell)
        paint = world._scenery.scenes.colours[i, ITEMS:]
        paint[: 2 * (FIGHTERS - 1)] = opponents_colours(hue) * (FIGHTERS - 1)

    def begin(self) -> None:
        """Puts all fighters where they begin."""
        combat = self.combat
        combat.status[self._i, :, TAGGED_AT] = 0
        for fighter in range(int(combat.fighters[self._i])):
            respawn(combat, self._i, fighter)
        self._envs.bodies[self._i] = combat.bodies[self._i, 0]

    # What oracles read.

    def is_up(self, fighter: int) -> bool:
        """Whether a fighter is there, not tagged; fighter 0 is the player."""
        return bool(self.combat.status[self._i, fighter, TAGGED_AT] < 0)

    @property
    def enemies(self) -> list[int]:
        """The opponents that are there."""
        return [f for f in range(1, int(self.combat.fighters[self._i])) if self.is_up(f)]

    def place(self, fighter: int) -> tuple[float, float]:
        """x and y of a fighter."""
        body = self.combat.bodies[self._i, fighter]
        return float(body[X]), float(body[Y])

    def velocity(self, fighter: int) -> tuple[float, float]:
        """Of a fighter along x and y, units per second."""
        body = self.combat.bodies[self._i, fighter]
        return float(body[VX]), float(body[VY])

    def in_view(self, fighter: int) -> bool:
        """Whether no wall is between the player and a fighter."""
        solid: NDArray[np.bool_] = self._envs.solid[self._i]
        return bool(in_view(solid, *self.place(0), *self.place(fighter)))

    def health(self, fighter: int) -> int:
        """Of a fighter."""
        return int(self.combat.status[self._i, fighter, HEALTH])

    @property
    def gadget(self) -> int:
        """The player's, in hand."""
        return int(self.combat.status[self._i, 0, GADGET])

    def loaded(self, gadget: int) -> int:
        """Shots that the player has for a gadget."""
        return int(self.combat.status[self._i, 0, LOADED + gadget])

    @property
    def supplies(self) -> list[Supply]:
        """What lies there."""
        kinds, places = self.combat.kinds[self._i], self._envs.places[self._i]
        there = np.flatnonzero((kinds != NOTHING) & self._envs.present[self._i, :SUPPLIES])
        return [
            Supply(k, int(kinds[k]), float(places[k, 0]), float(places[k, 1]))
            for k in there.tolist()
        ]
