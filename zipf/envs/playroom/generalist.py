"""A scripted generalist: the expert, knowing of the room what has been in view."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.playroom import actions
from zipf.envs.playroom.constants import AGENT_RADIUS, FURNITURE_SIZE
from zipf.envs.playroom.expert import LOOK, Expert, around, require_playable
from zipf.envs.playroom.geometry import rectangle_gap
from zipf.envs.playroom.in_view import look
from zipf.envs.playroom.layout import FIRST_PITCH
from zipf.envs.playroom.levels import LIFT, NEAR, ON
from zipf.envs.playroom.state import AX, AY, PITCH, YAW, Envs, X
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.playroom.view import FIELD_OF_VIEW
from zipf.envs.remembering import Remembering

# Ours.
_NOWHERE = 1000.0  # coordinates of what has not been seen, metres: it is in nobody's way
_PITCHES = ((FIRST_PITCH, math.radians(-55)), (math.radians(-10), math.radians(-40)))
"""Views, radians, at which the room is searched by turns, first with an empty hand, then with a toy
in it: at lower views the toy would be so low that the bed and other toys were in its way."""
_SPOTS = np.array([(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
"""Places from which the room is searched again, metres."""
_THERE = 0.4  # distance at which a spot is reached, metres
_TOUCH = 0.02  # how near the agent comes to the bed when it bumps into it, metres
_WALK = 60  # steps after which it is given up


class Generalist(Remembering):
    """Plays all envs of a batch from what has been in view: `Generalist(env)()` is actions [N].

    It turns to the right until it sees the toy that the instruction names, and then does as the
    expert does; where it holds the toy and has not yet seen the bed or the tray that is named, it
    turns to the right until it sees that. A full turn without success is followed by one with the
    view lowered, and that by a walk to another place of the room.

    It knows the instruction, its own pose and speed, the room's walls, what it holds, and of toys,
    bed and tray the pose at which each was last in view in this episode: in the image and not
    behind something else, see `in_view.py`. Where a toy is not in view at the place where it was
    seen last, that place is forgotten. What has not been seen is to it not there, but it notices
    when it bumps into a bed that it has not seen, and turns until it sees it.

    It may be asked in envs in which another policy acts. It then remembers what was in view at
    every step at which it was asked, and how far the agent turned. Where it was not asked from the
    first step of an episode on, its memory begins when it was. Raises ValueError: the envs are of
    another engine, or have other actions: their episodes are questions.

    Args:
        env: the batch.
    """

    remembered = (
        *("_items", "_supports", "_objects", "_orientation", "_furniture"),
        *("_sweeps", "_turned", "_spots", "_walked"),
        *("_scenery", "_ranks", "_lengths", "_yaw"),
    )

    def __init__(self, env: PlayroomVectorEnv) -> None:
        require_playable(env, "generalist")
        self.env = env
        envs, n = env.envs, env.num_envs
        count = envs.ranks.shape[1]
        height, width = env.single_observation_space["image"].shape[:2]  # type: ignore[index]
        self._wide = math.tan(math.radians(FIELD_OF_VIEW) / 2)
        self._high = self._wide * height / width
        # What is remembered. The poses of what has not been seen are nowhere.
        self._items = np.zeros((n, count), np.bool_)
        self._supports = np.zeros((n, 2), np.bool_)
        self._objects = np.zeros_like(envs.objects)
        self._orientation = np.zeros_like(envs.orientation)
        self._furniture = np.zeros_like(envs.furniture)
        # The search: how often the room has been searched, how far this time, where next.
        self._sweeps = np.zeros(n, np.int64)
        self._turned = np.zeros(n)
        self._spots = np.full(n, -1, np.int64)
        self._walked = np.zeros(n, np.int64)
        # The episode that is remembered, and when this was last called.
        self._scenery = np.zeros((n, 4), np.uint64)
        self._ranks = np.zeros((n, count), np.int64)
        self._lengths = np.full(n, -1, np.int64)
        self._yaw = np.zeros(n)
        believed: Any = SimpleNamespace(
            num_envs=n, envs=envs, rooms=env.rooms, _lengths=env._lengths,
            single_action_space=env.single_action_space,
        )  # fmt: skip
        self._believed = believed
        self._expert = Expert(believed)

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every env, int64 [N]."""
        env = self.env
        moved = self._follow()
        envs = self._look()
        self._expert.envs = envs
        self._believed.rooms, self._believed._lengths = env.rooms, env._lengths
        return np.array([self._act(envs, i, bool(moved[i])) for i in range(env.num_envs)])

    def _follow(self) -> NDArray[np.bool_]:
        """Forgets the episodes before; returns which envs have moved since the last call, [N]."""
        envs, lengths = self.env.envs, self.env._lengths
        same = (lengths > 0) & (lengths >= self._lengths)
        same &= (envs.scenery == self._scenery).all(1) & (envs.ranks == self._ranks).all(1)
        moved = same & (lengths != self._lengths)
        new = ~same
        self._items[new] = self._supports[new] = False
        self._objects[new] = self._furniture[new] = _NOWHERE
        self._orientation[new] = np.eye(3)
        self._sweeps[new] = self._walked[new] = 0
        self._turned[new] = 0.0
        self._spots[new] = -1
        self._scenery[:], self._ranks[:], self._lengths[:] = envs.scenery, envs.ranks, lengths
        return moved

    def _look(self) -> Envs:
        """Adds what is in view now; returns the envs as they are remembered."""
        envs = self.env.envs
        items, supports = np.zeros_like(self._items), np.zeros_like(self._supports)
        look(envs, self._wide, self._high, items, supports)
        held = np.flatnonzero(envs.hands >= 0)
        items[held, envs.hands[held]] = True
        self._items |= items
        self._supports |= supports
        self._objects[items] = envs.objects[items]
        self._orientation[items] = envs.orientation[items]
        self._furniture[supports] = envs.furniture[supports]
        envs = envs._replace(
            objects=self._objects, orientation=self._orientation, furniture=self._furniture
        )
        # What would be in view now if it still were where it was.
        expected = np.zeros_like(items)
        look(envs, self._wide, self._high, expected, supports)
        gone = expected & ~items
        self._items[gone] = False
        self._objects[gone] = _NOWHERE
        if not envs.finding:
            return envs
        # Of two toys of the kind that is named it goes to the nearer.
        apart = np.linalg.norm(self._objects[:, :, :2] - envs.agents[:, None, :2], axis=2)
        swap = (envs.ranks[:, 0] == envs.ranks[:, 1]) & (apart[:, 1] < apart[:, 0])
        objects = self._objects.copy()
        objects[swap] = objects[swap, ::-1]
        return envs._replace(objects=objects)

    def _act(self, envs: Envs, i: int, moved: bool) -> int:
        task, holds = int(envs.task[i]), bool(envs.hands[i] == 0)
        if envs.hands[i] > 0:
            known = True  # it lets go of the wrong toy
        elif holds and task != LIFT and envs.lifted[i, 0]:
            known = bool(self._supports[i, task - (NEAR if task < ON else ON)])
        else:
            known = envs.objects[i, 0, X] != _NOWHERE
        yaw = float(envs.agents[i, YAW])
        if known and not self._bumps(i):
            self._sweeps[i], self._turned[i], self._spots[i] = 0, 0.0, -1
            action = self._expert.act(i)
        else:
            action = self._search(envs, i, moved, holds) + (actions.GRAB if holds else 0)
        self._yaw[i] = yaw
        return action

    def _bumps(self, i: int) -> bool:
        """Whether the agent touches a bed that it has not seen, and so has to look for it."""
        envs = self.env.envs
        if not envs.furnished or self._supports[i, 0]:
            return False
        agent = envs.agents[i]
        gap = rectangle_gap(envs.furniture[i, 0], FURNITURE_SIZE[0], agent[AX], agent[AY])
        return bool(gap < AGENT_RADIUS + _TOUCH)

    def _search(self, envs: Envs, i: int, moved: bool, holds: bool) -> int:
        """Turns to the right, and after a full turn looks elsewhere."""
        agent = envs.agents[i]
        if self._spots[i] >= 0:
            spot = _SPOTS[self._spots[i]]
            self._walked[i] += moved
            away = math.hypot(agent[AX] - spot[0], agent[AY] - spot[1])
            if away > _THERE and self._walked[i] < _WALK:
                return self._expert.go(i, around(spot, _THERE))
            self._spots[i] = -1
        pitch = _PITCHES[holds][self._sweeps[i] % 2]
        above = pitch - agent[PITCH]
        if abs(above) > 0.51 * LOOK:
            return actions.LOOK_UP if above > 0 else actions.LOOK_DOWN
        if moved:
            right = (self._yaw[i] - agent[YAW] + math.pi) % (2 * math.pi) - math.pi
            self._turned[i] = max(self._turned[i] + right, 0.0)
        if self._turned[i] >= 2 * math.pi:
            self._sweeps[i] += 1
            self._turned[i] = 0.0
            if self._sweeps[i] % 2 == 0:
                away = np.linalg.norm(_SPOTS - agent[[AX, AY]], axis=1)
                self._spots[i], self._walked[i] = away.argmax(), 0
            return self._search(envs, i, False, holds)
        return actions.TURN_RIGHT
