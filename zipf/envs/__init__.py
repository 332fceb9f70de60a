"""Zipfian environment families. Importing this registers them with Gymnasium."""

import gymnasium

from zipf.envs.levels import SPLITS, Split, chance, make, make_vec, split
from zipf.envs.mixture import MixtureVectorEnv
from zipf.envs.single import SingleWorld
from zipf.envs.vector import ZipfVectorEnv

__all__ = [
    "SPLITS",
    "MixtureVectorEnv",
    "SingleWorld",
    "Split",
    "ZipfVectorEnv",
    "chance",
    "make",
    "make_vec",
    "split",
]

gymnasium.register(
    id="zipf/Gridworld-v0",
    entry_point="zipf.envs.gridworld.single:GridworldEnv",
    vector_entry_point="zipf.envs.gridworld.vector:GridworldVectorEnv",
)

gymnasium.register(
    id="zipf/Playroom-v0",
    entry_point="zipf.envs.playroom.single:PlayroomEnv",
    vector_entry_point="zipf.envs.playroom.vector:PlayroomVectorEnv",
)
