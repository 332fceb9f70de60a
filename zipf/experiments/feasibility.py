"""Checks of combinations of options: do they fit each other, the worlds and this machine?"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import torch

from zipf import envs
from zipf.agents.agent import agents, no_auxiliary_losses
from zipf.agents.auxiliary import NO_AUXILIARY, build_auxiliary
from zipf.agents.network import ActorCritic
from zipf.experiments.config import Config, find_device
from zipf.experiments.errors import UserError


def problems(config: Config) -> Iterator[str]:
    """The problems of options that are each valid by themselves, one line each."""
    start, end = config.schedule.window
    if start > end:
        yield f"schedule.window=[{start}, {end}]: should begin before it ends"
    split = envs.split(config.environment.split)
    train = split.levels("train")
    if split.draw == "worlds" and config.collector.num_envs < len(train):
        yield (
            f"collector.num_envs={config.collector.num_envs}: should be at least {len(train)}, a "
            f"world for each train level of {split.name}"
        )
    agent, collector = agents()[config.agent.name], config.collector
    yield from agent.problems(config.agent, collector.num_envs, collector.unroll_length)
    if config.auxiliary != NO_AUXILIARY and not agent.auxiliary_losses:
        yield no_auxiliary_losses(config.agent.name, config.auxiliary.name)
    try:
        find_device(config.device)
    except UserError as error:
        yield str(error)
    if any(path.exists() and not path.is_dir() for path in (config.folder, *config.folder.parents)):
        yield f"run_root={config.run_root}: should be a folder, but there is a file of that name"
    if agent.answers_questions and config.exploration.name != "none":
        yield (
            f"exploration={config.exploration.name}: agent={config.agent.name} answers questions "
            "and does not act; choose exploration=none"
        )
    if agent.largest_lag < config.lag:
        yield (
            f"collector.lag={config.lag}: agent={config.agent.name} does not correct for older "
            f"weights; should be at most {agent.largest_lag}"
        )
    problem = _cannot_be_built(config)
    if problem:
        yield problem


def has_instruction(environment: dict[str, Any]) -> bool:
    """Whether the worlds of a split, with these options, have an instruction; True if they cannot
    be made."""
    key = json.dumps(environment, sort_keys=True, default=str)
    if key not in _instructed:
        options = {name: value for name, value in environment.items() if name != "split"}
        try:
            env = envs.make_vec(envs.split(environment["split"]).uniform[0], 1, **options)
            _instructed[key] = "instruction" in env.single_observation_space.spaces
            env.close()
        except (ValueError, TypeError):
            _instructed[key] = True
    return _instructed[key]


_instructed: dict[str, bool] = {}

_BUILT = ("environment", "network", "memory", "auxiliary")
_buildable: dict[str, str | None] = {}


def _cannot_be_built(config: Config) -> str | None:
    """Why the levels or the network cannot be made, or None. Equal options are tried once."""
    built = {name: value for name, value in config.model_dump().items() if name in _BUILT}
    key = json.dumps({"agent": config.agent.name, **built}, sort_keys=True)
    if key not in _buildable:
        _buildable[key] = _try_to_build(config)
    return _buildable[key]


def _try_to_build(config: Config) -> str | None:
    try:
        split = config.split
    except ValueError as error:
        answering = [one.name for one in envs.all_splits().values() if _has_questions(one)]
        return (
            f"agent={config.agent.name}: {error}; splits with such questions: "
            f"{', '.join(answering)}"
        )
    try:
        for level in split.all_levels:
            env = envs.make_vec(level, 1, **config.level_options)
            env.close()
    except ValueError as error:
        return f"environment: {error}"
    try:
        with torch.device("meta"):
            spaces = env.single_observation_space, env.single_action_space
            network = ActorCritic(*spaces, config.network, config.memory)
            build_auxiliary(config.auxiliary, spaces[0], config.network, network, seed=0)
    except ValueError as error:
        return str(error)
    return None


def _has_questions(split: envs.Split) -> bool:
    try:
        envs.questions(split)
    except ValueError:
        return False
    return True
