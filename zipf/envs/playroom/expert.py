"""A scripted expert that reads the state: it shows that every level can be solved."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.playroom import actions, hand
from zipf.envs.playroom.constants import (
    AGENT_RADIUS,
    DAMPING,
    EYE,
    FRAME,
    FRAMES,
    FURNITURE_SIZE,
    ROOM,
    STEP,
)
from zipf.envs.playroom.falling import STILL_STEPS
from zipf.envs.playroom.geometry import footprint, rectangle_gap
from zipf.envs.playroom.judgement import APPROACH_DISTANCE
from zipf.envs.playroom.levels import LIFT, NEAR, ON
from zipf.envs.playroom.state import AX, AY, HOLD, PITCH, YAW, X, Y, Z, one_env
from zipf.envs.playroom.vector import PlayroomVectorEnv

_CELL = 0.1
_CELLS = round(ROOM / _CELL)
_SPEED = 1.2  # m/s; faster, it would overshoot
# The share of its speed that the agent keeps through an action, and the speed that a push adds.
_DECAY = math.exp(-DAMPING * STEP)
_PUSH = hand.ACCELERATION * FRAME * sum(math.exp(-DAMPING * FRAME * k) for k in range(FRAMES))
_TURN = hand.TURN_RATE * STEP
LOOK = hand.LOOK_RATE * STEP
# How precisely the view can be turned: half of its smallest steps, and a little more.
_AIM_YAW = 0.51 * 0.05 * _TURN
_AIM_PITCH = 0.51 * 0.03 * LOOK

# Of bringing a toy, in metres.
_ARM = 1.1  # it is let go at most so far from the agent
_STAND_OFF = 0.3  # the least gap between the agent and the support
_INSIDE = 0.15  # from the support's edge to the spot on it
_FROM_EDGE = 0.1  # from the support's edge to the toy beside it
_OVER = 0.1  # it is let go when so near to the spot, seen from above,
_LOW_ENOUGH = 0.25  # and no higher than this above it
_ABOVE = 0.12  # it is held so high above the spot
_HOLD_ERROR = 0.07  # of the hand's distance: half of what a push changes, and a little more


class _Spot(NamedTuple):
    """Where a toy is let go."""

    # x, y, top: the place, metres; `top` is that of what it comes to lie on
    x: float
    y: float
    top: float
    # pose, size: of the support
    pose: NDArray[np.float64]
    size: NDArray[np.float64]
    inset: float  # of the place from the support's edge; negative outside
    closest: float  # of the agent to it
    # radius, height: of the toy
    radius: float
    height: float


def require_playable(env: PlayroomVectorEnv, policy: str) -> None:
    """Raises ValueError if a scripted policy, named in the message, cannot play these envs."""
    if not hasattr(env, "rooms"):
        raise ValueError(
            f"the {policy} reads the state of a batch of one playroom level, "
            f"got {type(env).__name__}"
        )
    count, known = env.single_action_space.n, len(actions.ACTIONS)
    if count != known:
        raise ValueError(f"the {policy} needs the playroom's {known} actions, got {count}")


class Expert:
    """Chooses actions that solve the episodes of `env`, among the same 46 as an agent's.

        expert = Expert(env)
        env.step(expert())

    It may take over at any step: it keeps no more than the ways that it found last in each env,
    which it follows as long as nothing that they depend on has moved.
    Raises ValueError: the batch is of another family, or its episodes are questions.
    """

    def __init__(self, env: PlayroomVectorEnv) -> None:
        require_playable(env, "expert")
        self.env = env
        self.envs = env.envs
        # By search and env: the state that the search depends on, and its result.
        self._found: dict[tuple[str, int], tuple[bytes, NDArray[Any]]] = {}

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every env, int64 [N]."""
        rooms = self.env.rooms  # None of an env that is on another level of a mixture
        return np.array(
            [actions.NOOP if room is None else self.act(i) for i, room in enumerate(rooms)]
        )

    def act(self, i: int) -> int:
        envs = self.envs
        if envs.finding:
            near = around(envs.objects[i, 0], APPROACH_DISTANCE - 0.1)
            return self.go(i, near)
        if envs.hands[i] == 0:
            return self._raise(i) if envs.task[i] == LIFT else self._bring(i)
        comes_to_rest = envs.lifted[i, 0] and envs.still[i, 0] < STILL_STEPS
        if envs.hands[i] > 0 or comes_to_rest:
            return actions.NOOP
        return self._fetch(i)

    def _fetch(self, i: int) -> int:
        """Walks to a place from which the target can be gripped, points at it and grips."""
        envs = self.envs
        agent = envs.agents[i].copy()
        env = one_env(envs, i)
        if hand.pick(agent, env) == 0:
            return actions.GRAB
        if _can_aim(agent, env):
            return self._face(i, agent[YAW], agent[PITCH], closed=False)
        cells = self._search("viewpoints", i, self._poses(i), lambda: _viewpoints(agent, envs, i))
        return self.go(i, cells)

    def _raise(self, i: int) -> int:
        """Lifts the held object by looking up, and at the highest view by pushing it away."""
        agent = self.envs.agents[i]
        if agent[PITCH] < hand.HIGHEST - 0.01:
            return actions.GRAB + actions.LOOK_UP
        return actions.PUSH

    def _bring(self, i: int) -> int:
        """Carries the held target to its support, and lets go there."""
        if not self.envs.lifted[i, 0]:
            return self._raise(i)
        spot = self._spot(i)
        agent = self.envs.agents[i]
        distance = math.hypot(spot.x - agent[AX], spot.y - agent[AY])
        gap = rectangle_gap(spot.pose, spot.size, agent[AX], agent[AY])
        if distance > _ARM or distance < spot.closest or gap < _STAND_OFF:
            return self._carry(i, spot)
        return self._hold_over(i, spot, distance)

    def _spot(self, i: int) -> _Spot:
        """Where to let go of the target: inside the support, or on the floor beside it."""
        envs = self.envs
        near = envs.task[i] < ON
        support = int(envs.task[i]) - (NEAR if near else ON)
        pose, size = envs.furniture[i, support], FURNITURE_SIZE[support]
        agent, extent = envs.agents[i], envs.extents[envs.ranks[i, 0]]
        radius = footprint(extent)
        closest = AGENT_RADIUS + radius + 0.05
        inset = -(radius + _FROM_EDGE) if near else _INSIDE
        x, y = _inside(pose, size, max(inset, 0.0), agent)
        if near:
            share = -inset / max(rectangle_gap(pose, size, agent[AX], agent[AY]), -inset)
            x, y = x + share * (agent[AX] - x), y + share * (agent[AY] - y)
        top = 0.0 if near else float(size[2])
        return _Spot(x, y, top, pose, size, inset, closest, radius, float(extent[2]))

    def _carry(self, i: int, spot: _Spot) -> int:
        """Walks to a place from which the target can be held over the spot."""
        if self._is_low(i, spot.radius):
            return actions.GRAB + actions.LOOK_UP
        # It faces the support on its way: a held object would keep it away from walls.
        agent = self.envs.agents[i]
        aside = _aside(agent, math.atan2(spot.pose[1] - agent[AY], spot.pose[0] - agent[AX]))
        if abs(aside) > _TURN and self.env._lengths[i] % 2:
            return actions.GRAB + (actions.TURN_RIGHT if aside < 0 else actions.TURN_LEFT)
        goals = _beside(spot.pose, spot.size, spot.inset, spot.closest)
        return actions.GRAB + self.go(i, goals)

    def _hold_over(self, i: int, spot: _Spot, distance: float) -> int:
        """Holds the target over the spot, `distance` metres away, and lets go there."""
        agent, item = self.envs.agents[i], self.envs.objects[i, 0]
        over = math.hypot(item[X] - spot.x, item[Y] - spot.y) < _OVER
        if over and item[Z] < spot.top + _LOW_ENOUGH:
            room = self.env.rooms[i]
            assert room is not None
            swinging = room.objects[0].velocity.length > 0.3
            return actions.GRAB if swinging else actions.NOOP
        height = max(spot.top + _ABOVE, 0.2) + spot.height / 2 - EYE
        hold = min(max(math.hypot(distance, height), hand.NEAREST_HOLD), self.envs.reach)
        if abs(hold - agent[HOLD]) > _HOLD_ERROR:
            return actions.PUSH if hold > agent[HOLD] else actions.PULL
        yaw = math.atan2(spot.y - agent[AY], spot.x - agent[AX])
        return self._face(i, yaw, math.atan2(height, distance), closed=True)

    def _is_low(self, i: int, radius: float) -> bool:
        """Whether the bed's side is in the way of the held object, and it can be raised."""
        envs = self.envs
        item, bed, size = envs.objects[i, 0], envs.furniture[i, 0], FURNITURE_SIZE[0]
        beside = rectangle_gap(bed, size, item[X], item[Y]) < radius + 0.1
        return bool(item[Z] < size[2] and beside and envs.agents[i, PITCH] < 0)

    def _face(self, i: int, yaw: float, pitch: float, *, closed: bool) -> int:
        """Turns the view towards two angles, the one with the larger error first."""
        agent = self.envs.agents[i]
        aside = _aside(agent, yaw)
        above = pitch - agent[PITCH]
        grip = actions.GRAB if closed else 0
        if abs(aside) > max(abs(above), _AIM_YAW):
            for share, right, left in (
                (0.6, actions.TURN_RIGHT, actions.TURN_LEFT),
                (0.1, actions.TURN_RIGHT_MID, actions.TURN_LEFT_MID),
                (0.0, actions.TURN_RIGHT_SLIGHTLY, actions.TURN_LEFT_SLIGHTLY),
            ):
                if abs(aside) >= share * _TURN:
                    return grip + (right if aside < 0 else left)
        if abs(above) > 0.5 * LOOK:
            return grip + (actions.LOOK_DOWN if above < 0 else actions.LOOK_UP)
        if abs(above) > _AIM_PITCH:
            return grip + (actions.LOOK_DOWN_MID if above < 0 else actions.LOOK_UP_MID)
        return grip

    def go(self, i: int, goals: NDArray[np.bool_]) -> int:
        """Walks the shortest way to one of the cells of `goals`, bool [rows, columns]."""
        agent = self.envs.agents[i]
        heading = self._way(i, goals, pushing=False)
        if math.isnan(heading):
            heading = self._way(i, goals, pushing=True)
        room = self.env.rooms[i]
        assert room is not None
        vx, vy = room.agent.velocity
        if math.isnan(heading):  # there is no way: move, so that something changes
            return actions.BACKWARD if self.env._lengths[i] // 8 % 2 else actions.TURN_LEFT
        # The change of velocity that is wanted, in the agent's own directions.
        dx = _SPEED * math.cos(heading) - _DECAY * vx
        dy = _SPEED * math.sin(heading) - _DECAY * vy
        cos, sin = math.cos(agent[YAW]), math.sin(agent[YAW])
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        if max(abs(ahead), abs(aside)) > _PUSH / 2:
            if abs(ahead) > abs(aside):
                return actions.FORWARD if ahead > 0 else actions.BACKWARD
            return actions.LEFT if aside > 0 else actions.RIGHT
        return actions.NOOP

    def _way(self, i: int, goals: NDArray[np.bool_], *, pushing: bool) -> float:
        """The heading of the shortest way to one of the cells of `goals`, radians; NaN if there is
        none. With `pushing` it may lead through objects, which are pushed aside."""
        distances = self._search(
            "way, pushing" if pushing else "way",
            i,
            self._poses(i) + goals.tobytes(),
            lambda: _distances(goals, _blocked(self.envs, i, pushing)),
        )
        return _heading(distances, self.envs.agents[i])

    def _search(
        self, what: str, i: int, depends_on: bytes, search: Callable[[], NDArray[Any]]
    ) -> NDArray[Any]:
        """What `search` finds in env `i`, or what it found last if that depended on the same."""
        found = self._found.get((what, i))
        if found is None or found[0] != depends_on:
            found = self._found[what, i] = depends_on, search()
        return found[1]

    def _poses(self, i: int) -> bytes:
        w = self.envs
        arrays = (w.ranks, w.hands, w.objects, w.orientation, w.furniture)
        return b"".join(array[i].tobytes() for array in arrays)


