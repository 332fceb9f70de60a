"""Rows of a benchmark that work in turn: calls of this process, or processes of their own.

A script with processes, each with a library's own interpreter, starts itself once for every row,
with an option that names the row; that process calls `serve`. What is imported here comes with
Python, since such a process may have an interpreter without zipf.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

Pause = Callable[[int], None]
"""Called every now and then with the number of frames since; returns when the row may go on."""


def add_options(parser: argparse.ArgumentParser, seconds: float) -> None:
    """Adds the options that all these scripts have; `seconds` is the default of one."""
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=seconds, help="of each row in each round")
    parser.add_argument("--match", default="", help="rows whose name has this in it, beside zipf's")
    parser.add_argument("--environments", type=Path, default=ROOT / "build" / "peers")


def python_of(name: str, packages: Sequence[str | Path], folder: Path) -> Path:
    """The interpreter of a virtual environment, which is made if it is not there.

    Args:
        name: of the virtual environment, in the folder.
        packages: arguments of `pip install`.
        folder: of the virtual environments.

    Raises:
        subprocess.CalledProcessError: it cannot be installed; pip's messages tell why.
    """
    python = folder.resolve() / name / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder / name)], check=True)
        try:
            install = [str(python), "-m", "pip", "install", "--quiet", *map(str, packages)]
            subprocess.run(install, check=True)
        except BaseException:
            python.unlink()  # is made anew the next time
            raise
    return python


@dataclass
class OwnRow:
    """A row of this process: `run(calls)` makes that many calls of `frames` frames each."""

    name: str
    frames: int
    run: Callable[[int], None]
    bytes_per_frame: int = 0
    speeds: list[float] = field(default_factory=list)

    def measure(self, seconds: float) -> None:
        """Adds the speed of as many calls as take so many CPU seconds."""
        calls = 1
        while True:
            start = time.process_time()
            self.run(calls)
            spent = time.process_time() - start
            if spent >= seconds:
                self.speeds.append(calls * self.frames / spent)
                return
            calls = max(calls * 2, int(1.2 * calls * seconds / max(spent, 1e-6)))

    @property
    def median(self) -> float:
        return statistics.median(self.speeds)


class Row:
    """A row's process, which works while it is let go. It imports zipf from this checkout, and what
    libraries write to the working directory is thrown away.

    Args:
        name: of the row.
        python: the interpreter.
        arguments: of the interpreter: the script, and what names the row there.
    """

    def __init__(self, name: str, python: str | Path, arguments: Sequence[str]):
        self.name = name
        self.speeds: list[float] = []
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._folder = tempfile.TemporaryDirectory()
        self._process = subprocess.Popen(
            [str(Path(python).absolute()), *arguments],
            cwd=self._folder.name,
            text=True,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            **pipes,
        )

    def go(self, seconds: float) -> float:
        """Frames per second over so many seconds of wall clock and the rest of the work then begun.

        Raises:
            RuntimeError: the process has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # what it says is read all the same
            print(seconds, file=self._process.stdin, flush=True)
        for line in self._process.stdout:  # libraries print, too
            if line.startswith("frames/s "):
                return float(line.split()[1])
        raise RuntimeError(f"{self.name}: the process has ended with {self._process.wait()}")

    def end(self) -> None:
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._folder.cleanup()


def serve(work: Callable[[Pause], None], clock: Callable[[], float] = time.perf_counter) -> None:
    """In a row's process: works as long as it is told on standard input.

    Args:
        work: is given the function to call with every few frames.
        clock: whose seconds count in frames per second.
    """
    frames, start, until = 0, 0.0, 0.0

    def pause(more: int) -> None:
        nonlocal frames, start, until
        frames += more
        if time.perf_counter() < until:
            return
        if until:
            print(f"frames/s {frames / (clock() - start)}", flush=True)
        line = sys.stdin.readline()
        if not line:
            raise SystemExit
        frames, start = 0, clock()
        until = time.perf_counter() + float(line)

    work(pause)


def measure(title: str, rows: Sequence[Row], rounds: int, seconds: float) -> None:
    """Lets the rows go in turn, `seconds` each, `rounds` times over, and then ends them."""
    try:
        for row in rows:
            row.go(seconds / 2)  # until everything is compiled and allocated
        for number, row in itertools.product(range(rounds), rows):
            row.speeds.append(row.go(seconds))
            speed = f"{row.speeds[-1]:,.0f} frames/s"
            print(f"{title}: {number + 1}: {row.name}: {speed}", file=sys.stderr)
    finally:
        for row in rows:
            row.end()


def show(title: str, rows: Sequence[Row]) -> None:
    """Prints the medians, and the median of each round's ratio of the first row to the others."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    for column in ("frames/s", "lowest .. highest", "zipf is x times as fast"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        ratios = [ours / other for ours, other in zip(rows[0].speeds, row.speeds, strict=True)]
        table.add_row(
            row.name,
            f"{statistics.median(row.speeds):,.0f}",
            f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}",
            f"{statistics.median(ratios):.2f}",
        )
    Console(width=120).print(table)


def cpu_seconds() -> float:
    """CPU seconds of this process and of the processes it started, ended or not."""
    spent = time.process_time()
    ticks = os.sysconf("SC_CLK_TCK")
    own = str(os.getpid())
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as file:
                    fields = file.read().rsplit(")", 1)[1].split()
            except OSError:
                continue
            if fields[1] == own:
                spent += (int(fields[11]) + int(fields[12])) / ticks
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent + children.ru_utime + children.ru_stime
