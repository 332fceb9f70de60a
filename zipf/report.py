"""The paper's tables and plots of runs: `python -m zipf.report FOLDER...`, and in Python
`zipf.report("runs/")`.

Reads result files only, no checkpoints, but for `videos=`.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from zipf.errors import UserError, reading
from zipf.experiments.records.wording import PLOT_FORMATS, PlotFormat, VideoFormat
from zipf.lazy import callable_as
from zipf.options import Options
from zipf.output import console, is_quiet, run_command

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from zipf.experiments.records.results import Run
    from zipf.experiments.reporting.claims import ClaimLine
    from zipf.experiments.reporting.panels import Looks
    from zipf.experiments.reporting.seed_statistics import SeedStatistics
    from zipf.experiments.reporting.tables import ScoreTable
    from zipf.experiments.reporting.windows import Asked


Text = Annotated[str, Field(min_length=1)]

USAGE = """usage: python -m zipf.report FOLDER ... [option=value ...]

Reads the result files of all runs under folders (no checkpoints, but for videos=), prints the
paper's tables of them, and writes these and plots to files.

Examples:

    python -m zipf.report runs/
    python -m zipf.report runs/demo html=true
    python -m zipf.report runs/demo window=last
    python -m zipf.report runs/gridworld window=2M:3M output=tables format=pdf

Options:

    FOLDER          a run's folder, or one with runs at any depth; of several words those without
                    a name and = are folders
    output=DIR      folder for report.md, report.tex, CSV files and the plots; default: the folder
                    report in the first FOLDER
    window=WINDOW   which evaluations scores are taken from: START:END in updates (2000000:3000000
                    or 2M:3M), last, last:N for the last N of each run, scaled: the window of the
                    experiment at the same fractions of a shorter run, or own: that of each run, in
                    one table also where they differ; default: the window of the experiment, and a
                    table for each
    conditions=NAMES  the conditions to show, in this order: names or titles, with * for anything,
                    such as impala,r2d2*; default: all
    highlight=NAMES   the conditions drawn in colour over grey ones; default: all of up to six, else
                    the six best by validation score, or by training score where there is none
    claims=BOOL     true: also check what the paper claims; default: false
    record=FILE     also write all tables, a description of each run, and the Markdown files of the
                    folders to this Markdown file; default: no such file
    format=FORMAT   of the plots: png, pdf or svg; default: png
    html=FILE       also write tables, plots, options and videos to one page, which needs no other
                    file and no network; true: report.html beside report.md; default: no page, but
                    a report.html that is there already is written anew
    videos=FORMAT   before, let the agent of each run's checkpoint play, and record a success and a
                    failure in its most frequent situation and in its rarest, into the run's
                    folder, as gif or mp4; the page of html=, which it implies, shows the videos
                    that there are; default: no videos
    plugins=NAMES   with videos=: modules to import, for environments and agents from outside the
                    package; default: none
    --quiet, -q     print nothing but warnings and errors"""


class ReportOptions(Options):
    """The options of `python -m zipf.report`, but for its folders."""

    output: Text | None = None
    window: str | None = None
    conditions: Text | None = None
    highlight: Text | None = None
    claims: bool = False
    record: Text | None = None
    format: PlotFormat = "png"
    html: Text | None = None
    videos: VideoFormat | None = None
    plugins: str = ""


@dataclass(frozen=True, repr=False)
class Report:
    """What a report holds. A notebook shows its tables.

    Attributes:
        tables: one for each experiment; more where runs of an experiment cannot be compared.
        files: that were written, in the order in which they should be shown.
        claims: of the paper, with what the tables say about each; none unless asked for.
        statistics: across seeds, of each table.
    """

    tables: tuple[ScoreTable, ...]
    files: tuple[Path, ...]
    claims: tuple[ClaimLine, ...]
    statistics: tuple[SeedStatistics, ...]
    _looks: Looks

    def __repr__(self) -> str:
        runs = sum(len(table.runs) for table in self.tables)
        names = ", ".join(table.title for table in self.tables)
        return f"Report({runs} run{'s' if runs > 1 else ''}: {names})"

    def to_dataframe(self) -> pd.DataFrame:
        """The scores, a line for each row of a table and each kind of levels, and further ones for
        single levels; the columns are those of `report.csv`, see docs/results.md."""
        from zipf.experiments.reporting.tables import report_frame

        return report_frame(self.tables)

    def figures(self) -> dict[str, Figure]:
        """The figures, drawn when this is called, by the names that their files have: the table's
        and the figure's, such as `demo_learning`."""
        from zipf.experiments.reporting import draw_matplotlib

        with draw_matplotlib.style():
            drawn = draw_matplotlib.figures(self.statistics, self._looks)
            return {f"{table}_{kind}": figure for table, kind, figure in drawn}

    def _repr_markdown_(self) -> str:
        from zipf.experiments.reporting.markdown import markdown_report

        return markdown_report(self.tables, {})


