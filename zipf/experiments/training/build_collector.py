"""Building what collects for an agent, from a configuration."""

from __future__ import annotations

from zipf import envs
from zipf.agents.agent import Agent
from zipf.agents.exploration import BONUSES
from zipf.agents.reweighting import REWEIGHTINGS
from zipf.envs.policies import Teacher
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks.augmentation import AUGMENTATIONS
from zipf.experiments.options.schema import Config
from zipf.experiments.training.collector import Collector


def build_collector(
    config: Config, env: ZipfVectorEnv, agent: Agent, player: tuple[int, ...] = ()
) -> Collector:
    """What collects for an agent in these worlds.

    Args:
        player: numbers which of several collectors of a run it is, a learner's or an actor's: each
            draws for itself.
    """
    options, device = config.collector, config.torch_device
    return Collector(
        env,
        agent,
        unroll_length=options.unroll_length,
        seed=derive_seed(config.seed, "training", *player),
        device=device,
        augmentation=AUGMENTATIONS.build(
            config.augmentation,
            env.single_observation_space,
            env.num_envs,
            seed=derive_seed(config.seed, "augmentation", *player),
            symmetries=envs.symmetries(config.split, env),
        ),
        exploration=BONUSES.build(
            config.exploration,
            env.single_observation_space,
            derive_seed(config.seed, "exploration", *player),
        ),
        goal=envs.family_of_split(config.environment.split).make_goal(env),
        reweighting=REWEIGHTINGS.build(config.reweighting, env.num_envs),
        hindsight=config.hindsight,
        lag=config.lag,
        bootstrap_at_time_limit=options.bootstrap_at_time_limit,
        reward_clipping=options.reward_clipping,
        teacher=Teacher(agent.needs.teacher, config.split, env) if agent.needs.teacher else None,
    )
