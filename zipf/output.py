"""What commands share: output that cannot end a program, help, version and exit codes."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Callable, Sequence
from typing import Any, TextIO

import zipf
from zipf.errors import EXPECTED, tell


def run_command(
    usage: str, work: Callable[[list[str]], None], arguments: Sequence[str] | None = None
) -> int:
    """Prints usage or version where the arguments, those of the process if None, ask for them, else
    does the work; errors that users can mend are lines on standard error. Returns the exit code."""
    keep_going()
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or {"-h", "--help"} & set(words):
        print(usage)
        return 0 if words else 2
    if "--version" in words:
        print(f"zipf {zipf.__version__}")
        return 0
    try:
        work(words)
    except EXPECTED as error:
        tell(error)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


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
