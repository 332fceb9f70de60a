"""The paper's published numbers, and the names of its conditions.

Source: Chan, Lampinen, Richemond and Hill (2022), "Zipfian environments for reinforcement
learning". ``paper_tables.json`` beside this file copies the tables whose LaTeX labels it lists.
What the copy leaves out or adds:

- "IMPALA + LSTM memory" repeats the numbers of "IMPALA" (the same runs): one condition here.
- "R2D2 without prioritised replay" stands in the text only, on putting, without an error.
- The gridworld row with vision and language reconstruction is as printed, although that
  environment has no language.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

from zipf.experiments.errors import UserError

LEVEL_KINDS = ("train", "uniform", "rare")

# In the order of the paper's tables: algorithms, self-supervised losses, memories; the supervised
# classifier has a table of its own.
CONDITION_NAMES: Mapping[str, str] = {
    "impala": "IMPALA",
    "vmpo": "V-MPO",
    "r2d2": "R2D2",
    "r2d2_uniform_replay": "R2D2, uniform replay",
    "impala_vision": "IMPALA + vis recon",
    "impala_vision_language": "IMPALA + vis+lang recon",
    "impala_byol": "IMPALA + BYOL",
    "impala_mlp": "IMPALA + MLP",
    "impala_transformer": "IMPALA + transformer",
    "impala_transformer_vision_language": "IMPALA + transformer + vis+lang recon",
    "supervised": "Supervised classifier",
}


TABLE_OF_SPLIT: Mapping[str, str] = {
    "gridworld": "gridworld",
    "playroom_lift": "playroom_lifting",
    "playroom_put": "playroom_putting",
    "playroom_find": "playroom_finding",
}
"""Which of the paper's experiments, by our key, a split repeats."""


@dataclass(frozen=True)
class PaperScore:
    """A published score. `error` is None where the paper prints none."""

    value: float
    error: float | None


@dataclass(frozen=True)
class PaperTable:
    """What the paper printed for one experiment.

    `error_kind` says in words what its ± is; `note` what a reader of the numbers has to know. A row
    has scores by level kind, or by the name of a group of train levels; `train_groups` says which
    levels, averaged, make such a group.
    """

    source: str
    error_kind: str
    note: str | None
    train_groups: Mapping[str, tuple[str, ...]]
    rows: Mapping[str, Mapping[str, PaperScore]]

    def score(self, condition: str, column: str) -> PaperScore | None:
        """The published score, or None where the paper has no such row or column."""
        return self.rows.get(condition, {}).get(column)


@functools.cache
def _tables() -> Mapping[str, PaperTable]:
    file = resources.files("zipf.experiments.reporting").joinpath("paper_tables.json")
    data = json.loads(file.read_text(encoding="utf-8"))
    return {
        experiment: PaperTable(
            source=data["source"],
            error_kind=table["error"],
            note=table["note"],
            train_groups={
                group: tuple(levels) for group, levels in table.get("train_groups", {}).items()
            },
            rows={
                condition: {
                    column: PaperScore(score[0], score[1] if len(score) > 1 else None)
                    for column, score in row.items()
                }
                for condition, row in table["rows"].items()
            },
        )
        for experiment, table in data["experiments"].items()
    }


def paper_table(experiment: str) -> PaperTable:
    """The paper's numbers for one of its experiments, by our key (for instance ``gridworld``).

    Raises:
        UserError: the paper has no such experiment.
    """
    tables = _tables()
    if experiment not in tables:
        raise UserError(
            f"the paper has no experiment {experiment!r}; it has {', '.join(sorted(tables))}"
        )
    return tables[experiment]


def condition_name(condition: str) -> str:
    """The name of a condition as tables and plots show it.

    A condition may add settings to a known one: ``impala_mlp,agent.learning_rate=0.001``.
    """
    known, *settings = condition.split(",")
    return ", ".join([CONDITION_NAMES.get(known, known), *settings])


def condition_order(condition: str) -> tuple[int, str]:
    """Sort key: the paper's conditions in the paper's order, then all others by name.

    A condition that adds settings to a known one follows it.
    """
    names = list(CONDITION_NAMES)
    known = condition.split(",")[0]
    return (names.index(known) if known in names else len(names), condition)
