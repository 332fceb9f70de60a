"""The plots of a report; here the learning curves, against updates or frames and against hours."""

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

from zipf.experiments.records.results import aligned, devices_of
from zipf.experiments.records.wording import KIND_NAMES, PlotFormat
from zipf.experiments.reporting.average_figures import averages
from zipf.experiments.reporting.frequency_figures import by_visits, frequencies
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
from zipf.experiments.reporting.windows import (
    LastEvaluations,
    OwnWindows,
    ScaledWindow,
    UpdateWindow,
    evaluations_inside,
)


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
            drawn = (
                learning_curves(table, styles),
                learning_curves(table, styles, in_hours=True),
                averages(table),
                frequencies(table),
                by_rank(table, styles),
                by_situation(table),
                by_visits(table, styles),
            )
            for kind, figure in zip(PLOT_KINDS, drawn, strict=True):
                if figure is not None:
                    path = folder / f"{table.name}_{kind}.{format}"
                    figure.savefig(path, format=format, metadata=UNDATED[format])
                    files.setdefault(table.name, []).append(path)
    return files


UNDATED: Mapping[str, Any] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}


def learning_curves(
    table: ScoreTable, styles: Mapping[str, LineStyle], *, in_hours: bool = False
) -> Figure | None:
    """Score against updates: a panel per level kind, a line per row.

    The line is the median over seeds at each update, the band reaches from the lowest to the
    highest seed; the window is shaded; an axis above counts frames. Where rows learn from different
    numbers of frames in an update, and with an external agent, whose updates are not ours, the
    scores are drawn against frames: at one place of the axis all have had the same experience.

    In hours, or minutes below two hours, a point of the line is at the median time of the seeds at
    an update, training and evaluation together; without external agents, whose time is not known.
    Where runs were on different devices there is none.
    """
    if in_hours and len(devices_of(table.runs)) > 1:
        return None
    rows = [row for row in table.rows if not (in_hours and row.external)]
    scores = {
        (row.key, levels.level_kind): pd.concat(
            aligned([run.mean_scores(levels) for run in row.runs])
        )
        for row in rows
        for levels in table.kinds
    }
    every = pd.concat([pd.DataFrame(), *scores.values()], ignore_index=True)
    if not len(every) or (in_hours and not every["seconds"].max()):
        return None
    unit = "hours" if every["seconds"].max() >= 2 * 3600 else "minutes"
    length = {"hours": 3600, "minutes": 60}[unit]
    every = every.assign(**{unit: every["seconds"] / length})
    time = "update" if frames_follow_updates(table) else "frames"
    shown = unit if in_hours else time
    window = None if in_hours else window_ends(table, time)
    handles = row_handles(rows, styles)
    handles += [reference_handle(name) for name in REFERENCE_LINES if table.reference(name)]
    if window:
        handles.append(Patch(color=SHADE, label="Window of the table"))
    if any(len(row.runs) > 1 for row in rows):
        handles.append(Patch(color="0.65", alpha=0.5, label="Lowest to highest seed"))
    what = f"score against {unit}" if in_hours else "learning curves"
    figure, axes = panels(len(table.kinds), f"{table.title}: {what}", handles)
    for axis, levels in zip(axes, table.kinds, strict=True):
        for row in rows:
            of_row = scores[row.key, levels.level_kind].groupby("update" if in_hours else time)
            places = of_row["seconds"].median() / length if in_hours else None
            _draw_curve(axis, of_row["score"], styles[row.key], places)
        for name, style in REFERENCE_LINES.items():
            if levels.level_kind in table.reference(name):
                axis.axhline(table.reference(name)[levels.level_kind], **style)
        if window:
            axis.axvspan(*window, color=SHADE, zorder=0, linewidth=0)
        axis.set_xlim(0, 1.02 * (every[shown].max() or 1))
        axis.set_title(KIND_NAMES[levels.level_kind])
        axis.set_xlabel(AXES[shown])
        axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=not in_hours))
        if not in_hours:
            axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        if shown == "update":
            _count_frames_above(axis, every)
    references = [pd.Series(table.reference(name)) for name in REFERENCE_LINES]
    score_limits(axes[0], pd.concat([every["score"], *references]))
    axes[0].set_ylabel("Score")
    return figure


AXES: Mapping[str, str] = {
    "update": "Updates",
    "frames": "Frames",
    "hours": "Hours of training and evaluation",
    "minutes": "Minutes of training and evaluation",
}


def _count_frames_above(axis: Axes, every: pd.DataFrame) -> None:
    """An axis above that counts frames, where an update has the same number of them everywhere."""
    last = every.iloc[int(every["update"].to_numpy().argmax())]
    if not last["update"]:
        return
    frames = last["frames"] / last["update"]
    above = axis.secondary_xaxis("top", functions=(lambda x: x * frames, lambda x: x / frames))
    above.set_xlabel("Frames")
    above.xaxis.set_major_formatter(EngFormatter(sep=""))
    above.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    above.tick_params(direction="in")


def frames_follow_updates(table: ScoreTable) -> bool:
    """Whether all rows learn from the same number of frames in an update."""
    if any(row.external for row in table.rows):
        return False
    ends = [run.evaluations.iloc[-1] for run in table.runs if len(run.evaluations)]
    return len({end["frames"] / end["update"] for end in ends if end["update"]}) <= 1


def _draw_curve(axis: Axes, seeds: Any, style: LineStyle, places: pd.Series | None = None) -> None:
    """`seeds` are scores, grouped by where they are on the axis unless `places` says otherwise."""
    middle = seeds.median()
    x = middle.index if places is None else places
    marker = "o" if len(middle) < 3 else None
    axis.plot(x, middle, **style._asdict(), marker=marker, markersize=3)
    axis.fill_between(x, seeds.min(), seeds.max(), color=style.color, **BAND)


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
