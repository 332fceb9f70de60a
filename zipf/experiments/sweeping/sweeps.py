"""From a command line to the jobs of a sweep: lists of values, and ready-made sweeps.

A ready-made sweep is in `configs/sweep.yaml`, or in a folder that a user or a plugin adds: a list
of blocks, each with experiments, conditions, seeds and further overrides, or with stages that begin
with the weights of earlier ones. `sweep=<name>` on the command line stands for its jobs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from pydantic import Field, ValidationError

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.options import catalogue, command_line, composing, config_files
from zipf.experiments.options.schema import Config, Name, Seed
from zipf.experiments.options.written import Place
from zipf.experiments.records.paper import conditions_of_the_paper, paper_table
from zipf.options import Options

MOST_JOBS = 10_000  # ours: all of them are checked before the first one starts
SETS = ("paper", "tail", "all")
"""Words for sets of conditions: those in the paper's table of the experiment, those in none of the
paper's tables, and all. Of the last two, conditions that do not go with the experiment are left
out."""


class Block(Options):
    """The jobs of every combination of experiment, condition and seed.

    `conditions` are names or words of `SETS`; without them the experiment's own agent is trained.
    `overrides` are as on the command line, with lists of values where wanted.
    """

    experiments: str | list[str]
    conditions: str | list[str] = Field(default_factory=list)
    seeds: Annotated[list[Seed], Field(min_length=1)]
    overrides: list[str] = Field(default_factory=list)


class Stage(Options):
    """A run for each seed, whose `name` it has.

    `overrides` are as on the command line; `pretrained.run=<name>` in them stands for the run of
    the same seed of an earlier stage.
    """

    name: Name
    experiment: str
    condition: str = ""
    overrides: list[str] = Field(default_factory=list)


class Chain(Options):
    """Stages, one after another, for every seed. `overrides` are of all stages."""

    stages: Annotated[list[Stage], Field(min_length=1)]
    seeds: Annotated[list[Seed], Field(min_length=1)]
    overrides: list[str] = Field(default_factory=list)


@dataclass(frozen=True)
class PlannedJob:
    """A run that a sweep is asked for.

    Attributes:
        overrides: of its own command, `python -m zipf.train <overrides>`.
        config: what they amount to.
        is_finished: whether there is nothing left to do.
    """

    overrides: tuple[str, ...]
    config: Config
    is_finished: bool


@dataclass(frozen=True)
class Sweep:
    """Jobs that were checked.

    Attributes:
        left_out: a line for every condition of a set that does not go with an experiment.
    """

    jobs: tuple[PlannedJob, ...]
    left_out: tuple[str, ...]


def check(overrides: list[str], is_finished: Callable[[Config], bool] = lambda _: False) -> Sweep:
    """All jobs of a command line. A finished one is not checked for what it would need to run.

    Raises:
        UserError: with one line for every mistake in any of the jobs; or two of them would use the
            same folder, or none are left.
    """
    if searches := [word for word in overrides if for_search(word)]:
        raise UserError(f"{searches[0]}: is a sweep of many runs: add -m, without --explain")
    problems: dict[str, None] = {}
    left_out: dict[str, None] = {}
    jobs: list[PlannedJob] = []
    folders: set[Path] = set()
    for words, pair in expand(overrides):
        try:
            config = loading.read(list(words))
            finished = is_finished(config)
            if not finished:
                if pair and (why := _misfit(*pair)):
                    left_out[why] = None
                    continue
                loading.check(config, folders)
            jobs.append(PlannedJob(words, config, finished))
            folders.add(config.folder)
        except UserError as error:
            problems.update(dict.fromkeys(str(error).splitlines()))
    problems.update(dict.fromkeys(_shared_folders(jobs)))
    if problems or not jobs:
        problems = problems or left_out
        raise UserError("\n".join(problems))
    return Sweep(tuple(jobs), tuple(left_out))


def named(overrides: Iterable[str]) -> bool:
    """Whether a command line names a ready-made sweep."""
    return any(word.startswith("sweep=") for word in overrides)


def for_hydra(word: str) -> bool:
    """Whether an override is about the command, such as the launcher, and not about a job."""
    return word.lstrip("+~").startswith(("hydra.", "hydra/"))


def for_search(word: str) -> bool:
    """Whether an override is about a search, and not about a job."""
    return word.lstrip("+~").partition("=")[0].partition(".")[0] == "search"


def of_all_jobs(overrides: list[str]) -> list[str]:
    """The overrides that all jobs of a command line have, without those that make a sweep of it."""
    parsed = command_line.parse(overrides)
    kept = (one for one in parsed if one.key_or_group != "sweep" and not one.is_sweep_override())
    return [line for one in kept if not for_search(line := str(one.input_line))]


def expand(
    overrides: list[str],
) -> Iterator[tuple[tuple[str, ...], tuple[str, str] | None]]:
    """The overrides of each job of a command line, not yet checked.

    With them come the job's experiment and condition if the condition is from a set of conditions,
    of which those that do not fit are left out; else None.

    Raises:
        UserError: there is no such sweep, or what narrows it is not in it.
    """
    words = [word for word in overrides if not for_hydra(word)]
    parsed = command_line.parse(words)
    names = [name for one in parsed if one.key_or_group == "sweep" for name in values_of(one)]
    if not names:
        yield from ((tuple(job), None) for job in _combinations(words))
        return
    narrowing = ("experiment", "condition")
    rest = [one for one in parsed if one.key_or_group not in ("sweep", *narrowing)]
    rows = [row for name in names for block in read_blocks(name) for row in _rows(name, block)]
    if not rows:
        raise UserError(f"sweep={','.join(names)}: has no experiments")
    for one in parsed:
        if (group := one.key_or_group) not in narrowing:
            continue
        known = sorted({row.pair[group] for row in rows if row.pair[group]})
        for value in values_of(one):
            if value not in known:
                hint = (
                    command_line.nearest(value, known) if known else f"its blocks name no {group}s"
                )
                raise UserError(f"{group}={value}: is not in sweep={','.join(names)}; {hint}")
        rows = [row for row in rows if row.pair[group] in values_of(one)]
    planned: dict[tuple[str, ...], tuple[str, str] | None] = {}
    for row in rows:
        changed = {one.key_or_group for one in rest}
        kept = [one for one in command_line.parse(row.own) if one.key_or_group not in changed]
        chosen = [f"{group}={name}" for group, name in row.pair.items() if name]
        lines = [*chosen, *(str(one.input_line) for one in [*kept, *rest])]
        for job in _combinations(lines):
            left_out = (row.pair["experiment"], row.pair["condition"]) if row.optional else None
            planned.setdefault(tuple(job), left_out)
    yield from planned.items()


@dataclass(frozen=True)
class _Row:
    """An experiment and a condition of a ready-made sweep.

    Attributes:
        pair: both, by group; an empty condition for none.
        own: further overrides, which the command line may replace.
        optional: whether it is left out where the condition does not fit.
    """

    pair: dict[str, str]
    own: list[str]
    optional: bool = False


def _rows(sweep: str, block: Block | Chain) -> Iterator[_Row]:
    seeds = f"seed={','.join(map(str, block.seeds))}"
    if isinstance(block, Block):
        for experiment in _as_list(block.experiments):
            for condition, optional in _conditions(sweep, block.conditions, experiment).items():
                pair = {"experiment": experiment, "condition": condition}
                yield _Row(pair, [seeds, *block.overrides], optional)
        return
    begun: dict[str, str] = {}
    for stage in block.stages:
        _conditions(sweep, stage.condition or [], stage.experiment)  # are there
        own = command_line.parse(stage.overrides)
        changed = {one.key_or_group for one in own}
        shared = [
            str(one.input_line)
            for one in command_line.parse(block.overrides)
            if one.key_or_group not in changed
        ]
        lines = [_begins_with(sweep, stage, one, begun) for one in own]
        if stage.name in begun:
            raise UserError(f"sweep={sweep}: two stages have the name {stage.name}")
        begun[stage.name] = f"${{run_root}}/{stage.experiment}/{stage.name}/seed${{seed}}"
        pair = {"experiment": stage.experiment, "condition": stage.condition}
        yield _Row(pair, [seeds, f"name={stage.name}", *shared, *lines])


def _begins_with(sweep: str, stage: Stage, override: Override, begun: dict[str, str]) -> str:
    """An override of a stage, with the folder of an earlier one in the place of its name."""
    line = str(override.input_line)
    if override.key_or_group != "pretrained.run" or "/" in line:
        return line
    name = str(override.value())
    if name not in begun:
        hint = command_line.nearest(name, list(begun)) if begun else "it is the first"
        raise UserError(
            f"sweep={sweep}: {stage.name}: {line}: is no earlier stage, nor a folder with a /; "
            f"{hint}"
        )
    return f"pretrained.run={composing.quoted(begun[name])}"


def read_blocks(name: str) -> list[Block | Chain]:
    """The blocks of a ready-made sweep.

    Raises:
        UserError: there is none of that name, or its file is no list of blocks.
    """
    written = config_files.find("sweep", name)
    if written is None:
        hint = command_line.nearest(name, composing.choices("sweep"))
        raise UserError(f"sweep={name}: no such sweep; {hint}")
    place, content = written.place, written.values
    if not isinstance(content, list) or not content:
        raise UserError(f"{place}: is no sweep: should be a list of blocks")
    return [read_block(place, block) for block in content]


def read_block(place: Place | Path, block: Any) -> Block | Chain:
    """A block of a sweep in a file; with `stages` it is a chain.

    Raises:
        UserError: it is none.
    """
    kind = Chain if isinstance(block, dict) and "stages" in block else Block
    try:
        return kind.model_validate(block)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "a block"
        accepted = ", ".join(kind.model_fields)
        raise UserError(f"{place}: {where}: {first['msg']}; a block has {accepted}") from None


def _conditions(sweep: str, named: str | list[str], experiment: str) -> dict[str, bool]:
    """A block's conditions in an experiment, and whether each may be left out."""
    if experiment not in (known := composing.choices("experiment")):
        hint = command_line.nearest(experiment, known)
        raise UserError(f"sweep={sweep}: no such experiment as {experiment}; {hint}")
    words = _as_list(named)
    if not words:
        return {"": False}
    found: dict[str, bool] = {}
    rows = list(catalogue.conditions())
    for word in words:
        if word == "paper":
            published = _of_the_papers_table(sweep, experiment)
            found |= {row: False for row in rows if row in published}
        elif word == "tail":
            found = {row: True for row in rows if row not in conditions_of_the_paper()} | found
        elif word == "all":
            found = {row: True for row in rows} | found
        elif word in rows:
            found[word] = False
        else:
            hint = command_line.nearest(word, [*SETS, *rows])
            raise UserError(f"sweep={sweep}: no such condition as {word}; {hint}")
    order = {row: place for place, row in enumerate(rows)}
    return dict(sorted(found.items(), key=lambda item: order[item[0]]))


