"""The report as one HTML page, which needs no other file, no server and no network.

A page is a list of sections, a section a list of blocks; `templates/blocks.html.jinja` has a macro
for each kind of block, of the name of its class. All text is escaped. Figures are pictures within
the page. A policy in the page's head allows the page's own script by its checksum and nothing from
elsewhere.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from zipf.experiments.records import video_files
from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import count_text, seeds_list
from zipf.experiments.reporting.charts import charts
from zipf.experiments.reporting.claims import ClaimLine
from zipf.experiments.reporting.comparable import differences
from zipf.experiments.reporting.draw_matplotlib import PAGE_COLOURS, inline, parts, style
from zipf.experiments.reporting.glossary import GLOSSARY
from zipf.experiments.reporting.grids import (
    Grid,
    caption,
    claims_caption,
    legend,
    lower_grids,
    main_grid,
    side_by_side_caption,
    side_by_side_grids,
)
from zipf.experiments.reporting.markdown import CLAIM_HEADER, RUN_COLUMNS, claim_cells, run_cells
from zipf.experiments.reporting.panels import Chart, Looks
from zipf.experiments.reporting.seed_statistics import SeedStatistics, reading
from zipf.experiments.reporting.side_by_side import side_by_side
from zipf.experiments.reporting.tables import Row


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Notes:
    """A list of what is missing or doubtful."""

    notes: tuple[str, ...]


@dataclass(frozen=True)
class Cells:
    """A table."""

    title: str  # above it
    head: Sequence[str]  # the headings of its columns
    # its cells; the first `leading` of a line are its heading or text
    lines: Sequence[Sequence[str]]
    baselines: Sequence[Sequence[str]] = ()  # lines apart from the others
    paper: frozenset[int] = frozenset()  # the places of the columns with the paper's numbers
    leading: int = 1  # how many columns hold text, from the left
    colours: Sequence[str] = ()  # of the agents of its lines, as figures have them; empty for none
    folded: bool = False  # whether the reader has to open it


@dataclass(frozen=True)
class Figure:
    """Pictures that belong together, side by side or one below the other."""

    title: str
    pictures: Sequence[tuple[str, Markup]]  # what each shows, for those who do not see it, and it
    note: str
    wide: bool  # whether a picture is as wide as the page


@dataclass(frozen=True)
class Lines:
    """The rows of the figures after it, which a reader can hide one by one."""

    rows: Sequence[tuple[str, str, str]]  # key, title and colour


@dataclass(frozen=True)
class Clip:
    """A video in the page; `address` is a `data:` address, None where there is no such episode."""

    text: str
    address: str | None
    is_film: bool = False


@dataclass(frozen=True)
class Clips:
    """The videos of a run; for each situation its name and its videos."""

    title: str
    groups: Sequence[tuple[str, Sequence[Clip]]]


@dataclass(frozen=True)
class RunDetails:
    """What is known of a run; `facts` are names and texts."""

    title: str
    facts: Sequence[tuple[str, str]]
    configuration: str


Block = Text | Notes | Cells | Figure | Lines | Clips | RunDetails


@dataclass(frozen=True)
class Section:
    """A part of a page, with a heading and an entry in its table of contents."""

    title: str
    blocks: Sequence[Block]


def report_sections(
    statistics: Sequence[SeedStatistics], looks: Looks, claims: Sequence[ClaimLine] = ()
) -> list[Section]:
    """The sections of a report: one for each table, then how to read them, the paper's layouts, its
    claims, statistics across seeds, what all runs differ in, where there are several tables, and
    the glossary. Raises UserError: a run's configuration or a video cannot be read."""
    with style():
        sections = [
            table_section(one, looks, f"t{number}") for number, one in enumerate(statistics)
        ]
    tables = [one.table for one in statistics]
    sections.append(Section("How to read the tables", (Notes(tuple(legend(tables))),)))
    for beside in side_by_side(tables):
        grids = [cells_of(grid) for grid in side_by_side_grids(beside)]
        title = grids[0].title if len(grids) == 1 else "Side by side"
        sections.append(Section(title, (*grids, Text(side_by_side_caption(beside)))))
    if cells := claim_cells(claims):
        shown = Cells("Claims", CLAIM_HEADER, cells, leading=len(CLAIM_HEADER))
        sections.append(Section("Claims of the paper", (shown, Text(claims_caption(claims)))))
    blocks: list[Block] = [
        cells_of(grid, f"{one.table.title}: {grid.title}")
        for one in statistics
        for grid in one.grids
    ]
    blocks.append(Notes(tuple(reading(statistics))))
    sections.append(Section("Statistics across seeds", blocks))
    if len(tables) > 1:
        every = list(dict.fromkeys(run for table in tables for run in table.runs))
        differing = _differences(every, "Options that differ", True)
        sections.append(Section("Differences between all runs", differing))
    words = Cells("Words", ("Word", "Meaning"), GLOSSARY, leading=2, folded=True)
    return [*sections, Section("Glossary", (words,))]


