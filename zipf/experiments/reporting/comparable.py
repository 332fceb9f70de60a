"""Which runs share a table, and which of them a row; in which options runs differ.

Runs are pooled only if they can be compared: same experiment, envs, window and published
counterpart. Others of the same experiment get a table of their own, whose title says what differs.
An external agent has no window and none of our options. It stands in the tables of its experiment
that have the same envs, or, if there is none, of every experiment that has. It is a row of its
own there, never pooled with runs of this package.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from zipf.errors import UserError
from zipf.experiments.records.paper import PaperTable, paper_table
from zipf.experiments.records.results import Run
from zipf.experiments.records.wording import EXTERNAL_MARK, NONE
from zipf.experiments.reporting.windows import Asked, used_window
from zipf.protocol import PAPER_KINDS


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a table: the runs of a condition, or of an external agent."""

    key: str  # unique among the rows of a table
    agent: str  # the same in tables of other environments: what looks alike in all of them
    title: str  # as tables and plots show it; an external agent's ends in a mark
    external: bool  # whether it was recorded from outside this package
    colour: str | None  # as #rrggbb; None if it is to be assigned
    line: str  # "solid" or "dashed"
    runs: tuple[Run, ...]  # its seeds

    @property
    def condition(self) -> str:
        """The condition's name, or the external agent's."""
        return self.runs[0].description.condition


@dataclass(frozen=True)
class PaperRow:
    """A row of one of the paper's tables of which there is no run."""

    key: str  # unique among the rows of a report: the condition
    title: str  # as tables show it


def rows_of(runs: Sequence[Run], title: str = "", order: Sequence[str] = ()) -> tuple[Row, ...]:
    """The rows of a table of these runs: in the order of these conditions, then in their own.
    Options of environments that the table's title has are not in those of rows again."""
    by_key: dict[str, list[Run]] = {}
    places = {condition: place for place, condition in enumerate(order)}

    def place(run: Run) -> tuple[Any, ...]:
        return places.get(run.description.condition, len(places)), run.description.row_order

    for run in sorted(runs, key=place):
        by_key.setdefault(run.description.row_key, []).append(run)
    agents = {key: _without_environment(key, ",") for key in by_key}
    known = re.split(r"[ (),]+", title)
    rows = []
    for key, of_row in by_key.items():
        description = of_row[0].description
        external = description.external is not None
        alone = list(agents.values()).count(agents[key]) == 1
        name = description.row.title
        name = _without_environment(name, ", ", known) if alone else name
        rows.append(
            Row(
                key=key,
                agent=agents[key] if alone else key,
                title=name + (f" {EXTERNAL_MARK}" if external else ""),
                external=external,
                colour=description.row.colour,
                line=description.row.line,
                runs=tuple(of_row),
            )
        )
    return tuple(rows)


def _without_environment(text: str, separator: str, known: Collection[str] | None = None) -> str:
    """A condition's name or title without the options of environments, or only without those with
    one of these values."""
    kept = [
        part
        for part in text.split(separator)
        if not part.startswith("environment.")
        or (known is not None and part.partition("=")[2] not in known)
    ]
    return separator.join(kept)


@dataclass(frozen=True)
class Differences:
    """The options in which runs differ."""

    # for each set of options that several runs may share, its runs
    columns: tuple[tuple[Run, ...], ...]
    # for each option that differs its name and its value in every column, those of a group together
    lines: tuple[tuple[str, tuple[str, ...]], ...]


def differences(runs: Sequence[Run]) -> Differences:
    """The options in which these runs differ, without those that cannot change what is learned.
    External agents, which have no options, are left out."""
    shared: dict[str, list[Run]] = {}
    for run in runs:
        if not run.description.external:
            shared.setdefault(json.dumps(run.settings, sort_keys=True, default=str), []).append(run)
    columns = tuple(tuple(of_column) for of_column in shared.values())
    names = list(dict.fromkeys(name for column in columns for name in column[0].settings))
    groups = list(dict.fromkeys(name.split(".")[0] for name in names))
    lines = []
    for name in sorted(names, key=lambda name: groups.index(name.split(".")[0])):
        texts = tuple(_text(column[0], name) for column in columns)
        if len(set(texts)) > 1:
            lines.append((name, texts))
    return Differences(columns, tuple(lines))


