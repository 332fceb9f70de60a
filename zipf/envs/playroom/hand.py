"""Before the physics, an action turns the view, pushes the agent and moves the hand.

The hand grips the object that the middle of the view points at and holds it at a fixed distance
from the eye, in the direction of the view. Where a held object is on the floor plane is left to
the physics, which is told a velocity; its height and its orientation are set here.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.playroom.actions import CONTROL_TABLE
from zipf.envs.playroom.constants import (
    AGENT_MASS,
    AGENT_RADIUS,
    CEILING,
    DAMPING,
    EYE,
    FRAME,
    FRAMES,
    FURNITURE_SIZE,
    LANDING,
    ROOM,
    STEP,
)
from zipf.envs.playroom.geometry import footprint, rectangle_gap, set_upright
from zipf.envs.playroom.state import (
    AIR,
    ANGLE,
    AX,
    AY,
    BASE,
    CARRIED_LAYER,
    FLOOR,
    GROUND_LAYER,
    HELD,
    HOLD,
    LOW_LAYER,
    ON_BED,
    ON_TRAY,
    PITCH,
    RAISED_LAYER,
    SUPPORTED_LAYER,
    VZ,
    YAW,
    X,
    Y,
    Z,
    one_world,
)

# Ours.
ACCELERATION = 12.5
"""Of the agent, m/s^2: with the damping, 2.7 m/s at most."""
TURN_RATE = math.radians(120)
LOOK_RATE = math.radians(90)
LOWEST, HIGHEST = math.radians(-75), math.radians(60)
"""Limits of the pitch."""
REACH = 2.0
"""From the eye, metres."""
NEAREST_HOLD = 0.45
AIM_MARGIN = 0.03
"""How far beside an object's bounding box the hand may point, metres."""
PUSH_RATE = 1.0
SPIN_RATE = math.radians(180)
HAND_SPEED = 5.0
CLIMB = 0.1
"""A held object is put on a top when its lowest point is no more than this below it, metres."""

# How far a body coasts in one action, divided by its speed at the beginning: positions are
# advanced before the damping.
_COAST = FRAME * sum(math.exp(-DAMPING * FRAME * k) for k in range(FRAMES))


