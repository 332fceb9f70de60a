"""The paper's tables of results, its columns side by side and every row that it prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from zipf.experiments.records.paper import (
    PaperColumn,
    PaperLayout,
    paper_layouts,
    paper_table,
    paper_titles,
)
from zipf.experiments.reporting.comparable import PaperRow, Row
from zipf.experiments.reporting.scores import other_statistic
from zipf.experiments.reporting.tables import ScoreTable
from zipf.protocol import BASELINE_NAMES, KINDS


@dataclass(frozen=True, eq=False)
class SideBySide:
    """One of the paper's layouts with the tables at hand."""

    name: str  # unique among those of a report
    # those that the paper has, in its order, then the others of the tables, in theirs
    rows: tuple[Row | PaperRow, ...]
    # for each table of the layout its title, the headings of its columns, and lines of
    # `zipf.experiments.reporting.scores.score_frame` whose `column` is the heading
    parts: tuple[tuple[str, tuple[str, ...], pd.DataFrame], ...]
    tables: tuple[ScoreTable, ...]  # where the columns come from
    missing: tuple[str, ...]  # experiments of the layout of which there is no run


def side_by_side(tables: Sequence[ScoreTable]) -> list[SideBySide]:
    """Every layout of the paper of whose experiments one is there.

    Experiments stand side by side if they were made alike: if their names differ in nothing but the
    split's, as `playroom_lift` and `playroom_put`. Of several tables of one experiment the one with
    most of the paper's rows is laid out.
    """
    found: dict[str, dict[str, ScoreTable]] = {}
    for table in tables:
        description = table.description
        if description.paper is not None:
            variant = description.experiment.replace(description.split, "")
            of_variant = found.setdefault(variant, {})
            other = of_variant.setdefault(description.paper, table)
            if _published_rows(table) > _published_rows(other):
                of_variant[description.paper] = table
    return [
        _arrange(layout, variant, by_key)
        for variant, by_key in found.items()
        for layout in paper_layouts()
        if by_key.keys() & set(layout.experiments)
    ]


def _published_rows(table: ScoreTable) -> int:
    scored = table.scores[table.scores["score"].notna() & table.scores["paper_value"].notna()]
    return int(scored["row"].nunique())


def _arrange(layout: PaperLayout, variant: str, by_key: dict[str, ScoreTable]) -> SideBySide:
    marked = f" ({variant.strip('_')})" if variant else ""
    used = [by_key[experiment] for experiment in layout.experiments if experiment in by_key]
    by_row = {row.key: row for table in used for row in table.rows}
    published = {key for one in layout.experiments for key in paper_table(one).rows}
    rows: list[Row | PaperRow] = [
        by_row.pop(key) if key in by_row else PaperRow(key, title)
        for key, title in paper_titles().items()
        if key in published
    ]
    others = sorted(by_row.values(), key=lambda row: row.runs[0].description.row_order)
    rows += others
    parts = []
    for title, columns in layout.tables:
        chosen = [
            _scores(column, by_key.get(column.experiment), rows).assign(column=heading)
            for heading, column in columns.items()
        ]
        part = pd.concat([one for one in chosen if len(one)])
        part = part.astype({**dict.fromkeys(_NUMBERS, float), "seeds": "Int64"})
        if part[["score", "paper_value"]].notna().any(axis=None):
            parts.append((title + marked, tuple(columns), part))
    return SideBySide(
        name=f"{layout.name}{variant}",
        rows=tuple(rows),
        parts=tuple(parts),
        tables=tuple(used),
        missing=tuple(one for one in layout.experiments if one not in by_key),
    )


def _scores(
    column: PaperColumn, table: ScoreTable | None, rows: Sequence[Row | PaperRow]
) -> pd.DataFrame:
    """The lines of a column, with one for each row of which there are only published scores."""
    found = pd.DataFrame()
    if table is not None:
        scores = table.scores if column.column in KINDS else table.group_scores
        name_of = "level_kind" if column.column in KINDS else "level"
        found = scores[scores[name_of] == column.column]
        if column.statistic != "score":
            found = other_statistic(found, column.statistic.removesuffix("_score"))
    known = set(found["row"]) if len(found) else set()
    lines = []
    for row in rows:
        published = paper_table(column.experiment).score(row.key, column.column)
        if row.key not in known and published is not None and column.statistic == "score":
            error = np.nan if published.error is None else published.error
            # A row with runs has its seeds in the columns of its experiment.
            seeds = 0 if isinstance(row, PaperRow) else pd.NA
            lines.append(
                {
                    **dict.fromkeys(_NUMBERS, np.nan),
                    "row": row.key,
                    "marked": False,
                    "seeds": seeds,
                    "paper_value": published.value,
                    "paper_error": error,
                }
            )
    known_and_more = [one.astype(object) for one in (found, pd.DataFrame(lines)) if len(one)]
    return pd.concat(known_and_more) if known_and_more else found


_NUMBERS = (
    *("score", "error", "shown", "shown_error", "paper_value", "paper_error"),
    *BASELINE_NAMES,
)
