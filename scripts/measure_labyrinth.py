"""Measures what uniformly random actions and the scripted experts score in the labyrinth.

    python scripts/measure_labyrinth.py --episodes 200

Writes `zipf/envs/labyrinth/references.json`, which evaluations, reports and the documentation read.
Every draw comes from fixed seeds. Images are of a single pixel, since neither depends on them.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import zipf.envs
import zipf.envs.labyrinth
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.references import Reference, References
from zipf.envs.random_play import play_returns

PATH = Path(zipf.envs.labyrinth.__file__).with_name("references.json")


def measure(level: str, episodes: int, seed: int) -> References:
    """Plays a level."""
    name = f"labyrinth/{level}"
    env = zipf.envs.make_vec(name, min(episodes, 100), image_size=(1, 1))
    rng = np.random.default_rng([seed, 1])
    random = play_returns(env, lambda: rng.integers(15, size=env.num_envs), episodes, seed=seed)
    expert = zipf.envs.expert(name, env)
    assert expert is not None
    return References(reference(random), reference(play_returns(env, expert, episodes, seed=seed)))


def reference(returns: NDArray[np.float64]) -> Reference:
    error = float(returns.std(ddof=1)) / math.sqrt(len(returns))
    return Reference(round(float(returns.mean()), 4), round(error, 4), len(returns))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("levels", nargs="*", help="levels to measure; all if none is given")
    parser.add_argument("--episodes", type=int, default=200, help="of each level, at least 2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=PATH, help="the file to write, or to renew")
    given = parser.parse_args(arguments)
    if given.episodes < 2:
        parser.error(f"--episodes must be at least 2, got {given.episodes}")
    unknown = [level for level in given.levels if level not in LEVELS]
    if unknown:
        parser.error(f"unknown levels {', '.join(unknown)}: expected some of {', '.join(LEVELS)}")
    found = json.loads(given.out.read_text("utf-8")) if given.out.exists() else {}
    for level in given.levels or LEVELS:
        found[level] = asdict(measure(level, given.episodes, given.seed))
        means = ", ".join(
            f"{who} {value['mean']:.2f} +- {value['error']:.2f}"
            for who, value in found[level].items()
        )
        print(f"{level}: {means}", flush=True)
        ordered = {name: found[name] for name in LEVELS if name in found}
        given.out.write_text(json.dumps(ordered, indent=2) + "\n", "utf-8")
    print(f"written: {given.out}")


if __name__ == "__main__":
    main()
