"""How fast the environments step, on one core, beside a copy in RAM.

    python scripts/benchmark_envs.py
    python scripts/benchmark_envs.py --families gridworld

Actions are uniformly random; writing every observation and resetting at the end of episodes are
included. Times are CPU seconds of this process, so that other jobs on the machine disturb less.
All rows are measured in turn, several times over, and each row's median is shown: ratios are of
figures from the same run, and the only ones to compare between machines. benchmark_peers.py
measures the gridworld beside the released one.
"""

import argparse
import os
import statistics
import time
import tracemalloc
from collections.abc import Iterator

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from turns import OwnRow

import zipf.envs
from zipf.envs.labyrinth.levels import LEVELS

LEVEL = "gridworld/zipf_2"
PLAYROOM = {
    "playroom/lift/lift_shape_zipf3": 50000,
    "playroom/put/put_on_bed_tray_all": 6000,
    "playroom/supervised/find_shape_zipf3": None,
}
"""Levels to measure, with the steps per second that are the goal."""
LABYRINTH_MEAN, LABYRINTH_EACH, MIXTURE = 15000, 6000, 10000  # steps per second, the goals
UNITY_STEPS_PER_SECOND = 900 / 4  # the paper: about 900 frames/s with a GPU, four an action


def batch(name: str, num_envs: int, *, into_out: bool, observation: str = "image") -> OwnRow:
    env = zipf.envs.make_vec(LEVEL, num_envs, observation=observation)
    out = env.allocate() if into_out else None
    actions = np.random.default_rng(0).integers(8, size=(256, num_envs))
    env.reset(seed=0, out=out)
    env.step(actions[0], out=out)  # until everything is compiled

    def run(calls: int) -> None:
        for call in range(calls):
            env.step(actions[call % 256], out=out)

    size = sum(array.nbytes for array in env.allocate().values()) // num_envs
    return OwnRow(name, num_envs, run, bytes_per_frame=size)


def single() -> OwnRow:
    env = gym.make("zipf/Gridworld-v0", level="zipf_2")
    actions = np.random.default_rng(0).integers(8, size=1 << 16)
    env.reset(seed=0)

    def run(calls: int) -> None:
        for call in range(calls):
            _, _, terminated, truncated, _ = env.step(actions[call & 0xFFFF])
            if terminated or truncated:
                env.reset()

    size = sum(array.nbytes for array in env.reset(seed=0)[0].values())
    return OwnRow("gym.make", 1, run, bytes_per_frame=size)


def memcpy(frames: int, bytes_per_frame: int) -> OwnRow:
    source = np.ones((frames, bytes_per_frame), dtype=np.uint8)
    target = np.empty_like(source)

    def run(calls: int) -> None:
        for _ in range(calls):
            np.copyto(target, source)

    return OwnRow("memcpy", frames, run)


def bytes_per_env() -> float:
    """Bytes of RAM that a batch takes for each further env, besides `out`."""

    def taken(num_envs: int) -> int:
        tracemalloc.start()
        env = zipf.envs.make_vec(LEVEL, num_envs)
        before = tracemalloc.get_traced_memory()[0]
        out = env.allocate()
        buffers = tracemalloc.get_traced_memory()[0] - before
        env.reset(seed=0, out=out)
        rng = np.random.default_rng(0)
        for _ in range(50):
            env.step(rng.integers(8, size=num_envs), out=out)
        total = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        return total - buffers

    return (taken(4096) - taken(64)) / (4096 - 64)


def rows() -> Iterator[OwnRow]:
    for num_envs in (1, 32, 256, 1024):
        yield batch(f"batch of {num_envs}, out=", num_envs, into_out=True)
    yield batch("batch of 256, fresh arrays", 256, into_out=False)
    yield batch("batch of 256, tiles, out=", 256, into_out=True, observation="tiles")
    yield single()


class Parts:
    """A batch of envs, and where the time of its steps goes.

    Args:
        level: of the envs.
        num_envs: how many.
        methods: of the batch, and the part of the time that is spent in them.
        rest: the part that is spent elsewhere.
    """

    def __init__(self, level: str, num_envs: int, methods: dict[str, str], rest: str) -> None:
        self.env = zipf.envs.make_vec(level, num_envs)
        self.spent = dict.fromkeys((*methods.values(), rest), 0.0)
        self._rest = rest
        self._out = self.env.allocate()
        count = int(self.env.single_action_space.n)
        self._actions = np.random.default_rng(0).integers(count, size=(256, num_envs))
        self._calls = 0
        self._steps = 0
        self.env.reset(seed=0, out=self._out)
        self.run(50)
        for method, part in methods.items():
            self._time(method, part)
        self.forget()

    def stagger(self, steps: int) -> None:
        """Begins the envs' episodes one after another over so many steps.

        A measurement is shorter than an episode: this way its share of resets is the right one.
        """
        everywhere = np.arange(self.env.num_envs)
        for i in everywhere.tolist():
            self.env.reset(options={"reset_mask": everywhere == i}, out=self._out)
            self.run(steps // self.env.num_envs)
        self.forget()

    def forget(self) -> None:
        """Counts anew."""
        self._steps = 0
        self.spent = dict.fromkeys(self.spent, 0.0)

    def run(self, calls: int) -> None:
        start, counted = time.process_time(), sum(self.spent.values())
        for _ in range(calls):
            self.env.step(self._actions[self._calls % 256], out=self._out)
            self._calls += 1
        self._steps += calls * self.env.num_envs
        elsewhere = sum(self.spent.values()) - counted
        self.spent[self._rest] += time.process_time() - start - elsewhere

    def microseconds(self) -> dict[str, float]:
        """Of an env's step, by what they are spent on."""
        return {part: 1e6 * spent / self._steps for part, spent in self.spent.items()}

    def _time(self, method: str, part: str) -> None:
        original = getattr(self.env, method)

        def timed(*arguments: object) -> object:
            start = time.process_time()
            result = original(*arguments)
            self.spent[part] += time.process_time() - start
            return result

        setattr(self.env, method, timed)


def print_playroom(console: Console, repetitions: int, seconds: float) -> None:
    methods = {"_simulate": "physics", "_start": "beginning", "_observe": "rendering"}
    batches = {level: Parts(level, 64, methods, "logic") for level in PLAYROOM}
    measured = [OwnRow(level, 64, parts.run) for level, parts in batches.items()]
    for _ in range(repetitions):
        for row in measured:
            row.measure(seconds)
    table = Table(
        title="the playroom, one core, batch of 64, out=, random actions, resets included",
        title_justify="left",
    )
    table.add_column("", no_wrap=True)
    for column in ("steps/s", "lowest .. highest", "goal", "x original"):
        table.add_column(column, justify="right", no_wrap=True)
    parts = list(next(iter(batches.values())).spent)
    for part in parts:
        table.add_column(f"{part}, us", justify="right")
    for row in measured:
        goal = PLAYROOM[row.name]
        spent = batches[row.name].microseconds()
        table.add_row(
            row.name.removeprefix("playroom/"),
            f"{row.median:,.0f}",
            f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}",
            f">= {goal:,}" if goal else "",
            f"{row.median / UNITY_STEPS_PER_SECOND:.0f}",
            *(f"{spent[part]:.1f}" for part in parts),
        )
    console.print(table)
    console.print(
        "A step is one action: four physics frames and one image of 96 x 72. original: not "
        "measured here; about 900 frames/s, four a step, on a workstation's GPU (the paper).",
        highlight=False,
    )


