"""Figures of a report as data: from tables to panels of lines, bands, shades, markers and axes.

`draw_matplotlib.py` draws them as pictures, `draw_plotly.py` on the page of the report.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zipf.experiments.records.descriptions import LevelGroup
from zipf.experiments.records.results import Run, aligned, devices_of
from zipf.experiments.records.wording import KIND_NAMES, spoken
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.scores import seed_means
from zipf.experiments.reporting.situations import (
    Measure,
    baseline_by_rank,
    baseline_on_uniform,
    measure_of,
    rank_counts,
    rare_ranks,
    rates,
    rates_by_visits,
    shares,
    situation_names,
    spans,
    visit_names,
)
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import (
    LastEvaluations,
    OwnWindows,
    ScaledWindow,
    UpdateWindow,
    evaluations_inside,
)
from zipf.protocol import BASELINES

Dash = tuple[float, ...]  # lengths of dashes and gaps in line widths; () is a solid line
Numbers = Sequence[float] | pd.Series

# Okabe and Ito (2008): told apart with any colour vision. Yellow is left out (too light for lines),
# and so is orange (too near vermilion); olive and wine are from Tol's muted colours (2021). Grey is
# kept for baselines.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#999933", "#56B4E9", "#882255", "#000000")
RARE_COLOUR = "#D55E00"
LINES: Mapping[str, Dash] = {"solid": (), "dashed": (5, 1.5)}
DASHES: tuple[Dash, ...] = (*LINES.values(), (1.5, 1), (5, 1.5, 1.5, 1.5))
MARKERS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "star", "triangle-down")
WIDTH = 1.8  # points, of a line
_BASELINE_LINES: tuple[Mapping[str, Any], ...] = (
    {"colour": "#808080", "dash": (1, 1.65), "width": 1.6},
    {"colour": "#333333", "dash": (7, 2, 1.5, 2), "width": 1.1},
    {"colour": "#808080", "dash": (7, 2, 1.5, 2, 1.5, 2), "width": 1.1},
    {"colour": "#333333", "dash": (10, 3), "width": 1.1},
)
BASELINE_LINES = dict(zip((one.name for one in BASELINES), _BASELINE_LINES, strict=True))
KIND_STYLES: Mapping[str, Mapping[str, Any]] = {
    "train": {"colour": "#0072B2", "marker": "circle"},
    "uniform": {"colour": "#999933", "marker": "square"},
    "rare": {"colour": RARE_COLOUR, "marker": "diamond"},
}
NAMES: Mapping[Measure, str] = {"success": "Success", "return": "Mean return"}
INTERVALS: Mapping[Measure, str] = {
    "success": "95 % Wilson interval (of episodes)",
    "return": "95 % interval (1.96 standard errors across evaluations)",
}
ZERO = 0.1  # where 0 stands on a logarithmic axis of counts
TIME = "time"


# --- what a figure is ------------------------------------------------------------------------


@dataclass(frozen=True)
class Line:
    """A line of a panel."""

    # [n] for each choice of the horizontal axis; NaN where there is no point
    x: Mapping[str, Numbers]
    y: Numbers  # [n]
    colour: str  # #rrggbb
    dash: Dash = ()
    key: str = ""  # lines of one key are hidden together
    title: str = ""  # of its entry in the legend; empty for none
    # width, size: of the line and of its markers, in points
    width: float = WIDTH
    marker: str = ""  # one of `MARKERS`; empty for none
    size: float = 3.5
    joined: bool = True  # whether its points are joined
    opacity: float = 1.0
    behind: bool = False  # whether it is below the others
    # low, high: the ends of a band around it [n]
    low: Numbers | None = None
    high: Numbers | None = None
    # the lines that it sums up. Where there is room for them they are drawn, in the place of the
    # band.
    members: Sequence[Line] = ()
    # what a page shows of a point, as Plotly's `hovertemplate`; its `customdata` are `numbers`, for
    # each point
    hover: str = ""
    numbers: Sequence[Any] = ()

    def is_drawn(self, choice: str) -> bool:
        """Whether it has a point."""
        places = np.asarray(self.x[choice], float)
        return bool(np.isfinite(places * np.asarray(self.y, float)).any())


@dataclass(frozen=True)
class Axis:
    """An axis of a panel."""

    title: str
    limits: tuple[float, float] | None = None  # None for what its lines need
    log: bool = False
    # places and texts; None for round numbers
    ticks: tuple[Sequence[float], Sequence[str]] | None = None
    whole: bool = False  # whether it counts, in whole numbers (`20k`)
    shades: Sequence[tuple[float, float]] = ()  # intervals that are shaded
    above: tuple[str, float] | None = None  # title and scale of an axis at the other side


@dataclass(frozen=True)
class Panel:
    """Lines on two axes; `x` are the choices of the horizontal one."""

    title: str
    lines: Sequence[Line]
    x: Mapping[str, Axis]
    y: Axis


@dataclass(frozen=True)
class Chart:
    """A figure: panels in a row with one legend."""

    kind: str  # as in the names of files
    table: str  # the title of the table that it is of
    subject: str  # what it shows
    panels: Sequence[Panel]  # with the same choices of the horizontal axis
    choice: str = ""  # the one that is meant where nobody chooses
    # shaded, band: what shades and bands are; empty where there are none
    shaded: str = ""
    band: str = ""
    note: str = ""  # how to read it on a page
    # width, height: in inches, without the legend; None for a width by the number of panels
    width: float | None = None
    height: float = 3.2


@dataclass(frozen=True)
class HeatMaps:
    """A picture of all situations for each row of a table; situations have two ranks."""

    kind: str
    table: str
    subject: str
    names: tuple[str, str]  # of the ranks, downwards and to the right
    # title and values [first rank, second rank] each, NaN where there is no episode
    maps: Sequence[tuple[str, NDArray[np.float64]]]
    limits: tuple[float, float]  # of the values
    label: str  # what the values are
    # the first and the last of the ranks that are framed, of either
    frames: Sequence[tuple[tuple[int, int], tuple[int, int]]]


def legend(panels: Sequence[Panel], choice: str | None = None) -> list[Line]:
    """The first line of each key that has a title and is drawn, with this choice of the horizontal
    axis; with any if None."""
    found: dict[str, Line] = {}
    for line in (line for panel in panels for line in panel.lines if line.title):
        if any(line.is_drawn(one) for one in ([choice] if choice is not None else line.x)):
            found.setdefault(line.key, line)
    order = list(dict.fromkeys(line.key for panel in panels for line in panel.lines))
    return sorted(found.values(), key=lambda line: order.index(line.key))


class LineStyle(NamedTuple):
    """How a row looks in every figure."""

    colour: str
    dash: Dash


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


# --- the figures of a table ------------------------------------------------------------------


def charts(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Iterator[Chart | HeatMaps]:
    """Every figure that a table has data for."""
    every = (
        learning_curves(table, styles),
        averages(table),
        frequencies(table),
        by_rank(table, styles),
        by_situation(table),
        by_visits(table, styles),
    )
    return (chart for chart in every if chart is not None)


def learning_curves(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Chart | None:
    """Score against updates, frames and time: a panel per level kind, a line per row.

    The line is the median over seeds at each update, the band reaches from the lowest to the
    highest seed; the window is shaded; an axis above counts frames. Where rows learn from different
    numbers of frames in an update, and with an external agent, whose updates are not ours, the
    scores are drawn against frames: at one place of the axis all have had the same experience.

    Time is in hours, or in minutes below two hours: that of training and evaluation together,
    without external agents, whose time is not known. Where runs were on different devices there is
    none.
    """
    found = {
        (row.key, levels.level_kind): [_curve(row, run, levels) for run in row.runs]
        for row in table.rows
        for levels in table.kinds
    }
    every = pd.concat([seed for seeds in found.values() for seed in seeds], ignore_index=True)
    if not len(every):
        return None
    axes = _time_axes(table, every)
    limits = _score_limits(table, every["score"])
    several = any(len(row.runs) > 1 for row in table.rows)
    panels = []
    for levels in table.kinds:
        kind = levels.level_kind
        lines = [_median(row, styles, found[row.key, kind], axes) for row in table.rows]
        for one in BASELINE_LINES:
            if kind in (known := table.baseline(one)):
                ends = {name: axis.limits or (0.0, 1.0) for name, axis in axes.items()}
                lines.append(_baseline_line(one, ends, [known[kind]] * 2))
        panels.append(Panel(KIND_NAMES[kind], lines, axes, Axis("Score", limits)))
    shaded = any(axis.shades for axis in axes.values())
    return Chart(
        "learning",
        table.title,
        "learning curves",
        panels,
        choice="update" if frames_follow_updates(table) else "frames",
        shaded="Window of the table" if shaded else "",
        band="Lowest to highest seed" if several else "",
        note=("Thick: median over seeds; thin: each seed." if several else "One seed.")
        + (" Shaded: the window of the table." if shaded else ""),
    )


def _curve(row: Row, run: Run, levels: LevelGroup) -> pd.DataFrame:
    means = run.mean_scores(levels)
    return means.assign(seconds=math.nan) if row.external else means


def _median(
    row: Row,
    styles: Mapping[str, LineStyle],
    seeds: Sequence[pd.DataFrame],
    axes: Mapping[str, Axis],
) -> Line:
    """The median of a row's seeds at each update."""
    pooled = pd.concat(aligned(seeds)).groupby("update")
    middle = pooled[["frames", "seconds", "score"]].median().reset_index()
    several = len(seeds) > 1
    length = 3600 if TIME in axes and axes[TIME].title.startswith("Hours") else 60

    def line(frame: pd.DataFrame, title: str, **more: Any) -> Line:
        places = {"update": frame["update"], "frames": frame["frames"]}
        places[TIME] = frame["seconds"] / length
        x = {name: places[name] for name in axes}
        hover = f"{title}: %{{y:.3f}} at %{{x:.4s}}"
        return row_line(row, styles, x, frame["score"], hover=hover, **more)

    members = [
        line(seed, f"seed {run.description.seed}", width=0.7, opacity=0.45)
        for run, seed in zip(row.runs, seeds, strict=True)
    ]
    return line(
        middle,
        "median" if several else "one seed",
        marker="circle" if len(middle) < 3 else "",
        size=3,
        low=pooled["score"].min() if several else None,
        high=pooled["score"].max() if several else None,
        members=members if several else (),
    )


