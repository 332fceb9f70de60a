"""Batches of envs of other engines, which cannot save their state: episodes are replayed."""

import hashlib
import struct
import warnings
from abc import abstractmethod
from collections.abc import Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.envs import pcg64
from zipf.envs.vector import Observation, ZipfVectorEnv

SEEDS = 2**31  # some engines take no larger ones
_NOT_DETERMINISTIC: set[str] = set()
"""The engines and levels that this process has warned about."""


class Outcome(NamedTuple):
    """What one env returned for an action.

    `observation` has the parts of the observation space, without a batch axis; `info` is for
    `_succeeded` alone.
    """

    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: Mapping[str, Any] = MappingProxyType({})


class ReplayedVectorEnv(ZipfVectorEnv):
    """`N` envs of another engine, stepped one after another.

    Every episode is begun with a seed from the env's own stream, so seed and actions determine an
    episode of a deterministic engine. Engines cannot save their state in general: `get_state` holds
    seed, actions and a digest of the observations, rewards and ends of the running episodes, and
    `set_state` replays them, which takes as long as playing them did. If a digest differs, the
    engine is not deterministic: a warning names it, once in a process, and all its envs begin
    their episodes again. Pickling replays likewise.

    The situation has no ranks. Arguments are those of `ZipfVectorEnv`.

    Attributes:
        replayed_name: names engine and level in the warning.
    """

    replayed_name: str
    _resizable = frozenset({"actions"})

    def __init__(self, num_envs: int, **kwargs: Any) -> None:
        super().__init__(num_envs, situation={}, **kwargs)
        # The running episodes: how to repeat them, and what they returned last and so far.
        self._seeds = np.zeros(num_envs, np.int64)
        self._actions: list[list[int]] = [[] for _ in range(num_envs)]
        self._digests = np.zeros(num_envs, np.uint64)
        self._current = self.allocate()

    @abstractmethod
    def _open(self, i: int, seed: int) -> Observation:
        """Begins an episode of env `i` with a seed of 0 .. `SEEDS` - 1: its first observation."""

    @abstractmethod
    def _act(self, i: int, action: int) -> Outcome:
        """Takes an action in env `i`. `self._actions[i]` has the episode's actions, this one
        included."""

    def _succeeded(self, episode_return: float, outcome: Outcome) -> bool:
        """Whether an episode with this return and last step was a success. Asked where the batch
        reports success."""
        return episode_return > 0

    def name_of(self, i: int) -> str:
        return self.replayed_name

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        for i in np.flatnonzero(mask).tolist():
            self._begin_env(i, int(pcg64.next_double(self._streams[i]) * SEEDS))

    def _begin_env(self, i: int, seed: int) -> None:
        first = self._open(i, seed)
        self._seeds[i] = seed
        self._actions[i] = []
        self._digests[i] = 0
        self._keep(i, Outcome(first, 0.0, False, False))

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        reward = np.zeros(self.num_envs)
        terminated, truncated, success = np.zeros((3, self.num_envs), np.bool_)
        for i in np.flatnonzero(mask).tolist():
            outcome = self._step_env(i, int(actions[i]))
            _, reward[i], terminated[i], truncated[i], _ = outcome
            if self.reports_success and (outcome.terminated or outcome.truncated):
                success[i] = self._succeeded(float(self._returns[i]) + outcome.reward, outcome)
        # Here, too: nobody may ask for the last observation of an episode.
        self._check_finite(self._current, mask)
        return reward, terminated, truncated, success

    def _step_env(self, i: int, action: int) -> Outcome:
        self._actions[i].append(action)
        outcome = self._act(i, action)
        self._keep(i, outcome)
        return outcome

    def _keep(self, i: int, outcome: Outcome) -> None:
        """Keeps an env's observation, and what the env returned in its digest."""
        observation, *returned, _ = outcome
        content = [struct.pack("<Qd??", self._digests[i], *returned)]
        for name, array in self._current.items():
            row = array[i : i + 1]
            row[0] = observation[name]
            content.append(row.tobytes())
        digest = hashlib.blake2b(b"".join(content), digest_size=8).digest()
        self._digests[i] = int.from_bytes(digest, "little")

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        for name, array in out.items():
            array[mask] = self._current[name][mask]

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return {}

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        begun = self._seeded
        actions = [self._actions[i] for i in np.flatnonzero(begun).tolist()]
        counts = np.zeros(self.num_envs, np.int64)
        counts[begun] = [len(one) for one in actions]
        dtype = np.min_scalar_type(int(self.single_action_space.n) - 1)
        return {
            "seeds": self._seeds * begun,
            "digests": self._digests * begun,
            "counts": counts,
            "actions": np.fromiter(chain.from_iterable(actions), dtype, int(counts.sum())),
        }

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        seeds, counts, actions = state["seeds"], state["counts"], state["actions"]
        begun = state["seeded"]
        if (
            (seeds < 0).any()
            or (seeds >= SEEDS).any()
            or (counts != state["lengths"] * begun).any()
            or counts.sum() != len(actions)
            or (actions >= self.single_action_space.n).any()
        ):
            raise ValueError(
                "the state is of another environment, or damaged: seeds, actions or lengths out "
                "of range"
            )
        envs = np.flatnonzero(begun).tolist()
        episodes = np.split(actions, np.cumsum(counts)[:-1])
        same = [
            self._replay(i, int(seeds[i]), episodes[i].tolist())
            and self._digests[i] == state["digests"][i]
            for i in envs
        ]
        if not all(same):
            self._warn()
            for i in envs:
                self._begin_env(i, int(seeds[i]))
                self._restarted[i] = True

    def _replay(self, i: int, seed: int, actions: list[int]) -> bool:
        """Plays an env's episode again; whether it was as long as these actions."""
        self._begin_env(i, seed)
        ended = False
        for action in actions:
            if ended:
                return False
            outcome = self._step_env(i, action)
            ended = outcome.terminated or outcome.truncated
        return True

    def _warn(self) -> None:
        if self.replayed_name not in _NOT_DETERMINISTIC:
            _NOT_DETERMINISTIC.add(self.replayed_name)
            warnings.warn(
                f"{self.replayed_name} is not deterministic: an episode replayed from its seed "
                "and actions was another one. Its envs begin their episodes again, here and "
                "whenever a state of it is restored",
                stacklevel=2,
            )

    def __getstate__(self) -> dict[str, Any]:
        none: list[list[int]] = [[] for _ in range(self.num_envs)]
        return {**super().__getstate__(), "_actions": none, "_saved": self.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved = state.pop("_saved")
        self.__dict__.update(state)
        self.set_state(saved)
