"""Chance: the score of uniformly random actions on a level, and of other players."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.family import make_vec
from zipf.envs.splits import Level, SplitLevel
from zipf.envs.vector import ZipfVectorEnv

Player = Callable[[], NDArray[np.int64]]


@dataclass(frozen=True)
class Chance:
    """The mean return of an episode of a policy that does not learn: of uniformly random actions,
    or of a blind policy, see `Family`.

    Attributes:
        score: the mean return.
        episodes: how many it was measured over; None if it is exact.
        by_rank: the mean return at each value of a rank of the situation, by the rank's name, on a
            level on which all others are drawn as here; without those that are not known.
    """

    score: float
    episodes: int | None = None
    by_rank: Mapping[str, tuple[float, ...]] = field(default_factory=dict, hash=False)


def measure_chance(
    level: Level | SplitLevel | Sequence[Level | SplitLevel],
    *,
    episodes: int = 1000,
    seed: int = 0,
    num_envs: int = 250,
    **options: Any,
) -> Chance:
    """Plays uniformly random actions on a level; the arguments are those of `measure`.

    Raises:
        ValueError: no episodes, an unknown level, or options out of range.
    """
    generator = np.random.default_rng([seed, 1])  # worlds are seeded seed, seed + 1, ...

    def random_player(env: ZipfVectorEnv) -> Player:
        return lambda: generator.integers(int(env.single_action_space.n), size=env.num_envs)

    return measure(random_player, level, episodes=episodes, seed=seed, num_envs=num_envs, **options)


def measure(
    player: Callable[[Any], Player],
    level: Level | SplitLevel | Sequence[Level | SplitLevel],
    *,
    episodes: int = 1000,
    seed: int = 0,
    num_envs: int = 250,
    **options: Any,
) -> Chance:
    """Plays a level with the actions of a scripted player.

    The same arguments give the same figure on every machine.

    Args:
        player: `player(env)` plays a batch: called, it gives actions [N].
        level: what `make_vec` takes.
        episodes: how many episodes, at least 1.
        seed: of the worlds, and of random actions.
        num_envs: worlds played at a time; more of them take more RAM and less time.
        options: constructor options of the level.

    Raises:
        ValueError: no episodes, an unknown level, or options out of range.
    """
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    env = make_vec(level, min(num_envs, episodes), **options)
    returns = play_returns(env, player(env), episodes, seed=seed)
    env.close()
    return Chance(float(returns.mean()), episodes)


def play_returns(
    env: ZipfVectorEnv, act: Player, episodes: int, *, seed: int
) -> NDArray[np.float64]:
    """Plays episodes of a batch and gives their returns, float64 [episodes].

    The first `episodes` episodes to start are counted, however long they are: of many worlds played
    at a time those with short episodes finish more of them, and counting the first to end would
    count short ones too often.

    Args:
        env: the batch, which resets worlds in the step that ends their episodes.
        act: gives the actions of all worlds, [N].
        episodes: how many, at least 1.
        seed: of the worlds.
    """
    returns = np.zeros(episodes)
    # The episode that each world plays, numbered as they start; from `episodes` on, not counted.
    playing = np.arange(env.num_envs)
    started, unfinished = env.num_envs, episodes
    out = env.allocate()
    env.reset(seed=seed, out=out)
    while unfinished:
        _, _, terminated, truncated, info = env.step(act(), out=out)
        ended = terminated | truncated
        if not ended.any():
            continue
        counted = ended & (playing < episodes)
        returns[playing[counted]] = info["final_info"]["return"][counted]
        unfinished -= int(counted.sum())
        new = int(ended.sum())
        playing[ended] = np.arange(started, started + new)
        started += new
    return returns


def measured(package: str) -> Callable[..., Chance | None]:
    """The measured chance of a family's levels, from `chance.json` in its package.

    Returns:
        A function of a level's name and constructor options, as `Family.chance`. It returns None
        for levels and options that were not measured. The file has for each level a list of
        figures, as `scripts/measure_chance.py` writes it:

        {"lift/lift_shape_zipf3": [{"score": 0.3, "episodes": 1000, "options": {"max_steps": 900}}]}
    """

    def chance(level: str, **options: Any) -> Chance | None:
        figures = json.loads((resources.files(package) / "chance.json").read_text("utf-8"))
        for figure in figures.get(level, []):
            if options.items() <= figure["options"].items():
                return Chance(figure["score"], figure["episodes"])
        return None

    return chance
