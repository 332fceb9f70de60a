"""A run of training, as its folder tells it: `zipf.train` returns one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from zipf.experiments.evaluation.trained import TrainedAgent
    from zipf.experiments.options.schema import Config
    from zipf.report import Report


class Run:
    """A run of training. Its properties read its files, so they follow a run that goes on.

    Args:
        folder: the run's.
        plugins: modules that it was made with, see `zipf.plugins`.

    Attributes:
        folder: the run's.
        config: its options.

    Raises:
        UserError: the folder holds no run of this package, or one that needs other plugins or
            another version, or is damaged.
    """

    def __init__(self, folder: str | Path, plugins: Sequence[str] = ()) -> None:
        from zipf.experiments.building import run_folder  # imports PyTorch
        from zipf.experiments.options import composing

        plugins = [plugins] if isinstance(plugins, str) else plugins
        composing.load_plugins(plugins)
        self.folder = Path(folder).expanduser()
        self.config: Config = run_folder.read_config(self.folder, plugins)
        self._plugins = tuple(plugins)

    def __repr__(self) -> str:
        state = "finished" if self.is_finished else f"to go on, of {self.config.updates} updates"
        return f"Run({self.folder.as_posix()!r}: {self._last_scores()}, {state})"

    def _last_scores(self) -> str:
        from zipf.experiments.records.results import load_run

        run = load_run(self.folder)
        if run.evaluations.empty:
            return "not scored yet"
        update = run.evaluations["update"].max()
        means = {
            kind: run.mean_scores(run.description.levels_of(kind)).set_index("update")["score"]
            for kind in run.evaluations["level_kind"].unique()
        }
        shown = [f"{kind} {by[update]:.3f}" for kind, by in means.items() if update in by]
        return f"{', '.join(shown)} at update {update}"

    @property
    def is_finished(self) -> bool:
        """Whether it was scored after the last of its updates."""
        from zipf.experiments.records.result_table import ends_at

        return ends_at(self.folder / "evaluations.csv", self.config.updates)

    @property
    def scores(self) -> pd.DataFrame:
        """Its evaluations, a row for each update and level: `update`, `frames`, `seconds`,
        `level_kind` (train, uniform, rare, ...), `level`, `episodes`, `score`, `success` (NaN where
        the level reports none) and `return`.

        Raises:
            UserError: a file of the run is damaged.
        """
        from zipf.experiments.records.results import load_run

        return load_run(self.folder).evaluations

    def load_agent(self, device: str = "cpu", *, seed: int = 0) -> TrainedAgent:
        """The agent of its last checkpoint, as `zipf.load_agent` loads it."""
        from zipf.experiments.evaluation.trained import load_agent

        return load_agent(self.folder, device, self._plugins, seed=seed)

    def report(self, **options: Any) -> Report:
        """Its tables and figures; see `zipf.report`, which has these options."""
        from zipf.report import report

        return report(self.folder, **options)
