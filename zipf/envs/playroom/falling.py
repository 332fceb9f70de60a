"""After the physics on the floor plane, objects that are not held fall, stand up and rest."""

import math

from zipf.compiled import compiled
from zipf.envs.playroom.constants import FRAME, FRAMES, FURNITURE_SIZE, LANDING
from zipf.envs.playroom.geometry import rectangle_gap, set_rows, upright
from zipf.envs.playroom.state import AIR, ANGLE, BASE, FLOOR, HELD, ON_BED, VZ, X, Y, Z

# Ours, except for gravity.
GRAVITY = 9.8
LIFT_HEIGHT = 0.15
"""An object is lifted from this far above where it was gripped, metres."""
STILL_STEPS = 2  # an object is at rest after so many actions without motion, 0.27 s
STILL_MOTION = 0.01  # an object that moves less than this counts as motionless, metres per action


@compiled(references=False)
def fall(envs, i, before):
    """Updates heights, orientations and the status of the objects of env `i`, whose x, y `before`
    the physics of this step are float64 [C, 2]."""
    status, still = envs.status[i], envs.still[i]
    for j in range(status.size):
        item = envs.objects[i, j]
        if status[j] == HELD:
            still[j] = 0
            envs.lifted[i, j] |= item[Z] - envs.agents[i, BASE] >= LIFT_HEIGHT
            continue
        motion = math.hypot(item[X] - before[j, 0], item[Y] - before[j, 1])
        status[j] = _fall(item, before[j], envs.furnished, envs.furniture[i])
        rests = status[j] != AIR and motion < STILL_MOTION
        still[j] = min(still[j] + 1, STILL_STEPS) if rests else 0
        _stand_up(envs.orientation[i, j], item[ANGLE])


@compiled(references=False)
def _fall(item, before, furnished, furniture):
    """Lets an object that is not held fall for one step; returns its status."""
    where, began = FLOOR, item[Z]
    for k in range(1, FRAMES + 1):
        share = k / FRAMES
        x = before[0] + (item[X] - before[0]) * share
        y = before[1] + (item[Y] - before[1]) * share
        top, where = 0.0, FLOOR
        if furnished:
            for f in range(2):
                height = FURNITURE_SIZE[f, 2]
                # By the height at which the step began, as in `hand._layer`: the physics lets an
                # object through the sides of the supports that were below it, and of no others.
                if (
                    began >= height - LANDING
                    and rectangle_gap(furniture[f], FURNITURE_SIZE[f], x, y) == 0.0
                ):
                    top, where = height, ON_BED + f
        if item[Z] > top:
            item[VZ] -= GRAVITY * FRAME
            item[Z] += item[VZ] * FRAME
        if item[Z] <= top:
            item[Z], item[VZ] = top, 0.0
        else:
            where = AIR
    return where


@compiled(references=False)
def _stand_up(frame, angle):
    """Turns an object that is not held towards the upright rotation by `angle`, for one step."""
    rows = upright(angle)
    # The weights below do not cancel out even for an object that is upside down.
    off = 0.0
    for r in range(3):
        for c in range(3):
            off = max(off, abs(frame[r, c] - rows[r][c]))
    if off < 0.01:
        set_rows(frame, rows)
        return
    for c in (2, 0):
        for r in range(3):
            frame[r, c] = 0.4 * frame[r, c] + 0.6 * rows[r][c]
    _normalise(frame, 2)
    dot = frame[0, 0] * frame[0, 2] + frame[1, 0] * frame[1, 2] + frame[2, 0] * frame[2, 2]
    for r in range(3):
        frame[r, 0] -= dot * frame[r, 2]
    _normalise(frame, 0)
    frame[0, 1] = frame[1, 2] * frame[2, 0] - frame[2, 2] * frame[1, 0]
    frame[1, 1] = frame[2, 2] * frame[0, 0] - frame[0, 2] * frame[2, 0]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[1, 2] * frame[0, 0]


@compiled(references=False)
def _normalise(frame, c):
    norm = math.sqrt(frame[0, c] ** 2 + frame[1, c] ** 2 + frame[2, c] ** 2)
    for r in range(3):
        frame[r, c] /= norm
