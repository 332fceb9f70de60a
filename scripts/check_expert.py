"""Plays the scripted expert on the playroom's levels, and lists the episodes in which it fails.

    python scripts/check_expert.py
    python scripts/check_expert.py --levels lift/lift_shape_zipf3 --episodes 100

Every episode has a seed of its own: `zipf.envs.make("playroom/LEVEL").reset(seed=SEED)` begins it
again. The exit code is 1 if more than one in 2,000 episodes of a level fails.
"""

import argparse
import sys
from typing import Any

import numpy as np

from zipf.envs.playroom.expert import Expert
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.playroom.vector import PlayroomVectorEnv

NUM_ENVS = 100


def failures(level: str, episodes: int, first_seed: int = 0, **options: Any) -> list[int]:
    """The seeds of the episodes of a level that the expert does not solve.

    Args:
        level: the level's name, without its family.
        episodes: how many, seeded `first_seed`, `first_seed + 1`, ...
        first_seed: at least 0.
        options: constructor options of the level.
    """
    num_envs = min(NUM_ENVS, episodes)
    env = PlayroomVectorEnv(
        num_envs, level, image_size=(1, 1), autoreset_mode="Disabled", **options
    )
    seeds = np.arange(first_seed, first_seed + num_envs)
    unfinished, last = set(seeds.tolist()), first_seed + episodes
    failed = []
    env.reset(seed=seeds.tolist())
    expert = Expert(env)
    while unfinished:
        *_, info = env.step(expert())
        if "_success" not in info:
            continue
        ended = info["_success"]
        for i in np.flatnonzero(ended).tolist():
            unfinished.discard(seed := int(seeds[i]))
            if seed < last and not info["success"][i]:
                failed.append(seed)
            seeds[i] += num_envs
            if seeds[i] < last:
                unfinished.add(int(seeds[i]))
        env.reset(seed=seeds.tolist(), options={"reset_mask": ended})
    env.close()
    return sorted(failed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", nargs="+", default=list(LEVELS), metavar="LEVEL")
    parser.add_argument("--episodes", type=int, default=2000, help="of each level")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    arguments = parser.parse_args()
    worst = 0
    for level in arguments.levels:
        failed = failures(level, arguments.episodes, arguments.seed)
        worst = max(worst, len(failed))
        print(f"{level}: {arguments.episodes} episodes, {len(failed)} fail {failed}", flush=True)
    sys.exit(worst > max(1, arguments.episodes / 2000))


if __name__ == "__main__":
    main()
