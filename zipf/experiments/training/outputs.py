"""What a run shows and writes: the screen, its tables and text, and what its loggers make of it."""

from __future__ import annotations

import traceback
from collections.abc import Mapping

from rich.console import Console

from zipf.errors import UserError
from zipf.experiments.evaluation.evaluator import Result, scores
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.loggers import LOGGERS, End, Logger, Start
from zipf.experiments.options.schema import Config
from zipf.experiments.training.display import Display
from zipf.experiments.training.tables import Tables


class Outputs:
    """The outputs of a run. Of several learners the first has them; the others show and write
    nothing.

    Args:
        update: updates made.
        is_first: whether this is the first learner.

    Attributes:
        reason: why a logger asks the run to stop; empty while none does.

    Raises (in every method):
        UserError: a file cannot be written.
    """

    def __init__(self, config: Config, update: int, *, is_first: bool, takes_turns: bool = True):
        self.config = config
        self.reason = ""
        self.display = Display(
            config.run_name,
            config.updates,
            update,
            frames_per_update=config.frames_per_update,
            takes_turns=takes_turns,
            console=None if is_first else Console(quiet=True, force_terminal=False),
        )
        self._tables: Tables | None = None
        self._loggers: dict[str, Logger] = {}
        self._lost: list[str] = []

    def open(self, update: int, lengths: Mapping[str, int] | None) -> None:
        """Begins or goes on with the tables; see `Tables`."""
        self._tables = Tables(self.config.folder, update, lengths)

    def say(self, line: str) -> None:
        """Shows a line."""
        self.display.say(line)

    def write(self, line: str) -> None:
        """Writes a line to `train.log`."""
        if self._tables:
            self._tables.text(line)

    def tell(self, line: str) -> None:
        """Shows and writes a line."""
        self.say(line)
        self.write(line)

    def warn(self, line: str) -> None:
        """Shows a line, also where a run is quiet, and writes it."""
        self.display.warn(line)
        self.write(line)

    def start(self, run: Start) -> None:
        """Starts loggers and the display. Raises UserError: a logger cannot start; those before it
        are ended."""
        for name, options in self.config.loggers.items() if self._tables else ():
            try:
                logger = LOGGERS.build(options)
                self._stop(name, logger.on_start(run))
                self._loggers[name] = logger
            except Exception as error:
                self.end(End(run.update, False, lambda: None))
                raise UserError(f"loggers=[{name}]: {_described(error)}") from error
        self.display.start()

    def metrics(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> None:
        """The metrics of an update."""
        if self._tables:
            self._tables.metrics(when, metrics)
        self._call("on_update", when, metrics)
        self.display.show_metrics({**when, **metrics})

    def evaluation(self, when: Mapping[str, float], results: list[Result], visits: Visits) -> None:
        """An evaluation, with how often training has met each situation."""
        assert self._tables is not None
        self._tables.evaluation(when, results, visits)
        self.display.show_scores(results)
        found = scores(results)
        shown = "  ".join(f"{kind} {score:.3f}" for kind, score in found.items())
        self.write(f"update {when['update']}: {shown}")
        if len(results) > len(found):
            found |= {f"{result.kind}/{result.level}": result.score for result in results}
        self._call("on_evaluation", when, found)

    def lengths(self) -> dict[str, int]:
        """The lengths of the tables, for a checkpoint."""
        assert self._tables is not None
        return self._tables.lengths()

    def end(self, end: End) -> None:
        """Ends the loggers; those that were switched off are named again."""
        for line in self._lost:
            self.display.warn(line)
        self._call("on_end", end)

    def _call(self, method: str, *given: object) -> None:
        for name, logger in list(self._loggers.items()):
            try:
                self._stop(name, getattr(logger, method)(*given))
            except Exception as error:
                del self._loggers[name]
                line = f"loggers=[{name}]: {_described(error)}"
                if method != "on_end":
                    line += f"; it is switched off since update {self.display.update}"
                self._lost.append(line)
                self.warn(line)

    def _stop(self, name: str, reason: str | None) -> None:
        if reason is not None and not self.reason:
            self.reason = f"{name}: {reason}"


def _described(error: Exception) -> str:
    """An error of a logger on one line, with where it was raised unless it explains itself."""
    message = " ".join(str(error).split())
    if isinstance(error, UserError):
        return message
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {message} ({place.filename}, line {place.lineno})"
