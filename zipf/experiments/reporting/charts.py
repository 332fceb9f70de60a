"""The figures of a table, as data: `panels.py` says what a figure is."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from zipf.experiments.records.results import Run, aligned, devices_of
from zipf.experiments.records.wording import KIND_NAMES, count_text, spoken
from zipf.experiments.reporting.comparable import Row
from zipf.experiments.reporting.panels import (
    GREY,
    MARKERS,
    Axis,
    Chart,
    Dash,
    HeatMaps,
    Line,
    Looks,
    Numbers,
    Panel,
)
from zipf.experiments.reporting.scores import seed_means
from zipf.experiments.reporting.seed_statistics import IQM, SeedStatistics, estimate_text
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
from zipf.protocol import BASELINES, PAPER_KINDS

BASELINE_DASHES: Mapping[str, Dash] = {
    "chance": (1, 1.65),
    "blind": (7, 2, 1.5, 2),
    "generalist": (7, 2, 1.5, 2, 1.5, 2),
    "expert": (10, 3),
}
KIND_MARKS: Mapping[str, Mapping[str, Any]] = {
    "train": {"marker": "o", "filled": False},
    "uniform": {"marker": "s", "filled": False},
    "rare": {"marker": "D"},
}
NAMES: Mapping[Measure, str] = {"success": "Success", "return": "Mean return"}
INTERVALS: Mapping[Measure, str] = {
    "success": "95 % Wilson interval (of episodes)",
    "return": "95 % interval (1.96 standard errors across evaluations)",
}
ZERO = 0.1  # where 0 stands on a logarithmic axis of counts


def charts(found: SeedStatistics, looks: Looks) -> list[Chart | HeatMaps]:
    """Every figure that a table has data for."""
    table = found.table
    every = (
        estimates(found, looks),
        learning_curves(table, looks),
        learning_curves(table, looks, "time"),
        averages(table, looks),
        frequencies(table),
        by_rank(table, looks),
        by_situation(table),
        by_visits(table, looks),
    )
    return [chart for chart in every if chart is not None]


def estimates(statistics: SeedStatistics, looks: Looks) -> Chart | None:
    """The interquartile mean of each row on each kind of levels, with its 95 % interval; the score,
    as an empty mark, where there are fewer than two seeds, or where levels have weights, which that
    mean does not know; the paper's score and those of policies that do not learn in grey. None
    without a score."""
    table, frame = statistics.table, statistics.frame
    scores = table.scores[table.scores["score"].notna()]
    rows = [row for row in table.rows if row.key in set(scores["row"])]
    if not rows:
        return None
    baselines = [one for one in BASELINES if table.baseline(one.name)]
    places, y = _row_axis([row.title for row in rows] + [one.title for one in baselines])
    known = frame[frame["statistic"] == IQM].set_index(["row", "level_kind"])
    panels = []
    for levels in table.kinds:
        kind = levels.level_kind
        lines: list[Line] = []
        of_kind = scores[scores["level_kind"] == kind].set_index("row")
        for row, place in zip(rows, places, strict=False):
            if row.key not in of_kind.index:
                continue
            found: Any = of_kind.loc[row.key]
            colour, key = looks.of(table, row).colour, f"row {row.key}"
            published = float(found["paper_value"])
            text = f"{row.title}: the paper {published:.2f}"
            paper = Line([published], [place], GREY, (), "paper", "The paper", points=[text])
            lines.append(replace(paper, marker="X", size=4.5, joined=False))
            score, text = float(found["score"]), f"{row.title}: {found['score']:.2f}"
            several = (row.key, kind) in known.index and not levels.is_weighted
            if several:
                estimate: Any = known.loc[(row.key, kind)]
                score, low, high = (float(estimate[one]) for one in ("value", "low", "high"))
                text = f"{row.title}: {estimate_text(score, low, high)}"
                lines.append(Line([low, high], [place] * 2, colour, key=key, width=2.4))
            dot = Line([score], [place], colour, key=key, points=[text])
            lines.append(replace(dot, marker="o", size=6, filled=several, joined=False))
        for one, place in zip(baselines, places[len(rows) :], strict=True):
            score = table.baseline(one.name).get(kind, math.nan)
            dot = Line([score], [place], GREY, points=[f"{one.title}: {score:.2f}"])
            lines.append(replace(dot, marker="o", size=5, joined=False))
        limits = _reach([line.x for line in lines])
        panels.append(Panel(KIND_NAMES[kind], lines, Axis("Score", limits), y))
    assert y.limits is not None
    return Chart(
        "scores",
        table.title,
        "interquartile mean with 95 % interval across seeds",
        panels,
        grey=_others(table, looks),
        note="Filled: interquartile mean of the scores of all seeds and levels; the line is the "
        "95 % interval of a stratified bootstrap over seeds. Empty: the score, where there are "
        "fewer than two seeds or levels have weights.",
        width=2.3 + 1.75 * len(panels),
        height=1.25 + 0.235 * y.limits[0],
    )


def learning_curves(table: ScoreTable, looks: Looks, across: str = "") -> Chart | None:
    """Score against updates, or frames, or with `across="time"` time: a panel per level kind, a
    line per row.

    The line is the median over seeds at each update, the band reaches from the lowest to the
    highest seed; the window is shaded; an axis above counts frames. Where rows learn from different
    numbers of frames in an update, and with an external agent, whose updates are not ours, the
    scores are drawn against frames: at one place of the axis all have had the same experience.
    A curve of an agent that began with the weights of another begins at the frames of that.

    Time is in hours, or in minutes below two hours: that of training and evaluation together,
    without external agents, whose time is not known, and those that began with another's weights,
    whose time is not all there is to it. Where runs were on different devices there is
    no figure of it.
    """
    across = across or ("update" if frames_follow_updates(table) else "frames")
    found = {
        (row.key, levels.level_kind): [_curve(run, levels, row.external) for run in row.runs]
        for row in table.rows
        for levels in table.kinds
    }
    every = pd.concat([seed for seeds in found.values() for seed in seeds], ignore_index=True)
    x = _time_axis(table, every, across) if len(every) else None
    if x is None:
        return None
    limits = _score_limits(table, every["score"])
    panels = []
    for levels in table.kinds:
        kind = levels.level_kind
        lines = []
        for row in table.rows:
            pooled = pd.concat(aligned(found[row.key, kind])).groupby("update")
            middle = pooled[["frames", "seconds", "score"]].median().reset_index()
            unit = {"Hours": 3600, "Minutes": 60}.get(x.title.split()[0], 1)
            several = len(row.runs) > 1
            places = middle["seconds" if across == "time" else across] / unit
            at = [f"{one:,.0f} {x.title.split()[0].lower()}" for one in places.fillna(0)]
            lines.append(
                _row_line(
                    table,
                    looks,
                    row,
                    places,
                    middle["score"],
                    marker="o" if len(middle) < 3 else "",
                    low=pooled["score"].min() if several else None,
                    high=pooled["score"].max() if several else None,
                    points=[
                        f"{row.title}: {score:.3f} at {place}"
                        for score, place in zip(middle["score"], at, strict=True)
                    ],
                )
            )
        known = {one.name: table.baseline(one.name) for one in BASELINES}
        assert x.limits is not None
        lines += _baseline_lines(
            {name: (x.limits, [of[kind]] * 2) for name, of in known.items() if kind in of}
        )
        panels.append(Panel(KIND_NAMES[kind], lines, x, Axis("Score", limits)))
    several = any(len(row.runs) > 1 for row in table.rows)
    against = x.title.split()[0].lower()
    inherited = any(run.description.pretrained for run in table.runs)
    return Chart(
        "time" if across == "time" else "learning",
        table.title,
        f"score against {against}" if across == "time" else "learning curves",
        panels,
        shaded="Window of the table" if x.shades else "",
        band="Lowest to highest seed" if several else "",
        grey=_others(table, looks),
        note=(
            "Median over the seeds that have come so far; band: lowest to highest of them."
            if several
            else "One seed."
        )
        + (" Shaded: the window of the table." if x.shades else "")
        + (
            " Curves of agents that began with another's weights begin at its frames."
            if inherited and across == "frames"
            else ""
        ),
    )


def _curve(run: Run, levels: Any, external: bool) -> pd.DataFrame:
    """A run's scores, with the frames of the run whose weights it began with."""
    means = run.mean_scores(levels)
    frames = means["frames"] + run.frames_before
    timed = not external and run.description.pretrained is None
    return means.assign(frames=frames, **({} if timed else {"seconds": math.nan}))


