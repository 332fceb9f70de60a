"""What stops a run: Ctrl-C, SIGTERM, what clusters send, and the end of the sweep that it is a job
of."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], object]

CLUSTER = tuple(
    signal.Signals[name] for name in ("SIGUSR1", "SIGUSR2", "SIGXCPU") if hasattr(signal, name)
)  # Windows has none of them
"""Signals by which clusters say that the time of a job is over, or that its place is needed. The
system sends the last one every second."""

STOPPED = (signal.SIGINT, signal.SIGTERM, *CLUSTER)
"""Signals that stop a run with a checkpoint."""

SWEEP_PIPE = "ZIPF_SWEEP_PIPE"
"""The environment variable by which a sweep gives a job of its the reading end of a pipe. The job
has to stop when the other end is closed, on purpose or because the sweep is gone."""


class Stopped(Exception):
    """Work that does not have to be done before a run stops was given up."""


class StopSignals:
    """While this context is entered, the signals of `take` set `requested` to the number of the
    first one. A second SIGINT (Ctrl-C) or SIGTERM raises KeyboardInterrupt at once; those of
    clusters do not, which are sent again and again.

    Args:
        say: told, at the first signal, what will happen.
    """

    def __init__(self, say: Callable[[str], None]):
        self.say = say
        self._received = 0
        self._asked = False

    @property
    def requested(self) -> int:
        """The number of the first signal; SIGTERM's where the sweep has ended; 0 for neither."""
        if not self._received and sweep_has_ended():
            self._received = signal.SIGTERM
            self.say("stopping with a checkpoint: the sweep has ended")
        return self._received

    def __enter__(self) -> StopSignals:
        self._before = take(self._stop, self.say)
        return self

    def __exit__(self, *_: object) -> None:
        give_back(self._before)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        is_first, self._received = not self._received, self._received or number
        if number in CLUSTER:
            line = f"stopping with a checkpoint: {signal.Signals(number).name}" if is_first else ""
        elif self._asked:
            raise KeyboardInterrupt
        else:
            self._asked = True
            line = "stopping with a checkpoint; a second signal stops at once"
        if line:
            with suppress(RuntimeError):  # it came while another line was being written
                self.say(line)


def take(handler: Handler, say: Callable[[str], None]) -> dict[int, Any]:
    """Lets a handler have SIGINT, SIGTERM and, where nobody else handles them, those of `CLUSTER`.
    SIGHUP, of a terminal that is closed, does nothing. Python allows handlers in the main thread
    alone; in another one this says that signals do not stop anything.

    Returns what `give_back` needs.
    """
    if threading.current_thread() is not threading.main_thread():
        say("signals save no checkpoint here: this is not the main thread")
        return {}
    taken = [signal.SIGINT, signal.SIGTERM]
    taken += [number for number in CLUSTER if signal.getsignal(number) is signal.SIG_DFL]
    before: dict[int, Any] = {number: signal.signal(number, handler) for number in taken}
    before[signal.SIGHUP] = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    return before


def give_back(before: Mapping[int, Any]) -> None:
    """Restores the handlers that `take` has replaced."""
    for number, handler in before.items():
        signal.signal(number, handler)


def sweep_has_ended() -> bool:
    """Whether this process is a job of a sweep that stops, or was killed."""
    pipe = os.environ.get(SWEEP_PIPE)
    return pipe is not None and bool(select.select([int(pipe)], [], [], 0)[0])
