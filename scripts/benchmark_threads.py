"""How much faster several threads, or processes, step the envs of playroom and labyrinth.

    python scripts/benchmark_threads.py
    python scripts/benchmark_threads.py --threads 1 4 16 --envs 256
    python scripts/benchmark_threads.py playroom/lift/lift_shape_zipf3 --processes 2 --policy expert

They take turns, so that what else the machine does meets all of them alike; the ratio is the median
over rounds of one's speed to that of the first. Actions are random, or those of the family's
expert, whose episodes are as short as those of an agent that solves the task; they are chosen
outside of the time.
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


class Batch:
    """Envs, and the policy that plays them."""

    def __init__(self, env: ZipfVectorEnv, level: str, policy: str) -> None:
        self.env = env
        env.reset(seed=0)
        self._out = env.allocate()
        self._rng = np.random.default_rng(0)
        self._expert = envs.expert(level, env) if policy == "expert" else None

    def speed(self, seconds: float) -> float:
        """Frames a second while they are stepped for so long."""
        env, passed, steps = self.env, 0.0, 0
        count = int(env.single_action_space.n)
        while passed < seconds:
            random = self._rng.integers(count, size=env.num_envs)
            actions = self._expert() if self._expert else random
            start = time.perf_counter()
            env.step(actions, out=self._out)
            passed += time.perf_counter() - start
            steps += env.num_envs
        return steps / passed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    cores = os.cpu_count() or 1
    parser.add_argument("levels", nargs="*", metavar="LEVEL", default=list(LEVELS))
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, cores}))
    parser.add_argument("--processes", type=int, nargs="+", default=[])
    parser.add_argument("--policy", choices=["random", "expert"], default="random")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each in a round")
    given = parser.parse_args()
    ways = [{"threads": k} for k in given.threads] + [{"processes": k} for k in given.processes]
    headings = [f"{count} {name}, frames/s" for way in ways for name, count in way.items()]
    table = Table("level", *headings, "ratios to the first")
    for level in given.levels:
        options = LABYRINTH if level.startswith("labyrinth") else {}
        batches = [
            Batch(
                envs.make_vec(level, given.envs, **way, **options),  # type: ignore[arg-type]
                level,
                given.policy,
            )
            for way in ways
        ]
        for batch in batches:
            batch.speed(0.5)
        rounds = [[batch.speed(given.seconds) for batch in batches] for _ in range(given.rounds)]
        for batch in batches:
            batch.env.close()
        found = np.array(rounds)
        ratios = np.median(found / found[:, :1], axis=0)
        best = [f"{value:,.0f}" for value in np.median(found, axis=0)]
        table.add_row(level, *best, "  ".join(f"{ratio:.2f}" for ratio in ratios))
    Console().print(table)


if __name__ == "__main__":
    main()
