"""A family of envs of one's own: a corridor of doors, of which one is to be opened.

The agent sees where it stands and which door to open. Which door that is follows Zipf's law in
training, so that some doors are hardly ever asked for. The family registers itself on import.
"""

import numpy as np
from gymnasium import spaces

import zipf.envs
from zipf.envs import Family, Split, ZipfVectorEnv, distributions, pcg64
from zipf.options import Options


class CorridorOptions(Options):
    """Constructor options: `environment.doors` and so on."""

    doors: int = 10
    max_steps: int = 30


class Corridor(ZipfVectorEnv):
    """`N` corridors. Actions: 0 left, 1 right, 2 open the door; reward 1 for the right door."""

    def __init__(self, num_envs=1, level="zipf_2", *, doors=10, max_steps=30, **options):
        one_hot = spaces.Box(0, 1, (doors,), np.float32)
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(place=one_hot, target=one_hot),
            single_action_space=spaces.Discrete(3),
            situation={"door": doors},
            **options,
        )
        self.cumulative = pcg64.cumulative(distributions.by_name(level)(doors))
        self.one_hot = np.eye(doors, dtype=np.float32)
        self.max_steps = max_steps
        self.places = np.zeros(num_envs, np.int64)
        self.targets = np.zeros(num_envs, np.int64)

    def _begin(self, mask, forced):
        for i in np.flatnonzero(mask):
            drawn = pcg64.choice(self._streams[i], self.cumulative)  # the env's random stream
            self.targets[i] = drawn if forced[0, i] < 0 else forced[0, i]
            self.places[i] = len(self.one_hot) // 2

    def _advance(self, actions, mask):
        moved = self.places + np.select([actions == 0, actions == 1], [-1, 1], 0)
        self.places[mask] = moved.clip(0, len(self.one_hot) - 1)[mask]
        opened = actions == 2
        success = opened & (self.places == self.targets)
        return success.astype(float), opened, ~opened & (self._lengths >= self.max_steps), success

    def _observe(self, out, mask):
        out["place"][mask] = self.one_hot[self.places[mask]]
        out["target"][mask] = self.one_hot[self.targets[mask]]

    def _situations(self):
        return {"door": self.targets.copy()}

    def _get_env_states(self):
        return {"places": self.places, "targets": self.targets}

    def _set_env_states(self, state):
        envs = self._get_env_states()
        for name in envs:
            if not np.isin(state[name], range(len(self.one_hot))).all():
                raise ValueError(f"the state has {name} outside of the corridor")
        for name, values in envs.items():
            values[:] = state[name]


zipf.envs.register(
    Family(
        name="corridor",
        summary="open the right one of many doors",
        levels=("zipf_2", "uniform", "rare"),
        check=distributions.by_name,  # any exponent, as in `corridor/zipf_1.5`
        options=CorridorOptions,
        make_vec=Corridor,
        splits=(Split("corridor", "corridor/zipf_2", "corridor/uniform", "corridor/rare"),),
    )
)
