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

from zipf.experiments.paper import LEVEL_KINDS, condition_name
from zipf.experiments.results import Run
from zipf.experiments.tables import (
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
    if table.chance:
        sentences.append("Chance: uniformly random actions.")
    if table.paper:
        sentences.append(f"Paper: {table.paper.source}, ± {table.paper.error_kind}.")
        if table.paper.note:
            sentences.append(table.paper.note)
    return " ".join(sentences)


def print_table(table: ScoreTable, console: Console) -> None:
    """Print the table, the paper's scores below ours, then its caption and notes."""
    grid = Table(title=escape(table.title), title_style="bold", title_justify="left")
    grid.add_column("Condition")
    grid.add_column("Seeds", justify="right", no_wrap=True)
    for level_kind in LEVEL_KINDS:
        grid.add_column(LEVEL_NAMES[level_kind], justify="right", no_wrap=True)
    for row in _rows(table):
        grid.add_row(escape(row.name), row.seeds, *row.ours)
        if any(text != NONE for text in row.paper):
            grid.add_row("[dim]  paper[/dim]", "", *(f"[dim]{text}[/dim]" for text in row.paper))
    if table.chance:
        grid.add_section()
        grid.add_row("Chance", "", *_chance_cells(table))
    console.print(grid)
    console.print(f"[dim]{escape(caption(table))}[/dim]", highlight=False)
    for note in table.notes:
        console.print(f"[yellow]Note:[/yellow] {escape(note)}", highlight=False)


def markdown(table: ScoreTable) -> str:
    """The table as Markdown, with its caption and notes below it."""
    header, align = ["Condition", "Seeds"], [":--", "--:"]
    for level_kind in LEVEL_KINDS:
        header += [LEVEL_NAMES[level_kind]] + (["paper"] if table.paper else [])
        align += ["--:"] * (2 if table.paper else 1)
    lines = [header, align]
    lines += [[_markdown_escape(row.name), row.seeds, *_beside(table, row)] for row in _rows(table)]
    if table.chance:
        lines.append(["Chance", "", *_chance_beside(table)])
    text = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    parts = [text, caption(table)]
    if table.notes:
        parts.append("\n".join(f"- {_markdown_escape(note)}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def markdown_report(tables: Sequence[ScoreTable], plots: Mapping[str, Sequence[Path]]) -> str:
    """`report.md`: every table, with its plots (by the table's name; files beside the report)."""
    parts = []
    for table in tables:
        parts.append(f"## {_markdown_escape(table.title)}\n\n{markdown(table)}")
        parts += [f"![{path.stem}]({path.name})\n" for path in plots.get(table.name, [])]
    return "\n".join(parts)


def linked_plots(markdown_text: str) -> list[str]:
    """The names of the plots that a `report.md` of this module shows."""
    kinds = "|".join(PLOT_KINDS)
    links = re.finditer(rf"^!\[([\w.-]+_(?:{kinds}))\]\(\1\.png\)$", markdown_text, re.MULTILINE)
    return [f"{link[1]}.png" for link in links]


def latex_report(tables: Sequence[ScoreTable]) -> str:
    """`report.tex`: a document that compiles by itself, one booktabs table per experiment."""
    body = "\n".join(_latex_table(table) for table in tables)
    return _LATEX_HEAD + body + "\\end{document}\n"


def csv_report(tables: Sequence[ScoreTable]) -> str:
    """`report.csv`: one line per condition and level kind, at full precision, empty for none."""
    return pd.concat([table.scores for table in tables]).to_csv(
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
        commands = "\n".join(run.description.command for run in table.runs)
        parts.append(f"```\n{commands}\n```\n")
    return "\n".join(parts)


class _Row(NamedTuple):
    """A condition's cells as text; one of `ours` and `paper` for each level kind."""

    name: str
    seeds: str
    ours: list[str]
    paper: list[str]


def _rows(table: ScoreTable) -> list[_Row]:
    rows = []
    for condition in table.conditions:
        scores = table.scores[table.scores["condition"] == condition]
        scores = scores.set_index("level_kind").loc[list(LEVEL_KINDS)]
        published = zip(scores["paper_value"], scores["paper_error"], strict=True)
        rows.append(
            _Row(
                name=condition_name(condition),
                seeds=seeds_text(int(scores["seeds"].min())),
                ours=[
                    score_text(*pair) for pair in zip(scores["median"], scores["mad"], strict=True)
                ],
                paper=[score_text(*pair) for pair in published],
            )
        )
    return rows


def _beside(table: ScoreTable, row: _Row) -> list[str]:
    if not table.paper:
        return row.ours
    return [text for pair in zip(row.ours, row.paper, strict=True) for text in pair]


def _chance_cells(table: ScoreTable) -> list[str]:
    return [score_text(table.chance.get(level_kind, math.nan)) for level_kind in LEVEL_KINDS]


def _chance_beside(table: ScoreTable) -> list[str]:
    cells = _chance_cells(table)
    return [text for cell in cells for text in (cell, "")] if table.paper else cells


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


def _latex_table(table: ScoreTable) -> str:
    width = 2 if table.paper else 1
    lines = [
        r"\begin{table}",
        r"\centering",
        r"\footnotesize",
        r"\setlength{\tabcolsep}{4pt}",
        rf"\begin{{tabular}}{{lr{'r' * width * len(LEVEL_KINDS)}}}",
        r"\toprule",
    ]
    names = [_latex_escape(LEVEL_NAMES[level_kind]) for level_kind in LEVEL_KINDS]
    if table.paper:
        spans = [rf"\multicolumn{{2}}{{c}}{{{name}}}" for name in names]
        lines.append(rf" & & {' & '.join(spans)} \\")
        lines.append("".join(rf"\cmidrule(lr){{{first}-{first + 1}}}" for first in range(3, 9, 2)))
        lines.append(rf"Condition & Seeds{' & ours & paper' * len(LEVEL_KINDS)} \\")
    else:
        lines.append(rf"Condition & Seeds & {' & '.join(names)} \\")
    lines.append(r"\midrule")
    rows = [[row.name, row.seeds, *_beside(table, row)] for row in _rows(table)]
    lines += [rf"{' & '.join(_latex_escape(cell) for cell in row)} \\" for row in rows]
    if table.chance:
        lines += [
            r"\midrule",
            rf"{' & '.join(_latex_escape(c) for c in ['Chance', '', *_chance_beside(table)])} \\",
        ]
    notes = "".join(f" {note}" for note in table.notes)
    lines += [
        r"\bottomrule",
        r"\end{tabular}",
        rf"\caption{{\textbf{{{_latex_escape(table.title)}.}} "
        rf"{_latex_escape(caption(table) + notes)}}}",
        rf"\label{{tab:{re.sub(r'[^A-Za-z0-9-]', '-', table.name)}}}",
        r"\end{table}",
        "",
    ]
    return "\n".join(lines) + "\n"
