"""Tables of several experiments with their columns side by side, as the paper prints them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.reporting.paper import condition_order
from zipf.experiments.reporting.tables import ScoreTable

# Title, and for each column the paper's experiment, by our key, and its level kind or group of
# train levels there.
PLAYROOM = (
    (
        "Zipf's Playroom",
        {
            "Lifting: uniform": ("playroom_lifting", "uniform"),
            "Lifting: rare": ("playroom_lifting", "rare"),
            "Putting: uniform": ("playroom_putting", "uniform"),
            "Putting: rare": ("playroom_putting", "rare"),
        },
    ),
    (
        "Zipf's Playroom, training performance",
        {
            "Lifting (Zipf 3)": ("playroom_lifting", "train"),
            "Putting: lifting (Zipf 2)": ("playroom_putting", "Lifting (Zipf 2)"),
            "Putting: putting (frequent only)": (
                "playroom_putting",
                "Putting (frequent only)",
            ),
        },
    ),
)


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Two experiments' tables in the paper's layout.

    Attributes:
        name: unique among those of a report.
        parts: for each table its title, its columns and, for these in the place of level kinds, the
            rows of `zipf.experiments.reporting.tables.score_table`.
        caption: where the columns come from.
        chance_is_measured: rather than exact.
    """

    name: str
    parts: tuple[tuple[str, tuple[str, ...], pd.DataFrame], ...]
    caption: str
    chance_is_measured: bool


def side_by_side(tables: Sequence[ScoreTable]) -> list[SideBySide]:
    """The paper's table of the playroom for every pair of lifting and putting made alike.

    Alike are experiments whose names differ in nothing but the split's: `playroom_lift_compact` and
    `playroom_put_compact`.
    """
    found: dict[str, dict[str, ScoreTable]] = {}
    for table in tables:
        description = table.runs[0].description
        if description.paper is not None:
            variant = description.experiment.replace(description.split, "")
            found.setdefault(variant, {}).setdefault(description.paper, table)
    return [
        _playroom(f"playroom{variant}", by_key)
        for variant, by_key in found.items()
        if by_key.keys() >= {"playroom_lifting", "playroom_putting"}
    ]


def _playroom(name: str, by_key: dict[str, ScoreTable]) -> SideBySide:
    used = [by_key["playroom_lifting"], by_key["playroom_putting"]]
    parts = []
    for title, columns in PLAYROOM:
        chosen = []
        for heading, (key, column) in columns.items():
            scores = pd.concat([by_key[key].scores, by_key[key].train_scores])
            chosen.append(scores[scores["level_kind"] == column].assign(level_kind=heading))
        rows = pd.concat(chosen)
        order = sorted(rows["condition"].unique(), key=condition_order)
        rows = rows.sort_values("condition", key=lambda c: c.map(order.index), kind="stable")
        parts.append((title, tuple(columns), rows))
    return SideBySide(
        name=name,
        parts=tuple(parts),
        caption=(
            f"Columns of {used[0].title} and {used[1].title} side by side, as the paper prints "
            f"them; windows, episodes and notes stand there."
        ),
        chance_is_measured=any(table.chance_episodes for table in used),
    )
