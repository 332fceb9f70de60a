"""The playroom's rules, for many worlds at once: what begins, what the hand does, what counts.

The floor plane is simulated by pymunk (`room.py`). Here are the draws of an episode, the hand,
heights and orientations, and the judgement. Lengths in metres, angles in radians, time in seconds.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.playroom.actions import CONTROL_TABLE
from zipf.envs.playroom.levels import LIFT, NEAR, ON

# The room. Ours where no source is named; DeepMind's rooms are 3 x 3 and 4 x 4 m (Carvalho et al.).
ROOM = 4.0
CEILING = 2.5
EYE = 1.0
FRAMES = 4  # physics frames per action: paper
FRAME = 1 / 30  # paper
STEP = FRAMES * FRAME

# The agent.
AGENT_RADIUS = 0.25
AGENT_MASS = 20.0
DAMPING = 5.0  # 1/s: speed falls by this rate, so that the agent has momentum
ACCELERATION = 12.5  # m/s^2: 2.7 m/s at most
TURN_RATE = math.radians(120)
LOOK_RATE = math.radians(90)
FIRST_PITCH = math.radians(-25)  # objects on the floor are in view
LOWEST, HIGHEST = math.radians(-75), math.radians(60)

# The hand.
REACH = 2.0  # from the eye
NEAREST_HOLD = 0.45
AIM_MARGIN = 0.03  # how far beside an object the hand may point
PUSH_RATE = 1.0
SPIN_RATE = math.radians(180)
HAND_SPEED = 5.0
GRAVITY = 9.8

# What counts.
LIFT_HEIGHT = 0.15  # above where the object lay
NEAR_DISTANCE = 0.5  # from the support's edge
STILL_STEPS = 2  # at rest for so many actions, 0.27 s
STILL_MOTION = 0.01  # per action
APPROACH_DISTANCE = 0.7  # between the centres of agent and object, in supervised/ levels

# Furniture: bed and tray, half length and half width of the footprint, and height of the top.
FURNITURE_SIZE = np.array([[0.70, 0.45, 0.35], [0.30, 0.225, 0.03]])
LANDING = 0.005  # what falls lands on a top that it is this little below, or less
CLIMB = 0.1  # what is held this little below a top, or less, comes to be on it
PASSAGE = 0.55  # left free around furniture, for the agent to pass

FLOOR, AIR, HELD, ON_BED, ON_TRAY = range(5)
"""Where an object is."""
GROUND_LAYER, RAISED_LAYER, LOW_LAYER, CARRIED_LAYER, SUPPORTED_LAYER = range(5)
"""What an object collides with, see `room.py`."""

AX, AY, YAW, PITCH, HOLD, BASE = range(6)
"""Columns of `agents`: pose, distance of the held object from the eye, its height when gripped."""
X, Y, ANGLE, Z, VZ = range(5)
"""Columns of `objects`: pose on the floor plane, height of the lowest point and its speed."""

_MAX_TRIES = 10_000

# How far a body coasts in one action, by its speed at the beginning: positions move before
# damping does.
_COAST = FRAME * sum(math.exp(-DAMPING * FRAME * k) for k in range(FRAMES))


@compiled()
def _between(stream, low, high):
    return low + (high - low) * pcg64.next_double(stream)


@compiled()
def _below(stream, n):
    return min(int(pcg64.next_double(stream) * n), n - 1)


@compiled()
def draw_situations(mask, forced, probabilities, replacement, tasks, streams, ranks, task, scenery):
    """Draws ranks, task and the seed of everything else of the episodes of `mask`.

    Every episode takes the same number of draws from its world's stream, forced or not.

    Args:
        forced: int64 [ranks of the situation, N], -1 where drawn.
        probabilities: of an object's rank, float64 [50].
        replacement: whether an object may come twice.
        tasks: int64 [any], drawn from uniformly; empty where there is no such rank.
        ranks: int64 [N, objects], written; the target comes first.
        task: int64 [N], written.
        scenery: uint64 [N, 4], written: a stream for poses and colours.
    """
    count = ranks.shape[1]
    left = np.empty_like(probabilities)
    drawn = np.empty(count, np.int64)
    for i in range(mask.size):
        if not mask[i]:
            continue
        stream = streams[i]
        left[:] = probabilities
        for k in range(count):
            total = left.sum()
            u = pcg64.next_double(stream) * total
            rank, above = -1, 0.0
            for r in range(left.size):
                if left[r] > 0:
                    rank = r
                    above += left[r]
                    if u < above:
                        break
            drawn[k] = rank
            if not replacement:
                left[rank] = 0.0
        target = _below(stream, count)
        drawn[0], drawn[target] = drawn[target], drawn[0]
        ranks[i] = drawn
        for k in range(count):
            if forced[k, i] >= 0:
                ranks[i, k] = forced[k, i]
        if not replacement:
            _keep_apart(ranks[i], drawn, forced[:, i])
        choice = _below(stream, max(tasks.size, 1))
        task[i] = tasks[choice] if tasks.size else LIFT
        if forced.shape[0] > count and forced[count, i] >= 0:
            task[i] = forced[count, i]
        for k in range(2):
            scenery[i, k] = np.uint64(pcg64.next_double(stream) * 9007199254740992.0)
            scenery[i, 2 + k] = np.uint64(2 * k + 1)
        for _ in range(4):  # a state made of so few bits takes a few steps to mix
            pcg64.next_double(scenery[i])


@compiled()
def _keep_apart(ranks, drawn, forced):
    """Gives drawn objects that equal a forced one a rank that the forced one has replaced."""
    count = ranks.size
    for k in range(count):
        if forced[k] >= 0:
            continue
        taken = False
        for other in range(count):
            taken |= forced[other] >= 0 and ranks[k] == ranks[other]
        if not taken:
            continue
        for candidate in drawn:
            free = True
            for other in range(count):
                free &= ranks[other] != candidate
            if free:
                ranks[k] = candidate
                break


@compiled()
def lay_out(
    mask, finding, furnished, ranks, extents, scenery, agents, objects, furniture, colors, palette
):
    """Places everything of the episodes of `mask`, without overlap, everything within reach.

    Args:
        ranks: int64 [N, objects].
        extents: bounding boxes by rank, float64 [50, 3].
        scenery: uint64 [N, 4]: a stream of its own for each episode.
        agents, objects, furniture: float64 [N, 6], [N, objects, 5], [N, 2, 3] (x, y, angle),
            written.
        colors: uint8 [N, objects + 2, 2, 3], written: main and accent colours, furniture last.
        palette: uint8 [any, 3].

    Returns:
        Whether there was room for everything.
    """
    count = ranks.shape[1]
    fits = True
    for i in range(mask.size):
        if not mask[i]:
            continue
        stream = scenery[i]
        _paint(stream, palette, colors[i])
        tries = 0
        placed = False
        while not placed and tries < _MAX_TRIES:
            tries += 1
            if furnished:
                _place_furniture(stream, furniture[i])
                if (
                    rectangle_gap(
                        furniture[i, 0], FURNITURE_SIZE[0], furniture[i, 1, 0], furniture[i, 1, 1]
                    )
                    < PASSAGE + 0.375
                ):
                    continue
            agents[i, HOLD] = agents[i, BASE] = 0.0
            agents[i, PITCH] = FIRST_PITCH
            agents[i, YAW] = _between(stream, -math.pi, math.pi)
            if finding:
                _face_two(stream, agents[i], objects[i])
                placed = True
            else:
                placed = _scatter(
                    stream, furnished, ranks[i], extents, agents[i], objects[i], furniture[i]
                )
        fits &= placed
        for j in range(count):
            objects[i, j, ANGLE] = _between(stream, -math.pi, math.pi)
            objects[i, j, Z] = objects[i, j, VZ] = 0.0
    return fits


@compiled()
def _paint(stream, palette, colors):
    """Two different colours of the palette each, a little off."""
    for j in range(colors.shape[0]):
        main = _below(stream, palette.shape[0])
        accent = (main + 1 + _below(stream, palette.shape[0] - 1)) % palette.shape[0]
        for slot, pick in ((0, main), (1, accent)):
            for c in range(3):
                value = palette[pick, c] + _between(stream, -25.0, 25.0)
                colors[j, slot, c] = np.uint8(min(max(value, 0.0), 255.0))


@compiled()
def _place_furniture(stream, furniture):
    """The bed with its head or its side to a wall, the tray anywhere."""
    wall = _below(stream, 4)
    side_on = pcg64.next_double(stream) < 0.5
    reach = FURNITURE_SIZE[0, 1] if side_on else FURNITURE_SIZE[0, 0]
    along = FURNITURE_SIZE[0, 0] if side_on else FURNITURE_SIZE[0, 1]
    depth = ROOM / 2 - reach - 0.02
    slide = _between(stream, -1.0, 1.0) * (ROOM / 2 - along - 0.02)
    angle = wall * math.pi / 2
    cos, sin = math.cos(angle), math.sin(angle)
    # The bed's head is at its own -x; turned by pi it points at the wall in direction `angle`.
    furniture[0, 0] = cos * depth - sin * slide
    furniture[0, 1] = sin * depth + cos * slide
    furniture[0, 2] = angle + math.pi / 2 if side_on else angle + math.pi
    free = ROOM / 2 - PASSAGE - 0.375
    furniture[1, 0] = _between(stream, -free, free)
    furniture[1, 1] = _between(stream, -free, free)
    furniture[1, 2] = _between(stream, -math.pi, math.pi)


@compiled()
def rectangle_gap(pose, size, x, y):
    """Distance of a point from a rectangle, 0 inside."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    out_x = max(abs(cos * dx + sin * dy) - size[0], 0.0)
    out_y = max(abs(cos * dy - sin * dx) - size[1], 0.0)
    return math.sqrt(out_x * out_x + out_y * out_y)


