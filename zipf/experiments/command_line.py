"""From a command line to a checked configuration.

`load` composes `configs/` with Hydra's overrides and checks the result; `check_command_line` does
so for every job of a sweep before the first one starts. Both report all that is wrong at once.
"""

from __future__ import annotations

import difflib
import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import ValidationError

import zipf
from zipf import envs
from zipf.agents.agent import agents, no_auxiliary_losses
from zipf.agents.auxiliary import NO_AUXILIARY, build_auxiliary
from zipf.agents.network import ActorCritic
from zipf.experiments.config import (
    DEVICE_PATTERN,
    NAME_PATTERN,
    NOT_LEARNED,
    Config,
    find_device,
    flatten,
)
from zipf.experiments.errors import UserError
from zipf.options import Options

_PACKAGE = Path(zipf.__file__).parent
# In the wheel `configs/` lies inside the package; in a checkout it lies beside it.
CONFIG_DIR = next(
    path for path in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if path.is_dir()
)

AnyOptions = TypeVar("AnyOptions", bound=Options)
_GROUPS = ("agent", "memory", "network", "auxiliary", "exploration")


@dataclass(frozen=True)
class _Composed:
    values: dict[str, Any]
    choices: dict[str, str]


def load(overrides: list[str]) -> Config:
    """The configuration that these overrides ask for.

    Raises:
        UserError: with one line for every unknown, mistyped or impossible option.
    """
    known, problems = _known(_parse(overrides))
    if not any(override.startswith("experiment=") for override in known):
        raise UserError("\n".join(problems))
    composed = _compose_condition(*known)
    values = dict(composed.values)
    name = values.pop("name")
    values["condition"] = _name(composed) if name is None else name
    try:
        config = Config.model_validate(values)
    except ValidationError as error:
        problems += _explain(error, values)
    else:
        problems += _impossible(config)
    if problems:
        raise UserError("\n".join(problems))
    return config


def check_command_line(overrides: list[str]) -> list[Config]:
    """Checks every job that the overrides ask for, before any starts, and returns them.

    Raises:
        UserError: as `load`, for all jobs together.
    """
    problems: dict[str, None] = {}
    jobs = []
    for job in _jobs(overrides):
        try:
            jobs.append(load(job))
        except UserError as error:
            problems.update(dict.fromkeys(str(error).splitlines()))
    if problems:
        raise UserError("\n".join(problems))
    return jobs


def read_options(schema: type[AnyOptions], arguments: list[str]) -> AnyOptions:
    """The options of a small command, from `name=value` arguments.

    Raises:
        UserError: with one line for every unknown, missing or mistyped option.
    """
    accepted = list(schema.model_fields)
    problems, values = [], {}
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if not equals:
            problems.append(f"{argument}: not of the form option=value")
        elif name not in accepted:
            problems.append(f"{name}: no such option; {nearest(name, accepted)}")
        else:
            values[name] = value
    try:
        options = schema.model_validate_strings(values)
    except ValidationError as error:
        problems += _explain(error, values)
    if problems:
        raise UserError("\n".join(problems))
    return options


def choices(group: str) -> list[str]:
    """The names in `configs/<group>/`."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))


def nearest(name: str, accepted: list[str]) -> str:
    """The tail of an error message: what was probably meant, or what there is."""
    group, dot, option = name.rpartition(".")
    within = [other for other in accepted if other.rpartition(".")[0] == group]
    if dot and within:  # the group is right, so it says nothing about what was meant
        close = difflib.get_close_matches(option, [other.rpartition(".")[2] for other in within])
        close = [f"{group}.{other}" for other in close]
        accepted = within
    else:
        close = difflib.get_close_matches(name, accepted, n=3)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"there is {', '.join(sorted(accepted))}"


@cache
def _compose(*overrides: str) -> _Composed:
    backup = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
            config = compose("train", list(overrides), return_hydra_config=True)
        choices = {k: str(v) for k, v in config.hydra.runtime.choices.items()}
        OmegaConf.set_struct(config, False)
        del config["hydra"]
        values = OmegaConf.to_container(config, resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        message = " ".join(str(error).split())
        if "hydra/launcher" in message:
            message += ' (joblib and submitit come with the extra: pip install "zipf-rl[sweep]")'
        raise UserError(message) from None
    finally:
        GlobalHydra.instance().hydra = backup
    assert isinstance(values, dict)
    return _Composed({str(k): v for k, v in values.items()}, choices)


def _compose_condition(*overrides: str) -> _Composed:
    """As `_compose`; with visual reconstruction alone in the paper's gridworld row "Transformer+
    vis+lang recon", as that world has no language."""
    composed = _compose(*overrides)
    if (
        composed.choices["condition"] == "impala_transformer_vision_language"
        and composed.values["environment"]["split"] == "gridworld"
        and not any(override.startswith("auxiliary=") for override in overrides)
    ):
        composed = _compose(*overrides, "auxiliary=vision")
    return composed