@compiled()
def control(mask, actions, worlds, commands):
    """Applies the actions of the worlds of `mask`, and tells the physics what to do.

    Args:
        mask: bool [N].
        actions: int64 [N].
        worlds: read and written.
        commands: written.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        act = CONTROL_TABLE[actions[i]]
        agent, objects, orientation = worlds.agents[i], worlds.objects[i], worlds.orientation[i]
        status = worlds.status[i]
        agent[YAW] -= act[2] * TURN_RATE * STEP
        agent[YAW] -= 2 * math.pi * math.floor((agent[YAW] + math.pi) / (2 * math.pi))
        agent[PITCH] = min(max(agent[PITCH] + act[3] * LOOK_RATE * STEP, LOWEST), HIGHEST)
        cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
        push = AGENT_MASS * ACCELERATION
        commands.forces[i, 0] = push * (act[0] * cos + act[1] * sin)
        commands.forces[i, 1] = push * (act[0] * sin - act[1] * cos)
        commands.turned[i] = -1
        held = worlds.hands[i]
        if act[8] > 0 and held < 0:
            held = pick(agent, one_world(worlds, i))
            if held >= 0:
                worlds.hands[i] = held
                status[held] = HELD
                agent[BASE] = objects[held, Z]
        elif act[8] == 0 and held >= 0:
            worlds.hands[i] = -1
            status[held] = AIR
            objects[held, VZ] = 0.0
            floor = _floor_of_hand(worlds.furnished, worlds.furniture[i], objects[held])
            objects[held, Z] = max(objects[held, Z], floor)
            _set_angle(objects[held], orientation[held])
            commands.turned[i] = held
            held = -1
        if held >= 0:
            if act[7] != 0:
                agent[HOLD] += act[7] * PUSH_RATE * STEP
                agent[HOLD] = min(max(agent[HOLD], NEAREST_HOLD), REACH)
            _spin(orientation[held], agent, act)
            _carry(worlds, i, held, commands.drives[i])
        for j in range(status.size):
            commands.layers[i, j] = _layer(status[j], objects[j, Z])


@compiled()
def _layer(status, height):
    """What an object collides with, by where it is and its height."""
    if status == FLOOR:
        return GROUND_LAYER
    if status in (ON_BED, ON_TRAY):
        return SUPPORTED_LAYER
    if status == HELD and height < 0.1:
        return CARRIED_LAYER
    if height < FURNITURE_SIZE[0, 2] - (CLIMB if status == HELD else LANDING):
        return LOW_LAYER
    return RAISED_LAYER


@compiled()
def pick(agent, world):
    """The object that an agent could grip, or -1.

    Args:
        agent: a row of `Worlds.agents` or a pose that is tried out, float64 [6]; HOLD is written.
        world: `World`, read.
    """
    ranks, furniture = world.ranks, world.furniture
    objects, orientation = world.objects, world.orientation
    direction = np.empty(3)
    direction[0] = math.cos(agent[PITCH]) * math.cos(agent[YAW])
    direction[1] = math.cos(agent[PITCH]) * math.sin(agent[YAW])
    direction[2] = math.sin(agent[PITCH])
    picked, nearest = -1, REACH
    centre = np.empty(3)
    half = np.empty(3)
    frame = np.empty((3, 3))
    if world.furnished:
        for k in range(2):
            half[0], half[1] = FURNITURE_SIZE[k, 0], FURNITURE_SIZE[k, 1]
            half[2] = FURNITURE_SIZE[k, 2] / 2
            centre[0], centre[1], centre[2] = furniture[k, 0], furniture[k, 1], half[2]
            set_upright(frame, furniture[k, 2])
            nearest = min(nearest, _distance_along(direction, agent, centre, frame, half))
    for j in range(ranks.size):
        extent = world.extents[ranks[j]]
        for c in range(3):
            half[c] = extent[c] / 2 + AIM_MARGIN
        centre[0], centre[1] = objects[j, X], objects[j, Y]
        centre[2] = objects[j, Z] + extent[2] / 2
        distance = _distance_along(direction, agent, centre, orientation[j], half)
        if distance < nearest:
            picked, nearest = j, distance
            along = (
                (centre[0] - agent[AX]) * direction[0]
                + (centre[1] - agent[AY]) * direction[1]
                + (centre[2] - EYE) * direction[2]
            )
            agent[HOLD] = min(max(along, NEAREST_HOLD), REACH)
    return picked


@compiled()
def _distance_along(direction, agent, centre, frame, half):
    """The distance at which a ray from the eye enters an oriented box; infinity if it misses."""
    near, far = 0.0, math.inf
    for axis in range(3):
        offset = (
            frame[0, axis] * (centre[0] - agent[AX])
            + frame[1, axis] * (centre[1] - agent[AY])
            + frame[2, axis] * (centre[2] - EYE)
        )
        slope = (
            frame[0, axis] * direction[0]
            + frame[1, axis] * direction[1]
            + frame[2, axis] * direction[2]
        )
        if abs(slope) < 1e-9:
            if abs(offset) > half[axis]:
                return math.inf
            continue
        one, two = (offset - half[axis]) / slope, (offset + half[axis]) / slope
        near, far = max(near, min(one, two)), min(far, max(one, two))
    return near if near <= far else math.inf


@compiled()
def _set_angle(item, frame):
    """Sets a released object's angle on the floor to that of its front, unless that is vertical."""
    if math.hypot(frame[0, 0], frame[1, 0]) > 0.1:
        item[ANGLE] = math.atan2(frame[1, 0], frame[0, 0])


