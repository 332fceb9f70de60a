"""Takes what the record needs of finished runs from `runs/` into `results/`.

    python scripts/keep_results.py runs/gridworld_compact/impala_mlp/seed0 ...
    make results

Rows are added to the tables of the record (`zipf.experiments.records.record`), in the place of
those that the same run may have there, and `results/scores.csv` is written anew: the score of every
run on every kind of level, the median of the evaluations in its window. Checkpoints, TensorBoard's
files and situations outside the window are not taken. With `--weights` the run's folder in
`results/` has its weights, in bfloat16, options and description as well: some megabytes, which let
others play the agent and begin with it. `run_root` is left out of the options: it changes nothing
and tells where somebody keeps their runs. A run is refused whose files are damaged, or that has not
reached its window.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path

import pandas as pd
import yaml

from zipf.errors import EXPECTED, UserError, tell
from zipf.experiments.building import checkpoint
from zipf.experiments.records import record
from zipf.experiments.records.csv_files import read_texts
from zipf.experiments.records.record import Record
from zipf.experiments.records.result_table import TABLES
from zipf.experiments.records.results import Run, load_record, load_run
from zipf.experiments.reporting.scores import means_inside
from zipf.experiments.reporting.windows import OwnWindows, evaluations_inside
from zipf.protocol import KINDS

RESULTS = Path(__file__).parent.parent / "results"


def keep(kept: Record, folder: Path, *, weights: bool = False) -> str:
    """Adds one run to a record, and its weights to `results/` if asked to; returns its name there.

    Raises:
        UserError: it is no run, is damaged, has not reached its window, or has no weights; or those
            of an earlier training would stay beside it.
    """
    run = load_run(folder)
    if run.notes:
        raise UserError(f"{folder}: {run.notes[0]}")
    inside = evaluations_inside(run, OwnWindows())["update"]
    if not len(inside):
        raise UserError(f"{folder}: has no evaluation in its window yet; let it go on first")
    if weights and not (folder / "weights.pt").is_file():
        raise UserError(f"{folder}: has no weights.pt")
    description = json.loads((folder / "run.json").read_text("utf-8"))
    name = f"{description['experiment']}/{description['condition']}/seed{description['seed']}"
    other = kept.runs.get(name)
    if other is not None and bool(other.get("external")) != bool(description.get("external")):
        raise UserError(f"{name}: is of an agent of ours in one run and of others in the other")
    if not weights and (RESULTS / name / "weights.pt").exists():
        raise UserError(
            f"{RESULTS / name}: has the weights of an earlier training; give --weights, or remove "
            "the folder"
        )
    for start in (description, *description.get("resumed", [])):
        if words := shlex.split(start.get("command") or ""):
            start["command"] = shlex.join(w for w in words if not w.startswith("run_root="))
    tables = {file: read_texts(folder / file, []) for file in TABLES}
    situations = tables["situations.csv"]
    if len(situations.columns):
        tables["situations.csv"] = situations[situations["update"].astype(int).isin(inside)]
    kept.runs[name], kept.tables[name] = description, tables
    if run.options:
        kept.options[name] = {**run.options, "run_root": "runs"}
    if weights:
        target = RESULTS / name
        target.mkdir(parents=True, exist_ok=True)
        learned = checkpoint.load(folder / "weights.pt")
        for place, values in learned["weights"].items():
            if values.is_floating_point():
                learned["weights"][place] = values.bfloat16()
        checkpoint.save(target / "weights.pt", learned)
        (target / "run.json").write_text(json.dumps(description, indent=2) + "\n", "utf-8")
        options = yaml.safe_dump(kept.options[name], sort_keys=False)
        (target / "config.yaml").write_text(options, "utf-8")
    return name


def scores(runs: list[Run], folder: Path) -> pd.DataFrame:
    """A row for each run and kind of level: its score, and what that rests on."""
    rows = []
    for run in sorted(runs, key=lambda one: one.folder.as_posix()):
        for kind in KINDS:
            means = means_inside(run, run.description.levels_of(kind), OwnWindows())
            if len(means):
                rows.append(
                    {
                        "run": run.folder.relative_to(folder).as_posix(),
                        "level_kind": kind,
                        "score": means["score"].median(),
                        "evaluations": len(means),
                        "episodes": means["episodes"].min(),
                        "update": means["update"].max(),
                        "frames": means["frames"].max(),
                    }
                )
    return pd.DataFrame(rows)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders")
    parser.add_argument("--weights", action="store_true", help="take the agents' weights, too")
    arguments = parser.parse_args()
    try:
        kept = record.read(RESULTS)
        for run in arguments.runs:
            print(f"{run} -> {keep(kept, run, weights=arguments.weights)}")
        record.write(RESULTS, kept)
        scores(load_record(RESULTS), RESULTS).to_csv(RESULTS / "scores.csv", index=False)
    except EXPECTED as error:
        tell(error)
        sys.exit(2)


if __name__ == "__main__":
    main()
