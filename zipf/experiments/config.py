"""The typed schema of every option, and how a command line becomes a checked configuration.

`load` composes `configs/` with Hydra's overrides and checks the result; `check_command_line` does
so for every job of a sweep before the first one starts. Both report all that is wrong at once.
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field, ValidationError

import zipf
from zipf.agents.encoders import NetworkOptions
from zipf.agents.exploration import ExplorationOptions
from zipf.agents.impala import ImpalaOptions
from zipf.agents.memory import MemoryOptions
from zipf.agents.options import Options
from zipf.envs import levels
from zipf.experiments.errors import UserError

_PACKAGE = Path(zipf.__file__).parent
# In the wheel `configs/` lies inside the package; in a checkout it lies beside it.
CONFIG_DIR = next(
    path for path in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if path.is_dir()
)

PositiveInt = Annotated[int, Field(ge=1)]
Pair = Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
Device = Annotated[str, Field(pattern=r"^(auto|cpu|cuda(:\d+)?)$")]
AnyOptions = TypeVar("AnyOptions", bound=Options)


class GridworldOptions(Options):
    """The gridworld's split and constructor options; the defaults are the released benchmark."""

    split: Literal["gridworld"]
    num_maps: PositiveInt = 20
    num_rooms: Pair = Field(default=[3, 3])
    room_size: Pair = Field(default=[3, 3])
    num_objects: PositiveInt = 20
    max_steps: PositiveInt = 100
    observation: Literal["image", "tiles"] = "image"


class NoAuxiliaryOptions(Options):
    """No auxiliary loss."""

    name: Literal["none"]


class CollectorOptions(Options):
    """An update consumes num_envs x unroll_length frames."""

    num_envs: PositiveInt
    unroll_length: PositiveInt


class EvaluationOptions(Options):
    """Evaluation on the split's three levels, every so many updates."""

    every: PositiveInt
    episodes: PositiveInt
    num_envs: PositiveInt


class ScheduleOptions(Options):
    """When things are written; `window` is the interval of updates that results are taken over."""

    window: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)]
    log_every: PositiveInt
    checkpoint_every: PositiveInt


class Config(Options):
    """Everything a training run can be told; `configs/train.yaml` says what each means."""

    experiment: str
    condition: str
    seed: Annotated[int, Field(ge=0)]
    updates: PositiveInt
    run_root: Annotated[str, Field(min_length=1)]
    device: Device
    precision: Literal["float32", "bfloat16"]
    resume: Literal["auto", "must", "never"]
    agent: ImpalaOptions
    memory: MemoryOptions
    network: NetworkOptions
    auxiliary: NoAuxiliaryOptions
    exploration: ExplorationOptions
    environment: GridworldOptions
    collector: CollectorOptions
    evaluation: EvaluationOptions
    schedule: ScheduleOptions

    @property
    def folder(self) -> Path:
        """Where the run is kept."""
        return Path(self.run_root) / self.experiment / self.condition / f"seed{self.seed}"

    @property
    def level_options(self) -> dict[str, Any]:
        """Constructor options of the split's levels."""
        return {k: v for k, v in self.environment.model_dump().items() if k != "split"}

    @property
    def is_released_benchmark(self) -> bool:
        """Whether the levels are the released ones, so that the paper's numbers compare."""
        return self.environment == GridworldOptions(split=self.environment.split)

    @property
    def torch_device(self) -> str:
        """The device to compute on."""
        return find_device(self.device)

    @property
    def what_is_learned(self) -> dict[str, Any]:
        """The options that a checkpoint depends on, flat: {"agent.discount": 0.99, ...}."""
        return {
            name: value
            for name, value in _flatten(self.model_dump()).items()
            if name.split(".")[0] not in _NOT_LEARNED
        }


# What does not change what is learned: no condition is named after it, no checkpoint tied to it.
_NOT_LEARNED = frozenset(
    ["condition", "updates", "run_root", "device", "resume", "evaluation", "schedule"]
)
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
    problems = list(_unknown_names(_parse(overrides)))
    if problems:
        raise UserError("\n".join(problems))
    composed = _compose(*overrides)
    values = dict(composed.values)
    if values["condition"] is None:
        values["condition"] = _condition(composed)
    try:
        config = Config.model_validate(values)
    except ValidationError as error:
        raise UserError("\n".join(_explain(error, values))) from None
    problems = list(_impossible(config))
    if problems:
        raise UserError("\n".join(problems))
    return config


