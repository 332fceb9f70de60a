"""The figures of a report on its page: panels as data for Plotly, which redraws them with other
lines or another horizontal axis as the reader chooses."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from zipf.experiments.reporting.panels import Axis, Dash, Line, Panel

SHADE = "rgba(240, 205, 90, 0.25)"
GRID = "rgba(0, 0, 0, 0.12)"
INK = "#222222"

_LAYOUT: Mapping[str, Any] = {
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


def specification(panel: Panel, choice: str) -> dict[str, Any]:
    """What the page's script draws.

    `data` and `layout` are as Plotly reads them; `axes` have for each choice of the horizontal axis
    its `title`, the `x` of each trace, `range` and `shapes`; empty where there is no choice.
    """
    traces = [trace for line in panel.lines for trace in _traces(line)]
    axes = {
        key: {
            "title": plain(axis.title),
            "x": [x[key] for _, x in traces],
            "range": _range(axis),
            "shapes": [_shade(*ends) for ends in axis.shades],
        }
        for key, axis in panel.x.items()
    }
    title = {"text": f"<b>{plain(panel.title)}</b>", "font": {"size": 14}}
    layout = {
        **_LAYOUT,
        "title": {**title, "x": 0, "xref": "paper", "xanchor": "left"},
        "xaxis": _axis(panel.x[choice]),
        "yaxis": _axis(panel.y),
        "shapes": axes[choice]["shapes"],
    }
    data = [{**trace, "x": x[choice]} for trace, x in traces]
    return {"data": data, "layout": layout, "axes": axes if len(axes) > 1 else {}}


def _traces(line: Line) -> Iterator[tuple[dict[str, Any], dict[str, list[Any]]]]:
    """A line as Plotly's traces, and the `x` of each for every choice of the horizontal axis: first
    its members or its band, then itself."""
    if not any(line.is_drawn(choice) for choice in line.x):
        return
    for member in line.members:
        yield from _traces(member)
    common = {"type": "scatter", "name": plain(line.title), "legendgroup": line.key}
    stroke = {"color": line.colour, "dash": dash(line.dash), "width": round(1.1 * line.width, 1)}
    if line.low is not None and line.high is not None and not line.members:
        low, high = (
            pd.Series(line.low).reset_index(drop=True),
            pd.Series(line.high).reset_index(drop=True),
        )
        known = low.notna() & high.notna()  # of a single evaluation there is no interval
        band = {
            **common,
            "y": [*numbers(high[known]), *numbers(low[known][::-1])],
            "mode": "lines",
            "line": {"width": 0, "color": line.colour},
            "fill": "toself",
            "opacity": 0.15,
            "fillcolor": line.colour,
            "hoverinfo": "skip",
        }
        around = {}
        for choice, x in line.x.items():
            places = numbers(np.asarray(x)[known])
            around[choice] = [*places, *reversed(places)]
        yield band, around
    trace: dict[str, Any] = {
        **common,
        "y": numbers(line.y),
        "mode": "lines+markers" if line.marker else "lines",
        "line": stroke,
        "marker": {"symbol": line.marker, "size": 6} if line.marker else {},
        "opacity": line.opacity,
        "hovertemplate": line.hover,
    }
    if line.numbers:
        trace["customdata"] = line.numbers
    yield trace, {choice: numbers(x) for choice, x in line.x.items()}


def _axis(axis: Axis) -> dict[str, Any]:
    described: dict[str, Any] = {**_AXIS, "title": {"text": plain(axis.title), "standoff": 8}}
    if axis.limits is not None:
        described["range"] = _range(axis)
    if axis.log:
        described["type"] = "log"
    if axis.ticks is not None:
        places, texts = axis.ticks
        described |= {"tickmode": "array", "tickvals": places, "ticktext": texts}
    elif axis.whole:
        described["tickformat"] = "~s"
        if axis.limits is not None and axis.limits[1] <= 10:
            described["dtick"] = 1
    return described


def _range(axis: Axis) -> list[float] | None:
    """Plotly has the ends of a logarithmic axis as powers of ten."""
    if axis.limits is None:
        return None
    return [float(math.log10(end) if axis.log else end) for end in axis.limits]


def _shade(start: float, end: float) -> dict[str, Any]:
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


def dash(lengths: Dash) -> str:
    """Dashes and gaps in pixels, as Plotly has them."""
    return ",".join(f"{part * 1.6:g}px" for part in lengths) or "solid"


def numbers(values: Any) -> list[Any]:
    """As a list, None for NaN, which JSON does not have."""
    return [None if pd.isna(value) else value for value in pd.Series(values).tolist()]


def plain(text: str) -> str:
    """Text that Plotly shows as it is: it reads some of HTML."""
    return html.escape(text, quote=False)
