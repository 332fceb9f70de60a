"""Sweeps: many runs, each a process of its own, one after another or by one of Hydra's launchers.

What is finished is skipped, what was interrupted goes on, and what fails is said at the end, after
all the others have run. A run that begins with the weights of another one of the sweep waits for
that one. See `job.py` for what happens in a launcher's processes.
"""

from __future__ import annotations

import shlex
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from zipf.errors import UserError
from zipf.experiments.building import run_folder
from zipf.experiments.options.runtime import TorchrunOptions
from zipf.experiments.options.schema import Config
from zipf.experiments.sweeping import search, sweeps
from zipf.experiments.sweeping.job import Board, Job, Jobs, Outcome, State
from zipf.experiments.sweeping.launching import Launch
from zipf.experiments.sweeping.progress import SweepProgress

_COUNTED: tuple[State, ...] = ("finished", "skipped", "paused", "stopped", "not begun", "failed")


def run(overrides: Sequence[str], config_dir: str | None = None) -> int:
    """All jobs of a command line that are not finished; prints a line when one begins, now and then
    and when it ends, and a summary.

    Args:
        config_dir: a folder of the user's configurations, which was added to `composing`.

    Returns the exit code: 0 where all jobs are finished, or stopped by their own
    `schedule.stop_after`; 2 where one is not; 128 and the number of the signal that stopped the
    sweep.

    Raises:
        UserError: a mistake in any job, or in the choice of a launcher. Nothing was begun.
    """
    words = list(overrides)
    if (asked := search.asked(words, config_dir)) is not None:
        sweeping = Sweeping(words, len(asked.jobs), config_dir)
        sweeping.run(asked.jobs)
        asked.tell()
        sweeping.summarise()
        for line in asked.summary():
            sweeping.say(line)
    else:
        found = sweeps.check(words, run_folder.is_finished)
        sweeping = Sweeping(words, len(found.jobs), config_dir)
        for why in found.left_out:
            sweeping.say(f"left out: {why}")
        sweeping.run(found.jobs)
        sweeping.summarise()
    return sweeping.exit_code


