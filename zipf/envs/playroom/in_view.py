"""What can be seen in the image: which toys and supports are in view and not hidden."""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.playroom.constants import EYE, FURNITURE_SIZE
from zipf.envs.playroom.geometry import half_width, set_upright
from zipf.envs.playroom.hand import distance_along
from zipf.envs.playroom.state import AX, AY, PITCH, YAW, X, Y, Z, one_env

# Ours. A thing is in view where this share of the points of a grid within it are.
_SHARE = 0.25
_INNER = 0.7
"""The grid's share of the bounding box, which a toy does not fill."""


@compiled()
def look(envs, wide, high, items, supports):
    """Says what is in view of the agents. A bounding box hides what is behind it.

    Args:
        wide, high: tangents of half the horizontal and half the vertical field of view.
        items: bool [N, C], the objects in view, written.
        supports: bool [N, 2], bed and tray, written; False without furniture.
    """
    for i in range(len(items)):
        env, agent = one_env(envs, i), envs.agents[i]
        count = items.shape[1]
        centres, halves = np.empty((count + 2, 3)), np.empty((count + 2, 3))
        frames = np.empty((count + 2, 3, 3))
        boxes = count + 2 if env.furnished else count
        for j in range(count):
            extent, frame = env.extents[env.ranks[j]], env.orientation[j]
            frames[j] = frame
            for c in range(3):
                halves[j, c] = extent[c] / 2
            centres[j, 0], centres[j, 1] = env.objects[j, X], env.objects[j, Y]
            centres[j, 2] = env.objects[j, Z] + half_width(frame, extent, 0.0, 0.0, 1.0)
        for k in range(boxes - count):
            set_upright(frames[count + k], env.furniture[k, 2])
            for c in range(3):
                halves[count + k, c] = FURNITURE_SIZE[k, c]
            halves[count + k, 2] /= 2
            centres[count + k, 0], centres[count + k, 1] = (
                env.furniture[k, 0],
                env.furniture[k, 1],
            )
            centres[count + k, 2] = halves[count + k, 2]
        for j in range(count):
            items[i, j] = _is_seen(j, agent, wide, high, centres[:boxes], frames, halves)
        supports[i] = False
        for k in range(boxes - count):
            supports[i, k] = _is_seen(count + k, agent, wide, high, centres[:boxes], frames, halves)


@compiled()
def _is_seen(box, agent, wide, high, centres, frames, halves):
    """Whether enough of a box is in the image and not behind another box."""
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    level, up = math.cos(agent[PITCH]), math.sin(agent[PITCH])
    ray = np.empty(3)
    seen = 0
    for cell in range(27):
        steps = (cell % 3 - 1, cell // 3 % 3 - 1, cell // 9 - 1)
        for c in range(3):
            ray[c] = centres[box, c]
            for axis in range(3):
                ray[c] += frames[box, c, axis] * steps[axis] * _INNER * halves[box, axis]
        ray[0] -= agent[AX]
        ray[1] -= agent[AY]
        ray[2] -= EYE
        ahead = cos * ray[0] + sin * ray[1]
        depth = level * ahead + up * ray[2]
        aside, above = sin * ray[0] - cos * ray[1], level * ray[2] - up * ahead
        if depth <= 0.0 or abs(aside) > wide * depth or abs(above) > high * depth:
            continue
        distance = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        for c in range(3):
            ray[c] /= distance
        hidden = False
        for other in range(len(centres)):
            if other != box and not hidden:
                entry = distance_along(ray, agent, centres[other], frames[other], halves[other])
                hidden = entry < distance
        seen += not hidden
    return seen >= _SHARE * 27
