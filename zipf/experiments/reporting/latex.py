"""Score tables as a LaTeX document."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

from zipf.experiments.reporting.grids import (
    Grid,
    caption,
    lower_grids,
    main_grid,
    side_by_side_caption,
    side_by_side_grids,
)
from zipf.experiments.reporting.seed_statistics import SeedStatistics
from zipf.experiments.reporting.side_by_side import side_by_side
from zipf.experiments.reporting.tables import ScoreTable

LINE_BREAK = r" \\ "


def latex_report(tables: Sequence[ScoreTable], statistics: Sequence[SeedStatistics] = ()) -> str:
    """`report.tex`: a document that compiles by itself, booktabs tables for each experiment, those
    of the paper, and further statistics."""
    parts = []
    for table in tables:
        text = caption(table) + "".join(f" {note}" for note in table.notes)
        parts.append(_grid(main_grid(table), table.title, text))
        parts += [_grid(grid, f"{table.title}: {grid.title}", "") for grid in lower_grids(table)]
    for beside in side_by_side(tables):
        text = side_by_side_caption(beside)
        parts += [_grid(grid, grid.title, text) for grid in side_by_side_grids(beside)]
    for one in statistics:
        for k, grid in enumerate(one.grids):
            parts.append(_grid(grid, f"{one.table.title}: {grid.title}", "" if k else one.text))
    return _HEAD + "\n".join(parts) + "\\end{document}\n"


_HEAD = r"""% Compiles by itself; a paper with booktabs, graphicx and docmute can also \input it.
\documentclass{article}
\usepackage[margin=2cm]{geometry}
\usepackage{booktabs}
\usepackage{graphicx}
\begin{document}

"""

_NO_WIDER_THAN_THE_PAGE = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "†": r"\dag{}",
    "–": "--",
    **{character: "\\" + character for character in "&%$#_{}"},
    **{character: f"${character}$" for character in "<>|[]"},
}


def _escape(text: str) -> str:
    escaped = [_SPECIAL.get(character, character) for character in text.replace("--", "-\0-")]
    return "".join(escaped).replace("\0", "{}")  # keeps "--" from becoming a dash


def _heading(text: str) -> str:
    """A heading in lines of at most 18 letters, where it has spaces."""
    wrapped = textwrap.wrap(text, 18, break_long_words=False, break_on_hyphens=False)
    lines = [_escape(line) for line in wrapped]
    return lines[0] if len(lines) == 1 else rf"\shortstack[r]{{{LINE_BREAK.join(lines)}}}"


def _grid(grid: Grid, title: str, text: str) -> str:
    widths = [2 if published else 1 for published in grid.has_paper]
    leading = len(grid.leading)
    wide = leading + sum(widths) > 8
    lines = [
        r"\begin{table}",
        r"\centering",
        r"\footnotesize",
        rf"\setlength{{\tabcolsep}}{{{3 if wide else 4}pt}}",
        _NO_WIDER_THAN_THE_PAGE,
        rf"\begin{{tabular}}{{l{'r' * (leading - 1 + sum(widths))}}}",
        r"\toprule",
    ]
    names = [_heading(column) for column in grid.columns]
    headings = " & ".join(grid.leading)
    if any(grid.has_paper):
        spans = [
            rf"\multicolumn{{{width}}}{{c}}{{{name}}}"
            for name, width in zip(names, widths, strict=True)
        ]
        lines.append(rf"{' &' * leading} {' & '.join(spans)} \\")
        firsts = [leading + 1 + sum(widths[:place]) for place in range(len(widths))]
        rules = (
            rf"\cmidrule(lr){{{first}-{first + width - 1}}}"
            for first, width in zip(firsts, widths, strict=True)
        )
        lines.append("".join(rules))
        below = (" & ours & paper" if width == 2 else " & ours" for width in widths)
        lines.append(rf"{headings}{''.join(below)} \\")
    else:
        lines.append(rf"{headings} & {' & '.join(names)} \\")
    lines.append(r"\midrule")
    rows = [*grid.lines, *grid.baselines]
    texts = [rf"{' & '.join(_escape(cell) for cell in grid.cells(row))} \\" for row in rows]
    if grid.baselines:
        texts.insert(len(grid.lines), r"\midrule")
    lines += [
        *texts,
        r"\bottomrule",
        r"\end{tabular}}",
        rf"\caption{{\textbf{{{_escape(title)}.}} {_escape(text)}}}",
        rf"\label{{tab:{re.sub(r'[^A-Za-z0-9-]', '-', grid.name)}}}",
        r"\end{table}",
        "",
    ]
    return "\n".join(lines) + "\n"