def print_labyrinth(console: Console, repetitions: int, seconds: float) -> None:
    """Every level; resets are spread over the steps as in long runs."""
    methods = {"_tell": "rules", "_start": "beginning", "_observe": "rendering"}
    table = Table(
        title="the labyrinth, one core, batch of 64, out=, random actions, resets included",
        title_justify="left",
    )
    table.add_column("", no_wrap=True)
    for column in ("steps/s", "lowest .. highest", "goal"):
        table.add_column(column, justify="right", no_wrap=True)
    for part in ("physics", *methods.values()):
        table.add_column(f"{part}, us", justify="right")
    speeds = []
    for name, level in LEVELS.items():
        parts = Parts(f"labyrinth/{name}", 64, methods, "physics")
        parts.stagger(level.seconds * 15)
        row = OwnRow(name, 64, parts.run)
        for _ in range(repetitions):
            row.measure(seconds)
        spent = parts.microseconds()
        speeds.append(row.median)
        table.add_row(
            name,
            f"{row.median:,.0f}",
            f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}",
            f">= {LABYRINTH_EACH:,}",
            *(f"{spent[part]:.1f}" for part in ("physics", *methods.values())),
        )
    table.add_row(
        "mean of the levels", f"{statistics.mean(speeds):,.0f}", "", f">= {LABYRINTH_MEAN:,}"
    )
    together = statistics.harmonic_mean(speeds)
    table.add_row("the same steps on all levels", f"{together:,.0f}", "", f">= {LABYRINTH_MEAN:,}")
    drawn = Parts("labyrinth/forward_zipf", 64, {}, "all")
    drawn.stagger(120 * 15)
    row = OwnRow("forward_zipf", 64, drawn.run)
    for _ in range(3 * repetitions):
        row.measure(seconds)
    table.add_row(
        "forward_zipf, tasks drawn at resets",
        f"{row.median:,.0f}",
        f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}",
        f">= {MIXTURE:,}",
    )
    console.print(table)


def print_gridworld(console: Console, repetitions: int, seconds: float) -> None:
    measured = [(row, memcpy(row.frames, row.bytes_per_frame)) for row in rows()]
    for _ in range(repetitions):
        for pair in measured:
            for row in pair:
                row.measure(seconds)

    parts = Parts(
        LEVEL, 256, {"_advance": "rules", "_begin": "beginning", "_observe": "drawing"}, "rest"
    )
    parts.stagger(256)
    OwnRow("", 256, parts.run).measure(repetitions * seconds)

    table = Table(title=f"{LEVEL}, one core, random actions, resets included", title_justify="left")
    table.add_column("", no_wrap=True)
    for column in ("frames/s", "lowest .. highest", "us/call", "of memcpy"):
        table.add_column(column, justify="right", no_wrap=True)
    for row, copy in measured:
        table.add_row(
            row.name,
            f"{row.median:,.0f}",
            f"{min(row.speeds):,.0f} .. {max(row.speeds):,.0f}",
            f"{1e6 * row.frames / row.median:.1f}",
            f"{row.median / copy.median:.2f}",
        )
    console.print(table)
    spent = ", ".join(f"{part} {256 * us:.0f}" for part, us in parts.microseconds().items())
    console.print(
        f"Microseconds of a step of the batch of 256 with out=: {spent}.", highlight=False
    )
    console.print(
        f"RAM: {bytes_per_env():.0f} bytes for each further env, besides the observations "
        "(goal < 1024)",
        highlight=False,
    )


PRINTED = {"gridworld": print_gridworld, "playroom": print_playroom, "labyrinth": print_labyrinth}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", choices=PRINTED, default=list(PRINTED))
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.3, help="CPU seconds per measurement")
    parser.add_argument("--core", type=int, default=0, help="the core to run on, where possible")
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {arguments.core})

    console = Console(width=120)
    for family in arguments.families:
        PRINTED[family](console, arguments.repetitions, arguments.seconds)


if __name__ == "__main__":
    main()