def page(sections: Sequence[Section]) -> str:
    """The page. It depends on the sections alone."""
    loader = PackageLoader("zipf.experiments.reporting")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = breakable
    script, *_ = loader.get_source(environment, "report.js")
    return environment.get_template("report.html.jinja").render(
        title="Zipfian environments: report",
        sections=sections,
        script=Markup(script),
        policy=_policy(script),
    )


def table_section(found: SeedStatistics, looks: Looks, name: str) -> Section:
    """Scores, figures and runs of a table; `name` is unique in the page."""
    table = found.table
    drawn = [looks.of(table, row).colour.lower() for row in table.rows]
    colours = [PAGE_COLOURS.get(colour, colour) for colour in drawn]
    blocks: list[Block] = [cells_of(main_grid(table), "Scores", colours=colours)]
    blocks += [cells_of(grid, folded=True) for grid in lower_grids(table)]
    blocks.append(Text(caption(table)))
    if table.notes:
        blocks.append(Notes(table.notes))
    lines = zip(table.rows, colours, strict=True)
    blocks.append(Lines([(f"row {row.key}", row.title, colour) for row, colour in lines]))
    blocks += _figures(found, looks, name)
    pairs = [(row, run) for row in table.rows for run in row.runs]
    blocks.append(Cells("Runs", RUN_COLUMNS, [run_cells(row, run) for row, run in pairs]))
    blocks += _differences(table.runs, "Options that differ between runs", False)
    blocks += [clips for row, run in pairs for clips in _clips(row, run)]
    blocks += [_details(row, run) for row, run in pairs]
    return Section(table.title, blocks)


def cells_of(
    grid: Grid, title: str = "", folded: bool = False, colours: Sequence[str] = ()
) -> Cells:
    """A score table; `colours` are those of its lines."""
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
        colours=colours,
        folded=folded,
    )


def _figures(found: SeedStatistics, looks: Looks, name: str) -> list[Figure]:
    figures = []
    for chart in charts(found, looks):
        pictures = []
        wide = isinstance(chart, Chart) and chart.width is not None
        for number, part in enumerate(parts(chart)):
            what = part.panels[0].title if isinstance(part, Chart) else part.maps[0][0]
            what = "" if wide else what  # a picture of all panels
            label = f"{chart.table}: {chart.subject}{', ' if what else ''}{what}"
            drawn = inline(part, f"{name}-{chart.kind}-{number}")
            pictures.append((label, Markup(drawn)))
        grey = getattr(chart, "grey", "")
        note = f"{chart.note} Grey: {grey}." if grey else chart.note
        title = f"{chart.subject[0].upper()}{chart.subject[1:]}"
        figures.append(Figure(title, pictures, note, wide))
    return figures


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
    """What the table of runs has no room for."""
    one = run.description
    resumed = ", ".join(f"update {again.get('update')}" for again in one.resumed)
    facts = (("Folder", run.label), ("Command", one.last_command), ("Resumed at", resumed))
    configuration = yaml.safe_dump(dict(run.options), sort_keys=False) if run.options else ""
    known = [(name, text) for name, text in facts if text]
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


def breakable(text: str) -> Markup:
    """Text whose long words, such as lists of options, may be broken behind punctuation only."""
    return Markup(re.sub(r"([,=/:])(?=[^\d\s])", r"\1<wbr>", str(escape(text))))


def _policy(script: str) -> str:
    """Only this script runs, and nothing is loaded."""
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{allowed}'; style-src 'unsafe-inline'; "
        f"img-src data: blob:; media-src data:; form-action 'none'; base-uri 'none'"
    )