def _time_axis(table: ScoreTable, every: pd.DataFrame, across: str) -> Axis | None:
    """The horizontal axis of learning curves; `every` are all their points."""
    if across == "time":
        seconds = float(every["seconds"].max())
        if not seconds > 0 or len(devices_of(table.runs)) > 1:
            return None
        unit, length = ("Hours", 3600) if seconds >= 2 * 3600 else ("Minutes", 60)
        return Axis(f"{unit} of training and evaluation", (0.0, seconds / length or 1.0))
    last = every.iloc[int(every["update"].to_numpy().argmax())]
    above = ("Frames", last["frames"] / last["update"]) if last["update"] else None
    window = window_ends(table, across)
    return Axis(
        "Updates" if across == "update" else "Frames",
        (0.0, float(every[across].max()) or 1.0),
        whole=True,
        shades=[window] if window else (),
        above=above if across == "update" else None,
    )


def _score_limits(table: ScoreTable, scores: pd.Series) -> tuple[float, float]:
    """0 to 1 for success-like scores, with room above a line at 1; whatever is needed beyond."""
    known = [value for one in BASELINES for value in table.baseline(one.name).values()]
    low, high = min(0.0, scores.min(), *known), max(1.0, scores.max(), *known)
    return low - (0.05 if low < 0 else 0.02) * (high - low), high + 0.05 * (high - low)


