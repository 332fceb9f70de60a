"""Tables of several experiments with their columns side by side, as the paper prints them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.reporting.paper import LEVEL_KINDS, PaperLayout, paper_layouts
from zipf.experiments.reporting.tables import Row, ScoreTable


@dataclass(frozen=True, eq=False)
class SideBySide:
    """The tables of several experiments in the paper's layout.

    Attributes:
        name: unique among those of a report.
        rows: of all these tables, in their order.
        parts: for each table of the layout its title, the headings of its columns, and lines of
            `zipf.experiments.reporting.tables.score_frame` whose `column` is the heading.
        tables: where the columns come from.
    """

    name: str
    rows: tuple[Row, ...]
    parts: tuple[tuple[str, tuple[str, ...], pd.DataFrame], ...]
    tables: tuple[ScoreTable, ...]


def side_by_side(tables: Sequence[ScoreTable]) -> list[SideBySide]:
    """Every layout of the paper whose experiments are all there, made alike.

    Alike are experiments whose names differ in nothing but the split's: `playroom_lift_compact` and
    `playroom_put_compact`.
    """
    found: dict[str, dict[str, ScoreTable]] = {}
    for table in tables:
        description = table.description
        if description.paper is not None:
            variant = description.experiment.replace(description.split, "")
            found.setdefault(variant, {}).setdefault(description.paper, table)
    return [
        _arrange(f"{layout.name}{variant}", layout, by_key)
        for variant, by_key in found.items()
        for layout in paper_layouts()
        if by_key.keys() >= set(layout.experiments)
    ]


def _arrange(name: str, layout: PaperLayout, by_key: dict[str, ScoreTable]) -> SideBySide:
    used = [by_key[experiment] for experiment in layout.experiments]
    rows = {row.key: row for table in used for row in table.rows}
    parts = []
    for title, columns in layout.tables:
        chosen = []
        for heading, (experiment, column) in columns.items():
            table = by_key[experiment]
            scores = table.scores if column in LEVEL_KINDS else table.group_scores
            name_of = "level_kind" if column in LEVEL_KINDS else "level"
            chosen.append(scores[scores[name_of] == column].assign(column=heading))
        parts.append((title, tuple(columns), pd.concat(chosen)))
    return SideBySide(
        name=name,
        rows=tuple(sorted(rows.values(), key=lambda row: row.runs[0].description.row_order)),
        parts=tuple(parts),
        tables=tuple(used),
    )
