"""Before the physics, an action turns the view, pushes the agent and moves the hand.

The hand grips the object that the middle of the view points at and holds it at a fixed distance
from the eye, in the direction of the view, or closer where there is no room. The physics takes it
there on the floor plane, so that it pushes other objects; its height and its orientation are set
here. A turn of the view or the object for which there is no room is not made.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.playroom.actions import CONTROL_TABLE
from zipf.envs.playroom.constants import (
    AGENT_MASS,
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
from zipf.envs.playroom.geometry import half_width, set_upright
from zipf.envs.playroom.holding import find_room, floor_of_hand, keep_in_view
from zipf.envs.playroom.state import (
    AIR,
    ANGLE,
    AX,
    AY,
    BASE,
    BED_LAYER,
    CARRIED_LAYER,
    FLOOR,
    GROUND_LAYER,
    HELD,
    HELD_LAYER,
    HOLD,
    LOW_LAYER,
    ON_BED,
    ON_TRAY,
    PITCH,
    RAISED_LAYER,
    TRAY_LAYER,
    VZ,
    YAW,
    X,
    Y,
    Z,
    one_env,
)

# Ours.
ACCELERATION = 12.5  # the agent's acceleration, m/s^2: with the damping it moves at 2.7 m/s at most
TURN_RATE = math.radians(120)
LOOK_RATE = math.radians(90)
LOWEST, HIGHEST = math.radians(-75), math.radians(60)
"""Limits of the pitch."""
NEAREST_HOLD = 0.45
AIM_MARGIN = 0.03
"""How far beside an object's bounding box the hand may point, metres."""
PUSH_RATE = 1.0
SPIN_RATE = math.radians(180)
HAND_SPEED = 5.0
"""Speed at which a held object moves back to its distance, m/s."""

# How far a body coasts in one action, divided by its speed at the beginning: positions are
# advanced before the damping.
_COAST = FRAME * sum(math.exp(-DAMPING * FRAME * k) for k in range(FRAMES))


@compiled()
def control(mask, actions, envs, commands):
    """Applies the actions int64 [N] of the envs of `mask`, and tells the physics what to do."""
    pose, turned = np.empty(6), np.empty((3, 3))
    for i in range(mask.size):
        if not mask[i]:
            continue
        act = CONTROL_TABLE[actions[i]]
        agent, objects, orientation = envs.agents[i], envs.objects[i], envs.orientation[i]
        status, spot = envs.status[i], envs.spots[i]
        pose[:] = agent
        agent[YAW] -= act[2] * TURN_RATE * STEP
        agent[YAW] -= 2 * math.pi * math.floor((agent[YAW] + math.pi) / (2 * math.pi))
        agent[PITCH] = min(max(agent[PITCH] + act[3] * LOOK_RATE * STEP, LOWEST), HIGHEST)
        commands.turned[i] = -1
        held = envs.hands[i]
        if held < 0:
            if act[8] > 0:
                held = pick(agent, one_env(envs, i))
                if held >= 0 and find_room(agent, one_env(envs, i), held, spot):
                    envs.hands[i] = held
                    status[held] = HELD
                    agent[BASE] = objects[held, Z]
        elif act[8] == 0:
            envs.hands[i] = -1
            status[held] = AIR
            _release(objects[held], orientation[held], envs.extents[envs.ranks[i, held]])
            commands.turned[i] = held
        else:
            turned[:] = orientation[held]
            agent[HOLD] += act[7] * PUSH_RATE * STEP
            agent[HOLD] = min(max(agent[HOLD], NEAREST_HOLD), envs.reach)
            _spin(orientation[held], agent, act)
            if not find_room(agent, one_env(envs, i), held, spot):
                agent[:] = pose
                orientation[held] = turned
        held = envs.hands[i]
        if held >= 0:
            _reach_out(agent, objects[held], spot, commands.drives[i])
            objects[held, Z] = spot[2]
        cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
        push = AGENT_MASS * ACCELERATION
        commands.forces[i, 0] = push * (act[0] * cos + act[1] * sin)
        commands.forces[i, 1] = push * (act[0] * sin - act[1] * cos)
        for j in range(status.size):
            commands.layers[i, j] = _layer(status[j], objects[j, Z])


@compiled()
def _layer(status, height):
    """What an object collides with, by where it is and its height."""
    if status == FLOOR or (status == AIR and height < FURNITURE_SIZE[1, 2] - LANDING):
        return GROUND_LAYER  # in the air, too low to pass over the tray, it lands within this step
    if status == ON_BED:
        return BED_LAYER
    if status == ON_TRAY:
        return TRAY_LAYER
    if status == HELD:
        return CARRIED_LAYER if height < 0.1 else HELD_LAYER
    if height < FURNITURE_SIZE[0, 2] - LANDING:
        return LOW_LAYER
    return RAISED_LAYER


