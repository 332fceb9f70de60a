"""An env that needs memory: a cue, k steps of waiting, then the action that the cue named.

While waiting, any action but `wait` loses the reward, so that the last action, which is an input of
agents, cannot carry the cue. Without memory the success rate is at most 1 / CUES.
"""

import numpy as np
from gymnasium import spaces

from zipf.envs import pcg64
from zipf.envs.vector import ZipfVectorEnv

CUES = 4
WAIT = CUES


class Recall(ZipfVectorEnv):
    """The first image shows the cue, the last asks for it, those between are blank."""

    def __init__(self, num_envs: int, delay: int):
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {"image": spaces.Box(0, 255, (9, 9, 3), np.uint8)}
            ),
            single_action_space=spaces.Discrete(CUES + 1),
            situation={"cue": CUES},
        )
        self.delay = delay
        self.cue = np.zeros(num_envs, np.int64)
        self.waited = np.ones(num_envs, np.bool_)

    def _begin(self, mask, forced):
        for i in np.flatnonzero(mask):
            self.cue[i] = int(pcg64.next_double(self._streams[i]) * CUES)
        self.waited[mask] = True

    def _advance(self, actions, mask):
        asked = self._lengths > self.delay
        self.waited &= asked | (actions == WAIT)
        success = asked & self.waited & (actions == self.cue)
        reward = np.where(asked, success, 0.1 * (actions == WAIT))
        return reward, asked, np.zeros_like(asked), success

    def _observe(self, out, mask):
        image = out["image"]
        image[mask] = 0
        for i in np.flatnonzero(mask & (self._lengths == 0)):
            image[i, 2 * self.cue[i] : 2 * self.cue[i] + 2] = 255
        image[mask & (self._lengths == self.delay)] = 128

    def _situations(self):
        return {"cue": self.cue.copy()}

    def _get_env_states(self):
        return {"cue": self.cue, "waited": self.waited}

    def _set_env_states(self, state):
        self.cue[:] = state["cue"]
        self.waited[:] = state["waited"]
