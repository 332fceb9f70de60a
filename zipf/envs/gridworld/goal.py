"""What a gridworld's observation asks for: the cue."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.goals import Goal
from zipf.envs.gridworld.sprites import CELL, SPRITES
from zipf.envs.vector import Observation, ZipfVectorEnv


class Cue(Goal):
    """The top left cell of the image, uint8 [N, 243], or the part `cue`, uint8 [N, 1]."""

    def __init__(self, env: ZipfVectorEnv):
        self.drawn = "image" in env.single_observation_space.spaces

    def read(self, observation: Observation) -> NDArray[np.uint8]:
        if not self.drawn:
            return observation["cue"].copy()
        image = observation["image"]
        return image[:, :CELL, :CELL].reshape(len(image), -1)

    def write(self, observation: Observation, goals: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        if self.drawn:
            cells = goals.reshape(-1, CELL, CELL, 3)
            np.copyto(observation["image"][:, :CELL, :CELL], cells, where=mask[:, None, None, None])
        else:
            np.copyto(observation["cue"], goals, where=mask[:, None])


def cues(codes: NDArray[np.uint8], observation: str) -> NDArray[np.uint8]:
    """The goals, as `Cue` reads them, of episodes that ask for objects of these cell codes [N]; in
    "image" or "tiles", the level's option."""
    if observation == "tiles":
        return codes[:, None].copy()
    return SPRITES[1, codes].reshape(len(codes), -1)
