"""A job of a sweep: a training in a process of its own, and what becomes of it.

The processes of launchers run this. It imports neither PyTorch nor anything that does.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Literal

from hydra.core.hydra_config import HydraConfig

from zipf.experiments.records.replacing import replace_text
from zipf.experiments.records.wording import duration_text
from zipf.experiments.training.signals import STOPPED, SWEEP_PIPE, Handler, give_back

State = Literal[
    "begun", "running", "finished", "skipped", "failed", "stopped", "paused", "not begun"
]
POLL = 0.2  # seconds; ours
REPORT_EVERY = 5  # seconds; ours: a bar that moves, and few files written
GPUS = "CUDA_VISIBLE_DEVICES"
TRAIN = (sys.executable, "-m", "zipf.train")


@dataclass(frozen=True)
class Job:
    """A run of a sweep.

    Attributes:
        number: in the sweep, from 1.
        of: how many jobs the sweep has.
        name: the run's.
        folder: the run's, absolute.
        updates: to reach.
        arguments: of its command, `python -m zipf.train <arguments>`.
    """

    number: int
    of: int
    name: str
    folder: str
    updates: int
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What became of a job, in a word and in words."""

    state: State
    text: str

    @property
    def is_last(self) -> bool:
        """Whether nothing more becomes of the job."""
        return self.state not in ("begun", "running")


class Board:
    """A folder of files through which jobs report their state and learn that the sweep stops.

    Jobs may be processes of other machines; what they return reaches the sweep late, or not at all
    where a launcher's process was killed.
    """

    def __init__(self, folder: Path):
        self.folder = folder.absolute()

    def tell(self, job: Job, outcome: Outcome) -> None:
        """Notes what became of a job. Raises `OSError` where the folder cannot be written."""
        replace_text(self.folder / f"{job.number}.json", json.dumps(asdict(outcome)))

    def outcome(self, job: Job) -> Outcome | None:
        """The latest that a job has reported; None before it has begun."""
        path = self.folder / f"{job.number}.json"
        try:
            return Outcome(**json.loads(path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return None

    def stop(self) -> None:
        """Makes running jobs stop with checkpoints, and further ones not begin."""
        (self.folder / "stop").touch()

    def remove(self) -> None:
        """Removes the folder, and the one that it is in if no other sweep uses that."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.folder.parent.rmdir()

    @property
    def stops(self) -> bool:
        """Whether the sweep stops."""
        return (self.folder / "stop").exists()


@dataclass(frozen=True)
class Jobs:
    """What a launcher calls for each job, in a process of its own or in that of the sweep.

    Attributes:
        jobs: those to launch, in order.
        folder: the working directory of their commands.
        gpus: the environment variable `GPUS` of their processes, where it is set; None: what the
            launcher makes of it.
    """

    jobs: tuple[Job, ...]
    board: Board
    folder: str
    gpus: dict[str, str] | None = None

    def __call__(self, _: Any) -> Outcome:
        job = self.jobs[HydraConfig.get().job.num]
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            # Ctrl-C reaches the job's process, too; this one waits for its end.
            signal.signal(signal.SIGINT, lambda number, frame: None)
        if self.board.stops:
            outcome = Outcome("not begun", "not begun")
        else:
            self.board.tell(job, Outcome("begun", f"begins, in {job.folder}"))
            try:
                outcome = self._train(job)
            except Exception as error:
                outcome = failed(f"{type(error).__name__}: {error}")
        self.board.tell(job, outcome)
        return outcome

    def _train(self, job: Job) -> Outcome:
        began = time.monotonic()
        requeue = _handlers_that_requeue()
        asked: list[int] = []
        for number in requeue:
            signal.signal(number, lambda number, frame: asked.append(number))
        environment = dict(os.environ)
        if self.gpus is not None:
            environment.pop(GPUS, None)
            environment |= self.gpus
        reading, writing = os.pipe()
        with (
            os.fdopen(writing, "wb") as pipe,
            tempfile.TemporaryFile() as shown,
            tempfile.TemporaryFile() as errors,
        ):
            process = subprocess.Popen(
                [*TRAIN, *job.arguments],
                cwd=self.folder,
                env={**environment, SWEEP_PIPE: str(reading)},
                pass_fds=(reading,),
                stdin=subprocess.DEVNULL,
                stdout=shown,
                stderr=errors,
            )
            os.close(reading)
            reported = began
            try:
                while not _has_ended(process):
                    if self.board.stops or asked:
                        pipe.close()
                    elif time.monotonic() - reported > REPORT_EVERY:
                        reported = time.monotonic()
                        if progress := [one for one in _lines(shown) if one.startswith("update ")]:
                            self.board.tell(job, Outcome("running", progress[-1]))
            finally:
                process.kill()  # where waiting for it was interrupted
                process.wait()
                give_back(requeue)
            outcome = _outcome(
                job, process.returncode, _lines(shown), _lines(errors), time.monotonic() - began
            )
        if not asked or outcome.state != "stopped":
            return outcome
        where = outcome.text.partition(";")[0]
        self.board.tell(job, Outcome("begun", f"{where}: its time is over, or its place is needed"))
        try:
            requeue[asked[0]](asked[0], None)  # ends this process, where the job is to begin again
        except Exception as error:
            return Outcome("stopped", " ".join(f"{outcome.text}; {error}".split()))
        return outcome


def _handlers_that_requeue() -> dict[int, Handler]:
    """Submitit's handlers of the signals by which the time of a job is over, or its place needed:
    they give the job back to the queue, or raise where that was too often. What a job does has to
    be saved before.
    """
    handlers: dict[int, Any] = {one: signal.getsignal(one) for one in signal.valid_signals()}
    name = "checkpoint_and_try_requeue"
    return {one: own for one, own in handlers.items() if getattr(own, "__name__", "") == name}


def _has_ended(process: subprocess.Popen[bytes]) -> bool:
    try:
        process.wait(POLL)
    except subprocess.TimeoutExpired:
        return False
    return True


def _outcome(job: Job, code: int, shown: list[str], errors: list[str], seconds: float) -> Outcome:
    said = [line for line in shown if line.startswith("stopped at ")]
    if code == 0:
        if said:  # by schedule.stop_after
            return Outcome("paused", said[-1])
        return Outcome("finished", f"finished, {job.updates:,} updates, {duration_text(seconds)}")
    if code - 128 in STOPPED:
        return Outcome("stopped", said[-1] if said else "stopped before it began")
    if -code in STOPPED:
        return Outcome("stopped", "stopped before it began, or without a checkpoint")
    if code < 0:
        why = ", as happens where a machine runs out of RAM" if code == -signal.SIGKILL else ""
        return failed(f"its process was killed by {signal.Signals(-code).name}{why}")
    messages = [line.removeprefix("error: ") for line in errors if line.startswith("error: ")]
    if code == 2 and messages:
        return failed("; ".join(messages))
    log = Path(job.folder) / "train.log"
    with open(log, "a", encoding="utf-8") as file:
        file.writelines(f"{line}\n" for line in errors)
    last = errors[-1] if errors else f"exit code {code}"
    return failed(f"{last} (traceback in {log})")


def _lines(file: IO[bytes]) -> list[str]:
    """What a process has written so far; does not move the place where it writes on."""
    written = os.pread(file.fileno(), os.fstat(file.fileno()).st_size, 0)
    return written.decode(errors="replace").splitlines()


def failed(why: str) -> Outcome:
    """The outcome of a job that failed, on one line."""
    return Outcome("failed", f"failed: {' '.join(why.split())}")
