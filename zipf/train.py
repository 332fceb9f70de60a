"""`python -m zipf.train experiment=gridworld`: trains an agent and scores it as it learns."""

from __future__ import annotations

import os
import signal
import sys

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zipf.experiments import config, runner
from zipf.experiments.errors import UserError

_command_process = os.getpid()
_failed: list[UserError] = []


@hydra.main(version_base="1.3", config_path=str(config.CONFIG_DIR), config_name="train")
def _job(_: DictConfig) -> None:
    try:
        stopped = runner.train(config.load(list(HydraConfig.get().overrides.task)))
    except UserError as error:
        _tell(error)
        if os.getpid() != _command_process:  # a sweep's worker: the launcher must hear of it
            raise
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
    arguments = get_args_parser().parse_args()
    asks_only = arguments.help or arguments.hydra_help or arguments.cfg or arguments.info
    try:
        if not asks_only:
            config.check_command_line(arguments.overrides)
        _job()
    except UserError as error:
        _tell(error)
        _failed.append(error)
    if _failed:
        sys.exit(2)


if __name__ == "__main__":
    main()
