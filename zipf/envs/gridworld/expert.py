"""A scripted expert: the shortest way to the target that touches no other object; and without the
cue."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.arguments import checked
from zipf.envs.baselines import BaselineScore
from zipf.envs.gridworld import GridworldOptions, kernels
from zipf.envs.gridworld.chance import destinations, mean_success
from zipf.envs.gridworld.level import distribution as of_level
from zipf.envs.gridworld.level import maps_of
from zipf.envs.gridworld.maps import Maps
from zipf.envs.gridworld.vector import GridworldVectorEnv


class Expert:
    """Plays all envs of a batch from their state: `Expert(env)()` is actions, int64 [N].

    It succeeds wherever the target can be reached in `max_steps`, as on all released maps.
    Raises ValueError: the batch is not one of a single gridworld level.
    """

    def __init__(self, env: GridworldVectorEnv) -> None:
        require_gridworld(env, "expert")
        self._envs = env._envs  # the state itself, which the environment writes in place
        self._maps = env.level.maps

    def __call__(self) -> NDArray[np.int64]:
        map, target = self._envs[:, kernels.MAP], self._envs[:, kernels.TARGET]
        cell = self._envs[:, kernels.ROW] * self._maps.boards.shape[2]
        return shortest_ways(self._maps)[map, target, cell + self._envs[:, kernels.COLUMN]]


def require_gridworld(env: object, policy: str) -> None:
    """Raises ValueError if a scripted policy, named in the message, cannot play these envs."""
    if not isinstance(env, GridworldVectorEnv):
        raise ValueError(
            f"the {policy} plays a batch of one gridworld level, got {type(env).__name__}"
        )


def score(level: str, **options: Any) -> BaselineScore:
    """The expert's score on a level with these options of `GridworldOptions`, exact, also by map
    and by target."""
    chosen = checked(GridworldOptions, options)
    maps = maps_of(level.removeprefix("gridworld/"), chosen)
    return mean_success(level, reached(maps, chosen.max_steps).astype(np.float64))


def blind(level: str, **options: Any) -> BaselineScore:
    """The score of a policy that cannot see the cue, and goes by shortest ways to that object of
    the map which is the target most often on this level, of those that it reaches in time: exact.
    No policy without the cue has a higher one, since the first object that is reached ends the
    episode."""
    name, chosen = level.removeprefix("gridworld/"), checked(GridworldOptions, options)
    in_time = reached(maps_of(name, chosen), chosen.max_steps)  # [maps, objects]
    probabilities = of_level(name)(chosen.num_objects)
    places = np.arange(len(in_time)), (probabilities * in_time).argmax(axis=1)
    success = np.zeros(in_time.shape)
    success[places] = in_time[places]
    policy = "expert of the most frequent target"
    if not (success == success[0]).all():
        return replace(mean_success(level, success), policy=policy)
    # All maps alike, as those that are released: without the rounding of a mean over them.
    score = float(probabilities @ success[0])
    by_rank = {"map": (score,) * len(success), "target": tuple(success[0].tolist())}
    return BaselineScore(score, by_rank=by_rank, policy=policy)


def reached(maps: Maps, max_steps: int) -> NDArray[np.bool_]:
    """Whether the expert reaches the target in `max_steps`, bool [maps, objects]."""
    width = maps.boards.shape[2]
    cells = maps.cells[:, :, 0] * width + maps.cells[:, :, 1]
    objects, start = cells[:, :-1], cells[:, -1:]
    map, target = np.indices(objects.shape)
    leads_to, ways = destinations(maps), shortest_ways(maps)
    at = np.broadcast_to(start, objects.shape)
    walking = np.ones(objects.shape, np.bool_)
    for _ in range(min(max_steps, maps.boards[0].size)):  # no shortest way is longer
        at = np.where(walking, leads_to[map, at, ways[map, target, at]], at)
        walking &= (at[:, :, None] != objects[:, None, :]).all(axis=2)
    return at == objects


@lru_cache(maxsize=16)
def shortest_ways(maps: Maps) -> NDArray[np.int64]:
    """The action to take in each cell, by map and target: int64 [maps, objects, cells].
    Cells are flat indices. From those that no way leads from, any action."""
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
