"""How long replay takes: to draw 32 items of 100,000 and give them new priorities, on one core.

    python scripts/benchmark_replay.py

The sampler alone, and the whole of it with items of several kinds. Each time is the median of as
many calls as fit into a second or two.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from tensordict import TensorDict

from zipf.agents.free_space import in_words
from zipf.agents.priorities import PrioritySampler
from zipf.agents.replay import Replay

CAPACITY = 100_000
BATCH = 32


def median_ms(call: Callable[[], object], seconds: float) -> float:
    for _ in range(10):
        call()
    times = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def sampler_alone(exponent: float) -> Callable[[], object]:
    sampler = PrioritySampler(
        CAPACITY, CAPACITY, priority_exponent=exponent, importance_exponent=0.6, seed=0
    )
    sampler.extend(torch.arange(CAPACITY))
    sampler.update_priority(torch.arange(CAPACITY), torch.rand(CAPACITY))
    priorities = torch.rand(BATCH)

    def call() -> None:
        index, _ = sampler.sample(None, BATCH)
        sampler.update_priority(index, priorities)

    return call


def replay_of(item: TensorDict, capacity: int, folder: Path | None) -> tuple[Replay, Callable]:
    replay = Replay(
        item,
        capacity=capacity,
        priority_exponent=0.9,
        importance_exponent=0.6,
        folder=folder,
        spare=BATCH,
        seed=0,
    )
    batch = torch.stack([item] * BATCH)
    for _ in range(capacity // BATCH):
        replay.insert(batch.clone())
    priorities = torch.rand(BATCH)

    def call() -> None:
        _, index, _ = replay.sample(BATCH)
        replay.update_priorities(index, priorities)

    return replay, call


def frames(rows: int, *shape: int) -> TensorDict:
    """A sequence with one image a row, uint8."""
    return TensorDict({"image": torch.randint(256, (rows, *shape), dtype=torch.uint8)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="to measure each row for")
    seconds = parser.parse_args().seconds
    torch.set_num_threads(1)

    table = Table("what", "items", "each", "ms", title=f"draw {BATCH} and update their priorities")
    for exponent in (0.9, 0.0):
        spent = median_ms(sampler_alone(exponent), seconds)
        table.add_row(f"sampler, exponent {exponent}", str(CAPACITY), "", f"{spent:.3f}")
    with tempfile.TemporaryDirectory() as folder:
        for name, item, capacity, where in (
            ("numbers, RAM", frames(1, 8), CAPACITY, None),
            ("tiles of 20 steps, RAM", frames(20, 49), CAPACITY, None),
            ("63 x 63 images of 132 steps, RAM", frames(132, 63, 63, 3), 320, None),
            ("63 x 63 images of 132 steps, files", frames(132, 63, 63, 3), 320, Path(folder)),
        ):
            replay, call = replay_of(item, capacity, where)
            spent = median_ms(call, seconds)
            table.add_row(name, str(capacity), in_words(replay.item_bytes), f"{spent:.3f}")
    Console().print(table)


if __name__ == "__main__":
    main()
