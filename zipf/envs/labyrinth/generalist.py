"""The scripted generalist of all levels: the expert, knowing what has been in view."""

import math

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth import in_view
from zipf.envs.labyrinth.expert import batch_of
from zipf.envs.labyrinth.in_view import NEVER
from zipf.envs.labyrinth.knowledge import Knowledge, Memory
from zipf.envs.labyrinth.scenery import FIELD_OF_VIEW
from zipf.envs.labyrinth.state import CELL, ITEMS, QUADS, YAW, X, Y
from zipf.envs.labyrinth.steering import WAIT
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.mixture import Mixture
from zipf.envs.remembering import Remembering

_MOVED = 5.0  # units a step; a player that moves less is stuck
_STUCK, _FREEING = 12, 10  # steps without moving, and those that leave such a place


class Generalist(Remembering):
    """Plays all envs of a batch from what has been in view: `Generalist(env)()` is actions [N].

    It does what the level's expert does with what it has seen, see `Episode.act`, and explores or
    looks around until it has seen enough. It knows the rules of the level, the instruction, where
    it is and how large a text map is, and of cells, items and opponents those that were in the
    image and not behind something else (`in_view.py`). Of a map's walls what was seen stays
    remembered as long as the map does.

    It may be asked in envs in which another policy acts, also where a task is drawn at every reset.
    It then remembers what was in view at every step at which it was asked. Raises ValueError: the
    batch has another number of actions than fifteen, or is of another family.
    """

    remembered = (
        *("_seen_at", "_known", "_ever", "_turned", "_turns", "_walks", "_still", "_freeing"),
        *("_seeds", "_maps", "_lengths", "_poses"),
    )

    def __init__(self, env: LabyrinthVectorEnv | Mixture) -> None:
        self.env = batch = batch_of(env, "generalist")
        n = batch.num_envs
        height, width = batch.single_observation_space["image"].shape[:2]  # type: ignore[index]
        wide = math.tan(math.radians(FIELD_OF_VIEW) / 2)
        self._seen_at = np.full((n, QUADS, QUADS), NEVER, np.int64)
        self._known, self._ever = np.zeros((2, n, ITEMS), np.bool_)
        self._turned = np.zeros(n)
        self._turns, self._still, self._freeing = np.zeros((3, n), np.int64)
        self._walks = np.zeros(n, np.bool_)
        self.memory = Memory(
            wide, wide * height / width, self._seen_at, self._known, self._ever, self._turned,
            self._turns, self._walks, self._still, self._freeing,
        )  # fmt: skip
        # The episode and the map that are remembered, and when and where this was last called.
        self._seeds = np.full(n, -1.0)
        self._maps, self._lengths = np.full((2, n), -1, np.int64)
        self._poses = np.zeros((n, 3))

    def __call__(self) -> NDArray[np.int64]:
        """Actions, int64 [N]; 0 in envs without an episode."""
        env = self.env
        actions = np.zeros(env.num_envs, np.int64)
        for i, episode in enumerate(env.episodes):
            if episode is None:
                continue
            self._follow(i)
            self._look(i)
            known = Knowledge(self.memory, episode.world, i)
            actions[i] = WAIT if env.envs.finishing[i] else episode.act(known)
        return actions

    def _follow(self, i: int) -> None:
        """Forgets what may be otherwise now, and notices how the player has moved."""
        env = self.env
        x, y, yaw = env.envs.bodies[i, [X, Y, YAW]]
        length, number = int(env._lengths[i]), int(env.maps[i])
        same = env.seeds[i] == self._seeds[i] and length >= self._lengths[i]
        if not same:
            self._seen_at[i] = NEVER
            self._known[i] = self._ever[i] = False
            self._turns[i] = 0
        if not same or number != self._maps[i]:
            self._known[i] = self._walks[i] = False
            self._turned[i], self._still[i], self._freeing[i] = 0.0, 0, 0
            episode = env.episodes[i]
            assert episode is not None
            for row, column in episode.renewed():
                self._seen_at[i, row, column] = NEVER
        elif length > self._lengths[i]:
            before_x, before_y, before = self._poses[i]
            right = (before - yaw + math.pi) % (2 * math.pi) - math.pi
            self._turned[i] = max(self._turned[i] + right, 0.0)
            moved = math.hypot(x - before_x, y - before_y) > _MOVED
            self._still[i] = 0 if moved else self._still[i] + 1
            self._freeing[i] = max(self._freeing[i] - 1, 0)
            if self._still[i] == _STUCK:
                self._still[i], self._freeing[i] = 0, _FREEING
        self._seeds[i], self._maps[i], self._lengths[i] = env.seeds[i], number, length
        self._poses[i] = x, y, yaw

    def _look(self, i: int) -> None:
        envs, memory = self.env.envs, self.memory
        body, now = envs.bodies[i], int(envs.clock[i])
        seen_at, opaque = self._seen_at[i], envs.opaque[i]
        view = body, memory.wide, memory.high, now, seen_at
        rows, columns = envs.cells[i]
        if rows:
            own_row, own_column = int(body[Y] // CELL), int(body[X] // CELL)
            if 0 <= own_row < rows and 0 <= own_column < columns:
                seen_at[own_row, own_column] = now
            if opaque.any():
                in_view.see_cells(opaque[:rows, :columns], *view)
            else:
                in_view.see_floors(envs.floor[i], rows, columns, *view)
        elif envs.quad[i]:
            in_view.see_ground(envs.heights[i], envs.quad[i], *view)
        in_view.see_items(
            envs, i, opaque, envs.see_through[i], memory.wide, memory.high, self._known[i]
        )
        self._ever[i] |= self._known[i]
