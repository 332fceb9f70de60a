"""Frames learned from per second on this machine's device, and the time to the first update.

    python scripts/benchmark_device.py
    python scripts/benchmark_device.py --match gridworld --seconds 10
    python scripts/benchmark_device.py --against <another checkout>

Every row is a process that trains; its reference is another that trains the same right after it:
with environments on the host and every kernel launched by itself (`collector.envs=host
capture=false`), or with `--against` another checkout as it is. A row's ratio is its speed to that
of its reference. A row of more environments than an update takes has no reference of its own in an
older checkout, which has no such option: there it is the same experiment with the environments of
one update.
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
MEASURED = "--measured"  # what a row's process is started with, and begins its line with
NEW = ("collector.envs", "capture=")  # options that older checkouts lack


def train(seconds: float, overrides: list[str]) -> None:
    """In a row's process: trains, and prints what it measured. Of zipf it uses what older checkouts
    have, too."""
    began = time.perf_counter()
    from zipf.experiments.building import loading, run_folder
    from zipf.experiments.training.allocator import keep_freed_ram
    from zipf.experiments.training.runner import Run

    keep_freed_ram()
    config = loading.load(overrides)
    run_folder.make(config.folder)
    parts = getattr(config, "updates_per_unroll", 1)

    def wait() -> None:
        if config.torch_device.startswith("cuda"):
            import torch

            torch.cuda.synchronize()

    with Run(config) as run:
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
        device = str(run.device)
    print(MEASURED, json.dumps({"speed": speed, "first": first, "device": device}), flush=True)


def measure(checkout: Path, overrides: list[str], seconds: float) -> dict[str, float | str]:
    """What a process of a checkout measures; its error in the place of numbers if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        given = [*overrides, f"run_root={folder}", "name=measured", "updates=1000000000"]
        given += ["schedule.checkpoint_every=1000000", "evaluation.every=1000000"]
        if "envs_per_update" in " ".join(overrides):  # multiples of the updates of an unroll
            given[-3:] = ["updates=1024000000", "schedule.checkpoint_every=1024000"]
            given += ["evaluation.every=1024000"]
        finished = subprocess.run(
            [sys.executable, __file__, MEASURED, str(seconds), *given],
            env=os.environ | {"PYTHONPATH": str(checkout)},
            capture_output=True,
            text=True,
            check=False,
        )
    for line in finished.stdout.splitlines():
        if line.startswith(MEASURED):
            return json.loads(line.removeprefix(MEASURED))
    errors = finished.stderr.strip().splitlines()
    return {"error": errors[-1][:160] if errors else f"ended with {finished.returncode}"}


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
    print("| row | frames/s | reference | ratio | first update |\n| :-- | --: | --: | --: | --: |")
    where = ""
    for name, options in ROWS.items():
        if given.match not in name:
            continue
        overrides = [*options.split(), f"device={given.device}", "precision=auto"]
        row = measure(ROOT, overrides, given.seconds)
        if given.against:
            other = measure(given.against.resolve(), older(overrides), given.seconds)
        else:
            other = measure(ROOT, [*overrides, *LAUNCHED], given.seconds)
        shown = [one.get("error") or f"{one['speed']:,.0f}" for one in (row, other)]
        ratio, first = "-", "-"
        if "error" not in row:
            where, first = str(row["device"]), f"{row['first']:.1f} s"
            if "error" not in other:
                ratio = f"{float(row['speed']) / float(other['speed']):.2f}"
        print(f"| {name} | {shown[0]} | {shown[1]} | {ratio} | {first} |", flush=True)
    print(f"\nOn {where}, {os.cpu_count()} CPU cores.")


if __name__ == "__main__":
    if sys.argv[1:2] == [MEASURED]:
        train(float(sys.argv[2]), sys.argv[3:])
    else:
        main()
