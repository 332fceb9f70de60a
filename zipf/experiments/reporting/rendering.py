"""Score tables as text: terminal, Markdown, LaTeX, CSV, and the record of all results.

Output depends on the result files alone: the same files give the same bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from zipf.experiments.reporting.paper import condition_name
from zipf.experiments.reporting.results import Run
from zipf.experiments.reporting.side_by_side import SideBySide, side_by_side
from zipf.experiments.reporting.tables import (
    PROTOCOL_SEEDS,
    ScoreTable,
    UpdateWindow,
    count_text,
    window_text,
)

LEVEL_NAMES: Mapping[str, str] = {"train": "Train (Zipfian)", "uniform": "Uniform", "rare": "Rare"}
PLOT_KINDS = ("learning", "ranks", "situations")  # as in the plots' file names
NONE = "–"


def score_text(value: float, error: float = math.nan) -> str:
    """`0.69 ± 0.05`, without the second part where there is none; a dash for no score.

    Two decimals, as the paper prints: 1000 episodes do not carry a third.
    """
    if math.isnan(value):
        return NONE
    text = f"{value:z.2f}"
    return text if math.isnan(error) else f"{text} ± {error:.2f}"


def seeds_text(count: int) -> str:
    """`2/3` below the protocol's number of seeds, the plain count from there."""
    return f"{count}/{PROTOCOL_SEEDS}" if count < PROTOCOL_SEEDS else str(count)


def short_name(level: str) -> str:
    """A level's name without those before its last: `put_on_bed_tray_all`."""
    return level.rpartition("/")[2]


def duration_text(seconds: float) -> str:
    """`45 s`, `12 min`, `3 h 05 min`."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def caption(table: ScoreTable) -> str:
    """How to read the table: window, statistics, effort, chance, the paper."""
    window = table.window
    what = window_text(window)
    if isinstance(window, UpdateWindow):
        what = f"Median over the evaluations at {what}"
    elif window.count > 1:
        what = f"Median over {what}"
    own = "" if table.own_window else " (not the experiment's own window)"
    sentences = [
        f"{what[0].upper()}{what[1:]} of the median seed{own}, "
        f"± median absolute deviation across seeds (unscaled)."
    ]
    if (table.scores["seeds"] < PROTOCOL_SEEDS).any():
        sentences.append(f"n/{PROTOCOL_SEEDS}: fewer seeds than the protocol's {PROTOCOL_SEEDS}.")
    if table.episodes:
        sentences.append(f"Episodes per estimate: {_range_text(table.episodes)}.")
    sentences.append(
        f"Updates reached: {_range_text([run.updates for run in table.runs])}; "
        f"frames: {_range_text([run.frames for run in table.runs])}."
    )
    if table.chance and table.chance_episodes:
        sentences.append(
            f"Chance: uniformly random actions, measured over {_range_text(table.chance_episodes)} "
            f"episodes of each level."
        )
    elif table.chance:
        sentences.append("Chance: uniformly random actions.")
    if table.paper:
        sentences.append(f"Paper: {table.paper.source}, ± {table.paper.error_kind}.")
        if table.paper.note:
            sentences.append(table.paper.note)
    return " ".join(sentences)


def print_table(table: ScoreTable, console: Console) -> None:
    """Print the table, the paper's scores below ours, then its caption and notes."""
    _print_grid(_grid(table), table.title, console)
    if table.train_groups:
        _print_grid(_train_grid(table), f"{table.title}: train levels", console)
    console.print(f"[dim]{escape(caption(table))}[/dim]", highlight=False)
    for note in table.notes:
        console.print(f"[yellow]Note:[/yellow] {escape(note)}", highlight=False)


def print_side_by_side(beside: SideBySide, console: Console) -> None:
    """Print both tables of an environment in the paper's layout."""
    for title, grid in _grids(beside):
        _print_grid(grid, title, console)
    console.print(f"[dim]{escape(beside.caption)}[/dim]", highlight=False)


