"""The collector: plays the agent in a batch of worlds and fills unrolls."""

from __future__ import annotations

from collections import defaultdict
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.exploration import CountBonus
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.envs.mixture import Mixture
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.running.checkpoint import arrays

_OUTCOMES = ("return", "length", "success")


class Collector:
    """Fills one unroll after another without dropping a frame.

    The environment writes its observations straight into the unroll, which is reused: an agent
    that keeps frames copies them.

    Args:
        env: a batch in SAME_STEP autoreset mode; reset here, with `seed`.
        seed: of the worlds and of the agent's actions.
        exploration: a bonus for what the actions lead to.

    Raises:
        ValueError: the agent's burn-in is longer than an unroll.
    """

    def __init__(
        self,
        env: ZipfVectorEnv,
        agent: Agent,
        *,
        unroll_length: int,
        seed: int,
        device: str = "cpu",
        exploration: CountBonus | None = None,
    ):
        if agent.burn_in > unroll_length:
            raise ValueError(
                f"a burn-in of {agent.burn_in} rows is longer than an unroll of {unroll_length}"
            )
        self.env = env
        self.agent = agent
        self.unroll_length = unroll_length
        self.device = device
        self.exploration = exploration
        self.seconds = {"environment": 0.0, "inference": 0.0}
        self._levels_of_worlds: NDArray[np.str_] | None = None
        if isinstance(env, Mixture) and env.draw == "worlds":
            self._levels_of_worlds = np.array(env.level_names)[env.levels_of_worlds]
        self._episodes: dict[str, list[float]] = defaultdict(list)
        self._generator = torch.Generator().manual_seed(seed)
        self._memory = agent.initial_memory(env.num_envs)

        rows, worlds = unroll_length + 1, env.num_envs
        spaces = env.single_observation_space.spaces
        self._observation = {
            name: np.zeros((rows, worlds, *(space.shape or ())), space.dtype)
            for name, space in spaces.items()
        }
        self._final = {name: np.zeros_like(part[0]) for name, part in self._observation.items()}
        self._fields: dict[str, NDArray[Any]] = {
            "previous_action": np.full((rows, worlds), -1, np.int64),
            "previous_reward": np.zeros((rows, worlds), np.float32),
            "is_first": np.ones((rows, worlds), np.bool_),
            "action": np.zeros((rows, worlds), np.int64),
            "reward": np.zeros((rows, worlds), np.float32),
            "bonus": np.zeros((rows, worlds), np.float32),
            "terminated": np.zeros((rows, worlds), np.bool_),
            "truncated": np.zeros((rows, worlds), np.bool_),
            "truncation_value": np.zeros((rows, worlds), np.float32),
        }
        self._steps = TensorDict(
            {name: torch.from_numpy(field) for name, field in self._fields.items()},
            batch_size=[rows, worlds],
        )
        self._steps["observation"] = TensorDict(
            {name: torch.from_numpy(part) for name, part in self._observation.items()},
            batch_size=[rows, worlds],
        )
        self._inputs_of_steps = self._steps.select(
            "observation", "previous_action", "previous_reward", "is_first"
        )
        env.reset(seed=seed, out=self._row(self._observation, unroll_length))

    def collect(self) -> Unroll:
        """Plays `unroll_length` steps in every world; the next call overwrites the result."""
        for part in (*self._observation.values(), *self._fields.values()):
            part[0] = part[-1]
        memory, late_memory = self._memory, None
        for t in range(self.unroll_length):
            if self.agent.burn_in and t == self.unroll_length - self.agent.burn_in:
                late_memory = self._memory
            self._step(t)
        return Unroll(self._steps, memory, late_memory).to(self.device)

    def episode_metrics(self) -> dict[str, float]:
        """Means over the episodes that ended since the last call.

        `episode_return` and `episode_length` (NaN if no episode ended), `episode_success` if the
        worlds report it, and, with several levels, the same for each level whose episodes ended:
        `episode_return/<level>` and so on.
        """
        metrics = {f"episode_{name}": float("nan") for name in ("return", "length")}
        metrics |= {f"episode_{name}": float(np.mean(v)) for name, v in self._episodes.items()}
        self._episodes.clear()
        return metrics

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next unroll depends on."""
        carried = ("previous_action", "previous_reward", "is_first")
        return {
            "environment": self.env.get_state(),
            "memory": dict(self._memory),
            "generator": self._generator.get_state(),
            "inputs": {name: self._fields[name][-1].copy() for name in carried},
            "episodes": dict(self._episodes),
            "exploration": self.exploration.state_dict() if self.exploration else {},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.env.set_state(arrays(state["environment"]))
        self.env.observations(out=self._row(self._observation, -1))
        self._memory = {k: v.to(self.device) for k, v in state["memory"].items()}
        self._generator.set_state(state["generator"])
        self._episodes = defaultdict(list, {k: list(v) for k, v in state["episodes"].items()})
        for name, value in state["inputs"].items():
            self._fields[name][-1] = value
        if self.exploration:
            self.exploration.load_state_dict(arrays(state["exploration"]))

    def _step(self, t: int) -> None:
        start = perf_counter()
        fields = self._fields
        action, self._memory, behaviour = self.agent.act(
            self._inputs(t), self._memory, self._generator
        )
        fields["action"][t] = action.cpu().numpy()
        for name, value in behaviour.items():
            if name not in self._steps.keys():
                empty = torch.zeros(self.unroll_length + 1, *value.shape, dtype=value.dtype)
                self._steps[name] = empty
            self._steps[name][t] = value
        acted = perf_counter()

        following = self._row(self._observation, t + 1)
        _, reward, terminated, truncated, info = self.env.step(
            fields["action"][t], out=following, final_out=self._final
        )
        ended = terminated | truncated
        fields["reward"][t] = reward
        fields["terminated"][t] = terminated
        fields["truncated"][t] = truncated
        fields["previous_action"][t + 1] = np.where(ended, -1, fields["action"][t])
        fields["previous_reward"][t + 1] = np.where(ended, 0.0, reward)
        fields["is_first"][t + 1] = ended
        if self.exploration:
            fields["bonus"][t] = self.exploration(following, ~ended)
            if ended.any():
                fields["bonus"][t] += self.exploration(self._final, ended)
        if ended.any():
            self._record(info["final_info"], ended)
        stepped = perf_counter()

        fields["truncation_value"][t] = 0.0
        if truncated.any():
            fields["truncation_value"][t, truncated] = self._value_at_truncation(t, truncated)
        self.seconds["inference"] += acted - start + perf_counter() - stepped
        self.seconds["environment"] += stepped - acted

    def _record(self, final_info: dict[str, NDArray], ended: NDArray[np.bool_]) -> None:
        """Keeps the outcomes of the episodes that ended, for `episode_metrics`."""
        levels = final_info.get("level_name", self._levels_of_worlds)
        for name in _OUTCOMES:
            if name not in final_info:  # `success` in worlds that do not report it
                continue
            values = final_info[name][ended].tolist()
            self._episodes[name].extend(values)
            if levels is not None:
                for level, value in zip(levels[ended], values, strict=True):
                    self._episodes[f"{name}/{level}"].append(value)

    def _inputs(self, t: int) -> Inputs:
        return Inputs.of(self._inputs_of_steps[t].to(self.device, non_blocking=True))

    def _value_at_truncation(self, t: int, truncated: NDArray[np.bool_]) -> NDArray:
        def send(array: NDArray) -> Tensor:
            return torch.from_numpy(array[truncated]).to(self.device)

        inputs = Inputs(
            {name: send(part) for name, part in self._final.items()},
            send(self._fields["action"][t]),
            send(self._fields["reward"][t]),
            torch.zeros(int(truncated.sum()), dtype=torch.bool, device=self.device),
        )
        rows = torch.from_numpy(truncated).to(self.device)
        memory = {name: value[rows] for name, value in self._memory.items()}
        return self.agent.value(inputs, memory).cpu().numpy()

    @staticmethod
    def _row(parts: dict[str, NDArray], t: int) -> dict[str, NDArray]:
        return {name: part[t] for name, part in parts.items()}
