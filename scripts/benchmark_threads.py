"""How much faster several threads step the envs of playroom and labyrinth, with random actions.

    python scripts/benchmark_threads.py
    python scripts/benchmark_threads.py --threads 1 4 16 --envs 256

Numbers of threads take turns, so that what else the machine does meets all of them alike; the ratio
is the median over rounds of a number's speed to that of the first.
"""

import argparse
import os
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from zipf import envs
from zipf.envs.vector import ZipfVectorEnv

LABYRINTH = {"image_size": (48, 64), "action_repeat": 8}  # as in experiment=labyrinth_compact
LEVELS = {
    "playroom/lift/lift_shape_zipf3": {},
    "labyrinth/rooms_watermaze": LABYRINTH,
    "labyrinth/explore_goal_locations_small": LABYRINTH,
    "labyrinth/lasertag_one_opponent_small": LABYRINTH,
}


def speed(env: ZipfVectorEnv, seconds: float, rng: np.random.Generator) -> float:
    """Steps of all envs a second."""
    out, count, steps = env.allocate(), int(env.single_action_space.n), 0
    start = time.perf_counter()
    while (passed := time.perf_counter() - start) < seconds:
        env.step(rng.integers(count, size=env.num_envs), out=out)
        steps += env.num_envs
    return steps / passed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    cores = os.cpu_count() or 1
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, cores}))
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0, help="of a number in a round")
    given = parser.parse_args()
    table = Table(
        "level", *(f"{k} threads, frames/s" for k in given.threads), "ratios to the first"
    )
    for level, options in LEVELS.items():
        batches = [
            envs.make_vec(level, given.envs, threads=k, **options)  # type: ignore[arg-type]
            for k in given.threads
        ]
        rng = np.random.default_rng(0)
        for env in batches:
            env.reset(seed=0)
            speed(env, 0.5, rng)
        rounds = [[speed(env, given.seconds, rng) for env in batches] for _ in range(given.rounds)]
        found = np.array(rounds)
        ratios = np.median(found / found[:, :1], axis=0)
        best = [f"{value:,.0f}" for value in np.median(found, axis=0)]
        table.add_row(level, *best, "  ".join(f"{ratio:.2f}" for ratio in ratios))
    Console().print(table)


if __name__ == "__main__":
    main()
