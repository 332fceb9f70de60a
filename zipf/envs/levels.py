"""Every level by name, and which levels train and which test a benchmark.

A level is its family's name and its own, for instance `gridworld/zipf_2` or
`playroom/lift/lift_shape_uniform`.
"""

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs import distributions
from zipf.envs.chance import Chance, measured
from zipf.envs.gridworld.chance import random_policy_success
from zipf.envs.gridworld.expert import Expert as GridworldExpert
from zipf.envs.gridworld.keys import KEYS as GRIDWORLD_KEYS
from zipf.envs.gridworld.single import GridworldEnv
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.keys import Keys
from zipf.envs.mixture import MixtureVectorEnv
from zipf.envs.playroom import levels as playroom_levels
from zipf.envs.playroom.expert import Expert as PlayroomExpert
from zipf.envs.playroom.first_frame import FirstFrameVectorEnv
from zipf.envs.playroom.keys import KEYS as PLAYROOM_KEYS
from zipf.envs.playroom.single import PlayroomEnv
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.vector import ZipfVectorEnv

Expert = Callable[[], NDArray[np.int64]]
"""A scripted player of a batch of worlds, from their state: called, it gives actions [N]."""


Level = str | Callable[..., ZipfVectorEnv]
"""A full level name, or for worlds of your own what makes a batch of them, called as
`make(num_envs, **options)`."""

KINDS = ("train", "uniform", "rare")


@dataclass(frozen=True)
class Split:
    """A benchmark: the level to train on, or several at once, and the two that test."""

    name: str
    train: Level | tuple[Level, ...]
    uniform: Level
    rare: Level

    def levels(self, kind: str) -> tuple[Level, ...]:
        """The levels of a kind: "train", "uniform" or "rare"."""
        levels = getattr(self, kind)
        return levels if isinstance(levels, tuple) else (levels,)


SPLITS = {
    "gridworld": Split("gridworld", "gridworld/zipf_2", "gridworld/uniform", "gridworld/rare"),
    "playroom_lift": Split(
        "playroom_lift",
        "playroom/lift/lift_shape_zipf3",
        "playroom/lift/lift_shape_uniform",
        "playroom/lift/lift_shape_uniform_rare",
    ),
    "playroom_put": Split(
        "playroom_put",
        (
            "playroom/put/lift_shape_zipf2",
            "playroom/put/put_near_bed_tray_frequent",
            "playroom/put/put_on_bed_tray_frequent",
        ),
        "playroom/put/put_on_bed_tray_all",
        "playroom/put/put_on_bed_tray_rare",
    ),
    "playroom_find": Split(
        "playroom_find",
        "playroom/supervised/find_shape_zipf3",
        "playroom/supervised/find_shape_uniform",
        "playroom/supervised/find_shape_uniform_rare",
    ),
}


@dataclass(frozen=True)
class _Family:
    single: Callable[..., gym.Env]
    vector: Callable[..., ZipfVectorEnv]
    chance: Callable[..., Chance | None] | None
    check: Callable[[str], object]
    """Raises ValueError for a name, without the family, that is no level."""
    keys: Keys | None = None
    expert: Callable[[Any], Expert] | None = None


def _gridworld_chance(level: str, **options: Any) -> Chance:
    return Chance(random_policy_success(level, **options))


_FAMILIES = {
    "gridworld": _Family(
        GridworldEnv,
        GridworldVectorEnv,
        _gridworld_chance,
        distributions.by_name,
        GRIDWORLD_KEYS,
        GridworldExpert,
    ),
    "playroom": _Family(
        PlayroomEnv,
        PlayroomVectorEnv,
        measured("zipf.envs.playroom"),
        playroom_levels.by_name,
        PLAYROOM_KEYS,
        PlayroomExpert,
    ),
}


@dataclass(frozen=True)
class FirstFrames:
    """A finding level of the playroom with its first frames as questions; see
    `FirstFrameVectorEnv`. It has the level's own name."""

    level: str

    def __call__(self, num_envs: int, **options: Any) -> ZipfVectorEnv:
        return FirstFrameVectorEnv(num_envs, self.level.partition("/")[2], **options)

    def __str__(self) -> str:
        return self.level


