"""The typed schema of every option."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from zipf import envs
from zipf.agents.agent import agents
from zipf.agents.auxiliary import AuxiliaryOptions
from zipf.agents.encoders import NetworkOptions
from zipf.agents.exploration import ExplorationOptions
from zipf.agents.impala import ImpalaOptions
from zipf.agents.memory import MemoryOptions
from zipf.agents.r2d2 import R2D2Options
from zipf.agents.supervised import SupervisedOptions
from zipf.agents.vmpo import VMPOOptions
from zipf.experiments.errors import UserError
from zipf.options import Options

PositiveInt = Annotated[int, Field(ge=1)]
Pair = Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
NAME_PATTERN = r"^[^/.][^/]*$"
DEVICE_PATTERN = r"^(auto|cpu|cuda(:\d+)?)$"
Name = Annotated[str, Field(max_length=200, pattern=NAME_PATTERN)]
Device = Annotated[str, Field(pattern=DEVICE_PATTERN)]


class GridworldOptions(Options):
    """The gridworld's split and constructor options; the defaults are the released benchmark."""

    split: Literal["gridworld"]
    num_maps: PositiveInt = 20
    num_rooms: Pair = Field(default=[3, 3])
    room_size: Pair = Field(default=[3, 3])
    num_objects: PositiveInt = 20
    max_steps: PositiveInt = 100
    observation: Literal["image", "tiles"] = "image"


class PlayroomOptions(Options):
    """A playroom split and constructor options; the defaults are the benchmark."""

    split: Literal["playroom_lift", "playroom_put", "playroom_find"]
    image_size: Pair = Field(default=[72, 96])
    object_order: Literal["default", "alternate"] = "default"
    max_steps: PositiveInt = 900


EnvironmentOptions = Annotated[GridworldOptions | PlayroomOptions, Field(discriminator="split")]


AgentOptions = Annotated[
    ImpalaOptions | VMPOOptions | R2D2Options | SupervisedOptions, Field(discriminator="name")
]


class CollectorOptions(Options):
    """An update consumes num_envs x unroll_length frames."""

    num_envs: PositiveInt
    unroll_length: PositiveInt


class EvaluationOptions(Options):
    """Evaluation on the split's levels, every so many updates."""

    every: PositiveInt
    episodes: PositiveInt
    num_envs: PositiveInt


class ScheduleOptions(Options):
    """When things are written; `window` is the interval of updates that results are taken over."""

    window: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)]
    log_every: PositiveInt
    checkpoint_every: PositiveInt


# What does not change what is learned: no condition is named after it, no checkpoint tied to it.
NOT_LEARNED = frozenset(
    ["condition", "updates", "run_root", "device", "compile", "resume", "evaluation", "schedule"]
)


class Config(Options):
    """Everything a training run can be told; `configs/train.yaml` says what each means."""

    experiment: Name
    condition: Name
    seed: Seed
    updates: PositiveInt
    run_root: Annotated[str, Field(min_length=1)]
    device: Device
    precision: Literal["float32", "bfloat16"]
    compile: bool = False  # what runs had before it was an option
    resume: Literal["auto", "must", "never"]
    agent: AgentOptions
    memory: MemoryOptions
    network: NetworkOptions
    auxiliary: AuxiliaryOptions
    exploration: ExplorationOptions
    environment: EnvironmentOptions
    collector: CollectorOptions
    evaluation: EvaluationOptions
    schedule: ScheduleOptions

    @property
    def folder(self) -> Path:
        """Where the run is kept."""
        return (
            Path(self.run_root).expanduser() / self.experiment / self.condition / f"seed{self.seed}"
        )

    @property
    def split(self) -> envs.Split:
        """The levels that are played; a classifier is asked about their first frames alone.

        Raises:
            ValueError: a classifier, and levels that it cannot be asked about.
        """
        split = envs.split(self.environment.split)
        if agents()[self.agent.name].answers_questions:
            return envs.questions(split)
        return split

    @property
    def level_options(self) -> dict[str, Any]:
        """Constructor options of the split's levels."""
        return {k: v for k, v in self.environment.model_dump().items() if k != "split"}

    @property
    def is_released_benchmark(self) -> bool:
        """Whether the levels are the released ones, so that the paper's numbers compare."""
        released = type(self.environment).model_validate({"split": self.environment.split})
        return self.environment == released

    @property
    def torch_device(self) -> str:
        """The device to compute on."""
        return find_device(self.device)

    @property
    def what_is_learned(self) -> dict[str, Any]:
        """The options that a checkpoint depends on, flat: {"agent.discount": 0.99, ...}."""
        return {
            name: value
            for name, value in flatten(self.model_dump()).items()
            if name.split(".")[0] not in NOT_LEARNED
        }


class EvaluateOptions(Options):
    """What `python -m zipf.evaluate` can be told."""

    run: Annotated[str, Field(min_length=1)]
    episodes: PositiveInt = 1000
    num_envs: PositiveInt = 250
    seed: Seed = 0
    device: Device = "auto"


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


def flatten(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested options as one level: {"agent.discount": 0.99, ...}."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
