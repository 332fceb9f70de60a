"""Actors in a Ray cluster that play for one learner (`runtime=ray`).

Every actor is a process with envs, seeds and a `HostCollector` of its own. The learner gives it
weights, and it plays one unroll with them, which it puts into Ray's object store. The learner
learns from unrolls as they arrive, the longest asked for first, one update from each.

Weights have a version: the number of updates that made them. The *lag* of an unroll is the version
that learns from it less the version that played it. An actor has `runtime.ahead` unrolls on their
way, and is asked for another when one is taken, with the weights as they are then: it plays while
the learner learns. If unrolls are taken in the order in which they were asked for, as with equally
fast actors, the lag is at most actors x ahead. A slow actor does not hold up the others; an unroll
whose lag has come to exceed 4 x actors x ahead is discarded.

A frame counts when it is learned from, so that every update counts num_envs x unroll_length of
them, as in other runtimes. An actor that is lost, with its node or alone, is replaced by a new
process, the next *incarnation*, with seeds of its own; its unrolls on their way are lost with it.
Unrolls are numbered by the process that plays them: what the agent keeps from one goes to the next.

What is not promised:

- Results depend on timing. Two runs of a seed differ, and a run that goes on from a checkpoint is
  not as if it had not stopped: actors begin new episodes, and unrolls on their way are lost.
- Visits that an exploration bonus counts, goals that reweighting counts, and the episodes that
  augmentation and hindsight change are an actor's own, and begin anew with an incarnation.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import zipf
from zipf import envs
from zipf.agents.agent import Agent
from zipf.agents.learner import Learner
from zipf.agents.unroll import Unroll
from zipf.envs.tensor import TensorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import EXPECTED, UserError
from zipf.experiments.building.checkpoint import arrays, tensors
from zipf.experiments.building.factory import build_agent
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.options import composing
from zipf.experiments.options.runtime import RayOptions
from zipf.experiments.options.schema import Config, schema
from zipf.experiments.training.build_collector import build_collector
from zipf.experiments.training.host_collector import episode_metrics
from zipf.experiments.training.rollouts import Learned
from zipf.experiments.training.runtime import Runtime
from zipf.experiments.training.signals import Stopped

MOST_DEATHS = 3  # ours: of an actor in a row, none of which has played an unroll
PATIENCE = 60.0  # seconds without an unroll before the user is told; ours: starting takes less


class Collecting:
    """What runs in an actor's process."""

    def begin(self, options: dict[str, Any], actor: int, incarnation: int) -> str:
        """Makes the envs and the agent; returns the version of this package.

        Args:
            options: of the run, `Config.model_dump()`.
            actor: its number, from 0.
            incarnation: how many there were before it of that number.

        Raises:
            UserError: a plugin cannot be imported here, or the agent cannot be built.
        """
        composing.load_plugins(options["plugins"])
        config = schema().model_validate(options)
        env = envs.make_train(config.split, config.collector.num_envs, **config.level_options)
        agent = build_agent(config, env)
        assert isinstance(agent, Learner)  # it has a `largest_lag`
        self.agent = agent
        self.collector = build_collector(config, env, agent, (actor, incarnation))
        self.played = 0
        return zipf.__version__

    def play(self, weights: dict[str, Any]) -> dict[str, Any]:
        """Plays an unroll with these weights; arrays, and what else there is to tell of it."""
        self.agent.load_weights(tensors(weights))
        unroll = self.collector.collect()
        self.played += 1
        seconds = dict(self.collector.seconds)
        self.collector.seconds.update(dict.fromkeys(seconds, 0.0))
        return {
            "number": self.played,
            "unroll": arrays(unroll.state_dict()),
            "episodes": self.collector.take_episodes(),
            "visits": self.collector.visits.take().state_dict(),
            "seconds": seconds,
        }


@dataclass
class _Actor:
    """What the learner knows of an actor.

    Attributes:
        incarnation: counts the processes that were this actor; -1 before the first.
        handle: Ray's, of the process.
        begun: whether it has envs.
        learned: number of the last unroll of this incarnation that was learned from; 0 for none.
        carried: what the agent keeps for its next unroll.
        has_played: whether an unroll of this incarnation has been taken.
        deaths: in a row, of incarnations that had not played.
    """

    number: int
    incarnation: int = -1
    handle: Any = None
    begun: bool = False
    learned: int = 0
    carried: dict[str, Any] = field(default_factory=dict)
    has_played: bool = False
    deaths: int = 0


@dataclass(frozen=True)
class _Call:
    """A call of an actor: its `begin`, or `play` with weights of this version."""

    actor: _Actor
    version: int | None


class RayRuntime(Runtime):
    """`runtime=ray`: actors in a Ray cluster collect for one learner."""

    def rollouts(
        self, env: ZipfVectorEnv | TensorEnv, agent: Agent, stream: tuple[int, ...] = ()
    ) -> RayActors:
        """See the base class."""
        assert isinstance(env, ZipfVectorEnv)
        assert isinstance(self.config.runtime, RayOptions)
        assert isinstance(agent, Learner)  # it has a `largest_lag`
        return RayActors(self.config, self.config.runtime, env, agent)


