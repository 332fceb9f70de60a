"""Envs whose observations are samples of any space: action 1 is rewarded, three steps each."""

import numpy as np
from gymnasium import spaces

from zipf.envs import pcg64
from zipf.envs.vector import ZipfVectorEnv

CART_POLE = spaces.Box(
    np.float32([-4.8, -np.inf, -0.42, -np.inf]), np.float32([4.8, np.inf, 0.42, np.inf])
)
SPACES = {
    "a vector": spaces.Dict(position=CART_POLE),
    "lights": spaces.Dict(lights=spaces.Box(0, 1, (6,), np.float32)),
    "float64 without bounds": spaces.Dict(x=spaces.Box(-np.inf, np.inf, (2, 3), np.float64)),
    "bytes": spaces.Dict(ram=spaces.Box(0, 255, (8,), np.uint8)),
    "integers": spaces.Dict(counts=spaces.Box(-5, 10**6, (3,), np.int32)),
    "a number": spaces.Dict(x=spaces.Box(0, 1, (), np.float32)),
    "a code": spaces.Dict(cell=spaces.Discrete(16)),
    "a code from 3": spaces.Dict(cell=spaces.Discrete(5, start=3)),
    "codes": spaces.Dict(cells=spaces.MultiDiscrete([3, 7, 2])),
    "a board": spaces.Dict(board=spaces.MultiDiscrete(np.full((7, 7, 3), 11), np.uint8)),
    "tiles": spaces.Dict(
        tiles=spaces.Box(0, 227, (7, 7), np.uint8), cue=spaces.Box(0, 227, (1,), np.uint8)
    ),
    "switches": spaces.Dict(switches=spaces.MultiBinary([2, 3])),
    "a text": spaces.Dict(mission=spaces.Box(0, 999, (5,), np.int64)),
    "an image": spaces.Dict(image=spaces.Box(0, 255, (36, 36, 3), np.uint8)),
    "a grey image": spaces.Dict(image=spaces.Box(0, 255, (36, 40, 1), np.uint8)),
    "an image of four channels": spaces.Dict(image=spaces.Box(0, 255, (36, 36, 4), np.uint8)),
    "two images": spaces.Dict(
        {
            "image": spaces.Box(0, 255, (36, 36, 3), np.uint8),
            "arm.camera": spaces.Box(0, 255, (24, 30, 1), np.uint8),
        }
    ),
    "everything": spaces.Dict(
        image=spaces.Box(0, 255, (36, 36, 3), np.uint8),
        instruction=spaces.Box(0, 9, (4,), np.int64),
        mission=spaces.Box(0, 99, (3,), np.int64),
        position=CART_POLE,
        switches=spaces.MultiBinary(3),
        cell=spaces.Discrete(16),
        cells=spaces.MultiDiscrete([3, 7, 2]),
    ),
}


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

    def _get_env_states(self):
        return {"seeds": self.seeds}

    def _set_env_states(self, state):
        self.seeds[:] = state["seeds"]
