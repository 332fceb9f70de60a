"""The scripted expert solves every level with the 46 actions."""

import numpy as np
import pytest
from numpy.typing import NDArray

from zipf.envs.playroom.expert import Expert
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.playroom.vector import PlayroomVectorEnv


def solved(level: str, episodes: int, **options: str) -> tuple[float, NDArray[np.int64]]:
    """The share of the worlds' first episodes that succeed, and the lengths of those that end.

    Stops when nearly all have succeeded, because a failure takes all 200 actions.
    """
    env = PlayroomVectorEnv(
        episodes, level, image_size=(1, 1), max_steps=200, autoreset_mode="Disabled", **options
    )
    env.reset(seed=1000)
    expert = Expert(env)
    success, lengths = np.zeros(episodes, np.bool_), np.zeros(episodes, np.int64)
    while (lengths == 0).any() and success.mean() < 0.97:
        *_, info = env.step(expert())
        if "_success" in info:
            new = info["_success"] & (lengths == 0)
            success[new], lengths[new] = info["success"][new], info["length"][new]
            env.reset(options={"reset_mask": info["_success"]})
    return float(success.mean()), lengths[lengths > 0]


@pytest.mark.parametrize("level", list(LEVELS))
def test_the_expert_solves_every_level(level: str) -> None:
    success, lengths = solved(level, 50)
    assert success >= 0.95
    assert np.median(lengths) < 100


@pytest.mark.parametrize("level", ["lift/lift_shape_uniform", "put/put_near_bed_tray_frequent"])
def test_the_expert_solves_the_other_order(level: str) -> None:
    assert solved(level, 50, object_order="alternate")[0] >= 0.95