@compiled()
def _is_free(x, y, radius, furnished, furniture):
    if max(abs(x), abs(y)) > ROOM / 2 - radius:
        return False
    if furnished:
        for k in range(2):
            if rectangle_gap(furniture[k], FURNITURE_SIZE[k], x, y) < radius:
                return False
    return True


@compiled()
def _scatter(stream, furnished, ranks, extents, agent, objects, furniture):
    """Agent and objects anywhere; False where no place was found for one of them."""
    for j in range(-1, ranks.size):
        radius = AGENT_RADIUS if j < 0 else footprint(extents[ranks[j]])
        found = False
        for _ in range(50):
            x = _between(stream, -ROOM / 2, ROOM / 2)
            y = _between(stream, -ROOM / 2, ROOM / 2)
            if not _is_free(x, y, radius + 0.05, furnished, furniture):
                continue
            found = j < 0 or math.hypot(x - agent[AX], y - agent[AY]) > radius + AGENT_RADIUS + 0.2
            for k in range(max(j, 0)):
                gap = radius + footprint(extents[ranks[k]]) + 0.1
                found &= math.hypot(x - objects[k, X], y - objects[k, Y]) > gap
            if found:
                if j < 0:
                    agent[AX], agent[AY] = x, y
                else:
                    objects[j, X], objects[j, Y] = x, y
                break
        if not found:
            return False
    return True


