"""The rows of a table: the runs of a condition, or of an external agent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import EXTERNAL_MARK


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a table: the runs of a condition, or of an external agent.

    Attributes:
        key: unique among the rows of a report.
        title: as tables and plots show it; an external agent's ends in a mark.
        external: whether it was recorded from outside this package.
        colour: as #rrggbb; None if it is to be assigned.
        line: "solid" or "dashed".
        runs: its seeds.
    """

    key: str
    title: str
    external: bool
    colour: str | None
    line: str
    runs: tuple[Run, ...]

    @property
    def condition(self) -> str:
        """The condition's name, or the external agent's."""
        return self.runs[0].description.condition


@dataclass(frozen=True)
class PaperRow:
    """A row of one of the paper's tables of which there is no run.

    Attributes:
        key: unique among the rows of a report: the condition.
        title: as tables show it.
    """

    key: str
    title: str


def rows_of(runs: Sequence[Run]) -> tuple[Row, ...]:
    """The rows of a table of these runs, in their order."""
    by_key: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda run: run.description.row_order):
        by_key.setdefault(run.description.row_key, []).append(run)
    rows = []
    for key, of_row in by_key.items():
        description = of_row[0].description
        external = description.external is not None
        rows.append(
            Row(
                key=key,
                title=description.row.title + (f" {EXTERNAL_MARK}" if external else ""),
                external=external,
                colour=description.row.colour,
                line=description.row.line,
                runs=tuple(of_row),
            )
        )
    return tuple(rows)
