"""How plots look: the line of each row, and figures whose text fits.

Figures are drawn without pyplot, so that no display is needed and no global state of a caller's is
touched.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from zipf.experiments.reporting.rows import Row
from zipf.protocol import REFERENCES

# Okabe and Ito (2008): told apart with any colour vision. Yellow is left out (too light for lines),
# and so is orange (too near vermilion); olive and wine are from Tol's muted colours (2021). Grey is
# kept for references.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#999933", "#56B4E9", "#882255", "#000000")
RARE_COLOUR = "#D55E00"
SHADE = "#FBF1CC"
LINES: Mapping[str, Any] = {"solid": "-", "dashed": (0, (5, 1.5))}
DASHES: tuple[Any, ...] = (*LINES.values(), (0, (1.5, 1)), (0, (5, 1.5, 1.5, 1.5)))
_REFERENCE_LINES: tuple[Mapping[str, Any], ...] = (
    {"color": "0.5", "linestyle": ":", "linewidth": 1.6},
    {"color": "0.2", "linestyle": (0, (7, 2, 1.5, 2)), "linewidth": 1.1},
    {"color": "0.5", "linestyle": (0, (7, 2, 1.5, 2, 1.5, 2)), "linewidth": 1.1},
    {"color": "0.2", "linestyle": (0, (10, 3)), "linewidth": 1.1},
)
REFERENCE_LINES: Mapping[str, Mapping[str, Any]] = {
    one.name: {**line, "zorder": 1} for one, line in zip(REFERENCES, _REFERENCE_LINES, strict=True)
}
BAND: Mapping[str, Any] = {"alpha": 0.18, "linewidth": 0}

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "savefig.dpi": 200,
    "text.parse_math": False,
    "figure.constrained_layout.h_pad": 0.08,
}
LETTER = 0.068  # inches, the width of a letter in a legend
TITLE_LINE = 0.17  # inches, the height of a line in a panel's title
FIGURE_TITLE_LINE = 0.19  # inches, the same in a figure's title


class LineStyle(NamedTuple):
    """How a row looks in every figure."""

    color: str
    linestyle: Any


def line_styles(rows: Sequence[Row]) -> dict[str, LineStyle]:
    """A style for each row, by its key, for all figures of a report.

    A row has the colour and the line that its condition gives it. If another row before it has the
    same, or it has no colour, it gets the next free style, with its own line as long as there is
    one.
    """
    wanted = {
        row.key: row for row in sorted(rows, key=lambda row: row.runs[0].description.row_order)
    }
    styles: dict[str, LineStyle] = {}
    for key, row in wanted.items():
        if row.colour is not None:
            style = LineStyle(row.colour.upper(), LINES[row.line])
            if style not in styles.values():
                styles[key] = style
    for key, row in wanted.items():
        if key not in styles:
            dashes = sorted(DASHES, key=lambda dash: dash != LINES[row.line])
            every = [LineStyle(colour, dash) for dash in dashes for colour in COLOURS]
            free = [style for style in every if style not in styles.values()]
            styles[key] = free[0] if free else every[len(styles) % len(every)]
    return styles


def row_handles(rows: Sequence[Row], styles: Mapping[str, LineStyle]) -> list[Any]:
    """The rows' entries of a legend."""
    return [Line2D([], [], **styles[row.key]._asdict(), label=row.title) for row in rows]


def reference_handle(name: str, addition: str = "") -> Line2D:
    """The entry of a player that does not learn in a legend."""
    (one,) = (one for one in REFERENCES if one.name == name)
    return Line2D([], [], **REFERENCE_LINES[name], label=f"{one.title} ({one.hint}){addition}")


def panels(count: int, title: str, handles: list[Any]) -> tuple[Figure, list[Axes]]:
    """Panels in a row with one legend below, as many columns as its longest label leaves room."""
    width = 0.6 + 3.2 * count
    room = int((width - 0.7) / LETTER)
    labels = [textwrap.fill(handle.get_label(), room) for handle in handles]
    for handle, label in zip(handles, labels, strict=True):
        handle.set_label(label)
    longest = max(len(line) for label in labels for line in label.splitlines())
    columns = max(1, min(len(handles), int(width / (0.6 + LETTER * longest))))
    rows = math.ceil(sum(label.count("\n") + 1 for label in labels) / columns)
    figure = Figure(figsize=(width, 3.2 + 0.19 * rows), layout="constrained")
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    set_title(figure, title)
    axes = figure.subplots(1, count, sharey=True, squeeze=False)
    return figure, list(axes[0])


def set_title(figure: Figure, title: str) -> None:
    """Set the title, wrapped to the figure's width, and make room for the lines after its first."""
    text = textwrap.fill(title, int(figure.get_figwidth() / 0.09))
    figure.suptitle(text, fontsize=11)
    figure.set_figheight(figure.get_figheight() + FIGURE_TITLE_LINE * text.count("\n"))


def score_limits(axis: Axes, scores: pd.Series) -> None:
    """0 to 1 for success-like scores; whatever is needed beyond."""
    low, high = min(0.0, scores.min()), max(1.0, scores.max())
    axis.set_ylim(low - (0.05 * (high - low) if low < 0 else 0), high + 0.02 * (high - low))
