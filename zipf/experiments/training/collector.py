"""The collector: the agent acts in a batch of worlds, and unrolls are filled."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from threading import Event
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.exploration import Bonus
from zipf.agents.hindsight import NO_HINDSIGHT, AchievedOptions, HindsightOptions
from zipf.agents.network import Inputs
from zipf.agents.reweighting import GoalWeights
from zipf.agents.unroll import Unroll
from zipf.envs.goals import Goal
from zipf.envs.mixture import Mixture
from zipf.envs.policies import Teacher
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.building.checkpoint import arrays
from zipf.experiments.hooks.augmentation import Augmentation
from zipf.experiments.hooks.relabelling import RELABELLINGS, Hindsight
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training.unroll_buffers import CARRIED, UnrollBuffers

_OUTCOMES = ("return", "length", "success")


class Abandoned(Exception):
    """`Collector.abandon` was called."""


class Collector:
    """Fills one unroll after another without dropping a frame.

    The environment writes its observations straight into an unroll. There are 1 + `lag` unrolls,
    used in turn: an agent that keeps frames for longer copies them.

    Attributes:
        seconds: spent in `environment` (stepping the worlds) and `inference` (the agent acts).
        visits: how often each situation was met.

    Args:
        env: a batch in SAME_STEP autoreset mode; reset here, with `seed`.
        agent: acts.
        unroll_length: T.
        seed: of the worlds and of the agent's actions.
        device: where the agent computes. Unrolls are in RAM: pinned, if the device is CUDA.
        exploration: adds a bonus for the observations that actions lead to, before augmentation.
        augmentation: changes what the agent sees of the worlds.
        lag: for how many further calls of `collect` an unroll stays valid.
        bootstrap_at_time_limit: whether unrolls tell time limits from the end of the task. If
            not, `terminated` is set in the place of `truncated`.
        teacher: of these worlds, for an agent that learns from one.
        reward_clipping: "none", or "soft_asymmetric": the agent learns from squashed rewards (see
            `soft_asymmetric`); the previous rewards in its input and episodes' returns stay as
            they are.
        goal: reads what episodes ask for; needed where something depends on it.
        reweighting: gives frames of episodes with a rare goal a larger weight.
        hindsight: relabels episodes with what they achieved.

    Raises:
        ValueError: the agent's burn-in is longer than an unroll, or nothing says what episodes ask
            for, or what they achieve, and something depends on it.
    """

    def __init__(
        self,
        env: ZipfVectorEnv,
        agent: Agent,
        *,
        unroll_length: int,
        seed: int,
        device: str = "cpu",
        exploration: Bonus | None = None,
        augmentation: Augmentation | None = None,
        lag: int = 0,
        bootstrap_at_time_limit: bool = True,
        reward_clipping: str = "none",
        teacher: Teacher | None = None,
        goal: Goal | None = None,
        reweighting: GoalWeights | None = None,
        hindsight: HindsightOptions = NO_HINDSIGHT,
    ):
        burn_in = agent.needs.burn_in
        if burn_in > unroll_length:
            raise ValueError(
                f"a burn-in of {burn_in} rows is longer than an unroll of {unroll_length}"
            )
        relabels = isinstance(hindsight, AchievedOptions)
        if goal is None and (reweighting is not None or relabels):
            raise ValueError("these worlds do not say what an episode asks for")
        self.env = env
        self.agent = agent
        self.unroll_length = unroll_length
        self.device = device
        self.exploration = exploration
        self.augmentation = augmentation
        self.bootstrap_at_time_limit = bootstrap_at_time_limit
        self.reward_clipping = reward_clipping
        self.teacher = teacher
        self.goal = goal
        self.reweighting = reweighting
        self.hindsight: Hindsight | None = None
        if isinstance(hindsight, AchievedOptions):
            assert goal is not None
            success = float(self._learned(np.array([hindsight.reward]))[0])
            self.hindsight = RELABELLINGS.build(
                hindsight,
                goal,
                env,
                reward=success,
                seed=seed,
                augmentation=augmentation,
                teacher=teacher is not None,
            )
        self.seconds = {"environment": 0.0, "inference": 0.0}
        self.visits = Visits(tuple(env.situation))
        self._episodes: dict[str, list[float]] = defaultdict(list)
        self._generator = torch.Generator().manual_seed(seed)
        self._memory = agent.initial_memory(env.num_envs)
        self._abandoned = Event()
        pinned = device.startswith("cuda")
        further = {
            **({"label": torch.int64} if teacher is not None else {}),
            **({"weight": torch.float32} if reweighting is not None else {}),
        }
        self._buffers = [
            UnrollBuffers(env, unroll_length + 1, agent.needs.final_observations, further, pinned)
            for _ in range(1 + lag)
        ]
        self._final = env.allocate()
        env.reset(seed=seed, out=self._buffers[-1].observation_row(-1))
        everywhere = np.ones(env.num_envs, np.bool_)
        self._count(self._buffers[-1].observation_row(-1), everywhere)
        self._shown: dict[str, NDArray] = {}  # the last observation before augmentation
        if augmentation:
            augmentation.begin(everywhere)
            self._change(self._buffers[-1].observation_row(-1))

    def collect(self) -> Unroll:
        """Plays T steps in every world.

        Returns an unroll whose steps are in RAM and whose memory is on the device.

        Raises:
            Abandoned: `abandon` was called.
        """
        before = self._buffers[-1]
        self._buffers = [*self._buffers[1:], self._buffers[0]]
        buffers = self._buffers[-1]
        buffers.begin_after(before)
        memory, late_memory = self._memory, None
        asked = []
        for t in range(self.unroll_length):
            if self._abandoned.is_set():
                raise Abandoned
            if self.agent.needs.burn_in and t == self.unroll_length - self.agent.needs.burn_in:
                late_memory = self._memory
            if self.reweighting is not None:
                asked.append(self.reweighting.counters.copy())
            self._step(buffers, t)
        if self.reweighting is not None:
            buffers.fields["weight"][:-1] = self.reweighting.weights(np.stack(asked))
        episodes = self.hindsight.take() if self.hindsight is not None else None
        return Unroll(buffers.steps, memory, late_memory, buffers.final, episodes)

    def abandon(self) -> None:
        """Makes `collect` raise `Abandoned` at its next step, for good; called by another thread
        than the one that collects."""
        self._abandoned.set()

    def episode_metrics(self) -> dict[str, float]:
        """Means over the episodes that ended since the last call.

        `episode_return` and `episode_length` (NaN if no episode ended), `episode_success` if the
        worlds report it, and, with several levels, the same for each level whose episodes ended:
        `episode_return/<level>` and so on.
        """
        return episode_metrics(self.take_episodes())

    def take_episodes(self) -> dict[str, list[float]]:
        """The outcomes of the episodes that ended since the last call, by the names that
        `episode_metrics` has them by."""
        episodes, self._episodes = dict(self._episodes), defaultdict(list)
        return episodes

    def take_visits(self) -> Visits:
        """How often each situation was met since the last call, or since the beginning."""
        visits, self.visits = self.visits, Visits(self.visits.ranks)
        return visits

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next unroll depends on."""
        fields = self._buffers[-1].fields
        return {
            "environment": self.env.get_state(),
            "memory": dict(self._memory),
            "generator": self._generator.get_state(),
            "inputs": {name: fields[name][-1].copy() for name in CARRIED},
            "episodes": dict(self._episodes),
            "visits": self.visits.state_dict(),
            "exploration": self.exploration.state_dict() if self.exploration else {},
            "augmentation": self.augmentation.state_dict() if self.augmentation else {},
            "teacher": self.teacher.get_state() if self.teacher else {},
            "reweighting": self.reweighting.state_dict() if self.reweighting else {},
            "hindsight": self.hindsight.state_dict() if self.hindsight else {},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        buffers = self._buffers[-1]
        restarted = self.env.set_state(arrays(state["environment"]))
        self.env.observations(out=buffers.observation_row(-1))
        self._memory = {k: v.to(self.device) for k, v in state["memory"].items()}
        self._generator.set_state(state["generator"])
        self._episodes = defaultdict(list, {k: list(v) for k, v in state["episodes"].items()})
        self.visits.load_state_dict(arrays(state["visits"]))
        for name, value in state["inputs"].items():
            buffers.fields[name][-1] = value
        # Worlds that could not be restored have begun another episode.
        beginning = {"is_first": True, "previous_action": -1, "previous_reward": 0.0}
        for name, value in beginning.items():
            buffers.fields[name][-1][restarted] = value
        if self.exploration:
            self.exploration.load_state_dict(arrays(state["exploration"]))
            self.exploration.end(restarted)
        if self.teacher:
            self.teacher.set_state(arrays(state["teacher"]))
        if self.reweighting:
            self.reweighting.load_state_dict(arrays(state["reweighting"]))
            self._count(buffers.observation_row(-1), restarted)
        if self.hindsight:
            self.hindsight.load_state_dict(arrays(state["hindsight"]), restarted)
        if self.augmentation:
            self.augmentation.load_state_dict(state["augmentation"])
            self.augmentation.begin(restarted)
            self._change(buffers.observation_row(-1))

    def _step(self, buffers: UnrollBuffers, t: int) -> None:
        start = perf_counter()
        fields = buffers.fields
        inputs = Inputs.of(buffers.inputs[t].to(self.device, non_blocking=True))
        action, self._memory, behaviour = self.agent.act(inputs, self._memory, self._generator)
        for name, value in behaviour.items():
            buffers.write(name, t, value)
        fields["action"][t] = action.cpu().numpy()  # waits for the copies above, too
        acted = perf_counter()
        if self.teacher is not None:
            label = self.teacher()
            if self.augmentation:
                label = self.augmentation.from_worlds(label)
            fields["label"][t] = label
            share = torch.rand(self.env.num_envs, generator=self._generator).numpy()
            by_teacher = share < self.agent.needs.teacher_share
            fields["action"][t, by_teacher] = fields["label"][t, by_teacher]

        following = buffers.observation_row(t + 1)
        action_of_worlds = fields["action"][t]
        if self.augmentation:
            action_of_worlds = self.augmentation.to_worlds(action_of_worlds)
        _, reward, terminated, truncated, info = self.env.step(
            action_of_worlds, out=following, final_out=self._final
        )
        ended = terminated | truncated
        if not self.bootstrap_at_time_limit:
            terminated, truncated = ended, np.zeros_like(truncated)
        fields["reward"][t] = self._learned(reward)
        fields["terminated"][t] = terminated
        fields["truncated"][t] = truncated
        fields["previous_action"][t + 1] = np.where(ended, -1, fields["action"][t])
        fields["previous_reward"][t + 1] = np.where(ended, 0.0, reward)
        fields["is_first"][t + 1] = ended
        if self.exploration:
            fields["bonus"][t] = self.exploration(following, ~ended)
            if ended.any():
                fields["bonus"][t] += self.exploration(self._final, ended)
                self.exploration.end(ended)
        if ended.any():
            self._record(info["final_info"], ended)
            self.visits.add(info["final_info"], ended)
            self._count(following, ended)
        if self.hindsight is not None:
            row = {name: part[t] for name, part in fields.items()}
            final_info = info.get("final_info", {})
            seen = self._shown or buffers.observation_row(t)
            self.hindsight.add(seen, row, ended, final_info)
        if self.augmentation:
            self.augmentation.observe(self._final, ended)
            self.augmentation.begin(ended)
            self._change(following)
        stepped = perf_counter()

        fields["truncation_value"][t] = 0.0
        if truncated.any() and buffers.final is not None:
            buffers.keep_final(t, truncated, self._final, reward)
        elif truncated.any():
            values = self._value_at_truncation(
                fields["action"][t], reward.astype(np.float32), truncated
            )
            fields["truncation_value"][t, truncated] = values
        self.seconds["inference"] += acted - start + perf_counter() - stepped
        self.seconds["environment"] += stepped - acted

    def _learned(self, reward: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rewards [N] as the agent learns from them."""
        return soft_asymmetric(reward) if self.reward_clipping == "soft_asymmetric" else reward

    def _change(self, observation: dict[str, NDArray]) -> None:
        """Augments observations, in place; what hindsight relabels is kept as it was."""
        assert self.augmentation is not None
        if self.hindsight is not None:
            self._shown = {name: part.copy() for name, part in observation.items()}
        self.augmentation.observe(observation, np.ones(self.env.num_envs, np.bool_))

    def _count(self, observation: dict[str, NDArray], begins: NDArray[np.bool_]) -> None:
        """Counts what the episodes ask for that begin in some worlds, if that is needed."""
        if self.reweighting is not None and begins.any():
            assert self.goal is not None
            self.reweighting.begin(self.goal.read(observation), begins)

    def _record(self, final_info: dict[str, NDArray], ended: NDArray[np.bool_]) -> None:
        """Keeps the outcomes of the episodes that ended, for `episode_metrics`."""
        levels = None
        if isinstance(self.env, Mixture) and self.env.draw == "resets":
            levels = final_info[f"{self.env.rank}_name"]
        elif isinstance(self.env, Mixture):
            levels = np.array(self.env.level_names)[self.env.levels_of_worlds]
        for name in _OUTCOMES:
            if name == "success" and not self.env.reports_success:
                continue
            values = final_info[name][ended].tolist()
            self._episodes[name].extend(values)
            if levels is not None:
                for level, value in zip(levels[ended], values, strict=True):
                    self._episodes[f"{name}/{level}"].append(value)

    def _value_at_truncation(
        self, action: NDArray, reward: NDArray, truncated: NDArray[np.bool_]
    ) -> NDArray:
        def send(array: NDArray) -> Tensor:
            return torch.from_numpy(array[truncated]).to(self.device)

        inputs = Inputs(
            {name: send(part) for name, part in self._final.items()},
            send(action),
            send(reward),
            torch.zeros(int(truncated.sum()), dtype=torch.bool, device=self.device),
        )
        rows = torch.from_numpy(truncated).to(self.device)
        memory = {name: value[rows] for name, value in self._memory.items()}
        return self.agent.value(inputs, memory).cpu().numpy()


def episode_metrics(episodes: Mapping[str, list[float]]) -> dict[str, float]:
    """The means of `Collector.take_episodes()`."""
    metrics = {f"episode_{name}": float("nan") for name in ("return", "length")}
    return metrics | {f"episode_{name}": float(np.mean(v)) for name, v in episodes.items()}


def soft_asymmetric(reward: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rewards [N] squashed to -1.5 .. 5, bad ones to a third of what good ones of their size are.

    `5 tanh(r / 5)`, times 0.3 where r < 0, as the code of Espeholt et al. 2018 has it; the paper
    prints it without the division.
    """
    squashed = np.tanh(reward / 5.0)
    return 5.0 * np.where(reward < 0, 0.3 * squashed, squashed)
