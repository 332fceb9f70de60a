"""How well uniformly random actions do, exactly."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.arguments import checked
from zipf.envs.baselines import BaselineScore
from zipf.envs.gridworld import GridworldOptions, kernels, sprites
from zipf.envs.gridworld.level import distribution as of_level
from zipf.envs.gridworld.level import maps_of
from zipf.envs.gridworld.maps import MOVES, Maps

SURVIVAL = 1e-20  # ours: less of an episode is left than a sum of probabilities can show


def chance(level: str, **options: Any) -> BaselineScore:
    """The score of uniformly random actions on a level with these options of `GridworldOptions`,
    exact, also by map and by target.

    On the released maps 0.0324 (`zipf_2`), 0.0477 (`uniform`) and 0.0859 (`rare`).
    """
    chosen = checked(GridworldOptions, options)
    return _chance(level, maps_of(level.removeprefix("gridworld/"), chosen), chosen.max_steps)


@lru_cache(maxsize=16)
def _chance(level: str, maps: Maps, max_steps: int) -> BaselineScore:
    return mean_success(level, success_of_random_actions(maps, max_steps))


def mean_success(level: str, success: NDArray) -> BaselineScore:
    """The score of a policy on a level, from the probability of success where an object is the
    target, [maps, objects]."""
    distribution = of_level(level.removeprefix("gridworld/"))
    num_maps, num_objects = success.shape
    by_map, by_target = success @ distribution(num_objects), distribution(num_maps) @ success
    by_rank = {"map": tuple(by_map.tolist()), "target": tuple(by_target.tolist())}
    return BaselineScore(float(distribution(num_maps) @ by_map), by_rank=by_rank)


def success_of_random_actions(maps: Maps, max_steps: int) -> NDArray[np.float64]:
    """The probability that an episode of uniformly random actions ends at each object, which is
    that of success where it is the target, float64 [maps, objects].

    Follows the distribution over the cells of each map, which random actions make a Markov chain
    that objects absorb, up to the step limit.
    """
    num_maps, height, width = maps.boards.shape
    leads_to = destinations(maps)
    success = np.zeros((num_maps, maps.num_objects))
    for i in range(num_maps):
        cells = maps.cells[i, :, 0] * width + maps.cells[i, :, 1]
        at = np.zeros(height * width)
        at[cells[-1]] = 1.0
        for _ in range(max_steps):
            if at.sum() < SURVIVAL:
                break
            at = np.bincount(
                leads_to[i].ravel(), np.repeat(at / len(MOVES), len(MOVES)), height * width
            )
            success[i] += at[cells[:-1]]
            at[cells[:-1]] = 0.0
    return success


def destinations(maps: Maps) -> NDArray[np.int64]:
    """Where each action leads from each cell, as flat cell indices [maps, cells, actions]."""
    num_maps, height, width = maps.boards.shape
    shape = (num_maps, height, width, len(MOVES))
    map, row, column, action = (index.ravel() for index in np.indices(shape))
    envs = np.stack([map, np.zeros_like(map), row, column], axis=1)
    inside = maps.boards[map, row, column] != sprites.WALL
    moved = envs[inside]
    n = len(moved)
    kernels.move(
        np.ones(n, dtype=np.bool_),
        action[inside],
        maps.codes,
        maps.cells,
        1,
        np.zeros(n, dtype=np.int64),
        moved,
        np.empty(n),
        np.empty(n, dtype=np.bool_),
        np.empty(n, dtype=np.bool_),
    )
    envs[inside] = moved
    flat = envs[:, kernels.ROW] * width + envs[:, kernels.COLUMN]
    return flat.reshape(num_maps, height * width, len(MOVES))
