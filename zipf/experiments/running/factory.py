"""Building an agent from a configuration."""

from __future__ import annotations

from zipf.agents.agent import Agent, Setting, agents
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.config import Config
from zipf.experiments.errors import UserError
from zipf.experiments.running.evaluator import derive_seed


def build_agent(config: Config, env: ZipfVectorEnv) -> Agent:
    """The agent that the configuration names, for these worlds, with weights from its seed; its
    image encoders are compiled with `compile=true`.

    Raises:
        UserError: the network cannot read these observations, they lack what the auxiliary loss
            is about, or there is no image encoder to compile.
    """
    setting = Setting(
        env.single_observation_space,
        env.single_action_space,
        config.network,
        config.memory,
        config.auxiliary,
        config.critic,
        config.episodic,
        num_envs=config.collector.num_envs,
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
            agent.compile()
    except ValueError as error:
        raise UserError(str(error)) from None
    return agent