def markdown(table: ScoreTable) -> str:
    """The table as Markdown, with its caption and notes below it."""
    parts = [_markdown_grid(_grid(table))]
    if table.train_groups:
        parts += ["Train levels:", _markdown_grid(_train_grid(table))]
    parts.append(caption(table))
    if table.notes:
        parts.append("\n".join(f"- {_markdown_escape(note)}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def markdown_side_by_side(beside: SideBySide) -> str:
    """Both tables of an environment in the paper's layout, as Markdown with headings."""
    parts = [
        f"## {_markdown_escape(title)}\n\n{_markdown_grid(grid)}\n"
        for title, grid in _grids(beside)
    ]
    return "\n".join([*parts, f"{_markdown_escape(beside.caption)}\n"])


def markdown_report(tables: Sequence[ScoreTable], plots: Mapping[str, Sequence[Path]]) -> str:
    """`report.md`: every table, with its plots (by the table's name; files beside the report)."""
    parts = []
    for table in tables:
        parts.append(f"## {_markdown_escape(table.title)}\n\n{markdown(table)}")
        parts += [f"![{path.stem}]({path.name})\n" for path in plots.get(table.name, [])]
    parts += [markdown_side_by_side(beside) for beside in side_by_side(tables)]
    return "\n".join(parts)


def linked_plots(markdown_text: str) -> list[str]:
    """The names of the plots that a `report.md` of this module shows."""
    kinds = "|".join(PLOT_KINDS)
    links = re.finditer(rf"^!\[([\w.-]+_(?:{kinds}))\]\(\1\.png\)$", markdown_text, re.MULTILINE)
    return [f"{link[1]}.png" for link in links]


def latex_report(tables: Sequence[ScoreTable]) -> str:
    """`report.tex`: a document that compiles by itself, one booktabs table per experiment."""
    body = "\n".join(
        [
            *(part for table in tables for part in _latex_tables(table)),
            *(part for beside in side_by_side(tables) for part in _latex_side_by_side(beside)),
        ]
    )
    return _LATEX_HEAD + body + "\\end{document}\n"


def csv_report(tables: Sequence[ScoreTable]) -> str:
    """`report.csv`: one line per condition and level kind, at full precision, empty for none.

    Where there are several train levels, lines of `train: <level or group of levels>` follow.
    """
    parts = []
    for table in tables:
        groups = "train: " + table.train_scores["level_kind"].astype(str)
        parts += [table.scores, table.train_scores.assign(level_kind=groups)]
    return pd.concat([part for part in parts if len(part)]).to_csv(
        index=False, float_format="%.10g", lineterminator="\n"
    )


def record(tables: Sequence[ScoreTable], command: str) -> str:
    """The record of all results: every table, and what each of its runs was."""
    parts = [f"Generated by `{command}`; do not edit by hand.\n", "# Results\n"]
    for table in tables:
        parts.append(f"## {_markdown_escape(table.title)}\n\n{markdown(table)}")
        lines = [_RUN_COLUMNS, [":--", "--:", "--:", "--:", "--:", ":--", ":--", ":--", ":--"]]
        lines += [_run_cells(run) for run in table.runs]
        parts.append("\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n")
        commands = "\n".join(dict.fromkeys(run.description.command for run in table.runs))
        parts.append(f"```\n{commands}\n```\n")
    parts += [markdown_side_by_side(beside) for beside in side_by_side(tables)]
    return "\n".join(parts)


class _Row(NamedTuple):
    """A condition's cells as text; one of `ours` and `paper` for each column."""

    name: str
    seeds: str
    ours: list[str]
    paper: list[str]


class _Grid(NamedTuple):
    """A table's cells as text, before any markup; `chance` is empty where it is not known."""

    columns: list[str]
    rows: list[_Row]
    chance_name: str
    chance: list[str]

    @property
    def has_paper(self) -> bool:
        return any(text != NONE for row in self.rows for text in row.paper)

    def beside(self, row: _Row) -> list[str]:
        """The row's cells, the paper's beside ours where there are any."""
        if not self.has_paper:
            return row.ours
        return [text for pair in zip(row.ours, row.paper, strict=True) for text in pair]

    @property
    def chance_beside(self) -> list[str]:
        if not self.has_paper:
            return self.chance
        return [text for cell in self.chance for text in (cell, "")]


def _grid(table: ScoreTable) -> _Grid:
    return _grid_of(table.scores, LEVEL_NAMES, measured=bool(table.chance_episodes))


def _train_grid(table: ScoreTable) -> _Grid:
    columns = {group: short_name(group) for group in table.train_groups}
    return _grid_of(table.train_scores, columns, measured=bool(table.chance_episodes))


def _grid_of(scores: pd.DataFrame, columns: Mapping[str, str], *, measured: bool) -> _Grid:
    """The grid of a `score_table`, with a heading for each level kind."""
    rows = []
    for condition in scores["condition"].unique():
        row = scores[scores["condition"] == condition].set_index("level_kind").reindex(columns)
        published = zip(row["paper_value"], row["paper_error"], strict=True)
        rows.append(
            _Row(
                name=condition_name(condition),
                seeds=seeds_text(int(row["seeds"].min())),
                ours=[score_text(*pair) for pair in zip(row["median"], row["mad"], strict=True)],
                paper=[score_text(*pair) for pair in published],
            )
        )
    chance = scores.groupby("level_kind")["chance"].first().reindex(list(columns))
    return _Grid(
        columns=list(columns.values()),
        rows=rows,
        chance_name="Chance (measured)" if measured else "Chance",
        chance=[score_text(value) for value in chance] if chance.notna().any() else [],
    )


def _grids(beside: SideBySide) -> list[tuple[str, _Grid]]:
    return [
        (title, _grid_of(scores, {c: c for c in columns}, measured=beside.chance_is_measured))
        for title, columns, scores in beside.parts
    ]


def _print_grid(grid: _Grid, title: str, console: Console) -> None:
    shown = Table(title=escape(title), title_style="bold", title_justify="left")
    shown.add_column("Condition")
    shown.add_column("Seeds", justify="right", no_wrap=True)
    for column in grid.columns:
        fits = len(column) <= len(LEVEL_NAMES["train"])
        shown.add_column(escape(column), justify="right", no_wrap=fits, overflow="fold")
    for row in grid.rows:
        shown.add_row(escape(row.name), row.seeds, *row.ours)
        if any(text != NONE for text in row.paper):
            shown.add_row("[dim]  paper[/dim]", "", *(f"[dim]{text}[/dim]" for text in row.paper))
    if grid.chance:
        shown.add_section()
        shown.add_row(grid.chance_name, "", *grid.chance)
    console.print(shown)


def _markdown_grid(grid: _Grid) -> str:
    header, align = ["Condition", "Seeds"], [":--", "--:"]
    for column in grid.columns:
        header += [_markdown_escape(column)] + (["paper"] if grid.has_paper else [])
        align += ["--:"] * (2 if grid.has_paper else 1)
    lines = [header, align]
    lines += [[_markdown_escape(row.name), row.seeds, *grid.beside(row)] for row in grid.rows]
    if grid.chance:
        lines.append([grid.chance_name, "", *grid.chance_beside])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _range_text(counts: Sequence[int]) -> str:
    low, high = count_text(min(counts)), count_text(max(counts))
    return low if low == high else f"{low} to {high}"


_RUN_COLUMNS = [
    "Condition",
    "Seed",
    "Updates",
    "Frames",
    "Wall time",
    "Device",
    "PyTorch",
    "zipf",
    "Commit",
]


def _run_cells(run: Run) -> list[str]:
    description = run.description
    return [
        _markdown_escape(condition_name(description.condition)),
        str(description.seed),
        count_text(run.updates),
        count_text(run.frames),
        duration_text(run.seconds),
        f"{description.device}, {description.precision}",
        description.torch,
        description.version,
        _commit_text(description.commit),
    ]


def _commit_text(commit: str | None) -> str:
    """The commit, shortened, with what a run adds to it ("+changes")."""
    identifier, plus, addition = (commit or NONE).partition("+")
    return f"{identifier[:10]}{plus}{addition}"


def _markdown_escape(text: str) -> str:
    return re.sub(r"([|*_<])", r"\\\1", text)


_LATEX_HEAD = r"""% Compiles by itself; a paper that loads booktabs and docmute can also \input it.
\documentclass{article}
\usepackage[margin=2cm]{geometry}
\usepackage{booktabs}
\begin{document}

"""

_LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "–": "--",
    **{character: "\\" + character for character in "&%$#_{}"},
    **{character: f"${character}$" for character in "<>|"},
}


def _latex_escape(text: str) -> str:
    escaped = [_LATEX_SPECIAL.get(character, character) for character in text.replace("--", "-\0-")]
    return "".join(escaped).replace("\0", "{}")  # keeps "--" from becoming a dash


def _latex_tables(table: ScoreTable) -> list[str]:
    text = caption(table) + "".join(f" {note}" for note in table.notes)
    parts = [_latex_grid(_grid(table), table.title, text, table.name)]
    if table.train_groups:
        title = f"{table.title}: train levels"
        parts.append(_latex_grid(_train_grid(table), title, "", f"{table.name}-train"))
    return parts


def _latex_side_by_side(beside: SideBySide) -> list[str]:
    return [
        _latex_grid(grid, title, beside.caption, f"{beside.name}-{number}")
        for number, (title, grid) in enumerate(_grids(beside))
    ]


def _latex_grid(grid: _Grid, title: str, text: str, label: str) -> str:
    count = len(grid.columns)
    width = 2 if grid.has_paper else 1
    lines = [
        r"\begin{table}",
        r"\centering",
        r"\footnotesize",
        rf"\setlength{{\tabcolsep}}{{{4 if count <= len(LEVEL_NAMES) else 3}pt}}",
        rf"\begin{{tabular}}{{lr{'r' * width * count}}}",
        r"\toprule",
    ]
    names = [_latex_escape(column) for column in grid.columns]
    if grid.has_paper:
        spans = [rf"\multicolumn{{2}}{{c}}{{{name}}}" for name in names]
        lines.append(rf" & & {' & '.join(spans)} \\")
        ends = range(3, 3 + 2 * count, 2)
        lines.append("".join(rf"\cmidrule(lr){{{first}-{first + 1}}}" for first in ends))
        lines.append(rf"Condition & Seeds{' & ours & paper' * count} \\")
    else:
        lines.append(rf"Condition & Seeds & {' & '.join(names)} \\")
    lines.append(r"\midrule")
    rows = [[row.name, row.seeds, *grid.beside(row)] for row in grid.rows]
    lines += [rf"{' & '.join(_latex_escape(cell) for cell in row)} \\" for row in rows]
    if grid.chance:
        cells = [grid.chance_name, "", *grid.chance_beside]
        lines += [r"\midrule", rf"{' & '.join(_latex_escape(cell) for cell in cells)} \\"]
    lines += [
        r"\bottomrule",
        r"\end{tabular}",
        rf"\caption{{\textbf{{{_latex_escape(title)}.}} {_latex_escape(text)}}}",
        rf"\label{{tab:{re.sub(r'[^A-Za-z0-9-]', '-', label)}}}",
        r"\end{table}",
        "",
    ]
    return "\n".join(lines) + "\n"