def report(
    folders: str | Path | Sequence[str | Path],
    output: str | Path | None = None,
    window: str | None = None,
    *,
    conditions: str | Sequence[str] | None = None,
    highlight: str | Sequence[str] | None = None,
    claims: bool = False,
    record: str | Path | None = None,
    format: PlotFormat = "png",
    html: str | Path | None = None,
    show: bool = False,
) -> Report:
    """The tables of all runs under `folders`; with plots they are written to files where `output`
    says so.

        made = zipf.report("runs/")
        made.to_dataframe()
        made.figures()["demo_learning"]

    Args:
        folders: a run's folder, or one with runs at any depth; or several of them.
        output: a folder where `report.md`, `.tex`, the CSV files and the plots go; None: they are
            not written.
        window: `START:END` in updates, `last`, `last:N`, `scaled` or `own`; each experiment's own
            if None.
        conditions: those to show, in this order: names or titles, in which * stands for anything;
            a text is a list with commas. All if None.
        highlight: conditions that are drawn in colour over grey ones; see `looks_of` if None.
        claims: whether to check what the paper claims.
        record: also write all tables, and what each run was, to this Markdown file; and after them
            the Markdown files in `folders` themselves, not further down.
        format: of the plots.
        html: also write everything to this file, a page that needs no other; "" is `report.html`
            in `output`, or in the current folder. One in `output` that is there already is written
            anew in any case.
        show: also print the tables, and which files were written.

    Raises:
        UserError: no run there, a damaged file, an unknown window, condition or format, a page
            whose name does not end in .html, or a file cannot be read or written.
    """
    from zipf.experiments.reporting import draw_matplotlib, latex, markdown, tables, terminal
    from zipf.experiments.reporting.claims import check_claims, csv_claims
    from zipf.experiments.reporting.panels import looks_of
    from zipf.experiments.reporting.seed_statistics import csv_statistics, seed_statistics
    from zipf.experiments.reporting.side_by_side import side_by_side

    chosen = _checked(window, html, format)
    folders = [folders] if isinstance(folders, str | Path) else folders
    target = None if output is None else Path(output).expanduser()
    record = None if record is None else Path(record).expanduser()
    html = Path(html).expanduser() if html else html
    runs, order, highlight = _asked_for(folders, conditions, highlight)
    found = tables.score_tables(runs, chosen, order)
    pages = [] if record is None else _pages(folders, [(target or Path()) / "report.md", record])
    checked = check_claims(found) if claims else []
    if show:
        shown = console()
        for table in found:
            terminal.print_table(table, shown)
            shown.print()
        for beside in side_by_side(found):
            if len(beside.tables) > 1:  # the others would be printed a second time
                terminal.print_side_by_side(beside, shown)
                shown.print()
        terminal.print_legend(found, shown)
        terminal.print_claims(checked, shown)
    statistics = [seed_statistics(table) for table in found]
    looks = looks_of(found, highlight)

    texts: dict[Path, str] = {}
    drawn: dict[str, list[Path]] = {}
    try:
        if target is not None:
            target.mkdir(parents=True, exist_ok=True)
            drawn = draw_matplotlib.draw(statistics, looks, target, format)
            _remove_earlier(target, {path.name for paths in drawn.values() for path in paths})
            texts = {
                target / "report.md": markdown.markdown_report(found, drawn, checked, statistics),
                target / "report.tex": latex.latex_report(found, statistics),
                target / "report.csv": tables.csv_report(found),
                target / "statistics.csv": csv_statistics(statistics),
            }
            if claims:
                texts[target / "claims.csv"] = csv_claims(checked)
        if record is not None:
            command = _command(folders, output, window, conditions, claims, record)
            texts[record] = markdown.record(found, command, pages, checked, statistics)
        # A page that is older than the tables beside it would be another report's.
        beside_tables = (target or Path()) / "report.html"
        page_files = {Path(html) if html else beside_tables} if html is not None else set()
        if target is not None and beside_tables.exists():
            page_files.add(beside_tables)
        if page_files:
            from zipf.experiments.reporting.html import page, report_sections

            text = page(report_sections(statistics, looks, checked))
            texts |= dict.fromkeys(sorted(page_files), text)
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        where = error.filename or target
        raise UserError(f"{where}: cannot be written: {error.strerror}") from error
    files = (*texts, *(path for paths in drawn.values() for path in paths))
    written = [path.as_posix() for path in files]
    if len(drawn) > 1:  # more files than one wants to read the names of
        written = [path.as_posix() for path in texts]
        written += [
            f"{paths[0].parent.as_posix()}/{name}_*.{format}: {len(paths)} figures"
            for name, paths in drawn.items()
        ]
    for line in written if show else ():
        shown.print(f"Wrote {line}", markup=False, soft_wrap=True)
    return Report(tuple(found), files, tuple(checked), tuple(statistics), looks)


