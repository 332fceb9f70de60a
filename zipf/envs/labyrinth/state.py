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
GRID = 21
"""Most rows and columns of a text map."""
ITEMS, BOXES, PLANES, PILLARS, ZONES, TIMERS = 184, 64, 16, 100, 10, 4
QUADS = 63
WIDGETS = 4
"""Capacities of each env."""


class Envs(NamedTuple):
    """The state of N envs."""

    clock: NDArray[np.int64]
    """[N]: frames since the episode began."""
    limit: NDArray[np.int64]
    """[N]: frames of an episode."""
    ending: NDArray[np.int64]
    """[N]: frames until the level ends the episode; -1: it does not."""
    finishing: NDArray[np.bool_]
    """[N]: whether the next frame begins with a new map."""
    bodies: NDArray[np.float64]
    """[N, 8], columns X .. PITCH."""
    pushed: NDArray[np.int64]
    """[N]: frames without friction that are left, after a teleport."""
    cells: NDArray[np.int64]
    """[N, 2]: rows and columns of the text map; 0, 0: there is none."""
    solid: NDArray[np.bool_]
    """[N, GRID, GRID], rows to the north."""
    opaque: NDArray[np.bool_]
    """[N, GRID, GRID]: cells that hide what is behind them: walls that are drawn, closed doors."""
    floor: NDArray[np.float64]
    """[N, GRID, GRID]: heights of the cells' floors."""
    boxes: NDArray[np.float64]
    """[N, BOXES, 6]: solid boxes, their lowest and highest corners."""
    see_through: NDArray[np.bool_]
    """[N, BOXES]: boxes that hide nothing, or of which `opaque` tells."""
    box_count: NDArray[np.int64]
    """[N]"""
    planes: NDArray[np.float64]
    """[N, PLANES, 3]: walls of a convex room, x and y of the outward normal and its distance from
    the origin."""
    plane_count: NDArray[np.int64]
    """[N]"""
    pillars: NDArray[np.float64]
    """[N, PILLARS, 3]: x, y and radius of solid upright pillars."""
    pillar_count: NDArray[np.int64]
    """[N]"""
    quad: NDArray[np.float64]
    """[N]: side of a terrain's quads; 0: there is no terrain."""
    heights: NDArray[np.float64]
    """[N, QUADS + 1, QUADS + 1]: of a terrain, rows to the north."""
    held: NDArray[np.bool_]
    """[N]: whether the player stands on a platform that holds it."""
    hold: NDArray[np.float64]
    """[N, 3]: where it holds the player."""
    places: NDArray[np.float64]
    """[N, ITEMS, 3]: where items are."""
    present: NDArray[np.bool_]
    """[N, ITEMS]: whether an item is there."""
    touchable: NDArray[np.bool_]
    """[N, ITEMS]: whether an item that is there can be touched, or only seen."""
    returning: NDArray[np.int64]
    """[N, ITEMS]: the frame at which an item is there again; -1: it does not return."""
    zones: NDArray[np.float64]
    """[N, ZONES, 6]: boxes that tell when the player enters; empty ones are nowhere."""
    inside: NDArray[np.bool_]
    """[N, ZONES]: whether the player is inside."""
    timers: NDArray[np.int64]
    """[N, TIMERS]: the frame at which a timer goes off; -1: it is off."""
    screen: NDArray[np.float64]
    """[N, 4]: x, y and z of the middle of a square screen that faces south, and its side; a side of
    0: there is none."""
    widgets: NDArray[np.float64]
    """[N, WIDGETS, 4]: left, top, right and bottom of parts of the screen that tell when they are
    looked at, as shares of its side from the top left corner; empty ones are nowhere."""
    watched: NDArray[np.int64]
    """[N]: the widget that the player looks at; -1: none."""
    instruction: NDArray[np.int64]
    """[N, 16]: the codes of the instruction's words, see `words.VOCABULARY`; 0: there is none."""
    combat: Combat
    """Laser tag."""


def make_envs(num_envs: int) -> Envs:
    """The state of envs in which no episode has begun."""
    n = num_envs
    return Envs(
        clock=np.zeros(n, np.int64),
        limit=np.ones(n, np.int64),
        ending=np.full(n, -1, np.int64),
        finishing=np.zeros(n, np.bool_),
        bodies=np.zeros((n, 8)),
        pushed=np.zeros(n, np.int64),
        cells=np.zeros((n, 2), np.int64),
        solid=np.zeros((n, GRID, GRID), np.bool_),
        opaque=np.zeros((n, GRID, GRID), np.bool_),
        floor=np.zeros((n, GRID, GRID)),
        boxes=np.zeros((n, BOXES, 6)),
        see_through=np.zeros((n, BOXES), np.bool_),
        box_count=np.zeros(n, np.int64),
        planes=np.zeros((n, PLANES, 3)),
        plane_count=np.zeros(n, np.int64),
        pillars=np.zeros((n, PILLARS, 3)),
        pillar_count=np.zeros(n, np.int64),
        quad=np.zeros(n),
        heights=np.zeros((n, QUADS + 1, QUADS + 1)),
        held=np.zeros(n, np.bool_),
        hold=np.zeros((n, 3)),
        places=np.zeros((n, ITEMS, 3)),
        present=np.zeros((n, ITEMS), np.bool_),
        touchable=np.zeros((n, ITEMS), np.bool_),
        returning=np.full((n, ITEMS), -1, np.int64),
        zones=np.zeros((n, ZONES, 6)),
        inside=np.zeros((n, ZONES), np.bool_),
        timers=np.full((n, TIMERS), -1, np.int64),
        screen=np.zeros((n, 4)),
        widgets=np.zeros((n, WIDGETS, 4)),
        watched=np.full(n, -1, np.int64),
        instruction=np.zeros((n, VOCABULARY.length), np.int64),
        combat=make_combat(n, GRID),
    )


def clear(envs: Envs, i: int) -> None:
    """Empties an env for a new episode."""
    for name, value in (
        ("clock", 0), ("limit", 1), ("ending", -1), ("finishing", False), ("bodies", 0.0),
        ("pushed", 0), ("cells", 0), ("solid", False), ("opaque", False), ("floor", 0.0),
        ("see_through", False), ("box_count", 0),
        ("plane_count", 0), ("held", False), ("pillar_count", 0), ("quad", 0.0),
        ("touchable", False), ("present", False), ("returning", -1), ("zones", 0.0),
        ("inside", False), ("timers", -1), ("screen", 0.0), ("widgets", 0.0), ("watched", -1),
        ("instruction", 0),
    ):  # fmt: skip
        getattr(envs, name)[i] = value
    envs.combat.fighters[i] = 0
