"""Copies what the record needs of finished runs from `runs/` to `results/`.

    python scripts/keep_results.py runs/gridworld_compact/impala_mlp/seed0 ...
    make results

Checkpoints, TensorBoard's files and situations outside the window are not copied, and weights only
with `--weights`: some megabytes, which let others play the agent and begin with it. `run_root` is
left out of the options: it changes nothing and tells where somebody keeps their runs. A run
whose files are damaged is refused.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from pathlib import Path

import pandas as pd

from zipf.errors import TOLD, UserError, tell
from zipf.experiments.records.results import load_run

RESULTS = Path(__file__).parent.parent / "results"


def keep(run: Path, *, weights: bool = False) -> Path:
    """Copies one run, with its weights if asked to; returns the folder of the copy.

    Raises:
        UserError: it is no run, is damaged, or has no weights.
    """
    if notes := load_run(run).notes:
        raise UserError(f"{run}: {notes[0]}")
    if weights and not (run / "weights.pt").is_file():
        raise UserError(f"{run}: has no weights.pt")
    description = json.loads((run / "run.json").read_text())
    target = RESULTS / description["experiment"] / description["condition"]
    target /= f"seed{description['seed']}"
    target.mkdir(parents=True, exist_ok=True)
    shutil.copy(run / "evaluations.csv", target / "evaluations.csv")
    situations = pd.read_csv(run / "situations.csv")
    if description["external"]:  # no options, no metrics, and scored at its last evaluation
        start = end = situations["update"].max()
    else:
        shutil.copy(run / "metrics.csv", target / "metrics.csv")
        options = (run / "config.yaml").read_text()
        (target / "config.yaml").write_text(re.sub("(?m)^run_root: .*", "run_root: runs", options))
        for start_of in (description, *description["resumed"]):
            words = start_of["command"].split()
            start_of["command"] = " ".join(w for w in words if not w.startswith("run_root="))
        start, end = description["window"]
    (target / "run.json").write_text(json.dumps(description, indent=2) + "\n")
    inside = situations[situations["update"].between(start, end)]
    inside.to_csv(target / "situations.csv", index=False)
    if weights:
        shutil.copy(run / "weights.pt", target / "weights.pt")
    return target


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders")
    parser.add_argument("--weights", action="store_true", help="copy the agents' weights, too")
    arguments = parser.parse_args()
    for run in arguments.runs:
        try:
            print(f"{run} -> {keep(run, weights=arguments.weights)}")
        except TOLD as error:
            tell(error)
            sys.exit(2)


if __name__ == "__main__":
    main()
