"""Where the player looks on a screen, compiled."""

import math

from zipf.compiled import compiled
from zipf.envs.labyrinth.mover import EYE
from zipf.envs.labyrinth.state import PITCH, YAW, X, Y, Z

NOWHERE = -1.0  # both coordinates of a gaze that does not meet the plane of the screen
_GRAZING = 0.01


@compiled(error_model="numpy")
def gaze(envs, i):
    """x and y of the point of the screen's plane that the player of env `i` looks at, as shares
    of the screen's side from its top left corner; NOWHERE if the player looks away from it."""
    body = envs.bodies[i]
    x, y, z, side = envs.screen[i]
    north = math.sin(body[YAW])
    ahead = y - body[Y]
    if north < _GRAZING or ahead <= 0.0:
        return NOWHERE, NOWHERE
    away = ahead / north
    at_x = body[X] + away * math.cos(body[YAW])
    at_z = body[Z] + EYE + away * math.tan(body[PITCH])
    return 0.5 + (at_x - x) / side, 0.5 - (at_z - z) / side


@compiled(error_model="numpy")
def widget_at(envs, i, x, y):
    """The first widget at a point of the screen, or -1."""
    for k in range(envs.widgets.shape[1]):
        left, top, right, bottom = envs.widgets[i, k]
        if left <= x < right and top <= y < bottom:
            return k
    return -1
