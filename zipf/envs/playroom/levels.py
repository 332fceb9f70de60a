"""The playroom's levels, its objects and its instructions.

The eighteen of the release, and ours, whose names end in `_validation`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zipf.envs import distributions
from zipf.envs.arguments import unknown
from zipf.envs.language import Vocabulary

OBJECTS = (
    *("duck", "ball", "book", "cup", "car", "train", "boat", "robot", "teddy", "rocket"),
    *("bus", "plane", "mug", "spoon", "bowl", "plate", "bottle", "chair", "lamp", "hat"),
    *("drum", "guitar", "piano", "clock", "phone", "keyboard", "helicopter", "carriage"),
    *("racket", "pillow", "candle", "teapot", "banana", "apple", "carrot", "mushroom"),
    *("toothbrush", "toothpaste", "comb", "hairdryer", "fork", "hammer", "screwdriver", "key"),
    *("scissors", "umbrella", "basket", "cactus", "dice", "pyramid"),
)
"""The 50 objects by frequency rank. Ours: the release's list is not published."""

ALTERNATE = (
    *("keyboard", "piano", "dice", "screwdriver", "helicopter", "bowl", "drum", "fork", "racket"),
    *("spoon", "banana", "robot", "comb", "book", "train", "hat", "bottle", "mug", "chair"),
    *("cactus", "clock", "carriage", "mushroom", "key", "boat", "cup", "pyramid", "rocket"),
    *("candle", "umbrella", "phone", "scissors", "toothbrush", "toothpaste", "car", "pillow"),
    *("hammer", "basket", "teapot", "plate", "apple", "teddy", "hairdryer", "ball", "duck"),
    *("carrot", "bus", "lamp", "plane", "guitar"),
)
"""A second order, shuffled so that nothing frequent or rare stays what it was: it separates
effects of rarity from effects of shape."""

ORDERS = {"default": OBJECTS, "alternate": ALTERNATE}

SUPPORTS = ("bed", "tray")
LIFT, NEAR, ON = 0, 1, 3
"""A task is LIFT, or NEAR or ON plus the index of a support."""
TASKS = ("lift", "near bed", "near tray", "on bed", "on tray")

VOCABULARY = Vocabulary(
    ("a", "find", "lift", "near", "on", "put", *SUPPORTS, *sorted(OBJECTS)), length=6
)


@dataclass(frozen=True)
class Level:
    """What a level draws an episode from."""

    name: str  # without its family
    probabilities: NDArray[np.float64]  # of the ranks of objects, float64 [50]
    others: int  # objects beside the target
    # those drawn from, each as likely as the others; empty in `supervised/` levels, where the task
    # is to approach
    tasks: tuple[int, ...]
    furnished: bool  # whether there are a bed and a tray

    @property
    def finding(self) -> bool:
        """Two objects, drawn with replacement, left and right of the agent's view."""
        return not self.tasks

    @property
    def situation(self) -> dict[str, int]:
        """Names and sizes of the ranks an episode is drawn at."""
        others = ["other"] if self.others == 1 else [f"other_{i + 1}" for i in range(self.others)]
        situation = dict.fromkeys(["target", *others], len(OBJECTS))
        if self.furnished:
            situation["task"] = len(TASKS)
        return situation


def _frequent(exponent: float) -> NDArray[np.float64]:
    """Zipf's law over the most frequent fifth of the objects, float64 [50]."""
    n = len(OBJECTS)
    return np.append(distributions.zipfian(n // 5, exponent), np.zeros(n - n // 5))


def _levels() -> dict[str, Level]:
    n = len(OBJECTS)
    drawn = {
        **{f"zipf{exponent}": distributions.zipfian(n, exponent) for exponent in (1, 2, 3, 4)},
        "uniform": distributions.uniform(n),
        "uniform_rare": distributions.rare(n),
        "all": distributions.uniform(n),
        "rare": distributions.rare(n),
        "validation": distributions.validation(n),
        "frequent": _frequent(0.0),
    }
    near = tuple(NEAR + i for i in range(len(SUPPORTS)))
    on = tuple(ON + i for i in range(len(SUPPORTS)))
    kinds: dict[str, tuple[list[str], int, tuple[int, ...], bool]] = {
        "lift/lift_shape": (
            ["zipf2", "zipf3", "zipf4", "uniform", "uniform_rare", "validation"],
            2,
            (LIFT,),
            False,
        ),
        "put/lift_shape": (["zipf2", "uniform", "uniform_rare"], 2, (LIFT,), True),
        # Ours: how many are many is not published.
        "put/lift_shape_many": (["zipf1", "zipf4"], 5, (LIFT,), True),
        "put/put_near_bed_tray": (["frequent"], 2, near, True),
        "put/put_on_bed_tray": (["frequent", "all", "rare", "validation"], 2, on, True),
        "supervised/find_shape": (
            ["zipf2", "zipf3", "uniform", "uniform_rare", "validation"],
            1,
            (),
            False,
        ),
    }
    return {
        f"{kind}_{name}": Level(f"{kind}_{name}", drawn[name], others, tasks, furnished)
        for kind, (names, others, tasks, furnished) in kinds.items()
        for name in names
    }


LEVELS = _levels()


def by_name(name: str, frequent_exponent: float = 0.0) -> Level:
    """The level of this name, with or without `playroom/` before it; the exponent is that of Zipf's
    law over the ten most frequent objects in `*_frequent` levels. Raises ValueError: there is none;
    names the nearest."""
    if not isinstance(name, str):
        raise ValueError(f"level must be a name, got {name!r}: expected one of {', '.join(LEVELS)}")
    name = name.removeprefix("playroom/")
    if name not in LEVELS:
        raise unknown("level", name, LEVELS)
    level = LEVELS[name]
    if name.endswith("_frequent"):
        level = replace(level, probabilities=_frequent(frequent_exponent))
    return level


def instruction(level: Level, target: str, task: int) -> str:
    """What the agent is told, for instance "put a duck on a bed"."""
    if level.finding:
        return f"find a {target}"
    if task == LIFT:
        return f"lift a {target}"
    return f"put a {target} {TASKS[task].split()[0]} a {TASKS[task].split()[1]}"
