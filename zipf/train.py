"""`python -m zipf.train experiment=gridworld`: trains an agent and scores it as it learns."""

from __future__ import annotations

import os
import signal
import sys

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from zipf.experiments import catalogue, command_line, composing
from zipf.experiments.errors import UserError
from zipf.experiments.running import run_folder, runner

_command_process = os.getpid()
_failed: list[UserError] = []

# For the help text in configs/train.yaml.
OmegaConf.register_new_resolver("zipf_choices", catalogue.help_text, replace=True)


@hydra.main(version_base="1.3", config_path=str(composing.CONFIG_DIR), config_name="train")
def _job(_: DictConfig) -> None:
    try:
        for source in HydraConfig.get().runtime.config_sources:
            if source.schema == "file" and source.path != str(composing.CONFIG_DIR):
                composing.add_folder(source.path)  # in a sweep's worker process
        config = command_line.load(list(HydraConfig.get().overrides.task))
        stopped = runner.train(config, alone=os.getpid() == _command_process)
    except UserError as error:
        if os.getpid() != _command_process:  # a sweep's worker: the launcher raises it in `main`
            raise
        _tell(error)
        _failed.append(error)
        return
    except KeyboardInterrupt:
        stopped = signal.SIGINT
    if stopped:
        sys.exit(128 + stopped)


def _tell(error: UserError) -> None:
    for line in str(error).splitlines():
        print(f"error: {line}", file=sys.stderr)


def main() -> None:
    """The command: checks every job first, then runs one after another."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # otherwise Hydra prints a worker's error and exits
    arguments = get_args_parser().parse_intermixed_args()
    flags = [word for word in sys.argv[1:] if word not in arguments.overrides]
    sys.argv[1:] = [*flags, *arguments.overrides]  # Hydra wants all overrides together
    asks = ("help", "hydra_help", "info", "shell_completion", "version")
    try:
        if arguments.config_name or arguments.config_path:
            raise UserError("--config-name and --config-path: use experiment=<name>")
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
        _job()
    except UserError as error:
        _tell(error)
        _failed.append(error)
    if _failed:
        sys.exit(2)


if __name__ == "__main__":
    main()
