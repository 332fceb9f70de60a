"""What signals do to a run: Ctrl-C and SIGTERM stop it, a closed terminal does not."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import ClassVar


class StopSignals:
    """While this context is entered, SIGINT (Ctrl-C) and SIGTERM set `requested` to their number;
    the second one raises KeyboardInterrupt at once. SIGHUP, of a terminal that is closed, does
    nothing.

    Args:
        say: told, at the first signal, what will happen.

    Attributes:
        received: of the class: the number of the first signal in this process, 0 before.
    """

    received: ClassVar[int] = 0

    def __init__(self, say: Callable[[str], None]):
        self.say = say
        self.requested = 0

    def __enter__(self) -> StopSignals:
        self._before = {s: signal.signal(s, self._stop) for s in (signal.SIGINT, signal.SIGTERM)}
        self._before[signal.SIGHUP] = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = StopSignals.received = number
        self.say("stopping after this update, with a checkpoint; a second signal stops at once")