def _asked_for(
    folders: Sequence[str | Path],
    conditions: str | Sequence[str] | None,
    highlight: str | Sequence[str] | None,
) -> tuple[list[Run], list[str], list[str]]:
    """The runs of the conditions that are asked for, these conditions in order (none: as usual),
    and those to highlight. Raises UserError: there is none of a name."""
    from zipf.experiments.records.results import load_runs
    from zipf.experiments.reporting.comparable import chosen_runs, split_names

    runs, order, highlighted = load_runs(folders), list[str](), list[str]()
    if conditions is not None:
        names = split_names(conditions, runs) if isinstance(conditions, str) else conditions
        runs, order = chosen_runs(runs, names, "conditions")
    if highlight is not None:
        names = split_names(highlight, runs) if isinstance(highlight, str) else highlight
        highlighted = chosen_runs(runs, names, "highlight")[1]
    return runs, order, highlighted


def _pages(folders: Sequence[str | Path], written: Collection[Path]) -> list[str]:
    """The Markdown files in these folders, but for those that the report writes itself. Raises
    UserError: one cannot be read."""
    own = {path.resolve() for path in written}
    found = (path for one in folders for path in sorted(Path(one).expanduser().glob("*.md")))
    texts = []
    for path in found:
        if path.is_file() and path.resolve() not in own:
            try:
                with reading(path):
                    texts.append(path.read_text("utf-8"))
            except UnicodeDecodeError as error:
                raise UserError(f"{path.as_posix()}: is not UTF-8 text: {error}") from None
    return texts


def _checked(window: str | None, html: str | Path | None, format: str) -> Asked | None:
    """The window that is asked for. Raises `UserError` for one that there is not, a page whose name
    does not end in .html, or another format."""
    from zipf.experiments.reporting.windows import parse_window

    if html and Path(html).suffix != ".html":
        raise UserError(f"html={html}: should be true, or a name that ends in .html")
    if format not in PLOT_FORMATS:
        raise UserError(f"format={format}: should be {' or '.join(PLOT_FORMATS)}")
    return parse_window(window) if window is not None else None


def _remove_earlier(folder: Path, drawn: Collection[str]) -> None:
    """Remove the plots that the report in `folder`, if there is one, says are its own, but for
    those that have been drawn anew, and its claims."""
    from zipf.experiments.reporting.markdown import linked_plots

    earlier = folder / "report.md"
    if earlier.is_file():
        for name in linked_plots(earlier.read_text(encoding="utf-8", errors="replace")):
            if name not in drawn:
                (folder / name).unlink(missing_ok=True)
        (folder / "claims.csv").unlink(missing_ok=True)


def _command(
    folders: Sequence[str | Path],
    output: str | Path | None,
    window: str | None,
    conditions: str | Sequence[str] | None,
    claims: bool,
    record: str | Path,
) -> str:
    arguments = [Path(folder).as_posix() for folder in folders]
    if output is not None and Path(output) != _usual_output(folders):
        arguments.append(f"output={Path(output).as_posix()}")
    if window is not None:
        arguments.append(f"window={window}")
    if conditions is not None:
        names = conditions if isinstance(conditions, str) else ",".join(conditions)
        arguments.append(f"conditions={names}")
    if claims:
        arguments.append("claims=true")
    arguments.append(f"record={Path(record).as_posix()}")
    return shlex.join(["python", "-m", "zipf.report", *arguments])


def _usual_output(folders: Sequence[str | Path]) -> Path:
    """Where the command writes to, if it is not told."""
    return Path(folders[0]) / "report"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run_command(USAGE, _report, arguments)


def _report(words: list[str]) -> None:
    from zipf.experiments.options.command_line import read_options
    from zipf.experiments.options.schema import module_names

    named = [word for word in words if word.startswith("-") or re.match(r"[a-z_]\w*=", word, re.I)]
    folders = [word for word in words if word not in named]
    for word in named:
        name, _, folder = word.partition("=")
        if name in ("run", "runs"):
            raise UserError(f"{word}: folders have no name here: python -m zipf.report {folder}")
        if name not in ReportOptions.model_fields and Path(word).is_dir():
            raise UserError(f"{word}: to name this folder, write ./{word}")
    options = read_options(ReportOptions, named)
    if not folders:
        raise UserError("name a run's folder, or one with runs at any depth, such as runs/")
    html = {"true": "", "false": None}.get(options.html or "false", options.html)
    if options.plugins and not options.videos:
        raise UserError(f"plugins={options.plugins}: goes with videos= only")
    if options.videos:
        from zipf.experiments.playing.videos import record_videos

        _checked(options.window, html, options.format)
        say = (lambda line: None) if is_quiet() else print
        runs, *_ = _asked_for(folders, options.conditions, options.highlight)
        plugins = module_names(options.plugins)
        record_videos([run.folder for run in runs], options.videos, plugins, say)
        html = html or ""
    report(
        folders,
        options.output or _usual_output(folders),
        options.window,
        conditions=options.conditions,
        highlight=options.highlight,
        claims=options.claims,
        record=options.record,
        format=options.format,
        html=html,
        show=True,
    )


callable_as(__name__, report)

if __name__ == "__main__":
    sys.exit(main())
