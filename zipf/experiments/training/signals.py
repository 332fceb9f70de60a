"""What stops a run: Ctrl-C, SIGTERM, and the end of the sweep that it is a job of."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable
from types import FrameType

SWEEP_PIPE = "ZIPF_SWEEP_PIPE"
"""The environment variable by which a sweep gives a job of its the reading end of a pipe. The job
has to stop when the other end is closed, on purpose or because the sweep is gone."""


class Stopped(Exception):
    """Work that does not have to be done before a run stops was given up."""


class StopSignals:
    """While this context is entered, SIGINT (Ctrl-C) and SIGTERM set `requested` to their number;
    the second one raises KeyboardInterrupt at once. SIGHUP, of a terminal that is closed, does
    nothing.

    Args:
        say: told, at the first signal, what will happen.
    """

    def __init__(self, say: Callable[[str], None]):
        self.say = say
        self._received = 0

    @property
    def requested(self) -> int:
        """The number of the first signal; SIGTERM's where the sweep has ended; 0 for neither."""
        if not self._received and sweep_has_ended():
            self._received = signal.SIGTERM
            self.say("stopping with a checkpoint: the sweep has ended")
        return self._received

    def __enter__(self) -> StopSignals:
        self._before = {s: signal.signal(s, self._stop) for s in (signal.SIGINT, signal.SIGTERM)}
        self._before[signal.SIGHUP] = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self._received:
            raise KeyboardInterrupt
        self._received = number
        self.say("stopping with a checkpoint; a second signal stops at once")


def sweep_has_ended() -> bool:
    """Whether this process is a job of a sweep that stops, or was killed."""
    pipe = os.environ.get(SWEEP_PIPE)
    return pipe is not None and bool(select.select([int(pipe)], [], [], 0)[0])
