"""The collector of tensor environments: an unroll is one function of tensors.

It makes what `zipf.experiments.training.collector` makes, with tensors on the device of the agent
and of the envs. Nothing waits for the device within an unroll, and all shapes are fixed, so that an
unroll can be captured as a CUDA graph and played again as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.capture import Captured, CudaGraph, Graph
from zipf.agents.memory import State
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.envs.tensor import Codes, TensorEnv
from zipf.experiments.building.checkpoint import arrays
from zipf.experiments.hooks.hook import Hook
from zipf.experiments.hooks.tensor import Counts, View
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.collector import OUTCOMES, Collector, Step
from zipf.experiments.training.unroll_buffers import CARRIED, UnrollBuffers


class TensorCollector(Collector):
    """Fills one unroll after another, as one function of tensors.

    Where episodes are truncated the values of their last observations are computed once, after the
    unroll: of each env there is room for K = 1 + (T - 1) // max_steps of these observations, more
    than which cannot be cut in T steps.

    Attributes:
        reported: what episodes come to: `OUTCOMES`, without success where the envs report none.
        outcomes: of the episodes that ended in the unroll, float64 [1 + len(reported)]: how many,
            and the sums of what they came to.
        met: how often they were of each situation, int64, all ranks flat.

    Args:
        env: reset here, with `seed`, which is also that of the agent's actions and of what hooks
            draw.
        agent: acts, on the device of the envs; its augmentation is a `View` of them.
        unroll_length, hooks: see `Collector`.

    Raises:
        ValueError: the agent's burn-in is longer than an unroll.
    """

    env: TensorEnv

    def __init__(
        self,
        env: TensorEnv,
        agent: Agent,
        *,
        unroll_length: int,
        seed: int,
        hooks: Sequence[Hook] = (),
    ):
        super().__init__(
            env, agent, unroll_length=unroll_length, hooks=hooks, generator=env.generator
        )
        assert isinstance(agent.augmentation, View)
        self._view = agent.augmentation
        self._captured: Captured | None = None
        env.reset(seed)
        slots = agent.needs.final_observations
        self._bootstraps = not slots
        self._buffers = UnrollBuffers(
            env.observe(),
            unroll_length + 1,
            finals=slots or 1 + (unroll_length - 1) // env.max_steps,
            further=self._columns,
        )
        assert self._buffers.final is not None
        self._final = self._buffers.final
        self._memories: dict[str, State] = {}  # those that an unroll has, by their place
        self._final_memory = {
            name: part.new_zeros(len(self._final), *part.shape)
            for name, part in (self._memory if self._bootstraps else {}).items()
        }
        self._cut = torch.zeros(env.num_envs, dtype=torch.int64, device=self.device)
        self.reported = [name for name in OUTCOMES if name != "success" or env.reports_success]
        self.outcomes = torch.zeros(1 + len(self.reported), dtype=torch.float64, device=self.device)
        self.ranks = dict(env.situation)
        sizes = int(np.prod(list(self.ranks.values())))
        self.met = torch.zeros(sizes, dtype=torch.int64, device=self.device)
        self._one = torch.ones(env.num_envs, dtype=torch.int64, device=self.device)
        self._show_first()

    def begin_episodes(self, seed: int) -> None:
        """Begins new episodes in all envs; the seed is of all that is drawn."""
        self.env.reset(seed)
        self._show_first()

    def _show_first(self) -> None:
        _copy(self._buffers.shown(self.unroll_length), self.env.observe())
        self._show(self._buffers, self.unroll_length, self._one.bool())

    def collect(self) -> Unroll:
        """Plays T steps in every env. The unroll is overwritten by the next call."""
        return self._play() if self._captured is None else self._captured()

    def capture(self, graph: Callable[[str], Graph] = CudaGraph) -> None:
        """From now on unrolls are played as a graph, which the first call records."""
        self._captured = Captured(
            self._play,
            graph(self.device),
            self.tensors,
            generators=[self.env.generator],
            name="an unroll",
        )

    def tensors(self) -> list[Tensor]:
        """All that an unroll writes in place and that later ones depend on."""
        last = dict(self._buffers.steps["observation"].items()) | self._buffers.rows[-1]
        parts: list[dict[str, Tensor]] = [self.env.tensors(), self._memory, last]
        parts += [hook.tensors() for hook in self.hooks]
        return [tensor for part in parts for tensor in part.values()]

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next unroll depends on."""
        inputs = {name: self._buffers.rows[-1][name].clone() for name in CARRIED}
        return {
            "environment": self.env.get_state(),
            "memory": {name: part.clone() for name, part in self._memory.items()},
            "inputs": inputs,
            "hooks": {
                hook.name: {name: part.clone() for name, part in hook.tensors().items()}
                for hook in self.hooks
            },
        }

    def begin_with(self, hooks: Mapping[str, Any]) -> None:
        """Goes on with new episodes and with what a host's collector has counted for the bonus."""
        for hook in self.hooks:
            if isinstance(hook, Counts):
                hook.visits.copy_(hooks[hook.name]["visits"])

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.env.set_state(state["environment"])
        for name, part in self._memory.items():
            part.copy_(state["memory"][name])
        for hook in self.hooks:
            for name, part in hook.tensors().items():
                part.copy_(state["hooks"][hook.name][name])
        for name in CARRIED:
            self._buffers.rows[-1][name].copy_(state["inputs"][name])
        _copy(self._buffers.shown(self.unroll_length), self.env.observe())
        for hook in self.hooks:
            hook.show(self._buffers.rows[-1])

    @torch.no_grad()
    def _play(self) -> Unroll:
        self._buffers.begin_after(self._buffers)
        for tensor in (self._cut, self.outcomes, self.met):
            tensor.zero_()
        return self._fill(self._buffers)

    def _advance(self, buffers: UnrollBuffers, t: int) -> Step:
        row = buffers.rows[t]
        stepped = self.env.step(self._view.to_env(row["action"], row.get("draw")))
        _copy(buffers.shown(t + 1), self.env.observe())
        self._record(stepped.outcome, stepped.terminated | stepped.truncated)
        return Step(*stepped)

    def _remember(self, memory: State) -> None:
        _copy(self._memory, memory)

    def _kept(self, place: str) -> State:
        kept = self._memories.setdefault(
            place, {name: torch.zeros_like(part) for name, part in self._memory.items()}
        )
        _copy(kept, self._memory)
        return kept

    def _record(self, outcome: Codes, ended: Tensor) -> None:
        """Adds the outcomes of the episodes that ended."""
        sums = [ended.sum(dtype=torch.float64)]
        sums += [(outcome[name].double() * ended).sum() for name in self.reported]
        self.outcomes.add_(torch.stack(sums))
        if self.ranks:
            index = torch.zeros_like(self._one)
            for name, size in self.ranks.items():
                index = index * size + outcome[name]
            self.met.index_add_(0, index.clamp(0, len(self.met) - 1), ended.long())

    def _truncate(self, buffers: UnrollBuffers, t: int, step: Step) -> None:
        """Keeps what episodes were truncated at after row t, and the memory there."""
        row = buffers.rows[t]
        truncated = row["truncated"]
        given = {
            "step": torch.full_like(self._cut, t),
            "previous_action": row["action"],
            "previous_reward": step.reward,
        } | {name: part for name, part in row.items() if name == "draw"}
        for k in range(len(self._final)):
            here = truncated & (self._cut == k)
            for part, new in ((self._final["observation"], step.final), (self._final, given)):
                for name, value in new.items():
                    part[name][k].copy_(_where(here, value, part[name][k]))
            for name, kept in self._final_memory.items():
                kept[k].copy_(_where(here, self._memory[name], kept[k]))
        self._cut.add_(truncated)

    def _finish(self, buffers: UnrollBuffers) -> None:
        """Values what episodes were truncated at, all in one pass."""
        if not self._bootstraps:
            return
        final, n = self._final.flatten(0, 1), self.env.num_envs
        observation = self._view(dict(final["observation"].items()), final.get("draw", None))
        inputs = Inputs(observation, *(final[name] for name in CARRIED))
        memory = {name: part.flatten(0, 1) for name, part in self._final_memory.items()}
        values = self.agent.value(inputs, memory).view(-1, n)
        at = torch.arange(self.unroll_length, device=values.device).view(-1, 1, 1)
        here = at == self._final["step"]  # [T, K, N]
        found = torch.where(here, values, 0.0).sum(1)
        buffers.steps["truncation_value"][:-1].copy_(found)


