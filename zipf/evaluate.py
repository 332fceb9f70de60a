"""`python -m zipf.evaluate run=<folder>`: scores a trained agent; `score` scores any policy."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zipf.experiments.errors import UserError
from zipf.experiments.output import keep_going
from zipf.experiments.running.external import record
from zipf.experiments.running.scoring import Evaluation, geometry, score

if TYPE_CHECKING:
    from zipf.experiments.config import EvaluateOptions
    from zipf.experiments.running.evaluator import Result

__all__ = ["Evaluation", "geometry", "main", "record", "score"]

USAGE = """Scores the agent of a run's checkpoint, or a script, on train, uniform and rare levels.

    python -m zipf.evaluate run=runs/demo/impala_mlp/seed0
    python -m zipf.evaluate policy=generalist split=gridworld

run=FOLDER      a run's folder with a checkpoint
policy=NAME     in the place of a run, a scripted player of the split's family: expert, which reads
                the state of the worlds, or generalist, which knows what has been in view
split=NAME      with policy=, whose levels to play
episodes=N      episodes per level; default: those of the split (1000 in the paper's splits)
num_envs=250    worlds played at a time
seed=0          of the worlds and the agent's actions
device=auto     auto, cpu, cuda or cuda:<number>; with run=
plugins=NAMES   modules to import, for worlds and agents from outside the package

Writes the scores of a run to evaluation-<update>-episodes<N>-seed<seed>.csv in its folder (without
-episodes<N> for the default), and the situations to a second file beside it."""


def main() -> None:
    """The command."""
    keep_going()
    arguments = sys.argv[1:]
    if not arguments or {"-h", "--help"} & set(arguments):
        print(USAGE)
        sys.exit(0 if arguments else 2)
    try:
        _evaluate(arguments)
    except KeyboardInterrupt:
        sys.exit(130)
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(2)


def _evaluate(arguments: list[str]) -> None:
    # Here, because `score` needs none of these: they import PyTorch and TensorBoard.
    from rich.console import Console

    from zipf.experiments.command_line import read_options
    from zipf.experiments.config import EvaluateOptions
    from zipf.experiments.running import run_folder
    from zipf.experiments.running.logger import write_results
    from zipf.experiments.running.trained import evaluate_run

    options = read_options(EvaluateOptions, arguments)
    if options.run is None or options.policy or options.split:
        _evaluate_script(options)
        return
    folder = Path(options.run)
    description = run_folder.read_description(folder)
    update, results = evaluate_run(options)
    chosen = f"-episodes{options.episodes}" if options.episodes else ""
    name = f"evaluation-{update}{chosen}-seed{options.seed}"
    files = write_results(folder / name, results)
    _show(f"{folder} at update {update}", results, description["levels"])
    for file in files:
        Console(highlight=False).print(f"written: {file}", soft_wrap=True)


def _evaluate_script(options: EvaluateOptions) -> None:
    """Scores the player of `policy=`. Raises UserError for options that do not go together."""
    from zipf import envs
    from zipf.experiments import composing
    from zipf.experiments.config import module_names
    from zipf.experiments.running import run_folder
    from zipf.experiments.running.trained import evaluate_scripted

    scripts = " or ".join(f"policy={name}" for name in envs.SCRIPTED)
    if options.policy is None or options.split is None:
        raise UserError(f"choose run=<a run's folder>, or {scripts} with split=<a split's name>")
    for name in ("run", "device"):
        if name in options.model_fields_set:
            raise UserError(f"{name}={getattr(options, name)}: does not go with policy=")
    composing.load_plugins(module_names(options.plugins))
    try:
        split = envs.split(options.split)
    except ValueError as error:
        raise UserError(f"split={options.split}: {error}") from None
    results = evaluate_scripted(options, split)
    _show(f"policy={options.policy}", results, run_folder.describe_levels(split, {}))


def _show(title: str, results: list[Result], levels: list[dict[str, Any]]) -> None:
    """Prints scores by kind, and by level where there are more, beside those of references."""
    from rich.console import Console
    from rich.table import Table

    from zipf.experiments.running import run_folder
    from zipf.experiments.running.evaluator import scores

    by_kind = scores(results)
    table = Table("", *by_kind)
    table.add_row("score", *(f"{value:.3f}" for value in by_kind.values()))
    for name in run_folder.REFERENCES:
        means = [run_folder.mean_of_levels(levels, kind, name) for kind in by_kind]
        if name == "chance" or any(mean is not None for mean in means):
            table.add_row(name, *map(_figure, means))
    console = Console(highlight=False)
    console.print(title, soft_wrap=True)
    console.print(table)
    if len(results) > len(by_kind):
        described = {level["level"]: level for level in levels}
        each = Table("level", "score", *run_folder.REFERENCES)
        for result in results:
            known = (described[result.level].get(name) for name in run_folder.REFERENCES)
            each.add_row(result.level, f"{result.score:.3f}", *map(_figure, known))
        console.print(each)


def _figure(score: float | None) -> str:
    return "unknown" if score is None else f"{score:.3f}"


if __name__ == "__main__":
    main()
