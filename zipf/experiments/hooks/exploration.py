"""Exploration bonuses: intrinsic rewards.

A bonus is added to the reward that the agent learns from and to nothing else: scores, logged
returns and the agent's last-reward input are of the task's reward alone.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from zipf.experiments.hooks.bonus import Bonus
from zipf.experiments.hooks.hook import Parts, Row, arrays
from zipf.experiments.hooks.kernels import add_hashes, count_bonus
from zipf.experiments.hooks.rnd import RNDBonus, RNDOptions
from zipf.options import Options, Positive
from zipf.registry import Registry


class NoExplorationOptions(Options):
    """No bonus, as in the paper."""

    name: Literal["none"]


class CountOptions(Options):
    """A bonus of `scale / sqrt(visits)` for the observation that an action led to."""

    name: Literal["count"]
    scale: Positive
    table_size: Annotated[int, Field(ge=1, le=2**30)]


class FirstVisitOptions(Options):
    """A bonus of `scale` for every observation that an action led to for the first time in the
    episode; that with which the episode began counts as such when an action leads back to it."""

    name: Literal["first_visit"]
    scale: Positive


class CountBonus(Bonus):
    """Counts visits of hashed observations (Tang et al. 2017, with a universal hash).

    The observations that all envs show in a step are counted before any of their bonuses is
    computed, so that envs that show the same one have the same bonus.

    Observations that differ share a count with probability 1 / table_size, so the table should be
    several times larger than the number of observations that matter.
    """

    def __init__(self, options: CountOptions):
        self.scale = options.scale
        self.visits = np.zeros(options.table_size, np.int64)
        self.hashes = Hashes()

    def __call__(self, observation: Parts, mask: Tensor) -> Tensor:
        """Counts observations, those of the mask alone."""
        chosen = np.asarray(mask)
        return self._count(self.hashes(arrays(observation), chosen), chosen)

    def step(self, row: Row) -> None:
        ended = row.ended.numpy()
        hashes = self.hashes(arrays(row.following), ~ended)
        if row.any_ended:
            hashes += self.hashes(arrays(row.final), ended)
        row.fields["bonus"][:] = self._count(hashes, np.ones_like(ended))

    def _count(self, hashes: NDArray[np.uint64], mask: NDArray[np.bool_]) -> Tensor:
        bonus = np.zeros(len(mask), np.float32)
        count_bonus(hashes, mask, self.visits, self.scale, bonus)
        return torch.from_numpy(bonus)

    def state_dict(self) -> dict[str, NDArray]:
        return {"visits": self.visits}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        self.visits[:] = state["visits"]


class FirstVisitBonus(Bonus):
    """The first visits of observations in an episode, by their hashes.

    It does not fade over training: an agent gains from searching what it has not yet seen in an
    episode however well it knows the place, and a memory tells it where it was.
    """

    def __init__(self, options: FirstVisitOptions):
        self.scale = options.scale
        self.hashes = Hashes()
        self.seen: dict[int, set[int]] = {}  # by env

    def __call__(self, observation: Parts, mask: Tensor) -> Tensor:
        """Remembers observations, those of the mask alone."""
        bonus, chosen = np.zeros(len(mask), np.float32), np.asarray(mask)
        envs = np.flatnonzero(chosen)
        hashes = self.hashes(arrays(observation), chosen)[envs]
        for i, value in zip(envs.tolist(), hashes.tolist(), strict=True):
            seen = self.seen.setdefault(i, set())
            if value not in seen:
                seen.add(value)
                bonus[i] = self.scale
        return torch.from_numpy(bonus)

    def begin(self, observation: Parts, mask: Tensor) -> None:
        for i in np.flatnonzero(mask).tolist():
            self.seen.pop(i, None)

    def state_dict(self) -> dict[str, NDArray]:
        """What was seen in the episodes so far: envs int64 [K] and hashes int64 [K]."""
        pairs = [(i, value) for i, seen in self.seen.items() for value in sorted(seen)]
        both = np.array(pairs, np.uint64).reshape(-1, 2).view(np.int64)
        return {"worlds": both[:, 0].copy(), "hashes": both[:, 1].copy()}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        self.seen = {}
        hashes = state["hashes"].view(np.uint64)
        for i, value in zip(state["worlds"].tolist(), hashes.tolist(), strict=True):
            self.seen.setdefault(i, set()).add(value)


class Hashes:
    """Hashes of observations by a universal hash, the same in every process."""

    def __init__(self) -> None:
        self.weights: dict[str, NDArray[np.uint64]] = {}

    def __call__(self, observation: dict[str, NDArray], mask: NDArray[np.bool_]) -> NDArray:
        """The hashes of the observations `{name: [N, ...]}` where `mask` [N]; uint64 [N], elsewhere
        0."""
        hashes = np.zeros(len(mask), np.uint64)
        for name in sorted(observation):
            part = observation[name].reshape(len(mask), -1).view(np.uint8)
            if name not in self.weights:
                self.weights[name] = weights_of(name, part.shape[1])
            add_hashes(part, self.weights[name], mask, hashes)
        return hashes


def weights_of(name: str, size: int) -> NDArray[np.uint64]:
    """The weights of the bytes of a part of observations, uint64 [size]; the name is the seed."""
    rng = np.random.default_rng(list(name.encode()))
    return rng.integers(2**64, size=size, dtype=np.uint64)


BONUSES: Registry[Bonus | None] = Registry("exploration")
"""Each is built from its options, the space of the observations of one env, and a seed."""

BONUSES.register(NoExplorationOptions, lambda options, space, seed: None)
BONUSES.register(CountOptions, lambda options, space, seed: CountBonus(options))
BONUSES.register(FirstVisitOptions, lambda options, space, seed: FirstVisitBonus(options))
BONUSES.register(RNDOptions, RNDBonus)