@compiled()
def _spin(frame, agent, act):
    """Rotates a held object about the vertical and about the view's right and forward axes."""
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    if act[4] != 0:
        _rotate(frame, 0.0, 0.0, 1.0, -act[4] * SPIN_RATE * STEP)
    if act[5] != 0:
        _rotate(frame, sin, -cos, 0.0, act[5] * SPIN_RATE * STEP)
    if act[6] != 0:
        _rotate(frame, cos, sin, 0.0, act[6] * SPIN_RATE * STEP)


@compiled()
def _rotate(frame, x, y, z, angle):
    """Rotates `frame` about a unit axis in the room's coordinates, by Rodrigues' formula."""
    cos, sin = math.cos(angle), math.sin(angle)
    for column in range(3):
        a, b, c = frame[0, column], frame[1, column], frame[2, column]
        dot = (x * a + y * b + z * c) * (1 - cos)
        frame[0, column] = a * cos + (y * c - z * b) * sin + x * dot
        frame[1, column] = b * cos + (z * a - x * c) * sin + y * dot
        frame[2, column] = c * cos + (x * b - y * a) * sin + z * dot


@compiled()
def _carry(worlds, i, held, drive):
    """Moves a held object to the hand: its height at once, its position by a velocity, `drive`."""
    agent, item = worlds.agents[i], worlds.objects[i, held]
    extent, furniture = worlds.extents[worlds.ranks[i, held]], worlds.furniture[i]
    radius = footprint(extent)
    flat = max(math.cos(agent[PITCH]) * agent[HOLD], AGENT_RADIUS + radius + 0.05)
    limit = ROOM / 2 - radius
    x = min(max(agent[AX] + flat * math.cos(agent[YAW]), -limit), limit)
    y = min(max(agent[AY] + flat * math.sin(agent[YAW]), -limit), limit)
    if worlds.furnished and item[Z] < FURNITURE_SIZE[0, 2] - CLIMB:
        x, y = _beside(furniture[0], FURNITURE_SIZE[0], 0.5 * min(extent[0], extent[1]), item, x, y)
    dx, dy = x - item[X], y - item[Y]
    distance = math.hypot(dx, dy)
    share = min(1.0, HAND_SPEED * STEP / distance) if distance > 0 else 0.0
    drive[0], drive[1] = dx * share / _COAST, dy * share / _COAST
    height = EYE + math.sin(agent[PITCH]) * agent[HOLD] - extent[2] / 2
    floor = _floor_of_hand(worlds.furnished, furniture, item)
    height = min(max(height, floor), CEILING - extent[2])
    step = HAND_SPEED * STEP
    item[Z] += min(max(height - item[Z], -step), step)


@compiled()
def _floor_of_hand(furnished, furniture, item):
    """The lowest height at which an object may be held where it is now."""
    floor = 0.0
    if furnished:
        for k in range(2):
            over = rectangle_gap(furniture[k], FURNITURE_SIZE[k], item[X], item[Y]) == 0.0
            if over and item[Z] >= FURNITURE_SIZE[k, 2] - CLIMB:
                floor = FURNITURE_SIZE[k, 2]
    return floor


@compiled()
def _beside(pose, size, radius, item, x, y):
    """The point nearest to (x, y) on the side of a rectangle that an object is on now.

    The physics alone would let the object through: a body whose velocity is set moves before its
    collisions are resolved.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    own_x = cos * (item[X] - pose[0]) + sin * (item[Y] - pose[1])
    own_y = cos * (item[Y] - pose[1]) - sin * (item[X] - pose[0])
    to_x = cos * (x - pose[0]) + sin * (y - pose[1])
    to_y = cos * (y - pose[1]) - sin * (x - pose[0])
    least_x, least_y = size[0] + radius, size[1] + radius
    if abs(own_x) - least_x > abs(own_y) - least_y:
        to_x = max(to_x, least_x) if own_x > 0 else min(to_x, -least_x)
    else:
        to_y = max(to_y, least_y) if own_y > 0 else min(to_y, -least_y)
    return pose[0] + cos * to_x - sin * to_y, pose[1] + sin * to_x + cos * to_y
