"""Measures how well uniformly random actions do on the playroom's levels.

    python scripts/measure_chance.py

Writes `zipf/envs/playroom/chance.json`, which evaluations and reports read. Every draw comes from
fixed seeds. Images are drawn as small as can be, since random actions do not look at them.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import zipf.envs.playroom
from zipf.envs import make_vec
from zipf.envs.playroom.levels import LEVELS
from zipf.experiments.running.evaluator import play

MEASURED = [(level, 900) for level in LEVELS] + [
    (f"lift/lift_shape_{name}", 100) for name in ("zipf3", "uniform", "uniform_rare")
]
"""Levels and `max_steps`: the benchmark's, and that of `experiment=playroom_lift_compact`."""


class Random:
    """Uniformly random actions."""

    def start(self, num_envs: int) -> None:
        self.generator = np.random.default_rng([0, 1])  # worlds are seeded 0, 1, ...

    def __call__(self, observation: object, reward: NDArray, is_first: NDArray) -> NDArray:
        return self.generator.integers(46, size=len(is_first))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=1000, help="of each level")
    episodes = parser.parse_args().episodes
    figures: dict[str, list[dict[str, Any]]] = {}
    for level, max_steps in MEASURED:
        options = {"object_order": "default", "max_steps": max_steps}
        env = make_vec(f"playroom/{level}", 250, image_size=(1, 1), **options)  # type: ignore[arg-type]
        score = float(play(Random(), env, episodes=episodes, seed=0)["return"].mean())
        figure = {"score": score, "episodes": episodes, "options": options}
        figures.setdefault(level, []).append(figure)
        print(f"{level}, {max_steps} steps: {score:.4f}", flush=True)
    path = Path(zipf.envs.playroom.__file__).with_name("chance.json")
    path.write_text(json.dumps(figures, indent=2) + "\n", "utf-8")
    print(f"written: {path}")


if __name__ == "__main__":
    main()
