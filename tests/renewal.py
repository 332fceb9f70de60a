"""An env whose situations are new every few episodes: what was learned from one goes to waste.

An episode is one step: the image is one of `CUES` patterns, and one of `ACTIONS` actions is right.
All envs have the same patterns and answers, and begin their episodes together; after `LASTS` of
them both are drawn anew. Who recalls earlier episodes knows the answers after a few of them. Who
does not has to learn `CUES` images in `LASTS` episodes of each env.
"""

from functools import cache

import numpy as np
from gymnasium import spaces

from zipf.envs import pcg64
from zipf.envs.vector import ZipfVectorEnv

CUES, ACTIONS, LASTS = 32, 4, 16
SIDE = 6


@cache
def rules(generation):
    """The images of a generation's cues, and the actions that are right there."""
    rng = np.random.default_rng(generation)
    images = 255 * rng.integers(2, size=(CUES, SIDE, SIDE, 1), dtype=np.uint8)
    return images.repeat(3, -1), rng.integers(ACTIONS, size=CUES)


class Renewal(ZipfVectorEnv):
    """The batch of envs; their cues are drawn uniformly at every episode."""

    def __init__(self, num_envs: int):
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {"image": spaces.Box(0, 255, (SIDE, SIDE, 3), np.uint8)}
            ),
            single_action_space=spaces.Discrete(ACTIONS),
            situation={"cue": CUES},
        )
        self.cue = np.zeros(num_envs, np.int64)
        self.played = np.zeros(num_envs, np.int64)

    def _begin(self, mask, forced):
        for i in np.flatnonzero(mask):
            self.cue[i] = int(pcg64.next_double(self._streams[i]) * CUES)
        self.played[mask] += 1

    def _advance(self, actions, mask):
        _, right = rules(int(self.played[0]) // LASTS)
        success = actions == right[self.cue]
        ends = np.ones(self.num_envs, np.bool_)
        return success.astype(np.float64), ends, ~ends, success

    def _observe(self, out, mask):
        images, _ = rules(int(self.played[0]) // LASTS)
        out["image"][mask] = images[self.cue[mask]]

    def _situations(self):
        return {"cue": self.cue.copy()}

    def _get_env_states(self):
        return {"cue": self.cue, "played": self.played}

    def _set_env_states(self, state):
        self.cue[:] = state["cue"]
        self.played[:] = state["played"]
