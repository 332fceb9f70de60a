"""The expert without the instruction: it shows what a policy that cannot read can score."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.playroom.expert import Expert, require_playable
from zipf.envs.playroom.vector import PlayroomVectorEnv

_OF_OBJECTS = ("ranks", "objects", "orientation", "status", "still", "lifted")
"""The arrays of `Worlds` that have an entry for each object."""


class BlindExpert:
    """Solves the episodes of `env` as if another instruction had been given: any toy of the room as
    the target, and any task of the level.

    Args:
        env: asked at every step from the first of an episode on.
        seed: of the choice of toys and tasks.

    Raises:
        ValueError: as for `Expert`.
    """

    def __init__(self, env: PlayroomVectorEnv, seed: int = 0) -> None:
        require_playable(env, "blind expert")
        self.env = env
        self.generator = np.random.default_rng(seed)
        n, count = env.worlds.ranks.shape
        self.order = np.tile(np.arange(count), (n, 1))  # of the objects, the believed target first
        self.tasks = env.worlds.task.copy()
        believed: Any = SimpleNamespace(
            num_envs=n, worlds=self._worlds(), rooms=[None] * n, lengths=env.lengths,
            single_action_space=env.single_action_space,
        )  # fmt: skip
        self.believed = believed
        self.expert = Expert(believed)

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every world, int64 [N]."""
        env = self.env
        for i in np.flatnonzero(env.lengths == 0).tolist():
            target = int(self.generator.integers(self.order.shape[1]))
            self.order[i] = np.arange(self.order.shape[1])
            self.order[i, [0, target]] = target, 0
            if env.level.tasks:
                self.tasks[i] = self.generator.choice(env.level.tasks)
        self.believed.worlds = self.expert.worlds = self._worlds()
        self.believed.lengths = env.lengths
        for world, room in enumerate(env.rooms):
            assert room is not None
            objects = [room.objects[j] for j in self.order[world]]
            self.believed.rooms[world] = SimpleNamespace(agent=room.agent, objects=objects)
        return self.expert()

    def _worlds(self) -> Any:
        """The worlds with their objects in the believed order."""
        worlds = self.env.worlds
        rows = np.arange(len(self.order))[:, None]
        swapped = {name: getattr(worlds, name)[rows, self.order] for name in _OF_OBJECTS}
        hands = worlds.hands.copy()
        held = hands >= 0
        # An exchange of two is its own inverse.
        hands[held] = self.order[held, hands[held]]
        return worlds._replace(**swapped, hands=hands, task=self.tasks)
