"""The two action tables of the published agents.

An action is held for all frames of a step. Sources: scalable_agent, `environments.py` (nine
actions); sample-factory, `dmlab_env.py` (fifteen, after later DeepMind papers).
"""

from typing import NamedTuple

import numpy as np

DEGREES_PER_PIXEL = 0.11 * 0.06 * 16
"""Degrees of turning in a frame (DeepMind Lab: sensitivity, scale, milliseconds of a frame)."""


class Action(NamedTuple):
    """What an agent does in every frame of a step."""

    name: str
    look_right: int = 0
    """Pixels per frame; see `DEGREES_PER_PIXEL`."""
    look_down: int = 0
    strafe: int = 0
    """1 right, -1 left."""
    forward: int = 0
    fire: int = 0


EXTENDED = (
    Action("forward", forward=1),
    Action("backward", forward=-1),
    Action("strafe left", strafe=-1),
    Action("strafe right", strafe=1),
    Action("look slightly left", look_right=-10),
    Action("look slightly right", look_right=10),
    Action("look left", look_right=-60),
    Action("look right", look_right=60),
    Action("look down", look_down=10),
    Action("look up", look_down=-10),
    Action("forward and slightly left", look_right=-10, forward=1),
    Action("forward and slightly right", look_right=10, forward=1),
    Action("forward and left", look_right=-60, forward=1),
    Action("forward and right", look_right=60, forward=1),
    Action("fire", fire=1),
)

IMPALA = (
    Action("forward", forward=1),
    Action("backward", forward=-1),
    Action("strafe left", strafe=-1),
    Action("strafe right", strafe=1),
    Action("look left", look_right=-20),
    Action("look right", look_right=20),
    Action("forward and left", look_right=-20, forward=1),
    Action("forward and right", look_right=20, forward=1),
    Action("fire", fire=1),
)

TABLES = {15: EXTENDED, 9: IMPALA}  # the action tables by their number of actions


def commands(num_actions: int) -> np.ndarray:
    """The table as numbers, float64 [actions, 5]: turn to the left and upwards in a frame
    (radians), strafe to the right, forward, fire."""
    degrees = np.radians(DEGREES_PER_PIXEL)
    return np.array(
        [
            (-a.look_right * degrees, -a.look_down * degrees, a.strafe, a.forward, a.fire)
            for a in TABLES[num_actions]
        ]
    )
