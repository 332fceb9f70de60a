"""The state of a batch of playrooms, as the arrays that the compiled functions work on."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled

AX, AY, YAW, PITCH, HOLD, BASE = range(6)
"""Columns of `agents`: pose, distance of the held object from the eye, its height when gripped."""
X, Y, ANGLE, Z, VZ = range(5)
"""Columns of `objects`: pose of the middle on the floor plane, height of the lowest point of the
(rotated) bounding box, vertical speed."""

FLOOR, AIR, HELD, ON_BED, ON_TRAY = range(5)  # values of `status`: where an object is
GROUND_LAYER, RAISED_LAYER, LOW_LAYER, CARRIED_LAYER, HELD_LAYER, BED_LAYER, TRAY_LAYER = range(7)
"""Values of `layers`: what an object collides with, see `room.py`."""


class Envs(NamedTuple):
    """The state of N envs of one level, with C objects each, of which the target is the first.

    Compiled functions check no bounds: ranks, tasks and held objects must be in range.
    """

    finding: bool  # whether the task is to approach the target (`supervised/` levels)
    furnished: bool  # whether there are a bed and a tray
    near_failure: bool
    """Whether a wrong object near a support ends an episode that asks for one near a support."""
    reach: float  # of the hand from the eye, metres
    extents: NDArray[np.float64]  # bounding boxes of the objects by rank, [50, 3], metres
    ranks: NDArray[np.int64]  # of the objects that are there, [N, C]
    task: NDArray[np.int64]  # [N], see `levels.TASKS`
    scenery: NDArray[np.uint64]  # [N, 4]: the random stream of an episode's poses and colours
    agents: NDArray[np.float64]  # [N, 6], columns AX .. BASE
    hands: NDArray[np.int64]  # [N]: the held object, or -1
    spots: NDArray[np.float64]
    """Where the held object has room, [N, 3], as `holding.find_room` wrote it last; meaningless
    where nothing is held."""
    objects: NDArray[np.float64]  # [N, C, 5], columns X .. VZ
    orientation: NDArray[np.float64]  # rotation matrices of the objects, [N, C, 3, 3]
    furniture: NDArray[np.float64]  # x, y, angle of bed and tray, [N, 2, 3]
    status: NDArray[np.int64]  # [N, C]: FLOOR .. ON_TRAY
    still: NDArray[np.int64]
    """[N, C]: for how many actions an object has been at rest, counted up to STILL_STEPS."""
    lifted: NDArray[np.bool_]  # [N, C]: whether an object has been lifted in this episode
    colours: NDArray[np.uint8]
    """Main and accent colours of the objects, then of bed and tray, [N, C + 2, 2, 3]."""


class Env(NamedTuple):
    """One of the `Envs`: where things are."""

    finding: bool
    furnished: bool
    reach: float
    extents: NDArray[np.float64]
    ranks: NDArray[np.int64]
    hand: int
    objects: NDArray[np.float64]
    orientation: NDArray[np.float64]
    furniture: NDArray[np.float64]


@compiled()
def one_env(envs, i):
    """Env number `i`, to be passed to functions that are called often.
    Its arrays are views. Passing all of `Envs` takes longer than such a function."""
    return Env(
        envs.finding, envs.furnished, envs.reach, envs.extents, envs.ranks[i],
        envs.hands[i], envs.objects[i], envs.orientation[i], envs.furniture[i],
    )  # fmt: skip


class Commands(NamedTuple):
    """Commands to the physics that follow from the actions of a step."""

    layers: NDArray[np.int64]  # [N, C]: GROUND_LAYER .. TRAY_LAYER, for each object
    forces: NDArray[np.float64]  # on the agents, [N, 2], newtons
    drives: NDArray[np.float64]
    """Velocities of the held objects, [N, 2], m/s; meaningless where nothing is held."""
    turned: NDArray[np.int64]
    """[N]: an object that was just released, to be placed at its new angle, or -1."""


def make_envs(num_envs: int, num_objects: int, **level: Any) -> Envs:
    """The state of envs in which no episode has begun; `level` are its fields before `ranks`."""
    n, count = num_envs, num_objects
    return Envs(
        **level,
        ranks=np.zeros((n, count), np.int64),
        task=np.zeros(n, np.int64),
        scenery=np.zeros((n, 4), np.uint64),
        agents=np.zeros((n, 6)),
        hands=np.full(n, -1, np.int64),
        spots=np.zeros((n, 3)),
        objects=np.zeros((n, count, 5)),
        orientation=np.zeros((n, count, 3, 3)),
        furniture=np.zeros((n, 2, 3)),
        status=np.zeros((n, count), np.int64),
        still=np.zeros((n, count), np.int64),
        lifted=np.zeros((n, count), np.bool_),
        colours=np.zeros((n, count + 2, 2, 3), np.uint8),
    )


def make_commands(num_envs: int, num_objects: int) -> Commands:
    """Commands to be written by `hand.control`."""
    return Commands(
        layers=np.zeros((num_envs, num_objects), np.int64),
        forces=np.zeros((num_envs, 2)),
        drives=np.zeros((num_envs, 2)),
        turned=np.full(num_envs, -1, np.int64),
    )
