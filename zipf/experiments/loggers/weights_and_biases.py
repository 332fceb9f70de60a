"""Weights & Biases: curves over frames, the options, and a film of a failure."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from typing import Annotated, Any, Literal

from pydantic import Field

from zipf.experiments.loggers.logger import LOGGERS, End, Logger, Start
from zipf.options import Context, Options

Text = Annotated[str, Field(min_length=1)]
PATIENCE = 600.0  # seconds that the end of a run waits for uploads; ours


class WandbOptions(Options):
    """`project` is that of `entity`, a user or a team; None: the usual one of who is logged in.
    With `mode=offline` nothing leaves this machine, until `wandb sync` does it. `film`: a run that
    has finished shows a failure in the rarest situation."""

    name: Literal["wandb"]
    project: Text
    entity: Text | None
    mode: Literal["online", "offline"]
    film: bool

    def problems(self, context: Context) -> Iterator[str]:
        if find_spec("wandb") is None:
            yield "loggers=[wandb]: needs wandb: pip install '.[wandb]' in a clone of zipf"


class Wandb(Logger):
    """A run of Weights & Biases. Its id is in the file `wandb.txt` of the run's folder, so that a
    run that goes on does so there, too."""

    def __init__(self, options: WandbOptions):
        self.options = options

    def on_start(self, run: Start) -> None:
        import wandb

        file = run.folder / "wandb.txt"
        if run.is_new or not file.exists():
            file.write_text(f"{secrets.token_hex(4)}\n", encoding="utf-8")
        o = self.options
        self._run: Any = wandb.init(
            project=o.project,
            entity=o.entity,
            mode=o.mode,
            id=file.read_text(encoding="utf-8").strip(),
            resume="allow",
            name=run.name,
            group=f"{run.options['experiment']} {run.options['condition']}",
            config=dict(run.options),
            dir=run.folder,
            settings=wandb.Settings(
                console="off",
                quiet=True,
                finish_timeout=PATIENCE,
                finish_timeout_raises=True,
            ),
        )
        self._run.define_metric("*", step_metric="frames")

    def on_update(self, when: Mapping[str, float], metrics: Mapping[str, float]) -> None:
        self._log(when, "train", metrics)

    def on_evaluation(self, when: Mapping[str, float], scores: Mapping[str, float]) -> None:
        self._log(when, "score", scores)

    def on_end(self, end: End) -> None:
        import wandb

        try:
            if end.finished and self.options.film and (film := end.film()):
                shown = wandb.Video(str(film), format="gif")
                self._run.log({"update": end.update, "failure in the rarest situation": shown})
        finally:
            self._run.finish()

    def _log(self, when: Mapping[str, float], group: str, values: Mapping[str, float]) -> None:
        self._run.log({**when, **{f"{group}/{name}": value for name, value in values.items()}})


LOGGERS.register(WandbOptions, Wandb)