def _time_axes(table: ScoreTable, every: pd.DataFrame) -> dict[str, Axis]:
    """The choices of the horizontal axis of learning curves; `every` are all their points."""
    last = every.iloc[int(every["update"].to_numpy().argmax())]
    above = ("Frames", last["frames"] / last["update"]) if last["update"] else None
    axes = {}
    for name, title in (("update", "Updates"), ("frames", "Frames")):
        window = window_ends(table, name)
        axes[name] = Axis(
            title,
            (0.0, 1.02 * (float(every[name].max()) or 1.0)),
            whole=True,
            shades=[window] if window else (),
            above=above if name == "update" else None,
        )
    seconds = float(every["seconds"].max())
    if seconds > 0 and len(devices_of(table.runs)) < 2:
        unit, length = ("Hours", 3600) if seconds >= 2 * 3600 else ("Minutes", 60)
        title = f"{unit} of training and evaluation"
        axes[TIME] = Axis(title, (0.0, 1.02 * seconds / length))
    return axes


def _score_limits(table: ScoreTable, scores: pd.Series) -> tuple[float, float]:
    """0 to 1 for success-like scores; whatever is needed beyond."""
    known = [value for one in BASELINE_LINES for value in table.baseline(one).values()]
    low, high = min(0.0, scores.min(), *known), max(1.0, scores.max(), *known)
    return low - (0.05 * (high - low) if low < 0 else 0.0), high + 0.02 * (high - low)