def frames_follow_updates(table: ScoreTable) -> bool:
    """Whether all rows learn from the same number of frames in an update, from none at first."""
    if any(row.external for row in table.rows):
        return False
    if any(run.description.pretrained for run in table.runs):
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
        return (table.window.start, min(table.window.end, max(last, 1)))
    ends = set()
    for run in own:
        frames = evaluations_inside(run, table.window)["frames"] + run.frames_before
        if len(frames):
            ends.add((frames.min(), frames.max()))
    return ends.pop() if len(ends) == 1 else None


def averages(table: ScoreTable, looks: Looks) -> Chart | None:
    """The misleading average: a line for each row, its scores on the three kinds of levels, each
    with its lowest and highest seed; those of policies that do not learn below, in grey.

    After the paper's figure of one agent, almost perfect on the training distribution and below
    60 % on the rarest objects. None without a score, or where not all three kinds have levels.
    """
    scores = table.scores.pivot(index="row", columns="level_kind", values="score")
    if not set(PAPER_KINDS) <= set(scores):
        return None
    scores = scores[[*PAPER_KINDS]]
    rows = [row for row in table.rows if scores.loc[row.key].notna().any()]
    if not rows:
        return None
    names = [row.title for row in rows]
    points = [pd.Series(scores.loc[row.key]) for row in rows]
    colours = [looks.of(table, row).colour for row in rows]
    for one in BASELINES:
        if baseline := table.baseline(one.name):
            names.append(one.title)
            points.append(pd.Series(baseline).reindex(scores.columns))
            colours.append(GREY)
    places, y = _row_axis(names)
    lines, ranges = [], False
    for number, (place, of_kinds) in enumerate(zip(places, points, strict=True)):
        colour, key = colours[number], f"row {rows[number].key}" if number < len(rows) else ""
        ends = [of_kinds.min(), of_kinds.max()]
        lines.append(Line(ends, [place] * 2, "#EBEBEB", key=key, width=2, behind=True))
        for levels in table.kinds:
            if (kind := levels.level_kind) not in KIND_MARKS:
                continue
            if number < len(rows):
                seeds = seed_means(rows[number], levels, table.window).values()
                if len(seeds) > 1:
                    ranges = True
                    ends = [min(seeds), max(seeds)]
                    lines.append(Line(ends, [place] * 2, colour, key=key, width=5, opacity=0.3))
            text = f"{names[number]}: {KIND_NAMES[kind]} {of_kinds[kind]:.2f}"
            dot = Line([of_kinds[kind]], [place], colour, key=key, points=[text], size=6.5)
            lines.append(replace(dot, joined=False, **KIND_MARKS[kind]))
    for kind, mark in KIND_MARKS.items():  # for the legend alone, which knows no opacity
        title = KIND_NAMES[kind]
        lines.append(
            Line([0.0], [0.0], GREY, (), kind, title, size=6.5, joined=False, opacity=0.0, **mark)
        )
    assert y.limits is not None
    return Chart(
        "averages",
        table.title,
        "what the training score hides",
        [Panel("", lines, Axis("Score", _reach([line.x for line in lines])), y)],
        band="Lowest to highest seed" if ranges else "",
        grey=_others(table, looks),
        note="Circle: on the training distribution; square: uniform; diamond: rare.",
        width=7.4,
        height=1.3 + 0.3 * y.limits[0],
    )


