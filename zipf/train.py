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

import zipf
from zipf.errors import TOLD, UserError, tell
from zipf.experiments import cluster
from zipf.experiments.cluster import torchrun
from zipf.experiments.options import catalogue, command_line, composing
from zipf.experiments.sweeping import sweep, sweeps
from zipf.experiments.training import runner
from zipf.output import keep_going

# For the help text in configs/train.yaml.
OmegaConf.register_new_resolver("zipf_choices", catalogue.help_text, replace=True)


@hydra.main(version_base="1.3", config_path=str(composing.CONFIG_DIR), config_name="train")
def _run(_: DictConfig) -> None:
    try:
        config = command_line.load(list(HydraConfig.get().overrides.task))
        stopped = runner.train(config, cluster.runtime_of(config))
    except TOLD as error:
        _tell(error)
        sys.exit(2)
    except KeyboardInterrupt:
        stopped = signal.SIGINT
    if stopped:
        sys.exit(128 + stopped)


def _tell(error: Exception) -> None:
    torchrun.let_others_tell(error)
    tell(error)


def main() -> None:
    """The command: a run, or with `-m` a sweep."""
    keep_going()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # otherwise Hydra shortens the traceback of a run
    try:
        sys.exit(_main())
    except TOLD as error:
        _tell(error)
    except (HydraException, OmegaConfBaseException) as error:
        _tell(UserError(composing.told(error)))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    sys.exit(2)


def _main() -> int:
    if "--version" in sys.argv[1:]:  # Hydra would tell its own
        print(f"zipf {zipf.__version__}")
        return 0
    arguments = _parse(sys.argv[1:])
    flags = [word for word in sys.argv[1:] if word not in arguments.overrides]
    if arguments.help:  # shows the options of one run
        arguments.overrides = sweeps.of_all_jobs(arguments.overrides)
    sys.argv[1:] = [*flags, *arguments.overrides]  # Hydra wants all overrides together
    asks = ("help", "hydra_help", "info", "shell_completion")
    _check_flags(arguments)
    if arguments.config_dir:
        composing.add_folder(arguments.config_dir)
    composing.load_plugins(command_line.plugins_of(arguments.overrides))
    if not any(getattr(arguments, name, None) for name in asks):
        if arguments.multirun:
            return sweep.run(arguments.overrides, arguments.config_dir)
        jobs = sweeps.check(arguments.overrides).jobs
        if len(jobs) > 1 or sweeps.named(arguments.overrides):
            if arguments.cfg:
                raise UserError(
                    f"--cfg: shows the options of one run, and this is a sweep of {len(jobs)} jobs"
                )
            raise UserError(f"this is a sweep of {len(jobs)} jobs: add -m")
        if launcher := [word for word in arguments.overrides if sweeps.for_launcher(word)]:
            raise UserError(f"{launcher[0]}: is for the jobs of a sweep: add -m, or leave it out")
    sys.argv += [path for path in [composing.search_path()] if path]
    _run()
    return 0


def _parse(words: list[str]) -> argparse.Namespace:
    """Hydra's flags and the overrides.

    Raises:
        UserError: a flag is none of Hydra's, or is shortened: `--experiment` is no rerun.
    """
    parser = get_args_parser()
    parser.allow_abbrev = False
    arguments, unknown = parser.parse_known_intermixed_args(words)
    if unknown:
        raise UserError(command_line.without_dashes(unknown[0]))
    return arguments


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