def _of_the_papers_table(sweep: str, experiment: str) -> Iterable[str]:
    environment = composing.composed(f"experiment={experiment}").values["environment"]
    try:
        published = envs.split(environment["split"]).paper
    except (LookupError, TypeError, ValueError):  # it chooses no envs, or of no split
        published = None
    if published is None:
        raise UserError(
            f"sweep={sweep}: conditions: paper: the paper has no table of experiment={experiment}"
        )
    return paper_table(published).rows


@cache
def _misfit(experiment: str, condition: str) -> str | None:
    """Why a condition does not go with an experiment, whatever else is chosen; None if it does."""
    try:
        loading.load([f"experiment={experiment}", f"condition={condition}"])
    except UserError as error:
        return f"experiment={experiment} condition={condition}: {str(error).splitlines()[0]}"
    return None


def _shared_folders(jobs: list[PlannedJob]) -> Iterator[str]:
    seen: dict[str, PlannedJob] = {}
    for job in jobs:
        folder = str(job.config.folder)
        if folder in seen and seen[folder].overrides == job.overrides:
            yield f"{' '.join(job.overrides)}: is given twice"
        elif folder in seen:
            yield (
                f"{folder}: two jobs would use this folder ({' '.join(seen[folder].overrides)} and "
                f"{' '.join(job.overrides)}); give the options that differ in separate sweeps with "
                "another run_root"
            )
        seen.setdefault(folder, job)


