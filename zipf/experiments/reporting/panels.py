"""What a figure of a report is: panels of lines, bands, shades, markers and axes; and its colours.

`charts.py` makes figures of tables, `draw_matplotlib.py` draws them, for files and for the page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.tables import ScoreTable

Dash = tuple[float, ...]  # lengths of dashes and gaps in line widths; () is a solid line
Numbers = Sequence[float] | NDArray[np.float64] | pd.Series

# Okabe and Ito (2008): told apart with any colour vision. Yellow is left out (too light for lines),
# and so is orange (too near vermilion); olive and wine are from Tol's muted colours (2021). Greys
# are kept for baselines, the paper, and rows that are not in colour.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#999933", "#56B4E9", "#882255", "#000000")
MOST_IN_COLOUR = 6  # ours: more lines than that cannot be told apart
TOO_NEAR = 90  # ours: as far as light blue and cyan are apart, or two greens
OTHERS = "#C4C4C4"  # of rows that are not in colour
GREY = "#7F7F7F"
RARE_COLOUR = "#D55E00"
LINES: Mapping[str, Dash] = {"solid": (), "dashed": (5, 1.5)}
DASHES: tuple[Dash, ...] = (*LINES.values(), (1.5, 1), (5, 1.5, 1.5, 1.5))
MARKERS = "osDPX^"  # Matplotlib's
WIDTH = 1.8  # points, of a line
LABEL_LETTERS = 20  # of a line of a label at a curve's end


@dataclass(frozen=True)
class Line:
    """A line of a panel."""

    x: Numbers  # [n], NaN where there is no point
    y: Numbers  # [n]
    colour: str  # #rrggbb
    dash: Dash = ()
    key: str = ""  # lines of one key are hidden together
    title: str = ""  # empty for none
    labelled: bool = False  # whether its title stands at its end, and not in the legend
    # width, size: of the line and of its markers, in points
    width: float = WIDTH
    marker: str = ""  # one of `MARKERS`; empty for none
    filled: bool = True  # whether its markers are
    size: float = 3.5
    joined: bool = True  # whether its points are joined
    opacity: float = 1.0
    behind: bool = False  # whether it is below the others
    # low, high: the ends of a band around it [n]
    low: Numbers | None = None
    high: Numbers | None = None
    points: Sequence[str] = ()  # what a page shows of each point [n]; empty for nothing

    @property
    def is_drawn(self) -> bool:
        """Whether it has a point."""
        return bool(np.isfinite(np.asarray(self.x, float) * np.asarray(self.y, float)).any())


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
    """Lines on two axes."""

    title: str
    lines: Sequence[Line]
    x: Axis
    y: Axis


@dataclass(frozen=True)
class Chart:
    """A figure: panels in a row with one legend."""

    kind: str  # as in the names of files
    table: str  # the title of the table that it is of
    subject: str  # what it shows
    panels: Sequence[Panel]
    # shaded, band, grey: what shades, bands and grey lines are; empty where there are none
    shaded: str = ""
    band: str = ""
    grey: str = ""
    note: str = ""  # how to read it on a page
    # width, height: in inches, without legend and labels; None for a width by the number of panels
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
    # the first and the last of the ranks that are framed, of either, from 0
    frames: Sequence[tuple[tuple[int, int], tuple[int, int]]]
    note: str


def legend(panels: Sequence[Panel]) -> list[Line]:
    """The first line of each key that has a title and is drawn."""
    found: dict[str, Line] = {}
    for line in (line for panel in panels for line in panel.lines):
        if line.title and line.is_drawn:
            found.setdefault(line.key, line)
    return list(found.values())


# --- what a row looks like -------------------------------------------------------------------


class LineStyle(NamedTuple):
    """How an agent looks in every figure."""

    colour: str
    dash: Dash


class Looks(NamedTuple):
    """How the agents of a report look, and which rows are in colour."""

    styles: Mapping[str, LineStyle]  # by `Row.agent`
    coloured: Mapping[str, Sequence[str]]  # the keys of rows, by the table's name
    rule: Mapping[str, str]  # which rows these are, by the table's name; empty where all are

    def of(self, table: ScoreTable, row: Row) -> LineStyle:
        """How a row looks in the figures of a table."""
        if row.key in self.coloured[table.name]:
            return self.styles[row.agent]
        return LineStyle(OTHERS, ())


def looks_of(tables: Sequence[ScoreTable], highlight: Sequence[str] = ()) -> Looks:
    """How the rows of a report look: the conditions of `highlight` in colour, or else up to six of
    a table, the best by validation score, or by training score where there is no validation. Never
    by a score that is reported."""
    coloured, rules = {}, {}
    for table in tables:
        keys = [row.key for row in table.rows if row.condition in highlight]
        rules[table.name] = "as chosen" if len(keys) < len(table.rows) else ""
        if not keys:
            keys, rules[table.name] = _best(table)
        coloured[table.name] = keys
    rows = [row for table in tables for row in table.rows]
    shown = {row.agent for table in tables for row in table.rows if row.key in coloured[table.name]}
    return Looks(line_styles(rows, shown), coloured, rules)


def _best(table: ScoreTable) -> tuple[list[str], str]:
    if len(table.rows) <= MOST_IN_COLOUR:
        return [row.key for row in table.rows], ""
    scores = table.scores.pivot(index="row", columns="level_kind", values="score")
    scores = scores.reindex([row.key for row in table.rows])
    validated = "validation" in scores and scores["validation"].notna().any()
    kind = "validation" if validated else "train"
    best = scores[kind].sort_values(ascending=False, kind="stable").index[:MOST_IN_COLOUR]
    rule = f"the {MOST_IN_COLOUR} best by {'validation' if validated else 'training'} score"
    return [row.key for row in table.rows if row.key in best], rule


def line_styles(rows: Sequence[Row], first: Iterable[str] = ()) -> dict[str, LineStyle]:
    """A style for each agent, for all figures of a report; those of `first` choose first.

    An agent has the colour and the line that its condition gives it. If another before it has the
    same, or one of `first`, seen together with it, nearly the same colour, or it has no colour, it
    gets the next free style, with its own line as long as there is one.
    """
    order = [row.runs[0].description.row_order for row in rows]
    numbers = sorted(range(len(rows)), key=lambda k: (rows[k].agent not in first, order[k]))
    wanted: dict[str, Row] = {}
    for row in (rows[k] for k in numbers):
        wanted.setdefault(row.agent, row)
    styles: dict[str, LineStyle] = {}

    def is_near(agent: str, style: LineStyle) -> bool:
        """Whether one that is seen together with the agent has about this colour."""
        seen = [styles[other].colour for other in styles if other in first and agent in first]
        return any(_distance(style.colour, colour) < TOO_NEAR for colour in seen)

    for agent, row in wanted.items():
        if row.colour is not None:
            style = LineStyle(row.colour.upper(), LINES[row.line])
            if style not in styles.values() and not is_near(agent, style):
                styles[agent] = style
    for agent, row in wanted.items():
        if agent not in styles:
            dashes = sorted(DASHES, key=lambda dash: dash != LINES[row.line])
            every = [LineStyle(colour, dash) for dash in dashes for colour in COLOURS]
            free = [style for style in every if style not in styles.values()]
            apart = [style for style in free if not is_near(agent, style)]
            styles[agent] = (apart or free or [every[len(styles) % len(every)]])[0]
    return styles


def _distance(one: str, other: str) -> float:
    """How far two colours (#rrggbb) are apart, of 441."""
    return math.dist(bytes.fromhex(one[1:]), bytes.fromhex(other[1:]))