def _text(run: Run, name: str) -> str:
    return value_text(run.settings[name]) if name in run.settings else NONE


def value_text(value: Any) -> str:
    """An option's value as a command line has it."""
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{','.join(value_text(item) for item in value)}]"
    return str(value)


def names_of(run: Run) -> tuple[str, str]:
    """What `conditions=` may call a run's condition: its name and its title."""
    return run.description.condition, run.description.row.title


def chosen_runs(
    runs: Sequence[Run], names: Sequence[str], option: str
) -> tuple[list[Run], list[str]]:
    """The runs of these conditions, and the conditions in the order of `names`: names or titles of
    conditions, in which * stands for anything; an option has them.
    Raises UserError: a name is of no condition of these runs, or there is none."""
    if not names:
        raise UserError(f"{option}: names none; leave it out")
    found: list[str] = []
    for name in names:
        asked = re.compile(".*".join(re.escape(part) for part in name.lower().split("*")))
        matching = [
            run.description.condition
            for run in runs
            if any(asked.fullmatch(one.lower()) for one in names_of(run))
        ]
        if not matching:
            there = ", ".join(dict.fromkeys(run.description.condition for run in runs))
            raise UserError(f"{name}: no such condition; there are {there}")
        found += matching
    order = list(dict.fromkeys(found))
    return [run for run in runs if run.description.condition in order], order


def split_names(text: str, runs: Sequence[Run]) -> list[str]:
    """A list of conditions as it is written on a command line. Names may have commas themselves:
    as many parts as make a name or a title of a condition of these runs belong together."""
    known = {name.lower() for run in runs for name in names_of(run)}
    if text.lower() not in known and text.startswith("[") and text.endswith("]"):
        text = text[1:-1]
    parts, names = text.split(","), []
    while parts:
        lengths = range(len(parts), 1, -1)
        length = next((n for n in lengths if ",".join(parts[:n]).strip().lower() in known), 1)
        names.append(",".join(parts[:length]).strip())
        parts = parts[length:]
    return [name for name in names if name]


@dataclass(frozen=True, eq=False)
class RunGroup:
    """The runs of a table."""

    name: str  # unique among the groups, and safe in file names
    title: str  # the experiment, and what sets the group apart from others of that experiment
    runs: tuple[Run, ...]  # those of this package first


def group_runs(runs: Sequence[Run], window: Asked | None) -> list[RunGroup]:
    """The runs of each table, in the order of tables; `window` stands in the place of each run's
    own. Raises UserError: two runs of a group are the same condition and seed."""
    by_key: dict[str, list[Run]] = {}
    for run in runs:
        if not run.description.external:
            by_key.setdefault(_key(run, window), []).append(run)
    tabled = list(by_key.values())
    experiments: dict[str, set[str]] = {}  # of each agent from outside the package
    for run in runs:
        if run.description.external:
            of_agent = experiments.setdefault(run.description.row_key, set())
            of_agent.add(run.description.experiment)
    for run in runs:
        if run.description.external:
            alike = [group for group in tabled if _envs(group[0]) == _envs(run)]
            experiment = run.description.experiment
            places = [group for group in alike if group[0].description.experiment == experiment]
            if not places and len(experiments[run.description.row_key]) == 1:
                places = alike  # rows of several experiments would be one agent there
            if not places:
                places = [by_key.setdefault(_key(run, window), [])]
            for group in places:
                group.append(run)

    groups: list[RunGroup] = []
    for key in sorted(by_key, key=_with_numbers):
        group = by_key[key]
        _refuse_duplicates(group)
        experiment = group[0].description.experiment
        siblings = [
            _identity(other[0], window)
            for other in by_key.values()
            if other[0].description.experiment == experiment
        ]
        title = _title(experiment, _identity(group[0], window), siblings)
        name = _unused_name(title, [group.name for group in groups])
        groups.append(RunGroup(name, title, tuple(group)))
    return groups


def paper_of(runs: Sequence[Run]) -> PaperTable | None:
    """What the paper published for the runs of a group; None if it has nothing.
    Raises UserError: they name an experiment that the paper does not have."""
    key = runs[0].description.paper
    if key is None:
        return None
    try:
        return paper_table(key)
    except UserError as error:
        raise UserError(f"{runs[0].label}/run.json: paper: {error}") from error


