"""Scripted policies as policies of the evaluator."""

from __future__ import annotations

from numpy.typing import NDArray

from zipf import envs
from zipf.envs.mixture import Mixture
from zipf.envs.splits import Level
from zipf.envs.vector import ZipfVectorEnv


class ScriptedPolicy:
    """A scripted policy of a family, for one level after another.

    Args:
        name: which one, of `zipf.envs.SCRIPTED`.
    """

    def __init__(self, name: envs.Scripted) -> None:
        self.name = name

    def enter(self, level: Level, env: ZipfVectorEnv) -> None:
        """Plays these envs of a level from now on.

        Raises:
            ValueError: the level has no such policy, or it cannot play these envs.
        """
        if isinstance(env, Mixture) and level in env.level_names:  # the only one that is played
            env = env.batches[env.engines[env.level_names.index(level)]]
        policy = envs.scripted(self.name, level, env) if isinstance(level, str) else None
        if policy is None:
            raise ValueError(f"policy={self.name}: {level} has none")
        self.policy = policy

    def start(self, num_envs: int) -> None: ...

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        return self.policy()