class RayActors:
    """Learns from the unrolls of actors in a Ray cluster.

    Attributes:
        version: of the weights: updates made.
        is_between_unrolls: True, since every update learns from all of what was collected for it.
        actors: of this run, in the order of their numbers.
        visits: how often each situation was met in the unrolls that were learned from.

    Args:
        config: of the run.
        options: `config.runtime`.
        env: envs like those of the actors.
        agent: learns.
    """

    is_between_unrolls = True

    def __init__(self, config: Config, options: RayOptions, env: ZipfVectorEnv, agent: Learner):
        self.options = options
        self.agent = agent
        self.version = 0
        self.actors = [_Actor(number) for number in range(options.actors)]
        self.visits = Visits(tuple(env.situation))
        self.seconds = {"environment": 0.0, "inference": 0.0}
        self._config = config.model_copy(update={"device": "cpu"}).model_dump()
        self._calls: dict[Any, _Call] = {}  # by the reference of what they return, oldest first
        self._published: tuple[int, Any] = (-1, None)  # a version and its weights' reference
        self._lags: list[float] = []
        self._episodes: dict[str, list[float]] = defaultdict(list)
        self._discarded = self._replaced = 0
        self._connected = False
        self._tell: Callable[[str], None] = print
        self._stopping: Callable[[], bool] = bool

    def open(self, tell: Callable[[str], None], stopping: Callable[[], bool]) -> None:
        """Connects to the cluster, or starts one, and begins the actors.

        Raises:
            UserError: there is no such cluster, it has too few cores, or this process belongs to
                another.
        """
        self._tell, self._stopping = tell, stopping
        try:
            self._connect()
            for actor in self.actors:
                self._begin(actor)
        except BaseException:
            self.close()
            raise

    def step(self, learn: Callable[[Unroll], Learned]) -> tuple[Unroll, Learned]:
        """Waits for an unroll and calls `learn` with it.

        Raises:
            UserError: actors die before they have played, or have another version of this package.
        """
        actor, played = self._take()
        follows = actor.learned == played["number"] - 1
        self.agent.carry(actor.carried if follows else {})
        unroll = Unroll.of_state(tensors(played["unroll"]))
        learned = learn(unroll)
        actor.carried = self.agent.carried()
        actor.learned = played["number"]
        self.version += 1
        for name, values in played["episodes"].items():
            self._episodes[name].extend(values)
        self.visits.add_those(played["visits"])
        for part, seconds in played["seconds"].items():
            self.seconds[part] += seconds / len(self.actors)
        return unroll, learned

    def metrics(self) -> dict[str, float]:
        """Of the unrolls that were learned from since the last call: those of the episodes that
        ended in them, and the mean and the largest lag; how many were discarded, and how many
        actors replaced."""
        lags = np.array(self._lags or [np.nan])
        metrics = {
            **episode_metrics(self._episodes),
            "lag_mean": float(lags.mean()),
            "lag_max": float(lags.max()),
            "unrolls_discarded": float(self._discarded),
            "actors_replaced": float(self._replaced),
        }
        self._episodes.clear()
        self._lags, self._discarded, self._replaced = [], 0, 0
        return metrics

    def state_dict(self) -> dict[str, Any]:
        """How far the run is. Actors have no state that would be saved."""
        return {
            "version": self.version,
            "incarnations": [actor.incarnation for actor in self.actors],
            "visits": self.visits.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Actors that begin after this are the next incarnations."""
        self.version = state["version"]
        self.visits.load_state_dict(arrays(state["visits"]))
        for actor, incarnation in zip(self.actors, state["incarnations"], strict=True):
            actor.incarnation = incarnation

    def close(self) -> None:
        """Ends the actors, and Ray where it was started here."""
        begun = [actor for actor in self.actors if actor.handle is not None]
        if not begun and not self._connected:
            return
        import ray

        for actor in begun:
            if ray.is_initialized():  # otherwise they have ended with it
                ray.kill(actor.handle)
            actor.handle = None
        self._calls.clear()
        self._published = -1, None
        if self._connected:
            self._connected = False
            ray.shutdown()

    def _connect(self) -> None:
        # Read when Ray is imported or starts its processes.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # a warning, otherwise
        import ray

        count, address = self.options.actors, self.options.address
        if not ray.is_initialized():
            own: dict[str, Any] = {}
            if address is None:
                own = {"num_cpus": count, "include_dashboard": False}
            quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
            try:
                if address not in (None, "auto"):  # where nobody listens, Ray tries for minutes
                    host, _, port = str(address).rpartition(":")
                    socket.create_connection((host, int(port)), timeout=10).close()
                ray.init(address or "local", **quiet, **own)
            except (ConnectionError, RuntimeError, ValueError, OSError) as error:
                reason = " ".join(str(error).split())
                raise UserError(f"runtime.address={address}: no cluster there: {reason}") from None
            self._connected = True
        elif address not in (None, "auto", there := ray.get_runtime_context().gcs_address):
            raise UserError(
                f"runtime.address={address}: this process belongs to the cluster {there}; should "
                "be that, auto or null"
            )
        cores = int(ray.cluster_resources().get("CPU", 0))
        if cores < count:
            raise UserError(
                f"runtime.actors={count}: the cluster has {cores} cores, one for each actor; "
                f"should be at most {cores}"
            )

    def _begin(self, actor: _Actor) -> None:
        """Starts an actor's next incarnation."""
        import ray

        actor.incarnation += 1
        actor.begun, actor.has_played = False, False
        actor.learned, actor.carried = 0, {}
        actor.handle = ray.remote(Collecting).options(num_cpus=1).remote()
        reference = actor.handle.begin.remote(self._config, actor.number, actor.incarnation)
        self._calls[reference] = _Call(actor, None)

    def _ask(self, actor: _Actor) -> None:
        """Asks an actor for an unroll by the weights as they are."""
        reference = actor.handle.play.remote(self._publish())
        self._calls[reference] = _Call(actor, self.version)

    def _publish(self) -> Any:
        """A reference of the weights as they are."""
        import ray

        if self._published[0] != self.version:
            weights = self.agent.weights()
            cpu = {name: weight.detach().cpu() for name, weight in weights.items()}
            self._published = self.version, ray.put(arrays(cpu))
        return self._published[1]

    def _take(self) -> tuple[_Actor, dict[str, Any]]:
        """The next unroll to learn from, with its actor."""
        while True:
            call, result = self._next_result()
            actor = call.actor
            if call.version is None:
                self._check_version(actor, result)
                actor.begun = True
                for _ in range(self.options.ahead):
                    self._ask(actor)
                continue
            self._ask(actor)
            actor.has_played = True
            lag = self.version - call.version
            # Older ones are discarded, as by Petrenko et al. 2020. Ours: 4, so that a node may be
            # about four times slower than the others.
            if lag <= 4 * self.options.actors * self.options.ahead:
                self._lags.append(lag)
                return actor, result
            self._discarded += 1

    def _next_result(self) -> tuple[_Call, Any]:
        """Of those calls that have returned the oldest, and what it returned; replaces actors that
        are lost."""
        import ray
        from ray import exceptions

        lost = (
            exceptions.RayActorError,
            exceptions.ObjectLostError,
            exceptions.NodeDiedError,
            exceptions.WorkerCrashedError,
            exceptions.OutOfMemoryError,
        )
        while True:
            reference = self._wait()
            call = self._calls.pop(reference)
            try:
                return call, ray.get(reference)
            except lost as error:
                self._replace(call.actor, error)
            except exceptions.RayTaskError as error:
                if isinstance(error.cause, EXPECTED):
                    raise UserError(f"actor {call.actor.number}: {error.cause}") from None
                raise

    def _wait(self) -> Any:
        """The reference of the oldest call that has returned. Raises Stopped: there is none, and
        the run has to stop."""
        import ray

        said = time.monotonic()
        while True:
            references = list(self._calls)
            done, _ = ray.wait(references, num_returns=len(references), timeout=0)
            if not done:
                done, _ = ray.wait(references, num_returns=1, timeout=1.0)
            if done:
                found = set(done)
                return next(one for one in references if one in found)
            if self._stopping():
                raise Stopped
            if time.monotonic() - said > PATIENCE:
                said = time.monotonic()
                begun = sum(actor.begun for actor in self.actors)
                self._tell(
                    f"waits for unrolls; {begun} of {len(self.actors)} actors have begun, and the "
                    f"cluster has {ray.cluster_resources().get('CPU', 0):.0f} cores"
                )

    def _replace(self, actor: _Actor, error: Exception) -> None:
        import ray

        # Ray's errors are of many lines, the first of them of many sentences.
        lines = str(error).strip().splitlines() or [""]
        reason = f"{type(error).__name__}: {lines[0].split('. ')[0]}"
        actor.deaths = 0 if actor.has_played else actor.deaths + 1
        if actor.deaths == MOST_DEATHS:
            raise UserError(
                f"runtime=ray: actor {actor.number} died {MOST_DEATHS} times before it had played "
                f"an unroll: {reason}"
            ) from None
        self._tell(f"actor {actor.number} is lost and replaced: {reason}")
        self._replaced += 1
        ray.kill(actor.handle)  # it may be out of reach only
        self._calls = {ref: call for ref, call in self._calls.items() if call.actor is not actor}
        self._begin(actor)

    @staticmethod
    def _check_version(actor: _Actor, version: str) -> None:
        if version != zipf.__version__:
            raise UserError(
                f"runtime=ray: actor {actor.number} has zipf {version}, and the learner "
                f"{zipf.__version__}; install the same version on all nodes"
            )
