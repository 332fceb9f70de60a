"""The collector: the agent acts in a batch of envs, and unrolls are filled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

import torch
from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.memory import State
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.experiments.hooks.hook import Hook, Parts, Row
from zipf.experiments.training.unroll_buffers import CARRIED, UnrollBuffers

OUTCOMES = ("return", "length", "success")
OWN_STATE = ("environment", "memory", "generator", "inputs", "episodes")  # saved beside the hooks'


class Step(NamedTuple):
    """What the envs have made of an action, on their device."""

    reward: Tensor  # [N], the task's: float64 on the host, else float32
    terminated: Tensor  # bool [N]
    truncated: Tensor  # bool [N]
    final: Parts  # as `Row` has it, and the next three
    outcome: Parts
    any_ended: bool = True


class Collector(ABC):
    """The base of collectors: what happens in a step, in envs on the host or on the device.

    What is kept of observations is what the envs show; what an agent sees of it, its augmentation
    makes.

    Attributes:
        seconds: spent in `environment` (stepping the envs) and `inference` (the agent acts).

    Args:
        env: the envs.
        agent: acts.
        unroll_length: T.
        hooks: what else happens around a step, in this order.
        generator: of the agent's actions.

    Raises:
        ValueError: the agent's burn-in is longer than an unroll.
    """

    def __init__(
        self,
        env: Any,
        agent: Agent,
        *,
        unroll_length: int,
        hooks: Sequence[Hook],
        generator: torch.Generator,
    ):
        burn_in = agent.needs.burn_in
        if burn_in > unroll_length:
            raise ValueError(
                f"a burn-in of {burn_in} rows is longer than an unroll of {unroll_length}"
            )
        names = [hook.name for hook in hooks]
        if taken := [name for name in names if name in OWN_STATE or names.count(name) > 1]:
            raise ValueError(
                f"a hook's name is where its state is saved, and {taken[0]!r} is the collector's "
                "own or another hook's"
            )
        self.env = env
        self.agent = agent
        self.unroll_length = unroll_length
        self.device = agent.device
        self.hooks = list(hooks)
        self.seconds = {"environment": 0.0, "inference": 0.0}
        self._generator = generator
        self._memory = agent.initial_memory(env.num_envs)
        self._columns = {k: like for hook in self.hooks for k, like in hook.columns.items()}

    @abstractmethod
    def _advance(self, buffers: UnrollBuffers, t: int) -> Step:
        """Takes the actions of row t, writes what the envs show then to row t + 1, and keeps the
        outcomes of the episodes that ended."""

    @abstractmethod
    def _remember(self, memory: State) -> None:
        """`_memory` is this one from now on."""

    @abstractmethod
    def _kept(self, place: str) -> State:
        """The memory as it is now, which stays so for as long as an unroll; `place` tells apart
        what an unroll has of it."""

    @abstractmethod
    def _truncate(self, buffers: UnrollBuffers, t: int, step: Step) -> None:
        """Values what episodes were truncated at after row t, or keeps it."""

    def _fill(self, buffers: UnrollBuffers) -> Unroll:
        """Plays T steps in every env, into buffers whose first row is there."""
        burn_in, late = self.agent.needs.burn_in, None
        memory = self._kept("memory")
        for t in range(self.unroll_length):
            if t == self.unroll_length - burn_in:
                late = self._kept("late_memory")
            self._step(buffers, t)
        self._finish(buffers)
        final = buffers.final if self.agent.needs.final_observations else None
        unroll = Unroll(buffers.steps, memory, late, final)
        for hook in self.hooks:
            hook.finish(unroll)
        return unroll

    def _finish(self, buffers: UnrollBuffers) -> None:
        """All steps are made; does nothing here."""
        return

    def _step(self, buffers: UnrollBuffers, t: int) -> None:
        start = perf_counter()
        row, following = buffers.rows[t], buffers.rows[t + 1]
        observation, augmentation = buffers.shown(t), self.agent.augmentation
        seen = observation
        if augmentation is not None:
            seen = augmentation(observation, row.get("draw"))
        inputs = Inputs(
            {name: part.to(self.device, non_blocking=True) for name, part in seen.items()},
            *(row[name].to(self.device, non_blocking=True) for name in CARRIED),
        )
        action, memory, behaviour = self.agent.act(inputs, self._memory, self._generator)
        self._remember(memory)
        buffers.write(t, behaviour)
        row["action"].copy_(action)  # the host waits for the copies above, too
        acted = perf_counter()
        for hook in self.hooks:
            hook.act(row, self._generator)

        step = self._advance(buffers, t)
        ended = step.terminated | step.truncated
        row["reward"].copy_(step.reward)
        row["terminated"].copy_(step.terminated)
        row["truncated"].copy_(step.truncated)
        following["previous_action"].copy_(row["action"].masked_fill(ended, -1))
        following["previous_reward"].copy_(step.reward.masked_fill(ended, 0.0))
        following["is_first"].copy_(ended)
        whole = Row(
            observation,
            row,
            step.reward,
            buffers.shown(t + 1),
            step.final,
            ended,
            step.any_ended,
            step.outcome,
        )
        for hook in self.hooks:
            hook.step(whole)
        self._show(buffers, t + 1, ended, step.any_ended)
        stepped = perf_counter()
        self._truncate(buffers, t, step)
        self.seconds["inference"] += acted - start + perf_counter() - stepped
        self.seconds["environment"] += stepped - acted

    def _show(self, buffers: UnrollBuffers, t: int, begins: Tensor, any_begin: bool = True) -> None:
        """Row t is there; episodes begin in it where `begins` [N]."""
        if any_begin:
            for hook in self.hooks:
                hook.begin(buffers.shown(t), begins)
        for hook in self.hooks:
            hook.show(buffers.rows[t])
