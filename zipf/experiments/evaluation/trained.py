"""Trained agents: loaded from a run's folder, and scored."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from zipf import envs
from zipf.agents.agent import Agent
from zipf.agents.learner import Learner
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, feasibility, run_folder
from zipf.experiments.building.factory import build_agent
from zipf.experiments.building.out_of_ram import enough_ram
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import Result, Watch, evaluate, unwatched
from zipf.experiments.evaluation.scripted import ScriptedPolicy
from zipf.experiments.options import composing
from zipf.experiments.options.schema import (
    DEVICE_PATTERN,
    Config,
    EvaluateOptions,
    has_bfloat16,
    module_names,
)


class TrainedAgent:
    """The agent of a run, as it was at an update: acts in environments of one's own, and is a
    policy of `zipf.score`. `zipf.load_agent` makes it.

    It acts as it does when it is scored: without exploration, agents with a policy by draws from
    it, R2D2 greedily. Its memory and its last actions are kept between calls.

        agent = zipf.load_agent("runs/demo/impala_mlp/seed0")
        env = zipf.make_vec("gridworld/rare", 16, **agent.env_options)
        observation, _ = env.reset(seed=0)
        action = agent.act(observation)
        while True:
            observation, reward, terminated, truncated, _ = env.step(action)
            action = agent.act(observation, reward, terminated | truncated)

    Attributes:
        folder: the run's.
        config: the run's options, with the device to compute on.
        update: how many updates the agent has made.
        env_options: the constructor options of the levels that it was trained on.
        observation_space, action_space: of one of its environments.
        agent: what acts and learns (`zipf.agents.agent.Agent`).
    """

    def __init__(self, folder: Path, config: Config, agent: Agent, update: int, seed: int) -> None:
        self.folder = folder
        self.config = config
        self.agent = agent
        self.update = update
        self.env_options = config.level_options
        self.observation_space = agent.spec.observation_space
        self.action_space = agent.spec.action_space
        self.reset(seed=seed)

    def __repr__(self) -> str:
        return f"TrainedAgent({self.folder.as_posix()!r}, update={self.update})"

    def reset(self, *, seed: int | None = None) -> None:
        """Forgets all: new episodes begin in all environments, of which there may be another number
        than before. Where `seed` is given the draws of actions begin anew from it."""
        if seed is not None:
            self._policy = AgentPolicy(self.agent, seed=seed)
        self._acts_in: int | None = None

    def act(
        self,
        observation: Mapping[str, NDArray],
        reward: ArrayLike | None = None,
        is_first: ArrayLike | None = None,
        *,
        deterministic: bool = False,
    ) -> NDArray[np.int64] | int:
        """The next action, in one environment or in each of N.

        Args:
            observation: `{name: [...]}` of one environment, or `{name: [N, ...]}`.
            reward: of the last action, float or [N]; needed but for the first call after `reset`,
                because agents read it.
            is_first: bool or [N], where this observation is the first of an episode; there the
                memory is cleared. After a step of a vector environment that resets in the same
                step, as those of `zipf.make_vec` do, that is `terminated | truncated`.
            deterministic: take the most probable action; otherwise as the agent is scored, which
                mostly draws one.

        Returns:
            int for one environment, int64 [N] for N.

        Raises:
            ValueError: observations of other shapes or dtypes than the agent was trained with,
                another number of environments than in the last call, or no reward.
        """
        alone = self._is_alone(observation)
        batch = {
            name: _as_trained_with(name, observation[name], space, alone)
            for name, space in self.observation_space.items()
        }
        count = len(next(iter(batch.values())))
        begins = self._acts_in is None
        if begins:
            self._policy.start(count)
            self._acts_in = count
        elif count != self._acts_in:
            raise ValueError(
                f"act: {count} environments, and {self._acts_in} before; reset() begins anew"
            )
        elif reward is None:
            raise ValueError(
                "act: needs the reward of the last action: act(observation, reward); or reset() "
                "where an episode begins"
            )
        rewards = np.zeros(count) if begins or reward is None else np.asarray(reward)
        firsts = np.asarray(begins or (False if is_first is None else is_first), bool)
        self._policy.deterministic = deterministic
        actions = self._policy(
            batch,
            np.array(np.broadcast_to(rewards, count), np.float32),
            np.array(np.broadcast_to(firsts, count)),
        )
        return int(actions[0]) if alone else actions

    def _is_alone(self, observation: Mapping[str, NDArray]) -> bool:
        """Whether an observation is of one environment. Raises ValueError where it is none."""
        found = set()
        for name, space in self.observation_space.items():
            assert space.shape is not None
            shape = np.shape(observation[name]) if name in observation else None
            if shape is None or shape[max(len(shape) - len(space.shape), 0) :] != space.shape:
                got = "is missing" if shape is None else f"has shape {shape}"
                raise ValueError(
                    f"act: observation {name!r} {got}; should be {space.shape} or "
                    f"(N, {', '.join(map(str, space.shape))})"
                )
            found.add(len(shape) - len(space.shape))
        if len(found) > 1 or not found <= {0, 1}:
            raise ValueError("act: observations should be of one environment, or of N each")
        return found == {0}

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> AgentPolicy:
        """The policy that plays environments with these spaces; its actions are drawn from `seed`.
        `zipf.score` calls this.

        Raises:
            ValueError: the agent was trained in environments with other spaces.
        """
        known = self.observation_space, self.action_space
        if known != (observation_space, action_space):
            raise ValueError(
                f"{self.folder}: its agent was trained in environments with {known[0]} and "
                f"{known[1]}; those to play have {observation_space} and {action_space}"
            )
        return AgentPolicy(self.agent, seed=seed)


def _as_trained_with(name: str, part: ArrayLike, space: spaces.Space, alone: bool) -> NDArray:
    """A part of an observation with an axis of environments, in the space's dtype. Raises
    ValueError for another kind of numbers, such as an image in floats."""
    array = np.asarray(part)
    assert space.dtype is not None
    if not np.can_cast(array.dtype, space.dtype, "same_kind"):
        raise ValueError(f"act: observation {name!r} is {array.dtype}; should be {space.dtype}")
    return np.ascontiguousarray(array[None] if alone else array, space.dtype)


def load_agent(
    folder: str | Path, device: str = "cpu", plugins: Sequence[str] = (), *, seed: int = 0
) -> TrainedAgent:
    """Loads the agent of a run's checkpoint or, where there is none, of its weights.

    One that was trained in bfloat16 acts in float32 on a device without instructions for that: the
    weights are float32 in any case.

    Args:
        folder: the run's.
        device: to compute on: `cpu`, `cuda`, `cuda:<number>` or `auto`.
        plugins: modules to import first, see `zipf.plugins`.
        seed: of the draws of actions in `TrainedAgent.act`.

    Raises:
        UserError: the folder holds no run or neither file, or the file is damaged or was made with
            other options; or there is no such device.

    Warns by the logger `zipf` of a run that was trained on other images.
    """
    if not re.fullmatch(DEVICE_PATTERN, device):
        raise UserError(f"device={device}: should be auto, cpu, cuda or cuda:<number>")
    plugins = [plugins] if isinstance(plugins, str) else plugins
    composing.load_plugins(plugins)
    folder = Path(folder).expanduser()
    here = {"device": device, "compile": False}
    config = run_folder.read_config(folder, plugins).model_copy(update=here)
    if line := run_folder.other_images(folder):
        logging.getLogger("zipf").warning(line)
    path = run_folder.agent_file(folder)
    saved = checkpoint.load(path)
    of_checkpoint = path.name == "checkpoint.pt"
    if of_checkpoint:
        run_folder.check_options(path, saved, config)
    if config.precision == "bfloat16" and not has_bfloat16(config.torch_device):
        config = config.model_copy(update={"precision": "float32"})
    # All levels of a split have the same spaces.
    env = envs.make_vec(config.split.train[0], 1, **config.level_options)
    agent = build_agent(config, env)
    env.close()
    with run_folder.fits(path):
        if of_checkpoint:
            agent.load_state_dict(saved["agent"])
        else:
            assert isinstance(agent, Learner)  # others have no such file
            agent.load_weights(saved["weights"])
        update = saved["update"]
    return TrainedAgent(folder, config, agent, update, seed)


def evaluate_agent(
    config: Config,
    agent: Agent,
    *,
    episodes: int | None,
    num_envs: int,
    seed: int,
    watch: Watch = unwatched,
) -> list[Result]:
    """Scores an agent on its split's levels; all random draws derive from `seed`."""
    return evaluate(
        AgentPolicy(agent, seed=derive_seed(seed, "actions")),
        config.split,
        episodes=episodes,
        num_envs=num_envs,
        seed=seed,
        watch=watch,
        **config.level_options,
    )


