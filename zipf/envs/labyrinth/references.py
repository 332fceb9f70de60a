"""What random actions and the scripted experts score, measured by `measure_labyrinth.py`."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from zipf.envs.labyrinth.levels import by_name
from zipf.envs.random_play import Chance

OPTIONS = {"backend": "own", "num_actions": 15, "action_repeat": 4}
"""Constructor options that were measured."""


@dataclass(frozen=True)
class Reference:
    """A mean return, its standard error, and how many episodes it was measured over."""

    mean: float
    error: float
    episodes: int


@dataclass(frozen=True)
class References:
    """The measured returns of uniformly random actions and of the scripted expert on a level.

    Attributes:
        seed: of the measurement.
        commit: of the checkout that measured.
    """

    random: Reference
    expert: Reference
    seed: int
    commit: str


@cache
def measured() -> dict[str, References]:
    """The references of all levels by name."""
    return read(Path(__file__).with_name("references.json"))


def read(path: Path) -> dict[str, References]:
    """What `measure_labyrinth.py` has written: references by the level's name."""
    return {
        level: References(
            Reference(**found["random"]),
            Reference(**found["expert"]),
            found["seed"],
            found["commit"],
        )
        for level, found in json.loads(path.read_text("utf-8")).items()
    }


def chance(level: str, **options: Any) -> Chance | None:
    """The score of uniformly random actions, or None for options that were not measured."""
    if not options.items() <= OPTIONS.items():
        return None
    reference = measured()[by_name(level).name].random
    return Chance(reference.mean, reference.episodes)
