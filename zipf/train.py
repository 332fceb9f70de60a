"""`python -m zipf.train experiment=gridworld`: trains an agent and scores it as it learns."""

from __future__ import annotations

import argparse
import os
import signal
import sys

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zipf.experiments import catalogue, command_line, composing
from zipf.experiments.errors import TOLD, UserError
from zipf.experiments.output import keep_going
from zipf.experiments.running import run_folder, runner

_command_process = os.getpid()
_failed: list[Exception] = []

# For the help text in configs/train.yaml.
OmegaConf.register_new_resolver("zipf_choices", catalogue.help_text, replace=True)


@hydra.main(version_base="1.3", config_path=str(composing.CONFIG_DIR), config_name="train")
def _job(_: DictConfig) -> None:
    keep_going()
    alone = os.getpid() == _command_process
    try:
        for source in HydraConfig.get().runtime.config_sources:
            if source.schema == "file" and source.path != str(composing.CONFIG_DIR):
                composing.add_folder(source.path)  # in a sweep's worker process
        config = command_line.load(list(HydraConfig.get().overrides.task))
        stopped = runner.train(config, alone=alone)
    except TOLD as error:
        if not alone:  # a sweep's worker: the launcher raises it in `main`
            raise
        _tell(error)
        _failed.append(error)
        return
    except KeyboardInterrupt:
        stopped = signal.SIGINT
    if stopped and alone:
        sys.exit(128 + stopped)


def _tell(error: Exception) -> None:
    for line in str(error).splitlines():
        print(f"error: {line}", file=sys.stderr)


def main() -> None:
    """The command: checks every job first, then runs one after another."""
    keep_going()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # otherwise Hydra prints a worker's error and exits
    try:
        _main()
    except TOLD as error:
        _tell(error)
        _failed.append(error)
    except (HydraException, OmegaConfBaseException) as error:
        told = UserError(" ".join(str(error).split()))
        _tell(told)
        _failed.append(told)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    if _failed:
        sys.exit(2)


def _main() -> None:
    arguments = get_args_parser().parse_intermixed_args()
    flags = [word for word in sys.argv[1:] if word not in arguments.overrides]
    sys.argv[1:] = [*flags, *arguments.overrides]  # Hydra wants all overrides together
    asks = ("help", "hydra_help", "info", "shell_completion", "version")
    _check_flags(arguments)
    if arguments.config_dir:
        composing.add_folder(arguments.config_dir)
    composing.load_plugins(command_line.plugins_of(arguments.overrides))
    if not any(getattr(arguments, name, None) for name in asks):
        jobs = command_line.check_command_line(arguments.overrides)
        if len(jobs) > 1 and not arguments.multirun:
            raise UserError(f"lists of values make a sweep of {len(jobs)} jobs: add -m")
        for job in jobs if arguments.multirun else ():
            run_folder.make(job.folder)  # gives our error message, not Hydra's
    sys.argv += [path for path in [composing.search_path()] if path]
    launchers = [word for word in arguments.overrides if word.startswith("hydra/launcher=")]
    if arguments.multirun and launchers and launchers[-1] != "hydra/launcher=basic":
        _run_beside()
    else:
        _job()


def _run_beside() -> None:
    """Runs a sweep whose jobs are processes of their own. Ctrl-C on the terminal reaches them, too:
    they stop with checkpoints, which is waited for; a second one stops all at once."""
    interrupted = False

    def note(number: int, frame: object) -> None:
        nonlocal interrupted
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True

    signal.signal(signal.SIGINT, note)
    try:
        _job()
    except Exception:  # a process that Ctrl-C met between two jobs
        if not interrupted:
            raise
    if interrupted:
        raise KeyboardInterrupt


def _check_flags(arguments: argparse.Namespace) -> None:
    """Raises `UserError` for flags of Hydra's that do not go together, or not with this command."""
    if arguments.config_name or arguments.config_path:
        raise UserError("--config-name and --config-path: use experiment=<name>")
    if arguments.experimental_rerun:
        raise UserError("--experimental-rerun: give the same options again")
    if arguments.resolve and not (arguments.cfg or arguments.help):
        raise UserError("--resolve: goes with --cfg job")
    modes = ("run", "multirun", "cfg", "info", "shell_completion")
    given = [f"--{mode.replace('_', '-')}" for mode in modes if getattr(arguments, mode)]
    if len(given) > 1:
        raise UserError(f"{' and '.join(given)}: choose one")


if __name__ == "__main__":
    main()
