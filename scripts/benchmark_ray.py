"""What bounds a training with actors in a Ray cluster (`runtime=ray`), measured on this machine.

    python scripts/benchmark_ray.py                     # sizes, and Ray's object store
    python scripts/benchmark_ray.py --training --seconds 20

For each experiment: bytes of an unroll and of its weights; frames per second that one process plays
(the actor), from a few steps with as many envs as the experiment has; and what passes from
another process through the object store into the learner's tensors, with arrays of the unroll's
size. Of the latter the first figure is by the clock on the wall, with both processes in turn, the
second by the learner's processor time alone. The actor's is by processor time: what a core of its
own would give.

With `--training` whole training of one experiment is measured, in turn with `runtime=local` and
with 1 and 2 actors: frames per second, the mean and the largest lag, and how busy the learner was.
Without a core for each process these figures say little of a cluster.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table

from zipf import envs
from zipf.experiments.building import loading, run_folder
from zipf.experiments.building.checkpoint import arrays, tensors
from zipf.experiments.building.factory import build_agent
from zipf.experiments.cluster import runtime_of
from zipf.experiments.training.build_collector import build_collector
from zipf.experiments.training.runner import Run

EXPERIMENTS = ("gridworld_compact", "gridworld", "playroom_lift")
STEPS = 4  # of a shortened unroll, whose bytes are those of as many rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--training", action="store_true")
    parser.add_argument("--experiment", default="gridworld_compact", help="of --training")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each training")
    arguments = parser.parse_args()
    console = Console(width=120)
    if arguments.training:
        console.print(trainings(arguments.experiment, arguments.seconds))
    else:
        console.print(sizes())


def sizes() -> Table:
    columns = "frames", "unroll MB", "weights MB", "actor", "store", "learner's part"
    table = Table("Experiment", *columns)
    import ray

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    own = {"include_dashboard": False, "log_to_driver": False, "logging_level": "ERROR"}
    ray.init("local", num_cpus=1, **own)
    actor = ray.remote(Sender).remote()
    calls, _ = timed(lambda: ray.get(actor.send.remote(0)), 200)
    for name in EXPERIMENTS:
        frames, unroll, weights, speed = measured(name)
        passes = timed(lambda unroll=unroll: tensors(ray.get(actor.send.remote(unroll))), 5)
        table.add_row(
            name,
            f"{frames:,}",
            f"{unroll / 1e6:.1f}",
            f"{weights / 1e6:.1f}",
            f"{speed:,.0f}/s",
            *(f"{frames / one:,.0f}/s, {unroll / one / 1e9:.2f} GB/s" for one in passes),
        )
    table.caption = f"a call that carries nothing: {calls * 1e3:.2f} ms"
    ray.shutdown()
    return table


class Sender:
    """An actor that returns arrays of a size."""

    def send(self, count: int) -> dict[str, np.ndarray]:
        """That many bytes, in two arrays: most of an unroll is one."""
        if not hasattr(self, "content") or len(self.content) != count:
            self.content = np.ones(count, np.uint8)
        return {"observation": self.content, "rest": np.ones(16)}


def timed(call: Callable[[], object], times: int) -> tuple[float, float]:
    """The medians of its seconds, on the wall and of this process."""
    call()
    wall, own = [], []
    for _ in range(times):
        starts = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - starts[0])
        own.append(time.process_time() - starts[1])
    return statistics.median(wall), statistics.median(own)


def measured(experiment: str) -> tuple[int, int, int, float]:
    """Frames and bytes of an unroll, bytes of the weights, frames per second of one actor."""
    config = loading.load([f"experiment={experiment}", "device=cpu", "collector.lag=0"])
    num_envs, length = config.collector.num_envs, config.collector.unroll_length
    short = config.collector.model_copy(update={"unroll_length": STEPS})
    config = config.model_copy(update={"collector": short})
    env = envs.make_train(config.split, num_envs, **config.level_options)
    agent = build_agent(config, env)
    collector = build_collector(config, env, agent)
    state = arrays(collector.collect().state_dict())
    _, seconds = timed(collector.collect, 3)
    row = count(state["steps"]) / (STEPS + 1)
    unroll = round(row * (length + 1)) + count(state["memory"])
    weights = count(arrays(dict(agent.actor.state_dict())))
    env.close()
    return num_envs * length, unroll, weights, num_envs * STEPS / seconds


def count(state: object) -> int:
    """Bytes of all arrays in nested dictionaries."""
    if isinstance(state, dict):
        return sum(count(part) for part in state.values())
    return state.nbytes if isinstance(state, np.ndarray) else 0


def trainings(experiment: str, seconds: float) -> Table:
    table = Table("Runtime", "frames/s", "lag, mean", "lag, largest", "learner busy")
    for runtime in (
        ["runtime=local"],
        ["runtime=ray", "runtime.actors=1"],
        ["runtime=ray", "runtime.actors=2"],
    ):
        with tempfile.TemporaryDirectory() as folder:
            options = [f"experiment={experiment}", f"run_root={folder}", "device=cpu"]
            config = loading.load([*options, *runtime])
            run_folder.make(config.folder)
            with Run(config, runtime_of(config)) as run:
                for _ in range(3):
                    run.step()
                run.rollouts.metrics()
                first, learning = run.update, run.clock.parts["learning"]
                start = time.perf_counter()
                while time.perf_counter() < start + seconds:
                    run.step()
                elapsed = time.perf_counter() - start
                metrics = run.rollouts.metrics()
                frames = (run.update - first) * run.frames_per_update
                busy = (run.clock.parts["learning"] - learning) / elapsed
        table.add_row(
            " ".join(runtime),
            f"{frames / elapsed:,.0f}",
            f"{metrics.get('lag_mean', config.lag):.2f}",
            f"{metrics.get('lag_max', config.lag):.0f}",
            f"{busy:.0%}",
        )
    return table


if __name__ == "__main__":
    main()
