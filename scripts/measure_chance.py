"""Measures how well uniformly random actions do on the playroom's levels.

    python scripts/measure_chance.py
    python scripts/measure_chance.py --blind

Writes `zipf/envs/playroom/chance.json`, which evaluations and reports read. Every draw comes from
fixed seeds. Images are as small as possible, since random actions do not depend on them.

With `--blind` it plays the expert without the instruction instead and writes nothing: the score of
a blind policy is computed exactly, and this shows beside it what such a policy reaches.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import zipf.envs.playroom
from zipf.envs import blind, measure_chance
from zipf.envs.playroom import FAMILY
from zipf.envs.playroom.blind import BlindExpert
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.random_play import measure

MEASURED = [(level, 900) for level in LEVELS] + [
    (f"lift/lift_shape_{name}", 100) for name in ("zipf3", "uniform", "uniform_rare")
]
"""Levels and `max_steps`: the benchmark's, and that of `experiment=playroom_lift_compact`."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=1000, help="of each level")
    parser.add_argument("--blind", action="store_true", help="measure the blind expert, and print")
    chosen = parser.parse_args()
    if chosen.blind:
        show_blind(chosen.episodes)
    else:
        write_chance(chosen.episodes)


def show_blind(episodes: int) -> None:
    for level, max_steps in MEASURED:
        options = {"image_size": (1, 1), "max_steps": max_steps}
        reached = measure(BlindExpert, f"playroom/{level}", episodes=episodes, **options)
        exact = blind(f"playroom/{level}", **options)
        assert exact is not None
        shown = f"{reached.score:.3f} reached, {exact.score:.3f} exact"
        print(f"{level}, {max_steps} steps: {shown}", flush=True)


def write_chance(episodes: int) -> None:
    figures: dict[str, list[dict[str, Any]]] = {}
    for level, max_steps in MEASURED:
        defaults = FAMILY.options_class().model_dump(exclude=set(FAMILY.appearance))
        options = {**defaults, "max_steps": max_steps}
        chance = measure_chance(
            f"playroom/{level}", episodes=episodes, image_size=(1, 1), **options
        )
        figure = {"score": chance.score, "episodes": episodes, "options": options}
        figures.setdefault(level, []).append(figure)
        print(f"{level}, {max_steps} steps: {chance.score:.4f}", flush=True)
    path = Path(zipf.envs.playroom.__file__).with_name("chance.json")
    path.write_text(json.dumps(figures, indent=2) + "\n", "utf-8")
    print(f"written: {path}")


if __name__ == "__main__":
    main()
