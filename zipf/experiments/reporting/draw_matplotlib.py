"""The figures of a report, drawn by Matplotlib: as files, and as pictures within a page.

Without pyplot, so that no display is needed and no global state of a caller's is touched.
"""

from __future__ import annotations

import io
import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from zipf.experiments.reporting.any_matplotlib import matplotlib  # before any of its modules

# isort: split
from matplotlib import axes, axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import EngFormatter, MaxNLocator, NullLocator

from zipf.experiments.records.wording import PlotFormat, spoken
from zipf.experiments.reporting.charts import charts, rank_ticks
from zipf.experiments.reporting.panels import (
    LABEL_LETTERS,
    OTHERS,
    RARE_COLOUR,
    Axis,
    Chart,
    HeatMaps,
    Line,
    Looks,
    Panel,
    legend,
)
from zipf.experiments.reporting.seed_statistics import SeedStatistics

SHADE, GRID = "#FBF1CC", "#EBEBEB"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "text.parse_math": False,
    "figure.constrained_layout.h_pad": 0.08,
    "svg.hashsalt": "zipf",
}
LETTER = 0.068  # inches, the width of a letter in a legend
LABEL_SIZE = 7  # points, of a label at a curve's end
LABEL_LETTER, LABEL_LINE = 0.056, 0.115  # inches, the width of its letters, the height of its lines
TITLE_LINE = 0.17  # inches, the height of a line in a panel's title
FIGURE_TITLE_LINE = 0.19  # inches, the same in a figure's title
UNDATED: Mapping[str, Any] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
SVG, LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
# What a page has in the place of some colours, which are others where it is dark.
PAGE_COLOURS = {
    "#000000": "currentColor",
    GRID.lower(): "var(--rule)",
    SHADE.lower(): "var(--shade)",
    OTHERS.lower(): "var(--others)",
}


@contextmanager
def style() -> Iterator[None]:
    """Within it figures look as those of a report, whatever the user's settings are: some of them
    need LaTeX, or other fonts."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def draw(
    statistics: Sequence[SeedStatistics], looks: Looks, folder: Path, format: PlotFormat = "png"
) -> dict[str, list[Path]]:
    """Write every figure that tables have data for; the files, by the table's name.
    The same tables give the same bytes."""
    files: dict[str, list[Path]] = {}
    with style():
        for table, kind, figure in figures(statistics, looks):
            path = folder / f"{table}_{kind}.{format}"
            figure.savefig(path, format=format, metadata=UNDATED[format])
            files.setdefault(table, []).append(path)
    return files


def figures(
    statistics: Sequence[SeedStatistics], looks: Looks
) -> Iterator[tuple[str, str, Figure]]:
    """Every figure that tables have data for, after the table's name and the figure's kind."""
    for one in statistics:
        for chart in charts(one, looks):
            yield one.table.name, chart.kind, picture(chart)


class ShownFigure(Figure):
    """A figure that a notebook shows, though it is none of pyplot's."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        with style():
            self.savefig(content, format="png", dpi=90)
        return content.getvalue()


def picture(chart: Chart | HeatMaps, *, on_page: bool = False) -> Figure:
    """A figure. `on_page`: without title and legend, and with what `inline` needs."""
    if isinstance(chart, HeatMaps):
        return _heat_maps(chart, on_page)
    labels = [_end_labels(panel) for panel in chart.panels]
    letters = [max(map(len, text.split("\n"))) for one in labels for _, text in one]
    lines = max(sum(text.count("\n") + 1 for _, text in one) for one in labels)
    room = LABEL_LETTER * max(letters, default=0) + (0.3 if letters else 0)
    width = chart.width or 0.6 + (2.6 + room) * len(chart.panels)
    height = max(chart.height, 1.0 + LABEL_LINE * lines)
    figure = ShownFigure(figsize=(width, height), layout="constrained")
    if not on_page:
        _add_legend(figure, chart)
        _set_title(figure, f"{chart.table}: {chart.subject}")
    drawn = figure.subplots(1, len(chart.panels), sharey=True, squeeze=False)[0]
    for number, (one, panel) in enumerate(zip(drawn, chart.panels, strict=True)):
        _draw(one, panel, f"{number}-" if on_page else "")
        _label(one, panel, labels[number], height - 1.0, f"{number}-" if on_page else "")
    drawn[0].set_ylabel(chart.panels[0].y.title)
    return figure


