"""How an episode begins: which objects it has, and where everything is placed."""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.playroom.constants import AGENT_RADIUS, FURNITURE_SIZE, NEAR_DISTANCE, ROOM
from zipf.envs.playroom.geometry import footprint, rectangle_gap, rectangles_gap, set_upright
from zipf.envs.playroom.levels import LIFT
from zipf.envs.playroom.state import ANGLE, AX, AY, BASE, FLOOR, HOLD, PITCH, VZ, YAW, X, Y, Z

PALETTE = np.array(
    [
        (205, 40, 40),  # red
        (50, 160, 60),  # green
        (45, 80, 200),  # blue
        (90, 205, 180),  # aquamarine
        (200, 50, 190),  # magenta
        (235, 130, 30),  # orange
        (125, 60, 170),  # purple
        (240, 140, 180),  # pink
        (235, 210, 50),  # yellow
        (230, 230, 230),  # white
    ],
    np.uint8,
)
"""The colours of objects: Carvalho et al. 2021."""

FIRST_PITCH = math.radians(-25)  # Objects on the floor are in view. Ours.
FIRST_YAW = math.radians(30)
"""How far to either side of the objects' middle the agent may look at first. Ours."""
PASSAGE = 0.55
"""Free space between the tray and the walls, metres, so that the agent can pass. Ours."""

_between, _below = pcg64.between, pcg64.below
_TRAY_RADIUS = 0.375
_MAX_TRIES = 10_000


@compiled()
def draw_situations(mask, forced, probabilities, tasks, streams, envs):
    """Draws ranks, task and the seed of everything else for the episodes of `mask`.

    Every episode takes the same number of draws from its env's stream, forced or not. Objects are
    drawn with replacement in `supervised/` levels, without it in the others.

    Args:
        forced: int64 [ranks of the situation, N], -1 where a rank is drawn.
        probabilities: of an object's rank, float64 [50].
        tasks: the tasks to draw from uniformly, int64 [any]; empty where there is no choice.
        envs: `ranks`, `task` and `scenery` are written.
    """
    replacement = envs.finding
    count = envs.ranks.shape[1]
    left = np.empty_like(probabilities)
    drawn = np.empty(count, np.int64)
    for i in range(mask.size):
        if not mask[i]:
            continue
        stream, ranks, scenery = streams[i], envs.ranks[i], envs.scenery[i]
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
        ranks[:] = drawn
        for k in range(count):
            if forced[k, i] >= 0:
                ranks[k] = forced[k, i]
        if not replacement:
            _keep_apart(ranks, drawn, forced[:, i])
        choice = _below(stream, max(tasks.size, 1))
        envs.task[i] = tasks[choice] if tasks.size else LIFT
        if forced.shape[0] > count and forced[count, i] >= 0:
            envs.task[i] = forced[count, i]
        for k in range(2):
            scenery[k] = np.uint64(pcg64.next_double(stream) * 9007199254740992.0)
            scenery[2 + k] = np.uint64(2 * k + 1)
        for _ in range(4):  # a state seeded with so few bits takes a few steps to mix
            pcg64.next_double(scenery)


@compiled()
def _keep_apart(ranks, drawn, forced):
    """Replaces drawn ranks that equal a forced one by ranks that forced ones have displaced."""
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
def lay_out(mask, envs):
    """Places agent, objects and furniture of the episodes of `mask`, and paints them.

    Nothing overlaps, the agent can reach everything, and no place is near both bed and tray. Draws
    from `envs.scenery`. Returns whether there was room for everything.
    """
    fits = True
    for i in range(mask.size):
        if not mask[i]:
            continue
        stream, agent, objects = envs.scenery[i], envs.agents[i], envs.objects[i]
        furniture = envs.furniture[i]
        _paint(stream, envs.colours[i])
        tries = 0
        placed = False
        while not placed and tries < _MAX_TRIES:
            tries += 1
            if envs.furnished:
                _place_furniture(stream, furniture)
                bed, tray = furniture[0], furniture[1]
                gap = rectangles_gap(bed, FURNITURE_SIZE[0], tray, FURNITURE_SIZE[1])
                if gap <= 2 * NEAR_DISTANCE:
                    continue
            agent[HOLD] = agent[BASE] = 0.0
            agent[PITCH] = FIRST_PITCH
            if envs.finding:
                _face_two(stream, agent, objects)
                placed = True
            else:
                placed = _scatter(stream, envs, i)
                _face_the_objects(stream, agent, objects)
        fits &= placed
        for j in range(objects.shape[0]):
            objects[j, ANGLE] = _between(stream, -math.pi, math.pi)
            objects[j, Z] = objects[j, VZ] = 0.0
    return fits


