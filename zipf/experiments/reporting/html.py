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
from typing import Any, ClassVar

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from zipf.experiments.records import video_files
from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import count_text, duration_text, seeds_list
from zipf.experiments.reporting.claims import ClaimLine
from zipf.experiments.reporting.comparable import differences
from zipf.experiments.reporting.draw_plotly import dash, specification
from zipf.experiments.reporting.glossary import GLOSSARY
from zipf.experiments.reporting.grids import (
    Grid,
    caption,
    claims_caption,
    lower_grids,
    main_grid,
    side_by_side_caption,
    side_by_side_grids,
)
from zipf.experiments.reporting.markdown import CLAIM_HEADER, RUN_COLUMNS, claim_cells, run_cells
from zipf.experiments.reporting.panels import Chart, LineStyle, charts, legend, line_styles
from zipf.experiments.reporting.seed_statistics import SeedStatistics, without_statistics
from zipf.experiments.reporting.side_by_side import side_by_side
from zipf.experiments.reporting.tables import Row, ScoreTable

SHOWN = ("learning", "ranks", "frequency", "visits")  # the figures of a page


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
    """A table."""

    kind: ClassVar[str] = "cells"
    title: str  # above it
    head: Sequence[str]  # the headings of its columns
    # its cells; the first `leading` of a line are its heading or text
    lines: Sequence[Sequence[str]]
    baselines: Sequence[Sequence[str]] = ()  # lines apart from the others
    paper: frozenset[int] = frozenset()  # the places of the columns with the paper's numbers
    leading: int = 1  # how many columns hold text, from the left
    folded: bool = False  # whether the reader has to open it


@dataclass(frozen=True)
class Figures:
    """Panels with one legend."""

    kind: ClassVar[str] = "figures"
    name: str  # unique in a page
    # a title, a caption and panels each; of a panel its name, unique in a page, what it shows, for
    # those who do not see it, and what is drawn
    groups: Sequence[tuple[str, str, Sequence[tuple[str, str, Mapping[str, Any]]]]]
    # key, title, colour and dashes of its lines; a reader can hide them one by one
    legend: Sequence[tuple[str, str, str, str]]
    # the choices of the horizontal axis by their key; empty where there is none
    axes: Mapping[str, str]
    axis: str  # the one chosen first


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
    statistics across seeds, what all runs differ in, where there are several tables, and the
    glossary. Raises UserError: a run's configuration or a video cannot be read."""
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
    words = Cells("Words", ("Word", "Meaning"), GLOSSARY, leading=2, folded=True)
    return [*sections, Section("Glossary", (words,))]


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
        baselines=[grid.cells(line) for line in grid.baselines],
        paper=frozenset(paper),
        folded=folded,
    )


def _figures(table: ScoreTable, styles: Mapping[str, LineStyle]) -> list[Figures]:
    known = {chart.kind: chart for chart in charts(table, styles) if isinstance(chart, Chart)}
    shown = [known[kind] for kind in SHOWN if kind in known]
    if not shown:
        return []
    groups = []
    for chart in shown:
        panels = [
            (
                f"{table.name}-{chart.kind}-{number}",
                f"{table.title}: {chart.subject}, {panel.title}",
                specification(panel, chart.choice),
            )
            for number, panel in enumerate(chart.panels)
        ]
        groups.append((f"{chart.subject[0].upper()}{chart.subject[1:]}", chart.note, panels))
    lines = legend([panel for chart in shown for panel in chart.panels])
    entries = [(line.key, line.title, line.colour, dash(line.dash)) for line in lines]
    first = shown[0]
    axes = {key: axis.title for key, axis in first.panels[0].x.items() if key}
    return [Figures(f"{table.name}-axis", groups, entries, axes, first.choice)]


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
    configuration = yaml.safe_dump(dict(run.options), sort_keys=False) if run.options else ""
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