def find_device(device: str) -> str:
    """The device that is meant: `auto` is CUDA where there is one, else the CPU.

    Raises:
        UserError: CUDA is asked for where there is none.
    """
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if (
        device.startswith("cuda")
        and int(device.partition(":")[2] or 0) >= torch.cuda.device_count()
    ):
        raise UserError(
            f"device={device}: PyTorch {torch.__version__} finds {torch.cuda.device_count()} CUDA "
            "devices here; use device=cpu or device=auto"
        )
    return device


def check_command_line(overrides: list[str]) -> int:
    """Checks every job that the overrides ask for, before any starts; returns how many there are.

    Raises:
        UserError: as `load`, for all jobs together.
    """
    problems: dict[str, None] = {}
    count = 0
    for job in _jobs(overrides):
        count += 1
        try:
            load(job)
        except UserError as error:
            problems.update(dict.fromkeys(str(error).splitlines()))
    if problems:
        raise UserError("\n".join(problems))
    return count


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
        raise UserError(" ".join(str(error).split())) from None
    finally:
        GlobalHydra.instance().hydra = backup
    assert isinstance(values, dict)
    return _Composed({str(k): v for k, v in values.items()}, choices)


def _parse(overrides: list[str]) -> list[Override]:
    parser = OverridesParser.create()
    parsed, problems = [], []
    for text in overrides:
        try:
            parsed.append(parser.parse_override(text))
        except HydraException:
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


def _unknown_names(overrides: list[Override]) -> Iterator[str]:
    """Groups' choices and options that do not exist, each with what would be accepted."""
    groups = [path.name for path in CONFIG_DIR.iterdir() if path.is_dir()]
    valid, named = [], []
    for override in overrides:
        key, value = override.key_or_group, str(override.value())
        if key in groups:
            if value in choices(key):
                valid.append(str(override.input_line))
            else:
                yield f"{key}={value}: no such {key}; {nearest(value, choices(key))}"
        elif not key.startswith("hydra") and not override.is_add():
            named.append(key)
    if not any(override.key_or_group == "experiment" for override in overrides):
        yield f"experiment is not set; choose one: experiment={'|'.join(choices('experiment'))}"
        return
    if not any(text.startswith("experiment=") for text in valid):
        return
    known = list(_flatten(_compose(*valid).values))
    parents = {name.rsplit(".", 1)[0] for name in known if "." in name}
    for key in named:
        if key not in known and key not in parents:
            yield f"{key}: no such option; {nearest(key, known)}"


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
        if problem["type"] == "missing" or problem["input"] == "???":
            yield f"{name}: is not set"
        elif problem["type"] == "extra_forbidden":
            yield f"{name}: no such option here"
        else:
            message = problem["msg"].removeprefix("Input ").removeprefix("Value error, ")
            yield f"{name}={problem['input']}: {message}"


def _impossible(config: Config) -> Iterator[str]:
    """What each option alone does not show: levels that cannot be built, missing devices."""
    start, end = config.schedule.window
    if start > end:
        yield f"schedule.window=[{start}, {end}]: should begin before it ends"
    try:
        find_device(config.device)
    except UserError as error:
        yield str(error)
    for name in ("condition", "experiment"):
        value = getattr(config, name)
        if "/" in value or value.startswith("."):
            yield f"{name}={value}: should be usable as a folder's name (no '/', no leading '.')"
    try:
        split = levels.split(config.environment.split)
        for level in (split.train, split.uniform, split.rare):
            levels.make_vec(level, 1, **config.level_options).close()
    except ValueError as error:
        yield f"environment: {error}"


def _condition(composed: _Composed) -> str:
    """Names a row: agent, memory and auxiliary as the paper's rows, then whatever else differs.

    The paper's plain agent has an LSTM, so that goes without saying.
    """
    chosen = composed.choices
    name = chosen["agent"]
    for group, plain in (("memory", "lstm"), ("auxiliary", "none")):
        if chosen[group] != plain:
            name += f"_{chosen[group]}"
    experiment = f"experiment={chosen['experiment']}"
    usual = _compose(experiment).choices
    base = _flatten(_compose(experiment, *(f"{g}={chosen[g]}" for g in _GROUPS)).values)
    for group in ("network", "exploration"):
        if chosen[group] != usual[group]:
            name += f",{group}={chosen[group]}"
    for option, value in _flatten(composed.values).items():
        if option.split(".")[0] in _NOT_LEARNED | {"seed", "experiment"}:
            continue
        if value != base.get(option):
            name += f",{option}={str(value).replace(' ', '').replace('/', '_')}"
    return name


def _flatten(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
