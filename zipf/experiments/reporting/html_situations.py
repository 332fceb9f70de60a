"""The figures of the HTML report about the frequency ranks of the situation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from plotly import graph_objects as go

from zipf.experiments.records.wording import spoken
from zipf.experiments.reporting.frequencies import counted_visits, rank_shares, times_met
from zipf.experiments.reporting.html_panels import (
    WIDTH,
    Panel,
    layout,
    level_line,
    line,
    log_ticks,
    numbers,
    panel,
    plain,
    row_key,
    shade,
)
from zipf.experiments.reporting.situation_figures import INTERVALS, NAMES
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
from zipf.experiments.reporting.styles import LineStyle
from zipf.experiments.reporting.tables import Row, ScoreTable
from zipf.protocol import REFERENCES


def by_rank(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Panel]:
    """Success on the uniform levels, or mean return, against each rank of the situation."""
    measure = measure_of(table)
    panels = []
    for number, (name, of_rank) in enumerate(_measured(table, measure)):
        traces = []
        for row, of_row in _of_rows(table, of_rank):
            style = styles[row.key]
            traces.append(_band(row, of_row[name], of_row["low"], of_row["high"], style))
            hover = "rank %{x}: %{y:.3f}, of %{customdata} episodes"
            trace = line(row, style, hover, symbol=table.rows.index(row))
            trace.update(
                x=numbers(of_row[name]),
                y=numbers(of_row["value"]),
                customdata=numbers(of_row["episodes"]),
            )
            traces.append(trace)
        for one in REFERENCES:
            ranked = reference_by_rank(table, measure, one.name)
            mean = reference_on_uniform(table, measure, one.name)
            if name in ranked:
                flat = level_line(one.name, 0.0)
                flat.update(x=list(range(len(ranked[name]))), y=list(ranked[name]))
                traces.append(flat)
            elif mean is not None:
                flat = level_line(one.name, mean)
                flat.x = [-0.5, rank_counts(table)[name] - 0.5]
                traces.append(flat)
        shapes = [shade(first - 0.5, last + 0.5) for first, last in spans(rare_ranks(table, name))]
        figure = go.Figure(
            traces,
            layout(
                spoken(name),
                x={
                    "title": f"{spoken(name)} rank (0 = most frequent)",
                    "range": [-0.5, rank_counts(table)[name] - 0.5],
                },
                y=_measure_axis(measure),
                shapes=shapes,
            ),
        )
        label = f"{table.title}: {NAMES[measure].lower()} against {spoken(name)} rank"
        panels.append(panel(f"{table.name}-ranks-{number}", label, figure))
    return panels


def frequencies(table: ScoreTable) -> list[Panel]:
    """The share of training episodes at each value of each rank, on logarithmic axes."""
    panels = []
    for number, name in enumerate(situation_names(table)):
        shares = rank_shares(table, name)
        met = shares[shares > 0]
        if not len(met):
            continue
        curve = go.Scatter(
            x=numbers(met.index + 1),
            y=numbers(met),
            customdata=numbers(met.index),
            mode="lines+markers",
            line={"color": "#0072B2", "width": WIDTH},
            marker={"size": 5},
            name="",
            hovertemplate="rank %{customdata}: %{y:.3%}",
        )
        places = log_ticks(curve.x)  # of rank + 1, since a logarithmic axis has no 0
        figure = go.Figure(
            [curve],
            layout(
                spoken(name),
                x={
                    "title": f"{spoken(name)} rank (0 = most frequent)",
                    **places,
                    "ticktext": [f"{place - 1:.0f}" for place in places["tickvals"]],
                },
                y={
                    "title": "Share of episodes",
                    **log_ticks(curve.y),
                    "tickformat": "~%",
                },
            ),
        )
        label = f"{table.title}: how frequent each {spoken(name)} rank is in training"
        panels.append(panel(f"{table.name}-frequencies-{number}", label, figure))
    return panels


def by_times_met(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Panel]:
    """Success on the uniform levels, or mean return, at each rank against the number of training
    episodes that were drawn at it; a point is a rank.

    Ranks that training never met are at 0 where this was counted, and left out where it is
    estimated: evaluations that did not meet a rank do not say that training has not.
    """
    measure = measure_of(table)
    panels = []
    for number, (name, of_rank) in enumerate(_measured(table, measure)):
        times = times_met(table, name)
        drawn = []
        for row, of_row in _of_rows(table, of_rank):
            if row.key not in times:
                continue
            points = of_row.assign(times=of_row[name].map(times[row.key])).sort_values("times")
            if any(counted_visits(run, table, name) is None for run in row.runs):
                points = points[points["times"] > 0]
            points = points.dropna(subset=["times"])
            if len(points):
                drawn.append((row, points))
        if not drawn:
            continue
        every = pd.concat([points["times"] for _, points in drawn])
        axis, zero = _axis_with_zero(every)
        traces = []
        for row, points in drawn:
            hover = "rank %{customdata[0]}, met %{customdata[1]:.3~s} times: %{y:.3f}"
            trace = line(row, styles[row.key], hover, symbol=table.rows.index(row))
            trace.update(
                x=numbers(points["times"].replace(0.0, zero)),
                y=numbers(points["value"]),
                customdata=points[[name, "times"]].to_numpy().tolist(),
                error_y={
                    "type": "data",
                    "symmetric": False,
                    "array": numbers(points["high"] - points["value"]),
                    "arrayminus": numbers(points["value"] - points["low"]),
                    "thickness": 1,
                    "width": 0,
                },
            )
            traces.append(trace)
        figure = go.Figure(
            traces,
            layout(
                spoken(name),
                x={"title": f"Training episodes with the {spoken(name).lower()}", **axis},
                y=_measure_axis(measure),
            ),
        )
        label = (
            f"{table.title}: {NAMES[measure].lower()} against how often training has met each "
            f"{spoken(name)} rank"
        )
        panels.append(panel(f"{table.name}-met-{number}", label, figure))
    return panels


def counting_text(table: ScoreTable) -> str:
    """Where the numbers of training episodes are from."""
    names = situation_names(table)
    own = [run for run in table.runs if not run.description.external]
    if all(counted_visits(run, table, name) is not None for run in own for name in names):
        text = "counted in training."
    else:
        text = (
            "estimated: the share of this rank in evaluations on the train levels, times the "
            "frames of training divided by the mean length of its episodes. Ranks not met there "
            "are left out."
        )
    if any(run.description.pretrained for run in own):
        text += " Without those of runs whose weights other agents began with."
    return text


def band_text(table: ScoreTable) -> str:
    """What bands and bars are."""
    return INTERVALS[measure_of(table)]


def _measured(table: ScoreTable, measure: Measure) -> Iterator[tuple[str, pd.DataFrame]]:
    for name in situation_names(table):
        of_rank = rates(table, [name], measure=measure)
        if len(of_rank):
            yield name, of_rank


def _of_rows(table: ScoreTable, frame: pd.DataFrame) -> Iterator[tuple[Row, pd.DataFrame]]:
    for row in table.rows:
        of_row = frame[frame["row_key"] == row.key]
        if len(of_row):
            yield row, of_row


def _band(
    row: Row, places: pd.Series, low: pd.Series, high: pd.Series, style: LineStyle
) -> go.Scatter:
    """Around a line; without an interval, as of a single evaluation, it has no area."""
    known = low.notna() & high.notna()
    places, low, high = places[known], low[known], high[known]
    return go.Scatter(
        x=[*numbers(places), *numbers(places[::-1])],
        y=[*numbers(high), *numbers(low[::-1])],
        name=plain(row.title),
        legendgroup=row_key(row),
        mode="lines",
        line={"width": 0, "color": style.color},
        fill="toself",
        opacity=0.15,
        fillcolor=style.color,
        hoverinfo="skip",
    )


def _axis_with_zero(times: pd.Series) -> tuple[dict[str, Any], float]:
    """A logarithmic axis for these numbers of times, and where 0 stands on it: a tenth of its
    lowest power of ten, which is 1 at most, because Plotly's logarithmic axes have no 0."""
    positive = times[times > 0].tolist()
    if len(positive) == len(times):
        return {**log_ticks(positive), "tickformat": "~s"}, 0.0
    axis = log_ticks([1.0, *positive])
    ticks = axis["tickvals"]
    zero = ticks[0] / 10
    texts = ["0", *(_short(tick) for tick in ticks)]
    return {**axis, "tickvals": [zero, *ticks], "ticktext": texts}, zero


def _short(count: float) -> str:
    """`20k`, as Plotly's format `~s` has it."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:g}{letter}"
    return f"{count:g}"


def _measure_axis(measure: Measure) -> dict[str, Any]:
    title = f"{NAMES[measure]} on uniform"
    return {"title": title, "range": [-0.02, 1.03]} if measure == "success" else {"title": title}
