"""Searches: sweeps whose values are drawn at random, and scored.

A trial is a combination of values, trained with every seed of the command line; its objective is
the mean score of these runs on the train or the validation levels. The same command goes on with an
interrupted search.
"""

from __future__ import annotations

import csv
import itertools
import math
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from hydra.core.override_parser.types import IntervalSweep, Override

from zipf.errors import UserError, writing
from zipf.experiments.building import run_folder
from zipf.experiments.options import command_line
from zipf.experiments.options.naming import with_hash
from zipf.experiments.options.schema import RandomSearch
from zipf.experiments.records.wording import updates_text
from zipf.experiments.sweeping import sweeps
from zipf.protocol import KINDS

DIGITS = 3  # significant, of numbers from intervals; ours: they are parts of folders' names
_DRAWS = 1000  # ours: after as many that were there before there are no others


@dataclass(frozen=True)
class Dimension:
    """An option that is searched.

    Attributes:
        option: as on the command line.
        values: to choose from; empty for an interval.
        low, high: the interval, ends included.
        whole: whether its numbers are whole ones.
        log: whether their logarithm is drawn uniformly.
    """

    option: str
    values: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    whole: bool = False
    log: bool = False

    def draw(self, rng: np.random.Generator) -> str:
        """A value, as on the command line."""
        if self.values:
            return self.values[rng.integers(len(self.values))]
        low, high = (self.low - 0.5, self.high + 0.5) if self.whole else (self.low, self.high)
        if self.log:
            return self.text(math.exp(rng.uniform(math.log(low), math.log(high))))
        return self.text(rng.uniform(low, high))

    def text(self, value: float) -> str:
        """A number of the interval, as on the command line."""
        if self.whole:
            return str(int(min(max(round(value), self.low), self.high)))
        short = f"{value:.{DIGITS}g}"
        return short if self.low <= float(short) <= self.high else repr(float(value))


@dataclass
class _Tried:
    """A trial.

    Attributes:
        values: of the dimensions, in their order.
        jobs: its runs, one for each seed.
        scores: of the runs that have finished.
    """

    values: tuple[str, ...]
    jobs: tuple[sweeps.PlannedJob, ...]
    scores: list[float] = field(default_factory=list)

    @property
    def is_scored(self) -> bool:
        return len(self.scores) == len(self.jobs)

    @property
    def objective(self) -> float:
        return sum(self.scores) / len(self.scores) if self.scores else -math.inf


def asked(overrides: Sequence[str], config_dir: str | None = None) -> Search | None:
    """The search of a command line; None where it asks for none.

    Raises:
        UserError: there is no such search, or nothing that it could search.
    """
    is_asked = any(map(sweeps.for_search, overrides))
    return Search(list(overrides), config_dir) if is_asked else None


