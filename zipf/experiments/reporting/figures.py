"""Score tables as pictures: learning curves, and success against frequency rank.

Drawn on figures of their own, without pyplot, so that no display is needed and no global state of
a caller's is touched.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import EngFormatter, MaxNLocator

from zipf.experiments.reporting.paper import LEVEL_KINDS, condition_name, condition_order
from zipf.experiments.reporting.rendering import LEVEL_NAMES, PLOT_KINDS
from zipf.experiments.reporting.tables import ScoreTable, UpdateWindow, success_rates

# Okabe and Ito (2008): told apart with any colour vision. Yellow is left out (too light for lines)
# and grey is kept for chance.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PINK, ORANGE, SKY, BLACK = "#CC79A7", "#E69F00", "#56B4E9", "#000000"
COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, BLACK)
SOLID, DASHED = "-", (0, (5, 1.5))
DASHES: tuple[Any, ...] = (SOLID, DASHED, (0, (1.5, 1)), (0, (5, 1.5, 1.5, 1.5)))
CHANCE: dict[str, Any] = {"color": "0.35", "linestyle": ":", "linewidth": 1.3, "zorder": 1}

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
    """How a condition looks in every figure."""

    color: str
    linestyle: Any


# One colour each for the rows of the gridworld's table; a variant shares its relative's colour.
KNOWN_STYLES: Mapping[str, LineStyle] = {
    "impala": LineStyle(BLUE, SOLID),
    "vmpo": LineStyle(PINK, DASHED),
    "r2d2": LineStyle(VERMILION, SOLID),
    "r2d2_uniform_replay": LineStyle(VERMILION, DASHED),
    "impala_vision": LineStyle(GREEN, SOLID),
    "impala_vision_language": LineStyle(GREEN, DASHED),
    "impala_byol": LineStyle(PINK, SOLID),
    "impala_mlp": LineStyle(ORANGE, SOLID),
    "impala_transformer": LineStyle(SKY, SOLID),
    "impala_transformer_vision_language": LineStyle(BLACK, SOLID),
    "supervised": LineStyle(BLACK, DASHED),
}


def draw(tables: Sequence[ScoreTable], folder: Path) -> dict[str, list[Path]]:
    """Draw every figure the tables have data for; the files, by the table's name."""
    styles = line_styles({condition for table in tables for condition in table.conditions})
    files: dict[str, list[Path]] = {}
    with matplotlib.rc_context(STYLE):
        for table in tables:
            figures = (
                learning_curves(table, styles),
                success_against_rank(table, styles),
                success_by_situation(table),
            )
            for kind, figure in zip(PLOT_KINDS, figures, strict=True):
                if figure is not None:
                    path = folder / f"{table.name}_{kind}.png"
                    figure.savefig(path)
                    files.setdefault(table.name, []).append(path)
    return files


def line_styles(conditions: set[str]) -> dict[str, LineStyle]:
    """A style for each condition: always the same for the paper's, then the next free ones."""
    all_styles = [LineStyle(colour, dash) for dash in DASHES for colour in COLOURS]
    styles = {name: style for name, style in KNOWN_STYLES.items() if name in conditions}
    others = sorted(conditions - styles.keys(), key=condition_order)
    free = [style for style in all_styles if style not in styles.values()]
    for number, condition in enumerate(others):
        styles[condition] = free[number % len(free)]
    return styles