def _combinations(overrides: list[str]) -> Iterator[list[str]]:
    """Every combination of the listed values.

    Raises:
        UserError: there are too many, or what should be a list is none.
    """
    alternatives = []
    for override in command_line.parse(overrides):
        if override.is_sweep_override():
            prefix = override.get_key_element()
            if prefix in config_files.several():
                listed = ",".join(values_of(override))
                raise UserError(
                    f"{override.input_line}: a run may have several of them: {prefix}=[{listed}]"
                )
            alternatives.append([f"{prefix}={value}" for value in values_of(override)])
        else:
            alternatives.append([str(override.input_line)])
    if math.prod(map(len, alternatives)) > MOST_JOBS:
        raise UserError(f"the lists of values make a sweep of more than {MOST_JOBS:,} jobs")
    for job in itertools.product(*alternatives):
        yield list(job)


def values_of(override: Override) -> list[str]:
    """The values that an override lists, one after another, as they would be on a command line.

    Raises:
        UserError: it lists none, or is an interval or a pattern.
    """
    if not override.is_sweep_override():
        return [str(override.value())]
    prefix, text = override.get_key_element(), override.input_line
    try:
        values = list(itertools.islice(override.sweep_string_iterator(), MOST_JOBS + 1))
    except HydraException:  # glob, and intervals of a sweeper that draws from them
        draw = "" if prefix == "seed" else ", or draw them with search=random"
        raise UserError(f"{text}: list the values, as in {prefix}=a,b{draw}") from None
    except ValueError as error:  # a range whose step is 0
        raise UserError(f"{text}: {error}") from None
    if not values:
        raise UserError(f"{text}: lists no values")
    return values


def _as_list(value: str | list[str]) -> list[str]:
    return [value] if isinstance(value, str) else value
