"""Trained agents: loaded from a run's folder, and scored."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gymnasium import spaces

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
from zipf.experiments.options.schema import Config, EvaluateOptions, has_bfloat16, module_names


@dataclass(frozen=True)
class Trained:
    """The agent of a run, as it was at an update."""

    config: Config
    agent: Agent
    update: int


def load_agent(folder: Path, device: str, plugins: Sequence[str] = ()) -> Trained:
    """Loads the agent of a run's checkpoint or, where there is none, of its weights.

    One that was trained in bfloat16 acts in float32 on a device without instructions for that: the
    weights are float32 in any case.

    Args:
        folder: the run's.
        device: to compute on.
        plugins: modules to import first, see `zipf.plugins`.

    Raises:
        UserError: the folder holds no run or neither file, or the file is damaged or was made with
            other options.

    Warns by the logger `zipf` of a run that was trained on other images.
    """
    composing.load_plugins(plugins)
    folder = folder.expanduser()
    config = run_folder.read_config(folder, plugins).model_copy(update={"device": device})
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
    env = envs.make_vec(config.split.uniform[0], 1, **config.level_options)
    agent = build_agent(config, env)
    env.close()
    with run_folder.fits(path):
        if of_checkpoint:
            agent.load_state_dict(saved["agent"])
        else:
            assert isinstance(agent, Learner)  # others have no such file
            agent.load_weights(saved["weights"])
        return Trained(config, agent, saved["update"])


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
        AgentPolicy(agent, seed=derive_seed(seed, "actions"), device=config.torch_device),
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


class TrainedPolicy:
    """The agent of a run's checkpoint, for `zipf.evaluate.score`.

    Attributes:
        env_options: the constructor options of its levels.

    Raises:
        UserError: no agent can be loaded from the folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trained = load_agent(folder, "cpu")
        self.env_options = self.trained.config.level_options

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> AgentPolicy:
        """The policy that plays environments with these spaces; its actions are drawn from `seed`.

        Raises:
            ValueError: the agent was trained in environments with other spaces.
        """
        config = self.trained.config
        env = envs.make_vec(config.split.uniform[0], 1, **config.level_options)
        known = env.single_observation_space, env.single_action_space
        env.close()
        if known != (observation_space, action_space):
            raise ValueError(
                f"{self.folder}: its agent was trained in environments with {known[0]} and "
                f"{known[1]}; those to play have {observation_space} and {action_space}"
            )
        return AgentPolicy(self.trained.agent, seed=seed, device="cpu")