def _add_legend(figure: Figure, chart: Chart) -> None:
    """A legend below, as many columns as its longest label leaves room, for what has no label."""
    room = int((figure.get_figwidth() - 0.7) / LETTER)
    handles: list[Any] = [
        Line2D([], [], **_style(line), label=line.title)
        for line in legend(chart.panels)
        if not line.labelled
    ]
    if chart.grey:
        handles.append(Line2D([], [], color=OTHERS, label=chart.grey))
    if any(panel.x.shades for panel in chart.panels):
        handles.append(Patch(color=SHADE, label=chart.shaded))
    if chart.band:
        handles.append(Patch(color="0.65", alpha=0.5, label=chart.band))
    if not handles:
        return
    labels = [textwrap.fill(handle.get_label(), room) for handle in handles]
    widths = [0.6 + LETTER * max(map(len, label.splitlines())) for label in labels]
    width = figure.get_figwidth()
    fitting = len(handles) if sum(widths) <= width else int(width / max(widths))
    columns = max(1, min(len(handles), fitting))
    rows = math.ceil(sum(label.count("\n") + 1 for label in labels) / columns)
    figure.set_figheight(figure.get_figheight() + 0.19 * rows)
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def _draw(drawn: axes.Axes, panel: Panel, name: str) -> None:
    """`name`: of its elements on a page; empty where there is none."""
    for number, line in enumerate(panel.lines):
        if not line.is_drawn:
            continue
        x, y = np.asarray(line.x, float), np.asarray(line.y, float)
        z = 1 if line.behind else 2
        gid = name and f"line-{name}{number}"
        drawn.plot(x, y, **_style(line), alpha=line.opacity, zorder=z, gid=gid)
        if name and line.points:
            gid = f"points-{name}{number}"
            drawn.plot(x, y, "o", color="#000000", markersize=9, alpha=0.01, zorder=5, gid=gid)
        if line.low is not None and line.high is not None:
            gid = name and f"line-{name}{number}-band"
            drawn.fill_between(
                x, line.low, line.high, color=line.colour, alpha=0.15, linewidth=0, gid=gid
            )
    for start, end in panel.x.shades:
        drawn.axvspan(start, end, color=SHADE, zorder=0, linewidth=0)
    if panel.x.log:
        drawn.set_xscale("log")
    if panel.y.log:
        drawn.set_yscale("log")
    _set_ticks(drawn.xaxis, panel.x)
    _set_ticks(drawn.yaxis, panel.y)
    drawn.set_xlim(panel.x.limits)
    drawn.set_ylim(panel.y.limits)
    drawn.set_title(panel.title)
    drawn.set_xlabel(panel.x.title)
    if panel.x.above is not None:
        title, scale = panel.x.above
        both: Any = (lambda x: x * scale, lambda x: x / scale)
        above = drawn.secondary_xaxis("top", functions=both)
        above.set_xlabel(title)
        above.xaxis.set_major_formatter(EngFormatter(sep=""))
        above.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        above.tick_params(direction="in")


def _end_labels(panel: Panel) -> list[tuple[int, str]]:
    """The lines with a label at their end, by their number, and the labels' texts."""
    return [
        (number, textwrap.fill(line.title, LABEL_LETTERS, max_lines=3, placeholder=" ..."))
        for number, line in enumerate(panel.lines)
        if line.labelled and line.is_drawn
    ]


