"""The scripted expert solves every level with the 46 actions."""

from typing import Any

import numpy as np
import pytest
from conftest import slow_but
from numpy.typing import NDArray

from zipf.envs.playroom.expert import Expert
from zipf.envs.playroom.levels import LEVELS
from zipf.envs.playroom.vector import PlayroomVectorEnv


def solved(
    level: str, seeds: list[int], **options: Any
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Whether the episodes of these seeds succeed in 300 actions, and their lengths."""
    env = PlayroomVectorEnv(
        len(seeds), level, image_size=(1, 1), max_steps=300, autoreset_mode="Disabled", **options
    )
    env.reset(seed=seeds)
    expert = Expert(env)
    success, lengths = np.zeros(len(seeds), np.bool_), np.zeros(len(seeds), np.int64)
    while (lengths == 0).any():
        *_, info = env.step(expert())
        if "_success" in info:
            new = info["_success"] & (lengths == 0)
            success[new], lengths[new] = info["success"][new], info["length"][new]
            env.reset(options={"reset_mask": info["_success"]})
    return success, lengths


@pytest.mark.parametrize("level", slow_but(LEVELS, "put/put_on_bed_tray_all"))
def test_the_expert_solves_every_level(level: str) -> None:
    """`scripts/check_expert.py` plays many more episodes."""
    success, lengths = solved(level, list(range(1000, 1040)))
    assert success.all(), f"seeds {1000 + np.flatnonzero(~success)}"
    assert np.median(lengths) < 60


def test_the_expert_pushes_aside_what_shuts_it_in() -> None:
    """Between bed, wall and a toy, with the target in the hand."""
    assert solved("put/put_on_bed_tray_all", [500165])[0].all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{"object_order": "alternate"}, {"reach": 1.5}, {"reach": 3.0}, {"looks": "varied"}]
)
@pytest.mark.parametrize("level", ["lift/lift_shape_uniform", "put/put_near_bed_tray_frequent"])
def test_the_expert_solves_other_worlds(level: str, options: dict[str, Any]) -> None:
    success, _ = solved(level, list(range(2000, 2020)), **options)
    assert success.all()