def learning_curves(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Figure | None:
    """Score against updates: a panel per level kind, a line per condition.

    The line is the median over seeds at each update, the band reaches from the lowest to the
    highest seed; the window is shaded.
    """
    evaluations = pd.concat(
        [run.evaluations.assign(condition=run.description.condition) for run in table.runs]
    )
    if not len(evaluations):
        return None
    handles = _condition_handles(table, styles)
    if table.chance:
        handles.append(_chance_handle())
    if isinstance(table.window, UpdateWindow):
        handles.append(Patch(color="0.9", label="Window of the table"))
    if len(table.runs) > len(table.conditions):
        handles.append(Patch(color="0.65", alpha=0.5, label="Lowest to highest seed"))
    figure, axes = _panels(len(LEVEL_KINDS), f"{table.title}: learning curves", handles)
    for axis, level_kind in zip(axes, LEVEL_KINDS, strict=True):
        of_kind = evaluations[evaluations["level_kind"] == level_kind]
        for condition in table.conditions:
            seeds = of_kind[of_kind["condition"] == condition].groupby("update")["score"]
            middle = seeds.median()
            style = styles[condition]
            axis.plot(
                middle.index,
                middle,
                color=style.color,
                linestyle=style.linestyle,
                marker="o" if len(middle) < 3 else None,
                markersize=3,
            )
            axis.fill_between(
                middle.index, seeds.min(), seeds.max(), color=style.color, alpha=0.18, linewidth=0
            )
        if level_kind in table.chance:
            axis.axhline(table.chance[level_kind], **CHANCE)
        axis.set_title(LEVEL_NAMES[level_kind])
        axis.set_xlabel("Updates")
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=True))
        _shade_window(axis, table, evaluations["update"])
    _score_limits(axes[0], evaluations["score"])
    axes[0].set_ylabel("Score")
    return figure


