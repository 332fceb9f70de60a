"""Copies what the record needs of finished runs from `runs/` to `results/`.

    python scripts/keep_results.py runs/gridworld_compact/impala_mlp/seed0 ...
    make results

Checkpoints, TensorBoard's files and the situations met outside the experiment's window stay behind,
and so does `run_root`, which changes nothing and says where somebody keeps their runs.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
from pathlib import Path

import pandas as pd

RESULTS = Path(__file__).parent.parent / "results"


def keep(run: Path) -> Path:
    """Copies one run; returns where to."""
    description = json.loads((run / "run.json").read_text())
    target = RESULTS / description["experiment"] / description["condition"]
    target /= f"seed{description['seed']}"
    target.mkdir(parents=True, exist_ok=True)
    for name in ("evaluations.csv", "metrics.csv"):
        shutil.copy(run / name, target / name)
    options = (run / "config.yaml").read_text()
    (target / "config.yaml").write_text(re.sub("(?m)^run_root: .*", "run_root: runs", options))
    for start_of in (description, *description.get("resumed", [])):
        words = start_of["command"].split()
        start_of["command"] = " ".join(w for w in words if not w.startswith("run_root="))
    (target / "run.json").write_text(json.dumps(description, indent=2) + "\n")
    start, end = description["window"]
    situations = pd.read_csv(run / "situations.csv")
    situations = situations[situations["update"].between(start, end)]
    situations.to_csv(target / "situations.csv", index=False)
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders")
    for run in parser.parse_args().runs:
        print(f"{run} -> {keep(run)}")


if __name__ == "__main__":
    main()
