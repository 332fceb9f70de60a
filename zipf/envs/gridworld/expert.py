"""A scripted expert: the shortest way to the target that touches no other object."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zipf.envs.gridworld import kernels
from zipf.envs.gridworld.chance import destinations
from zipf.envs.gridworld.maps import Maps
from zipf.envs.gridworld.vector import GridworldVectorEnv


class Expert:
    """Plays all worlds of a batch from their state: `Expert(env)()` is actions, int64 [N].

    It succeeds wherever the target can be reached in `max_steps`, as on all released maps.
    """

    def __init__(self, env: GridworldVectorEnv) -> None:
        self._worlds = env._worlds  # the state itself, which the environment writes in place
        self._maps = env.level.maps

    def __call__(self) -> NDArray[np.int64]:
        map, target = self._worlds[:, kernels.MAP], self._worlds[:, kernels.TARGET]
        cell = self._worlds[:, kernels.ROW] * self._maps.boards.shape[2]
        return shortest_ways(self._maps)[map, target, cell + self._worlds[:, kernels.COLUMN]]


@lru_cache(maxsize=16)
def shortest_ways(maps: Maps) -> NDArray[np.int64]:
    """The action to take in each cell, by map and target: int64 [maps, objects, cells].

    Cells are flat indices. From those that no way leads from, any action.
    """
    num_maps, height, width = maps.boards.shape
    leads_to = destinations(maps)
    objects = maps.cells[:, :-1, 0] * width + maps.cells[:, :-1, 1]
    ways = np.zeros((num_maps, maps.num_objects, height * width), dtype=np.int64)
    for map in range(num_maps):
        for target, goal in enumerate(objects[map]):
            distance = np.full(height * width, np.inf)
            others = np.delete(objects[map], target)
            while True:
                further = 1 + distance[leads_to[map]].min(axis=1)
                further[goal] = 0
                further[others] = np.inf
                if (further == distance).all():
                    break
                distance = further
            ways[map, target] = distance[leads_to[map]].argmin(axis=1)
    ways.flags.writeable = False
    return ways
