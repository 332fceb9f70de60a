"""The processes of a run: learners and those that collect for them. Here one process does both."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from zipf.agents.agent import Agent
from zipf.agents.learner import Learner
from zipf.envs.tensor import TensorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.options.schema import Config
from zipf.experiments.training.build_collector import build_collector, build_tensor_collector
from zipf.experiments.training.rollouts import (
    BackgroundRollouts,
    RolloutWorker,
    SynchronousRollouts,
    TensorRollouts,
)


class LearnerLost(UserError):
    """Another learner has ended."""


class OnlyLearner:
    """A run's only learner: what several would exchange stays as it is.

    Attributes:
        is_first: whether it writes, shows and evaluates.
        stream: what tells the seeds of its envs from those of other learners.
    """

    is_first = True
    stream: tuple[int, ...] = ()

    def seed(self, seed: int) -> int:
        """That of the learner's global random generator, from the run's."""
        return seed

    def agree(self, number: int) -> int:
        """The largest of the learners' numbers."""
        return number

    def mean(self, metrics: dict[str, float]) -> dict[str, float]:
        """For the first, the means over those learners that have a metric and where it is not NaN;
        for the others their own."""
        return metrics

    def total(self, visits: Visits) -> Visits:
        """For the first, the visits of all learners; for the others their own."""
        return visits

    def gather(self, own: dict[str, Any]) -> dict[str, Any]:
        """For the first, the entries of a checkpoint that hold what all learners have of their own;
        for the others nothing."""
        return own

    def receive(self, saved: dict[str, Any] | None) -> dict[str, Any] | None:
        """The checkpoint that the first has read, with what it holds of this learner's own; None
        where there is none."""
        return saved

    def of_first(self, value: Any) -> Any:
        """The value that the first has."""
        return value

    def check_same(self, what: str, state: Any) -> None:
        """Raises `UserError` where learners differ in `what`."""

    def wait(self) -> None:
        """Returns when all learners have come here."""


class Runtime:
    """`runtime=local`, and the base of other runtimes (`zipf.experiments.cluster`)."""

    def __init__(self, config: Config):
        self.config = config

    @contextmanager
    def learner(self) -> Iterator[OnlyLearner]:
        """This process as the learner that it is, until the end.

        Raises:
            UserError: torchrun has started several processes of a run that has one learner.
        """
        started = started_by_torchrun()
        if started > 1:
            raise UserError(
                f"runtime={self.config.runtime.name}: is of one learner, and torchrun has started "
                f"{started} processes; choose runtime=torchrun runtime.learners={started}"
            )
        yield OnlyLearner()

    def rollouts(
        self, env: ZipfVectorEnv | TensorEnv, agent: Agent, stream: tuple[int, ...] = ()
    ) -> RolloutWorker:
        """What collects for the agent.

        Args:
            stream: see `build_collector`.
        """
        parts = self.config.updates_per_unroll
        if not isinstance(env, ZipfVectorEnv):
            on_device = build_tensor_collector(self.config, env, agent, stream)
            return TensorRollouts(on_device, parts, self.config.lag)
        collector = build_collector(self.config, env, agent, stream)
        if self.config.lag == 0:
            return SynchronousRollouts(collector, parts)
        assert isinstance(agent, Learner)  # it has a `largest_lag`
        return BackgroundRollouts(collector, agent, parts)


def started_by_torchrun() -> int:
    """How many processes torchrun has started, this one among them; 0 where it has not."""
    return int(os.environ["WORLD_SIZE"]) if {"RANK", "WORLD_SIZE"} <= os.environ.keys() else 0