@compiled()
def _face_two(stream, agent, objects):
    """Two objects in view, one on the left and one on the right, the target on either side."""
    x, y = _between(stream, -0.2, 0.2), _between(stream, -0.2, 0.2)
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    agent[AX], agent[AY] = x - 0.6 * cos, y - 0.6 * sin
    side = 1.0 if pcg64.next_double(stream) < 0.5 else -1.0
    for j in range(2):
        ahead = _between(stream, 0.55, 0.8)
        aside = (side if j == 0 else -side) * _between(stream, 0.4, 0.6)
        objects[j, X] = x + ahead * cos - aside * sin
        objects[j, Y] = y + ahead * sin + aside * cos


@compiled()
def footprint(extent):
    """The radius that holds an object on the floor however it is turned."""
    return 0.5 * math.sqrt(extent[0] * extent[0] + extent[1] * extent[1])


@compiled()
def begin(mask, agents, hands, objects, orientation, status, still, lifted):
    """The rest of the state of the worlds of `mask`, where `lay_out` has placed everything."""
    for i in range(mask.size):
        if mask[i]:
            hands[i] = -1
            for j in range(status.shape[1]):
                status[i, j] = FLOOR
                still[i, j] = 0
                lifted[i, j] = False
                _stand(orientation[i, j], objects[i, j, ANGLE])


