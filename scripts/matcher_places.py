"""Where the matcher of a run sees the toy that is asked for, in first frames of lifting.

    python scripts/matcher_places.py runs/playroom_find_compact/names/seed0
    python scripts/matcher_places.py RUN --level playroom/lift/lift_shape_zipf3 --frames 5000

Counted are frames in which the named toy and another one are in view. A row for each group of
ranks of the named toy: `named` is the share of frames in which the place with the highest score is
nearest to it, of the toys in view, `random` that of a random toy in view. The run may be of any
agent with `network=matching`.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from zipf import envs
from zipf.agents.encoders import Encoder
from zipf.envs.playroom.constants import EYE
from zipf.envs.playroom.geometry import half_width
from zipf.envs.playroom.in_view import look
from zipf.envs.playroom.state import AX, AY, PITCH, YAW, X, Y, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.playroom.view import FIELD_OF_VIEW
from zipf.experiments.evaluation.trained import load_agent

_GROUPS = [0, 1, 2, 5, 10, 20, 40, 50]  # ours: first ranks of the rows
_BATCH = 250


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("--level", default="playroom/lift/lift_shape_uniform")
    parser.add_argument("--frames", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    trained = load_agent(options.run, "cpu")
    image_size = trained.config.level_options["image_size"]
    env = envs.make_vec(options.level, options.frames, image_size=image_size)
    assert isinstance(env, PlayroomVectorEnv)
    observation, info = env.reset(seed=options.seed)
    place = best_places(trained.agent.actor.encoder, observation)
    toys, seen = toys_in_image(env)
    counted = seen[:, 0] & (seen.sum(1) > 1)
    distance = np.linalg.norm(toys - place[:, None], axis=-1)
    frames = pd.DataFrame(
        {
            "ranks": pd.cut(info["target"], _GROUPS, right=False),
            "frames": 1,
            "named": np.where(seen, distance, np.inf).argmin(1) == 0,
            "random": 1 / np.maximum(seen.sum(1), 1),
        }
    )[counted]
    table = frames.groupby("ranks", observed=True).agg(
        {"frames": "sum", "named": "mean", "random": "mean"}
    )
    table.loc["all"] = [len(frames), frames["named"].mean(), frames["random"].mean()]
    print(f"{options.run}, update {trained.update}, {options.level}, {options.frames} episodes")
    print(table.astype({"frames": int}).round(2).to_string())


@torch.no_grad()
def best_places(encoder: Encoder, observation: dict[str, NDArray]) -> NDArray[np.float32]:
    """The centre of the place with the highest score for each image's own instruction, [N, 2]:
    down and to the right, in sides of the image."""
    best = []
    for start in range(0, len(observation["image"]), _BATCH):
        part = {k: torch.as_tensor(v[start : start + _BATCH]) for k, v in observation.items()}
        texts, which = part["instruction"].unique(dim=0, return_inverse=True)
        scores = encoder.match(part, {"instruction": texts})
        best.append(scores[torch.arange(len(which)), :, which].argmax(1))
    return encoder.places()[torch.cat(best)].numpy()


def toys_in_image(env: PlayroomVectorEnv) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where the toys' middles are in the image, as `best_places`, [N, C, 2], and which toys are in
    view, [N, C]; the first is the named one."""
    states = env.envs
    height, width = env.single_observation_space["image"].shape[:2]
    wide = math.tan(math.radians(FIELD_OF_VIEW) / 2)
    high = wide * height / width
    seen = np.zeros(states.ranks.shape, np.bool_)
    look(states, wide, high, seen, np.zeros((env.num_envs, 2), np.bool_))
    agents = states.agents[:, None]
    tall = [
        [half_width(states.orientation[i, j], states.extents[rank], 0.0, 0.0, 1.0)
         for j, rank in enumerate(ranks)]
        for i, ranks in enumerate(states.ranks)
    ]  # fmt: skip
    x = states.objects[..., X] - agents[..., AX]
    y = states.objects[..., Y] - agents[..., AY]
    z = states.objects[..., Z] + np.array(tall) - EYE
    cos, sin = np.cos(agents[..., YAW]), np.sin(agents[..., YAW])
    level, up = np.cos(agents[..., PITCH]), np.sin(agents[..., PITCH])
    ahead = cos * x + sin * y
    depth = level * ahead + up * z
    aside, above = sin * x - cos * y, level * z - up * ahead
    with np.errstate(divide="ignore"):
        down, right = 0.5 - above / (2 * high * depth), 0.5 + aside / (2 * wide * depth)
    return np.stack([down, right], -1), seen


if __name__ == "__main__":
    main()
