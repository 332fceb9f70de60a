"""The tables of the record's numbers, from the runs in results/."""

import re
from collections.abc import Sequence
from functools import cache
from math import isnan, nan
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import yaml
from tables import code, markdown

from zipf import envs
from zipf.experiments.building.run_folder import describe_levels, mean_of_levels
from zipf.experiments.options import catalogue, composing
from zipf.experiments.records.paper import paper_table
from zipf.experiments.records.results import Run, load_runs
from zipf.experiments.records.wording import KIND_NAMES, NONE, count_text, range_text, score_text
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.seed_statistics import (
    bootstrap_of_situations,
    success_by_situation,
)
from zipf.experiments.reporting.statistics import FEWEST_SEEDS
from zipf.experiments.reporting.tables import ScoreTable, score_tables
from zipf.experiments.reporting.windows import OwnWindows, Window, evaluations_inside
from zipf.protocol import BASELINES, PAPER_KINDS

RESULTS = Path(__file__).parent.parent / "results"
UNTUNED = ("ppo", "r2d2", "r2d2_uniform_replay", "vmpo")
"""Conditions whose values in `gridworld_compact` were not tuned; those of the others were."""
COLUMNS = ("train", "validation", "uniform", "rare", "fresh")
"""Kinds of levels in the order of the columns: what is chosen by, then what is reported."""


class Agent(NamedTuple):
    """A row; `results/numbers.yaml` has its fields."""

    title: str
    beyond: str
    folder: str
    command: str
    readme: str | None = None
    situations: bool = False


class Task(NamedTuple):
    """A task: its title, the paper's experiment, and the rows of the record to show."""

    title: str
    paper: str
    agents: tuple[Agent, ...]


def _tasks() -> dict[str, Task]:
    tasks = yaml.safe_load((RESULTS / "numbers.yaml").read_text("utf-8"))
    return {
        name: Task(task["title"], task["paper"], tuple(Agent(**row) for row in task["agents"]))
        for name, task in tasks.items()
    }


TASKS = _tasks()


def numbers(name: str) -> list[str]:
    """The lines of a task's table, then the commands of its rows."""
    task = TASKS[name]
    split = composing.composed(f"experiment={task.paper}").values["environment"]["split"]
    kinds = [kind for kind in COLUMNS if envs.split(split).levels(kind)]
    rows = [_published(task, kinds, hours=True)]
    levels = _levels(task.agents[0].folder)
    for one in BASELINES:
        rows.append((one.title, "", "", "", "", *_known(levels, one.name, kinds)))
    rows += [_shown(agent, agent.title, kinds, hours=True) for agent in task.agents]
    counts = ("Seeds", "Frames", "Hours", *(KIND_NAMES[kind] for kind in kinds))
    table = markdown(("Agent", "Beyond pixels and rewards", *counts), rows, right=counts)
    trained: dict[str, list[str]] = {}  # titles by their command
    for agent in task.agents:
        trained.setdefault(agent.command, []).append(agent.title.replace("`", ""))
    commands = [
        line
        for command, titles in trained.items()
        for line in (*(f"# {title}" for title in titles), f"python -m zipf.train {command}")
    ]
    lines = [*table, "", "```sh", *commands, "```"]
    weights = [line for agent in task.agents for line in _weights(agent)]
    return [*lines, "", "Weights:", "", *weights] if weights else lines


def alone(experiment: str) -> list[str]:
    """The lines of a table of an experiment's runs that have one level: a row for each level and
    condition, with baselines beside the score in the window."""
    rows = []
    for folder in {str(run.folder.parent.relative_to(RESULTS)) for run in _runs(experiment)}:
        levels = _levels(folder)
        if len(levels) > 1:
            continue
        table, row = _row(folder)
        (score,) = table.scores[table.scores["row"] == row.key].to_dict("records")
        spent = (
            str(int(score["seeds"])),
            f"{score['frames'] / 1e6:,.1f} M",
            _spent(row, table.window),
        )
        known = (_known(levels, one.name, ["train"])[0] for one in BASELINES)
        name = code(levels[0]["level"].rpartition("/")[2])
        agent = row.title.replace(f", environment.split={table.description.split}", "")
        rows.append((name, agent, *spent, *known, score_text(score["score"])))
    counts = ("Seeds", "Frames", "Hours", *(one.title for one in BASELINES), "Score")
    return markdown(("Task", "Agent", *counts), sorted(rows), right=counts)