class Sweeping:
    """Jobs that are run as soon as they can be, and what has become of each.

    Args:
        overrides: of the command line.
        jobs: how many there will be.
        config_dir: as for `run`.

    Attributes:
        stopped: the number of the signal that stopped them, or 0.
    """

    def __init__(self, overrides: list[str], jobs: int, config_dir: str | None = None):
        self.stopped = 0
        self._overrides = overrides
        self._of = jobs
        self._flags = ["--config-dir", config_dir] if config_dir else []
        self._progress = SweepProgress(jobs)
        self._outcomes: dict[Job, Outcome] = {}
        self._configs: dict[Job, Config] = {}
        self._jobs: dict[Path | None, Job] = {}  # by their runs' folders

    def say(self, line: str) -> None:
        """Prints a line."""
        self._progress.say(line)

    def run(self, planned: Sequence[sweeps.PlannedJob]) -> None:
        """Runs jobs that were checked, each after the one whose weights it begins with.

        Raises:
            UserError: they cannot be started, or there is no such launcher. Nothing was begun.
        """
        if any(isinstance(one.config.runtime, TorchrunOptions) for one in planned):
            raise UserError(
                "runtime=torchrun: a sweep starts each job as one process; start each with "
                "torchrun, or choose runtime=local"
            )
        jobs = {self._job(one): one for one in planned}
        waiting = {job: one.config for job, one in jobs.items() if not one.is_finished}
        stages = _stages(waiting)
        launch = self._launch(stages[0]) if stages else None
        for config in waiting.values():
            run_folder.make(config.folder)
        with self._progress:
            for job in jobs:
                if job not in waiting:
                    self._end(job, Outcome("skipped", "skipped, is finished"))
            for stage in stages:
                ready = tuple(job for job in stage if not self._lacks_weights(job))
                if ready and not self.stopped:
                    launch = launch or self._launch(ready)
                    self.stopped = launch.run()
                    self._outcomes |= launch.outcomes
                    launch = None
                else:
                    for job in ready:
                        self._end(job, Outcome("not begun", "not begun"))

    def _job(self, planned: sweeps.PlannedJob) -> Job:
        config = planned.config
        job = Job(
            len(self._configs) + 1,
            self._of,
            config.run_name,
            str(config.folder.absolute()),
            config.updates,
            (*self._flags, *planned.overrides),
        )
        self._configs[job] = config
        self._jobs[config.folder] = job
        return job

    def _launch(self, jobs: tuple[Job, ...]) -> Launch:
        configs = [self._configs[job] for job in jobs]
        root = configs[0].run_root
        board = Board(Path(root).expanduser() / ".sweeps" / uuid.uuid4().hex)
        task = Jobs(jobs, board, str(Path.cwd()))
        wants_gpu = any(config.device == "auto" for config in configs)
        launch = Launch(self._overrides, root, task, wants_gpu, self._progress)
        run_folder.make(board.folder)
        return launch

    def _lacks_weights(self, job: Job) -> bool:
        """Whether the run that a job begins with has not finished, of which the job's outcome then
        tells."""
        other = self._jobs.get(self._configs[job].pretrained.folder)
        outcome = self._outcomes.get(other) if other else None
        if other is None or outcome is None or outcome.state in ("finished", "skipped"):
            return False
        why = f"not begun: begins with the weights of {other.name}, which has not finished"
        self._end(job, Outcome("paused" if outcome.state == "paused" else "not begun", why))
        return True

    def _end(self, job: Job, outcome: Outcome) -> None:
        self._outcomes[job] = outcome
        self._progress.show(job, outcome)

    @property
    def exit_code(self) -> int:
        """That of the command, as `run` says."""
        if self.stopped:
            return 128 + self.stopped
        states = {outcome.state for outcome in self._outcomes.values()}
        return 0 if states <= {"finished", "skipped", "paused"} else 2

    def summarise(self) -> None:
        """Says how many jobs have ended how, which have failed, and how a report is made."""
        outcomes = {job: self._outcomes[job] for job in self._configs}
        states = Counter(outcome.state for outcome in outcomes.values())
        words = {
            "skipped": f"{'was' if states['skipped'] == 1 else 'were'} finished before",
            "paused": "stopped by schedule.stop_after or a callback",
        }
        counted = [f"{states[one]} {words.get(one, one)}" for one in _COUNTED if states[one]]
        jobs = f"{len(outcomes)} job{'s' if len(outcomes) > 1 else ''}"
        self.say(f"{jobs}: {', '.join(counted)}")
        for job, outcome in outcomes.items():
            if outcome.state == "failed" or (outcome.state == "not begun" and not self.stopped):
                self.say(f"{job.number}/{job.of} {job.name}: {outcome.text}")
        if states["finished"] + states["skipped"] < len(outcomes):
            self.say("the same command does what is missing")
        configs = list(self._configs.values())
        folders = dict.fromkeys(config.folder.parent.parent.as_posix() for config in configs)
        self.say(shlex.join(["python", "-m", "zipf.report", *folders, *_window(configs)]))


def _stages(configs: Mapping[Job, Config]) -> list[tuple[Job, ...]]:
    """The jobs, each in a later stage than the one before it whose weights it begins with."""
    places: dict[Path | None, int] = {}
    stages: list[list[Job]] = []
    for job, config in configs.items():
        place = places.get(config.pretrained.folder, -1) + 1
        places[config.folder] = place
        if place == len(stages):
            stages.append([])
        stages[place].append(job)
    return [tuple(stage) for stage in stages]


def _window(configs: Sequence[Config]) -> list[str]:
    """The option of a report that shows all of these runs: the last evaluation where one ends
    before its window begins, and each run's own window where those of an experiment differ."""
    if any(config.updates < config.schedule.window[0] for config in configs):
        return ["window=last"]
    windows = {(config.experiment, *config.schedule.window) for config in configs}
    return ["window=own"] if len(windows) > len({config.experiment for config in configs}) else []
