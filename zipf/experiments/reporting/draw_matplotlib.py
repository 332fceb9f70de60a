"""The figures of a report as pictures, drawn by Matplotlib.

Without pyplot, so that no display is needed and no global state of a caller's is touched.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zipf.experiments.reporting.any_matplotlib import matplotlib  # before any of its modules

# isort: split
from matplotlib import axes, axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import EngFormatter, MaxNLocator, NullLocator

from zipf.experiments.records.wording import PlotFormat
from zipf.experiments.reporting.panels import (
    RARE_COLOUR,
    TIME,
    Axis,
    Chart,
    HeatMaps,
    Line,
    Panel,
    charts,
    legend,
    line_styles,
)
from zipf.experiments.reporting.tables import ScoreTable

SHADE = "#FBF1CC"
MARKERS = {
    "": None,
    "circle": "o",
    "square": "s",
    "diamond": "D",
    "cross": "P",
    "x": "X",
    "triangle-up": "^",
    "star": "*",
    "triangle-down": "v",
}
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
    "savefig.dpi": 200,
    "text.parse_math": False,
    "figure.constrained_layout.h_pad": 0.08,
}
LETTER = 0.068  # inches, the width of a letter in a legend
TITLE_LINE = 0.17  # inches, the height of a line in a panel's title
FIGURE_TITLE_LINE = 0.19  # inches, the same in a figure's title
UNDATED: Mapping[str, Any] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}


def draw(
    tables: Sequence[ScoreTable], folder: Path, format: PlotFormat = "png"
) -> dict[str, list[Path]]:
    """Draw every figure the tables have data for; the files, by the table's name.
    The same tables give the same bytes."""
    files: dict[str, list[Path]] = {}
    with style():
        for table, kind, figure in figures(tables):
            path = folder / f"{table}_{kind}.{format}"
            figure.savefig(path, format=format, metadata=UNDATED[format])
            files.setdefault(table, []).append(path)
    return files


@contextmanager
def style() -> Iterator[None]:
    """In which figures are made and drawn: nothing is the user's, of which some needs LaTeX, or
    other fonts."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**STYLE, "svg.hashsalt": "zipf"})
        yield


def figures(tables: Sequence[ScoreTable]) -> Iterator[tuple[str, str, Figure]]:
    """Every figure the tables have data for, after the table's name and the figure's kind."""
    styles = line_styles([row for table in tables for row in table.rows])
    for table in tables:
        for chart in charts(table, styles):
            for kind, figure in pictures(chart):
                yield table.name, kind, figure


