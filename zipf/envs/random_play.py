"""Measures the score of uniformly random actions on a level, and of other players."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.family import make_vec
from zipf.envs.references import ReferenceScore
from zipf.envs.splits import Level, SplitLevel
from zipf.envs.vector import ZipfVectorEnv

Player = Callable[[], NDArray[np.int64]]


def measure_chance(
    level: Level | SplitLevel | Sequence[Level | SplitLevel],
    *,
    episodes: int = 1000,
    seed: int = 0,
    num_envs: int = 250,
    **options: Any,
) -> ReferenceScore:
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
) -> ReferenceScore:
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
    error = float(returns.std(ddof=1)) / math.sqrt(episodes) if episodes > 1 else None
    return ReferenceScore(float(returns.mean()), episodes, error=error)


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
