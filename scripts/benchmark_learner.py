"""How fast the learner learns: one update of IMPALA on an unroll made up beforehand.

    python scripts/benchmark_learner.py
    python scripts/benchmark_learner.py --match "72 x 96" --envs 8
    python scripts/benchmark_learner.py --clock cpu --threads 1     # where others use the machine
    python scripts/benchmark_learner.py --training                  # collector.lag=1 against 0

Unrolls are as large as the experiment's. Each measurement has a process of its own, since glibc is
told once what to do with freed memory; all rows are measured in turn, several times over, and each
row's median is shown. Ratios are of figures from the same run, and the only ones to compare between
machines.

Rows that are `giving back` return freed memory to the kernel, as glibc does by itself. `x plain` is
the speed beside the first row, PyTorch as it comes; `of peak` the share of the speed of large
matrix products in the same precision; `GB` the most memory that was held, beside the program. Then,
in microseconds per frame, forward and backward together: the image encoder, the memory, the
instruction encoder, and the rest (heads, losses, optimiser).

With `--training` whole training is measured, collecting and learning, with `collector.lag` 0 and 1
in turn: two runs of each compact experiment, in one process, `--seconds` of one and then of the
other, `--rounds` times.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from tensordict import TensorDict
from torch.utils.flop_counter import FlopCounterMode

from zipf import envs
from zipf.agents.image_networks import ResNet
from zipf.agents.impala import Impala
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.experiments.building import loading, run_folder
from zipf.experiments.building.factory import build_agent
from zipf.experiments.options.schema import find_device
from zipf.experiments.training.allocator import keep_freed_ram
from zipf.experiments.training.runner import Run

Speeds = dict[int, list[float]]

TRAINED = ("gridworld_compact", "playroom_lift_compact")
EXPERIMENTS = {
    "gridworld": "the paper's network, 63 x 63",
    "playroom_lift": "the paper's network, 72 x 96",
    "gridworld_compact": "the compact network, 63 x 63",
    "playroom_lift_compact": "the shallow network, 72 x 96",
}


@dataclass(frozen=True)
class Variant:
    """A way to compute the same."""

    precision: str
    channels_last: bool = True
    keeps_memory: bool = True
    compiled: bool = False

    def __str__(self) -> str:
        words = [self.precision, "channels-last" if self.channels_last else "NCHW"]
        words += ["compiled"] * self.compiled + ["giving back"] * (not self.keeps_memory)
        return " ".join(words)


PLAIN = Variant("float32", channels_last=False, keeps_memory=False)
BEST = Variant("bfloat16")
VARIANTS = (
    PLAIN,
    Variant("float32", channels_last=False),
    Variant("float32"),
    Variant("bfloat16", keeps_memory=False),
    BEST,
    Variant("float32", compiled=True),
    Variant("bfloat16", compiled=True),
)
GOALS = {  # frames/s on 2 cores
    ("gridworld", BEST): 1000,
    ("playroom_lift", BEST): 700,
    ("gridworld_compact", Variant("float32")): 5000,
}
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


def variants(experiment: str, device: str) -> list[Variant]:
    """Those that differ from each other there; what is measured against comes first."""
    found = list(VARIANTS)
    if device != "cpu":  # glibc has no say in a GPU's memory
        found = [v for v in found if v.keeps_memory or v == PLAIN]
    if experiment.endswith("compact"):  # which has no convolutions
        found = [v for v in found if v.channels_last or v == PLAIN]
    return found


def unroll_of(
    agent: Impala, spaces: dict[str, gym.Space], steps: int, num_envs: int, device: str
) -> Unroll:
    """An unroll of noise in which every twentieth step ends an episode."""
    rng = np.random.default_rng(0)
    shape = (steps + 1, num_envs)
    actions = agent.network.actions

    def noise(space: gym.Space) -> torch.Tensor:
        assert isinstance(space, gym.spaces.Box)
        highest = int(space.high.max())
        values = rng.integers(highest + 1, size=(*shape, *space.shape), dtype=space.dtype)
        return torch.from_numpy(values)

    ended = torch.from_numpy(rng.random(shape) < 0.05)
    tensors = {
        "previous_action": torch.from_numpy(rng.integers(actions, size=shape)),
        "previous_reward": torch.zeros(shape),
        "is_first": ended.roll(1, 0),
        "action": torch.from_numpy(rng.integers(actions, size=shape)),
        "reward": torch.from_numpy(rng.random(shape, np.float32)),
        "bonus": torch.zeros(shape),
        "terminated": ended,
        "truncated": torch.zeros(shape, dtype=torch.bool),
        "truncation_value": torch.zeros(shape),
        "logits": torch.zeros(*shape, actions),
    }
    steps_ = TensorDict(tensors, batch_size=shape)
    parts = {name: noise(space) for name, space in spaces.items()}
    steps_["observation"] = TensorDict(parts, batch_size=shape)
    return Unroll(steps_.to(device), agent.initial_memory(num_envs))


def measure(
    experiment: str, variant: Variant, num_envs: int | None, seconds: float, clock: str, device: str
) -> dict[str, Any]:
    """One measurement, in a process made for it."""
    if variant.keeps_memory:
        keep_freed_ram()
    now = CLOCKS[clock]
    config = loading.load(
        [f"experiment={experiment}", f"precision={variant.precision}", f"device={device}"]
    )
    env = envs.make_vec(envs.split(config.environment.split).train[0], 1, **config.level_options)
    agent = build_agent(config, env)
    assert isinstance(agent, Impala)
    spaces = dict(env.single_observation_space.spaces)
    rows, num_envs = config.collector.unroll_length + 1, num_envs or config.collector.num_envs
    with FlopCounterMode(display=False) as counter:
        agent.update(unroll_of(agent, spaces, 3, 2, device))
    flops = counter.get_total_flops() / 8 * rows * num_envs  # of 4 rows of 2 envs
    see = agent.network.encoder.reader("image")
    if not variant.channels_last and isinstance(see, ResNet):
        see.layers.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
        see.layers.register_forward_pre_hook(lambda _, inputs: (inputs[0].contiguous(),))
    if variant.compiled:
        see.compile()

    unroll = unroll_of(agent, spaces, rows - 1, num_envs, device)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(3):  # until the heap has grown as large as it will be
        agent.update(unroll)
    spent = repeat(lambda: agent.update(unroll), seconds, now)
    held = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if device != "cpu":
        held = torch.cuda.max_memory_allocated()
    frames = (rows - 1) * num_envs
    return {
        "frames_per_second": frames / spent,
        "updates_per_second": 1 / spent,
        "of_peak": flops / spent / peak(variant.precision, device, now),
        "held": held,
        "parts": {
            name: 1e6 * repeat(part, seconds / 4, now) / frames
            for name, part in parts(agent, unroll, variant.precision).items()
        },
        "flops_per_frame": flops / frames,
    }


def measure_training(rounds: int, seconds: float, device: str) -> Iterator[tuple[str, Speeds]]:
    """Frames per second of training by `collector.lag`, a figure for each round."""
    keep_freed_ram()
    for experiment in TRAINED:
        speeds: Speeds = {0: [], 1: []}
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            runs = {}
            for lag in speeds:
                options = [f"collector.lag={lag}", f"device={device}", f"run_root={folder}"]
                config = loading.load([f"experiment={experiment}", f"name=lag{lag}", *options])
                run_folder.make(config.folder)
                runs[lag] = stack.enter_context(Run(config))
                for _ in range(3):  # until the heap has grown as large as it will be
                    runs[lag].step()
            for _ in range(rounds):
                for lag, run in runs.items():
                    start, before = time.perf_counter(), run.update
                    while time.perf_counter() - start < seconds:
                        run.step()
                    frames = (run.update - before) * run.frames_per_update
                    speeds[lag].append(frames / (time.perf_counter() - start))
        yield experiment, speeds


def repeat(work: Callable[[], object], seconds: float, now: Callable[[], float]) -> float:
    """Median seconds of the work, done at least once and for so long altogether."""
    spent: list[float] = []
    while sum(spent) < seconds:
        start = now()
        work()
        spent.append(now() - start)
    return statistics.median(spent)


def parts(agent: Impala, unroll: Unroll, precision: str) -> dict[str, Callable[[], object]]:
    """Forward and backward through the parts of the network, on their own."""
    inputs, network, device = Inputs.of(unroll.steps), agent.network, agent.device
    kind = torch.device(device).type

    def alone(part: Callable[[], torch.Tensor]) -> Callable[[], object]:
        def work() -> None:
            with torch.autocast(kind, torch.bfloat16, enabled=precision == "bfloat16"):
                outputs = part()
            outputs.backward(torch.ones_like(outputs))
            if kind == "cuda":
                torch.cuda.synchronize()

        return work

    seen = inputs.observation["image"].flatten(0, 1)
    features = network.encoder.size + network.actions + 1
    dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
    remembered = torch.randn(
        *inputs.is_first.shape, features, dtype=dtype, device=device, requires_grad=True
    )
    found = {
        "image": alone(lambda: network.encoder.reader("image")(seen)),
        "memory": alone(lambda: network.memory(remembered, inputs.is_first, unroll.memory)[0]),
    }
    if "instruction" in inputs.observation:
        read = network.encoder.reader("instruction")
        words = inputs.observation["instruction"].flatten(0, 1)
        found["instruction"] = alone(lambda: read(words))
    return found


def peak(precision: str, device: str, now: Callable[[], float]) -> float:
    """Operations per second in the product of two large matrices."""
    size = 2048 if device == "cpu" else 8192
    one, other = torch.randn(2, size, size, device=device, dtype=getattr(torch, precision))

    def work() -> None:
        one @ other
        if device != "cpu":
            torch.cuda.synchronize()

    work()
    return 2 * size**3 / repeat(work, 1.0, now)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each row in each round")
    parser.add_argument("--envs", type=int, help="of an unroll; otherwise as the experiment has")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--clock", choices=sorted(CLOCKS), default="wall")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--match", default="", help="rows whose description has this in it")
    parser.add_argument("--training", action="store_true", help="whole training, lag 1 against 0")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    device = find_device(arguments.device)
    if arguments.measure:
        experiment, variant = json.loads(arguments.measure)
        print(json.dumps(measure(
            experiment, Variant(**variant), arguments.envs, arguments.seconds, arguments.clock,
            device,
        )))  # fmt: skip
        return
    console = Console(width=160)
    where = torch.cuda.get_device_name() if device != "cpu" else f"{arguments.threads} threads"
    machine = f"{where}, PyTorch {torch.__version__}"
    if arguments.training:
        for experiment, speeds in measure_training(arguments.rounds, arguments.seconds, device):
            show_training(console, experiment, speeds)
        console.print(f"{machine}, seconds by the wall clock")
        return

    rows = [
        (experiment, variant)
        for experiment, title in EXPERIMENTS.items()
        for variant in variants(experiment, device)
        if arguments.match in f"{title}: {variant}"
    ]
    measured: dict[tuple[str, Variant], list[dict[str, Any]]] = defaultdict(list)
    for _ in range(arguments.rounds):
        for experiment, variant in rows:
            request = json.dumps([experiment, asdict(variant)])
            command = [sys.executable, __file__, *sys.argv[1:], "--measure", request]
            answer = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
            one = json.loads(answer.splitlines()[-1])
            measured[experiment, variant].append(one)
            speed = f"{one['frames_per_second']:,.0f} frames/s"
            print(f"{EXPERIMENTS[experiment]}: {variant}: {speed}", file=sys.stderr)
    for experiment in dict.fromkeys(experiment for experiment, _ in rows):
        show(console, experiment, {v: m for (e, v), m in measured.items() if e == experiment})
    console.print(f"{machine}, seconds by the {arguments.clock} clock")


def show_training(console: Console, experiment: str, speeds: Speeds) -> None:
    table = Table(title=f"training {experiment}", title_justify="left")
    for column in ("", "frames/s", "lowest..highest", "x lag 0", "by round"):
        table.add_column(column, justify="right", no_wrap=True)
    for lag, found in speeds.items():
        ratios = [speed / base for speed, base in zip(found, speeds[0], strict=True)]
        table.add_row(
            f"lag {lag}",
            f"{statistics.median(found):,.0f}",
            f"{min(found):,.0f}..{max(found):,.0f}",
            f"{statistics.median(ratios):.2f}",
            " ".join(f"{ratio:.2f}" for ratio in ratios),
        )
    console.print(table)


def show(console: Console, experiment: str, rows: dict[Variant, list[dict[str, Any]]]) -> None:
    def median(variant: Variant, name: str) -> float:
        return statistics.median(one[name] for one in rows[variant])

    first = next(iter(rows))
    flops = rows[first][0]["flops_per_frame"]
    title = f"{EXPERIMENTS[experiment]}: {flops / 1e6:,.0f} million operations a frame"
    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    names = list(rows[first][0]["parts"])
    columns = ("frames/s", "lowest..highest", "goal", "updates/s", "x plain", "of peak", "GB")
    for column in (*columns, *names, "rest"):
        table.add_column(column, justify="right", no_wrap=True)
    for variant, runs in rows.items():
        speeds = [one["frames_per_second"] for one in runs]
        speed = median(variant, "frames_per_second")
        goal = GOALS.get((experiment, variant))
        plain = speed / median(PLAIN, "frames_per_second") if PLAIN in rows else None
        spent = {part: statistics.median(one["parts"][part] for one in runs) for part in names}
        table.add_row(
            str(variant),
            f"{speed:,.0f}",
            f"{min(speeds):,.0f}..{max(speeds):,.0f}",
            f">={goal:,}" if goal else "",
            f"{median(variant, 'updates_per_second'):.2f}",
            f"{plain:.2f}" if plain else "",
            f"{median(variant, 'of_peak'):.0%}",
            f"{median(variant, 'held') / 1e9:.1f}",
            *(f"{spent[part]:.0f}" for part in names),
            f"{1e6 / speed - sum(spent.values()):.0f}",
        )
    console.print(table)


if __name__ == "__main__":
    main()
