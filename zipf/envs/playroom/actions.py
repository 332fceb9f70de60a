"""The 46 actions.

Names, order and magnitudes are those of the playrooms at DeepMind (Carvalho et al. 2021, "Feature-
attending recurrent modules", table 7; magnitudes from public code for "Fast and slow learning",
Hill et al. 2020). Published sources disagree on the signs; ours are tested by rendering.
"""

import numpy as np

CONTROLS = (
    "move",  # 1 forward, -1 backward
    "strafe",  # 1 to the right
    "turn",  # 1 to the right
    "look",  # 1 upwards
    "spin_right",  # of the held object, about the vertical: its front turns to the right
    "spin_up",  # about the view's rightward axis: its front turns up
    "spin_forward",  # about the view's forward axis: its top tips to the right
    "push",  # 1 pushes the held object away, -1 pulls it closer
    "grip",  # 1 grips
)
"""The columns of `CONTROL_TABLE`, with values of -1 .. 1."""

_MOVES: list[tuple[str, dict[str, float]]] = [
    ("MOVE_FORWARD_FULL", {"move": 1.0}),
    ("MOVE_BACKWARD_FULL", {"move": -1.0}),
    ("MOVE_RIGHT_FULL", {"strafe": 1.0}),
    ("MOVE_LEFT_FULL", {"strafe": -1.0}),
    ("LOOK_RIGHT_FULL", {"turn": 1.0}),
    ("LOOK_LEFT_FULL", {"turn": -1.0}),
    ("LOOK_DOWN_FULL", {"look": -1.0}),
    ("LOOK_UP_FULL", {"look": 1.0}),
    ("MOVE_RIGHT_SLIGHTLY", {"strafe": 0.05}),
    ("MOVE_LEFT_SLIGHTLY", {"strafe": -0.05}),
    ("LOOK_DOWN_MID", {"look": -0.03}),
    ("LOOK_UP_MID", {"look": 0.03}),
    ("LOOK_RIGHT_MID", {"turn": 0.2}),
    ("LOOK_LEFT_MID", {"turn": -0.2}),
    ("LOOK_RIGHT_SLIGHTLY", {"turn": 0.05}),
    ("LOOK_LEFT_SLIGHTLY", {"turn": -0.05}),
]

_GRIPPED: list[tuple[str, dict[str, float]]] = [
    ("SPIN_RIGHT", {"spin_right": 1.0}),
    ("SPIN_LEFT", {"spin_right": -1.0}),
    ("SPIN_UP", {"spin_up": 1.0}),
    ("SPIN_DOWN", {"spin_up": -1.0}),
    ("SPIN_FORWARD", {"spin_forward": 1.0}),
    ("SPIN_BACKWARD", {"spin_forward": -1.0}),
    ("PULL_CLOSER_FULL", {"push": -1.0}),
    ("PUSH_AWAY_FULL", {"push": 1.0}),
    ("PULL_CLOSER_MID", {"push": -0.5}),
    ("PUSH_AWAY_MID", {"push": 0.5}),
]

_ACTIONS: list[tuple[str, dict[str, float]]] = [
    ("NOOP", {}),
    *_MOVES,
    ("GRAB", {"grip": 1.0}),
    *((f"GRAB_AND_{name}", {**controls, "grip": 1.0}) for name, controls in _MOVES + _GRIPPED),
    ("PULL_CLOSER_MID", {"push": -0.5}),
    ("PUSH_AWAY_MID", {"push": 0.5}),
]

ACTIONS = tuple(name for name, _ in _ACTIONS)  # the names of the actions in their order

NOOP, FORWARD, BACKWARD, RIGHT, LEFT, TURN_RIGHT, TURN_LEFT, LOOK_DOWN, LOOK_UP = range(9)
TURN_RIGHT_MID, TURN_LEFT_MID, TURN_RIGHT_SLIGHTLY, TURN_LEFT_SLIGHTLY = range(13, 17)
LOOK_DOWN_MID, LOOK_UP_MID = 11, 12
GRAB = 17
"""`GRAB + a` is the movement `a` (1 .. 16) with the hand closed."""
PULL, PUSH = 40, 41

CONTROL_TABLE = np.array(
    [[controls.get(control, 0.0) for control in CONTROLS] for _, controls in _ACTIONS]
)
"""float64 [46, 9]."""
