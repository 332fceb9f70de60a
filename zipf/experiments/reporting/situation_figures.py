"""Plots of success, or of the mean return, against the frequency ranks of the situation."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from zipf.experiments.records.wording import spoken
from zipf.experiments.reporting.situations import (
    Measure,
    measure_of,
    rank_counts,
    rare_ranks,
    rates,
    reference_by_rank,
    reference_on_uniform,
    situation_names,
    spans,
)
from zipf.experiments.reporting.styles import (
    BAND,
    RARE_COLOUR,
    REFERENCE_LINES,
    SHADE,
    TITLE_LINE,
    LineStyle,
    panels,
    reference_handle,
    row_handles,
    set_title,
)
from zipf.experiments.reporting.tables import ScoreTable

NAMES: Mapping[Measure, str] = {"success": "Success", "return": "Mean return"}
INTERVALS: Mapping[Measure, str] = {
    "success": "95 % Wilson interval (of episodes)",
    "return": "95 % interval (1.96 standard errors across evaluations)",
}


def draw_with_band(axis: Axes, lines: pd.DataFrame, across: str, style: LineStyle) -> None:
    """Draws `value` against the column `across`, and the interval from `low` to `high`."""
    axis.plot(lines[across], lines["value"], **style._asdict(), marker="o", markersize=3.5)
    axis.fill_between(lines[across], lines["low"], lines["high"], color=style.color, **BAND)


def by_rank(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Figure | None:
    """Success on the uniform levels against each rank of the situation, with 95 % intervals; the
    mean return where success is not reported.

    References are drawn at each rank where they are known there, else as their mean over all ranks.
    """
    measure = measure_of(table)
    found = {name: rates(table, [name], measure=measure) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    handles = row_handles(table.rows, styles)
    means = {one: reference_on_uniform(table, measure, one) for one in REFERENCE_LINES}
    ranked = {one: reference_by_rank(table, measure, one) for one in REFERENCE_LINES}
    for one, mean in means.items():
        if mean is not None:
            flat = any(name not in ranked[one] for name in found)
            handles.append(reference_handle(one, ", mean over ranks" if flat else ""))
    rare = {name: rare_ranks(table, name) for name in found}
    if any(rare.values()):
        handles.append(Patch(color=SHADE, label="Rare"))
    handles.append(Patch(color="0.65", alpha=0.5, label=INTERVALS[measure]))
    title = f"{table.title}: {NAMES[measure].lower()} against frequency rank"
    figure, axes = panels(len(found), title, handles)
    for axis, (name, of_rank) in zip(axes, found.items(), strict=True):
        for row in table.rows:
            of_row = of_rank[of_rank["row_key"] == row.key]
            draw_with_band(axis, of_row, name, styles[row.key])
        for one, line in REFERENCE_LINES.items():
            if name in ranked[one]:
                axis.plot(range(len(ranked[one][name])), ranked[one][name], **line)
            elif (mean := means[one]) is not None:
                axis.axhline(mean, **line)
        for first, last in spans(rare[name]):
            axis.axvspan(first - 0.5, last + 0.5, color=SHADE, zorder=0, linewidth=0)
        axis.set_title(spoken(name))
        axis.set_xlabel(f"{spoken(name)} rank (0 = most frequent)")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlim(-0.5, rank_counts(table)[name] - 0.5)
    if measure == "success":
        axes[0].set_ylim(0, 1.02)
    axes[0].set_ylabel(success_label(table, measure))
    return figure


def by_situation(table: ScoreTable) -> Figure | None:
    """A heat map of the uniform levels for each row of the table; for two-dimensional situations.

    Situations without an episode are grey; the rare ones are framed.
    """
    names = situation_names(table)
    if len(names) != 2:
        return None
    measure = measure_of(table)
    found = rates(table, names, measure=measure)
    if not len(found):
        return None
    row_name, column_name = names
    shape = tuple(rank_counts(table)[name] for name in names)
    rows = [row for row in table.rows if (found["row_key"] == row.key).any()]
    across = min(4, len(rows))
    down = math.ceil(len(rows) / across)
    titles = [textwrap.fill(row.title, 27) for row in rows]
    title_lines = sum(
        max(title.count("\n") + 1 for title in titles[first : first + across])
        for first in range(0, len(titles), across)
    )
    height = 0.7 + 2.85 * down + TITLE_LINE * title_lines
    figure = Figure(figsize=(1.3 + 2.7 * across, height), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    limits = (0.0, 1.0) if measure == "success" else (found["value"].min(), found["value"].max())
    rare = [rare_ranks(table, name) for name in names]
    image, gaps = None, False
    for axis, row, title in zip(axes.flat, rows, titles, strict=False):
        of_row = found[found["row_key"] == row.key]
        grid = np.full(shape, np.nan)
        grid[of_row[row_name].to_numpy(int), of_row[column_name].to_numpy(int)] = of_row["value"]
        gaps = gaps or bool(np.isnan(grid).any())
        axis.grid(False)
        axis.spines[:].set_visible(True)
        # A fixed aspect would make the constrained layout misjudge the room that labels need.
        empty = ListedColormap(["white", "0.8"])
        axis.imshow(np.isnan(grid), cmap=empty, vmin=0, vmax=1, aspect="auto")
        colours = matplotlib.colormaps["cividis"]
        image = axis.imshow(grid, cmap=colours, vmin=limits[0], vmax=limits[1], aspect="auto")
        for down_span in spans(rare[0]):
            for across_span in spans(rare[1]):
                axis.add_patch(_frame(down_span, across_span))
        axis.set_title(title)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    for axis in axes.flat[len(rows) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel(f"{row_name.capitalize()} rank")
    for column in range(across):
        lowest = max(line for line in range(down) if line * across + column < len(rows))
        axes[lowest, column].set_xlabel(f"{column_name.capitalize()} rank")
        axes[lowest, column].tick_params(labelbottom=True)
    assert image is not None
    figure.colorbar(image, ax=axes, label=success_label(table, measure), shrink=0.9)
    key = "rank 0: most frequent; framed: rare" + ("; grey: no episode" if gaps else "")
    set_title(figure, f"{table.title}: {NAMES[measure].lower()} by situation ({key})")
    return figure


def success_label(table: ScoreTable, measure: Measure) -> str:
    """What an axis of success, or of the mean return, on the uniform levels is called."""
    several = any(levels.level_kind == "uniform" for levels in table.groups)
    return f"{NAMES[measure]} on the uniform {'levels' if several else 'level'}"


def _frame(down: tuple[int, int], across: tuple[int, int]) -> Rectangle:
    """Around the ranks between these, both ends included."""
    return Rectangle(
        (across[0] - 0.5, down[0] - 0.5),
        across[1] - across[0] + 1,
        down[1] - down[0] + 1,
        fill=False,
        edgecolor=RARE_COLOUR,
        linewidth=1.8,
        clip_on=False,
        zorder=3,
    )
