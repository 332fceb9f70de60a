"""The tables of agents that are to do well on what is rare, from the runs in results/."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from tables import code, markdown

from zipf.envs import split
from zipf.envs.splits import KINDS
from zipf.experiments.reporting.paper import paper_table
from zipf.experiments.reporting.results import load_runs
from zipf.experiments.reporting.tables import score_tables
from zipf.experiments.reporting.wording import KIND_NAMES, score_text
from zipf.references import REFERENCES

RESULTS = Path(__file__).parent.parent / "results"


class Task(NamedTuple):
    """A task, and the rows of the record to show.

    Attributes:
        title: of the task.
        experiment: the folder of results/.
        conditions: the folders in that, each with its name in the table.
        best: some of them, with a name that stands alone.
    """

    title: str
    experiment: str
    conditions: dict[str, str]
    best: dict[str, str]


SETTLED_WHOLE = "impala_comparing_settled_whole"
TASKS = (
    Task(
        "Gridworld",
        "gridworld_compact",
        {
            "impala_mlp": "IMPALA + MLP, `compact` network",
            "impala_given_augmented": "IMPALA, given comparison, then augmentation",
            "impala_comparing_hindsight,precision=bfloat16": "IMPALA + MLP, learned comparison and "
            "hindsight",
            "impala_comparing_augmented,precision=bfloat16,"
            "pretrained.run=gridworld_compact_impala_comparing_hindsight,precision=bfloat16,"
            "collector.num_envs=64,collector.unroll_length=64": "Its encoder, then LSTM and "
            "augmentation",
            SETTLED_WHOLE: "The same, then whole episodes and a falling learning rate",
            "imitation_comparing_augmented,precision=bfloat16": "Imitation, learned comparison, "
            "augmentation",
        },
        {
            "impala_mlp": "IMPALA",
            SETTLED_WHOLE: "IMPALA that compares, with hindsight, then augmentation",
            "imitation_comparing_augmented,precision=bfloat16": "Imitation that compares, with "
            "augmentation",
        },
    ),
    Task(
        "Finding a toy",
        "playroom_find_compact",
        {
            "supervised,network=film": "Classifier, `film` network",
            "supervised_hindsight_augmented,network=film": "Classifier, `film` network, memory of "
            "goals",
            "supervised_matching": "Classifier, `matching` network, memory of goals",
            "supervised_matching_scaled": "Classifier, `matching` network, memory of goals, "
            "images scaled 0.4 to 1.4",
            "impala,network=film": "IMPALA, `film` network",
            "imitation,network=film": "Imitation, `film` network",
        },
        {
            "impala,network=film": "IMPALA",
            "supervised,network=film": "Classifier",
            "supervised_matching_scaled": "Classifier with a matcher",
        },
    ),
    Task(
        "Lifting a toy",
        "playroom_lift_compact",
        {
            "impala_1000_updates": "IMPALA",
            "impala_hindsight": "IMPALA, hindsight",
            "imitation": "Imitation",
            "impala,network=film": "IMPALA, `film` network",
            "impala_matching": "IMPALA, `matching` network, matcher from finding",
            "impala_matching_settled": "The same, then a falling learning rate",
            "impala_matching_settled_longer": "The same, the rate falling three times as slowly",
            "imitation_matching": "Imitation, `matching` network, matcher from finding",
        },
        {
            "impala,network=film": "IMPALA",
            "impala_matching_settled_longer": "IMPALA with a matcher",
            "imitation_matching": "Imitation with a matcher",
        },
    ),
)


def tail() -> list[str]:
    """The lines of a table of all tasks and conditions."""
    return _table([(task, task.conditions) for task in TASKS])


def best() -> list[str]:
    """The lines of a shorter one."""
    return _table([(task, task.best) for task in TASKS])


def _table(shown: Iterable[tuple[Task, Mapping[str, str]]]) -> list[str]:
    """Frames are those of the runs that an agent began with, too."""
    rows: list[tuple[str, ...]] = []
    for task, titles in shown:
        folders = [RESULTS / task.experiment / name for name in titles]
        runs = load_runs(folders)
        published = paper_table(split(runs[0].description.split).paper or "").rows.values()
        of_paper = [max(row[kind].value for row in published if kind in row) for kind in KINDS]
        rows.append((task.title, "the paper's best", "", "", *(f"{one:.2f}" for one in of_paper)))
        tables = score_tables(runs, "own")
        for reference in REFERENCES:
            known = tables[0].reference(reference.name)
            rows.append(("", reference.title, "", "", *(f"{known[kind]:.2f}" for kind in KINDS)))
        found = pd.concat([table.scores for table in tables])
        for name, title in titles.items():
            scores = found[found["condition"] == name].set_index("level_kind")
            seeds, frames = int(scores["seeds"].min()), int(scores["frames"].min())
            of_row = [run.description for run in runs if run.description.condition == name]
            frames += max(run.pretrained.frames if run.pretrained else 0 for run in of_row)
            of_kinds = (f"{scores['score'][kind]:.2f}" for kind in KINDS)
            rows.append(("", title, str(seeds), f"{frames / 1e6:,.1f} M", *of_kinds))
    numbers = ("Seeds", "Frames", *(KIND_NAMES[kind] for kind in KINDS))
    return markdown(("Task", "Agent", *numbers), rows, right=numbers)


def comparison(experiment: str) -> list[str]:
    """The lines of a table of an experiment's conditions, in the order that RESULTS.md has."""
    (table,) = score_tables(load_runs([RESULTS / experiment]), "own")
    scores = table.scores.set_index(["condition", "level_kind"])
    rows: list[tuple[str, ...]] = []
    for name in table.scores["condition"].unique():
        of_kinds = [scores.loc[name, kind] for kind in KINDS]
        shown = (score_text(one["score"], one["error"]) for one in of_kinds)
        rows.append((code(name), str(min(int(one["seeds"]) for one in of_kinds)), *shown))
    for reference in REFERENCES:
        known = table.reference(reference.name)
        rows.append((reference.title, "", *(f"{known[kind]:.2f}" for kind in KINDS)))
    numbers = ("Seeds", *(KIND_NAMES[kind] for kind in KINDS))
    return markdown(("Condition", *numbers), rows, right=numbers)