class Search:
    """A search: its runs, and what has come of them.

    Attributes:
        jobs: the runs, of all trials.
        folder: has `trials.csv`.

    Raises:
        UserError: there is nothing to search, or a line for every mistake in the options of a
            trial.
    """

    def __init__(self, overrides: list[str], config_dir: str | None):
        self._flags = ["--config-dir", config_dir] if config_dir else []
        parsed = command_line.parse([one for one in overrides if not sweeps.for_hydra(one)])
        own = [one for one in parsed if sweeps.for_search(str(one.input_line))]
        rest = [one for one in parsed if one not in own]
        self.options = _options(own)
        seeds = [one for one in rest if one.key_or_group == "seed"]
        lists = [one for one in rest if one.is_sweep_override() and one not in seeds]
        for one in rest:
            if one.key_or_group == "sweep" or (one in lists and one.key_or_group == "experiment"):
                raise UserError(
                    f"{one.input_line}: a search is of one experiment, whose scores compare; give "
                    "it experiment=<name>, and lists or intervals of other options"
                )
        self._dimensions = [_dimension(one) for one in lists]
        if not self._dimensions:
            raise UserError(
                "search=random: there is nothing to search; give an option an interval or a "
                "list, as in 'agent.learning_rate=tag(log,interval(1e-4,1e-2))'"
            )
        self._fixed = [str(one.input_line) for one in rest if one not in [*lists, *seeds]]
        self._seeds = [str(one.input_line) for one in seeds]
        drawn = list(itertools.islice(self._draws(), self.options.trials))
        self._trials = [_Tried(values, self._runs(values)) for values in drawn]
        self.jobs = [job for one in self._trials for job in one.jobs]
        first = self.jobs[0].config
        kinds = [kind for kind in first.split.kinds if kind in ("train", "validation")]
        if self.options.objective not in kinds:
            raise UserError(
                f"search.objective={self.options.objective}: {first.split.name} has no such "
                f"levels; should be {' or '.join(kinds)}"
            )
        self.folder = first.folder.parent.parent / self._folder_name()
        self._end = first.updates, first.schedule.window
        used = Counter(job.config.folder for job in self.jobs)
        if shared := [folder for folder, times in used.items() if times > 1]:
            raise UserError(
                f"{shared[0]}: two trials would use this folder; leave out name=, "
                "and search options that change what is learned"
            )

    def tell(self) -> None:
        """Reads the scores of the runs that have finished, and writes `trials.csv`."""
        for trial in self._trials:
            finished = (one.config for one in trial.jobs if run_folder.is_finished(one.config))
            trial.scores = [self._score(config.folder) for config in finished]
        run_folder.make(self.folder)
        path = self.folder / "trials.csv"
        with writing(path), open(path, "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(self._table())

    def summary(self) -> Iterator[str]:
        """A table of all trials, the best first, and the command of the best."""
        path = (self.folder / "trials.csv").as_posix()
        yield f"{len(self._trials)} trials of search=random, by {self._measure()}; {path}"
        rows = [row[:-1] for row in self._table()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            yield "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        best = self._ranked()[0]
        if not best.is_scored:
            yield "no trial has finished with all its seeds"
            return
        flags = [*self._flags, *(["-m"] if len(best.jobs) > 1 else [])]
        words = [*self._fixed, *self._words(best.values), *self._seeds]
        yield f"best: {shlex.join(['python', '-m', 'zipf.train', *flags, *words])}"

    def _draws(self) -> Iterator[tuple[str, ...]]:
        """Values of trials, none twice, until there are no others."""
        rng = np.random.default_rng(self.options.seed)
        seen = set()
        while True:
            draws = (tuple(one.draw(rng) for one in self._dimensions) for _ in range(_DRAWS))
            new = next((values for values in draws if values not in seen), None)
            if new is None:
                return
            seen.add(new)
            yield new

    def _runs(self, values: tuple[str, ...]) -> tuple[sweeps.PlannedJob, ...]:
        words = [*self._fixed, *self._words(values), *self._seeds]
        return sweeps.check(words, run_folder.is_finished).jobs

    def _words(self, values: Sequence[str]) -> list[str]:
        return [f"{one.option}={text}" for one, text in zip(self._dimensions, values, strict=True)]

    def _folder_name(self) -> str:
        """A name for the search of these options, which may have more trials later."""
        kept = self.options.model_dump(exclude={"trials"})
        whole = repr((sorted(self._fixed), self._dimensions, self._seeds, "random", kept))
        short = "+".join(one.option.rpartition(".")[2] for one in self._dimensions)
        return with_hash(f"search-random-{short}", whole)

    def _measure(self) -> str:
        """Where the scores are from, in words."""
        updates, (start, end) = self._end
        kind = self.options.objective
        if updates >= start:
            return f"{kind} score over updates {updates_text(start, end)}"
        return (
            f"{kind} score at the last evaluation (schedule.window=[{start},{end}] begins after "
            f"updates={updates})"
        )

    def _score(self, folder: Path) -> float:
        """The median score in the run's window, or that of its last evaluation before it."""
        from zipf.experiments.records.results import load_run
        from zipf.experiments.reporting.windows import LastEvaluations, OwnWindows, window_of

        run = load_run(folder)
        means = run.mean_scores(run.description.levels_of(self.options.objective))
        inside = means[window_of(run, OwnWindows()).select(means["update"])]
        if not len(inside):
            inside = means[LastEvaluations(1).select(means["update"])]
        return float(inside["score"].median())

    def _ranked(self) -> list[_Tried]:
        return sorted(self._trials, key=lambda one: (not one.is_scored, -one.objective))

    def _table(self) -> list[list[str]]:
        options = [one.option for one in self._dimensions]
        rows = [["trial", self.options.objective, "seeds", *options, "folder"]]
        number = {id(one): str(i) for i, one in enumerate(self._trials, start=1)}
        for one in self._ranked():
            score = f"{one.objective:.4f}" if one.scores else ""
            seeds = f"{len(one.scores)}/{len(one.jobs)}"
            folder = one.jobs[0].config.folder.parent.as_posix()
            rows.append([number[id(one)], score, seeds, *one.values, folder])
        return rows


def _options(own: Sequence[Override]) -> RandomSearch:
    """The options of the search that is asked for."""
    names = [str(one.value()) for one in own if one.key_or_group == "search"]
    if not names:
        raise UserError(f"{own[0].input_line}: choose the search, too: search=random")
    for one in own:
        if one.is_sweep_override():
            raise UserError(f"{one.input_line}: should be one value; a search is not swept over")
    if names[-1] != "random":
        raise UserError(f"search={names[-1]:.200}: no such search; there is random")
    given = {
        one.key_or_group.removeprefix("search."): one.value()
        for one in own
        if one.key_or_group != "search"
    }
    objective = given.get("objective")
    if objective in KINDS and objective not in ("train", "validation"):
        raise UserError(
            f"search.objective={objective}: what is chosen by {objective} scores is no longer "
            "tested by them; should be train or validation"
        )
    words = [f"{option}={value}" for option, value in given.items()]
    try:
        return command_line.read_options(RandomSearch, words)
    except UserError as error:
        lines = str(error).splitlines()
        raise UserError("\n".join(f"search.{line}" for line in lines)) from None


def _dimension(override: Override) -> Dimension:
    value, option = override.value(), override.get_key_element()
    if not isinstance(value, IntervalSweep):
        return Dimension(option, tuple(dict.fromkeys(sweeps.values_of(override))))
    low, high = value.start, value.end
    assert low is not None
    assert high is not None
    whole = "int" in value.tags or (isinstance(low, int) and isinstance(high, int))
    log = "log" in value.tags
    line = override.input_line
    if unknown := value.tags - {"int", "log"}:
        raise UserError(f"{line}: no such tag as {min(unknown)}; should be log or int")
    if not -math.inf < low < high < math.inf:
        raise UserError(f"{line}: should be two numbers, the smaller one first")
    if whole and not (float(low).is_integer() and float(high).is_integer()):
        raise UserError(f"{line}: an interval of whole numbers should have whole ends")
    if log and low <= 0:
        raise UserError(f"{line}: a logarithmic interval should begin above 0")
    return Dimension(option, (), low, high, whole, log)
