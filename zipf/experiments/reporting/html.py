"""The report as one HTML page, which needs no other file, no server and no network.

A page is a list of sections, a section a list of blocks; `templates/report.html.jinja` has a macro
for each kind of block. All text is escaped. A policy in the page's head allows the page's own two
scripts by their checksums and nothing from elsewhere.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from zipf.experiments.records import video_files
from zipf.experiments.records.csv_files import read_bytes
from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import (
    count_text,
    duration_text,
    seeds_list,
)
from zipf.experiments.reporting import html_learning, html_situations
from zipf.experiments.reporting.captions import caption, claims_caption, side_by_side_caption
from zipf.experiments.reporting.claims import ClaimLine
from zipf.experiments.reporting.differences import differences
from zipf.experiments.reporting.frequencies import episodes_behind
from zipf.experiments.reporting.grids import Grid, lower_grids, main_grid, side_by_side_grids
from zipf.experiments.reporting.html_panels import LegendEntry, Panel, legend
from zipf.experiments.reporting.markdown import (
    CLAIM_HEADER,
    RUN_COLUMNS,
    claim_cells,
    run_cells,
)
from zipf.experiments.reporting.seed_statistics import SeedStatistics, without_statistics
from zipf.experiments.reporting.side_by_side import side_by_side
from zipf.experiments.reporting.situation_figures import NAMES
from zipf.experiments.reporting.situations import measure_of
from zipf.experiments.reporting.styles import LineStyle, line_styles
from zipf.experiments.reporting.tables import Row, ScoreTable


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Notes:
    """A list of what is missing or doubtful."""

    kind: ClassVar[str] = "notes"
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Cells:
    """A table.

    Attributes:
        title: above it.
        head: the headings of its columns.
        lines: its cells; the first `leading` of a line are its heading or text.
        references: lines apart from the others.
        paper: the places of the columns with the paper's numbers.
        leading: how many columns hold text, from the left.
        folded: whether the reader has to open it.
    """

    kind: ClassVar[str] = "cells"
    title: str
    head: Sequence[str]
    lines: Sequence[Sequence[str]]
    references: Sequence[Sequence[str]] = ()
    paper: frozenset[int] = frozenset()
    leading: int = 1
    folded: bool = False


@dataclass(frozen=True)
class Figures:
    """Panels with one legend.

    Attributes:
        name: unique in a page.
        groups: a title, a caption and panels each.
        legend: its lines; a reader can hide them one by one.
        axes: the choices of the horizontal axis by their key; empty where there is none.
        axis: the one chosen first.
    """

    kind: ClassVar[str] = "figures"
    name: str
    groups: Sequence[tuple[str, str, Sequence[Panel]]]
    legend: Sequence[LegendEntry]
    axes: Mapping[str, str]
    axis: str


@dataclass(frozen=True)
class Clip:
    """A video in the page; `address` is a `data:` address, None where there is no such episode."""

    text: str
    address: str | None
    is_film: bool = False


@dataclass(frozen=True)
class Clips:
    """The videos of a run; for each situation its name and its videos."""

    kind: ClassVar[str] = "clips"
    title: str
    groups: Sequence[tuple[str, Sequence[Clip]]]


@dataclass(frozen=True)
class RunDetails:
    """What is known of a run; `facts` are names and texts."""

    kind: ClassVar[str] = "run"
    title: str
    facts: Sequence[tuple[str, str]]
    configuration: str


Block = Text | Notes | Cells | Figures | Clips | RunDetails


@dataclass(frozen=True)
class Section:
    """A part of a page, with a heading and an entry in its table of contents."""

    title: str
    blocks: Sequence[Block]


def report_sections(
    tables: Sequence[ScoreTable],
    claims: Sequence[ClaimLine] = (),
    statistics: Sequence[SeedStatistics] = (),
) -> list[Section]:
    """The sections of a report: one for each table, then the paper's layouts, its claims,
    statistics across seeds, and what all runs differ in, where there are several tables.

    Raises:
        UserError: a run's configuration or a video cannot be read.
    """
    styles = line_styles([row for table in tables for row in table.rows])
    sections = [table_section(table, styles) for table in tables]
    for beside in side_by_side(tables):
        grids = [cells_of(grid) for grid in side_by_side_grids(beside)]
        title = grids[0].title if len(grids) == 1 else "Side by side"
        sections.append(Section(title, (*grids, Text(side_by_side_caption(beside)))))
    if cells := claim_cells(claims):
        shown = Cells("Claims", CLAIM_HEADER, cells, leading=len(CLAIM_HEADER))
        sections.append(Section("Claims of the paper", (shown, Text(claims_caption(claims)))))
    if statistics:
        blocks: list[Block] = []
        for one in statistics:
            name = one.table.title
            blocks += [cells_of(grid, f"{name}: {grid.title}") for grid in one.grids]
            if one.grids:
                blocks.append(Text(one.text))
        if rest := without_statistics(statistics):
            blocks.append(Text(rest))
        sections.append(Section("Statistics across seeds", blocks))
    if len(tables) > 1:
        every = list(dict.fromkeys(run for table in tables for run in table.runs))
        differing = _differences(every, "Options that differ", True)
        sections.append(Section("Differences between all runs", differing))
    return sections


def page(sections: Sequence[Section]) -> str:
    """The page. It depends on the sections alone."""
    from plotly.offline import get_plotlyjs

    environment = Environment(
        loader=PackageLoader("zipf.experiments.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["script_data"] = _script_data
    own = _template("report.js")
    scripts = [get_plotlyjs(), own]
    return environment.get_template("report.html.jinja").render(
        title="Zipfian environments: report",
        sections=sections,
        style=Markup(_template("report.css")),
        scripts=[Markup(script) for script in scripts],
        policy=_policy(scripts),
    )


def table_section(table: ScoreTable, styles: Mapping[str, LineStyle]) -> Section:
    """Scores, figures and runs of a table."""
    blocks: list[Block] = [cells_of(main_grid(table), "Scores")]
    blocks += [cells_of(grid, folded=True) for grid in lower_grids(table)]
    blocks.append(Text(caption(table)))
    if table.notes:
        blocks.append(Notes(table.notes))
    blocks += _figures(table, styles)
    pairs = [(row, run) for row in table.rows for run in row.runs]
    lines = [run_cells(row, run) for row, run in pairs]
    blocks.append(Cells("Runs", RUN_COLUMNS, lines))
    blocks += _differences(table.runs, "Options that differ between runs", False)
    blocks += [clips for row, run in pairs for clips in _clips(row, run)]
    blocks += [_details(row, run) for row, run in pairs]
    return Section(table.title, blocks)


def cells_of(grid: Grid, title: str = "", folded: bool = False) -> Cells:
    """A score table."""
    head, paper = [*grid.leading], set()
    for column, published in zip(grid.columns, grid.has_paper, strict=True):
        head.append(column)
        if published:
            paper.add(len(head))
            head.append("paper")
    return Cells(
        title=title or grid.title[0].upper() + grid.title[1:],
        head=head,
        lines=[grid.cells(line) for line in grid.lines],
        references=[grid.cells(line) for line in grid.references],
        paper=frozenset(paper),
        folded=folded,
    )


def _figures(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Figures]:
    measure = NAMES[measure_of(table)]
    several = any(len(row.runs) > 1 for row in table.rows)
    found = []
    if curves := html_learning.learning_curves(table, styles):
        text = "Thick: median over seeds; thin: each seed." if several else "One seed."
        if any(panel.layout.get("shapes") for panel in curves):
            text += " Shaded: the window of the table."
        found.append(("Learning curves", text, curves))
    if ranks := html_situations.by_rank(table, styles):
        text = f"On the uniform levels. Band: {html_situations.band_text(table)}."
        if any(panel.layout.get("shapes") for panel in ranks):
            text += " Shaded: the ranks of the rare levels."
        found.append((f"{measure} against rank", text, ranks))
    if shares := html_situations.frequencies(table):
        count = count_text(episodes_behind(table))
        text = f"As met in {count} evaluation episodes on the train levels, over all runs here."
        found.append(("Frequency of situations in training", text, shares))
    if met := html_situations.by_times_met(table, styles):
        text = (
            f"A point is a rank: {measure.lower()} on the uniform levels against the training "
            f"episodes at this rank until the last evaluation, "
            f"{html_situations.counting_text(table)} Bars: "
            f"{html_situations.band_text(table)}."
        )
        found.append((f"{measure} against the number of times met", text, met))
    if not found:
        return []
    axes = html_learning.axes_of(table) if curves else {}
    axis = html_learning.default_axis(table)
    return [Figures(f"{table.name}-axis", found, legend(table, styles), axes, axis)]


def _differences(runs: Sequence[Run], title: str, with_experiment: bool) -> list[Block]:
    found = differences(runs)
    if len(found.columns) < 2:
        alike = "Runs do not differ in their options, but for the seed."
        return [Text(alike)] if len(runs) > 1 and found.columns else []
    head = ["Option"]
    for column in found.columns:
        first = column[0].description
        titles = dict.fromkeys(run.description.row.title for run in column)
        name = f"{', '.join(titles)}, {seeds_list([run.description.seed for run in column])}"
        head.append(f"{first.experiment}: {name}" if with_experiment else name)
    lines = [[name, *texts] for name, texts in found.lines]
    return [Cells(title, head, lines, leading=len(head), folded=len(found.columns) > 4)]


def _details(row: Row, run: Run) -> RunDetails:
    one = run.description
    resumed = ", ".join(f"update {again.get('update')}" for again in one.resumed)
    facts = {
        "Folder": run.label,
        "Command": one.last_command,
        "Commit": one.commit,
        "Device": one.device,
        "Precision": one.precision,
        "PyTorch": one.torch,
        "zipf": one.version,
        "Updates": None if row.external else count_text(run.updates),
        "Frames": count_text(run.frames),
        "Wall time": None if row.external else duration_text(run.seconds),
        "Resumed at": resumed or None,
    }
    path = run.folder / "config.yaml"
    configuration = "" if one.external else read_bytes(path).decode("utf-8", errors="replace")
    known = [(name, text) for name, text in facts.items() if text is not None]
    return RunDetails(f"{row.title}, seed {one.seed}", known, configuration)


def _clips(row: Row, run: Run) -> list[Clips]:
    found = video_files.read(run.folder)
    if found is None:
        return []
    groups = []
    for one in found.situations:
        ranks = ", ".join(f"{name} {rank}" for name, rank in one.ranks.items())
        name = (
            f"{one.title[0].upper()}{one.title[1:]} ({one.level}, rank: {ranks}): "
            f"{one.successes} of {one.episodes} episodes succeeded"
        )
        groups.append((name, [_clip(run, one, outcome) for outcome in video_files.OUTCOMES]))
    title = (
        f"Videos: {row.title}, seed {run.description.seed}, at update {count_text(found.update)}"
    )
    return [Clips(title, groups)]


def _clip(run: Run, situation: video_files.VideosOfSituation, outcome: video_files.Outcome) -> Clip:
    video = situation.of(outcome)
    if video is None:
        return Clip(f"No {outcome} in {count_text(situation.episodes)} episodes.", None)
    text = (
        f"{outcome.capitalize()}: seed {video.seed}, return {video.episode_return:g}, "
        f"{video.length} frames" + (f", one in {video.every} shown" if video.every > 1 else "")
    )
    address = video_files.data_address(run.folder, video)
    return Clip(text, address, is_film=address.startswith("data:video"))


def _script_data(value: object) -> Markup:
    """JSON for a `<script type="application/json">`, in which no text can end the element."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return Markup(text)


def _template(name: str) -> str:
    folder = resources.files("zipf.experiments.reporting").joinpath("templates")
    return folder.joinpath(name).read_text(encoding="utf-8")


def _policy(scripts: Sequence[str]) -> str:
    """Only these scripts run, and nothing is loaded."""
    sums = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(one).decode()}'" for one in sums)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        f"img-src data: blob:; media-src data:; form-action 'none'; base-uri 'none'"
    )
