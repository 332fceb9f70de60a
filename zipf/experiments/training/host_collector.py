"""The collector of envs that the CPU steps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from threading import Event
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.memory import State
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.building.checkpoint import arrays
from zipf.experiments.hooks.augmentation import HostAugmentation
from zipf.experiments.hooks.exploration import CountBonus
from zipf.experiments.hooks.hook import Hook
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.collector import OUTCOMES, Collector, Step
from zipf.experiments.training.unroll_buffers import CARRIED, UnrollBuffers


class Abandoned(Exception):
    """`HostCollector.abandon` was called."""


class HostCollector(Collector):
    """Fills one unroll after another without dropping a frame.

    The environment writes its observations straight into an unroll. There are 1 + `lag` unrolls,
    used in turn: an agent that keeps frames for longer copies them. They are in RAM: pinned, if the
    agent computes on a CUDA device.

    Attributes:
        visits: how often each situation was met.

    Args:
        env: a batch in SAME_STEP autoreset mode; reset here, with `seed`.
        agent, unroll_length, hooks: see `Collector`.
        seed: of the envs and of the agent's actions.
        lag: for how many further calls of `collect` an unroll stays valid.

    Raises:
        ValueError: the agent's burn-in is longer than an unroll.
    """

    env: ZipfVectorEnv

    def __init__(
        self,
        env: ZipfVectorEnv,
        agent: Agent,
        *,
        unroll_length: int,
        seed: int,
        hooks: Sequence[Hook] = (),
        lag: int = 0,
    ):
        self.visits = Visits(tuple(env.situation))
        super().__init__(
            env,
            agent,
            unroll_length=unroll_length,
            hooks=[self.visits, *hooks],
            generator=torch.Generator(),
        )
        self._augmentation = cast(HostAugmentation | None, agent.augmentation)
        self._episodes: dict[str, list[float]] = defaultdict(list)
        self._abandoned = Event()
        self._final = env.allocate()
        self._final_tensors = tensors(self._final)
        self._buffers = [
            UnrollBuffers(
                self._final_tensors,
                unroll_length + 1,
                finals=agent.needs.final_observations,
                further=self._columns,
                pinned=self.device.startswith("cuda"),
            )
            for _ in range(1 + lag)
        ]
        self.begin_episodes(seed)

    def begin_episodes(self, seed: int) -> None:
        """Begins new episodes in all envs; the seed is of these, of later ones and of actions."""
        self._generator.manual_seed(seed)
        self.env.reset(seed=seed, out=self._buffers[-1].observation_row(-1))
        self._show(self._buffers[-1], -1, torch.ones(self.env.num_envs, dtype=torch.bool))

    def collect(self) -> Unroll:
        """Plays T steps in every env.

        Returns an unroll whose steps are in RAM and whose memory is on the device.

        Raises:
            Abandoned: `abandon` was called.
        """
        before = self._buffers[-1]
        self._buffers = [*self._buffers[1:], self._buffers[0]]
        self._buffers[-1].begin_after(before)
        return self._fill(self._buffers[-1])

    def abandon(self) -> None:
        """Makes `collect` raise `Abandoned` at its next step, for good; called by another thread
        than the one that collects."""
        self._abandoned.set()

    def episode_metrics(self) -> dict[str, float]:
        """Means over the episodes that ended since the last call.

        `episode_return` and `episode_length` (NaN if no episode ended), `episode_success` if the
        envs report it, and, with several levels, the same for each level whose episodes ended:
        `episode_return/<level>` and so on.
        """
        return episode_metrics(self.take_episodes())

    def take_episodes(self) -> dict[str, list[float]]:
        """The outcomes of the episodes that ended since the last call, by the names that
        `episode_metrics` has them by."""
        episodes, self._episodes = dict(self._episodes), defaultdict(list)
        return episodes

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next unroll depends on."""
        fields = self._buffers[-1].fields
        return {
            "environment": self.env.get_state(),
            "memory": dict(self._memory),
            "generator": self._generator.get_state(),
            "inputs": {name: fields[name][-1].copy() for name in CARRIED},
            "episodes": dict(self._episodes),
            **{hook.name: hook.state_dict() for hook in self.hooks},
        }

    def begin_with(self, visits: Mapping[str, Any], hooks: Mapping[str, Any]) -> None:
        """Goes on with new episodes, and with the visits and the bonus's counts of a collector of
        tensor environments."""
        self.visits.load_state_dict(visits)
        for hook in self.hooks:
            if isinstance(hook, CountBonus):
                hook.load_state_dict(hooks[hook.name])

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        buffers = self._buffers[-1]
        restarted = self.env.set_state(arrays(state["environment"]))
        self.env.observations(out=buffers.observation_row(-1))
        self._memory = {k: v.to(self.device) for k, v in state["memory"].items()}
        self._generator.set_state(state["generator"])
        self._episodes = defaultdict(list, {k: list(v) for k, v in state["episodes"].items()})
        for name, value in state["inputs"].items():
            buffers.fields[name][-1] = value
        # Envs that could not be restored have begun another episode.
        beginning = {"is_first": True, "previous_action": -1, "previous_reward": 0.0}
        for name, value in beginning.items():
            buffers.fields[name][-1][restarted] = value
        for hook in self.hooks:
            hook.load_state_dict(arrays(state.get(hook.name, {})))
        self._show(buffers, -1, torch.from_numpy(restarted), bool(restarted.any()))

    def _step(self, buffers: UnrollBuffers, t: int) -> None:
        if self._abandoned.is_set():
            raise Abandoned
        super()._step(buffers, t)

    def _advance(self, buffers: UnrollBuffers, t: int) -> Step:
        played = buffers.fields["action"][t]
        if self._augmentation is not None:
            played = self._augmentation.to_env(played, buffers.fields["draw"][t])
        _, reward, terminated, truncated, info = self.env.step(
            played, out=buffers.observation_row(t + 1), final_out=self._final
        )
        ended = terminated | truncated
        any_ended = bool(ended.any())
        outcome = info["final_info"] if any_ended else {}
        if any_ended:
            self._record(outcome, ended)
        return Step(
            torch.from_numpy(reward),
            torch.from_numpy(terminated),
            torch.from_numpy(truncated),
            self._final_tensors,
            tensors({name: part for name, part in outcome.items() if part.dtype.kind in "biuf"}),
            any_ended,
        )

    def _remember(self, memory: State) -> None:
        self._memory = memory

    def _kept(self, place: str) -> State:
        return self._memory  # the agent makes another one in every step

    def _truncate(self, buffers: UnrollBuffers, t: int, step: Step) -> None:
        fields, reward = buffers.fields, step.reward.numpy()
        fields["truncation_value"][t] = 0.0
        truncated = fields["truncated"][t]
        if truncated.any() and buffers.final is not None:
            buffers.keep_final(t, truncated, self._final, reward)
        elif truncated.any():
            fields["truncation_value"][t, truncated] = self._value_at_truncation(
                buffers, t, reward.astype(np.float32), truncated
            )

    def _record(self, final_info: dict[str, NDArray], ended: NDArray[np.bool_]) -> None:
        """Keeps the outcomes of the episodes that ended, for `episode_metrics`."""
        levels = self.env.level_of_envs
        if isinstance(levels, str):
            levels = final_info[levels]
        for name in OUTCOMES:
            if name == "success" and not self.env.reports_success:
                continue
            values = final_info[name][ended].tolist()
            self._episodes[name].extend(values)
            if levels is not None:
                for level, value in zip(levels[ended], values, strict=True):
                    self._episodes[f"{name}/{level}"].append(value)

    def _value_at_truncation(
        self, buffers: UnrollBuffers, t: int, reward: NDArray, truncated: NDArray[np.bool_]
    ) -> NDArray:
        def send(array: NDArray) -> Tensor:
            return torch.from_numpy(array[truncated])

        observation = {name: send(part) for name, part in self._final.items()}
        if self._augmentation is not None:
            observation = self._augmentation(observation, send(buffers.fields["draw"][t]))
        inputs = Inputs(
            {name: part.to(self.device) for name, part in observation.items()},
            send(buffers.fields["action"][t]).to(self.device),
            send(reward).to(self.device),
            torch.zeros(int(truncated.sum()), dtype=torch.bool, device=self.device),
        )
        rows = torch.from_numpy(truncated).to(self.device)
        memory = {name: value[rows] for name, value in self._memory.items()}
        return self.agent.value(inputs, memory).cpu().numpy()


def episode_metrics(episodes: Mapping[str, list[float]]) -> dict[str, float]:
    """The means of `HostCollector.take_episodes()`."""
    metrics = {f"episode_{name}": float("nan") for name in ("return", "length")}
    return metrics | {f"episode_{name}": float(np.mean(v)) for name, v in episodes.items()}


def tensors(parts: Mapping[str, NDArray[Any]]) -> dict[str, Tensor]:
    """The same memory as tensors."""
    return {name: torch.from_numpy(part) for name, part in parts.items()}
