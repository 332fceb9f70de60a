"""Worlds whose observations are samples of any space: action 1 is rewarded, three steps each."""

import numpy as np
from gymnasium import spaces

from zipf.envs import pcg64
from zipf.envs.vector import ZipfVectorEnv


class Noise(ZipfVectorEnv):
    """Observations say nothing of what to do; every other episode is truncated."""

    def __init__(self, num_envs: int, observation_space: spaces.Dict, actions: int = 2):
        super().__init__(
            num_envs,
            single_observation_space=observation_space,
            single_action_space=spaces.Discrete(actions),
            situation={"nothing": 1},
        )
        self.seeds = np.zeros(num_envs, np.int64)

    def _begin(self, mask, forced):
        for i in np.flatnonzero(mask):
            self.seeds[i] = int(pcg64.next_double(self._streams[i]) * 2**31)

    def _advance(self, actions, mask):
        right, ends, odd = actions == 1, self._lengths == 3, self.seeds % 2 == 1
        return right.astype(np.float64), ends & odd, ends & ~odd, right

    def _observe(self, out, mask):
        for i in np.flatnonzero(mask):
            self.single_observation_space.seed(int(self.seeds[i] + self._lengths[i]))
            for name, value in self.single_observation_space.sample().items():
                out[name][i] = value

    def _situations(self):
        return {"nothing": np.zeros(self.num_envs, np.int64)}

    def _get_worlds(self):
        return {"seeds": self.seeds}

    def _set_worlds(self, state):
        self.seeds[:] = state["seeds"]
