"""Score tables on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from zipf.experiments.records.wording import KIND_NAMES, NONE
from zipf.experiments.reporting.claim_checks import Outcome
from zipf.experiments.reporting.claims import ClaimLine
from zipf.experiments.reporting.grids import (
    LEVEL,
    Grid,
    caption,
    claims_caption,
    legend,
    lower_grids,
    main_grid,
    side_by_side_caption,
    side_by_side_grids,
)
from zipf.experiments.reporting.side_by_side import SideBySide
from zipf.experiments.reporting.tables import ScoreTable


def print_table(table: ScoreTable, console: Console) -> None:
    """Print the table, the paper's scores below ours, then what is its own of caption and notes."""
    _print_grid(main_grid(table), table.title, console)
    long = [grid.title for grid in lower_grids(table) if grid.leading[0] == LEVEL]
    for grid in lower_grids(table):
        if grid.title not in long:
            _print_grid(grid, f"{table.title}: {grid.title}", console)
    if long:
        console.print(
            f"[dim]In report.md: {', '.join(dict.fromkeys(long))}.[/dim]", highlight=False
        )
    console.print(f"[dim]{escape(caption(table))}[/dim]", highlight=False)
    for note in table.notes:
        console.print(f"[yellow]Note:[/yellow] {escape(note)}", highlight=False)


def print_legend(tables: Sequence[ScoreTable], console: Console) -> None:
    """Print how to read the tables."""
    console.print(f"[dim]{escape(' '.join(legend(tables)))}[/dim]", highlight=False)


def print_side_by_side(beside: SideBySide, console: Console) -> None:
    """Print the tables of one of the paper's layouts."""
    for grid in side_by_side_grids(beside):
        _print_grid(grid, grid.title, console)
    console.print(f"[dim]{escape(side_by_side_caption(beside))}[/dim]", highlight=False)


def print_claims(lines: Sequence[ClaimLine], console: Console) -> None:
    """Print the claims for which there are scores; nothing if there are none."""
    known = [line for line in lines if line.at_hand]
    if not known:
        return
    shown = Table(title="Claims of the paper", title_style="bold", title_justify="left")
    for heading in ("Claim", "Table", "Numbers", "Outcome"):
        shown.add_column(heading, overflow="fold", no_wrap=heading == "Outcome")
    for line in known:
        cells = (line.claim.statement, line.table, line.numbers)
        colour = OUTCOME_STYLES[line.outcome]
        shown.add_row(*(escape(cell) for cell in cells), f"[{colour}]{line.outcome}[/{colour}]")
    console.print(shown)
    console.print(f"[dim]{escape(claims_caption(lines))}[/dim]", highlight=False)


OUTCOME_STYLES: Mapping[Outcome, str] = {"holds": "green", "fails": "red", "not enough data": "dim"}


def _print_grid(grid: Grid, title: str, console: Console) -> None:
    shown = Table(title=escape(title), title_style="bold", title_justify="left")
    first, *numbers = grid.leading
    shown.add_column(first, overflow="fold")
    for heading in numbers:
        shown.add_column(heading, justify="right", no_wrap=True)
    for column in grid.columns:
        fits = len(column) <= len(KIND_NAMES["train"])
        shown.add_column(escape(column), justify="right", no_wrap=fits, overflow="fold")
    for line in grid.lines:
        shown.add_row(*(escape(cell) for cell in line.leading), *line.ours)
        if any(text != NONE for text in line.paper):
            empty = [""] * len(numbers)
            paper = (f"[dim]{text}[/dim]" for text in line.paper)
            shown.add_row("[dim]  paper[/dim]", *empty, *paper)
    if grid.baselines:
        shown.add_section()
    for line in grid.baselines:
        shown.add_row(*line.leading, *line.ours)
    console.print(shown)
