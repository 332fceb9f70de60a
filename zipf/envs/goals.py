"""Goals: which part of an observation says what an episode asks for.

A family names a class of goals in its field `goal`. Options that depend on what is asked for
(weights by how rarely it is, relabelling with what was achieved) work on any family that has one:

    goal = zipf.envs.goal("playroom/lift/lift_shape_zipf3", env)
    goal.read(observation)  # int64 [N, 6], the codes of the instruction

`zipf.envs.testing.check_goal` checks one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from zipf.envs.vector import Observation, ZipfVectorEnv


class Goal(ABC):
    """Reads and replaces what observations ask for, in a code of K integers.

    Two episodes ask for the same if their codes are equal. Read from the first observation of an
    episode, and written to every one, the code is all that tells what is asked for.

    Args:
        env: the batch whose observations these are.
    """

    @abstractmethod
    def __init__(self, env: ZipfVectorEnv): ...

    @abstractmethod
    def read(self, observation: Observation) -> NDArray[Any]:
        """What observations {name: [N, ...]} ask for: a fresh array of integers [N, K]."""

    @abstractmethod
    def write(self, observation: Observation, goals: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        """Makes the observations {name: [N, ...]} where `mask` [N] ask for `goals` [N, K]; in
        place, and without a change to anything else."""


class Instruction(Goal):
    """The observation's part `instruction`, int64 [N, words]."""

    def __init__(self, env: ZipfVectorEnv):
        pass

    def read(self, observation: Observation) -> NDArray[np.int64]:
        return observation["instruction"].copy()

    def write(self, observation: Observation, goals: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        np.copyto(observation["instruction"], goals, where=mask[:, None])
