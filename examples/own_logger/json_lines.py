"""A logger of one's own: a line of JSON for every evaluation, in a file of the run's folder."""

import json
from typing import Literal

from zipf.experiments.loggers import LOGGERS, Logger
from zipf.options import Options


class JsonLinesOptions(Options):
    name: Literal["json_lines"]
    file: str = "scores.jsonl"


class JsonLines(Logger):
    def __init__(self, options):
        self.options = options

    def on_start(self, run):
        self.path = run.folder / self.options.file
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        # What came after the checkpoint that the run goes on from is written again.
        kept = [line for line in lines if json.loads(line)["update"] <= run.update]
        self.path.write_text("".join(f"{line}\n" for line in kept))

    def on_evaluation(self, when, scores):
        with open(self.path, "a") as file:
            file.write(json.dumps({**when, **scores}) + "\n")


LOGGERS.register(JsonLinesOptions, JsonLines)