def _parse(overrides: list[str]) -> list[Override]:
    parser = OverridesParser.create()
    parsed, problems = [], []
    for text in overrides:
        try:
            parsed.append(parser.parse_override(text))
        except HydraException:
            name, equals, value = text.partition("=")
            if equals:
                problems.append(f"{text}: needs quotes within quotes: '{name}=\"{value}\"'")
            else:
                problems.append(f"{text}: not of the form option=value")
    if problems:
        raise UserError("\n".join(problems))
    return parsed


def _jobs(overrides: list[str]) -> Iterator[list[str]]:
    """Every combination of the values that a sweep lists."""
    alternatives = []
    for override in _parse(overrides):
        if override.is_sweep_override():
            prefix = override.get_key_element()
            alternatives.append([f"{prefix}={v}" for v in override.sweep_string_iterator()])
        else:
            alternatives.append([str(override.input_line)])
    for job in itertools.product(*alternatives):
        yield list(job)


def _known(overrides: list[Override]) -> tuple[list[str], list[str]]:
    """The overrides of choices and options that exist, and a line about each that does not."""
    groups = [path.name for path in CONFIG_DIR.iterdir() if path.is_dir()]
    groups.remove("values")  # they follow from the others
    known, problems, options = [], [], []
    for override in overrides:
        key, text = override.key_or_group, str(override.input_line)
        if override.is_delete():
            problems.append(f"{text}: options cannot be deleted; give another value")
        elif key in groups:
            value = str(override.value())
            if value in choices(key):
                known.append(text)
            else:
                own = "; to name a row yourself, say name=<name>" if key == "condition" else ""
                told = nearest(value, choices(key))
                problems.append(f"{key}={value}: no such {key}; {told}{own}")
        else:
            options.append(override)
    if not any(override.key_or_group == "experiment" for override in overrides):
        experiments = "|".join(choices("experiment"))
        problems.append(f"experiment is not set; choose one: experiment={experiments}")
    if not any(text.startswith("experiment=") for text in known):
        return known, problems
    accepted = list(flatten(_compose(*known).values))
    parents = {name.rsplit(".", 1)[0] for name in accepted if "." in name}
    for override in options:
        key = override.key_or_group
        if key in accepted or key in parents or key.startswith("hydra"):
            known.append(str(override.input_line))
        else:
            problems.append(f"{key}: no such option; {nearest(key, accepted)}")
    return known, problems


_IN_WORDS = {
    NAME_PATTERN: "should be usable as a folder's name (not empty, no '/', no leading '.')",
    DEVICE_PATTERN: "should be auto, cpu, cuda or cuda:<number>",
    "string_type": "should be text (quote it if it looks like a number)",
    "string_too_long": "is too long for a folder's name; say name=<name>",
}


