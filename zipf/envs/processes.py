"""A batch stepped by several processes."""

from __future__ import annotations

import contextlib
import mmap
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import weakref
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, Pipe
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.errors import EngineError
from zipf.envs.slices import Make, Slices, cut, described, share
from zipf.envs.vector import SHARED, Observation, ZipfVectorEnv

_CLOSING = 1.0  # seconds that all have to end by themselves; ours: a step takes milliseconds
_NOT_OURS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU")
"""Signals that are sent to all processes of a run, whose first process decides what they do."""


class Processes(Slices):
    """`N` envs in consecutive slices, each stepped by a process of its own.

    What is observed is the same, bit for bit, as in one process. Observations and the arrays that
    slices share are in shared memory; what else is asked and answered goes through a pipe, one
    message each way for a step. The processes end with this batch, or with the process that has it.

    The arguments and attributes are those of `Slices`; `make` and the options are pickled.

    Raises:
        ValueError: as `Slices`, or the envs cannot be made in another process.
        EngineError (also in the methods): a process has ended.
    """

    _workers = "processes"

    def __init__(self, make: Make, num_envs: int, count: int, **options: Any) -> None:
        self._arguments = {"make": make, "num_envs": num_envs, "count": count, **options}
        super().__init__(make, num_envs, count, **options)

    def _make(self, make: Callable[[slice], ZipfVectorEnv]) -> list[dict[str, Any]]:
        count = len(self.rows)
        try:
            pickle.dumps(make)
        except Exception as error:
            raise ValueError(f"processes={count}: the envs cannot be sent: {error}") from None
        self.parts: list[Any] = [0] * count  # places among what the processes have
        self._memory = _new_memory()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._pipes: list[Connection] = []
        self._end = weakref.finalize(self, _end, self._pipes, self._processes)
        try:
            for _ in self.rows:
                ours, theirs = Pipe()
                self._pipes.append(ours)
                self._processes.append(_start(theirs, self._memory))
                theirs.close()
            num_envs = self.rows[-1].stop
            return self.each("begin", lambda rows: (make, rows, num_envs, count))
        except BaseException:
            self._end()
            os.close(self._memory)
            raise

    def _share_rows(self) -> None:
        state, self._observation, self._final = _arrays(self._memory, self.num_envs, self)
        os.close(self._memory)
        self.__dict__.update(state)

    def each(
        self,
        method: str,
        args: Callable[[slice], tuple[Any, ...]] = lambda rows: (),
        of: Sequence[Any] | None = None,
    ) -> list[Any]:
        if not self._end.alive:
            raise EngineError(f"processes={len(self.rows)}: they have ended")
        messages = [
            pickle.dumps((place, method, args(rows)), -1)
            for place, rows in zip(of or self.parts, self.rows, strict=True)
        ]
        replies: list[tuple[bool, Any]] = []
        sent = 0
        try:
            for pipe, message in zip(self._pipes, messages, strict=True):
                pipe.send_bytes(message)
                sent += 1
            for pipe in self._pipes:
                replies.append(pickle.loads(pipe.recv_bytes()))
        except BaseException as error:  # what was not received would answer the next question
            self._end()
            if isinstance(error, EOFError | OSError):
                raise self._lost(sent if sent < len(messages) else len(replies)) from None
            raise
        for is_good, value in replies:
            if not is_good:
                raise value
        return [value for _, value in replies]

    def _lost(self, k: int) -> EngineError:
        code, rows = self._processes[k].returncode, self.rows[k]
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else "has ended"
        return EngineError(
            f"processes={len(self.rows)}: the process of envs {rows.start} to {rows.stop - 1} {how}"
        )

    def bind(self, make: Callable[[ZipfVectorEnv], Any]) -> list[Any]:
        return self.each("bind", lambda rows: (make,))

    def close_extras(self, **kwargs: Any) -> None:
        self._end()

    def _step_slices(
        self, actions: NDArray[np.int64], observation: Observation, final: Observation | None
    ) -> list[Any]:
        found = self.each("step", lambda rows: (actions[rows], final is not None))
        for name, array in observation.items():
            np.copyto(array, self._observation[name])
        if final is not None:
            done = np.concatenate([one[1] | one[2] for one in found])
            for name, array in final.items():
                array[done] = self._final[name][done]
        return found

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        self.each("observe", lambda rows: (mask[rows],))
        for name, array in out.items():
            array[mask] = self._observation[name][mask]

    def __getstate__(self) -> dict[str, Any]:
        achieved = self._reports_achieved
        return {"arguments": self._arguments, "state": self.get_state(), "achieved": achieved}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state["arguments"])  # type: ignore[misc]
        if state["achieved"]:
            self.report_achieved()
        self.set_state(state["state"])


