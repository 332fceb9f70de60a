"""The base class of the rules of a level."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

import numpy as np

from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.world import World


class Episode(ABC):
    """The rules of a level, for one episode of one env.

    The constructor builds what stays for the episode, then `begin_map` what a map begins with. A
    map ends with `World.finish_map`; the clock goes on. `rng` is for this episode's layout.
    """

    def __init_subclass__(cls) -> None:
        cls.__doc__ = cls.__doc__ or cls.__mro__[1].__doc__  # of a variant: that of what it varies

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.world = world

    @abstractmethod
    def begin_map(self, rng: np.random.Generator) -> None:
        """Places the player and everything that a map begins with."""

    @abstractmethod
    def act(self, known: Knowledge) -> int:
        """What the level's scripted policy does now: one of the fifteen actions.

        It knows the rules, the instruction, and of the state of the env what `known` says: the
        expert everything, to show that the level can be solved; the generalist what it has seen.
        """

    def guess(self, number: int) -> int | None:
        """What one does now who acts as the expert but guesses the answer: the one with this
        number, from 0. None: the level asks for no answer."""
        return None

    def aside(self) -> int | None:
        """The action with which the expert steps aside where it is stuck; None: it never is."""
        return None

    def renewed(self) -> Iterable[Cell]:
        """Cells of the text map that a new map may have changed."""
        return ()

    def picked_up(self, item: int) -> None:  # noqa: B027
        """The player has touched an item, which is gone now."""

    def entered(self, zone: int) -> None:  # noqa: B027
        """The player has entered a zone."""

    def scored(self, points: int) -> None:  # noqa: B027
        """The player has won or lost a point in combat: 1 or -1."""

    def went_off(self) -> None:  # noqa: B027
        """The timer has gone off."""

    def looked_at(self, widget: int) -> None:  # noqa: B027
        """The player's gaze has entered a widget of the screen."""

    def looked_away(self, widget: int) -> None:  # noqa: B027
        """The player's gaze has left a widget of the screen."""
