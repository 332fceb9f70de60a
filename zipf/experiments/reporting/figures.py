"""The plots of a report; here the learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, MaxNLocator

from zipf.experiments.reporting.markdown import PLOT_KINDS
from zipf.experiments.reporting.situation_figures import by_rank, by_situation
from zipf.experiments.reporting.styles import (
    BAND,
    REFERENCE_LINES,
    SHADE,
    STYLE,
    LineStyle,
    line_styles,
    panels,
    reference_handle,
    row_handles,
    score_limits,
)
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import UpdateWindow, evaluations_inside
from zipf.experiments.reporting.wording import KIND_NAMES, PlotFormat


def draw(
    tables: Sequence[ScoreTable], folder: Path, format: PlotFormat = "png"
) -> dict[str, list[Path]]:
    """Draw every figure the tables have data for; the files, by the table's name.

    The same tables give the same bytes.
    """
    styles = line_styles([row for table in tables for row in table.rows])
    files: dict[str, list[Path]] = {}
    with matplotlib.rc_context({**STYLE, "svg.hashsalt": "zipf"}):
        for table in tables:
            drawn = (learning_curves(table, styles), by_rank(table, styles), by_situation(table))
            for kind, figure in zip(PLOT_KINDS, drawn, strict=True):
                if figure is not None:
                    path = folder / f"{table.name}_{kind}.{format}"
                    figure.savefig(path, format=format, metadata=UNDATED[format])
                    files.setdefault(table.name, []).append(path)
    return files


UNDATED: Mapping[str, Any] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}


def learning_curves(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Figure | None:
    """Score against updates: a panel per level kind, a line per row.

    The line is the median over seeds at each update, the band reaches from the lowest to the
    highest seed; the window is shaded. Where rows learn from different numbers of frames in an
    update, and with an external agent, whose updates are not ours, the scores are drawn against
    frames: at one place of the axis all have had the same experience.
    """
    scores = {
        (row.key, levels.level_kind): pd.concat([run.mean_scores(levels) for run in row.runs])
        for row in table.rows
        for levels in table.kinds
    }
    every = pd.concat(list(scores.values()))
    if not len(every):
        return None
    time = "update" if frames_follow_updates(table) else "frames"
    window = window_ends(table, time)
    handles = row_handles(table.rows, styles)
    handles += [reference_handle(name) for name in REFERENCE_LINES if table.reference(name)]
    if window:
        handles.append(Patch(color=SHADE, label="Window of the table"))
    if any(len(row.runs) > 1 for row in table.rows):
        handles.append(Patch(color="0.65", alpha=0.5, label="Lowest to highest seed"))
    figure, axes = panels(len(table.kinds), f"{table.title}: learning curves", handles)
    for axis, levels in zip(axes, table.kinds, strict=True):
        for row in table.rows:
            of_row = scores[row.key, levels.level_kind]
            _draw_curve(axis, of_row.groupby(time)["score"], styles[row.key])
        for name, style in REFERENCE_LINES.items():
            if levels.level_kind in table.reference(name):
                axis.axhline(table.reference(name)[levels.level_kind], **style)
        if window:
            axis.axvspan(*window, color=SHADE, zorder=0, linewidth=0)
        axis.set_xlim(0, 1.02 * max(every[time].max(), 1))
        axis.set_title(KIND_NAMES[levels.level_kind])
        axis.set_xlabel("Updates" if time == "update" else "Frames")
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=True))
    references = [pd.Series(table.reference(name)) for name in REFERENCE_LINES]
    score_limits(axes[0], pd.concat([every["score"], *references]))
    axes[0].set_ylabel("Score")
    return figure


def frames_follow_updates(table: ScoreTable) -> bool:
    """Whether all rows learn from the same number of frames in an update."""
    if any(row.external for row in table.rows):
        return False
    ends = [run.evaluations.iloc[-1] for run in table.runs if len(run.evaluations)]
    return len({end["frames"] / end["update"] for end in ends if end["update"]}) <= 1


def _draw_curve(axis: Axes, seeds: Any, style: LineStyle) -> None:
    middle = seeds.median()
    marker = "o" if len(middle) < 3 else None
    axis.plot(middle.index, middle, **style._asdict(), marker=marker, markersize=3)
    axis.fill_between(middle.index, seeds.min(), seeds.max(), color=style.color, **BAND)


def window_ends(table: ScoreTable, time: str) -> tuple[float, float] | None:
    """Between which updates or frames the window lies; None if there is none to show, or in frames
    if it is not the same for all rows."""
    if not isinstance(table.window, UpdateWindow):
        return None
    own = [run for run in table.runs if not run.description.external]
    last = max((run.evaluations["update"].max() for run in own if len(run.evaluations)), default=0)
    if table.window.start > last:
        return None
    if time == "update":
        return (table.window.start, min(table.window.end, 1.02 * max(last, 1)))
    inside = [evaluations_inside(run, table.window)["frames"] for run in own]
    ends = {(frames.min(), frames.max()) for frames in inside if len(frames)}
    return ends.pop() if len(ends) == 1 else None