def _weights(agent: Agent) -> list[str]:
    """A line for each of its runs whose weights come with the repository."""
    return [
        f"- {agent.title}, seed {path.parent.name.removeprefix('seed')}: "
        f'`zipf.load_agent("{path.parent.relative_to(RESULTS.parent)}")`'
        for path in sorted((RESULTS / agent.folder).glob("seed*/weights.pt"))
    ]


def best() -> list[str]:
    """The lines of README's table: rows with a title for it, and no baseline but blind."""
    rows: list[tuple[str, ...]] = []
    for task in TASKS.values():
        shown = [agent for agent in task.agents if agent.readme]
        if not shown:
            continue
        levels = _levels(shown[0].folder)
        rows.append((task.title, *_published(task, PAPER_KINDS)))
        rows.append(("", "Blind", "", "", "", *_known(levels, "blind", PAPER_KINDS)))
        rows += [("", *_shown(agent, str(agent.readme), PAPER_KINDS)) for agent in shown]
    counts = ("Seeds", "Frames", *(KIND_NAMES[kind] for kind in PAPER_KINDS))
    return markdown(("Task", "Agent", "Beyond pixels and rewards", *counts), rows, right=counts)


def _known(levels: list[dict[str, Any]], baseline: str, kinds: Sequence[str]) -> list[str]:
    means = (mean_of_levels(levels, kind, baseline) for kind in kinds)
    return [NONE if mean is None else score_text(mean) for mean in means]


def _published(task: Task, kinds: Sequence[str], *, hours: bool = False) -> tuple[str, ...]:
    """The best score of any of the paper's agents in each column."""
    values = composing.composed(f"experiment={task.paper}").values
    collector = values["collector"]
    frames = values["updates"] * collector["num_envs"] * collector["unroll_length"]
    split = envs.split(values["environment"]["split"])
    published = paper_table(str(split.paper)).rows.values()
    scores = [[row[kind].value for row in published if kind in row] for kind in kinds]
    texts = [score_text(max(each)) if each else "" for each in scores]
    spent = [""] if hours else []
    return ("the paper's best", "", "3", count_text(frames), *spent, *texts)


def _shown(
    agent: Agent, title: str, kinds: Sequence[str], *, hours: bool = False
) -> tuple[str, ...]:
    """Frames and hours are those of the runs that an agent began with, too; a dash where the record
    has not all of these."""
    table, row = _row(agent.folder)
    scores = table.scores[table.scores["row"] == row.key].set_index("level_kind")
    seeds, frames = int(scores["seeds"].min()), int(scores["frames"].min())
    texts = [score_text(scores["score"].get(kind, float("nan"))) for kind in kinds]
    if len(found := success_by_situation(row, table)) >= FEWEST_SEEDS:
        _, low, high = bootstrap_of_situations(found)
        texts[kinds.index("rare")] += f" [{score_text(low)}, {score_text(high)}]"
    if len(changes := envs.family_of_split(table.description.split).image_changes):
        version = min(run.description.images or 0 for run in row.runs)
        title += f" (images v{version})" if version < len(changes) else ""
    spent = [_spent(row, table.window)] if hours else []
    return (title, agent.beyond, str(seeds), f"{frames / 1e6:,.1f} M", *spent, *texts)