def frames_follow_updates(table: ScoreTable) -> bool:
    """Whether all rows learn from the same number of frames in an update."""
    if any(row.external for row in table.rows):
        return False
    ends = [run.evaluations.iloc[-1] for run in table.runs if len(run.evaluations)]
    return len({end["frames"] / end["update"] for end in ends if end["update"]}) <= 1


def window_ends(table: ScoreTable, time: str) -> tuple[float, float] | None:
    """Between which updates or frames the window lies; None if there is none to show, or in frames
    if it is not the same for all rows."""
    if isinstance(table.window, LastEvaluations | OwnWindows):
        return None
    own = [run for run in table.runs if not run.description.external and len(run.evaluations)]
    lasts = {int(run.evaluations["update"].max()) for run in own}
    last = max(lasts, default=0)
    if table.window.start > last and isinstance(table.window, UpdateWindow):
        return None
    if time == "update" and isinstance(table.window, ScaledWindow):
        each = {table.window.inside(one) for one in lasts}
        return each.pop() if len(each) == 1 else None
    if time == "update":
        return (table.window.start, min(table.window.end, 1.02 * max(last, 1)))
    inside = [evaluations_inside(run, table.window)["frames"] for run in own]
    ends = {(frames.min(), frames.max()) for frames in inside if len(frames)}
    return ends.pop() if len(ends) == 1 else None


