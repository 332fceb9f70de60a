"""The typed schema of all options.

PyTorch, and the agents, are imported where they are first needed: mistakes in the names of
options are answered without them.
"""

from __future__ import annotations

import os
from functools import reduce
from operator import or_
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.options.runtime import RayOptions, RuntimeOptions, TorchrunOptions
from zipf.experiments.records.descriptions import Colour, Count, Finite, Line
from zipf.experiments.records.learned_options import affects_learning, changes_nothing, flatten
from zipf.options import Options, Positive
from zipf.registry import registries

PositiveInt = Annotated[int, Field(ge=1, lt=10**15)]
Interval = Annotated[list[Count], Field(min_length=2, max_length=2)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
NAME_PATTERN = r"^[^/.\r\n][^/\r\n]*$"
DEVICE_PATTERN = r"^(auto|cpu|cuda(:\d+)?)$"


def _in_bytes(name: str) -> str:
    if len(os.fsencode(name)) > 255:  # as on most systems
        raise ValueError("should take at most 255 bytes as a folder's name; use name=<name>")
    return name


Name = Annotated[str, Field(max_length=200, pattern=NAME_PATTERN), AfterValidator(_in_bytes)]
Device = Annotated[str, Field(pattern=DEVICE_PATTERN)]


class CollectorOptions(Options):
    """An update consumes envs_per_update x unroll_length frames; None: of all `num_envs`.

    `envs` is where they are stepped: on the `host`, or as tensors on the `device` of the agent;
    `auto`: there, on a CUDA device and where all that a run consists of can be.
    Of several learners each has its share of the envs. `lag` is how many unrolls collection runs
    ahead of learning, but for `runtime=ray`; None: as many as the agent corrects for. Without
    `bootstrap_at_time_limit` the agent learns as if a time limit were the end of the task: no value
    is expected beyond it. `reward_clipping` changes the rewards that are learned from, not the
    scores.
    """

    num_envs: PositiveInt
    envs_per_update: PositiveInt | None = None
    envs: Literal["auto", "host", "device"] = "auto"
    unroll_length: PositiveInt
    lag: Annotated[int, Field(ge=0, le=1)] | None
    bootstrap_at_time_limit: bool
    reward_clipping: Literal["none", "soft_asymmetric"]


class EvaluationOptions(Options):
    """Evaluation on the split's levels, every `every` updates.

    `episodes` is per level; None: as many as the split says. Chance that is not known is measured
    over `chance_episodes` before a new run begins; 0: it stays unknown.
    """

    every: PositiveInt
    episodes: PositiveInt | None
    num_envs: PositiveInt
    chance_episodes: Annotated[int, Field(ge=0)]


class ScheduleOptions(Options):
    """When files are written. `window` is the interval of updates that results are taken from.

    A command ends with a checkpoint at the first update after `stop_after` seconds; None: no limit.
    """

    window: Interval
    log_every: PositiveInt
    checkpoint_every: PositiveInt
    stop_after: Positive | None = None


class RowOptions(Options):
    """How tables and figures show a condition.

    `order` sorts the rows; those without one come last. `colour` and `line` are those of its
    curves; without a `colour` a free one is chosen.
    """

    title: Line
    order: Finite | None = None
    colour: Colour | None = None
    line: Literal["solid", "dashed"] = "solid"


class PretrainedOptions(Options):
    """Which weights of another run a new run begins with.

    `run` is the other run's folder; None: all weights are drawn from the seed. `parts` are those of
    the agents' networks that are taken: `encoder`, `memory`, heads of the same name, and of the
    encoder also what reads one part of the observations, such as `encoder.instruction`.
    """

    run: Annotated[str, Field(min_length=1)] | None = None
    parts: list[str] = Field(default=["encoder"], min_length=1)

    @property
    def folder(self) -> Path | None:
        """That of `run`; None where there is none, or no such user's home."""
        try:
            return None if self.run is None else Path(self.run).expanduser()
        except RuntimeError:
            return None


SMALLEST_SLICE = 16
"""Ours: envs of a thread; with 8 a frame of lifting took twice the CPU time that it takes in one
thread, with 32 a sixth more."""


class Config(Options):
    """All options of a training run; `configs/train.yaml` says what each of them means.

    `schema()` is this class with the registered classes as types of `environment` and of the groups
    that have a registry (`zipf.registry`), such as `agent`; use it to validate.
    """

    experiment: Name
    condition: Name
    row: RowOptions
    plugins: list[str]
    seed: Seed
    updates: PositiveInt
    run_root: Annotated[str, Field(min_length=1)]
    device: Device
    precision: Literal["auto", "float32", "bfloat16"]
    compile: bool | Literal["auto"]
    capture: bool = True
    deterministic: bool = False
    threads: PositiveInt | None = None
    processes: PositiveInt | None = None
    resume: Literal["auto", "must", "never"]
    agent: Any
    memory: Any
    network: Any
    auxiliary: Any
    critic: Any
    episodic: Any
    exploration: Any
    augmentation: Any
    reweighting: Any
    hindsight: Any
    pretrained: PretrainedOptions = PretrainedOptions()
    learning_rate_decay: Interval | None = None
    environment: Any
    runtime: RuntimeOptions
    loggers: dict[str, Any] = Field(default={})
    collector: CollectorOptions
    evaluation: EvaluationOptions
    schedule: ScheduleOptions

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return (
            Path(self.run_root).expanduser() / self.experiment / self.condition / f"seed{self.seed}"
        )

    @property
    def run_name(self) -> str:
        """The run's name for people."""
        return f"{self.experiment} {self.condition} seed {self.seed}"

    @property
    def split(self) -> envs.Split:
        """The levels to play. For an agent that answers questions these are the variants with
        questions.

        Raises:
            ValueError: the agent answers questions, and these levels have none.
        """
        from zipf.agents import agents

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
        """Whether the levels are the released ones, so that scores compare with the paper's."""
        return self.environment == type(self.environment)(split=self.environment.split)

    @property
    def lag(self) -> int:
        """How many unrolls collection runs ahead of learning, 0 or 1; in a cluster every actor's
        collector waits for its turn."""
        if isinstance(self.runtime, RayOptions):
            return 0
        if self.collector.lag is None:
            from zipf.agents import agents

            return agents()[self.agent.name].largest_lag
        return self.collector.lag

    @property
    def env_threads(self) -> int:
        """How many threads step the envs of a learner: without `threads` as many as PyTorch has, or
        one fewer where collection runs ahead and the learner computes at the same time, as long as
        each has `SMALLEST_SLICE` envs; one where processes step them."""
        if self.processes is not None or not envs.sliceable(self.split):
            return 1
        if self.threads is not None:
            return self.threads
        import torch

        left = torch.get_num_threads() - (1 if self.lag else 0)
        return max(min(left, self.num_envs // SMALLEST_SLICE), 1)

    @property
    def learners(self) -> int:
        """How many processes learn."""
        return self.runtime.learners if isinstance(self.runtime, TorchrunOptions) else 1

    @property
    def num_envs(self) -> int:
        """The envs of each learner."""
        return self.collector.num_envs // self.learners

    @property
    def updates_per_unroll(self) -> int:
        """How many updates are made from each unroll."""
        collector = self.collector
        return max(collector.num_envs // (collector.envs_per_update or collector.num_envs), 1)

    @property
    def frames_per_update(self) -> int:
        """How many frames the learners' updates consume together."""
        collector = self.collector
        return (collector.envs_per_update or collector.num_envs) * collector.unroll_length

    @property
    def torch_device(self) -> str:
        """The device to compute on. Of the learners that torchrun has started on a machine each has
        a GPU of its own.

        Raises:
            UserError: this CUDA device does not exist.
        """
        device = find_device(self.device)
        if device == "cuda" and isinstance(self.runtime, TorchrunOptions):
            return find_device(f"cuda:{os.environ.get('LOCAL_RANK', 0)}")
        return device

    def learning_rate_factor(self, update: int) -> float:
        """The factor of all learning rates in the update that follows `update` others: 1, and in
        `learning_rate_decay` linearly towards 0."""
        if self.learning_rate_decay is None:
            return 1.0
        start, end = self.learning_rate_decay
        return min(max((end - update) / (end - start), 0.0), 1.0)

    @property
    def what_is_learned(self) -> dict[str, Any]:
        """The options that affect learning, flat: {"agent.discount": 0.99, ...}. A checkpoint can
        only be resumed with the same ones."""
        options = flatten(self.model_dump()) | {"collector.lag": self.lag}
        if self.pretrained.run is None:
            del options["pretrained.run"], options["pretrained.parts"]
        else:
            options["pretrained.run"] = name_of_run(self.pretrained.run)
        return {
            name: value
            for name, value in options.items()
            if affects_learning(name) and not changes_nothing(name, value)
        }


def name_of_run(folder: str) -> str:
    """A run's folder by the names of its experiment, condition and seed, wherever it is."""
    return "/".join(PurePath(folder).parts[-3:])


def schema() -> type[Config]:
    """`Config` with the families and the choices of all groups that are registered now."""
    import zipf.agents
    import zipf.experiments.hooks
    import zipf.experiments.loggers  # noqa: F401  (these three register their choices)

    families = [family for family in envs.families().values() if family.splits]
    groups = registries()
    classes = [one for group in groups.values() for one in group.options.values()]
    known = tuple(map(id, (*families, *classes)))
    if known not in _schemas:
        environments = [_environment_options(family) for family in families]
        types: dict[str, Any] = {
            name: (group.union(), {} if group.several else ...) for name, group in groups.items()
        }
        any_environment: Any = Annotated[reduce(or_, environments), Field(discriminator="split")]
        types["environment"] = (any_environment, ...)
        _schemas[known] = create_model("Config", __base__=Config, **types)
    return _schemas[known]


_schemas: dict[tuple[int, ...], type[Config]] = {}


def _environment_options(family: envs.Family) -> type[Options]:
    """A family's constructor options, with a choice of its splits."""
    names = tuple(split.name for split in family.splits)
    return create_model(
        f"{family.name}_environment",
        __base__=family.options_class,
        split=(Literal[names], ...),  # type: ignore[arg-type]
    )


class EvaluateOptions(Options):
    """The options of `python -m zipf.evaluate`."""

    run: Annotated[str, Field(min_length=1)] | None = None
    policy: envs.Scripted | None = None
    split: Annotated[str, Field(min_length=1)] | None = None
    plugins: str = ""
    episodes: PositiveInt | None = None
    num_envs: PositiveInt = 250
    seed: Seed = 0
    device: Device = "auto"


class RandomSearch(Options):
    """`search=random`: values are drawn from `seed`, each trial's anew, and all runs are begun.

    `objective` is the kind of levels whose score is the larger, the better.
    """

    trials: PositiveInt = 20  # ours: one is among the best 14 % of all in 19 of 20 searches
    objective: Literal["train", "validation"] = "validation"  # ours: the nearest to the tail
    seed: Seed = 0  # of the draws; ours: the first


def module_names(text: str) -> list[str]:
    """The modules that the `plugins` option of a small command names: `a,b` or `[a,b]`."""
    return [name.strip() for name in text.strip("[] ").split(",") if name.strip()]


def with_precision(config: Config) -> Config:
    """With what `precision=auto` is on this machine, so that a run's files tell what it computes
    in."""
    if config.precision != "auto":
        return config
    here = "bfloat16" if has_bfloat16(config.device) else "float32"
    return config.model_copy(update={"precision": here})


def find_device(device: str) -> str:
    """The device to use: for `auto`, CUDA if there is one, else the CPU.

    Raises:
        UserError: this CUDA device does not exist.
    """
    import torch

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


def has_bfloat16(device: str) -> bool:
    """Whether a device, or the one that is chosen by `auto`, has instructions for bfloat16. Without
    them it computes the same, several times slower than in float32."""
    import torch

    if device == "auto":
        device = find_device(device)
    if device.startswith("cuda"):
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False)
    # Older versions of PyTorch do not tell.
    known = torch.cpu.get_capabilities() if hasattr(torch.cpu, "get_capabilities") else {}
    return any(known.get(name, False) for name in ("avx512_bf16", "amx_bf16", "bf16"))
