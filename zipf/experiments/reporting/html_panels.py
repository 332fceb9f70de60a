"""Panels of the HTML report: interactive figures as data for Plotly, and what they have in common.

The page puts several panels beside each other, has one legend for them, and redraws them with other
traces or another horizontal axis as the reader chooses.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib.colors import to_hex
from plotly import graph_objects as go

from zipf.experiments.reporting.styles import REFERENCE_LINES, LineStyle
from zipf.experiments.reporting.tables import Row, ScoreTable
from zipf.protocol import REFERENCES

SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "triangle-down")
SHADE = "rgba(240, 205, 90, 0.25)"
GRID = "rgba(0, 0, 0, 0.12)"
INK = "#222222"
WIDTH = 2.0  # pixels, of a line

_LAYOUT: Mapping[str, Any] = {
    "template": None,
    "autosize": True,
    "height": 300,
    "margin": {"l": 54, "r": 12, "t": 34, "b": 46},
    "paper_bgcolor": "rgba(0, 0, 0, 0)",
    "plot_bgcolor": "rgba(0, 0, 0, 0)",
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": INK},
    "showlegend": False,
    "hovermode": "closest",
    "dragmode": "zoom",
    "modebar": {"bgcolor": "rgba(0, 0, 0, 0)", "color": "#888888", "activecolor": INK},
}
_AXIS: Mapping[str, Any] = {
    "gridcolor": GRID,
    "zeroline": False,
    "linecolor": INK,
    "showline": True,
    "ticks": "outside",
    "automargin": True,
}


@dataclass(frozen=True)
class LegendEntry:
    """A line of a legend; `key` is the `legendgroup` of its traces, `dash` as Plotly has it."""

    key: str
    title: str
    colour: str
    dash: str


@dataclass(frozen=True)
class Panel:
    """A figure.

    Attributes:
        name: unique in a page.
        label: what it shows, for those who do not see it.
        data, layout: as Plotly reads them.
        axes: for each choice of a horizontal axis its `title`, the `x` of each trace, and `shapes`;
            empty where there is no choice.
    """

    name: str
    label: str
    data: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    axes: Mapping[str, Mapping[str, Any]]

    @property
    def specification(self) -> dict[str, Any]:
        """What the page's script draws."""
        return {"data": self.data, "layout": self.layout, "axes": self.axes}


def legend(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[LegendEntry]:
    """The rows of a table and the references that are known."""
    entries = []
    for row in table.rows:
        style = styles[row.key]
        entries.append(LegendEntry(row_key(row), row.title, style.color, dash(style.linestyle)))
    for one in REFERENCES:
        if table.reference(one.name):
            drawn = reference_line(one.name)
            title = f"{one.title} ({one.hint})"
            entries.append(LegendEntry(one.name, title, drawn["color"], drawn["dash"]))
    return entries


def line(
    row: Row,
    style: LineStyle,
    hover: str,
    *,
    width: float = WIDTH,
    opacity: float = 1.0,
    symbol: int | None = None,
) -> go.Scatter:
    """A line of a row, without points.

    Args:
        hover: what is shown of a point, as Plotly's `hovertemplate`.
        symbol: number of the marker; None: no markers.
    """
    marker = {} if symbol is None else {"symbol": SYMBOLS[symbol % len(SYMBOLS)], "size": 6}
    return go.Scatter(
        name=plain(row.title),
        legendgroup=row_key(row),
        mode="lines" if symbol is None else "lines+markers",
        line={"color": style.color, "dash": dash(style.linestyle), "width": width},
        marker=marker,
        opacity=opacity,
        hovertemplate=hover,
    )


def level_line(reference: str, score: float) -> go.Scatter:
    """The horizontal line of a reference between two places, which are to be set."""
    (one,) = (one for one in REFERENCES if one.name == reference)
    return go.Scatter(
        y=[score, score],
        name=one.title,
        legendgroup=one.name,
        mode="lines",
        line={**reference_line(reference), "width": 1.4},
        hovertemplate="%{y:.3f}",
    )


def layout(
    title: str,
    *,
    x: Mapping[str, Any],
    y: Mapping[str, Any],
    shapes: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """The layout of a panel; `x` and `y` are its axes, with at least a title."""
    return {
        **_LAYOUT,
        "title": {
            "text": f"<b>{plain(title)}</b>",
            "font": {"size": 14},
            "x": 0,
            "xref": "paper",
            "xanchor": "left",
        },
        "xaxis": {**_AXIS, **x, "title": {"text": plain(x["title"]), "standoff": 8}},
        "yaxis": {**_AXIS, **y, "title": {"text": plain(y["title"]), "standoff": 8}},
        "shapes": list(shapes),
    }


def shade(start: float, end: float) -> dict[str, Any]:
    """A shaded interval of the horizontal axis."""
    return {
        "type": "rect",
        "xref": "x",
        "yref": "paper",
        "x0": float(start),
        "x1": float(end),
        "y0": 0,
        "y1": 1,
        "layer": "below",
        "line": {"width": 0},
        "fillcolor": SHADE,
    }


def panel(
    name: str, label: str, figure: go.Figure, axes: Mapping[str, Mapping[str, Any]] | None = None
) -> Panel:
    """A figure as a panel of the page."""
    drawn = figure.to_plotly_json()
    return Panel(name, label, drawn["data"], drawn["layout"], axes or {})


def row_key(row: Row) -> str:
    """The `legendgroup` of a row, which no reference has."""
    return f"row {row.key}"


def dash(linestyle: Any) -> str:
    """A Matplotlib line style as Plotly's, in pixels."""
    if linestyle == "-":
        return "solid"
    if linestyle == ":":
        return "2px,3px"
    return ",".join(f"{part * 1.6:g}px" for part in linestyle[1])


def reference_line(name: str) -> dict[str, str]:
    """How a reference's line looks."""
    drawn = REFERENCE_LINES[name]
    return {"color": to_hex(drawn["color"]), "dash": dash(drawn["linestyle"])}


def log_ticks(values: Sequence[float]) -> dict[str, Any]:
    """A logarithmic axis for these values, which are positive: ticks at 1, 2 and 5 times the powers
    of ten, or at these alone over more than three of them."""
    low, high = min(values), max(values)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < 1000 * low else (1,)
    ticks = [float(f"{step}e{power}") for power in powers for step in steps]
    return {"type": "log", "tickmode": "array", "tickvals": ticks}


def numbers(values: Any) -> list[Any]:
    """As a list, None for NaN. Plotly would encode an array, which a page then does not show."""
    return [None if pd.isna(value) else value for value in pd.Series(values).tolist()]


def plain(text: str) -> str:
    """Text that Plotly shows as it is: it reads some of HTML."""
    return html.escape(text, quote=False)