class ShownFigure(Figure):
    """A figure that a notebook shows, though it is none of pyplot's."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        with style():
            self.savefig(content, format="png", dpi=90)
        return content.getvalue()


def pictures(chart: Chart | HeatMaps) -> Iterator[tuple[str, Figure]]:
    """The pictures of a figure, with their kinds: of learning curves a second one against time."""
    if isinstance(chart, HeatMaps):
        yield chart.kind, _heat_maps(chart)
        return
    yield chart.kind, picture(chart)
    time = chart.panels[0].x.get(TIME)
    if time is not None:
        unit = time.title.split()[0].lower()
        yield "hours", picture(replace(chart, subject=f"score against {unit}", choice=TIME))


def picture(chart: Chart) -> Figure:
    """A figure with panels in a row and one legend below, as many columns as its longest label
    leaves room."""
    width = chart.width or 0.6 + 3.2 * len(chart.panels)
    room = int((width - 0.7) / LETTER)
    handles: list[Any] = [
        Line2D([], [], **_style(line), label=textwrap.fill(line.title, room))
        for line in legend(chart.panels, chart.choice)
    ]
    if any(panel.x[chart.choice].shades for panel in chart.panels):
        handles.append(Patch(color=SHADE, label=chart.shaded))
    if chart.band:
        handles.append(Patch(color="0.65", alpha=0.5, label=textwrap.fill(chart.band, room)))
    labels = [handle.get_label() for handle in handles]
    widths = [0.6 + LETTER * max(map(len, label.splitlines())) for label in labels]
    fitting = len(handles) if sum(widths) <= width else int(width / max(widths))
    columns = max(1, min(len(handles), fitting))
    rows = math.ceil(sum(label.count("\n") + 1 for label in labels) / columns)
    figure = ShownFigure(figsize=(width, chart.height + 0.19 * rows), layout="constrained")
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    _set_title(figure, f"{chart.table}: {chart.subject}")
    drawn = figure.subplots(1, len(chart.panels), sharey=True, squeeze=False)[0]
    for one, panel in zip(drawn, chart.panels, strict=True):
        _draw(one, panel, chart.choice)
    drawn[0].set_ylabel(chart.panels[0].y.title)
    return figure


def _draw(drawn: axes.Axes, panel: Panel, choice: str) -> None:
    for line in panel.lines:
        x = np.asarray(line.x[choice], float)
        drawn.plot(x, line.y, **_style(line), alpha=line.opacity, zorder=1 if line.behind else 2)
        if line.low is not None and line.high is not None:
            drawn.fill_between(x, line.low, line.high, color=line.colour, alpha=0.18, linewidth=0)
    across = panel.x[choice]
    for start, end in across.shades:
        drawn.axvspan(start, end, color=SHADE, zorder=0, linewidth=0)
    if across.log:
        drawn.set_xscale("log")
    if panel.y.log:
        drawn.set_yscale("log")
    _set_ticks(drawn.xaxis, across)
    _set_ticks(drawn.yaxis, panel.y)
    drawn.set_xlim(across.limits)
    drawn.set_ylim(panel.y.limits)
    drawn.set_title(panel.title)
    drawn.set_xlabel(across.title)
    if across.above is not None:
        title, scale = across.above
        both: Any = (lambda x: x * scale, lambda x: x / scale)
        above = drawn.secondary_xaxis("top", functions=both)
        above.set_xlabel(title)
        above.xaxis.set_major_formatter(EngFormatter(sep=""))
        above.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        above.tick_params(direction="in")


def _set_ticks(drawn: axis.Axis, described: Axis) -> None:
    if described.ticks is not None:
        drawn.set_ticks(*described.ticks)
        drawn.set_minor_locator(NullLocator())
    elif described.whole:
        few = described.limits is None or described.limits[1] > 100  # large numbers need room
        drawn.set_major_locator(MaxNLocator(5 if few else 10, steps=[1, 2, 5, 10], integer=True))
        drawn.set_major_formatter(EngFormatter(sep=""))


def _style(line: Line) -> dict[str, Any]:
    dash = (0, line.dash) if line.dash else "-"
    return {
        "color": line.colour,
        "linestyle": dash if line.joined else "none",
        "linewidth": line.width,
        "marker": MARKERS[line.marker],
        "markersize": line.size,
    }


def _heat_maps(chart: HeatMaps) -> Figure:
    across = min(4, len(chart.maps))
    down = math.ceil(len(chart.maps) / across)
    titles = [textwrap.fill(title, 27) for title, _ in chart.maps]
    title_lines = sum(
        max(title.count("\n") + 1 for title in titles[first : first + across])
        for first in range(0, len(titles), across)
    )
    height = 0.7 + 2.85 * down + TITLE_LINE * title_lines
    figure = ShownFigure(figsize=(1.3 + 2.7 * across, height), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    low, high = chart.limits
    image: Any = None
    for panel, (_, grid), title in zip(panels.flat, chart.maps, titles, strict=False):
        panel.grid(False)
        panel.spines[:].set_visible(True)
        # A fixed aspect would make the constrained layout misjudge the room that labels need.
        empty = ListedColormap(["white", "0.8"])
        panel.imshow(np.isnan(grid), cmap=empty, vmin=0, vmax=1, aspect="auto")
        image = panel.imshow(grid, cmap="cividis", vmin=low, vmax=high, aspect="auto")
        for (top, bottom), (left, right) in chart.frames:
            frame = Rectangle((left - 0.5, top - 0.5), right - left + 1, bottom - top + 1)
            frame.set(fill=False, edgecolor=RARE_COLOUR, linewidth=1.8, clip_on=False, zorder=3)
            panel.add_patch(frame)
        panel.set_title(title)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.yaxis.set_major_locator(MaxNLocator(integer=True))
    for panel in panels.flat[len(titles) :]:
        panel.set_visible(False)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"{chart.names[0].capitalize()} rank")
    for column in range(across):
        lowest = max(line for line in range(down) if line * across + column < len(titles))
        panels[lowest, column].set_xlabel(f"{chart.names[1].capitalize()} rank")
        panels[lowest, column].tick_params(labelbottom=True)
    figure.colorbar(image, ax=panels, label=chart.label, shrink=0.9)
    _set_title(figure, f"{chart.table}: {chart.subject}")
    return figure


def _set_title(figure: Figure, title: str) -> None:
    """Set the title, wrapped to the figure's width, and make room for the lines after its first."""
    text = textwrap.fill(title, int(figure.get_figwidth() / 0.09))
    figure.suptitle(text, fontsize=11)
    figure.set_figheight(figure.get_figheight() + FIGURE_TITLE_LINE * text.count("\n"))
