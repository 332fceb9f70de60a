"""Building what collects for an agent, from a configuration."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

from zipf import envs
from zipf.agents.agent import Agent
from zipf.agents.hindsight import AchievedOptions
from zipf.envs.policies import Teacher
from zipf.envs.tensor import TensorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks import tensor
from zipf.experiments.hooks.augmentation import Draws, HostAugmentation
from zipf.experiments.hooks.exploration import BONUSES, CountOptions
from zipf.experiments.hooks.hook import Hook
from zipf.experiments.hooks.labels import Labels
from zipf.experiments.hooks.relabelling import RELABELLINGS, reward_of
from zipf.experiments.hooks.rewards import SoftAsymmetric, TimeLimitsEnd, soft_asymmetric
from zipf.experiments.hooks.reweighting import REWEIGHTINGS
from zipf.experiments.hooks.tensor import View
from zipf.experiments.options.schema import Config
from zipf.experiments.training.host_collector import HostCollector
from zipf.experiments.training.tensor_collector import TensorCollector
from zipf.options import Options


def build_collector(
    config: Config, env: ZipfVectorEnv, agent: Agent, stream: tuple[int, ...] = ()
) -> HostCollector:
    """What collects for an agent in these envs.

    Args:
        stream: numbers which of several collectors of a run it is, a learner's or an actor's: each
            draws for itself.
    """
    return HostCollector(
        env,
        agent,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "training", *stream),
        hooks=list(_hooks(config, env, agent, stream)),
        lag=config.lag,
    )


def _hooks(
    config: Config, env: ZipfVectorEnv, agent: Agent, stream: tuple[int, ...]
) -> Iterator[Hook]:
    """The hooks in their order: what changes rewards comes before what keeps them."""
    clips = config.collector.reward_clipping == "soft_asymmetric"
    if clips:
        yield SoftAsymmetric()
    if not config.collector.bootstrap_at_time_limit:
        yield TimeLimitsEnd()
    needs, draws = agent.needs, None
    augmentation = cast(HostAugmentation | None, agent.augmentation)
    if augmentation is not None:
        seed = derive_seed(config.seed, "augmentation", *stream)
        draws = Draws(augmentation, env.num_envs, seed)
        yield draws
    if needs.teacher:
        teacher = Teacher(needs.teacher, config.split, env)
        yield Labels(teacher, needs.teacher_share, augmentation)
    goal = envs.family_of_split(config.environment.split).make_goal(env)
    chosen = (
        BONUSES.build(
            config.exploration,
            env.single_observation_space,
            derive_seed(config.seed, "exploration", *stream),
        ),
        REWEIGHTINGS.build(config.reweighting, goal, env.num_envs),
        RELABELLINGS.build(
            hindsight_of_unroll(config),
            goal,
            env,
            clip=soft_asymmetric if clips else None,
            seed=derive_seed(config.seed, "training", *stream),
            draws=draws,
            teacher=needs.teacher is not None,
        ),
    )
    yield from (hook for hook in chosen if hook is not None)


def hindsight_of_unroll(config: Config) -> Options:
    """The options of hindsight, with as many episodes as all updates of an unroll learn from."""
    hindsight = config.hindsight
    if isinstance(hindsight, AchievedOptions) and config.updates_per_unroll > 1:
        episodes = hindsight.episodes * config.updates_per_unroll
        return hindsight.model_copy(update={"episodes": episodes})
    return hindsight


def build_tensor_collector(
    config: Config, env: TensorEnv, agent: Agent, stream: tuple[int, ...] = ()
) -> TensorCollector:
    """What collects for an agent in tensor environments; `stream` as in `build_collector`."""
    view = agent.augmentation
    assert isinstance(view, View)
    return TensorCollector(
        env,
        agent,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "training", *stream),
        hooks=list(_tensor_hooks(config, env, view)),
    )


def _tensor_hooks(config: Config, env: TensorEnv, view: View) -> Iterator[Hook]:
    """The hooks in their order, as `_hooks`."""
    clips = config.collector.reward_clipping == "soft_asymmetric"
    if clips:
        yield SoftAsymmetric()
    if not config.collector.bootstrap_at_time_limit:
        yield TimeLimitsEnd()
    if view.size:
        yield tensor.Draws(view, env)
    if isinstance(config.exploration, CountOptions):
        yield tensor.Counts(config.exploration, env)
    hindsight = hindsight_of_unroll(config)
    if isinstance(hindsight, AchievedOptions):
        yield tensor.Hindsight(
            hindsight,
            env,
            unroll_length=config.collector.unroll_length,
            reward=reward_of(hindsight, soft_asymmetric if clips else None),
            draws=view.size,
        )
