"""`python -m zipf.evaluate run=<folder>`: scores a trained agent; `score` scores any policy."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from pydantic import Field
from rich.console import Console
from rich.table import Table

from zipf.agents.options import Options
from zipf.experiments import run_folder, runner
from zipf.experiments.config import Device, read_options
from zipf.experiments.errors import UserError
from zipf.experiments.evaluator import score
from zipf.experiments.logger import write_results

__all__ = ["main", "score"]

USAGE = """Scores the agent of a run's checkpoint on its train, uniform and rare levels.

    python -m zipf.evaluate run=runs/demo/impala_mlp/seed0

run=FOLDER      a run's folder (holds checkpoint.pt)
episodes=1000   episodes per level
num_envs=250    worlds played at a time
seed=0          of the worlds and the agent's actions
device=auto     auto, cpu, cuda or cuda:<number>

Writes evaluation-<update>-seed<seed>.csv, and beside it a file of every situation met, into the
run's folder."""


class EvaluateOptions(Options):
    """The command's options; `USAGE` says what they mean."""

    run: str
    episodes: Annotated[int, Field(ge=1)] = 1000
    num_envs: Annotated[int, Field(ge=1)] = 250
    seed: Annotated[int, Field(ge=0)] = 0
    device: Device = "auto"


def main() -> None:
    """The command."""
    arguments = sys.argv[1:]
    if not arguments or {"-h", "--help"} & set(arguments):
        print(USAGE)
        sys.exit(0 if arguments else 2)
    try:
        options = read_options(EvaluateOptions, arguments)
        folder = Path(options.run)
        update, results = runner.evaluate_run(
            folder, **{k: v for k, v in options.model_dump().items() if k != "run"}
        )
        files = write_results(folder / f"evaluation-{update}-seed{options.seed}", results)
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(2)
    chance = run_folder.read_description(folder)["chance"]
    table = Table("", *(result.kind for result in results), title=f"{folder} at update {update}")
    table.add_row("score", *(f"{result.score:.3f}" for result in results))
    table.add_row("chance", *(f"{chance[result.kind]:.3f}" for result in results))
    console = Console(highlight=False)
    console.print(table)
    for file in files:
        console.print(f"written: {file}", soft_wrap=True)


if __name__ == "__main__":
    main()
