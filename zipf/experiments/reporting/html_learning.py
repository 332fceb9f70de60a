"""The learning curves of the HTML report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
from plotly import graph_objects as go

from zipf.experiments.records.results import LevelGroup, Run, aligned, devices_of
from zipf.experiments.records.wording import KIND_NAMES
from zipf.experiments.reporting.figures import frames_follow_updates, window_ends
from zipf.experiments.reporting.html_panels import (
    Panel,
    layout,
    level_line,
    line,
    numbers,
    panel,
    shade,
)
from zipf.experiments.reporting.styles import LineStyle
from zipf.experiments.reporting.tables import Row, ScoreTable
from zipf.protocol import REFERENCES

_AXES: Mapping[str, str] = {"update": "Updates", "frames": "Frames", "hours": "Hours"}


def axes_of(table: ScoreTable) -> Mapping[str, str]:
    """The horizontal axes of learning curves, with titles. Times of several devices are not
    compared."""
    several = len(devices_of(table.runs)) > 1
    return {time: title for time, title in _AXES.items() if time != "hours" or not several}


def default_axis(table: ScoreTable) -> str:
    """The horizontal axis of learning curves on which all rows have had the same experience."""
    return "update" if frames_follow_updates(table) else "frames"


def learning_curves(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Panel]:
    """Score against time, a panel for each level kind: thin lines are seeds, thick ones their
    median at each update; the window of the table is shaded."""
    curves = {
        (row.key, levels.level_kind): [_curve(run, levels) for run in row.runs]
        for row in table.rows
        for levels in table.kinds
    }
    every = pd.concat([seed for seeds in curves.values() for seed in seeds])
    if not len(every):
        return []
    references = [value for one in REFERENCES for value in table.reference(one.name).values()]
    scores = pd.concat([every["score"], pd.Series(references, dtype=float)])
    low, high = min(0.0, scores.min()), max(1.0, scores.max())
    limits = [low - (0.05 * (high - low) if low < 0 else 0.0), high + 0.03 * (high - low)]
    titles = axes_of(table)
    ends = {time: 1.02 * max(float(every[time].max()), 1e-9) for time in titles}
    windows = {time: None if time == "hours" else window_ends(table, time) for time in titles}
    used = default_axis(table)
    panels = []
    for levels in table.kinds:
        kind = levels.level_kind
        traces: list[tuple[go.Scatter, pd.DataFrame]] = []
        for row in table.rows:
            traces += _curves(row, curves[row.key, kind], styles[row.key])
        for one in REFERENCES:
            known = table.reference(one.name)
            if kind in known:
                ends_of = pd.DataFrame({time: [0.0, end] for time, end in ends.items()})
                traces.append((level_line(one.name, known[kind]), ends_of))
        axes: dict[str, dict[str, Any]] = {}
        for time, title in titles.items():
            window = windows[time]
            axes[time] = {
                "title": title,
                "x": [numbers(places[time]) for _, places in traces],
                "range": [0, ends[time]],
                "shapes": [shade(*window)] if window else [],
            }
        for (trace, _), x in zip(traces, axes[used]["x"], strict=True):
            trace.x = x
        figure = go.Figure(
            [trace for trace, _ in traces],
            layout(
                KIND_NAMES[kind],
                x={"title": titles[used], "range": axes[used]["range"], "tickformat": "~s"},
                y={"title": "Score", "range": limits},
                shapes=axes[used]["shapes"],
            ),
        )
        label = f"{table.title}: score against training on {KIND_NAMES[kind]} levels"
        panels.append(panel(f"{table.name}-learning-{kind}", label, figure, axes))
    return panels


def _curve(run: Run, levels: LevelGroup) -> pd.DataFrame:
    means = run.mean_scores(levels)
    seconds = run.evaluations.groupby("update")["seconds"].max()
    return means.assign(hours=means["update"].map(seconds).astype(float) / 3600)


def _curves(
    row: Row, seeds: Sequence[pd.DataFrame], style: LineStyle
) -> Iterator[tuple[go.Scatter, pd.DataFrame]]:
    """The seeds of a row, where there are several, and their median."""
    columns = [*_AXES, "score"]
    if len(seeds) > 1:
        for run, seed in zip(row.runs, seeds, strict=True):
            hover = f"seed {run.description.seed}: %{{y:.3f}} at %{{x:.4s}}"
            thin = line(row, style, hover, width=0.8, opacity=0.45)
            thin.y = numbers(seed["score"])
            yield thin, seed[columns]
    pooled = pd.concat(aligned(seeds))
    middle = pooled.assign(at=pooled["update"]).groupby("at")[columns].median()
    hover = f"{'median' if len(seeds) > 1 else 'one seed'}: %{{y:.3f}} at %{{x:.4s}}"
    thick = line(row, style, hover)
    thick.update(y=numbers(middle["score"]), mode="lines" if len(middle) > 2 else "lines+markers")
    yield thick, middle
