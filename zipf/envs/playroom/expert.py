"""A scripted expert that sees the state: it proves that every level can be solved."""

import math

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.playroom import actions, kernels
from zipf.envs.playroom.kernels import AX, AY, FURNITURE_SIZE, HOLD, PITCH, YAW
from zipf.envs.playroom.levels import LIFT, NEAR, ON
from zipf.envs.playroom.vector import PlayroomVectorEnv

_CELL = 0.1
_CELLS = round(kernels.ROOM / _CELL)
_FAR = 1_000_000
_SPEED = 1.2  # m/s; faster, it would overshoot
_TURN = kernels.TURN_RATE * kernels.STEP
_LOOK = kernels.LOOK_RATE * kernels.STEP
_NOTHING = -1


class Expert:
    """Solves what `env` shows, by the same 46 actions as anybody.

        expert = Expert(env)
        env.step(expert())

    It holds no state of its own: it may take over at any step.
    """

    def __init__(self, env: PlayroomVectorEnv) -> None:
        self.env = env

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every world, int64 [N]."""
        return np.array([self._act(i) for i in range(self.env.num_envs)])

    def _act(self, i: int) -> int:
        env = self.env
        if env.level.finding:
            return self._walk(i, env.items[i, 0, :2].tolist(), kernels.APPROACH_DISTANCE - 0.1)
        if env.hands[i] == 0:
            return self._raise(i) if env.task[i] == LIFT else self._bring(i)
        comes_to_rest = env.lifted[i, 0] and env.still[i, 0] < kernels.STILL_STEPS
        if env.hands[i] > 0 or comes_to_rest:
            return actions.NOOP
        return self._fetch(i)

    def _fetch(self, i: int) -> int:
        """Goes to where the target can be pointed at, points at it and grips."""
        env = self.env
        agent = env.agents[i].copy()
        if self._points_at(i, agent) == 0:
            return actions.GRAB
        _aim(agent, env.items[i, 0], env.extents[env.ranks[i, 0]])
        if self._points_at(i, agent) == 0:
            action = self._face(i, agent[YAW], agent[PITCH], closed=False)
            if action != actions.NOOP:
                return action
            # It already points there as well as it can: something narrowly hides the target.
        goals = _viewpoints(
            agent, env.level.furnished, env.ranks[i], env.extents, env.furniture[i],
            env.items[i], env.orientation[i],
        )  # fmt: skip
        return self._go(i, goals, closed=False)

    def _points_at(self, i: int, agent: NDArray[np.float64]) -> int:
        env = self.env
        return kernels.pick(
            agent, env.level.furnished, env.ranks[i], env.extents, env.furniture[i],
            env.items[i], env.orientation[i],
        )  # fmt: skip

    def _raise(self, i: int) -> int:
        """Lifts what is held; what already hangs as high as the view goes is pushed farther up."""
        agent = self.env.agents[i]
        if agent[PITCH] < kernels.HIGHEST - 0.01:
            return actions.GRAB + actions.LOOK_UP
        return actions.PUSH

    def _bring(self, i: int) -> int:
        """Carries what is held to its support, and lets go there."""
        env = self.env
        near = env.task[i] < ON
        support = int(env.task[i]) - (NEAR if near else ON)
        pose, size = env.furniture[i, support], FURNITURE_SIZE[support]
        agent, item = env.agents[i], env.items[i, 0]
        extent = env.extents[env.ranks[i, 0]]
        if not env.lifted[i, 0]:
            return self._raise(i)
        radius = kernels.footprint(extent)
        closest = kernels.AGENT_RADIUS + radius + 0.05
        gap = kernels.rectangle_gap(pose, size, agent[AX], agent[AY])
        # Where to let go: inside the support, or on the floor beside it.
        inset = 0.15 if not near else -(radius + 0.1)
        spot = _inside(pose, size, max(inset, 0.0), agent)
        if near:
            share = -inset / max(gap, -inset)
            spot = tuple(s + share * (a - s) for s, a in zip(spot, agent[:2].tolist(), strict=True))
        distance = math.hypot(spot[0] - agent[AX], spot[1] - agent[AY])
        if distance > 1.1 or distance < closest or gap < 0.3:
            goals = _beside(pose, size, inset, closest)
            return self._go(i, goals, closed=True)
        top = 0.0 if near else float(size[2])
        height = max(top + 0.12, 0.2) + extent[2] / 2 - kernels.EYE
        if math.hypot(item[0] - spot[0], item[1] - spot[1]) < 0.1 and item[3] < top + 0.25:
            room = env.rooms[i]
            assert room is not None
            swinging = room.objects[0].velocity.length > 0.3
            return actions.GRAB if swinging else actions.NOOP
        yaw = math.atan2(spot[1] - agent[AY], spot[0] - agent[AX])
        hold = min(max(math.hypot(distance, height), kernels.NEAREST_HOLD), kernels.REACH)
        if abs(hold - agent[HOLD]) > 0.07:
            return actions.PUSH if hold > agent[HOLD] else actions.PULL
        return self._face(i, yaw, math.atan2(height, distance), closed=True)

    def _face(self, i: int, yaw: float, pitch: float, *, closed: bool) -> int:
        """Turns the view towards an angle, the larger error first."""
        agent = self.env.agents[i]
        aside = (yaw - agent[YAW] + math.pi) % (2 * math.pi) - math.pi
        above = pitch - agent[PITCH]
        hand = actions.GRAB if closed else 0
        if abs(aside) > max(abs(above), 0.1 * _TURN):
            for share, right, left in (
                (0.6, actions.TURN_RIGHT, actions.TURN_LEFT),
                (0.1, actions.TURN_RIGHT_MID, actions.TURN_LEFT_MID),
                (0.0, actions.TURN_RIGHT_SLIGHTLY, actions.TURN_LEFT_SLIGHTLY),
            ):
                if abs(aside) >= share * _TURN:
                    return hand + (right if aside < 0 else left)
        if abs(above) > 0.5 * _LOOK:
            return hand + (actions.LOOK_DOWN if above < 0 else actions.LOOK_UP)
        if abs(above) > 0.02 * _LOOK:
            return hand + (actions.LOOK_DOWN_MID if above < 0 else actions.LOOK_UP_MID)
        return hand

    def _walk(self, i: int, place: list[float], distance: float) -> int:
        """Approaches a place."""
        return self._go(i, _around(np.array(place), distance), closed=False)

    def _go(self, i: int, goals: NDArray[np.bool_], *, closed: bool) -> int:
        """Takes the shortest way to one of the cells of `goals`."""
        env = self.env
        agent = env.agents[i]
        carried = int(env.hands[i])
        heading = _way(
            goals, agent, env.level.furnished, env.level.finding, carried, env.ranks[i],
            env.extents, env.furniture[i], env.items[i],
        )  # fmt: skip
        hand = actions.GRAB if closed else 0
        room = env.rooms[i]
        assert room is not None
        vx, vy = room.agent.velocity
        if math.isnan(heading):  # no way: shake things up
            return hand + (actions.BACKWARD if env.lengths[i] // 8 % 2 else actions.TURN_LEFT)
        aside = (heading - agent[YAW] + math.pi) % (2 * math.pi) - math.pi
        quarter = round(aside / (math.pi / 2))
        aside -= quarter * math.pi / 2
        move = (actions.FORWARD, actions.LEFT, actions.BACKWARD, actions.RIGHT)[quarter % 4]
        if abs(aside) > 0.3:
            return hand + (actions.TURN_RIGHT if aside < 0 else actions.TURN_LEFT)
        along = vx * math.cos(heading) + vy * math.sin(heading)
        return hand + (move if along < _SPEED else actions.NOOP)


def _inside(
    pose: NDArray[np.float64], size: NDArray[np.float64], inset: float, agent: NDArray[np.float64]
) -> tuple[float, float]:
    """The point of a rectangle, drawn in by `inset`, that is nearest to the agent."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = agent[AX] - pose[0], agent[AY] - pose[1]
    half_x, half_y = size[0] - min(inset, size[0]), size[1] - min(inset, size[1])
    x = min(max(cos * dx + sin * dy, -half_x), half_x)
    y = min(max(cos * dy - sin * dx, -half_y), half_y)
    return pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y


