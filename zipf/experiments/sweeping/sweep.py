"""Sweeps: many runs, each a process of its own, one after another or by one of Hydra's launchers.

What is finished is skipped, what was interrupted goes on, and what fails is said at the end, after
all the others have run. See `job.py` for what happens in a launcher's processes.
"""

from __future__ import annotations

import os
import re
import shlex
import threading
import uuid
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from hydra import initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, RunMode
from hydra.utils import get_class
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zipf.errors import EXPECTED, UserError
from zipf.experiments.building import run_folder
from zipf.experiments.options import composing
from zipf.experiments.options.config_files import CONFIG_DIR, PRIMARY
from zipf.experiments.options.runtime import TorchrunOptions
from zipf.experiments.sweeping import sweeps
from zipf.experiments.sweeping.job import GPUS, POLL, Board, Job, Jobs, Outcome, State, failed
from zipf.experiments.training.signals import CLUSTER, give_back, take

_COUNTED: tuple[State, ...] = ("finished", "skipped", "paused", "stopped", "not begun", "failed")


def run(overrides: Sequence[str], config_dir: str | None = None) -> int:
    """All jobs of a command line that are not finished; prints a line when one begins, every ten
    minutes and when it ends, and a summary.

    Args:
        config_dir: a folder of the user's configurations, which was added to `composing`.

    Returns the exit code: 0 where all jobs are finished, or stopped by their own
    `schedule.stop_after`; 2 where one is not; 128 and the number of the signal that stopped the
    sweep.

    Raises:
        UserError: a mistake in any job, or in the choice of a launcher. Nothing was begun.
    """
    sweep = sweeps.check(list(overrides), run_folder.is_finished)
    if any(isinstance(job.config.runtime, TorchrunOptions) for job in sweep.jobs):
        raise UserError(
            "runtime=torchrun: a sweep starts each job as one process; start each with torchrun, "
            "or choose runtime=local"
        )
    for why in sweep.left_out:
        _say(f"left out: {why}")
    flags = ["--config-dir", config_dir] if config_dir else []
    jobs, outcomes = [], {}
    for number, planned in enumerate(sweep.jobs, start=1):
        config = planned.config
        job = Job(
            number,
            len(sweep.jobs),
            config.run_name,
            str(config.folder.absolute()),
            config.updates,
            (*flags, *planned.overrides),
        )
        jobs.append(job)
        if planned.is_finished:
            outcomes[job] = Outcome("skipped", "skipped, is finished")
    waiting = tuple(job for job in jobs if job not in outcomes)
    stopped = 0
    if waiting:
        root = sweep.jobs[0].config.run_root
        board = Board(Path(root).expanduser() / ".sweeps" / uuid.uuid4().hex)
        task = Jobs(waiting, board, str(Path.cwd()))
        wants_gpu = any(one.config.device == "auto" for one in sweep.jobs if not one.is_finished)
        launch = _Launch(list(overrides), root, task, wants_gpu)
        for folder in (board.folder, *(Path(job.folder) for job in waiting)):
            run_folder.make(folder)
        for job in outcomes:
            _say_of(job, outcomes[job])
        stopped = launch.run()
        outcomes |= launch.outcomes
    else:
        for job in outcomes:
            _say_of(job, outcomes[job])
    _summarise(outcomes, (job.config.folder.parent.parent for job in sweep.jobs))
    if stopped:
        return 128 + stopped
    states = {outcome.state for outcome in outcomes.values()}
    return 0 if states <= {"finished", "skipped", "paused"} else 2


