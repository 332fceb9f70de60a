"""The jobs of a sweep, given to one of Hydra's launchers and followed until all have ended."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import FrameType
from typing import Any

import torch
from hydra._internal.callbacks import Callbacks
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, RunMode
from hydra.utils import get_class
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zipf.errors import EXPECTED, UserError
from zipf.experiments.options import composing
from zipf.experiments.options.config_files import PRIMARY
from zipf.experiments.sweeping import sweeps
from zipf.experiments.sweeping.job import GPUS, POLL, Job, Jobs, Outcome, failed
from zipf.experiments.sweeping.progress import SweepProgress
from zipf.experiments.training.signals import CLUSTER, give_back, take


class Launch:
    """The jobs that a launcher is given.

    Args:
        overrides: of the command line.
        run_root: where the sweep's files are.
        wants_gpu: whether any of the jobs uses a GPU where it is given one.
        progress: which shows what becomes of the jobs.

    Attributes:
        outcomes: what has become of each of them, after `run`.

    Raises:
        UserError: there is no such launcher, or it was given unknown options.
    """

    def __init__(
        self,
        overrides: list[str],
        run_root: str,
        task: Jobs,
        wants_gpu: bool,
        progress: SweepProgress,
    ):
        self.task = task
        self.outcomes: dict[Job, Outcome] = {}
        self._progress = progress
        self._root = [f"run_root={composing.quoted(run_root)}"]
        self._launcher, note = launcher(overrides, self._root, task, wants_gpu)
        if note:
            progress.say(note)
        self._signals: list[int] = []
        self._ended = threading.Event()

    def run(self) -> int:
        """Returns, when all jobs have ended, the number of the signal that stopped them, or 0."""
        before = take(self._stop, self._progress.say)
        follower = threading.Thread(target=self._follow, daemon=True)
        follower.start()
        returned: Sequence[JobReturn] = ()
        broken = ""
        try:
            returned = self._launcher.launch([self._root for _ in self.task.jobs], 0)
        except KeyboardInterrupt:
            pass
        except Exception as error:  # of any launcher: the outcomes of most jobs are known
            broken = " ".join(str(error).split()) or type(error).__name__
            if not isinstance(error, EXPECTED):
                broken = f"the launcher failed: {type(error).__name__}: {broken}"
        finally:
            self._ended.set()
            follower.join()
            give_back(before)
        for i, job in enumerate(self.task.jobs):
            outcome = self.task.board.outcome(job)
            if outcome is None or not outcome.is_last:
                why = broken or (_error(returned[i]) if i < len(returned) else "")
                outcome = self._without_outcome(outcome is not None, why)
                self._progress.show(job, outcome)
            self.outcomes[job] = outcome
        if len(self._signals) < 2:  # else jobs that still wait in a queue have to see it
            self.task.board.remove()
        return self._signals[0] if self._signals else 0

    def _without_outcome(self, begun: bool, why: str) -> Outcome:
        if self._signals:
            return (
                Outcome("stopped", "stopped at once")
                if begun
                else Outcome("not begun", "not begun")
            )
        return failed(why or "the launcher's process has gone")

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if number in CLUSTER and self._signals:
            return
        self._signals.append(number)
        if sum(one not in CLUSTER for one in self._signals) > 1:
            raise KeyboardInterrupt
        self.task.board.stop()
        self._progress.say("stopping: running jobs save checkpoints; a second signal stops at once")

    def _follow(self) -> None:
        """Shows whenever a job has something new."""
        shown: dict[Job, Outcome] = {}
        while True:
            last = self._ended.wait(POLL)
            for job in self.task.jobs:
                if job in shown and shown[job].is_last:
                    continue
                outcome = self.task.board.outcome(job)
                if outcome is not None and outcome != shown.get(job):
                    shown[job] = outcome
                    self._progress.show(job, outcome)
            if last:
                return


def launcher(
    overrides: list[str], run_root: list[str], task: Jobs, wants_gpu: bool
) -> tuple[Launcher, str]:
    """What starts jobs, as the command line chooses it, and a line that users should read, if any.

    Raises:
        UserError: there is none of that name, or it has no such options.
    """
    words = [word for word in overrides if sweeps.for_hydra(word)]
    if chosen := [word for word in words if word.startswith(("hydra/sweeper", "hydra.sweeper"))]:
        raise UserError(
            f"{chosen[0]}: sweeps here are over lists of values, or draw them with search=random; "
            "leave it out"
        )
    options_of = [word for word in words if word.lstrip("+~").startswith("hydra.launcher.")]
    if options_of and not any(word.startswith("hydra/launcher=") for word in words):
        raise UserError(f"{options_of[0]}: choose the launcher too, as in hydra/launcher=joblib")
    given = [word for word in (composing.search_path(), *words, *run_root) if word]
    try:
        with composing.hydra_at_configs(job_name="zipf") as hydra:
            config = hydra.compose_config(
                config_name=PRIMARY,
                overrides=given,
                run_mode=RunMode.RUN,
                from_shell=False,
                with_log_configuration=False,
            )
            context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(config))
        options: Any = OmegaConf.to_container(config.hydra.launcher, resolve=True)
        kind = options.pop("_target_")
        made = get_class(kind)(**options)
    except (HydraException, OmegaConfBaseException, TypeError) as error:
        raise UserError(composing.message_of(error)) from None
    note = ""
    if kind.endswith(".submitit_launcher.LocalLauncher") and options["gpus_per_node"] is None:
        # Submitit would hide all GPUs. With this they see what they would see without a launcher.
        task = replace(task, gpus={GPUS: os.environ[GPUS]} if GPUS in os.environ else {})
    elif wants_gpu and (option := _of_no_gpu(options)):
        note = (
            f"hydra.launcher.{option}={options[option]}: jobs are given no GPU, and device=auto is "
            f"a CPU there; hydra.launcher.{option}=1 gives one"
        )
    made.setup(hydra_context=context, task_function=task, config=config)
    return made, note


def _of_no_gpu(options: Mapping[str, Any]) -> str | None:
    """The option of a launcher by which jobs would be given GPUs, where they are given none; None
    where they are, where a launcher gives none to anybody, and where this machine, on which the
    jobs run, has none."""
    asked = {name: value for name, value in options.items() if re.search("gpu|gres", name)}
    others = str(options.get("additional_parameters"))
    if not asked or any(asked.values()) or re.search("gpu|gres", others):
        return None
    if options.get("address") == "local" and not torch.cuda.is_available():
        return None
    return "num_gpus" if "num_gpus" in asked else "gpus_per_node"


def _error(returned: JobReturn) -> str:
    if returned.status is JobStatus.COMPLETED:
        return ""
    try:
        return " ".join(str(returned.return_value).split())
    except Exception as error:
        return " ".join(f"{type(error).__name__}: {error}".split())
