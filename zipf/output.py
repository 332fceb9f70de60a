"""What commands share: output that cannot end a program, help, version and exit codes."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TextIO

import zipf
from zipf.errors import EXPECTED, tell

if TYPE_CHECKING:
    from rich.console import Console

QUIET = {"-q", "--quiet"}
"""The flags of every command with which it prints warnings and errors alone."""

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


@contextmanager
def quietly(quiet: bool = True) -> Iterator[None]:
    """Here, in this thread, `is_quiet` says what is given."""
    before = _quiet.set(quiet)
    try:
        yield
    finally:
        _quiet.reset(before)


def is_quiet() -> bool:
    """Whether neither progress nor tables are to be printed."""
    return _quiet.get()


def console() -> Console:
    """What prints text and tables to standard output, unless `is_quiet`: 120 columns where that is
    no terminal. In a notebook, too, it is plain text."""
    from rich.console import Console

    made = Console(highlight=False, quiet=is_quiet())
    if made.is_jupyter:
        made = Console(highlight=False, quiet=is_quiet(), force_jupyter=False, force_terminal=False)
    if not made.is_terminal:
        made.width = 120
    return made


def run_command(
    usage: str, work: Callable[[list[str]], None], arguments: Sequence[str] | None = None
) -> int:
    """Prints usage or version where the arguments, those of the process if None, ask for them, else
    does the work, quietly with one of the flags `QUIET`; errors that users can mend are lines on
    standard error. Returns the exit code."""
    keep_going()
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or {"-h", "--help"} & set(words):
        print(usage)
        return 0 if words else 2
    if "--version" in words:
        print(f"zipf {zipf.__version__}")
        return 0
    try:
        with quietly(bool(QUIET & set(words))):
            work([word for word in words if word not in QUIET])
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
