"""Shows the expert at work: frames of a lifting, a putting and a finding episode, in one picture.

python scripts/episode_sheet.py out.png
"""

import argparse
from pathlib import Path

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from PIL import Image

from zipf.envs.playroom.expert import Expert
from zipf.envs.playroom.vector import PlayroomVectorEnv

EPISODES = {
    "lift/lift_shape_uniform": 1,
    "put/put_on_bed_tray_all": 5,
    "put/put_near_bed_tray_frequent": 2,
    "supervised/find_shape_uniform": 3,
}
"""Level and seed."""
COLUMNS = 6


def episode(level: str, seed: int) -> list[NDArray[np.uint8]]:
    """Every frame of an episode, uint8 [288, 384, 3] each."""
    env = PlayroomVectorEnv(
        1, level, render_mode="rgb_array", autoreset_mode=AutoresetMode.DISABLED
    )
    env.reset(seed=seed)
    expert = Expert(env)
    frames: list[NDArray[np.uint8]] = []
    while True:
        frames += env.render() or ()
        _, reward, terminated, truncated, _ = env.step(expert())
        if terminated[0] or truncated[0]:
            frames += env.render() or ()
            print(f"{level}: {len(frames) - 1} steps, reward {reward[0]:g}")
            return frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    rows = []
    for level, seed in EPISODES.items():
        frames = episode(level, seed)
        picks = np.linspace(0, len(frames) - 1, COLUMNS).round().astype(int)
        rows.append(np.concatenate([frames[k] for k in picks], 1))
    sheet = Image.fromarray(np.concatenate(rows))
    sheet.resize((sheet.width // 2, sheet.height // 2), Image.Resampling.LANCZOS).save(out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