@compiled()
def control(
    mask, actions, furnished, ranks, extents, furniture,
    agents, hands, objects, orientation, status, layers, forces, drives, turned,
):  # fmt: skip
    """What the actions do before the physics of the step: look, grip, hold, let go.

    Args:
        layers: int64 [N, objects], written: what each object collides with.
        forces: float64 [N, 2], written: on the agent, newtons.
        drives: float64 [N, 2], written: the held object's speed, where there is one.
        turned: int64 [N], written: an object just let go, to be turned to its new angle, or -1.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        act = CONTROL_TABLE[actions[i]]
        agent = agents[i]
        agent[YAW] -= act[2] * TURN_RATE * STEP
        agent[YAW] -= 2 * math.pi * math.floor((agent[YAW] + math.pi) / (2 * math.pi))
        agent[PITCH] = min(max(agent[PITCH] + act[3] * LOOK_RATE * STEP, LOWEST), HIGHEST)
        cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
        push = AGENT_MASS * ACCELERATION
        forces[i, 0] = push * (act[0] * cos + act[1] * sin)
        forces[i, 1] = push * (act[0] * sin - act[1] * cos)
        turned[i] = -1
        held = hands[i]
        if act[8] > 0 and held < 0:
            held = pick(
                agent, furnished, ranks[i], extents, furniture[i], objects[i], orientation[i]
            )
            if held >= 0:
                hands[i] = held
                status[i, held] = HELD
                agent[BASE] = objects[i, held, Z]
        elif act[8] == 0 and held >= 0:
            hands[i] = -1
            status[i, held] = AIR
            objects[i, held, VZ] = 0.0
            floor = _floor_of_hand(furnished, furniture[i], objects[i, held])
            objects[i, held, Z] = max(objects[i, held, Z], floor)
            _let_go(objects[i, held], orientation[i, held])
            turned[i] = held
            held = -1
        if held >= 0:
            if act[7] != 0:
                agent[HOLD] += act[7] * PUSH_RATE * STEP
                agent[HOLD] = min(max(agent[HOLD], NEAREST_HOLD), REACH)
            _spin(orientation[i, held], agent, act)
            _carry(
                agent, furnished, furniture[i], objects[i, held], extents[ranks[i, held]], drives[i]
            )
        for j in range(ranks.shape[1]):
            layers[i, j] = _layer(status[i, j], objects[i, j, Z])


@compiled()
def _layer(status, height):
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
def pick(agent, furnished, ranks, extents, furniture, objects, orientation):
    """The object that the hand points at within reach, or -1; sets how far it is held."""
    direction = np.empty(3)
    direction[0] = math.cos(agent[PITCH]) * math.cos(agent[YAW])
    direction[1] = math.cos(agent[PITCH]) * math.sin(agent[YAW])
    direction[2] = math.sin(agent[PITCH])
    picked, nearest = -1, REACH
    center = np.empty(3)
    half = np.empty(3)
    frame = np.empty((3, 3))
    if furnished:
        for k in range(2):
            half[0], half[1] = FURNITURE_SIZE[k, 0], FURNITURE_SIZE[k, 1]
            half[2] = FURNITURE_SIZE[k, 2] / 2
            center[0], center[1], center[2] = furniture[k, 0], furniture[k, 1], half[2]
            _stand(frame, furniture[k, 2])
            nearest = min(nearest, _distance_along(direction, agent, center, frame, half))
    for j in range(ranks.size):
        extent = extents[ranks[j]]
        for c in range(3):
            half[c] = extent[c] / 2 + AIM_MARGIN
        center[0], center[1] = objects[j, X], objects[j, Y]
        center[2] = objects[j, Z] + extent[2] / 2
        distance = _distance_along(direction, agent, center, orientation[j], half)
        if distance < nearest:
            picked, nearest = j, distance
            along = (
                (center[0] - agent[AX]) * direction[0]
                + (center[1] - agent[AY]) * direction[1]
                + (center[2] - EYE) * direction[2]
            )
            agent[HOLD] = min(max(along, NEAREST_HOLD), REACH)
    return picked


@compiled()
def _distance_along(direction, agent, center, frame, half):
    """Where a ray from the eye enters an oriented box; infinity where it misses."""
    near, far = 0.0, math.inf
    for axis in range(3):
        offset = (
            frame[0, axis] * (center[0] - agent[AX])
            + frame[1, axis] * (center[1] - agent[AY])
            + frame[2, axis] * (center[2] - EYE)
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
def _stand(frame, angle):
    """Writes the upright orientation that faces `angle`, float64 [3, 3]."""
    cos, sin = math.cos(angle), math.sin(angle)
    frame[0, 0], frame[0, 1], frame[0, 2] = cos, -sin, 0.0
    frame[1, 0], frame[1, 1], frame[1, 2] = sin, cos, 0.0
    frame[2, 0], frame[2, 1], frame[2, 2] = 0.0, 0.0, 1.0


@compiled()
def _let_go(item, frame):
    """The object's angle on the floor is that of its front, if it still points anywhere."""
    if math.hypot(frame[0, 0], frame[1, 0]) > 0.1:
        item[ANGLE] = math.atan2(frame[1, 0], frame[0, 0])