def success_against_rank(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Figure | None:
    """Success on the uniform level against each rank of the situation, with Wilson intervals."""
    names = _situation_names(table)
    rates = {name: success_rates(table, [name]) for name in names}
    names = [name for name in names if len(rates[name])]
    if not names:
        return None
    handles = _condition_handles(table, styles)
    if "uniform" in table.chance:
        handles.append(_chance_handle())
    rare = {name: _rare_ranks(table, name) for name in names}
    if any(rare.values()):
        handles.append(Patch(color="0.9", label="Rare"))
    handles.append(Patch(color="0.65", alpha=0.5, label="95 % Wilson interval (of episodes)"))
    figure, axes = _panels(len(names), f"{table.title}: success against frequency rank", handles)
    for axis, name in zip(axes, names, strict=True):
        for condition in table.conditions:
            rate = rates[name][rates[name]["condition"] == condition]
            style = styles[condition]
            axis.plot(
                rate[name],
                rate["success"],
                color=style.color,
                linestyle=style.linestyle,
                marker="o",
                markersize=3.5,
            )
            axis.fill_between(
                rate[name], rate["low"], rate["high"], color=style.color, alpha=0.18, linewidth=0
            )
        if "uniform" in table.chance:
            axis.axhline(table.chance["uniform"], **CHANCE)
        if rare[name]:
            ends = (min(rare[name]) - 0.5, max(rare[name]) + 0.5)
            axis.axvspan(*ends, color="0.9", zorder=0, linewidth=0)
        spoken = name.replace("_", " ").capitalize()
        axis.set_title(spoken)
        axis.set_xlabel(f"{spoken} rank (0 = most frequent)")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlim(-0.5, _rank_count(table, name, rates[name]) - 0.5)
    axes[0].set_ylim(0, 1.02)
    axes[0].set_ylabel("Success on the uniform level")
    return figure


def success_by_situation(table: ScoreTable) -> Figure | None:
    """A heat map of success on the uniform level for each condition; two-dimensional situations.

    Situations without an episode are grey; the rare ones are framed.
    """
    names = _situation_names(table)
    if len(names) != 2:
        return None
    rates = success_rates(table, names)
    if not len(rates):
        return None
    row_name, column_name = names
    shape = tuple(_rank_count(table, name, rates) for name in names)
    conditions = [name for name in table.conditions if (rates["condition"] == name).any()]
    columns = min(4, len(conditions))
    rows = math.ceil(len(conditions) / columns)
    titles = [textwrap.fill(condition_name(condition), 27) for condition in conditions]
    title_lines = sum(
        max(title.count("\n") + 1 for title in titles[first : first + columns])
        for first in range(0, len(titles), columns)
    )
    height = 0.7 + 2.85 * rows + TITLE_LINE * title_lines
    figure = Figure(figsize=(1.3 + 2.7 * columns, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    colours = matplotlib.colormaps["cividis"]
    image, gaps = None, False
    for axis, condition, title in zip(axes.flat, conditions, titles, strict=False):
        rate = rates[rates["condition"] == condition]
        grid = np.full(shape, np.nan)
        grid[rate[row_name].to_numpy(int), rate[column_name].to_numpy(int)] = rate["success"]
        gaps = gaps or bool(np.isnan(grid).any())
        axis.grid(False)
        axis.spines[:].set_visible(True)
        # A fixed aspect would make the constrained layout misjudge the room that labels need.
        empty = ListedColormap(["white", "0.8"])
        axis.imshow(np.isnan(grid), cmap=empty, vmin=0, vmax=1, aspect="auto")
        image = axis.imshow(grid, cmap=colours, vmin=0, vmax=1, aspect="auto")
        rare = [_rare_ranks(table, name) for name in names]
        if all(rare):
            (top, bottom), (left, right) = ((min(ranks), max(ranks)) for ranks in rare)
            axis.add_patch(
                Rectangle(
                    (left - 0.5, top - 0.5),
                    right - left + 1,
                    bottom - top + 1,
                    fill=False,
                    edgecolor="#D55E00",
                    linewidth=1.8,
                    clip_on=False,
                    zorder=3,
                )
            )
        axis.set_title(title)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    for axis in axes.flat[len(conditions) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel(f"{row_name.capitalize()} rank")
    for column in range(columns):
        lowest = max(r for r in range(rows) if r * columns + column < len(conditions))
        axes[lowest, column].set_xlabel(f"{column_name.capitalize()} rank")
        axes[lowest, column].tick_params(labelbottom=True)
    assert image is not None
    figure.colorbar(image, ax=axes, label="Success on the uniform level", shrink=0.9)
    key = "rank 0: most frequent; framed: rare" + ("; grey: no episode" if gaps else "")
    _set_title(figure, f"{table.title}: success by situation ({key})")
    return figure


def _panels(count: int, title: str, handles: list[Any]) -> tuple[Figure, list[Axes]]:
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
    _set_title(figure, title)
    axes = figure.subplots(1, count, sharey=True, squeeze=False)
    return figure, list(axes[0])


def _set_title(figure: Figure, title: str) -> None:
    """Set the title, wrapped to the figure's width, and make room for the lines after its first."""
    text = textwrap.fill(title, int(figure.get_figwidth() / 0.09))
    figure.suptitle(text, fontsize=11)
    figure.set_figheight(figure.get_figheight() + FIGURE_TITLE_LINE * text.count("\n"))


def _condition_handles(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Any]:
    return [
        Line2D([], [], **styles[condition]._asdict(), label=condition_name(condition))
        for condition in table.conditions
    ]


def _chance_handle() -> Line2D:
    return Line2D([], [], **CHANCE, label="Chance (random actions)")


def _score_limits(axis: Axes, scores: pd.Series) -> None:
    """0 to 1 for success-like scores; whatever is needed beyond."""
    low, high = min(0.0, scores.min()), max(1.0, scores.max())
    axis.set_ylim(low - (0.05 * (high - low) if low < 0 else 0), high + 0.02 * (high - low))


def _shade_window(axis: Axes, table: ScoreTable, updates: pd.Series) -> None:
    end = 1.02 * max(updates.max(), 1)
    if isinstance(table.window, UpdateWindow) and table.window.start <= updates.max():
        shown = (table.window.start, min(table.window.end, end))
        axis.axvspan(*shown, color="0.9", zorder=0, linewidth=0)
    axis.set_xlim(0, end)


def _situation_names(table: ScoreTable) -> list[str]:
    return list(dict.fromkeys(name for run in table.runs for name in run.situation_names))


def _rank_count(table: ScoreTable, name: str, rates: pd.DataFrame) -> int:
    """How many ranks there are; up to the highest visited one where runs do not tell."""
    return table.situation_sizes.get(name, int(rates[name].max()) + 1)


def _rare_ranks(table: ScoreTable, name: str) -> list[int]:
    """The ranks that the rare level is made of: the last fifth; none where it visits others, too.

    Where runs do not tell how many ranks there are: those that the rare level visited.
    """
    visited = sorted(success_rates(table, [name], "rare")[name].astype(int).unique())
    size = table.situation_sizes.get(name)
    if size is None:
        return visited
    last_fifth = range(size - size // 5, size)
    return list(last_fifth) if set(visited) <= set(last_fifth) else []
