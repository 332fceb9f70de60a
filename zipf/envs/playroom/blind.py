"""The expert without the instruction: it shows what a policy that cannot read can score."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.playroom.expert import Expert, require_playable
from zipf.envs.playroom.falling import STILL_STEPS
from zipf.envs.playroom.vector import PlayroomVectorEnv

_OF_OBJECTS = ("ranks", "objects", "orientation", "status", "still", "lifted")
"""The arrays of `Envs` that have an entry for each object."""


class BlindExpert:
    """Solves the episodes of `env` as if another instruction had been given: any toy of the room as
    the target, and any task of the level. Where that did not end the episode, it goes on with
    another toy or task, until all have been tried, in a random order. It is to be
    asked at every step from the first of an episode on. Raises ValueError: as for `Expert`."""

    def __init__(self, env: PlayroomVectorEnv) -> None:
        require_playable(env, "blind expert")
        self.env = env
        self.generator = np.random.default_rng(0)
        n, count = env.envs.ranks.shape
        tasks = env.level.tasks or (0,)
        # Every guess: a toy and a task. `guesses` has their order in each env.
        self.all = np.array([(toy, task) for toy in range(count) for task in tasks])
        self.guesses = np.tile(np.arange(len(self.all)), (n, 1))
        self.number = np.zeros(n, np.int64)  # of the guess, in that order
        self.held = np.zeros(n, np.bool_)  # whether its toy has been in the hand
        self.order = np.tile(np.arange(count), (n, 1))  # of the objects, the believed target first
        self.tasks = env.envs.task.copy()
        believed: Any = SimpleNamespace(
            num_envs=n, envs=self._envs(), rooms=[None] * n, _lengths=env._lengths,
            single_action_space=env.single_action_space,
        )  # fmt: skip
        self.believed = believed
        self.expert = Expert(believed)

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every env, int64 [N]."""
        env = self.env
        for i in np.flatnonzero(env._lengths == 0).tolist():
            self.guesses[i] = self.generator.permutation(len(self.all))
            self._guess(i, 0)
        self.held |= env.envs.hands == self.order[:, 0]
        for i in np.flatnonzero(self._has_failed()).tolist():
            self._guess(i, (int(self.number[i]) + 1) % len(self.all))
        self.believed.envs = self.expert.envs = self._envs()
        self.believed._lengths = env._lengths
        for i, room in enumerate(env.rooms):
            assert room is not None
            objects = [room.objects[j] for j in self.order[i]]
            self.believed.rooms[i] = SimpleNamespace(agent=room.agent, objects=objects)
        return self.expert()

    def _guess(self, i: int, number: int) -> None:
        target, task = self.all[self.guesses[i, number]]
        self.number[i], self.held[i] = number, False
        self.order[i] = np.arange(self.order.shape[1])
        self.order[i, [0, target]] = target, 0
        self.tasks[i] = task

    def _has_failed(self) -> NDArray[np.bool_]:
        """Where the believed target has been carried and lies still, and nothing has ended, [N]."""
        envs, rows = self.env.envs, np.arange(len(self.order))
        target = self.order[:, 0]
        rests = envs.lifted[rows, target] & (envs.still[rows, target] >= STILL_STEPS)
        return self.held & (envs.hands < 0) & rests

    def _envs(self) -> Any:
        """The envs with their objects in the believed order."""
        envs = self.env.envs
        rows = np.arange(len(self.order))[:, None]
        swapped = {name: getattr(envs, name)[rows, self.order] for name in _OF_OBJECTS}
        hands = envs.hands.copy()
        held = hands >= 0
        # An exchange of two is its own inverse.
        hands[held] = self.order[held, hands[held]]
        return envs._replace(**swapped, hands=hands, task=self.tasks)