@compiled()
def _spin(frame, agent, act):
    cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
    if act[4] != 0:
        _rotate(frame, 0.0, 0.0, 1.0, -act[4] * SPIN_RATE * STEP)
    if act[5] != 0:
        _rotate(frame, sin, -cos, 0.0, act[5] * SPIN_RATE * STEP)
    if act[6] != 0:
        _rotate(frame, cos, sin, 0.0, act[6] * SPIN_RATE * STEP)


@compiled()
def _rotate(frame, x, y, z, angle):
    """Turns `frame` about a unit axis of the world, by Rodrigues' formula."""
    cos, sin = math.cos(angle), math.sin(angle)
    for column in range(3):
        a, b, c = frame[0, column], frame[1, column], frame[2, column]
        dot = (x * a + y * b + z * c) * (1 - cos)
        frame[0, column] = a * cos + (y * c - z * b) * sin + x * dot
        frame[1, column] = b * cos + (z * a - x * c) * sin + y * dot
        frame[2, column] = c * cos + (x * b - y * a) * sin + z * dot


@compiled()
def _carry(agent, furnished, furniture, item, extent, drive):
    """Moves the held object to where the hand is: its height now, its place by the physics."""
    radius = footprint(extent)
    flat = max(math.cos(agent[PITCH]) * agent[HOLD], AGENT_RADIUS + radius + 0.05)
    limit = ROOM / 2 - radius
    x = min(max(agent[AX] + flat * math.cos(agent[YAW]), -limit), limit)
    y = min(max(agent[AY] + flat * math.sin(agent[YAW]), -limit), limit)
    if furnished and item[Z] < FURNITURE_SIZE[0, 2] - CLIMB:
        x, y = _beside(furniture[0], FURNITURE_SIZE[0], 0.5 * min(extent[0], extent[1]), item, x, y)
    dx, dy = x - item[X], y - item[Y]
    distance = math.hypot(dx, dy)
    share = min(1.0, HAND_SPEED * STEP / distance) if distance > 0 else 0.0
    drive[0], drive[1] = dx * share / _COAST, dy * share / _COAST
    height = EYE + math.sin(agent[PITCH]) * agent[HOLD] - extent[2] / 2
    floor = _floor_of_hand(furnished, furniture, item)
    height = min(max(height, floor), CEILING - extent[2])
    step = HAND_SPEED * STEP
    item[Z] += min(max(height - item[Z], -step), step)


@compiled()
def _floor_of_hand(furnished, furniture, item):
    """The lowest that an object may be held where it is."""
    floor = 0.0
    if furnished:
        for k in range(2):
            over = rectangle_gap(furniture[k], FURNITURE_SIZE[k], item[X], item[Y]) == 0.0
            if over and item[Z] >= FURNITURE_SIZE[k, 2] - CLIMB:
                floor = FURNITURE_SIZE[k, 2]
    return floor


