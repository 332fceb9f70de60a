"""A callback of one's own: stops a run whose validation score has stopped growing."""

from typing import Literal

import pandas as pd

from zipf.experiments.loggers import LOGGERS, Logger
from zipf.options import Options, Size


class EarlyStoppingOptions(Options):
    name: Literal["early_stopping"]
    patience: Size = 5  # evaluations without a better score; ours


class EarlyStopping(Logger):
    def __init__(self, options):
        self.options = options

    def on_start(self, run):
        self.table = run.folder / "evaluations.csv"  # which a run that goes on has, too
        return self.reason()

    def on_evaluation(self, when, scores):
        return self.reason()

    def reason(self):
        if not self.table.exists():
            return None
        rows = pd.read_csv(self.table)
        scores = rows[rows["level_kind"] == "validation"].groupby("update")["score"].mean()
        if scores.empty or len(scores.loc[scores.idxmax() :]) <= self.options.patience:
            return None
        return f"no better validation score than {scores.max():.3f} at update {scores.idxmax()}"


LOGGERS.register(EarlyStoppingOptions, EarlyStopping)
