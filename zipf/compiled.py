"""The decorator of every function that numba compiles, and the cache of its compiled code.

Compiled code contains the constants and functions that the function's module imports, but numba's
own cache only notices changes to the file of the function itself. Here compiled code is valid for
one state of all source files of the package that it can depend on. Envs and agents do not import
each other, so that a change of one leaves the code of the other valid; and the files of
`zipf/experiments` and `zipf/adapters` and the commands, which neither imports, count for their own
functions alone.
"""

import contextlib
import hashlib
import logging
import os
import pickle
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

Function = Callable[..., Any]


def compiled(*, references: bool = True, **options: Any) -> Callable[[Function], Any]:
    """Compiles a function by `numba.njit(nogil=True)` at its first call and saves the result.

    The first compilation of a state of the sources is announced by a warning of the logger `zipf`,
    which goes to standard error unless logging is told otherwise.

    It is saved where numba would save it: in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the
    function's file, else in the user's cache folder. Where none of them can be written, every
    process compiles again, and a RuntimeWarning says so once.

    Args:
        references: whether arrays are counted as they are named and dropped, by an atomic
            instruction each. A function that makes no array does without: those it works on are
            its caller's. If it returns any of them, its caller has to do without, too, or would
            give up a reference that was never counted.
        options: further options of `numba.njit`, such as `error_model="numpy"`.
    """

    def decorate(function: Function) -> Any:
        # `_nrt` is numba's runtime, which counts. Its annotations do not have the option.
        chosen = {"nogil": True, "_nrt": references, **options}
        dispatcher: Any = numba.njit(**chosen)(function)
        try:
            dispatcher._cache = _Cache(function)
        except RuntimeError:  # numba found no folder that can be written
            _warn_once()
        return dispatcher

    return decorate


APART = ("agents", "envs")
"""The folders of the package whose modules do not import each other's."""


@cache
def fingerprint(part: str = "") -> str:
    """A hash of numba's version and of the source files that compiled code can depend on,
    hexadecimal; without those of `zipf/experiments`, `zipf/adapters` and the commands.

    Args:
        part: the folder of the package that the code is in.
    """
    package = Path(__file__).parent
    digest = hashlib.sha256(numba.__version__.encode())
    others = {"experiments", "adapters"} | ({*APART} - {part} if part in APART else set())
    left_out = {path for folder in others for path in package.glob(f"{folder}/**/*.py")}
    for path in sorted(set(package.rglob("*.py")) - left_out):
        source = path.read_bytes()
        if path.parent == package and b"zipf.experiments" in source:
            continue  # a command
        digest.update(f"\n{path.relative_to(package).as_posix()} {len(source)}\n".encode())
        digest.update(source)
    return digest.hexdigest()


@cache
def _announce_once() -> None:
    """Once for each state of the sources, or once in a process where that cannot be noted."""
    folder = os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__"
    note = Path(folder) / "compiling_was_announced"
    with contextlib.suppress(OSError):
        if note.exists() and note.read_text() == fingerprint():
            return
        note.parent.mkdir(parents=True, exist_ok=True)
        note.write_text(fingerprint())
    logging.getLogger("zipf").warning(
        "zipf: code is compiled where it is first used: up to a minute, and kept for the next time"
    )


@cache
def _warn_once() -> None:
    warnings.warn(
        "compiled code cannot be saved, so every process compiles it again, which takes up to a "
        "minute: set the environment variable NUMBA_CACHE_DIR to a folder that can be written",
        RuntimeWarning,
        stacklevel=1,
    )


class _Cache(FunctionCache):
    """The saved code of one function. Raises RuntimeError if no folder can be written."""

    def __init__(self, function: Function) -> None:
        super().__init__(function)
        package, own = Path(__file__).parent, Path(function.__code__.co_filename)
        stamp = self._impl.locator.get_source_stamp()
        part = ""
        if package in own.parents:
            part = own.relative_to(package).parts[0]
            stamp = hashlib.sha256(own.read_bytes()).hexdigest()  # in every clone the same
        sources = fingerprint(part), stamp
        name = f"{function.__module__}.{function.__qualname__}".replace("<locals>", "locals")
        self._cache_file = _Files(
            self._cache_path, f"{name}.{sys.implementation.cache_tag}", sources
        )


class _Files(IndexDataCacheFile):
    """One file for each signature of a function, named after the signature and the sources.

    Numba's own files are numbered and listed in an index. Two processes that compile different
    signatures at the same time may choose the same number, and then the index of one can name the
    file of the other. Files that are named after their contents need no index.
    """

    def __init__(self, folder: str, name: str, sources: Any) -> None:
        super().__init__(folder, name, sources)
        self._folder = Path(folder)
        self._name = name
        self._prefix = f"{name}-{_short_hash(sources)}-"

    def load(self, key: Any) -> Any:
        """The code that was saved for a signature, or None."""
        try:
            content = self._path(key).read_bytes()
            digest, saved = content[:_DIGEST], content[_DIGEST:]
            if hashlib.sha256(saved).digest() == digest:  # else it is damaged, or of another origin
                saved_key, data = pickle.loads(saved)
                if saved_key == key:
                    return data
        except (OSError, ImportError, AttributeError):
            pass  # there is none, it cannot be read, or it needs another version of a library
        _announce_once()
        return None

    def save(self, key: Any, data: Any) -> None:
        """Saves the code for a signature and deletes code of other states of the sources."""
        try:
            with self._open_for_write(str(self._path(key))) as file:
                saved = self._dump((key, data))
                file.write(hashlib.sha256(saved).digest() + saved)
        except OSError:  # the disk is full
            _warn_once()
            return
        for path in self._folder.glob(f"{self._name}-*.nbc"):
            if not path.name.startswith(self._prefix):
                with contextlib.suppress(OSError):  # another process, or another user's file
                    path.unlink()

    def flush(self) -> None:
        """Deletes all code of the function."""
        for path in self._folder.glob(f"{self._name}-*.nbc"):
            path.unlink(missing_ok=True)

    def _path(self, key: Any) -> Path:
        return self._folder / f"{self._prefix}{_short_hash(key)}.nbc"


_DIGEST = 32  # bytes that a file begins with: SHA-256 of the rest


def _short_hash(value: Any) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]