@compiled()
def _beside(pose, size, radius, item, x, y):
    """The place nearest to (x, y) on the side of a rectangle on which an object is now.

    The physics alone would not do: what has its speed set moves before it is stopped.
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


@compiled()
def settle(
    mask, finding, furnished, task, ranks, extents, furniture, before,
    agents, hands, objects, orientation, status, still, lifted, reward, terminated, success,
):  # fmt: skip
    """What follows from the physics of the step: falling, resting, and whether the task is done.

    Args:
        before: float64 [N, objects, 2]: where the objects were before the physics.
        reward, terminated, success: float64, bool, bool [N], written.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        for j in range(ranks.shape[1]):
            item = objects[i, j]
            motion = math.hypot(item[X] - before[i, j, 0], item[Y] - before[i, j, 1])
            if status[i, j] == HELD:
                still[i, j] = 0
                lifted[i, j] |= item[Z] - agents[i, BASE] >= LIFT_HEIGHT
                continue
            status[i, j] = _fall(item, before[i, j], furnished, furniture[i])
            rests = status[i, j] != AIR and motion < STILL_MOTION
            still[i, j] = min(still[i, j] + 1, STILL_STEPS) if rests else 0
            _right(orientation[i, j], item[ANGLE])
        outcome = -1
        if finding:
            outcome = _judge_approach(ranks[i], agents[i], objects[i])
        elif task[i] == LIFT:
            if hands[i] >= 0 and lifted[i, hands[i]]:
                outcome = 1 if ranks[i, hands[i]] == ranks[i, 0] else 0
        else:
            outcome = _judge_put(
                task[i], ranks[i], furniture[i], objects[i], status[i], still[i], lifted[i]
            )
        terminated[i] = outcome >= 0
        success[i] = outcome == 1
        reward[i] = 1.0 if outcome == 1 else 0.0


@compiled()
def _fall(item, before, furnished, furniture):
    """Lets an object that is not held fall for one step; returns where it is then."""
    where = FLOOR
    for k in range(1, FRAMES + 1):
        share = k / FRAMES
        x = before[0] + (item[X] - before[0]) * share
        y = before[1] + (item[Y] - before[1]) * share
        top, where = 0.0, FLOOR
        if furnished:
            for f in range(2):
                height = FURNITURE_SIZE[f, 2]
                # What stands on the floor beside a support does not jump onto it.
                if (
                    item[Z] >= height - LANDING
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


@compiled()
def _right(frame, angle):
    """An object that is not held stands up again, over a few steps."""
    upright = np.empty((3, 3))
    _stand(upright, angle)
    # The weights keep even what is upside down from cancelling out.
    off = 0.0
    for r in range(3):
        for c in range(3):
            off = max(off, abs(frame[r, c] - upright[r, c]))
    if off < 0.01:
        frame[:] = upright
        return
    for c in (2, 0):
        for r in range(3):
            frame[r, c] = 0.4 * frame[r, c] + 0.6 * upright[r, c]
    _normalize(frame, 2)
    dot = frame[0, 0] * frame[0, 2] + frame[1, 0] * frame[1, 2] + frame[2, 0] * frame[2, 2]
    for r in range(3):
        frame[r, 0] -= dot * frame[r, 2]
    _normalize(frame, 0)
    frame[0, 1] = frame[1, 2] * frame[2, 0] - frame[2, 2] * frame[1, 0]
    frame[1, 1] = frame[2, 2] * frame[0, 0] - frame[0, 2] * frame[2, 0]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[1, 2] * frame[0, 0]


@compiled()
def _normalize(frame, c):
    norm = math.sqrt(frame[0, c] ** 2 + frame[1, c] ** 2 + frame[2, c] ** 2)
    for r in range(3):
        frame[r, c] /= norm


@compiled()
def _judge_approach(ranks, agent, objects):
    """1 where the target is approached, 0 where another object is, -1 where none is."""
    outcome = -1
    for j in range(ranks.size):
        gap = math.hypot(objects[j, X] - agent[AX], objects[j, Y] - agent[AY])
        if gap < APPROACH_DISTANCE:
            outcome = max(outcome, 1 if ranks[j] == ranks[0] else 0)
    return outcome


@compiled()
def _judge_put(task, ranks, furniture, objects, status, still, lifted):
    """1 where the target has been put where it belongs, 0 where anything else has, -1 if nothing.

    An object has been put when it rests after having been lifted. Where the task is to put it
    near, on counts, too.
    """
    near = task < ON
    support = task - (NEAR if near else ON)
    for j in range(ranks.size):
        if not lifted[j] or still[j] < STILL_STEPS:
            continue
        somewhere = right = False
        for k in range(2):
            there = status[j] == ON_BED + k
            if near and status[j] == FLOOR:
                gap = rectangle_gap(furniture[k], FURNITURE_SIZE[k], objects[j, X], objects[j, Y])
                there = gap <= NEAR_DISTANCE
            somewhere |= there
            right |= there and k == support
        if somewhere:
            return 1 if right and ranks[j] == ranks[0] else 0
    return -1
