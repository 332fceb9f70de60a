"""Plots of how often situations occur, and of success against how often training met them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator

from zipf.experiments.records.wording import KIND_NAMES, spoken
from zipf.experiments.reporting.average_figures import KIND_STYLES
from zipf.experiments.reporting.situation_figures import (
    INTERVALS,
    NAMES,
    draw_with_band,
    success_label,
)
from zipf.experiments.reporting.situations import (
    measure_of,
    rank_counts,
    rare_ranks,
    rates_by_visits,
    shares,
    situation_names,
    spans,
    visit_names,
)
from zipf.experiments.reporting.styles import SHADE, LineStyle, panels, row_handles
from zipf.experiments.reporting.tables import ScoreTable


def frequencies(table: ScoreTable) -> Figure | None:
    """The share of episodes at each rank of the situation, on train, uniform and rare levels, both
    axes logarithmic: Zipf's law is a straight line."""
    found = {name: shares(table, name) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    handles: list[Artist] = [
        Line2D([], [], label=KIND_NAMES[kind], markersize=3.5, **style)
        for kind, style in KIND_STYLES.items()
    ]
    rare = {name: rare_ranks(table, name) for name in found}
    if any(rare.values()):
        handles.append(Patch(color=SHADE, label="Rare ranks"))
    title = f"{table.title}: how often situations occur"
    figure, axes = panels(len(found), title, handles)
    for axis, (name, of_rank) in zip(axes, found.items(), strict=True):
        for kind, style in KIND_STYLES.items():
            of_kind = of_rank[of_rank["level_kind"] == kind]
            axis.plot(of_kind[name] + 1, of_kind["share"], markersize=3.5, **style)
        for first, last in spans(rare[name]):
            axis.axvspan(first + 0.5, last + 1.5, color=SHADE, zorder=0, linewidth=0)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlim(0.9, rank_counts(table)[name] + 0.5)
        axis.xaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda place, _: f"{place - 1:.0f}"))
        axis.xaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        axis.set_title(spoken(name))
        axis.set_xlabel(f"{spoken(name)} rank (0 = most frequent)")
        axis.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:g} %"))
        axis.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
    axes[0].set_ylabel("Share of episodes")
    return figure


def by_visits(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Figure | None:
    """Success, or the mean return, on the uniform levels against how often training had met the
    situation, and each of its ranks; None where no run has counted it."""
    measure = measure_of(table)
    found = {name: rates_by_visits(table, name, measure) for name in visit_names(table)}
    found = {name: groups for name, groups in found.items() if len(groups)}
    if not found:
        return None
    handles = row_handles(table.rows, styles)
    handles.append(Patch(color="0.65", alpha=0.5, label=INTERVALS[measure]))
    title = f"{table.title}: {NAMES[measure].lower()} against experience"
    figure, axes = panels(len(found), title, handles)
    for axis, (name, groups) in zip(axes, found.items(), strict=True):
        for row in table.rows:
            of_row = groups[groups["row_key"] == row.key]
            draw_with_band(axis, of_row, "met", styles[row.key])
        axis.set_xscale("symlog", linthresh=1)
        axis.set_xlim(-0.15, 1.5 * max(1.0, float(groups["met"].max())))
        most = int(np.ceil(np.log10(max(10.0, float(groups["met"].max())))))
        step = 1 if most < 6 else 2
        axis.set_xticks([0, *(10.0**power for power in range(0, most + 1, step))])
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.minorticks_off()
        rank = name.removeprefix("visits").removeprefix("_").replace("_", " ")
        axis.set_title(rank.capitalize() or "Situation")
        axis.set_xlabel(f"Times training met the {rank or 'situation'}")
    if measure == "success":
        axes[0].set_ylim(0, 1.02)
    axes[0].set_ylabel(success_label(table, measure))
    return figure
