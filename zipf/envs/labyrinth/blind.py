"""The expert without the answer: it shows what a policy that guesses can score."""

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.expert import batch_of
from zipf.envs.labyrinth.steering import WAIT
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv


class Guesser:
    """Plays a batch as the expert that always gives the answer with this number, see
    `Episode.guess`; waits where a level asks for none. Raises ValueError: as for `Expert`."""

    def __init__(self, env: LabyrinthVectorEnv, number: int) -> None:
        self.env = batch_of(env, "guesser")
        self.number = number

    def __call__(self) -> NDArray[np.int64]:
        """Actions, int64 [N]."""
        env = self.env
        actions = np.full(env.num_envs, WAIT, np.int64)
        for i, episode in enumerate(env.episodes):
            if episode is not None and not env.envs.finishing[i]:
                action = episode.guess(self.number)
                actions[i] = WAIT if action is None else action
        return actions


def first_answer(env: LabyrinthVectorEnv) -> Guesser:
    """The first button, or the object that lies first."""
    return Guesser(env, 0)


def second_answer(env: LabyrinthVectorEnv) -> Guesser:
    """The second one."""
    return Guesser(env, 1)