def _new_memory() -> int:
    """A file that is in memory and in no folder, so that nobody has to delete it."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("zipf-envs")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _arrays(
    memory: int, num_envs: int, like: ZipfVectorEnv
) -> tuple[dict[str, NDArray[Any]], Observation, Observation]:
    """The shared arrays of a batch of `num_envs` envs that are otherwise `like` these: what its
    slices share, observations, and last observations."""
    names = (*SHARED, "_seeded")
    kinds = [(getattr(like, name).shape, getattr(like, name).dtype) for name in names]
    kinds += [*like._shapes.values()] * 2
    sizes = [
        num_envs * int(np.prod(shape[1:])) * np.dtype(dtype).itemsize for shape, dtype in kinds
    ]
    ends = np.cumsum([-(-size // 64) * 64 for size in sizes]).tolist()
    os.ftruncate(memory, ends[-1])
    mapped = mmap.mmap(memory, ends[-1])
    arrays = [
        np.ndarray((num_envs, *shape[1:]), dtype, mapped, start)
        for (shape, dtype), start in zip(kinds, [0, *ends], strict=False)
    ]
    parts, count = [*like._shapes], len(names)
    observation = dict(zip(parts, arrays[count:], strict=False))
    final = dict(zip(parts, arrays[count + len(parts) :], strict=True))
    return dict(zip(names, arrays, strict=False)), observation, final


def _start(pipe: Connection, memory: int) -> subprocess.Popen[bytes]:
    files = pipe.fileno(), memory
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; from zipf.envs.processes import work; work{files}"
    )
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.DEVNULL,
        env=os.environ | one,
        pass_fds=files,
        start_new_session=True,  # Ctrl-C is for the process that has the batch
    )


def _end(pipes: list[Connection], processes: list[subprocess.Popen[bytes]]) -> None:
    for pipe in pipes:
        pipe.close()
    last = time.monotonic() + _CLOSING
    for process in processes:
        try:
            process.wait(max(0.0, last - time.monotonic()))
        except subprocess.TimeoutExpired:  # as while Numba compiles
            process.kill()
            process.wait()


class _Worker:
    """What runs in a process: a slice, and what is bound to it."""

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.objects: list[Any] = [self]

    def begin(
        self, make: Callable[[slice], ZipfVectorEnv], rows: slice, num_envs: int, count: int
    ) -> dict[str, Any]:
        self.part = part = make(rows)
        found = described(part, Processes._workers, count)
        state, observation, final = _arrays(self.memory, num_envs, part)
        share(state, part, rows)
        self.observation, self.final = cut(observation, rows), cut(final, rows)
        return found

    def bind(self, make: Callable[[ZipfVectorEnv], Any]) -> int:
        self.objects.append(make(self.part))
        return len(self.objects) - 1

    def step(self, actions: NDArray[np.int64], final: bool) -> Any:
        return self.part._step_slice(actions, self.observation, self.final if final else None)

    def observe(self, mask: NDArray[np.bool_]) -> None:
        self.part._observe(self.observation, mask)

    def call(self, place: int, method: str, args: tuple[Any, ...]) -> Any:
        called = self.objects[place]
        if place == 0 and not hasattr(_Worker, method):
            called = self.part
        return getattr(called, method)(*args)


def work(pipe: int, memory: int) -> None:
    """Answers what the other end of a pipe asks, until it is closed."""
    for name in _NOT_OURS:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    worker, ours = _Worker(memory), Connection(pipe)
    while True:
        try:
            message = ours.recv_bytes()
        except (EOFError, OSError):
            return
        reply = _reply(worker, message)
        with contextlib.suppress(OSError):  # nobody waits for it any more
            ours.send_bytes(reply)


def _reply(worker: _Worker, message: bytes) -> bytes:
    try:
        asked = pickle.loads(message)
    except Exception as error:
        return _failure(ValueError(f"not to be had in another process: {error}"))
    try:
        return pickle.dumps((True, worker.call(*asked)), -1)
    except Exception as error:
        return _failure(error)


def _failure(error: Exception) -> bytes:
    """The message that says what has gone wrong: the error itself, if it can be sent."""
    error.add_note("".join(["in a process of the envs:\n", *traceback.format_exception(error)]))
    try:
        reply = pickle.dumps((False, error), -1)
        pickle.loads(reply)
    except Exception:
        reply = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")), -1)
    return reply
