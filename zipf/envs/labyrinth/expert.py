"""The scripted experts of all levels, for a batch of envs."""

import math

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import EVERYTHING
from zipf.envs.labyrinth.state import X, Y
from zipf.envs.labyrinth.steering import BACKWARD, WAIT
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.mixture import Mixture
from zipf.envs.remembering import Remembering
from zipf.envs.vector import ZipfVectorEnv

_STUCK = 12  # steps without moving after which it leaves a place
_BACK, _ASIDE = 6, 4  # steps back, then aside, with which it does


class Expert(Remembering):
    """Plays a batch with the fifteen actions by reading the state of its envs: an env's episode
    says what to do, `Episode.act`, also where a task is drawn at every reset.

    Of an episode it remembers where it was in the last steps at which it was asked, in levels where
    it can get stuck (`Episode.aside`). Raises ValueError: the batch has another number of actions
    than fifteen, or is of another family.
    """

    remembered = ("_trail", "_freeing", "_seeds", "_lengths")

    def __init__(self, env: LabyrinthVectorEnv | Mixture) -> None:
        self.env = batch_of(env, "expert")
        n = self.env.num_envs
        # Where it was, the present place last; nowhere at steps that are not remembered.
        self._trail = np.full((n, _STUCK + 1, 2), np.inf)
        self._freeing = np.zeros(n, np.int64)  # steps left, this one too, of leaving a place
        # The episode that is remembered, and when this was last called.
        self._seeds = np.full(n, -1.0)
        self._lengths = np.full(n, -1, np.int64)

    def __call__(self) -> NDArray[np.int64]:
        """Actions, int64 [N]; 0 in envs without an episode."""
        actions = np.zeros(self.env.num_envs, np.int64)
        for i, episode in enumerate(self.env.episodes):
            if episode is None:
                continue
            freeing = self._free(i, episode)
            if self.env.envs.finishing[i]:
                actions[i] = WAIT
            else:
                actions[i] = episode.act(EVERYTHING) if freeing is None else freeing
        return actions

    def _free(self, i: int, episode: Episode) -> int | None:
        """The action that leaves a place where the player is stuck; None where it is not."""
        aside = episode.aside()
        if aside is None:
            return None
        env, trail = self.env, self._trail[i]
        length = int(env._lengths[i])
        if env.seeds[i] != self._seeds[i] or length < self._lengths[i]:
            trail[:], self._freeing[i], self._lengths[i] = np.inf, 0, -1
        if length > self._lengths[i]:
            if math.dist(trail[0], trail[-1]) < 5:
                trail[:], self._freeing[i] = np.inf, _BACK + _ASIDE
            else:
                self._freeing[i] = max(self._freeing[i] - 1, 0)
            trail[:-1] = trail[1:]
            trail[-1] = env.envs.bodies[i, [X, Y]]
        self._seeds[i], self._lengths[i] = env.seeds[i], length
        left = self._freeing[i]
        if left == 0:
            return None
        return BACKWARD if left > _ASIDE else aside


def batch_of(env: LabyrinthVectorEnv | Mixture, player: str) -> LabyrinthVectorEnv:
    """The envs that a scripted policy reads. Raises ValueError: it cannot play them."""
    batch: ZipfVectorEnv = env
    if isinstance(env, Mixture):
        if env.engines.any():
            raise ValueError(f"the {player} plays levels with the same options, got several")
        batch = env.batches[0]  # they share their envs
    if not isinstance(batch, LabyrinthVectorEnv):
        raise ValueError(
            f"the {player} reads the state of labyrinth envs, got {type(batch).__name__}"
        )
    if env.single_action_space.n != 15:
        raise ValueError(f"the {player} needs num_actions=15, got {env.single_action_space.n}")
    return batch
