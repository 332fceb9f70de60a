"""The misleading average: training scores beside those on rare situations.

After the paper's figure of one agent, almost perfect on the training distribution and below 60 % on
the rarest objects; here of every row of a table.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from zipf.experiments.records.wording import KIND_NAMES
from zipf.experiments.reporting.scores import seed_means
from zipf.experiments.reporting.styles import RARE_COLOUR, set_title
from zipf.experiments.reporting.tables import ScoreTable
from zipf.protocol import REFERENCES

KIND_STYLES: Mapping[str, Mapping[str, Any]] = {
    "train": {"color": "#0072B2", "marker": "o"},
    "uniform": {"color": "#999933", "marker": "s"},
    "rare": {"color": RARE_COLOUR, "marker": "D"},
}
ROW = 0.34  # inches, the height of a row whose title has one line
FURTHER_LINE = 0.45  # of that, what each further line of a title needs


def averages(table: ScoreTable) -> Figure | None:
    """A line for each row: its scores on the three kinds of levels, each with its lowest and
    highest seed; those of players that do not learn below, in grey. None without a score."""
    scores = table.scores.pivot(index="row", columns="level_kind", values="score")[[*KIND_STYLES]]
    rows = [row for row in table.rows if scores.loc[row.key].notna().any()]
    if not rows:
        return None
    names = [row.title for row in rows]
    points = [pd.Series(scores.loc[row.key]) for row in rows]
    for one in REFERENCES:
        if reference := table.reference(one.name):
            names.append(one.title)
            points.append(pd.Series(reference).reindex(scores.columns))
    titles = [textwrap.fill(name, 34) for name in names]
    heights = np.array([1 + FURTHER_LINE * title.count("\n") for title in titles])
    places = np.cumsum(heights) - heights / 2 - 0.5  # titles of one line are at 0, 1, 2, ...
    figure = Figure(figsize=(7.4, 1.5 + ROW * heights.sum()), layout="constrained")
    axis = figure.subplots()
    ranges = False
    for number, (place, of_kinds) in enumerate(zip(places, points, strict=True)):
        learns = number < len(rows)
        known = of_kinds.dropna()
        line = "0.75" if learns else "0.88"
        axis.plot([known.min(), known.max()], [place, place], color=line, linewidth=2, zorder=1)
        for kind, style in KIND_STYLES.items():
            if learns:
                levels = next(one for one in table.kinds if one.level_kind == kind)
                seeds = seed_means(rows[number], levels, table.window)
                if len(seeds) > 1:
                    ranges = True
                    ends = [min(seeds.values()), max(seeds.values())]
                    axis.plot(ends, [place, place], color=style["color"], linewidth=5, alpha=0.35)
            if kind in known:
                colours = style if learns else {**style, "color": "0.55"}
                axis.plot([known[kind]], [place], markersize=6.5, linestyle="none", **colours)
    axis.set_yticks(places, titles)
    axis.set_ylim(heights.sum() - 0.5, -0.5)
    low = float(min(point.min() for point in points))
    high = float(max(point.max() for point in points))
    axis.set_xlim(min(-0.02, low - 0.02), max(1.02, high + 0.02))
    axis.set_xlabel("Score")
    handles = [
        Line2D([], [], linestyle="none", markersize=6.5, label=KIND_NAMES[kind], **style)
        for kind, style in KIND_STYLES.items()
    ]
    if ranges:  # otherwise the line between a row's scores would be taken for it
        explained = "Lowest to highest seed"
        handles.append(Line2D([], [], color="0.55", linewidth=5, alpha=0.35, label=explained))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    set_title(figure, f"{table.title}: what the training score hides")
    return figure