def first_frames(split: Split) -> Split:
    """A split whose levels ask about the first frame alone.

    Raises:
        ValueError: there are not two objects on the first frames, left and right.
    """
    for level in (level for kind in KINDS for level in split.levels(kind)):
        family, _, name = str(level).partition("/")
        if family != "playroom" or not playroom_levels.by_name(name).finding:
            raise ValueError(
                f"the first frame of {level} does not show two objects, left and right"
            )
    train = tuple(FirstFrames(str(level)) for level in split.levels("train"))
    return Split(
        split.name,
        train if len(train) > 1 else train[0],
        FirstFrames(str(split.uniform)),
        FirstFrames(str(split.rare)),
    )


def split(name: str) -> Split:
    """The split of this name. Raises `ValueError` for an unknown one."""
    if name not in SPLITS:
        raise ValueError(_unknown("split", name, list(SPLITS)))
    return SPLITS[name]


def make(level: str, **kwargs: Any) -> gym.Env:
    """One world of a level; `kwargs` are its family's constructor options.

    Raises:
        ValueError: for an unknown level, or options out of range.
    """
    family, name = _resolve(level)
    return family.single(level=name, **kwargs)


def make_vec(
    level: Level | Sequence[Level],
    num_envs: int,
    *,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    **kwargs: Any,
) -> ZipfVectorEnv:
    """`num_envs` worlds of a level that step together; otherwise as `make`.

    The level may also be what a `Split` may hold in a name's place. Several levels share the
    worlds: see `MixtureVectorEnv`.
    """
    if isinstance(level, Sequence) and not isinstance(level, str):
        makers = {str(one): partial(make_vec, one) for one in level}
        if len(makers) < len(level):
            raise ValueError(f"a mixture has every level once, got {', '.join(map(str, level))}")
        return MixtureVectorEnv(makers, num_envs, autoreset_mode=autoreset_mode, **kwargs)
    if callable(level):
        return level(num_envs, autoreset_mode=autoreset_mode, **kwargs)
    family, name = _resolve(level)
    return family.vector(num_envs, level=name, autoreset_mode=autoreset_mode, **kwargs)


def chance(level: Level, **kwargs: Any) -> Chance | None:
    """The score of uniformly random actions on a level, exact or measured.

    Args:
        level: a full level name.
        kwargs: constructor options as for `make` and `make_vec`; those that only change what is
            shown are ignored.

    Returns:
        What is known, or None where nothing is known of a level with these options.
    """
    if callable(level):
        return None
    family, name = _resolve(level)
    if family.chance is None:
        return None
    shown = {"observation", "image_size", "render_mode", "copy", "autoreset_mode"}
    options = {key: value for key, value in kwargs.items() if key not in shown}
    return family.chance(name, **options)


def keys(level: str) -> Keys | None:
    """What a keyboard's keys do on a level; None in a family that has none.

    Raises:
        ValueError: for an unknown level.
    """
    return _resolve(level)[0].keys


def expert(level: str, env: ZipfVectorEnv) -> Expert | None:
    """A scripted player of worlds that `make_vec` made of a level; None in a family without.

    Raises:
        ValueError: for an unknown level.
    """
    make_expert = _resolve(level)[0].expert
    return None if make_expert is None else make_expert(env)


def _resolve(level: str) -> tuple[_Family, str]:
    """The family of a full level name, and the level's name within it."""
    prefix, _, name = level.partition("/")
    if prefix not in _FAMILIES or not name:
        known = [str(one) for s in SPLITS.values() for kind in KINDS for one in s.levels(kind)]
        raise ValueError(_unknown("level", level, known))
    family = _FAMILIES[prefix]
    family.check(name)
    return family, name


def _unknown(kind: str, name: str, known: list[str]) -> str:
    nearest = difflib.get_close_matches(name, known, n=2, cutoff=0.4)
    hint = f" (did you mean {' or '.join(map(repr, nearest))}?)" if nearest else ""
    return f"unknown {kind} {name!r}{hint}: expected one of {', '.join(known)}"