def _explain(error: ValidationError, values: dict[str, Any]) -> Iterator[str]:
    for problem in error.errors():
        node: Any = values
        path = []
        for part in problem["loc"]:  # without the tags that pydantic adds for alternatives
            if isinstance(node, dict) and part not in node and part != problem["loc"][-1]:
                continue
            path.append(str(part))
            node = node.get(part) if isinstance(node, dict) else node
        name = ".".join(path)
        if name == "condition":  # chosen from files, so it is the user's own name that is wrong
            name = "name"
        if problem["type"] == "missing" or problem["input"] == "???":
            yield f"{name}: is not set"
        elif problem["type"] == "union_tag_invalid":
            tag = problem["ctx"]
            option = tag["discriminator"].strip("'")
            yield f"{name}.{option}={tag['tag']}: should be one of {tag['expected_tags']}"
        elif problem["type"] == "extra_forbidden":
            yield f"{name}: no such option here"
        else:
            kind = problem.get("ctx", {}).get("pattern", problem["type"])
            message = _IN_WORDS.get(kind, problem["msg"].removeprefix("Input "))
            yield f"{name}={problem['input']}: {message}"


def _impossible(config: Config) -> Iterator[str]:
    """What each option alone does not show: levels that cannot be built, missing devices."""
    start, end = config.schedule.window
    if start > end:
        yield f"schedule.window=[{start}, {end}]: should begin before it ends"
    split = envs.split(config.environment.split)
    train = split.levels("train")
    if config.collector.num_envs < len(train):
        yield (
            f"collector.num_envs={config.collector.num_envs}: should be at least {len(train)}, a "
            f"world for each level that {split.name} trains on"
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
        yield f"run_root={config.run_root}: should be a folder, and a file is in its way"
    if agent.answers_questions and config.exploration.name != "none":
        yield (
            f"exploration={config.exploration.name}: agent={config.agent.name} answers questions "
            "and explores nothing; choose exploration=none"
        )
    built = {name: value for name, value in config.model_dump().items() if name in _BUILT}
    problem = _cannot_be_built(
        json.dumps({"agent": config.agent.name, **built}, sort_keys=True), config
    )
    if problem:
        yield problem


_BUILT = ("environment", "network", "memory", "auxiliary")
_buildable: dict[str, str | None] = {}


def _cannot_be_built(key: str, config: Config) -> str | None:
    """Why the levels or the network cannot be made, or None; tried once for each `key`."""
    if key not in _buildable:
        _buildable[key] = None
        try:
            split = config.split
        except ValueError as error:
            _buildable[key] = f"agent={config.agent.name}: {error}; choose experiment=playroom_find"
            return _buildable[key]
        try:
            for level in (level for kind in envs.KINDS for level in split.levels(kind)):
                env = envs.make_vec(level, 1, **config.level_options)
        except ValueError as error:
            _buildable[key] = f"environment: {error}"
            return _buildable[key]
        try:
            with torch.device("meta"):
                spaces = env.single_observation_space, env.single_action_space
                built = ActorCritic(*spaces, config.network, config.memory)
                build_auxiliary(config.auxiliary, spaces[0], config.network, built, seed=0)
        except ValueError as error:
            _buildable[key] = str(error)
    return _buildable[key]


def _name(composed: _Composed) -> str:
    """Names a row: the condition, or what it would be by agent, memory and auxiliary; then whatever
    else differs.

    The paper's plain agent has an LSTM, so that goes without saying.
    """
    chosen = composed.choices
    name = chosen["condition"]
    if name == "None":
        name = chosen["agent"]
        for group, plain in (("memory", "lstm"), ("auxiliary", "none")):
            if chosen[group] != plain:
                name += f"_{_IN_NAMES.get(chosen[group], chosen[group])}"
    start = [f"experiment={chosen['experiment']}"]
    groups = ["network", "exploration"]
    if name in choices("condition"):
        start.append(f"condition={name}")
        groups += ["agent", "memory", "auxiliary"]
    usual = _compose_condition(*start).choices
    base = flatten(_compose_condition(*start, *(f"{g}={chosen[g]}" for g in _GROUPS)).values)
    for group in groups:
        if chosen[group] != usual[group]:
            name += f",{group}={chosen[group]}"
    for option, value in flatten(composed.values).items():
        if option.split(".")[0] in NOT_LEARNED | {"seed", "experiment", "name"}:
            continue
        if value != base.get(option):
            name += f",{option}={str(value).replace(' ', '').replace('/', '_')}"
    return name


_IN_NAMES = {"gtrxl": "transformer"}  # the paper's word for it
