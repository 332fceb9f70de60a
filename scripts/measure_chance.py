"""Measures how well uniformly random actions do where nothing exact is known.

    python scripts/measure_chance.py playroom_lift playroom_put playroom_find --episodes 10000

Writes `zipf/envs/<family>/chance.json`, keeping there what is known of other levels.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from zipf.envs import levels
from zipf.experiments.config import EnvironmentOptions
from zipf.experiments.evaluator import play

ENVS = Path(__file__).parent.parent / "zipf" / "envs"


class RandomActions:
    """A policy that never looks."""

    def __init__(self, num_actions: int, seed: int) -> None:
        self.num_actions = num_actions
        self.rng = np.random.default_rng([seed, 1])  # worlds are seeded seed, seed + 1, ...

    def start(self, num_envs: int) -> None: ...

    def __call__(self, observation: object, reward: object, is_first: np.ndarray) -> np.ndarray:
        return self.rng.integers(self.num_actions, size=len(is_first))


def measure(split: levels.Split, episodes: int, num_envs: int, seed: int) -> None:
    """Measures every level of a split with its family's default options."""
    options = TypeAdapter(EnvironmentOptions).validate_python({"split": split.name}).model_dump()
    del options["split"]
    for level in {level: None for kind in levels.KINDS for level in split.levels(kind)}:
        family, name = str(level).split("/", 1)
        file = ENVS / family / "chance.json"
        known = json.loads(file.read_text()) if file.exists() else {}
        env = levels.make_vec(level, num_envs, **options)
        policy = RandomActions(int(env.single_action_space.n), seed)
        score = float(play(policy, env, episodes=episodes, seed=seed)["return"].mean())
        env.close()
        # How worlds are drawn does not matter to a policy that never looks.
        told = {key: value for key, value in options.items() if key != "image_size"}
        known[name] = {"score": score, "episodes": episodes, "options": told}
        file.write_text(json.dumps(dict(sorted(known.items())), indent=2) + "\n")
        print(f"{level}: {score:.4f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("splits", nargs="+", choices=list(levels.SPLITS))
    parser.add_argument("--episodes", type=int, default=10_000, help="a level (10000)")
    parser.add_argument("--num-envs", type=int, default=250, help="worlds at a time (250)")
    parser.add_argument("--seed", type=int, default=0, help="of worlds and actions (0)")
    arguments = parser.parse_args()
    for split in arguments.splits:
        measure(levels.split(split), arguments.episodes, arguments.num_envs, seed=arguments.seed)


if __name__ == "__main__":
    main()
