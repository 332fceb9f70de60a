"""Frames learned from per second on this machine's device, and the time to a run's first update.

    python scripts/benchmark_device.py
    python scripts/benchmark_device.py --match gridworld --seconds 10
    python scripts/benchmark_device.py --against <another checkout>

Every row trains, and so does its reference right after it: the same with environments on the host
and every kernel launched by itself (`collector.envs=host capture=false`), or with `--against`
another checkout as it is. A row's ratio is its speed to that of its reference. One process trains
all rows, and another all references. A row of more environments than an update takes has no
reference of its own in an older checkout, which has no such option: there it is the same experiment
with the environments of one update.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
MANY = "collector.num_envs=4096 collector.envs_per_update=256"
ROWS = {
    "gridworld_compact, MLP, count": "experiment=gridworld_compact condition=impala_mlp",
    "the same, 4,096 envs": f"experiment=gridworld_compact condition=impala_mlp {MANY}",
    "the same, LSTM": f"experiment=gridworld_compact condition=impala memory=lstm {MANY}",
    "the same, comparing, symmetries, hindsight": (
        "experiment=gridworld_compact condition=impala_comparing_augmented hindsight=achieved "
        f"memory=lstm {MANY}"
    ),
    "the same, GTrXL": f"experiment=gridworld_compact condition=impala memory=gtrxl {MANY}",
    "V-MPO, LSTM": "experiment=gridworld_compact condition=vmpo memory=lstm",
    "R2D2, LSTM": "experiment=gridworld_compact condition=r2d2 memory=lstm",
    "gridworld, ResNet, LSTM": "experiment=gridworld condition=impala",
    "the same, 1,024 envs": (
        "experiment=gridworld condition=impala collector.num_envs=1024 collector.envs_per_update=32"
    ),
    "playroom_lift_compact": "experiment=playroom_lift_compact condition=impala",
    "labyrinth_compact": "experiment=labyrinth_compact condition=impala",
    "playroom_lift": "experiment=playroom_lift condition=impala",
}
LAUNCHED = ("collector.envs=host", "capture=false")
MEASURED = "--measured"  # what a process is started with, and begins its lines with
NEW = ("collector.envs", "capture=")  # options that older checkouts lack


def serve() -> None:
    """A process of rows: trains what each line of its input asks for, and prints what it
    measured."""
    began = time.perf_counter()
    import torch

    try:
        from zipf.experiments.building import run_folder
        from zipf.experiments.building.loading import load
        from zipf.experiments.training import allocator, runner
    except ImportError:  # version 0.1
        from zipf.experiments.command_line import load
        from zipf.experiments.running import allocator, run_folder, runner

    allocator.keep_freed_ram()
    if torch.cuda.is_available():
        torch.zeros((), device="cuda")
    print(MEASURED, json.dumps({"started": time.perf_counter() - began}), flush=True)

    def measure(seconds: float, overrides: list[str]) -> dict[str, float | str]:
        began = time.perf_counter()
        config = load(overrides)
        run_folder.make(config.folder)
        parts = getattr(config, "updates_per_unroll", 1)

        def wait() -> None:
            if config.torch_device.startswith("cuda"):
                torch.cuda.synchronize()

        with runner.Run(config) as run:
            run.step()
            wait()
            first = time.perf_counter() - began
            for _ in range(parts - 1):
                run.step()
            settled = time.perf_counter() + seconds / 4
            while time.perf_counter() < settled:
                for _ in range(parts):
                    run.step()
            wait()
            start, updates = time.perf_counter(), run.update
            while time.perf_counter() - start < seconds:
                for _ in range(parts):
                    run.step()
                wait()
            frames = (run.update - updates) * run.frames_per_update
            speed = frames / (time.perf_counter() - start)
            return {"speed": speed, "first": first, "device": str(run.device)}

    for line in sys.stdin:
        try:
            found = measure(*json.loads(line))
        except BaseException as error:  # the other rows are measured all the same
            found = {"error": f"{type(error).__name__}: {error}"[:160]}
        print(MEASURED, json.dumps(found), flush=True)


class Trainer:
    """A process of a checkout that trains one row after another.

    Attributes:
        started: seconds until it had imported zipf and started the device.
    """

    def __init__(self, checkout: Path):
        self._process = subprocess.Popen(
            [sys.executable, __file__, MEASURED],
            env=os.environ | {"PYTHONPATH": f"{checkout}:{os.environ.get('PYTHONPATH', '')}"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.started = float(self._answer()["started"])

    def measure(self, overrides: list[str], seconds: float) -> dict[str, float | str]:
        """What a row measures; its error in the place of numbers if it fails."""
        with tempfile.TemporaryDirectory() as folder:
            given = [*overrides, f"run_root={folder}", "name=measured", "updates=1024000000"]
            given += ["schedule.checkpoint_every=1024000", "evaluation.every=1024000"]
            assert self._process.stdin is not None
            print(json.dumps([seconds, given]), file=self._process.stdin, flush=True)
            return self._answer()

    def _answer(self) -> dict[str, float | str]:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(MEASURED):
                return json.loads(line.removeprefix(MEASURED))
        raise SystemExit(f"a process of rows ended with {self._process.wait()}")


def older(overrides: list[str]) -> list[str]:
    """The same experiment, as a checkout without the options of this one has it."""
    per_update = [one for one in overrides if one.startswith("collector.envs_per_update=")]
    kept = [one for one in overrides if not one.startswith(NEW)]
    if per_update:
        kept = [one for one in kept if not one.startswith("collector.num_envs=")]
        kept.append(f"collector.num_envs={per_update[0].partition('=')[2]}")
    return kept


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0, help="of each row")
    parser.add_argument("--match", default="", help="rows whose name has this in it")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--against", type=Path, help="another checkout, the reference of all rows")
    given = parser.parse_args()
    rows, others = Trainer(ROOT), Trainer(given.against.resolve() if given.against else ROOT)
    print("| row | frames/s | reference | ratio | first update |\n| :-- | --: | --: | --: | --: |")
    where = ""
    for name, options in ROWS.items():
        if given.match not in name:
            continue
        overrides = [*options.split(), f"device={given.device}", "precision=auto"]
        row = rows.measure(overrides, given.seconds)
        referred = older(overrides) if given.against else [*overrides, *LAUNCHED]
        other = others.measure(referred, given.seconds)
        shown = [one.get("error") or f"{one['speed']:,.0f}" for one in (row, other)]
        ratio, first = "-", "-"
        if "error" not in row:
            where, first = str(row["device"]), f"{row['first']:.1f} s"
            if "error" not in other:
                ratio = f"{float(row['speed']) / float(other['speed']):.2f}"
        print(f"| {name} | {shown[0]} | {shown[1]} | {ratio} | {first} |", flush=True)
    print(f"\nOn {where}, {os.cpu_count()} CPU cores. Before the first row {rows.started:.1f} s")
    print("went into imports and starting the device.")


if __name__ == "__main__":
    if sys.argv[1:2] == [MEASURED]:
        serve()
    else:
        main()