def _label(
    drawn: axes.Axes, panel: Panel, labels: Sequence[tuple[int, str]], height: float, name: str
) -> None:
    """Write labels right of a panel, each as near its line's end as the others leave room.
    `height` is the panel's, in inches."""
    ends = []
    for number, text in labels:
        line = panel.lines[number]
        points = np.column_stack([np.asarray(line.x, float), np.asarray(line.y, float)])
        end = points[np.isfinite(points).all(axis=1)][-1]
        place = drawn.transAxes.inverted().transform(drawn.transData.transform(end))[1]
        ends.append((float(place), number, end, text))
    ends.sort(key=lambda one: one[:2])
    sizes = [LABEL_LINE * (text.count("\n") + 1) / height for *_, text in ends]
    places = apart([place for place, *_ in ends], sizes)
    for place, (_, number, end, text) in zip(places, ends, strict=True):
        colour = panel.lines[number].colour
        drawn.annotate(
            text,
            (float(end[0]), float(end[1])),
            (1.03, place),
            textcoords="axes fraction",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "alpha": 0.6},
            color=colour,
            fontsize=LABEL_SIZE,
            va="center",
            annotation_clip=False,
            gid=name and f"line-{name}{number}-label",
        )


def apart(wanted: Sequence[float], sizes: Sequence[float]) -> list[float]:
    """Places from 0 to 1, as near the wanted ones (ascending) as sizes allow."""
    places = list(wanted)
    for k in range(1, len(places)):
        places[k] = max(places[k], places[k - 1] + (sizes[k - 1] + sizes[k]) / 2)
    highest = 1.02
    for k in reversed(range(len(places))):
        places[k] = min(places[k], highest - sizes[k] / 2)
        highest = places[k] - sizes[k] / 2
    return places


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
        "marker": line.marker or None,
        "markersize": line.size,
        "markerfacecolor": line.colour if line.filled else "none",
    }


def _heat_maps(chart: HeatMaps, on_page: bool) -> Figure:
    across = min(4 if len(chart.maps) <= 12 else 6, len(chart.maps))
    size = 2.6 if across <= 4 else 1.9
    down = math.ceil(len(chart.maps) / across)
    titles = [textwrap.fill(title, int(size * 10)) for title, _ in chart.maps]
    title_lines = sum(
        max(title.count("\n") + 1 for title in titles[first : first + across])
        for first in range(0, len(titles), across)
    )
    height = 0.7 + (size + 0.15) * down + TITLE_LINE * title_lines
    figure = ShownFigure(figsize=(1.3 + size * across, height), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    low, high = chart.limits
    image: Any = None
    for panel, (_, grid), title in zip(panels.flat, chart.maps, titles, strict=False):
        panel.grid(False)
        panel.spines[:].set_visible(True)
        # Ranks count from 1. A fixed aspect would make the constrained layout misjudge the room
        # that labels need.
        extent = (0.5, grid.shape[1] + 0.5, grid.shape[0] + 0.5, 0.5)
        shown: dict[str, Any] = {"aspect": "auto", "extent": extent, "interpolation": "nearest"}
        empty = ListedColormap(["white", "0.8"])
        panel.imshow(np.isnan(grid), cmap=empty, vmin=0, vmax=1, **shown)
        image = panel.imshow(grid, cmap="cividis", vmin=low, vmax=high, **shown)
        for (top, bottom), (left, right) in chart.frames:
            frame = Rectangle((left + 0.5, top + 0.5), right - left + 1, bottom - top + 1)
            frame.set(fill=False, edgecolor=RARE_COLOUR, linewidth=1.8, clip_on=False, zorder=3)
            panel.add_patch(frame)
        panel.set_title(title, fontsize=10 if size > 2 else 8)
        panel.set_yticks(*rank_ticks(grid.shape[0]))
        panel.set_xticks(*rank_ticks(grid.shape[1]))
    for panel in panels.flat[len(titles) :]:
        panel.set_visible(False)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"{spoken(chart.names[0])} rank")
    for column in range(across):
        lowest = max(line for line in range(down) if line * across + column < len(titles))
        panels[lowest, column].set_xlabel(f"{spoken(chart.names[1])} rank")
        panels[lowest, column].tick_params(labelbottom=True)
    # As tall as one map, however many there are.
    part = min(0.9, 2.4 / height)
    figure.colorbar(
        image, ax=panels, label=chart.label, shrink=part, aspect=20 * part, anchor=(0, 1)
    )
    if not on_page:
        _set_title(figure, f"{chart.table}: {chart.subject}")
    return figure


