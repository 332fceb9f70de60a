"""Where a held object can be: in view, and outside of the agent, the walls and the bed.

It is held in the direction of the view. Where walls or the bed leave no room at the full distance
it comes closer, down to the body or to the edge of the view; from there it pushes the agent back.
One that lies before the agent's feet keeps the view from turning further down.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.playroom.constants import AGENT_RADIUS, CEILING, EYE, FURNITURE_SIZE, ROOM
from zipf.envs.playroom.geometry import half_width, rectangle_gap
from zipf.envs.playroom.state import AX, AY, HOLD, PITCH, YAW, X, Y, Z

# Ours.
CLEARANCE = 0.05  # between the body and a held object, metres
SLACK = math.radians(20)
"""How far below the middle of the view a wall may push the middle of a held object. The view
reaches 30 degrees up and down."""
STEEP = math.radians(25)
"""How far above the middle of the view floor or bed may push the middle of a held object."""
CLIMB = 0.1
"""A held object is put on a top when its lowest point is no more than this below it, metres."""

_STEEPEST = math.radians(80)
_ROUNDS = 8
_EXACT = 1e-6


@compiled()
def find_room(agent, env, held, spot):
    """Finds where an object can be held, and pushes the agent back where there is too little room.
    Returns whether there is room. If not, the agent's place is as it was.

    Args:
        agent: a row of `Envs.agents`; its place and its pitch may be changed.
        env: `Env`, read.
        held: the object.
        spot: float64 [3], written where there is room: the least and greatest distance of the
            object's middle from the agent's on the floor plane, and the height of its lowest
            point, metres.
    """
    item = env.objects[held]
    floor = floor_of_hand(env.furnished, env.furniture, item)
    if _find_room(agent, env, held, floor, spot):
        return True
    # Where there is no room beside the bed, an object as high as the bed stays as high.
    top = FURNITURE_SIZE[0, 2]
    high = env.furnished and item[Z] >= top - CLIMB
    return high and _find_room(agent, env, held, top, spot)


@compiled()
def _find_room(agent, env, held, floor, spot):
    """As `find_room`, with the object no lower than `floor`."""
    frame, extent = env.orientation[held], env.extents[env.ranks[held]]
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    high = half_width(frame, extent, 0.0, 0.0, 1.0)
    body = AGENT_RADIUS + CLEARANCE + half_width(frame, extent, cos, sin, 0.0)
    slope = math.tan(agent[PITCH])
    far = max(math.cos(agent[PITCH]) * agent[HOLD], body)
    height = EYE + slope * far
    if height < floor + high or height > CEILING - high:
        height = min(max(height, floor + high), CEILING - high)
        far = max((height - EYE) / slope, body)
    steepest = min(abs(agent[PITCH]) + SLACK, _STEEPEST)
    near = max(body, abs(height - EYE) / math.tan(steepest))
    low = env.furnished and height - high < FURNITURE_SIZE[0, 2] - CLIMB
    x, y = agent[AX], agent[AY]
    reach = np.empty(2)
    for _ in range(_ROUNDS):
        reach[0], reach[1] = near, far
        # Summed up: pushes that undo each other leave the agent in place, but make no room.
        pushed = _clear_walls(agent, frame, extent, cos, sin, reach)
        if low:
            pushed += _clear_bed(agent, env, held, cos, sin, reach)
        if agent[AX] != x or agent[AY] != y:
            pushed += _keep_body_out(agent, env)
        if pushed < _EXACT:
            spot[0], spot[1], spot[2] = reach[0], reach[1], height - high
            keep_in_view(agent, height, far)
            return True
    agent[AX], agent[AY] = x, y
    return False


@compiled()
def keep_in_view(agent, height, distance):
    """Keeps the view of an agent, whose pitch may be changed, from pointing too far below a held
    object whose middle is at this height and distance, metres."""
    agent[PITCH] = max(agent[PITCH], math.atan2(height - EYE, distance) - STEEP)


@compiled()
def _clear_walls(agent, frame, extent, cos, sin, reach):
    """Shortens the greatest distance to the walls, and pushes the agent back if it is too short;
    returns how far."""
    pushed = 0.0
    for axis in range(2):
        along = cos if axis == 0 else sin
        limit = ROOM / 2 - half_width(frame, extent, 1.0 - axis, float(axis), 0.0)
        nearest = agent[AX + axis] + along * reach[0]
        push = min(max(nearest, -limit), limit) - nearest
        agent[AX + axis] += push
        pushed += abs(push)
        if along != 0:
            wall = (math.copysign(limit, along) - agent[AX + axis]) / along
            reach[1] = min(reach[1], max(wall, reach[0]))
    return pushed


@compiled()
def _clear_bed(agent, env, held, cos, sin, reach):
    """Keeps the distances on the side of the bed where the object is, or pushes the agent back;
    returns how far."""
    bed, item, frame = env.furniture[0], env.objects[held], env.orientation[held]
    extent = env.extents[env.ranks[held]]
    c, s = math.cos(bed[2]), math.sin(bed[2])
    # The bed with a margin of half the object's size, in the bed's own directions.
    half_x = FURNITURE_SIZE[0, 0] + half_width(frame, extent, c, s, 0.0)
    half_y = FURNITURE_SIZE[0, 1] + half_width(frame, extent, -s, c, 0.0)
    x = c * (agent[AX] - bed[0]) + s * (agent[AY] - bed[1])
    y = c * (agent[AY] - bed[1]) - s * (agent[AX] - bed[0])
    along_x, along_y = c * cos + s * sin, c * sin - s * cos
    enter, leave = _crossing(x, along_x, half_x)
    enter_y, leave_y = _crossing(y, along_y, half_y)
    enter, leave = max(enter, enter_y), min(leave, leave_y)
    if enter >= leave - _EXACT or leave <= reach[0] + _EXACT or enter >= reach[1]:
        return 0.0
    now = (item[X] - agent[AX]) * cos + (item[Y] - agent[AY]) * sin
    if leave <= reach[1] and (now > (enter + leave) / 2):
        reach[0] = leave
    elif enter >= reach[0] - _EXACT:
        reach[1] = max(enter, reach[0])
    else:
        near_x, near_y = x + along_x * reach[0], y + along_y * reach[0]
        push_x, push_y = math.copysign(half_x, x) - near_x, math.copysign(half_y, y) - near_y
        # To where the agent stands, the shorter way.
        if abs(push_x) < abs(push_y):
            push_y = 0.0
        else:
            push_x = 0.0
        agent[AX] += c * push_x - s * push_y
        agent[AY] += s * push_x + c * push_y
        reach[1] = reach[0]
        return math.hypot(push_x, push_y)
    return 0.0


@compiled()
def _crossing(start, along, half):
    """Where start + t * along enters -half .. half and leaves it."""
    if abs(along) < 1e-9:
        return (-math.inf, math.inf) if abs(start) < half else (math.inf, -math.inf)
    one, two = (-half - start) / along, (half - start) / along
    return min(one, two), max(one, two)


@compiled()
def _keep_body_out(agent, env):
    """Moves the agent out of the walls and the bed; returns how far."""
    limit, pushed = ROOM / 2 - AGENT_RADIUS, 0.0
    for axis in range(2):
        inside = min(max(agent[AX + axis], -limit), limit)
        pushed += abs(inside - agent[AX + axis])
        agent[AX + axis] = inside
    if not env.furnished:
        return pushed
    bed = env.furniture[0]
    gap = rectangle_gap(bed, FURNITURE_SIZE[0], agent[AX], agent[AY])
    if gap >= AGENT_RADIUS:
        return pushed
    c, s = math.cos(bed[2]), math.sin(bed[2])
    x = c * (agent[AX] - bed[0]) + s * (agent[AY] - bed[1])
    y = c * (agent[AY] - bed[1]) - s * (agent[AX] - bed[0])
    out_x = x - min(max(x, -FURNITURE_SIZE[0, 0]), FURNITURE_SIZE[0, 0])
    out_y = y - min(max(y, -FURNITURE_SIZE[0, 1]), FURNITURE_SIZE[0, 1])
    if gap == 0:
        out_x, gap = math.copysign(1e-3, x), 1e-3
    push_x, push_y = (out_x / gap * (AGENT_RADIUS - gap), out_y / gap * (AGENT_RADIUS - gap))
    agent[AX] += c * push_x - s * push_y
    agent[AY] += s * push_x + c * push_y
    return pushed + math.hypot(push_x, push_y)


@compiled()
def floor_of_hand(furnished, furniture, item):
    """The lowest height at which an object may be held where it is now."""
    floor = 0.0
    if furnished:
        for k in range(2):
            over = rectangle_gap(furniture[k], FURNITURE_SIZE[k], item[X], item[Y]) == 0.0
            if over and item[Z] >= FURNITURE_SIZE[k, 2] - CLIMB:
                floor = FURNITURE_SIZE[k, 2]
    return floor
