"""Building an agent from a configuration."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

from zipf import envs
from zipf.agents.agent import Agent, AgentSpec, agents
from zipf.agents.learner import Learner
from zipf.agents.unroll import Augmentation
from zipf.envs.tensor import TensorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError
from zipf.experiments.building.device_envs import compiles
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks.augmentation import AUGMENTATIONS, RandomAugmentation
from zipf.experiments.hooks.tensor import View
from zipf.experiments.options.schema import Config


def build_agent(config: Config, env: ZipfVectorEnv | TensorEnv) -> Agent:
    """The agent that the configuration names, for these envs, with weights from its seed and, where
    the configuration `compiles` them, compiled image encoders. Of tensor environments it sees what
    a `View` makes of their codes.
    Raises UserError: the network cannot read these observations, they lack what the auxiliary loss
    is about, or there is no image encoder to compile."""
    assert config.precision != "auto"  # the schema has resolved it
    try:
        augmentation = AUGMENTATIONS.build(
            config.augmentation,
            env.single_observation_space,
            symmetries=envs.symmetries(config.split, env),
        )
        seen: Augmentation | None = augmentation
        codes = None
        if isinstance(env, TensorEnv):
            assert augmentation is None or isinstance(augmentation, RandomAugmentation)
            seen, codes = View(env, augmentation), _space(env)
        spec = AgentSpec(
            env.single_observation_space,
            env.single_action_space,
            config.network,
            config.memory,
            config.auxiliary,
            config.critic,
            config.episodic,
            num_envs=config.num_envs // config.updates_per_unroll,
            unroll_length=config.collector.unroll_length,
            seed=derive_seed(config.seed, "weights"),
            device=config.torch_device,
            precision=config.precision,
            weighted=config.reweighting.name != "none",
            hindsight=config.hindsight,
            augmentation=seen,
            unroll_space=codes,
        )
        agent = agents()[config.agent.name](config.agent, spec)
        if compiles(config):
            if not isinstance(agent, Learner):
                raise ValueError(
                    f"compile=true: compiles image encoders, and agent={config.agent.name} has no "
                    "network to learn; choose compile=false"
                )
            agent.compile()
    except ValueError as error:
        raise UserError(str(error)) from None
    return agent


def _space(env: TensorEnv) -> gym.spaces.Dict:
    """The codes of one env."""
    space: dict[str, gym.Space] = {}
    for name, part in env.observe().items():
        dtype = np.dtype(str(part.dtype).removeprefix("torch."))
        high = np.iinfo(dtype).max if dtype.kind in "iu" else 1
        space[name] = gym.spaces.Box(0, high, part.shape[1:], dtype.type)
    return gym.spaces.Dict(space)