@compiled()
def pick(agent, env):
    """The object that an agent could grip, or -1. `agent` is a row of `Envs.agents` or a pose that
    is tried out, float64 [6], whose HOLD is written."""
    ranks, furniture = env.ranks, env.furniture
    objects, orientation = env.objects, env.orientation
    direction = np.empty(3)
    direction[0] = math.cos(agent[PITCH]) * math.cos(agent[YAW])
    direction[1] = math.cos(agent[PITCH]) * math.sin(agent[YAW])
    direction[2] = math.sin(agent[PITCH])
    picked, nearest = -1, env.reach
    centre = np.empty(3)
    half = np.empty(3)
    frame = np.empty((3, 3))
    if env.furnished:
        for k in range(2):
            half[0], half[1] = FURNITURE_SIZE[k, 0], FURNITURE_SIZE[k, 1]
            half[2] = FURNITURE_SIZE[k, 2] / 2
            centre[0], centre[1], centre[2] = furniture[k, 0], furniture[k, 1], half[2]
            set_upright(frame, furniture[k, 2])
            nearest = min(nearest, distance_along(direction, agent, centre, frame, half))
    for j in range(ranks.size):
        extent = env.extents[ranks[j]]
        for c in range(3):
            half[c] = extent[c] / 2 + AIM_MARGIN
        centre[0], centre[1] = objects[j, X], objects[j, Y]
        centre[2] = objects[j, Z] + half_width(orientation[j], extent, 0.0, 0.0, 1.0)
        distance = distance_along(direction, agent, centre, orientation[j], half)
        if distance < nearest:
            picked, nearest = j, distance
            along = (
                (centre[0] - agent[AX]) * direction[0]
                + (centre[1] - agent[AY]) * direction[1]
                + (centre[2] - EYE) * direction[2]
            )
            agent[HOLD] = min(max(along, NEAREST_HOLD), env.reach)
    return picked


@compiled()
def distance_along(direction, agent, centre, frame, half):
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
def _release(item, frame, extent):
    """Lets an object go where it has room to stand up, its front in the direction it has now."""
    item[VZ] = 0.0
    if math.hypot(frame[0, 0], frame[1, 0]) > 0.1:  # otherwise its front is vertical
        item[ANGLE] = math.atan2(frame[1, 0], frame[0, 0])
    cos, sin = abs(math.cos(item[ANGLE])), abs(math.sin(item[ANGLE]))
    limit_x = (ROOM - cos * extent[0] - sin * extent[1]) / 2
    limit_y = (ROOM - sin * extent[0] - cos * extent[1]) / 2
    item[X] = min(max(item[X], -limit_x), limit_x)
    item[Y] = min(max(item[Y], -limit_y), limit_y)
    item[Z] = min(item[Z], CEILING - extent[2])


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
def _reach_out(agent, item, spot, drive):
    """The velocity that takes a held object to the greatest distance of `spot`, to `drive`."""
    dx = agent[AX] + spot[1] * math.cos(agent[YAW]) - item[X]
    dy = agent[AY] + spot[1] * math.sin(agent[YAW]) - item[Y]
    distance = math.hypot(dx, dy)
    share = min(1.0, HAND_SPEED * STEP / distance) if distance > 0 else 0.0
    drive[0], drive[1] = dx * share / _COAST, dy * share / _COAST


@compiled()
def keep_in_hand(envs, i, start):
    """After the physics, puts the held object of env `i` back in front of the agent.

    Other objects may have stopped it on its way, but do not push it aside. `start` is the agent's
    x, y before the physics, where there was room.
    """
    held = envs.hands[i]
    agent, item, spot = envs.agents[i], envs.objects[i, held], envs.spots[i]
    if not find_room(agent, one_env(envs, i), held, spot):
        agent[AX], agent[AY] = start[0], start[1]
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    distance = (item[X] - agent[AX]) * cos + (item[Y] - agent[AY]) * sin
    distance = min(max(distance, spot[0]), spot[1])
    item[X], item[Y] = agent[AX] + distance * cos, agent[AY] + distance * sin
    item[Z] = max(spot[2], floor_of_hand(envs.furnished, envs.furniture[i], item))
    if item[Z] > spot[2]:  # it slid onto a support
        extent = envs.extents[envs.ranks[i, held]]
        high = half_width(envs.orientation[i, held], extent, 0.0, 0.0, 1.0)
        keep_in_view(agent, item[Z] + high, distance)