@compiled()
def _aim(agent, item, extent):
    """Turns `agent` towards the middle of an object."""
    dx, dy = item[0] - agent[AX], item[1] - agent[AY]
    agent[YAW] = math.atan2(dy, dx)
    agent[PITCH] = math.atan2(item[3] + extent[2] / 2 - kernels.EYE, math.hypot(dx, dy))


@compiled()
def _center(row, column):
    return (column + 0.5) * _CELL - kernels.ROOM / 2, (row + 0.5) * _CELL - kernels.ROOM / 2


@compiled()
def _viewpoints(agent, furnished, ranks, extents, furniture, items, orientation):
    """Where the target can be pointed at from: bool [rows, columns]."""
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    there = agent.copy()
    for row in range(_CELLS):
        for column in range(_CELLS):
            there[AX], there[AY] = _center(row, column)
            distance = math.hypot(there[AX] - items[0, 0], there[AY] - items[0, 1])
            if distance < 0.55 or distance > 1.5:
                continue
            _aim(there, items[0], extents[ranks[0]])
            if there[PITCH] < kernels.LOWEST:
                continue
            goals[row, column] = (
                kernels.pick(there, furnished, ranks, extents, furniture, items, orientation) == 0
            )
    return goals


@compiled()
def _beside(pose, size, inset, closest):
    """Where something can be held over a support from: bool [rows, columns]."""
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _center(row, column)
            gap = kernels.rectangle_gap(pose, size, x, y)
            goals[row, column] = max(closest - inset, 0.35) + 0.05 <= gap <= 0.9 - inset
    return goals