def _set_title(figure: Figure, title: str) -> None:
    """Set the title, wrapped to the figure's width, and make room for the lines after its first."""
    text = textwrap.fill(title, int(figure.get_figwidth() / 0.09))
    figure.suptitle(text, fontsize=11)
    figure.set_figheight(figure.get_figheight() + FIGURE_TITLE_LINE * text.count("\n"))


def parts(chart: Chart | HeatMaps) -> list[Chart | HeatMaps]:
    """The pictures that a page has of a figure, so that they can stand side by side or one below
    the other: a panel each, or a map; all of a figure whose rows have names at its side."""
    if isinstance(chart, HeatMaps):
        return [replace(chart, maps=[one]) for one in chart.maps]
    if chart.width is not None:
        return [chart]
    return [replace(chart, panels=[panel]) for panel in chart.panels]


def inline(chart: Chart | HeatMaps, name: str) -> str:
    """A picture as SVG within a page, where `name` is unique. Lines have their `data-key`, and
    points a title, which browsers show below the pointer."""
    written = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "savefig.transparent": True}):
        picture(chart, on_page=True).savefig(written, format="svg", metadata=UNDATED["svg"])
    root = ElementTree.fromstring(written.getvalue())
    lines = {
        f"{number}-{place}": line
        for number, panel in enumerate(getattr(chart, "panels", ()))
        for place, line in enumerate(panel.lines)
    }
    for element in list(root.iter()):
        element.tag = element.tag.removeprefix(SVG)
        given = element.attrib
        for attribute in (LINK, "clip-path"):
            if attribute in given:
                given[attribute.rpartition("}")[2]] = given.pop(attribute).replace("#", f"#{name}-")
        what, _, place = given.pop("id", "").partition("-")
        if what == "line":
            given["data-key"] = lines["-".join(place.split("-")[:2])].key
        elif what == "points":
            _add_titles(element, lines[place])
        elif element.tag != "g" and what:
            given["id"] = f"{name}-{what}"
        for one in [one for one in element if one.tag in (f"{SVG}metadata", f"{SVG}style")]:
            element.remove(one)
        for attribute in {"d", "x", "y", "cx", "cy"} & given.keys():
            given[attribute] = re.sub(r"(\.\d)\d+", r"\1", " ".join(given[attribute].split()))
        if "font" in given.get("style", ""):  # the page has its own
            given["style"] = re.sub(r"font-family: [^;]*;? ?", "", given["style"])
        if given.get("transform", "").startswith("rotate(-0 "):
            del given["transform"]
    for attribute in ("width", "height", "version"):
        root.attrib.pop(attribute, None)
    text = ElementTree.tostring(root, encoding="unicode")
    for colour, of_page in PAGE_COLOURS.items():
        text = text.replace(colour, of_page)
    return re.sub(r">\s+<", "><", text)


def _add_titles(element: ElementTree.Element, line: Line) -> None:
    """Turn the markers of a line's points into circles with titles."""
    shown = np.isfinite(np.asarray(line.x, float) * np.asarray(line.y, float))
    texts = [text for text, known in zip(line.points, shown, strict=True) if known]
    places = [(use.get("x", ""), use.get("y", "")) for use in element.iter(f"{SVG}use")]
    element.clear()
    element.set("class", "points")
    element.set("data-key", line.key)
    for (x, y), text in zip(places, texts, strict=True):
        circle = ElementTree.SubElement(element, "circle", {"cx": x, "cy": y, "r": "6"})
        ElementTree.SubElement(circle, "title").text = text
