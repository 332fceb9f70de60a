"""Trains for a few updates, once in one go and once killed in the middle, and compares the runs."""

import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

TRAIN = [
    *(sys.executable, "-m", "zipf.train", "--config-dir", "configs", "plugins=[minigrid_zipf]"),
    *("experiment=minigrid_zipf", "name=short", "updates=10", "schedule.window=[0,10]"),
    *("schedule.checkpoint_every=2", "schedule.log_every=1", "collector.num_envs=16"),
    *("evaluation.every=10", "evaluation.episodes=20", "evaluation.chance_episodes=50"),
]
RUN = "minigrid_zipf/short/seed0"


def results(root):
    """The losses and scores of a run, without how long they took."""
    metrics = pd.read_csv(Path(root, RUN, "metrics.csv"))
    metrics = metrics[~metrics["metric"].str.contains("frames_per_second|time_")]
    scores = pd.read_csv(Path(root, RUN, "evaluations.csv"))
    return [table.drop(columns="seconds").reset_index(drop=True) for table in (metrics, scores)]


def updates(metrics):
    """How many updates have been logged."""
    return pd.read_csv(metrics)["update"].nunique() if metrics.exists() else 0


subprocess.run([*TRAIN, "run_root=whole"], check=True)

killed = subprocess.Popen([*TRAIN, "run_root=runs"])
metrics = Path("runs", RUN, "metrics.csv")
while killed.poll() is None and updates(metrics) < 5:
    time.sleep(0.05)
killed.kill()  # as `kill -9` does
assert killed.wait() != 0, "the run ended before it could be killed"
print(f"killed after update {updates(metrics)}")
subprocess.run([*TRAIN, "run_root=runs", "resume=must"], check=True)

for whole, resumed in zip(results("whole"), results("runs"), strict=True):
    pd.testing.assert_frame_equal(whole, resumed)
print("the resumed run is equal to the one that was never stopped")
