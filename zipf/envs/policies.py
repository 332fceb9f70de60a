"""Scripted policies of the envs that a split trains on, and how their memory is saved."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.family import Scripted, scripted
from zipf.envs.mixture import Mixture
from zipf.envs.remembering import Remembering
from zipf.envs.slices import SlicedPolicy, Slices
from zipf.envs.splits import Split

if TYPE_CHECKING:
    from zipf.envs.family import BoundPolicy
    from zipf.envs.vector import ZipfVectorEnv


class Teacher(Remembering):
    """A scripted policy, of `zipf.envs.SCRIPTED`, of the envs that `zipf.envs.make_train` makes of
    a split. Called, it gives the actions, int64 [N], that it would take. Raises ValueError: a train
    level has no such policy."""

    def __init__(self, name: Scripted, split: Split, env: ZipfVectorEnv):
        self._policies: dict[int, BoundPolicy] = {}
        self._sliced: SlicedPolicy | None = None
        if isinstance(env, Slices):
            self._sliced = SlicedPolicy(env, partial(Teacher, name, split))
            return
        batches = {0: (split.train[0].name, env)}
        # The split's own, and not a level that is a mixture itself.
        self._mixture: Mixture | None = None
        if isinstance(env, Mixture) and split.train[0].name in env.level_names:
            self._mixture = env
            firsts = np.unique(env.engines).tolist()  # one policy for all envs on an engine
            batches = {k: (env.level_names[k], env.batches[k]) for k in firsts}
        for k, (level, batch) in batches.items():
            policy = scripted(name, level, batch)
            if policy is None:
                raise ValueError(f"the levels of {split.name} have no {name}")
            self._policies[k] = policy

    def __call__(self) -> NDArray[np.int64]:
        if self._sliced is not None:
            return self._sliced()
        if self._mixture is None:
            return self._policies[0]()
        actions = np.zeros(self._mixture.num_envs, np.int64)
        engines = self._mixture.engines[self._mixture.levels_of_envs]
        for k in np.unique(engines).tolist():
            np.copyto(actions, self._policies[k](), where=engines == k)
        return actions

    def get_state(self) -> dict[str, NDArray[Any]]:
        """What its policies remember, by name."""
        if self._sliced is not None:
            return self._sliced.get_state()
        state: dict[str, NDArray[Any]] = {}
        for k, policy in self._policies.items():
            if isinstance(policy, Remembering):
                state |= {f"{k}:{name}": value for name, value in policy.get_state().items()}
        return state

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continues from `get_state()`, in the same envs."""
        if self._sliced is not None:
            self._sliced.set_state(state)
        for k, policy in self._policies.items():
            if isinstance(policy, Remembering):
                start = f"{k}:"
                own = {n.removeprefix(start): v for n, v in state.items() if n.startswith(start)}
                policy.set_state(own)