def _envs(run: Run) -> dict[str, Any]:
    """What a run is scored on, and how."""
    description = run.description
    levels = []
    for kind in PAPER_KINDS:  # a run of before there were others can be compared all the same
        each = (
            f"{one.level} x {one.weight:g}{', normalised' if one.normalised else ''}"
            for one in description.levels
            if one.level_kind == kind
        )
        if text := ", ".join(each):
            levels.append(f"{kind}: {text}")
    return {
        "split": description.split,
        "levels": "; ".join(levels),
        "spread": description.spread,
        "images": f"v{description.images or 0}",
        **{f"environment.{name}": value for name, value in description.environment.items()},
    }


def _identity(run: Run, window: Asked | None) -> dict[str, Any]:
    """What the runs of a group have in common, beside the experiment."""
    description = run.description
    if description.external or description.window is None:
        return _envs(run)
    used = used_window(description.window, window)
    return {"paper": description.paper, "window": str(used), **_envs(run)}


def _key(run: Run, window: Asked | None) -> str:
    return _json([run.description.experiment, _identity(run, window)])


def _with_numbers(text: str) -> list[str | float]:
    """By which texts are in the order of the numbers in them: a window 300:500 before 1000:1500."""
    parts = re.split(r"(\d+(?:\.\d+)?)", text)  # every second one is a number
    return [float(part) if place % 2 else part for place, part in enumerate(parts)]


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


def _title(experiment: str, identity: dict[str, Any], siblings: list[dict[str, Any]]) -> str:
    given = sorted({name for sibling in siblings for name in sibling})
    by_all = [name for name in given if all(name in sibling for sibling in siblings)]
    names = _differing(by_all, siblings)
    # Options that only some runs tell are named only where the others do not tell groups apart.
    if not _tell_apart(names, siblings):
        names = _differing(given, siblings)
        # One that tells all apart says as much as all that differ.
        names = next(([name] for name in names if _tell_apart([name], siblings)), names)
    # The names of all levels are long; a split's name tells as much where each has its own levels.
    others = [name for name in names if name != "levels"]
    if _tell_apart(others, siblings):
        names = others
    differing = [
        f"{name.removeprefix('environment.')} "
        + textwrap.shorten(str(identity.get(name, "not recorded")), 60, placeholder=" ...")
        for name in names
    ]
    return f"{experiment} ({', '.join(differing)})" if differing else experiment


def _differing(names: Sequence[str], siblings: Sequence[dict[str, Any]]) -> list[str]:
    """Those of the names that do not have the same value everywhere."""
    first = siblings[0]
    return [
        name for name in names if any(sibling.get(name) != first.get(name) for sibling in siblings)
    ]


def _tell_apart(names: Sequence[str], siblings: Sequence[dict[str, Any]]) -> bool:
    """Whether no two have the same values of all these names."""
    values = {_json([sibling.get(name) for name in names]) for sibling in siblings}
    return len(values) == len(siblings)


def _unused_name(title: str, used: list[str]) -> str:
    """A title as a name of files."""
    name = re.sub(r"[^\w.-]+", "_", title.replace(":", "-"))[:80].strip("_.")
    numbered = (f"{name}-{number}" for number in range(2, len(used) + 3))
    return name if name not in used else next(other for other in numbered if other not in used)


def _refuse_duplicates(runs: Sequence[Run]) -> None:
    seen: dict[tuple[str, int], Run] = {}
    for run in runs:
        key = (run.description.row_key, run.description.seed)
        if key in seen:
            what = (
                f"experiment {run.description.experiment}, condition {run.description.condition}, "
                f"seed {key[1]}"
            )
            both = f"{seen[key].label} and {run.label}"
            options = [
                f"{name} ({' and '.join(texts)})"
                for name, texts in differences([seen[key], run]).lines
            ]
            if not options:
                raise UserError(
                    f"{both} are the same run twice: {what}; leave one out, or give one "
                    "another seed= or name="
                )
            shown = ", ".join(options[:5]) + (" and more" if len(options) > 5 else "")
            raise UserError(
                f"{both} are both {what}, but by config.yaml they differ in {shown}: train one of "
                f"them under another name=, or report them apart"
            )
        seen[key] = run