def _spent(row: Row, window: Window) -> str:
    """The hours up to the scores of the row, of the median seed that has one."""
    inside = {run: evaluations_inside(run, window)["seconds"] for run in row.runs}
    each = [seconds.max() / 3600 + _before(run) for run, seconds in inside.items() if len(seconds)]
    if any(map(isnan, each)):
        return NONE
    hours = median(each)
    return f"{hours:.1f}" if hours >= 0.1 else f"{hours:.2f}"


def _before(run: Run) -> float:
    """The hours of the runs that a run began with; NaN where the record has not all of these."""
    there = run.description.pretrained
    if there is None:
        return 0.0
    folder = RESULTS / there.experiment / there.condition / f"seed{there.seed}"
    for one in _all_runs():  # a later run may have its name
        if one.folder == folder and one.frames + one.frames_before == there.frames:
            return one.seconds / 3600 + _before(one)
    return nan


def _levels(folder: str) -> list[dict[str, Any]]:
    """The levels that a condition's runs act on, with what is known of baselines now."""
    table, _ = _row(folder)
    return describe_levels(envs.split(table.description.split), table.description.environment)


def _runs(folder: str) -> list[Run]:
    return [run for run in _all_runs() if run.folder.is_relative_to(RESULTS / folder)]


@cache
def _all_runs() -> list[Run]:
    return load_runs([RESULTS])


@cache
def _row(folder: str) -> tuple[ScoreTable, Row]:
    """The table of a condition's runs alone, and its only row."""
    (table,) = score_tables(_runs(folder), OwnWindows())
    (row,) = table.rows
    assert table.unreached is None, f"{folder}: no run has reached its window"
    return table, row


def situations() -> list[str]:
    """Success in each of the gridworld's rare situations, by seed, of the marked agents."""
    agents = [agent for agent in TASKS["gridworld"].agents if agent.situations]
    found = {agent: success_by_situation(*reversed(_row(agent.folder))) for agent in agents}
    names = sorted({name for rates in found.values() for name in rates.columns})
    rows = [
        (
            str(map),
            str(target),
            *(" / ".join(f"{p:.2f}" for p, _ in rates[map, target]) for rates in found.values()),
        )
        for map, target in names
    ]
    columns = [agent.title for agent in agents]
    return markdown(("Map", "Target", *columns), rows, right=("Map", "Target", *columns))


def runs() -> list[str]:
    """The lines of a table of the experiments of the record."""
    rows = []
    for name in sorted({run.description.experiment for run in _all_runs()}):
        of_it = _runs(name)
        conditions = {run.description.condition for run in of_it}
        versions = (str(run.description.version) for run in of_it)
        started = min(versions, key=lambda one: [int(part) for part in re.findall(r"\d+", one)])
        frames = range_text([run.frames for run in of_it])
        what = (catalogue.summary("experiment", name), str(len(conditions)), str(len(of_it)))
        rows.append((code(name), *what, frames, started))
    numbers = ("Conditions", "Runs", "Frames of each")
    return markdown(("Experiment", "What it is", *numbers, "From version"), rows, right=numbers)


def comparison(experiment: str) -> list[str]:
    """The lines of a table of an experiment's conditions, in the order of all tables."""
    (table,) = score_tables(_runs(experiment), OwnWindows())
    scores = table.scores.set_index(["condition", "level_kind"])
    rows: list[tuple[str, ...]] = []
    for name in table.scores["condition"].unique():
        of_kinds = [scores.loc[name, kind] for kind in PAPER_KINDS]
        shown = (score_text(one["score"], one["error"]) for one in of_kinds)
        title = code(name) + (", not tuned" if name in UNTUNED else "")
        rows.append((title, str(min(int(one["seeds"]) for one in of_kinds)), *shown))
    for baseline in BASELINES:
        known = table.baseline(baseline.name)
        rows.append((baseline.title, "", *(f"{known[kind]:.2f}" for kind in PAPER_KINDS)))
    numbers = ("Seeds", *(KIND_NAMES[kind] for kind in PAPER_KINDS))
    return markdown(("Condition", *numbers), rows, right=numbers)
