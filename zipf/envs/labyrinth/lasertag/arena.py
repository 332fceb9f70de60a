"""The state of laser tag in a batch of envs: fighters, gadgets, supplies, shots.

Fighter 0 is the player; the others are opponents. Lengths
are in units. A second has 60 frames; periods that are stated in milliseconds are counted by the 16
ms of physics that a frame has, as the original counts them.
"""

from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FIGHTERS = 4  # most of them in an env
SECOND = 60  # frames
MILLISECONDS = 16  # duration of a frame of physics

IMPULSE, RAPID, ORB, BEAM, DISC = range(5)  # gadgets
HEALTH_PACK, ARMOUR_PACK = 5, 6  # kinds of supplies beside the gadgets ORB, BEAM and DISC
NOTHING = -1
DAMAGE = np.array([50, 7, 100, 8, 100])
PERIOD = np.array([400, 100, 800, 50, 1500])
"""Milliseconds from shot to shot."""
REACH = np.array([32.0, 1e4, 1e4, 768.0, 1e4])
AMMUNITION = np.array([0, 100, 10, 100, 10])
"""Shots that a gadget comes with. Impulse needs none."""
MOST_AMMUNITION = 200
MOST_HEALTH, FIRST_HEALTH, MOST_ARMOUR, PACK = 100, 125, 200, 50
RETURN = np.array([0, 0, 5, 5, 5, 35, 25]) * SECOND
"""Frames until a supply that was taken is there again, by kind."""
DROP_LIFE = 30 * SECOND
REST, LONGEST_REST = round(1.7 * SECOND), round(21.7 * SECOND)
"""Frames after which a tagged fighter may respawn by firing, and respawns by itself."""

HEALTH, ARMOUR, GADGET, WAIT, TAGGED_AT, SLIDE, CLOCK, TAGS = range(8)
LOADED = 8
"""Columns of `status`: health; armour; the gadget in hand; milliseconds until it is ready; the
frame at which the fighter was tagged, or -1; milliseconds of reduced control; milliseconds since
health last decayed; tags of others less tags of itself; and from LOADED on shots by gadget."""

(
    ENEMY, SEEN_AT, LAST_SEEN, LAST_ROW, LAST_COLUMN, GOAL_ROW, GOAL_COLUMN, FIELD_ROW,
    FIELD_COLUMN, SIDE, SIDE_UNTIL, SHOOT_UNTIL, PAUSE_UNTIL, STAY_UNTIL, AIM_YAW, AIM_PITCH,
    WISH_X, WISH_Y, TRIGGER, ATTACKER, ATTACKED_AT,
) = range(21)  # fmt: skip
"""Columns of `minds`: the enemy, or -1; frames at which it came in view and was last in view, and
the cell where; the cell that the opponent goes to, and that its field leads to; the side to which
it strafes, 1 right or -1 left, and until which frame; until which frames it shoots, holds its fire,
and stays where it is; where it wants to look; the direction in which it wants to go; whether it
holds the trigger; which fighter hurt it, and when."""

SPAWNS, SUPPLIES, SHOTS, TRACES, FLASHES = 12, 24, 16, 12, 8  # capacities of each env
SHOOTER, BORN = 6, 7  # columns of `shots` after place and direction: the shooter, and the frame
TRACE_FRAME, TRACE_GADGET = 6, 7  # columns of `traces` after start and end
FLASH_FRAME, FLASH_KIND = 3, 4  # columns of `flashes` after the place
SPARK, BLAST, PUFF = range(3)
"""Kinds of flashes: a hit, an orb that bursts, a fighter that vanishes."""


class Combat(NamedTuple):
    """The state of laser tag in N envs."""

    fighters: NDArray[np.int64]
    """[N]: how many there are; 0: there is no combat, and the rest has no meaning."""
    bodies: NDArray[np.float64]  # [N, FIGHTERS, 8], as `Envs.bodies`, of which row 0 is a copy
    status: NDArray[np.int64]  # [N, FIGHTERS, columns]
    minds: NDArray[np.float64]  # [N, FIGHTERS, columns]: of opponents
    fields: NDArray[np.int16]
    """[N, FIGHTERS, GRID, GRID]: steps to the cell that an opponent goes to; -1: no way."""
    spawns: NDArray[np.int64]  # [N, SPAWNS, 2]: cells
    spawn_count: NDArray[np.int64]  # [N]
    kinds: NDArray[np.int64]
    """[N, SUPPLIES]: what the env's first items are; NOTHING: a place for what is dropped."""
    until: NDArray[np.int64]
    """[N, SUPPLIES]: the frame at which something that was dropped vanishes; -1: it stays."""
    shots: NDArray[np.float64]  # [N, SHOTS, 8]: flying orbs; SHOOTER -1: none
    traces: NDArray[np.float64]  # [N, TRACES, 9]: the last shots that need no time, for the view
    flashes: NDArray[np.float64]  # [N, FLASHES, 5]: what flashed last, for the view
    written: NDArray[np.int64]  # [N, 2]: how many traces and flashes there were
    points: NDArray[np.int64]
    """[N, 2]: points that the player has won and lost and that its episode was not told yet."""
    stream: NDArray[np.uint64]  # [N, 4]: the random stream of the fights, see `pcg64`


def make_combat(num_envs: int, grid: int) -> Combat:
    """The state of envs without combat, whose text maps have `grid` rows and columns."""
    n = num_envs
    combat = Combat(
        fighters=np.zeros(n, np.int64),
        bodies=np.zeros((n, FIGHTERS, 8)),
        status=np.zeros((n, FIGHTERS, LOADED + len(DAMAGE)), np.int64),
        minds=np.zeros((n, FIGHTERS, ATTACKED_AT + 1)),
        fields=np.full((n, FIGHTERS, grid, grid), -1, np.int16),
        spawns=np.zeros((n, SPAWNS, 2), np.int64),
        spawn_count=np.zeros(n, np.int64),
        kinds=np.full((n, SUPPLIES), NOTHING, np.int64),
        until=np.full((n, SUPPLIES), -1, np.int64),
        shots=np.zeros((n, SHOTS, BORN + 1)),
        traces=np.zeros((n, TRACES, TRACE_GADGET + 1)),
        flashes=np.zeros((n, FLASHES, FLASH_KIND + 1)),
        written=np.zeros((n, 2), np.int64),
        points=np.zeros((n, 2), np.int64),
        stream=np.zeros((n, 4), np.uint64),
    )
    combat.shots[:, :, SHOOTER] = -1
    combat.traces[:, :, TRACE_FRAME] = -(10**6)
    combat.flashes[:, :, FLASH_FRAME] = -(10**6)
    return combat


_one_combat = cache(partial(make_combat, 1))


def clear_combat(combat: Combat, i: int) -> None:
    """Ends the combat of an env."""
    first = _one_combat(combat.fields.shape[-1])
    for name in Combat._fields:
        getattr(combat, name)[i] = getattr(first, name)[0]
