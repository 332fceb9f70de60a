"""Plays episodes on a level, and measures the scores of random actions and of scripted policies."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import whole
from zipf.envs.baselines import BaselineScore
from zipf.envs.family import BoundPolicy, make_vec
from zipf.envs.splits import Level, SplitLevel
from zipf.envs.vector import Observation, ZipfVectorEnv


def measure_chance(
    level: Level | SplitLevel,
    *,
    episodes: int = 1000,
    seed: int = 0,
    num_envs: int = 250,
    **options: Any,
) -> BaselineScore:
    """Plays uniformly random actions on a level; the arguments are those of `measure`.

    Raises:
        ValueError: no episodes, an unknown level, or options out of range.
    """
    generator = np.random.default_rng([seed, 1])  # envs are seeded seed, seed + 1, ...

    def random_policy(env: ZipfVectorEnv) -> BoundPolicy:
        return lambda: generator.integers(int(env.single_action_space.n), size=env.num_envs)

    return measure(random_policy, level, episodes=episodes, seed=seed, num_envs=num_envs, **options)


def measure(
    policy: Callable[[Any], BoundPolicy],
    level: Level | SplitLevel,
    *,
    episodes: int = 1000,
    seed: int = 0,
    num_envs: int = 250,
    **options: Any,
) -> BaselineScore:
    """Plays a level with the actions of a scripted policy.

    The same arguments give the same figure on every machine.
    Raises ValueError: no episodes, no envs, an unknown level, or options out of range.

    Args:
        policy: `policy(env)` plays a batch: called, it gives actions [N].
        level: what `make_vec` takes for a single level.
        episodes: how many episodes, at least 1.
        seed: of the envs, and of random actions.
        num_envs: envs played at a time; more of them take more RAM and less time.
        options: constructor options of the level.
    """
    episodes = whole("episodes", episodes, 1)
    num_envs = whole("num_envs", num_envs, 1)
    env = make_vec(level, min(num_envs, episodes), **options)
    act = policy(env)
    returns = play_episodes(env, lambda *_: act(), episodes, seed=seed)["return"]
    env.close()
    error = float(returns.std(ddof=1)) / math.sqrt(episodes) if episodes > 1 else None
    return BaselineScore(float(returns.mean()), episodes, error=error)


def play_episodes(
    env: ZipfVectorEnv,
    act: Callable[[Observation, NDArray[np.float32], NDArray[np.bool_]], NDArray[np.int64]],
    episodes: int,
    *,
    seed: int,
    watch: Callable[[int], object] = lambda ended: None,
) -> dict[str, NDArray]:
    """Plays episodes of a batch.

    The first `episodes` episodes to start are counted, however long they are: of many envs played
    at a time those with short episodes finish more of them, and counting the first to end would
    count short ones too often. Returns by name, an array [episodes] in the order in which the
    episodes started: the situation's ranks, `success` (where the envs report it), `return` and
    `length`. Raises ValueError: the batch has another autoreset mode, or envs of several levels;
    EnvError: a counted episode
    is longer than `env.longest_episode`.

    Args:
        env: the batch, which resets envs in the step that ends their episodes.
        act: `act(observation, reward, is_first)` gives the actions of all envs, [N]. The reward
            is that of the step before, float32 [N]; `is_first` says where an episode begins, bool
            [N]. The observation is overwritten by the next.
        episodes: how many, at least 1.
        seed: of the envs.
        watch: called after every step with the number of counted episodes that have ended; what it
            raises ends the playing.
    """
    if env.autoreset_mode is not AutoresetMode.SAME_STEP:
        raise ValueError(f"autoreset_mode must be SAME_STEP, got {env.autoreset_mode.name}")
    if isinstance(env.level_of_envs, np.ndarray):
        raise ValueError("the envs are of several levels: short episodes would count more")
    names = [*env.situation, *(["success"] if env.reports_success else []), "return", "length"]
    records: dict[str, NDArray] = {}
    # The episode that each env plays, numbered as they start; from `episodes` on, not counted.
    playing = np.arange(env.num_envs)
    started, unfinished = env.num_envs, episodes
    out = env.allocate()
    observation, _ = env.reset(seed=seed, out=out)
    reward = np.zeros(env.num_envs, np.float32)
    is_first = np.ones(env.num_envs, np.bool_)
    while unfinished:
        actions = act(observation, reward, is_first)
        observation, rewards, terminated, truncated, info = env.step(actions, out=out)
        reward = rewards.astype(np.float32)
        is_first = terminated | truncated
        env.check_lengths(playing < episodes)
        if not is_first.any():
            watch(episodes - unfinished)
            continue
        counted = is_first & (playing < episodes)
        for name in names:
            values = info["final_info"][name]
            column = records.setdefault(name, np.zeros(episodes, values.dtype))
            column[playing[counted]] = values[counted]
        unfinished -= int(counted.sum())
        new = int(is_first.sum())
        playing[is_first] = np.arange(started, started + new)
        started += new
        watch(episodes - unfinished)
    return {name: records[name] for name in names}