@compiled()
def _around(place, distance):
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _center(row, column)
            goals[row, column] = math.hypot(x - place[0], y - place[1]) < distance
    return goals


@compiled()
def _is_blocked(x, y, furnished, finding, carried, ranks, extents, furniture, items):
    margin = kernels.AGENT_RADIUS + 0.03
    if max(abs(x), abs(y)) > kernels.ROOM / 2 - margin:
        return True
    for j in range(ranks.size):
        if j == carried or (finding and j == 0) or items[j, 3] > 0.1:
            continue
        clear = 0.85 * kernels.footprint(extents[ranks[j]]) + margin
        if finding:
            clear = kernels.APPROACH_DISTANCE + 0.25
        if math.hypot(x - items[j, 0], y - items[j, 1]) < clear:
            return True
    if furnished:
        for k in range(2):
            if kernels.rectangle_gap(furniture[k], FURNITURE_SIZE[k], x, y) < margin:
                return True
    return False


@compiled()
def _way(goals, agent, furnished, finding, carried, ranks, extents, furniture, items):
    """The heading, radians, in which the shortest way to a goal begins; NaN where there is none."""
    blocked = np.zeros((_CELLS, _CELLS), np.bool_)
    distance = np.full((_CELLS, _CELLS), _FAR)
    queue = np.empty((_CELLS * _CELLS, 2), np.int64)
    tail = 0
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _center(row, column)
            blocked[row, column] = _is_blocked(
                x, y, furnished, finding, carried, ranks, extents, furniture, items
            )
            if goals[row, column] and not blocked[row, column]:
                distance[row, column] = 0
                queue[tail, 0], queue[tail, 1] = row, column
                tail += 1
    head = 0
    while head < tail:
        row, column = queue[head]
        head += 1
        for down in range(-1, 2):
            for right in range(-1, 2):
                r, c = row + down, column + right
                if r < 0 or c < 0 or r >= _CELLS or c >= _CELLS or blocked[r, c]:
                    continue
                if distance[r, c] == _FAR:
                    distance[r, c] = distance[row, column] + 1
                    queue[tail, 0], queue[tail, 1] = r, c
                    tail += 1
    # From the best cell within a short way, whichever side of an obstacle the agent touches.
    row = min(max(int((agent[AY] + kernels.ROOM / 2) / _CELL), 0), _CELLS - 1)
    column = min(max(int((agent[AX] + kernels.ROOM / 2) / _CELL), 0), _CELLS - 1)
    best, heading = np.inf, np.nan
    for down in range(-3, 4):
        for right in range(-3, 4):
            r, c = row + down, column + right
            if r < 0 or c < 0 or r >= _CELLS or c >= _CELLS or distance[r, c] == _FAR:
                continue
            x, y = _center(r, c)
            gap = math.hypot(x - agent[AX], y - agent[AY])
            if gap < 0.02:
                continue
            cost = distance[r, c] + 1.1 * gap / _CELL
            if cost < best:
                best, heading = cost, math.atan2(y - agent[AY], x - agent[AX])
    return heading
