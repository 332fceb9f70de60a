"""The finding levels' first frames as questions: left or right?"""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from zipf.envs.playroom.vector import PlayroomVectorEnv

LEFT, RIGHT = 0, 1


class FirstFrameVectorEnv(PlayroomVectorEnv):
    """`N` worlds of a `supervised/` level in which an episode is its first frame.

    The action says on which side the object is that the instruction names: `LEFT` or `RIGHT`. The
    reward is 1 if that is right, and the episode ends. Where both objects are the same, either
    answer is right, as in the paper. Episodes are drawn as `PlayroomVectorEnv` draws them.

    Raises:
        ValueError: the level has no two sides to tell apart.
    """

    def __init__(
        self, num_envs: int = 1, level: str = "supervised/find_shape_zipf3", **options: Any
    ):
        super().__init__(num_envs, level, **options)
        if not self.level.finding:
            raise ValueError(f"level 'playroom/{level}' has no object on the left and on the right")
        self.single_action_space = spaces.Discrete(2)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        right = (actions == self._side) | (self.ranks[:, 0] == self.ranks[:, 1])
        ended = np.ones(self.num_envs, np.bool_)
        return right.astype(np.float64), ended, ~ended, right
