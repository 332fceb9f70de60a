"""What a scripted policy knows of a labyrinth: everything, or what has been in view."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.actions import DEGREES_PER_PIXEL
from zipf.envs.labyrinth.in_view import NEVER, nearest_unseen
from zipf.envs.labyrinth.steering import BACKWARD, MARGIN, NAMES, Point, Ways, walk_to
from zipf.envs.labyrinth.world import World

_LEVEL = math.radians(10 * 4 * DEGREES_PER_PIXEL)  # what a step of four frames looks up or down
_THERE = 60.0  # units from a spot at which it is reached


@dataclass(frozen=True)
class Memory:
    """What the generalist remembers of N envs."""

    # wide, high: tangents of half the field of view across and upwards
    wide: float
    high: float
    # int64 [N, QUADS, QUADS], the frame at which a cell was seen last, or NEVER
    seen_at: NDArray[np.int64]
    # bool [N, ITEMS], items seen since they last appeared, or the map began
    known: NDArray[np.bool_]
    ever: NDArray[np.bool_]  # bool [N, ITEMS], items seen in the episode
    # float64 [N], how far it has turned to the right, looking around, radians
    turned: NDArray[np.float64]
    # int64 [N], how often it has looked around, or points of a tour that were reached
    turns: NDArray[np.int64]
    walks: NDArray[np.bool_]  # bool [N], whether it walks to a spot to look around from
    still: NDArray[np.int64]  # int64 [N], steps in which it has hardly moved
    freeing: NDArray[np.int64]  # int64 [N], steps left of leaving a place where it was stuck


class Knowledge:
    """What a scripted policy knows of one env, in addition to the rules of its level, the
    instruction, where it is itself and what it has taken: what has been in view."""

    def __init__(self, memory: Memory, world: World, number: int) -> None:
        self._memory = memory
        self._env = world
        self._i = number

    def knows(self, item: int) -> bool:
        """Whether an item was seen since it last appeared, or the map began."""
        return bool(self._memory.known[self._i, item])

    def has_seen(self, item: int) -> bool:
        """Whether an item was seen in this episode."""
        return bool(self._memory.ever[self._i, item])

    def seen(self, rows: int, columns: int) -> NDArray[np.bool_]:
        """Cells of a grid of so many that were seen."""
        seen: NDArray[np.bool_] = self._memory.seen_at[self._i, :rows, :columns] > NEVER
        return seen

    def faces(self, x: float, y: float) -> bool:
        """Whether a point is ahead, not beside the view or behind it."""
        own_x, own_y, yaw, _ = self._env.player
        off = (math.atan2(y - own_y, x - own_x) - yaw + math.pi) % (2 * math.pi) - math.pi
        return math.tan(min(abs(off), 1.5)) <= self._memory.wide

    def explore(self, solid: NDArray[np.bool_], *, size: float, margin: float = MARGIN) -> int:
        """The action that leads to the nearest cell that was not seen yet; where there is none, to
        the one that was seen last the longest time ago. What was not seen of `solid` does not
        count."""
        upright = self._towards(0.0)
        if upright is not None:
            return upright
        rows, columns = solid.shape
        seen_at = self._memory.seen_at[self._i, :rows, :columns]
        believed = solid & (seen_at > NEVER)
        ways = Ways(believed, [], size=size, margin=margin)
        x, y, *_ = self._env.player
        cell = nearest_unseen(believed, seen_at, *ways.cell_of(x, y))
        ways.add(cell)
        return ways.walk_to(self._env, cell)

    def search(
        self,
        spots: Sequence[Point] = (),
        walk: Callable[[Point], int] | None = None,
        pitches: Sequence[float] = (0.0,),
    ) -> int:
        """The action that looks around: a full turn at each pitch, radians, then another at the
        next of the spots, again and again. `walk` is the action that leads to a spot; None: there
        are no spots."""
        memory, i = self._memory, self._i
        if memory.turned[i] >= 2 * math.pi:
            memory.turned[i] = 0.0
            memory.turns[i] += 1
            memory.walks[i] = walk is not None and memory.turns[i] % len(pitches) == 0
        if walk is not None and memory.walks[i]:
            spot = spots[(memory.turns[i] // len(pitches) - 1) % len(spots)]
            x, y, *_ = self._env.player
            if math.dist(spot, (x, y)) > _THERE and memory.still[i] < 8:
                memory.turned[i] = 0.0
                return walk(spot)
            memory.walks[i] = False
        upright = self._towards(pitches[memory.turns[i] % len(pitches)])
        return NAMES["look right"] if upright is None else upright

    def tour(self, points: Sequence[Point]) -> int:
        """The action that walks to one point after another, in straight lines."""
        memory, i = self._memory, self._i
        x, y, *_ = self._env.player
        if math.dist(points[memory.turns[i] % len(points)], (x, y)) < _THERE:
            memory.turns[i] += 1
        return walk_to(self._env, *points[memory.turns[i] % len(points)])

    def free(self) -> int | None:
        """The action that leaves a place where the player is stuck; None where it is not."""
        left = int(self._memory.freeing[self._i])
        if left == 0:
            return None
        return BACKWARD if left > 4 else NAMES["strafe right"]

    def _towards(self, pitch: float) -> int | None:
        """The action that brings the view to this pitch; None if it is there."""
        above = pitch - self._env.player[3]
        if abs(above) <= 0.51 * _LEVEL:
            return None
        return NAMES["look up" if above > 0 else "look down"]


class _Everything(Knowledge):
    """The expert's: it has to look for nothing, so that it neither explores, searches nor tours,
    and it frees itself, see `Expert`."""

    def __init__(self) -> None:
        pass

    def knows(self, item: int) -> bool:
        return True

    def has_seen(self, item: int) -> bool:
        return True

    def seen(self, rows: int, columns: int) -> NDArray[np.bool_]:
        return np.ones((rows, columns), np.bool_)

    def faces(self, x: float, y: float) -> bool:
        return True

    def free(self) -> None:
        return None


EVERYTHING = _Everything()
