"""How much of stepping environments holds Python's GIL, and what that bounds threads to.

    python scripts/measure_gil.py
    python scripts/measure_gil.py playroom/lift/lift_shape_zipf3 labyrinth/rooms_watermaze --envs 8

The calls of compiled code in a step are timed: it does not hold the GIL while it runs. What a call
costs before its code runs, and what timing it costs, is found with a function that takes the same
arguments and does nothing, and put right. The rest of a step holds the GIL: rules, layouts and
descriptions in Python, NumPy, pymunk, and the way into compiled code. NumPy and pymunk let go of it
in parts of what they do, so shares are upper bounds. Times are CPU seconds of the thread; actions
are chosen outside of them. An equal batch takes the same steps before, so that all is compiled.

Threads hold the GIL in turns. However many there are, together they step at most 1 / (seconds per
frame that hold it) frames a second: the ceiling. A step has costs of its own, so the ceiling falls
with `--envs`, the environments of a thread. benchmark_threads.py measures threads.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from tables import code, markdown

from zipf import envs
from zipf.experiments.building import loading

EXPERIMENTS = {"playroom": "playroom_lift_compact", "labyrinth": "labyrinth_compact"}
PLAYROOM = (
    "playroom/lift/lift_shape_zipf3",
    "playroom/put/put_near_bed_tray_frequent",
    "playroom/put/put_on_bed_tray_frequent",
    "playroom/supervised/find_shape_zipf3",
)
STEPS = {"playroom": 500, "labyrinth": 450}  # five episodes and one, at their time limit
CALLS = 2000  # of a function that does nothing

PLAIN = Dispatcher.__call__


class Batch:
    """Envs that step by random actions, or by their family's expert, the same way each time.

    Attributes:
        steps: to measure.
        seconds: CPU time of the steps.
    """

    def __init__(self, level: str, num_envs: int, policy: str) -> None:
        family = level.partition("/")[0]
        self.steps = STEPS[family]
        config = loading.load([f"experiment={EXPERIMENTS[family]}"])
        self.env: Any = envs.make_vec(level, num_envs, **config.level_options)
        self.env.reset(seed=0)
        self._out = self.env.allocate()
        self._rng = np.random.default_rng(0)
        self._expert = envs.scripted("expert", level, self.env) if policy == "expert" else None
        self.seconds = 0.0

    def step(self, calls: Calls | None = None) -> None:
        env = self.env
        random = self._rng.integers(int(env.single_action_space.n), size=env.num_envs)
        actions = self._expert() if self._expert else random
        with calls.counted() if calls else nullcontext():
            start = time.thread_time()
            env.step(actions, out=self._out)
            self.seconds += time.thread_time() - start


class Calls:
    """The calls of compiled functions from Python.

    Attributes:
        seconds: in them, with what they cost before compiled code runs.
        number: of them, by the function and the types of its arguments.
        examples: of these arguments.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.number: Counter[Any] = Counter()
        self.examples: dict[Any, tuple[Any, ...]] = {}

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Counts those within."""

        def counted(function: Any, *args: Any) -> Any:
            start = time.thread_time()
            result = PLAIN(function, *args)
            self.seconds += time.thread_time() - start
            kind = function, tuple(map(type, args))
            self.number[kind] += 1
            self.examples[kind] = args
            return result

        Dispatcher.__call__ = counted
        yield
        del Dispatcher.__call__


def costs(function: Any, args: tuple[Any, ...]) -> tuple[float, float, float]:
    """Seconds of a call with these arguments without the function's code: as it is, as it is when
    calls are counted, and the part of the latter that is counted."""
    options = {k: v for k, v in function.targetoptions.items() if k != "nopython"}
    nothing = numba.njit(**options)(lambda *args: None)

    def calls() -> float:
        start = time.thread_time()
        for _ in range(CALLS):
            nothing(*args)
        return (time.thread_time() - start) / CALLS

    calls()  # compiles
    counting = Calls()
    plain = calls()
    with counting.counted():
        instrumented = calls()
    return plain, instrumented, counting.seconds / CALLS


def measured(level: str, num_envs: int, policy: str) -> tuple[float, float]:
    """Seconds of a frame on one core, and those of them that hold the GIL."""
    compiling, batch = (Batch(level, num_envs, policy) for _ in range(2))
    for _ in range(batch.steps):
        compiling.step()
    calls = Calls()
    for _ in range(batch.steps):
        batch.step(calls)
    whole, released = batch.seconds, calls.seconds
    for kind, number in calls.number.items():
        plain, instrumented, counted = costs(kind[0], calls.examples[kind])
        whole -= number * (instrumented - plain)
        released -= number * counted
    frames = batch.steps * num_envs
    return whole / frames, (whole - released) / frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    labyrinth = loading.load(["experiment=labyrinth_compact"]).split.levels("train")
    levels = [*PLAYROOM, *(level.name for level in labyrinth)]
    parser.add_argument("levels", nargs="*", metavar="LEVEL", default=levels)
    parser.add_argument("--envs", type=int, default=64, help="of the batch")
    given = parser.parse_args()
    heading = ("level", "policy", "frames/s of a core", "GIL, us a frame", "share", "ceiling")
    print(*markdown(heading, [], heading[2:]), sep="\n")
    for level in given.levels:
        for policy in ("random", "expert") if level.startswith("playroom") else ("random",):
            whole, gil = measured(level, given.envs, policy)
            numbers = (
                f"{1 / whole:,.0f}", f"{gil * 1e6:.1f}", f"{gil / whole:.0%}", f"{1 / gil:,.0f}"
            )  # fmt: skip
            print("|", " | ".join((code(level), policy, *numbers)), "|", flush=True)


if __name__ == "__main__":
    main()
