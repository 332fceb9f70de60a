"""Trains an agent and scores it as it learns: `python -m zipf.train experiment=gridworld`, and
`zipf.train(experiment="gridworld")` in Python."""

from __future__ import annotations

import argparse
import gc
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

import zipf
from zipf.envs.arguments import mapping
from zipf.errors import EXPECTED, UserError, tell
from zipf.experiments.building import loading
from zipf.experiments.options import catalogue, command_line, composing, config_files
from zipf.experiments.options.config_files import CONFIG_DIR, PRIMARY
from zipf.experiments.options.schema import Config
from zipf.experiments.sweeping import sweeps
from zipf.lazy import callable_as
from zipf.output import QUIET, keep_going, quietly
from zipf.run import Run

__all__ = ["TrainOptions", "main", "train"]

# PyTorch is imported where a run begins: it takes seconds, and mistakes are answered without.


class TrainOptions(TypedDict, total=False):
    """The options of a run whose names have no dot, as docs/configuration.md explains them."""

    experiment: str
    condition: str
    agent: str
    memory: str
    auxiliary: str
    critic: str
    episodic: str
    network: str
    augmentation: str
    exploration: str
    reweighting: str
    hindsight: str
    learning_rate_decay: Sequence[int] | None
    runtime: str
    environment: str
    name: str | None
    plugins: Sequence[str]
    loggers: Sequence[str]
    seed: int
    updates: int
    run_root: str | Path
    device: str
    precision: Literal["auto", "float32", "bfloat16"]
    compile: bool | Literal["auto"]
    capture: bool
    deterministic: bool
    threads: int | None
    processes: int | None
    resume: Literal["auto", "must", "never"]


def train(
    *,
    options: Mapping[str, Any] | None = None,
    config_dir: str | Path | None = None,
    quiet: bool = False,
    **chosen: Unpack[TrainOptions],
) -> Run:
    """Trains an agent and scores it as it learns; what `python -m zipf.train` does with the same
    options.

        run = zipf.train(experiment="demo", seed=1, options={"agent.learning_rate": 1e-3})

    The same call again resumes a run, and leaves a finished one as it is. Where it is interrupted,
    by Ctrl-C or a notebook's stop button, the run keeps a checkpoint, and KeyboardInterrupt is
    raised; a second time stops it at once. Signals are handled in the main thread alone; in another
    one only `schedule.stop_after` stops a run. A process trains one run at a time.

    Args:
        options: those whose names have a dot, by their names.
        config_dir: a folder of your own experiments, conditions and choices.
        quiet: print warnings alone.
        chosen: all other options.

    Returns:
        The run, also where `schedule.stop_after` has ended it before its last update.

    Raises:
        UserError: a line for every mistake in the options; or the run cannot begin, go on or be
            written; or another one is training in this process.
        ValueError: `options` is no mapping.
        KeyboardInterrupt: it was interrupted.
        SystemExit: SIGTERM or a signal of a cluster has ended it, with a checkpoint.
    """
    dotted = mapping("options", options)
    words = [f"{name}={_text(value)}" for name, value in {**chosen, **dotted}.items()]
    config_files.use_folder(config_dir)
    config = loading.load(words)
    flags = [] if config_dir is None else ["--config-dir", str(config_dir)]
    with quietly(quiet):
        stopped = _train(config, flags, words)
    if stopped == signal.SIGINT:
        raise KeyboardInterrupt(f"{config.run_name}: stopped with a checkpoint")
    if stopped:
        raise SystemExit(128 + stopped)
    return Run(config.folder, config.plugins)


_training = threading.Lock()


def _train(config: Config, flags: list[str], overrides: list[str]) -> int:
    """Trains; afterwards PyTorch's generators are as before, and the GPU's memory is free."""
    if of_hydra := [word for word in overrides if sweeps.for_hydra(word)]:
        raise UserError(f"{of_hydra[0]}: is for the jobs of a sweep: add -m, or leave it out")
    import torch

    from zipf.experiments import cluster
    from zipf.experiments.training import runner

    if not _training.acquire(blocking=False):
        raise UserError(
            f"{config.run_name}: another run is training in this process; wait for it, or train in "
            "another process"
        )
    gpus = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()
    try:
        with torch.random.fork_rng(devices=gpus):
            return runner.train(config, cluster.runtime_of(config), [*flags, *overrides])
    finally:
        _training.release()
        gc.collect()
        if torch.cuda.is_initialized():
            torch.cuda.empty_cache()


def _text(value: Any) -> str:
    """A value as the command line has it."""
    match value:
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case str() | Path():
            text = str(value)
            plain = re.fullmatch(r"(?ai)(?!(true|false|null|nan|inf)$)[a-z_/][\w./-]*", text)
            return text if plain else composing.quoted(text)
        case Mapping():
            return "{" + ",".join(f"{key}:{_text(one)}" for key, one in value.items()) + "}"
        case list() | tuple():
            return "[" + ",".join(map(_text, value)) + "]"
    return str(value)  # numbers, those of NumPy, too


@hydra.main(version_base="1.3", config_path=str(CONFIG_DIR), config_name=PRIMARY)
def _hydra(_: DictConfig) -> None:
    """What Hydra prints of a configuration or of itself."""


