"""The tables of agents that are to do well on what is rare, from the runs in results/."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from tables import code, markdown

from zipf import envs
from zipf.experiments.building.run_folder import describe_levels, mean_of_levels
from zipf.experiments.options import catalogue, composing
from zipf.experiments.records.paper import paper_table
from zipf.experiments.records.results import Run, load_runs
from zipf.experiments.records.wording import KIND_NAMES, NONE, count_text, range_text, score_text
from zipf.experiments.reporting.claims import check_claims
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.seed_statistics import (
    bootstrap_of_situations,
    success_by_situation,
)
from zipf.experiments.reporting.tables import ScoreTable, score_tables
from zipf.protocol import BASELINES, PAPER_KINDS, Baseline

RESULTS = Path(__file__).parent.parent / "results"
UNTUNED = ("r2d2", "r2d2_uniform_replay", "vmpo")
"""Conditions whose values in `gridworld_compact` were not tuned; those of the others were."""
UNMEASURED = "to be measured"


class Agent(NamedTuple):
    """A row.

    Attributes:
        title: in tables.
        beyond: what it learned from beyond pixels and rewards.
        folder: of results/, the experiment's and the condition's; None: to be measured.
    """

    title: str
    beyond: str
    folder: str | None


class Task(NamedTuple):
    """A task: its title, the paper's experiment, and the rows of the record to show."""

    title: str
    paper: str
    agents: tuple[Agent, ...]


CELLS = "count bonus, cells"
HINDSIGHT = f"{CELLS}, achieved goals"
SYMMETRIES = f"{HINDSIGHT}, symmetries"
TEACHER = "cells, symmetries, teacher"
MATCHER = "matcher of finding (achieved goals there)"
SEARCH = (
    "gridworld_compact/impala_comparing_augmented,precision=bfloat16,"
    "pretrained.run=gridworld_compact_impala_comparing_hindsight,precision=bfloat16,"
    "collector.num_envs=64,collector.unroll_length=64"
)
COMPARES = Agent(
    "IMPALA + MLP, learned comparison and hindsight",
    HINDSIGHT,
    "gridworld_compact/impala_comparing_hindsight,precision=bfloat16",
)
SETTLED = Agent(
    "The same, then whole episodes and a falling learning rate",
    SYMMETRIES,
    "gridworld_compact/impala_comparing_settled_whole",
)
LIFTED = Agent(
    "The same, then a falling learning rate",
    MATCHER,
    "playroom_lift_compact/impala_matching_settled",
)
CLASSIFIER = Agent(
    "Classifier, `film` network", "", "playroom_find_compact/supervised,network=film"
)
TASKS = (
    Task(
        "Gridworld",
        "gridworld",
        (
            Agent("IMPALA + MLP, `compact` network", CELLS, "gridworld_compact/impala_mlp"),
            Agent(
                "IMPALA, given comparison, then augmentation",
                f"{CELLS}, comparison, symmetries",
                "gridworld_compact/impala_given_augmented",
            ),
            COMPARES,
            Agent("Its encoder, then LSTM and augmentation", SYMMETRIES, SEARCH),
            SETTLED,
            Agent(
                "Imitation, learned comparison, augmentation",
                TEACHER,
                "gridworld_compact/imitation_comparing_augmented,precision=bfloat16",
            ),
        ),
    ),
    Task(
        "Finding a toy",
        "playroom_find",
        (
            CLASSIFIER,
            Agent(
                "Classifier, `film` network, memory of goals",
                "achieved goals",
                "playroom_find_compact/supervised_hindsight_augmented,network=film",
            ),
            Agent(
                "Classifier, `matching` network, memory of goals",
                "achieved goals",
                "playroom_find_compact/supervised_matching",
            ),
            Agent(
                "Classifier, `matching` network, memory of goals, images scaled 0.4 to 1.4",
                "achieved goals",
                "playroom_find_compact/supervised_matching_scaled",
            ),
            Agent("IMPALA", "", None),
            Agent("Imitation", "teacher", None),
        ),
    ),
    Task(
        "Lifting a toy",
        "playroom_lift",
        (
            Agent("IMPALA", "", "playroom_lift_compact/impala_1000_updates"),
            Agent("IMPALA, hindsight", "achieved goals", "playroom_lift_compact/impala_hindsight"),
            Agent("Imitation", "teacher", "playroom_lift_compact/imitation"),
            Agent("IMPALA, `film` network", "", "playroom_lift_compact/impala,network=film"),
            Agent(
                "IMPALA, `matching` network, matcher from finding",
                MATCHER,
                "playroom_lift_compact/impala_matching",
            ),
            LIFTED,
            Agent(
                "The same, the rate falling three times as slowly, from the best of three seeds",
                MATCHER,
                "playroom_lift_compact/impala_matching_settled_longer",
            ),
            Agent(
                "Imitation, `matching` network, matcher from finding",
                f"{MATCHER}, teacher",
                "playroom_lift_compact/imitation_matching",
            ),
        ),
    ),
)

