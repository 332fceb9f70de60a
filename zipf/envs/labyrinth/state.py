"""The state of a batch of labyrinths, as the arrays that the compiled functions work on.

Lengths are in DeepMind Lab's units, of which a cell of a text map has 100 and a second of running
covers 320; x east, y north, z up. Yaw 0 looks along +x and grows counter-clockwise, positive pitch
looks up; both are in radians.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.lasertag.arena import Combat, make_combat
from zipf.envs.labyrinth.words import VOCABULARY

FRAMES_PER_SECOND = 60
CELL = 100.0
"""Side of a cell and height of a wall of a text map."""

X, Y, Z, VX, VY, VZ, YAW, PITCH = range(8)
"""Columns of `bodies`: the point 24 above the soles, its velocity per second, where it looks."""

TOUCH_X, TOUCH_Y, TOUCH_Z = 40.0, 36.0, 36.0
"""An item is touched within these distances of the player's point. The original's reach along x is
from -50 to 44; approximated by a symmetric one."""
GRID = 21  # most rows and columns of a text map
ITEMS, BOXES, PLANES, PILLARS, ZONES = 184, 64, 16, 100, 10
QUADS = 63
WIDGETS = 4
"""Capacities of each env."""


class Envs(NamedTuple):
    """The state of N envs."""

    clock: NDArray[np.int64]  # [N]: frames since the episode began
    limit: NDArray[np.int64]  # [N]: frames of an episode
    ending: NDArray[np.int64]  # [N]: frames until the level ends the episode; -1: it does not
    finishing: NDArray[np.bool_]  # [N]: whether the next frame begins with a new map
    bodies: NDArray[np.float64]  # [N, 8], columns X .. PITCH
    pushed: NDArray[np.int64]  # [N]: frames without friction that are left, after a teleport
    cells: NDArray[np.int64]  # [N, 2]: rows and columns of the text map; 0, 0: there is none
    solid: NDArray[np.bool_]  # [N, GRID, GRID], rows to the north
    opaque: NDArray[np.bool_]
    """[N, GRID, GRID]: cells that hide what is behind them: walls that are drawn, closed doors."""
    floor: NDArray[np.float64]  # [N, GRID, GRID]: heights of the cells' floors
    boxes: NDArray[np.float64]  # [N, BOXES, 6]: solid boxes, their lowest and highest corners
    see_through: NDArray[np.bool_]
    """[N, BOXES]: boxes that hide nothing, or of which `opaque` tells."""
    box_count: NDArray[np.int64]  # [N]
    planes: NDArray[np.float64]
    """[N, PLANES, 3]: walls of a convex room, x and y of the outward normal and its distance from
    the origin."""
    plane_count: NDArray[np.int64]  # [N]
    pillars: NDArray[np.float64]  # [N, PILLARS, 3]: x, y and radius of solid upright pillars
    pillar_count: NDArray[np.int64]  # [N]
    quad: NDArray[np.float64]  # [N]: side of a terrain's quads; 0: there is no terrain
    heights: NDArray[np.float64]  # [N, QUADS + 1, QUADS + 1]: of a terrain, rows to the north
    held: NDArray[np.bool_]  # [N]: whether the player stands on a platform that holds it
    hold: NDArray[np.float64]  # [N, 3]: where it holds the player
    places: NDArray[np.float64]  # [N, ITEMS, 3]: where items are
    present: NDArray[np.bool_]  # [N, ITEMS]: whether an item is there
    touchable: NDArray[np.bool_]
    """[N, ITEMS]: whether an item that is there can be touched, or only seen."""
    returning: NDArray[np.int64]
    """[N, ITEMS]: the frame at which an item is there again; -1: it does not return."""
    zones: NDArray[np.float64]
    """[N, ZONES, 6]: boxes that tell when the player enters; empty ones are nowhere."""
    inside: NDArray[np.bool_]  # [N, ZONES]: whether the player is inside
    timer: NDArray[np.int64]  # [N]: the frame at which the timer goes off; -1: it is off
    screen: NDArray[np.float64]
    """[N, 4]: x, y and z of the middle of a square screen that faces south, and its side; a side of
    0: there is none."""
    widgets: NDArray[np.float64]
    """[N, WIDGETS, 4]: left, top, right and bottom of parts of the screen that tell when they are
    looked at, as shares of its side from the top left corner; empty ones are nowhere."""
    watched: NDArray[np.int64]  # [N]: the widget that the player looks at; -1: none
    instruction: NDArray[np.int64]
    """[N, 16]: the codes of the instruction's words, see `words.VOCABULARY`; 0: there is none."""
    combat: Combat  # laser tag


# By array, its shape behind [N] and what its entries are at first.
_AT_FIRST: dict[str, tuple[tuple[int, ...], float]] = {
    "clock": ((), 0), "limit": ((), 1), "ending": ((), -1), "finishing": ((), False),
    "bodies": ((8,), 0.0), "pushed": ((), 0), "cells": ((2,), 0),
    "solid": ((GRID, GRID), False), "opaque": ((GRID, GRID), False), "floor": ((GRID, GRID), 0.0),
    "boxes": ((BOXES, 6), 0.0), "see_through": ((BOXES,), False), "box_count": ((), 0),
    "planes": ((PLANES, 3), 0.0), "plane_count": ((), 0),
    "pillars": ((PILLARS, 3), 0.0), "pillar_count": ((), 0),
    "quad": ((), 0.0), "heights": ((QUADS + 1, QUADS + 1), 0.0),
    "held": ((), False), "hold": ((3,), 0.0), "places": ((ITEMS, 3), 0.0),
    "present": ((ITEMS,), False), "touchable": ((ITEMS,), False), "returning": ((ITEMS,), -1),
    "zones": ((ZONES, 6), 0.0), "inside": ((ZONES,), False), "timer": ((), -1),
    "screen": ((4,), 0.0), "widgets": ((WIDGETS, 4), 0.0), "watched": ((), -1),
    "instruction": ((VOCABULARY.length,), 0),
}  # fmt: skip


def make_envs(num_envs: int) -> Envs:
    """The state of envs in which no episode has begun."""
    n = num_envs
    arrays = {name: np.full((n, *shape), first) for name, (shape, first) in _AT_FIRST.items()}
    return Envs(**arrays, combat=make_combat(n, GRID))


def clear(envs: Envs, i: int) -> None:
    """Empties an env for a new episode."""
    for name, (_, first) in _AT_FIRST.items():
        getattr(envs, name)[i] = first
    envs.combat.fighters[i] = 0