def averages(table: ScoreTable) -> Chart | None:
    """The misleading average: a line for each row, its scores on the three kinds of levels, each
    with its lowest and highest seed; those of policies that do not learn below, in grey.

    After the paper's figure of one agent, almost perfect on the training distribution and below
    60 % on the rarest objects. None without a score.
    """
    scores = table.scores.pivot(index="row", columns="level_kind", values="score")[[*KIND_STYLES]]
    rows = [row for row in table.rows if scores.loc[row.key].notna().any()]
    if not rows:
        return None
    names = [row.title for row in rows]
    points = [pd.Series(scores.loc[row.key]) for row in rows]
    for one in BASELINES:
        if baseline := table.baseline(one.name):
            names.append(one.title)
            points.append(pd.Series(baseline).reindex(scores.columns))
    titles = [textwrap.fill(name, 34) for name in names]
    # The first line of a title needs a row, each further one less than half of that.
    heights = np.array([1 + 0.45 * title.count("\n") for title in titles])
    places = np.cumsum(heights) - heights / 2 - 0.5  # titles of one line are at 0, 1, 2, ...
    lines, ranges = [], False
    for number, (place, of_kinds) in enumerate(zip(places, points, strict=True)):
        learns = number < len(rows)
        ends = [of_kinds.min(), of_kinds.max()]
        grey = "#BFBFBF" if learns else "#E0E0E0"
        lines.append(Line({"": ends}, [place] * 2, grey, width=2, behind=True))
        for kind, style in KIND_STYLES.items():
            score = of_kinds[kind]
            at = {"": [score]}, [place]
            if not learns:
                looks = {**style, "colour": "#8C8C8C"}
                lines.append(Line(*at, **looks, size=6.5, joined=False))
                continue
            (levels,) = (levels for levels in table.kinds if levels.level_kind == kind)
            seeds = seed_means(rows[number], levels, table.window).values()
            if len(seeds) > 1:
                ranges = True
                ends = [min(seeds), max(seeds)]
                lines.append(Line({"": ends}, [place] * 2, style["colour"], width=5, opacity=0.35))
            name = KIND_NAMES[kind]
            lines.append(Line(*at, **style, key=kind, title=name, size=6.5, joined=False))
    low, high = min(point.min() for point in points), max(point.max() for point in points)
    x = Axis("Score", (min(-0.02, low - 0.02), max(1.02, high + 0.02)))
    y = Axis("", (heights.sum() - 0.5, -0.5), ticks=(places.tolist(), titles))
    return Chart(
        "averages",
        table.title,
        "what the training score hides",
        [Panel("", lines, {"": x}, y)],
        band="Lowest to highest seed" if ranges else "",
        width=7.4,
        height=1.3 + 0.34 * heights.sum(),
    )


