"""Standard output and standard error that cannot end a program."""

from __future__ import annotations

import errno
import io
import sys
from typing import Any, TextIO


def keep_going() -> None:
    """From now on output that cannot be written is dropped: after `| head` has exited, when the
    terminal was closed or the device is full. A character that the encoding lacks is shown as `?`.

    Streams that are no files, as a test's or a notebook's, stay as they are.
    """
    if sys.stdout is sys.__stdout__ and sys.stdout is not None:
        sys.stdout = _stream(sys.stdout, "standard output")
    if sys.stderr is sys.__stderr__ and sys.stderr is not None:
        sys.stderr = _stream(sys.stderr, None)


def _stream(stream: TextIO, name: str | None) -> TextIO:
    try:
        raw = _Droppable(stream.fileno(), name)
        stream.flush()
    except OSError:
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors="replace" if name else "backslashreplace",
        line_buffering=name is None or raw.isatty(),
    )


class _Droppable(io.FileIO):
    """A file that may stop to take what is written to it. Where that fails in an unusual way, it is
    named once, on standard error."""

    def __init__(self, descriptor: int, name: str | None):
        super().__init__(descriptor, "w", closefd=False)
        self._called = name

    def write(self, content: Any, /) -> int:
        try:
            written = super().write(content)
            return len(content) if written is None else written
        except OSError as error:
            # A reader that has seen enough is as usual; after a closed terminal nobody reads.
            if self._called and error.errno not in (errno.EPIPE, errno.EIO):
                print(
                    f"{self._called} cannot be written: {error.strerror}; going on without it",
                    file=sys.stderr,
                )
            self._called = None
            return memoryview(content).nbytes