def evaluate_run(options: EvaluateOptions, watch: Watch = unwatched) -> tuple[int, list[Result]]:
    """Scores the agent of a run; returns the update that it is of, and the scores.

    Raises:
        UserError: as `load_agent`, or so many envs do not fit into RAM.
    """
    assert options.run is not None
    trained = load_agent(Path(options.run), options.device, module_names(options.plugins))
    with enough_ram(f"a smaller num_envs={options.num_envs} needs less"):
        problem = feasibility.too_many_envs(
            trained.config, options.num_envs, options.episodes, "num_envs"
        )
        if problem:
            raise UserError(problem)
        results = evaluate_agent(
            trained.config,
            trained.agent,
            episodes=options.episodes,
            num_envs=options.num_envs,
            seed=options.seed,
            watch=watch,
        )
    return trained.update, results


def evaluate_scripted(
    options: EvaluateOptions,
    split: envs.Split,
    watch: Watch = unwatched,
) -> list[Result]:
    """Scores a scripted policy on the levels of a split.

    Raises:
        UserError: a level has no such policy, or so many envs do not fit into RAM.
    """
    assert options.policy is not None
    with enough_ram(f"a smaller num_envs={options.num_envs} needs less"):
        try:
            return evaluate(
                ScriptedPolicy(options.policy),
                split,
                episodes=options.episodes,
                num_envs=options.num_envs,
                seed=options.seed,
                watch=watch,
            )
        except ValueError as error:
            raise UserError(str(error)) from None