BEST = (
    Task(
        "Gridworld",
        "gridworld",
        (
            Agent("IMPALA", CELLS, "gridworld_conditions/impala"),
            SETTLED._replace(title="IMPALA that compares, with hindsight, then augmentation"),
            Agent(
                "Imitation that compares, with augmentation",
                TEACHER,
                "gridworld_conditions/imitation_comparing_augmented",
            ),
        ),
    ),
    Task(
        "Finding a toy",
        "playroom_find",
        (
            CLASSIFIER._replace(title="Classifier"),
            Agent(
                "Classifier with a matcher",
                "achieved goals",
                "playroom_find_compact/supervised_matching_scaled",
            ),
        ),
    ),
    Task(
        "Lifting a toy",
        "playroom_lift",
        (
            Agent("IMPALA", "", "playroom_lift_compact/impala_1000_updates"),
            LIFTED._replace(title="IMPALA with a matcher"),
            Agent(
                "Imitation with a matcher",
                f"{MATCHER}, teacher",
                "playroom_lift_compact/imitation_matching",
            ),
        ),
    ),
)
"""A shorter table, of rows with three seeds."""


def tail() -> list[str]:
    """The lines of a table of all tasks and agents."""
    return _table(TASKS)


def best() -> list[str]:
    """The lines of a shorter one, with no baseline but blind."""
    return _table(BEST, [one for one in BASELINES if one.name == "blind"])


def _table(tasks: Sequence[Task], baselines: Sequence[Baseline] = BASELINES) -> list[str]:
    """Frames are those of the runs that an agent began with, too."""
    rows: list[tuple[str, ...]] = []
    for task in tasks:
        rows.append((task.title, *_published(task)))
        levels = _levels(next(agent.folder for agent in task.agents if agent.folder))
        for baseline in baselines:
            means = (mean_of_levels(levels, kind, baseline.name) for kind in PAPER_KINDS)
            scores = (NONE if mean is None else score_text(mean) for mean in means)
            rows.append(("", baseline.title, "", "", "", *scores))
        rows += [("", *_shown(agent)) for agent in task.agents]
    numbers = ("Seeds", "Frames", *(KIND_NAMES[kind] for kind in PAPER_KINDS))
    return markdown(("Task", "Agent", "Beyond pixels and rewards", *numbers), rows, right=numbers)


def _published(task: Task) -> tuple[str, ...]:
    """The best score of any of the paper's agents in each column."""
    values = composing.composed(f"experiment={task.paper}").values
    collector = values["collector"]
    frames = values["updates"] * collector["num_envs"] * collector["unroll_length"]
    name = {"playroom_find": "playroom_finding", "playroom_lift": "playroom_lifting"}
    published = paper_table(name.get(task.paper, task.paper)).rows.values()
    scores = (max(row[kind].value for row in published if kind in row) for kind in PAPER_KINDS)
    return ("the paper's best", "", "3", count_text(frames), *map(score_text, scores))


def _shown(agent: Agent) -> tuple[str, ...]:
    if agent.folder is None:
        return (agent.title, agent.beyond, "", "", *(UNMEASURED for _ in PAPER_KINDS))
    table, row = _row(agent.folder)
    scores = table.scores[table.scores["row"] == row.key].set_index("level_kind")
    seeds, frames = int(scores["seeds"].min()), int(scores["frames"].min())
    began = (run.description.pretrained for run in row.runs)
    frames += max(one.frames if one else 0 for one in began)
    texts = [score_text(scores["score"][kind]) for kind in PAPER_KINDS]
    if len(found := success_by_situation(row, table)):
        _, low, high = bootstrap_of_situations(found)
        texts[-1] += f" [{score_text(low)}, {score_text(high)}]"
    return (agent.title, agent.beyond, str(seeds), f"{frames / 1e6:,.1f} M", *texts)


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
    (table,) = score_tables(_runs(folder), "own")
    (row,) = table.rows
    return table, row


def situations() -> list[str]:
    """Success of the best agents of the gridworld in each rare situation, by seed."""
    agents = (COMPARES, SETTLED, TASKS[0].agents[-1])
    found = {agent: success_by_situation(*reversed(_row(str(agent.folder)))) for agent in agents}
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
        started = min(str(run.description.version) for run in of_it)
        frames = range_text([run.frames for run in of_it])
        what = (catalogue.summary("experiment", name), str(len(conditions)), str(len(of_it)))
        rows.append((code(name), *what, frames, started))
    numbers = ("Conditions", "Runs", "Frames of each")
    return markdown(("Experiment", "What it is", *numbers, "From version"), rows, right=numbers)


def claims() -> list[str]:
    """The lines of a table of the paper's claims about which there are scores."""
    header = ("Claim of the paper", "Table", "Outcome", "On the paper's numbers")
    lines = check_claims(score_tables(_all_runs(), "own"))
    return markdown(
        header,
        (
            (line.claim.statement, code(line.table), line.outcome, line.paper or NONE)
            for line in lines
            if line.at_hand
        ),
    )


def comparison(experiment: str) -> list[str]:
    """The lines of a table of an experiment's conditions, in the order of all tables."""
    (table,) = score_tables(_runs(experiment), "own")
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
