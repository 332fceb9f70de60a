"""How well uniformly random actions do on a level."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Chance:
    """The mean return of an episode of uniformly random actions.

    `episodes` is how many it was measured over, None where it is exact.
    """

    score: float
    episodes: int | None = None


def measured(package: str) -> Callable[..., Chance | None]:
    """Chance as a family that has no exact figures measured it.

    A function of a level's name and constructor options reads it from the package's `chance.json`,
    which `scripts/measure_chance.py` writes:

        {"lift/lift_shape_zipf3": [{"score": 0.3, "episodes": 1000, "options": {"max_steps": 900}}]}

    It is None for levels and options that were not measured.
    """

    def chance(level: str, **options: Any) -> Chance | None:
        figures = json.loads((resources.files(package) / "chance.json").read_text("utf-8"))
        for figure in figures.get(level, []):
            if options.items() <= figure["options"].items():
                return Chance(figure["score"], figure["episodes"])
        return None

    return chance