class _Launch:
    """The jobs that a launcher is given.

    Attributes:
        outcomes: what has become of each of them, after `run`.

    Raises:
        UserError: there is no such launcher, or it was given unknown options.
    """

    def __init__(self, overrides: list[str], run_root: str, task: Jobs, wants_gpu: bool):
        self.task = task
        self.outcomes: dict[Job, Outcome] = {}
        self._root = [f"run_root={composing.quoted(run_root)}"]
        self._launcher = _launcher(overrides, self._root, task, wants_gpu)
        self._signals: list[int] = []
        self._ended = threading.Event()

    def run(self) -> int:
        """Returns, when all jobs have ended, the number of the signal that stopped them, or 0."""
        before = take(self._stop, _say)
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
            if outcome is None or outcome.state == "begun":
                why = broken or (_error(returned[i]) if i < len(returned) else "")
                outcome = self._without_outcome(outcome is not None, why)
                _say_of(job, outcome)
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
        _say("stopping: running jobs save checkpoints; a second signal stops at once")

    def _follow(self) -> None:
        """Prints a line whenever a job has something new."""
        shown: dict[Job, Outcome] = {}
        while True:
            last = self._ended.wait(POLL)
            for job in self.task.jobs:
                outcome = self.task.board.outcome(job)
                if outcome is not None and outcome != shown.get(job):
                    shown[job] = outcome
                    _say_of(job, outcome)
            if last:
                return


def _launcher(overrides: list[str], run_root: list[str], task: Jobs, wants_gpu: bool) -> Launcher:
    words = [word for word in overrides if sweeps.for_hydra(word)]
    if chosen := [word for word in words if word.startswith(("hydra/sweeper", "hydra.sweeper"))]:
        raise UserError(f"{chosen[0]}: sweeps here are over lists of values; leave it out")
    options_of = [word for word in words if word.lstrip("+~").startswith("hydra.launcher.")]
    if options_of and not any(word.startswith("hydra/launcher=") for word in words):
        raise UserError(f"{options_of[0]}: choose the launcher too, as in hydra/launcher=joblib")
    given = [word for word in (composing.search_path(), *words, *run_root) if word]
    backup = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(CONFIG_DIR), version_base="1.3", job_name="zipf"):
            hydra = GlobalHydra.instance().hydra
            assert hydra is not None
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
        launcher = get_class(kind)(**options)
    except (HydraException, OmegaConfBaseException, TypeError) as error:
        raise UserError(composing.message_of(error)) from None
    finally:
        GlobalHydra.instance().hydra = backup
    if kind.endswith(".submitit_launcher.LocalLauncher") and options["gpus_per_node"] is None:
        # Submitit would hide all GPUs. With this they see what they would see without a launcher.
        task = replace(task, gpus={GPUS: os.environ[GPUS]} if GPUS in os.environ else {})
    elif wants_gpu and (option := _of_no_gpu(options)):
        _say(
            f"hydra.launcher.{option}={options[option]}: jobs are given no GPU, and device=auto is "
            f"a CPU there; hydra.launcher.{option}=1 gives one"
        )
    launcher.setup(hydra_context=context, task_function=task, config=config)
    return launcher


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


def _summarise(outcomes: dict[Job, Outcome], folders: Iterable[Path]) -> None:
    states = Counter(outcome.state for outcome in outcomes.values())
    words = {
        "skipped": f"{'was' if states['skipped'] == 1 else 'were'} finished before",
        "paused": "stopped by schedule.stop_after",
    }
    counted = [f"{states[one]} {words.get(one, one)}" for one in _COUNTED if states[one]]
    jobs = f"{len(outcomes)} job{'s' if len(outcomes) > 1 else ''}"
    _say(f"{jobs}: {', '.join(counted)}")
    for job, outcome in outcomes.items():
        if outcome.state == "failed":
            _say_of(job, outcome)
    if states["finished"] + states["skipped"] < len(outcomes):
        _say("the same command does what is missing")
    shown = dict.fromkeys(folder.as_posix() for folder in folders)
    _say(shlex.join(["python", "-m", "zipf.report", *shown]))


def _say_of(job: Job, outcome: Outcome) -> None:
    _say(f"{job.number}/{job.of} {job.name}: {outcome.text}")


def _say(line: str) -> None:
    print(line, flush=True)