def frequencies(table: ScoreTable) -> Chart | None:
    """The share of episodes at each rank of the situation, on train, uniform and rare levels, both
    axes logarithmic: Zipf's law is a straight line."""
    found = {name: shares(table, name) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    every = pd.concat([of_rank["share"] for of_rank in found.values()])
    y = _log_axis("Share of episodes", every, lambda share: f"{100 * share:.3g} %")
    panels = []
    for name, of_rank in found.items():
        lines = []
        for kind, mark in KIND_MARKS.items():
            of_kind = of_rank[of_rank["level_kind"] == kind]
            ranks = of_kind[name] + 1
            lines.append(
                Line(
                    ranks,
                    of_kind["share"],
                    GREY if kind == "uniform" else "#000000",
                    key=kind,
                    title=KIND_NAMES[kind],
                    labelled=True,
                    points=[
                        f"{KIND_NAMES[kind]}, rank {rank}: {share:.3%}"
                        for rank, share in zip(ranks, of_kind["share"], strict=True)
                    ],
                    **mark,
                )
            )
        count = rank_counts(table)[name]
        x = _log_axis(_rank_title(name), range(1, count + 1), lambda rank: f"{rank:.0f}")
        x = replace(x, limits=(0.9, 1.1 * count), shades=_rare(table, name))
        panels.append(Panel(spoken(name), lines, x, y))
    marked = any(panel.x.shades for panel in panels)
    return Chart(
        "frequency",
        table.title,
        "how often situations occur",
        panels,
        shaded="Rare ranks" if marked else "",
        note="In the evaluations of all runs here."
        + (" Shaded: the ranks of the rare levels." if marked else ""),
    )


def by_rank(table: ScoreTable, looks: Looks) -> Chart | None:
    """Success on the uniform levels against each rank of the situation, with 95 % intervals; the
    mean return where success is not reported.

    Baselines are drawn at each rank where they are known there, else as their mean over all ranks.
    """
    measure = measure_of(table)
    found = {name: rates(table, [name], measure=measure) for name in situation_names(table)}
    found = {name: of_rank for name, of_rank in found.items() if len(of_rank)}
    if not found:
        return None
    means = {one.name: baseline_on_uniform(table, measure, one.name) for one in BASELINES}
    ranked = {one.name: baseline_by_rank(table, measure, one.name) for one in BASELINES}
    panels = []
    for name, of_rank in found.items():
        of_rank = of_rank.assign(rank=of_rank[name] + 1)
        of_rank["at"] = [f"rank {rank}" for rank in of_rank["rank"]]
        lines = _measured(table, looks, of_rank, "rank")
        count = rank_counts(table)[name]
        ends = (0.5, count + 0.5)
        each = {}
        for one, mean in means.items():
            if name in ranked[one]:
                each[one] = (np.arange(1.0, count + 1), ranked[one][name])
            elif mean is not None:
                each[one] = (np.array(ends), [mean] * 2)
        lines += _baseline_lines(each)
        x = Axis(_rank_title(name), ends, ticks=rank_ticks(count), shades=_rare(table, name))
        panels.append(Panel(spoken(name), lines, x, _measure_axis(table, measure)))
    marked = any(panel.x.shades for panel in panels)
    return Chart(
        "ranks",
        table.title,
        f"{NAMES[measure].lower()} against frequency rank",
        panels,
        shaded="Rare" if marked else "",
        band=INTERVALS[measure],
        grey=_others(table, looks),
        note=f"On the uniform levels. Band: {INTERVALS[measure]}."
        + (" Shaded: the ranks of the rare levels." if marked else "")
        + " A baseline that is not known at each rank is its mean.",
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
    key = "rank 1: most frequent; framed: rare" + ("; grey: no episode" if gaps else "")
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
        f"On the uniform levels; {key}.",
    )


def by_visits(table: ScoreTable, looks: Looks) -> Chart | None:
    """Success, or the mean return, on the uniform levels against how often training had met the
    situation, and each of its ranks; None where no run has counted it."""
    measure = measure_of(table)
    found = {name: rates_by_visits(table, name, measure) for name in visit_names(table)}
    found = {name: groups for name, groups in found.items() if len(groups)}
    if not found:
        return None
    panels = []
    for name, groups in found.items():
        groups = groups.assign(place=groups["met"].replace(0.0, ZERO))
        groups["at"] = [f"met {count_text(int(met))} times" for met in groups["met"]]
        rank = name.removeprefix("visits").removeprefix("_").replace("_", " ")
        x = _visits_axis(f"Times training met the {rank or 'situation'}", groups["met"])
        lines = _measured(table, looks, groups, "place")
        panels.append(
            Panel(rank.capitalize() or "Situation", lines, x, _measure_axis(table, measure))
        )
    return Chart(
        "visits",
        table.title,
        f"{NAMES[measure].lower()} against experience",
        panels,
        band=INTERVALS[measure],
        grey=_others(table, looks),
        note=f"{NAMES[measure]} on the uniform levels against how often training had met the "
        f"situation, or the one rank of it, in groups by powers of two; where it was counted. "
        f"Band: {INTERVALS[measure]}.",
    )


# --- what they have in common ----------------------------------------------------------------


def _row_line(
    table: ScoreTable, looks: Looks, row: Row, x: Numbers, y: Numbers, **more: Any
) -> Line:
    """A line of a row of the table, grey, thin and without a band where it is not in colour; `more`
    are attributes of the line."""
    style = looks.of(table, row)
    line = Line(x, y, *style, f"row {row.key}", row.title, **more)
    if row.key in looks.coloured[table.name]:
        return replace(line, labelled=True)
    return replace(line, width=0.8, title="", low=None, high=None, marker="", behind=True)


def _others(table: ScoreTable, looks: Looks) -> str:
    """What grey rows are; empty where there are none."""
    rule = looks.rule[table.name]
    others = len(table.rows) - len(looks.coloured[table.name])
    return f"{others} other{'s' if others > 1 else ''} (in colour: {rule})" if rule else ""


def _baseline_lines(found: Mapping[str, tuple[Numbers, Numbers]]) -> list[Line]:
    """The lines of policies that do not learn, of which `found` has places and values; one line for
    those that lie on each other."""
    lines: list[Line] = []
    for one in (one for one in BASELINES if one.name in found):
        x, y = found[one.name]
        for place, other in enumerate(lines):
            if np.allclose(np.interp(x, other.x, other.y), y, atol=0.005) and _spans(other.x, x):
                title = f"{other.title}, {one.title}"
                lines[place] = replace(other, title=title, points=[title] * len(other.y))
                break
        else:
            texts = [f"{one.title}: {value:.3f}" for value in y]
            line = Line(x, y, GREY, BASELINE_DASHES[one.name], one.name, one.title, labelled=True)
            lines.append(replace(line, width=1.2, behind=True, points=texts))
    return lines


def _spans(one: Numbers, other: Numbers) -> bool:
    """Whether the one's places reach as far as the other's, within a rank."""
    ends = np.asarray(one, float)[[0, -1]], np.asarray(other, float)[[0, -1]]
    return bool(np.abs(ends[0] - ends[1]).max() <= 1)


def _row_axis(names: Sequence[str]) -> tuple[list[float], Axis]:
    """The places of rows that stand one below the other, the first on top, and their axis."""
    titles = [textwrap.fill(name, 34) for name in names]
    # The first line of a title needs a row, each further one about half of that.
    heights = np.array([1 + 0.6 * title.count("\n") for title in titles])
    places = (np.cumsum(heights) - heights / 2 - 0.5).tolist()  # 0, 1, 2, ... for single lines
    return places, Axis("", (heights.sum() - 0.5, -0.5), ticks=(places, titles))


def _reach(values: Sequence[Numbers]) -> tuple[float, float]:
    """The limits of an axis of scores: 0 to 1 and whatever is needed beyond, with some room."""
    every = [number for one in values for number in np.asarray(one, float) if np.isfinite(number)]
    low, high = min(0.0, *every), max(1.0, *every)
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _measured(table: ScoreTable, looks: Looks, found: pd.DataFrame, across: str) -> list[Line]:
    """For each row of the table `value` against the column `across`, and the interval from `low` to
    `high`; the column `at` has each place in words."""
    lines = []
    markers = itertools.cycle(MARKERS)
    for row in table.rows:
        of_row = found[found["row_key"] == row.key]
        in_colour = row.key in looks.coloured[table.name]
        texts = [
            f"{row.title}, {line.at}: {line.value:.3f} of {line.episodes:,.0f} episodes"
            for line in of_row.itertuples()
        ]
        lines.append(
            _row_line(
                table,
                looks,
                row,
                of_row[across],
                of_row["value"],
                marker=next(markers) if in_colour else "",
                low=of_row["low"],
                high=of_row["high"],
                points=texts,
            )
        )
    return lines


def _measure_axis(table: ScoreTable, measure: Measure) -> Axis:
    several = any(levels.level_kind == "uniform" for levels in table.groups)
    title = f"{NAMES[measure]} on the uniform {'levels' if several else 'level'}"
    return Axis(title, (-0.03, 1.05) if measure == "success" else None)


def _rank_title(name: str) -> str:
    return f"{spoken(name)} rank (1 = most frequent)"


def rank_ticks(count: int) -> tuple[list[float], list[str]]:
    """Ranks from 1: all of a few, else the first and round ones."""
    steps = (round_ * 10**power for power in itertools.count() for round_ in (1, 2, 5))
    step = next(step for step in steps if count / step <= 6)
    ranks = list(dict.fromkeys([1, *range(step, count + 1, step)]))
    if step > 1 and len(ranks) > 1 and ranks[1] - 1 < step / 2:
        ranks.pop(1)
    return [float(rank) for rank in ranks], [str(rank) for rank in ranks]


def _rare(table: ScoreTable, name: str) -> list[tuple[float, float]]:
    """The stretches of a rank, from 1, that the rare levels have."""
    return [(first + 0.5, last + 1.5) for first, last in spans(rare_ranks(table, name))]


def _log_axis(
    title: str, values: Iterable[float], text: Callable[[float], str], most: int = 12
) -> Axis:
    """A logarithmic axis for these values, which are positive: ticks at 1, 2 and 5 times the powers
    of ten, or at every power or every second one where these would be more than `most`; at the ends
    where all values lie between two of them."""
    low, high = min(values), max(values)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    limits = low / 1.3, high * 1.3
    ticks = [float(f"{step}e{power}") for power in powers for step in (1, 2, 5)]
    for of_powers in (1, 2, 3):
        if sum(limits[0] <= tick <= limits[1] for tick in ticks) <= most:
            break
        ticks = [float(f"1e{power}") for power in powers[::of_powers]]
    ticks = [tick for tick in ticks if limits[0] <= tick <= limits[1]] or sorted({low, high})
    return Axis(title, limits, log=True, ticks=(ticks, [text(tick) for tick in ticks]))


def _visits_axis(title: str, visits: pd.Series) -> Axis:
    """A logarithmic axis for numbers of times, of which 0 stands at `ZERO`."""

    def text(count: float) -> str:  # `20k`
        sizes = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (0.0, ""))
        size, letter = next(one for one in sizes if count >= one[0])
        return f"{count / (size or 1):.3g}{letter}"

    if visits.min() > 0:
        return _log_axis(title, visits, text, most=6)
    axis = _log_axis(title, [1.0, *visits[visits > 0]], text, most=5)
    assert axis.ticks is not None
    assert axis.limits is not None
    places, texts = axis.ticks
    return replace(
        axis, limits=(ZERO / 1.3, axis.limits[1]), ticks=([ZERO, *places], ["0", *texts])
    )
