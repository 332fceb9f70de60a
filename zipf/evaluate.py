"""`python -m zipf.evaluate run=<folder>`: scores an agent or a script; `score` any policy."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zipf.errors import UserError
from zipf.lazy import lazily
from zipf.output import console, is_quiet, run_command

if TYPE_CHECKING:
    from zipf.experiments.evaluation.evaluator import Policy, Result, Watch
    from zipf.experiments.evaluation.external import record
    from zipf.experiments.evaluation.scoring import Evaluation, env_options, score
    from zipf.experiments.options.schema import EvaluateOptions
else:  # imported when first asked for: `--help` is to be quick
    __getattr__, __dir__ = lazily(
        __name__,
        {
            "Evaluation": "zipf.experiments.evaluation.scoring",
            "Policy": "zipf.experiments.evaluation.evaluator",
            "env_options": "zipf.experiments.evaluation.scoring",
            "record": "zipf.experiments.evaluation.external",
            "score": "zipf.experiments.evaluation.scoring",
        },
    )

__all__ = ["Evaluation", "Policy", "env_options", "main", "record", "score"]

USAGE = """usage: python -m zipf.evaluate run=FOLDER [option=value ...]
       python -m zipf.evaluate policy=NAME split=NAME [option=value ...]

Plays the agent of a run's last checkpoint, or a scripted policy, on the levels of each kind that a
split has (train, uniform, rare, and some validation and fresh), and prints its scores beside those
of chance and other baselines.

Examples:

    python -m zipf.evaluate run=runs/demo/impala_mlp/seed0
    python -m zipf.evaluate run=runs/demo/impala_mlp/seed0 episodes=10000 seed=1
    python -m zipf.evaluate policy=generalist split=gridworld

Options:

    run=FOLDER      a run's folder with a checkpoint or, without one, weights
    policy=NAME     in the place of a run, a scripted policy of the split's family: expert, which
                    reads the state of the envs, or generalist, which knows what has been in view
    split=NAME      with policy=, whose levels to play, for instance gridworld or playroom_lift
    episodes=N      episodes of each level; default: as many as the split says: 1000, in the
                    labyrinth's splits 100 of each task
    num_envs=N      envs played at a time; default: 250
    seed=N          of the envs and the agent's actions; default: 0
    device=NAME     with run=: auto, cpu, cuda or cuda:<number>; default: auto, CUDA if there is one
    plugins=NAMES   modules to import, for envs and agents from outside the package; default: none
    --quiet, -q     print neither progress nor tables

The scores of a run are also written to its folder, as evaluation-<update>-seed<seed>.csv (with
-episodes<N> after the update where episodes= is given), and the situations to a file beside it."""


def main() -> None:
    """The command."""
    if code := run_command(USAGE, _evaluate):
        sys.exit(code)


def _evaluate(arguments: list[str]) -> None:
    # Here, because `score` needs none of these: they import PyTorch.
    from zipf.experiments.building import run_folder
    from zipf.experiments.evaluation.trained import evaluate_run
    from zipf.experiments.options.command_line import read_options
    from zipf.experiments.options.schema import EvaluateOptions, module_names
    from zipf.experiments.training.tables import write_results

    options = read_options(EvaluateOptions, arguments)
    if options.run is None or options.policy or options.split:
        _evaluate_script(options)
        return
    folder = Path(options.run).expanduser()
    description = run_folder.read_description(folder)
    with _progress() as watch:
        update, results = evaluate_run(options, watch)
    chosen = f"-episodes{options.episodes}" if options.episodes else ""
    name = f"evaluation-{update}{chosen}-seed{options.seed}"
    config = run_folder.read_config(folder, module_names(options.plugins))
    levels = run_folder.with_further_kinds(
        description["levels"], config.split, config.level_options
    )
    _show(f"{folder} at update {update}", results, levels)
    for file in write_results(folder / name, results):
        console().print(f"written: {file}", soft_wrap=True, markup=False)


def _evaluate_script(options: EvaluateOptions) -> None:
    """Scores the policy of `policy=`. Raises UserError for options that do not go together."""
    from zipf import envs
    from zipf.experiments.building import run_folder
    from zipf.experiments.evaluation.trained import evaluate_scripted
    from zipf.experiments.options import composing
    from zipf.experiments.options.schema import module_names

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
    with _progress() as watch:
        results = evaluate_scripted(options, split, watch)
    _show(f"policy={options.policy}", results, run_folder.describe_levels(split, {}))


@contextmanager
def _progress() -> Iterator[Watch]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    shown = console().is_terminal and not is_quiet()
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("episodes")
    with Progress(*columns, transient=True, disable=not shown) as progress:
        task = progress.add_task("", total=None)
        yield lambda ended, episodes: progress.update(task, completed=ended, total=episodes)


def _show(title: str, results: list[Result], levels: list[dict[str, Any]]) -> None:
    """Prints scores by kind, and by level where there are more, beside those of baselines."""
    from rich.table import Column, Table

    from zipf import envs
    from zipf.experiments.building import run_folder
    from zipf.experiments.evaluation.evaluator import scores

    by_kind = scores(results)
    table = Table("", *by_kind)
    table.add_row("score", *(f"{value:.3f}" for value in by_kind.values()))
    for baseline in envs.BASELINES:
        means = [run_folder.mean_of_levels(levels, kind, baseline.name) for kind in by_kind]
        if baseline.name == "chance" or any(mean is not None for mean in means):
            table.add_row(baseline.name, *map(_figure, means))
    shown = console()
    shown.print(title, soft_wrap=True, markup=False)
    shown.print(table)
    if len(results) > len(by_kind):
        described = {level["level"]: level for level in levels}
        of_any = {name for level in levels for name in level["references"]}
        names = [one.name for one in envs.BASELINES if one.name in of_any]
        each = Table(Column("level", overflow="fold"), "score", *names)
        for result in {result.level: result for result in results}.values():
            known = described[result.level]["references"]
            scores_of = (known[name]["score"] if name in known else None for name in names)
            each.add_row(result.level, f"{result.score:.3f}", *map(_figure, scores_of))
        shown.print(each)


def _figure(score: float | None) -> str:
    return "unknown" if score is None else f"{score:.3f}"


if __name__ == "__main__":
    main()
