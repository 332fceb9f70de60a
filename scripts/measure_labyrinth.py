"""Measures what uniformly random actions and the scripted experts score in the labyrinth.

    python scripts/measure_labyrinth.py --episodes 200

Writes `zipf/envs/labyrinth/references.json`, which evaluations, reports and the documentation read,
and `results/labyrinth_references.md`, which `make results` copies into the record.
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
from zipf.envs.labyrinth.references import Reference, References, read
from zipf.envs.random_play import play_returns
from zipf.experiments.running.run_folder import commit

PAGE = Path(__file__).parent.parent / "results" / "labyrinth_references.md"
PATH = Path(zipf.envs.labyrinth.__file__).with_name("references.json")


def measure(level: str, episodes: int, seed: int) -> References:
    """Plays a level."""
    name = f"labyrinth/{level}"
    env = zipf.envs.make_vec(name, min(episodes, 100), image_size=(1, 1))
    rng = np.random.default_rng([seed, 1])
    random = play_returns(env, lambda: rng.integers(15, size=env.num_envs), episodes, seed=seed)
    expert = zipf.envs.expert(name, env)
    assert expert is not None
    played = play_returns(env, expert, episodes, seed=seed)
    return References(reference(random), reference(played), seed, commit() or "none")


def reference(returns: NDArray[np.float64]) -> Reference:
    error = float(returns.std(ddof=1)) / math.sqrt(len(returns))
    return Reference(round(float(returns.mean()), 4), round(error, 4), len(returns))


def page(found: dict[str, References]) -> str:
    """The table for the record."""
    lines = [
        "## Zipf's Labyrinth: references\n",
        "| Level | Random, published | Human, published | Random | Expert | Episodes | Seed "
        "| Commit |\n| :-- | --: | --: | --: | --: | --: | --: | :-- |",
    ]
    for name, own in found.items():
        level = LEVELS[name]
        random, expert = (f"{one.mean:.2f} ± {one.error:.2f}" for one in (own.random, own.expert))
        lines.append(
            f"| {name} | {level.random:g} | {level.human:g} | {random} | {expert} "
            f"| {own.random.episodes} | {own.seed} | {own.commit[:10]} |"
        )
    lines.append(
        "\nMean returns of an episode ± standard error. The published ones were taken in the "
        "original engine, those of levels that end in `_train` on the `_test` levels. The scripted "
        "experts read the state of the world; they are no upper bound.\n"
    )
    lines.append("```\npython scripts/measure_labyrinth.py --episodes 200\n```\n")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("levels", nargs="*", help="levels to measure; all if none is given")
    parser.add_argument("--episodes", type=int, default=200, help="of each level, at least 2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=PATH, help="the file to write, or to renew")
    parser.add_argument("--page", type=Path, default=PAGE, help="the table for the record")
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
            f"{who} {found[level][who]['mean']:.2f} +- {found[level][who]['error']:.2f}"
            for who in ("random", "expert")
        )
        print(f"{level}: {means}", flush=True)
        ordered = {name: found[name] for name in LEVELS if name in found}
        given.out.write_text(json.dumps(ordered, indent=2) + "\n", "utf-8")
    given.page.write_text(page(read(given.out)), "utf-8")
    print(f"written: {given.out}, {given.page}")


if __name__ == "__main__":
    main()