def frequencies(table: ScoreTable) -> Chart | None:
    """The share of episodes at each rank of the situation, on train, uniform and rare levels, both
    axes logarithmic: Zipf's law is a straight line."""
    found = {name: shares(table, name) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    every = pd.concat([of_rank["share"] for of_rank in found.values()])
    y = _log_axis("Share of episodes", every, lambda share: f"{100 * share:g} %")
    panels = []
    for name, of_rank in found.items():
        lines = []
        for kind, style in KIND_STYLES.items():
            of_kind = of_rank[of_rank["level_kind"] == kind]
            lines.append(
                Line(
                    {"": of_kind[name] + 1},  # since a logarithmic axis has no 0
                    of_kind["share"],
                    **style,
                    key=kind,
                    title=KIND_NAMES[kind],
                    hover="rank %{customdata}: %{y:.3%}",
                    numbers=of_kind[name].tolist(),
                )
            )
        count = rank_counts(table)[name]
        shaded = [(first + 0.5, last + 1.5) for first, last in spans(rare_ranks(table, name))]
        x = _log_axis(_rank_title(name), range(1, count + 1), lambda place: f"{place - 1:.0f}")
        x = replace(x, limits=(0.9, 1.1 * count), shades=shaded)
        panels.append(Panel(spoken(name), lines, {"": x}, y))
    marked = any(panel.x[""].shades for panel in panels)
    return Chart(
        "frequency",
        table.title,
        "how often situations occur",
        panels,
        shaded="Rare ranks" if marked else "",
        note="In the evaluations of all runs here."
        + (" Shaded: the ranks of the rare levels." if marked else ""),
    )


def by_rank(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Chart | None:
    """Success on the uniform levels against each rank of the situation, with 95 % intervals; the
    mean return where success is not reported.

    Baselines are drawn at each rank where they are known there, else as their mean over all ranks.
    """
    measure = measure_of(table)
    found = {name: rates(table, [name], measure=measure) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    means = {one: baseline_on_uniform(table, measure, one) for one in BASELINE_LINES}
    ranked = {one: baseline_by_rank(table, measure, one) for one in BASELINE_LINES}
    panels = []
    for name, of_rank in found.items():
        hover = "rank %{x}: %{y:.3f}, of %{customdata} episodes"
        lines = _measured(table, styles, of_rank, name, hover, "episodes")
        ends = (-0.5, rank_counts(table)[name] - 0.5)
        for one, mean in means.items():
            if mean is None:
                continue
            flat = any(other not in ranked[one] for other in found)
            addition = ", mean over ranks" if flat else ""
            if name in ranked[one]:
                values = ranked[one][name]
                lines.append(_baseline_line(one, {"": range(len(values))}, values, addition))
            else:
                lines.append(_baseline_line(one, {"": ends}, [mean] * 2, addition))
        shaded = [(first - 0.5, last + 0.5) for first, last in spans(rare_ranks(table, name))]
        x = Axis(_rank_title(name), ends, whole=True, shades=shaded)
        panels.append(Panel(spoken(name), lines, {"": x}, _measure_axis(table, measure)))
    marked = any(panel.x[""].shades for panel in panels)
    return Chart(
        "ranks",
        table.title,
        f"{NAMES[measure].lower()} against frequency rank",
        panels,
        shaded="Rare" if marked else "",
        band=INTERVALS[measure],
        note=f"On the uniform levels. Band: {INTERVALS[measure]}."
        + (" Shaded: the ranks of the rare levels." if marked else ""),
    )


def by_situation(table: ScoreTable) -> HeatMaps | None:
    """Success, or the mean return, on the uniform levels in each situation; for two-dimensional
    situations. Those without an episode are grey; the rare ones are framed."""
    names = situation_names(table)
    if len(names) != 2:
        return None
    measure = measure_of(table)
    found = rates(table, names, measure=measure)
    if not len(found):
        return None
    shape = tuple(rank_counts(table)[name] for name in names)
    maps = []
    for row in table.rows:
        of_row = found[found["row_key"] == row.key]
        if len(of_row):
            grid = np.full(shape, np.nan)
            places = tuple(of_row[name].to_numpy(int) for name in names)
            grid[places] = of_row["value"]
            maps.append((row.title, grid))
    values = found["value"]
    gaps = any(np.isnan(grid).any() for _, grid in maps)
    key = "rank 0: most frequent; framed: rare" + ("; grey: no episode" if gaps else "")
    down, across = (spans(rare_ranks(table, name)) for name in names)
    return HeatMaps(
        "situations",
        table.title,
        f"{NAMES[measure].lower()} by situation ({key})",
        (names[0], names[1]),
        maps,
        (0.0, 1.0) if measure == "success" else (values.min(), values.max()),
        _measure_axis(table, measure).title,
        [*itertools.product(down, across)],
    )


def by_visits(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Chart | None:
    """Success, or the mean return, on the uniform levels against how often training had met the
    situation, and each of its ranks; None where no run has counted it."""
    measure = measure_of(table)
    found = {name: rates_by_visits(table, name, measure) for name in visit_names(table)}
    found = {name: groups for name, groups in found.items() if len(groups)}
    if not found:
        return None
    panels = []
    for name, groups in found.items():
        hover = "met %{customdata[0]:.3~s} times: %{y:.3f}, of %{customdata[1]} episodes"
        groups = groups.assign(place=groups["met"].replace(0.0, ZERO))
        lines = _measured(table, styles, groups, "place", hover, ["met", "episodes"])
        rank = name.removeprefix("visits").removeprefix("_").replace("_", " ")
        x = _visits_axis(f"Times training met the {rank or 'situation'}", groups["met"])
        panels.append(
            Panel(rank.capitalize() or "Situation", lines, {"": x}, _measure_axis(table, measure))
        )
    return Chart(
        "visits",
        table.title,
        f"{NAMES[measure].lower()} against experience",
        panels,
        band=INTERVALS[measure],
        note=f"{NAMES[measure]} on the uniform levels against how often training had met the "
        f"situation, or the one rank of it, in groups by powers of two; where it was counted. "
        f"Band: {INTERVALS[measure]}.",
    )


# --- what they have in common ----------------------------------------------------------------


def row_line(
    row: Row, styles: Mapping[str, LineStyle], x: Mapping[str, Numbers], y: Numbers, **more: Any
) -> Line:
    """A line of a row of the table; `more` are attributes of the line."""
    style = styles[row.key]
    # A key that no baseline has.
    return Line(x, y, style.colour, style.dash, f"row {row.key}", row.title, **more)


def _baseline_line(name: str, x: Mapping[str, Numbers], y: Numbers, addition: str = "") -> Line:
    """The line of a policy that does not learn."""
    (one,) = (one for one in BASELINES if one.name == name)
    title = f"{one.title} ({one.hint}){addition}"
    hover = f"{one.title}: %{{y:.3f}}<extra></extra>"
    return Line(x, y, key=name, title=title, behind=True, hover=hover, **BASELINE_LINES[name])


def _measured(
    table: ScoreTable,
    styles: Mapping[str, LineStyle],
    found: pd.DataFrame,
    across: str,
    hover: str,
    numbers: str | list[str],
) -> list[Line]:
    """For each row of the table `value` against the column `across`, and the interval from `low` to
    `high`."""
    lines = []
    for number, row in enumerate(table.rows):
        of_row = found[found["row_key"] == row.key]
        lines.append(
            row_line(
                row,
                styles,
                {"": of_row[across]},
                of_row["value"],
                marker=MARKERS[number % len(MARKERS)],
                low=of_row["low"],
                high=of_row["high"],
                hover=hover,
                numbers=of_row[numbers].to_numpy().tolist(),
            )
        )
    return lines


def _measure_axis(table: ScoreTable, measure: Measure) -> Axis:
    several = any(levels.level_kind == "uniform" for levels in table.groups)
    title = f"{NAMES[measure]} on the uniform {'levels' if several else 'level'}"
    return Axis(title, (-0.02, 1.03) if measure == "success" else None)


def _rank_title(name: str) -> str:
    return f"{spoken(name)} rank (0 = most frequent)"


def _log_axis(
    title: str, values: Iterable[float], text: Callable[[float], str], most: int = 12
) -> Axis:
    """A logarithmic axis for these values, which are positive: ticks at 1, 2 and 5 times the powers
    of ten, or at every power or every second one where these would be more than `most`."""
    low, high = min(values), max(values)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    limits = low / 1.3, high * 1.3
    ticks = [float(f"{step}e{power}") for power in powers for step in (1, 2, 5)]
    for of_powers in (1, 2, 3):
        if sum(limits[0] <= tick <= limits[1] for tick in ticks) <= most:
            break
        ticks = [float(f"1e{power}") for power in powers[::of_powers]]
    ticks = [tick for tick in ticks if limits[0] <= tick <= limits[1]]
    return Axis(title, limits, log=True, ticks=(ticks, [text(tick) for tick in ticks]))


def _visits_axis(title: str, visits: pd.Series) -> Axis:
    """A logarithmic axis for numbers of times, of which 0 stands at `ZERO`."""

    def text(count: float) -> str:  # `20k`
        sizes = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (0.0, ""))
        size, letter = next(one for one in sizes if count >= one[0])
        return f"{count / (size or 1):g}{letter}"

    if visits.min() > 0:
        return _log_axis(title, visits, text, most=6)
    axis = _log_axis(title, [1.0, *visits[visits > 0]], text, most=5)
    assert axis.ticks is not None
    assert axis.limits is not None
    places, texts = axis.ticks
    return replace(
        axis, limits=(ZERO / 1.3, axis.limits[1]), ticks=([ZERO, *places], ["0", *texts])
    )