def _aside(agent: NDArray[np.float64], yaw: float) -> float:
    """How far a direction is to the left of the agent's view, radians, -pi to pi."""
    return float((yaw - agent[YAW] + math.pi) % (2 * math.pi) - math.pi)


def _inside(
    pose: NDArray[np.float64], size: NDArray[np.float64], inset: float, agent: NDArray[np.float64]
) -> tuple[float, float]:
    """The point nearest to the agent in a rectangle that is made smaller by `inset`."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = agent[AX] - pose[0], agent[AY] - pose[1]
    half_x, half_y = size[0] - min(inset, size[0]), size[1] - min(inset, size[1])
    x = min(max(cos * dx + sin * dy, -half_x), half_x)
    y = min(max(cos * dy - sin * dx, -half_y), half_y)
    return pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y


@compiled()
def _aim(agent, item, extent):
    """Turns the view of `agent` to the centre of an object."""
    dx, dy = item[X] - agent[AX], item[Y] - agent[AY]
    agent[YAW] = math.atan2(dy, dx)
    agent[PITCH] = math.atan2(item[Z] + extent[2] / 2 - EYE, math.hypot(dx, dy))


@compiled()
def _can_aim(agent, env):
    """Whether the target can be gripped from here; turns the view of `agent` to it.
    The view need not be turned more precisely than it can be."""
    _aim(agent, env.objects[0], env.extents[env.ranks[0]])
    yaw, pitch = agent[YAW], agent[PITCH]
    if pitch < hand.LOWEST + _AIM_PITCH or hand.pick(agent, env) != 0:
        return False
    sure = True
    for side in (-_AIM_YAW, _AIM_YAW):
        for rise in (-_AIM_PITCH, _AIM_PITCH):
            agent[YAW], agent[PITCH] = yaw + side, pitch + rise
            sure = sure and hand.pick(agent, env) == 0
    agent[YAW], agent[PITCH] = yaw, pitch
    return sure


@compiled()
def _centre(row, column):
    return (column + 0.5) * _CELL - ROOM / 2, (row + 0.5) * _CELL - ROOM / 2


@compiled()
def _viewpoints(agent, envs, i):
    """The cells from which the target can be gripped: bool [rows, columns]."""
    env = one_env(envs, i)
    target = env.objects[0]
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    there = agent.copy()
    for row in range(_CELLS):
        for column in range(_CELLS):
            there[AX], there[AY] = _centre(row, column)
            distance = math.hypot(there[AX] - target[X], there[AY] - target[Y])
            if distance < 0.55 or distance > 1.5:
                continue
            goals[row, column] = _can_aim(there, env)
    return goals


@compiled()
def _beside(pose, size, inset, closest):
    """The cells from which an object can be held over a support: bool [rows, columns]."""
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _centre(row, column)
            gap = rectangle_gap(pose, size, x, y)
            goals[row, column] = max(closest - inset, 0.35) + 0.05 <= gap <= 0.9 - inset
    return goals


@compiled()
def around(item, distance):
    """The cells that are nearer to an object than `distance`: bool [rows, columns]."""
    goals = np.zeros((_CELLS, _CELLS), np.bool_)
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _centre(row, column)
            goals[row, column] = math.hypot(x - item[X], y - item[Y]) < distance
    return goals


@compiled()
def _is_blocked(x, y, env, pushing):
    """Whether the agent would touch something at (x, y), or approach the wrong object.
    With `pushing` it may touch objects that it can push aside."""
    margin = AGENT_RADIUS + 0.03
    if max(abs(x), abs(y)) > ROOM / 2 - margin:
        return True
    objects, ranks = env.objects, env.ranks
    for j in range(ranks.size):
        if pushing and not env.finding:
            break
        if j == env.hand or (env.finding and j == 0) or objects[j, Z] > 0.1:
            continue
        clear = 0.85 * footprint(env.extents[ranks[j]]) + margin
        if env.finding:
            clear = APPROACH_DISTANCE + 0.25
        if math.hypot(x - objects[j, X], y - objects[j, Y]) < clear:
            return True
    if env.furnished:
        return rectangle_gap(env.furniture[0], FURNITURE_SIZE[0], x, y) < margin
    return False


@compiled()
def _blocked(envs, i, pushing):
    """The cells that the agent of env `i` keeps out of: bool [rows, columns].
    With `pushing` the way may lead through objects."""
    env = one_env(envs, i)
    blocked = np.zeros((_CELLS, _CELLS), np.bool_)
    for row in range(_CELLS):
        for column in range(_CELLS):
            x, y = _centre(row, column)
            blocked[row, column] = _is_blocked(x, y, env, pushing)
    return blocked


@compiled()
def _distances(goals, blocked):
    """The length of the shortest way from each cell to one of `goals`, float64 [rows, columns]."""
    distance = np.full((_CELLS, _CELLS), np.inf)
    for row in range(_CELLS):
        for column in range(_CELLS):
            if goals[row, column] and not blocked[row, column]:
                distance[row, column] = 0.0
    changed = True
    while changed:  # sweeps in opposite directions, until every distance is the shortest
        changed = False
        for sweep in range(2):
            for k in range(_CELLS * _CELLS):
                row, column = divmod(k if sweep == 0 else _CELLS * _CELLS - 1 - k, _CELLS)
                if not blocked[row, column]:
                    changed |= _shorten(distance, row, column)
    return distance


@compiled()
def _heading(distance, agent):
    """The direction of the nearby cell with the shortest way, radians; NaN if there is none."""
    # The best cell nearby rather than the agent's own, which an obstacle it touches may block.
    row = min(max(int((agent[AY] + ROOM / 2) / _CELL), 0), _CELLS - 1)
    column = min(max(int((agent[AX] + ROOM / 2) / _CELL), 0), _CELLS - 1)
    best, heading = np.inf, np.nan
    for r in range(max(row - 3, 0), min(row + 4, _CELLS)):
        for c in range(max(column - 3, 0), min(column + 4, _CELLS)):
            x, y = _centre(r, c)
            gap = math.hypot(x - agent[AX], y - agent[AY])
            length = distance[r, c] + 1.1 * gap
            if gap >= 0.02 and length < best:
                best, heading = length, math.atan2(y - agent[AY], x - agent[AX])
    return heading


@compiled()
def _shorten(distance, row, column):
    """Shortens the distance of a cell by way of its neighbours; whether that was possible."""
    least = distance[row, column]
    for r in range(max(row - 1, 0), min(row + 2, _CELLS)):
        for c in range(max(column - 1, 0), min(column + 2, _CELLS)):
            step = _CELL * math.sqrt((r - row) ** 2 + (c - column) ** 2)
            least = min(least, distance[r, c] + step)
    if least < distance[row, column] - 1e-9:
        distance[row, column] = least
        return True
    return False