@compiled()
def _paint(stream, colours):
    """Gives each thing two different colours of the palette, each a little changed."""
    for j in range(colours.shape[0]):
        main = _below(stream, PALETTE.shape[0])
        accent = (main + 1 + _below(stream, PALETTE.shape[0] - 1)) % PALETTE.shape[0]
        for slot, pick in ((0, main), (1, accent)):
            for c in range(3):
                value = PALETTE[pick, c] + _between(stream, -25.0, 25.0)
                colours[j, slot, c] = np.uint8(min(max(value, 0.0), 255.0))


@compiled()
def _place_furniture(stream, furniture):
    """Places the bed with its head or its side to a wall, and the tray anywhere."""
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
    free = ROOM / 2 - PASSAGE - _TRAY_RADIUS
    furniture[1, 0] = _between(stream, -free, free)
    furniture[1, 1] = _between(stream, -free, free)
    furniture[1, 2] = _between(stream, -math.pi, math.pi)


@compiled()
def _is_free(x, y, radius, furnished, furniture):
    """Whether a disc lies in the room and touches no furniture."""
    if max(abs(x), abs(y)) > ROOM / 2 - radius:
        return False
    if furnished:
        for k in range(2):
            if rectangle_gap(furniture[k], FURNITURE_SIZE[k], x, y) < radius:
                return False
    return True


@compiled()
def _scatter(stream, envs, i):
    """Places agent and objects anywhere; False where no place was found for one of them.

    The objects are placed in a random order: the later ones are pushed outwards by those before,
    and the target, which is the first of them, would be found in the middle of the room.
    """
    ranks, extents = envs.ranks[i], envs.extents
    agent, objects = envs.agents[i], envs.objects[i]
    order = np.arange(ranks.size)
    for last in range(ranks.size - 1, 0, -1):
        other = _below(stream, last + 1)
        order[last], order[other] = order[other], order[last]
    for turn in range(-1, ranks.size):
        j = order[turn] if turn >= 0 else -1
        radius = AGENT_RADIUS if j < 0 else footprint(extents[ranks[j]])
        found = False
        for _ in range(50):
            x = _between(stream, -ROOM / 2, ROOM / 2)
            y = _between(stream, -ROOM / 2, ROOM / 2)
            if not _is_free(x, y, radius + 0.05, envs.furnished, envs.furniture[i]):
                continue
            found = j < 0 or math.hypot(x - agent[AX], y - agent[AY]) > radius + AGENT_RADIUS + 0.2
            for k in order[: max(turn, 0)]:
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
def _face_the_objects(stream, agent, objects):
    """Turns the agent to the middle of all objects, give or take, so that it sees some of them."""
    aside = _between(stream, -FIRST_YAW, FIRST_YAW)
    dx, dy = objects[:, X].mean() - agent[AX], objects[:, Y].mean() - agent[AY]
    agent[YAW] = math.atan2(dy, dx) + aside
    agent[YAW] -= 2 * math.pi * math.floor((agent[YAW] + math.pi) / (2 * math.pi))


@compiled()
def _face_two(stream, agent, objects):
    """Places two objects in view, one on the left and one on the right, the target on either."""
    agent[YAW] = _between(stream, -math.pi, math.pi)
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
def begin(mask, envs):
    """Sets the state that follows from the poses which `lay_out` has drawn."""
    for i in range(mask.size):
        if mask[i]:
            envs.hands[i] = -1
            for j in range(envs.status.shape[1]):
                envs.status[i, j] = FLOOR
                envs.still[i, j] = 0
                envs.lifted[i, j] = False
                set_upright(envs.orientation[i, j], envs.objects[i, j, ANGLE])
