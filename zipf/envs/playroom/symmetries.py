"""The playroom's symmetry: left and right exchanged."""

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zipf.envs.playroom.actions import CONTROL_TABLE, CONTROLS

_SIDEWAYS = ("strafe", "turn", "spin_right", "spin_forward")


class Symmetries:
    """Shows rooms or questions about their first frame in a mirror. Instructions name no sides."""

    count = 2

    def __init__(self, observations: gym.spaces.Dict, actions: gym.spaces.Discrete):
        mirrored = np.array([1, 0]) if actions.n == 2 else _mirrored_actions()
        self.actions: NDArray[np.int64] = np.array([np.arange(actions.n), mirrored])

    def __call__(
        self, observation: dict[str, NDArray], which: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> None:
        """Changes the observations `{name: [N, ...]}`, in place, where `mask` [N]."""
        image = observation["image"]
        pixels = image.view(f"V{image.shape[-1]}")[..., 0]  # the bytes of a pixel as one element
        rows = np.flatnonzero(mask & (which == 1))
        pixels[rows] = pixels[rows, :, ::-1]


def _mirrored_actions() -> NDArray[np.int64]:
    signs = np.array([-1.0 if control in _SIDEWAYS else 1.0 for control in CONTROLS])
    mirrored = CONTROL_TABLE * signs
    return (mirrored[:, None] == CONTROL_TABLE).all(-1).argmax(1)
