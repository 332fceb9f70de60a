"""Weights of frames in the loss: frames of episodes with a rare goal weigh more.

What episodes ask for, their goals, is read from observations and counted when they begin. An agent
multiplies the loss of each frame by its weight, so that on average it learns as if goals were
drawn by another law than they are. Auxiliary losses are not weighted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from zipf.agents.unroll import Unroll
from zipf.envs.goals import Goal
from zipf.experiments.hooks.hook import Hook, Parts, Row, arrays
from zipf.options import BelowOne, Context, Options, Share
from zipf.registry import Registry


class NoReweightingOptions(Options):
    """All frames alike, as in the paper."""

    name: Literal["none"]


class _Weights(Options):
    """`largest_weight` bounds a frame's weight, and with it how much a goal's share of the loss can
    grow; the mean weight of all episodes so far is 1. Goals that differ share a counter with
    probability 1 / table_size."""

    name: str
    largest_weight: Annotated[float, Field(ge=1, allow_inf_nan=False)]
    table_size: Annotated[int, Field(ge=1, le=2**30)]

    def problems(self, context: Context) -> Iterator[str]:
        if not context.has_goals:
            yield (
                f"reweighting={self.name}: the envs of {context.family} do not say what an "
                "episode asks for; choose reweighting=none"
            )


class InverseCountOptions(_Weights):
    """Weights proportional to n^-power of a goal that was asked for n times: 0 leaves frames alike,
    1 gives all goals the weight of as many episodes, as far as `largest_weight` allows it. Goals
    whose episodes are longer have more of the frames."""

    name: Literal["inverse_count"]
    power: Share


class EffectiveNumberOptions(_Weights):
    """Weights proportional to (1 - beta) / (1 - beta^n) (Cui et al. 2019): as n^-1 while n is small
    beside 1 / (1 - beta), and alike beyond."""

    name: Literal["effective_number"]
    beta: BelowOne


def bounded(
    raw: NDArray[np.float64], counts: NDArray[np.float64], largest: float
) -> NDArray[np.float64]:
    """Weights [N] whose mean is 1 if each is taken as often as `counts` says, none above `largest`
    >= 1: min(c raw, largest) with the c for which they have that mean."""
    at_bound = np.zeros(raw.shape, np.bool_)
    while True:
        rest = counts.sum() - largest * counts.sum(where=at_bound)  # for those below the bound
        below = (counts * raw).sum(where=~at_bound)
        scaled = np.where(at_bound, largest, raw * (rest / below))
        over = scaled > largest
        if not over.any() or (at_bound | over).all():
            return np.minimum(scaled, largest)
        at_bound |= over


class Reweighting(Hook):
    """Counts the goals of N envs in a table of hashes, and weighs the frames of unrolls by the
    goals of their episodes, with the counts at the unrolls' end.

    Raises ValueError: the envs do not say what an episode asks for: `goal`, which reads it, is
    None.
    """

    name = "reweighting"

    def __init__(
        self,
        options: InverseCountOptions | EffectiveNumberOptions,
        goal: Goal | None,
        num_envs: int,
    ):
        if goal is None:
            raise ValueError("these envs do not say what an episode asks for")
        self.options = options
        self.goal = goal
        self.columns = {"weight": torch.empty((), dtype=torch.float32)}
        self.counts = np.zeros(options.table_size, np.int64)  # how often each goal was asked for
        self.counters = np.zeros(num_envs, np.int64)  # where in `counts` the goal of each env is
        self._factors = np.zeros(0, np.uint64)
        self._asked: list[NDArray[np.int64]] = []  # the counters of each row of the unroll

    def begin(self, observation: Parts, mask: Tensor) -> None:
        if not mask.any():
            return
        begins = mask.numpy()
        parts = self.goal.read(arrays(observation))[begins].astype(np.int64).view(np.uint64)
        if len(self._factors) != parts.shape[1]:  # the same in every process
            rng = np.random.default_rng(0)
            self._factors = rng.integers(2**64, size=parts.shape[1:], dtype=np.uint64)
        # Multilinear hashing: the high bits of sum_i factor_i * part_i mod 2^64 are universal.
        hashes = np.add.reduce(parts * self._factors, axis=1) >> np.uint64(32)
        size = np.uint64(len(self.counts))
        self.counters[begins] = (hashes * size >> np.uint64(32)).astype(np.int64)
        np.add.at(self.counts, self.counters[begins], 1)

    def step(self, row: Row) -> None:
        self._asked.append(self.counters.copy())

    def finish(self, unroll: Unroll) -> None:
        weights = self.weights(np.stack(self._asked))
        unroll.steps["weight"][:-1] = torch.from_numpy(weights)
        self._asked = []

    def weights(self, counters: NDArray[np.int64]) -> NDArray[np.float32]:
        """The weights, float32 [T, N], of frames of episodes with these `counters` [T, N], by the
        counts as they are now."""
        o, asked = self.options, np.flatnonzero(self.counts)
        counts = self.counts[asked].astype(np.float64)
        if isinstance(o, InverseCountOptions):
            raw = counts**-o.power
        else:
            raw = (1 - o.beta) / (1 - o.beta**counts)
        # Not of mean 1 in every unroll: one with a rare goal would make all of its weights smaller.
        of_goals = np.zeros(len(self.counts), np.float32)
        of_goals[asked] = bounded(raw, counts, o.largest_weight)
        return of_goals[counters]

    def state_dict(self) -> dict[str, Any]:
        """The counts, and what each env was asked for."""
        return {"counts": self.counts, "counters": self.counters.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.counts[:] = state["counts"]
        self.counters[:] = state["counters"]


REWEIGHTINGS: Registry[Hook | None] = Registry("reweighting")
"""Each is built from its options, the envs' goal, and their number."""

REWEIGHTINGS.register(NoReweightingOptions, lambda options, goal, num_envs: None)
REWEIGHTINGS.register(InverseCountOptions, Reweighting)
REWEIGHTINGS.register(EffectiveNumberOptions, Reweighting)
