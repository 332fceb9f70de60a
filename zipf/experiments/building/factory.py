"""Building an agent, and what collects for it, from a configuration."""

from __future__ import annotations

from zipf import envs
from zipf.agents.agent import Agent, Setting, agents
from zipf.agents.exploration import BONUSES
from zipf.agents.learner import Learner
from zipf.agents.reweighting import REWEIGHTINGS
from zipf.envs.players import Teacher
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks.augmentation import AUGMENTATIONS
from zipf.experiments.options.schema import Config
from zipf.experiments.training.collector import Collector


def build_agent(config: Config, env: ZipfVectorEnv) -> Agent:
    """The agent that the configuration names, for these worlds, with weights from its seed; its
    image encoders are compiled with `compile=true`.

    Raises:
        UserError: the network cannot read these observations, they lack what the auxiliary loss
            is about, or there is no image encoder to compile.
    """
    assert config.precision != "auto"  # the schema has resolved it
    setting = Setting(
        env.single_observation_space,
        env.single_action_space,
        config.network,
        config.memory,
        config.auxiliary,
        config.critic,
        config.episodic,
        num_envs=config.num_envs,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "weights"),
        device=config.torch_device,
        precision=config.precision,
        folder=config.folder,
        updates_between_checkpoints=config.schedule.checkpoint_every,
        reweighting=config.reweighting,
        hindsight=config.hindsight,
    )
    try:
        agent = agents()[config.agent.name](config.agent, setting)
        if config.compile:
            if not isinstance(agent, Learner):
                raise ValueError(
                    f"compile=true: compiles image encoders, and agent={config.agent.name} has no "
                    "network to learn; choose compile=false"
                )
            agent.compile()
    except ValueError as error:
        raise UserError(str(error)) from None
    return agent


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
        teacher=Teacher(agent.teacher, config.split, env) if agent.teacher else None,
    )