class Tally:
    """What episodes came to, and how often situations were met, of the unrolls that were learned
    from: sums on the device, until they are asked for."""

    def __init__(self, collector: TensorCollector):
        self._collector = collector
        self._outcomes = torch.zeros_like(collector.outcomes)
        self._met = torch.zeros_like(collector.met)
        self._visits = Visits(tuple(collector.ranks))

    def add(self, outcomes: Tensor, met: Tensor) -> None:
        """Adds those of an unroll."""
        self._outcomes.add_(outcomes)
        self._met.add_(met)

    def metrics(self) -> dict[str, float]:
        """Means over the episodes since the last call; NaN if none ended."""
        count, *sums = self._outcomes.tolist()
        self._outcomes.zero_()
        return {
            f"episode_{name}": total / count if count else float("nan")
            for name, total in zip(self._collector.reported, sums, strict=True)
        }

    @property
    def visits(self) -> Visits:
        """How often each situation was met."""
        met = self._met.cpu().clone().numpy()
        self._met.zero_()
        index = met.nonzero()[0]
        if self._collector.ranks:
            ranks = np.unravel_index(index, tuple(self._collector.ranks.values()))
            situations = np.stack(ranks, 1).astype(np.int64)
            self._visits.add_those({"situations": situations, "episodes": met[index]})
        return self._visits

    def state_dict(self) -> dict[str, Any]:
        """Everything so far."""
        return {"outcomes": self._outcomes.clone(), "visits": self.visits.state_dict()}

    def begin_with(self, visits: Mapping[str, Any]) -> None:
        """Goes on with what others have met."""
        self._visits.load_state_dict(arrays(visits))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self._outcomes.copy_(state["outcomes"])
        self._met.zero_()
        self.begin_with(state["visits"])


def _where(mask: Tensor, new: Tensor, old: Tensor) -> Tensor:
    """Rows [N, ...] of `new` where `mask` [N], else those of `old`."""
    return torch.where(mask.view(-1, *[1] * (new.ndim - 1)), new, old)


def _copy(target: Mapping[str, Tensor], source: Mapping[str, Tensor]) -> None:
    for name, part in target.items():
        part.copy_(source[name])
