"""A bonus of one's own: for the k-th observation of a kind in an episode, scale / k."""

from typing import Literal
from zlib import crc32

import torch

from zipf.experiments.hooks.bonus import Bonus
from zipf.experiments.hooks.exploration import BONUSES
from zipf.options import Options


class EpisodeCountOptions(Options):
    name: Literal["episode_count"]
    scale: float = 0.01  # ours: a hundredth of the reward


class EpisodeCount(Bonus):
    def __init__(self, options, space, seed):
        self.scale = options.scale
        self.seen = {}  # by env

    def begin(self, observation, mask):
        for env in mask.nonzero().flatten().tolist():
            self.seen[env] = {}

    def __call__(self, observation, mask):
        bonus = torch.zeros(len(mask))
        for env in mask.nonzero().flatten().tolist():
            shown, seen = 0, self.seen[env]
            for part in observation.values():
                shown = crc32(part[env].numpy().tobytes(), shown)
            seen[shown] = seen.get(shown, 0) + 1
            bonus[env] = self.scale / seen[shown]
        return bonus

    def state_dict(self):  # a resumed run goes on bit for bit
        return {"seen": self.seen}

    def load_state_dict(self, state):
        self.seen = {env: dict(seen) for env, seen in state["seen"].items()}


BONUSES.register(EpisodeCountOptions, EpisodeCount)
