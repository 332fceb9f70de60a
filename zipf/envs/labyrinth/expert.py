"""The scripted experts of all levels, for a batch of worlds."""

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.knowledge import EVERYTHING
from zipf.envs.labyrinth.steering import WAIT
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.mixture import Mixture


class Expert:
    """Plays a batch with the fifteen actions by reading the state of its worlds.

    Args:
        env: the batch, also one that draws a task at every reset; a world's episode says what to
            do, `Episode.act`.

    Raises:
        ValueError: the batch has another number of actions than fifteen, or another engine.
    """

    def __init__(self, env: LabyrinthVectorEnv | Mixture) -> None:
        self.env = batch_of(env, "expert")

    def __call__(self) -> NDArray[np.int64]:
        """Actions, int64 [N]; 0 in worlds without an episode."""
        actions = np.zeros(self.env.num_envs, np.int64)
        for i, episode in enumerate(self.env.episodes):
            if episode is not None:
                actions[i] = WAIT if self.env.worlds.finishing[i] else episode.act(EVERYTHING)
        return actions


def batch_of(env: LabyrinthVectorEnv | Mixture, player: str) -> LabyrinthVectorEnv:
    """The worlds that a scripted player reads.

    Raises:
        ValueError: it cannot play them.
    """
    if env.single_action_space.n != 15:
        raise ValueError(f"the {player} needs num_actions=15, got {env.single_action_space.n}")
    batch = env.batches[0] if isinstance(env, Mixture) else env  # they share their worlds
    if not isinstance(batch, LabyrinthVectorEnv):
        raise ValueError(f"the {player} reads the state of our engine: use backend='own'")
    return batch