def _tell(error: Exception) -> None:
    if "RANK" in os.environ:
        from zipf.experiments.cluster import torchrun

        torchrun.let_others_tell(error)
    tell(error)


def main() -> None:
    """The command: a run, or with `-m` a sweep."""
    keep_going()
    quiet = bool(QUIET & set(sys.argv[1:]))
    sys.argv[1:] = [word for word in sys.argv[1:] if word not in QUIET]
    try:
        with quietly(quiet):
            sys.exit(_main())
    except EXPECTED as error:
        _tell(error)
    except (HydraException, OmegaConfBaseException) as error:
        _tell(UserError(composing.message_of(error)))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    sys.exit(2)


def _main() -> int:
    if "--version" in sys.argv[1:]:  # Hydra would tell its own
        print(f"zipf {zipf.__version__}")
        return 0
    words, asked = _asked_to_explain(sys.argv[1:])
    arguments = command_line.split(words)
    if arguments.help:  # shows the options of one run
        arguments.overrides = sweeps.of_all_jobs(arguments.overrides)
    overrides = [] if arguments.hydra_help else arguments.overrides
    sys.argv[1:] = [*arguments.flags, *overrides]  # Hydra wants all overrides together
    asks = ("hydra_help", "info", "shell_completion")
    _check_flags(arguments)
    if arguments.config_dir:
        config_files.use_folder(arguments.config_dir)
    composing.load_plugins(command_line.plugins_of(arguments.overrides))
    if arguments.help:
        command_line.check_names(arguments.overrides)
        print(catalogue.help_text(arguments.overrides))
        return 0
    if asked is not None:
        _explain(asked, arguments.overrides)
        return 0
    if not any(getattr(arguments, name, None) for name in asks):
        if arguments.multirun:
            from zipf.experiments.sweeping import sweep

            return sweep.run(arguments.overrides, arguments.config_dir)
        jobs = sweeps.check(arguments.overrides).jobs
        if len(jobs) > 1 or sweeps.named(arguments.overrides):
            if arguments.cfg:
                raise UserError(
                    f"--cfg: shows the options of one run, and this is a sweep of {len(jobs)} jobs"
                )
            raise UserError(f"this is a sweep of {len(jobs)} jobs: add -m")
        if not arguments.cfg:
            stopped = _train(jobs[0].config, arguments.flags, overrides)
            return 128 + stopped if stopped else 0
    sys.argv += [path for path in [composing.search_path()] if path]
    _hydra()
    return 0


def _asked_to_explain(words: list[str]) -> tuple[list[str], list[str] | None]:
    """The words without `--explain` and what follows it, and the latter: a part of the options, a
    run's folder, or both; None without `--explain`."""
    if "--explain" not in words:
        return words, None
    start = end = words.index("--explain") + 1
    while end < len(words) and not words[end].startswith("-"):
        if "=" in words[end] and not Path(words[end]).is_dir():
            break
        end += 1
    return words[: start - 1] + words[end:], words[start:end]


def _explain(asked: list[str], overrides: list[str]) -> None:
    """Prints where options come from. Raises `UserError` for mistakes."""
    from zipf.experiments.building import run_folder
    from zipf.experiments.options import explaining
    from zipf.experiments.records.descriptions import read_description

    folders = [
        word
        for word in asked
        if ("/" in word or Path(word).is_dir()) and word not in Config.model_fields
    ]
    parts = [word for word in asked if word not in folders]
    if len(folders) > 1 or len(parts) > 1:
        raise UserError(f"--explain {' '.join(asked):.200}: name one group or option, or one run")
    if folders:
        others = [word for word in overrides if not word.startswith("plugins=")]
        if others:
            raise UserError(
                f"--explain {folders[0]:.200}: a run has its options; leave out {others[0]}"
            )
        folder = Path(folders[0])
        config = run_folder.read_config(folder, command_line.plugins_of(overrides))
        command = read_description(folder / "run.json").last_command or ""
        origins = explaining.explain_run(config, command, folder / "config.yaml")
    else:
        if len(jobs := sweeps.check(overrides).jobs) > 1:
            raise UserError(f"--explain: is about one run, and this is a sweep of {len(jobs)} jobs")
        origins = explaining.explain(overrides)
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    print(explaining.report(origins, "".join(parts), width))


def _check_flags(arguments: argparse.Namespace) -> None:
    """Raises `UserError` for flags of Hydra's that do not go together, or not with this command."""
    if arguments.config_name or arguments.config_path:
        raise UserError("--config-name and --config-path: use experiment=<name>")
    if arguments.experimental_rerun:
        raise UserError("--experimental-rerun: give the same options again")
    if arguments.resolve and not (arguments.cfg or arguments.help):
        raise UserError("--resolve: goes with --cfg job")
    if arguments.shell_completion and not any(
        word.startswith(("install=", "uninstall=", "query=")) for word in arguments.overrides
    ):
        raise UserError("--shell-completion: goes with install=, uninstall= or query=<shell>")
    modes = ("run", "multirun", "cfg", "info", "shell_completion")
    given = [f"--{mode.replace('_', '-')}" for mode in modes if getattr(arguments, mode)]
    if len(given) > 1:
        raise UserError(f"{' and '.join(given)}: choose one")


callable_as(__name__, train)

if __name__ == "__main__":
    main()
