"""A scripted generalist: it knows the rule of the game, and of the map what it has seen."""

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.gridworld.expert import require_gridworld
from zipf.envs.gridworld.kernels import COLUMN, MAP, ROW, TARGET
from zipf.envs.gridworld.maps import MOVES, PAD, VIEW
from zipf.envs.gridworld.sprites import FLOOR, WALL
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.remembering import Remembering

UNSEEN = 255  # what is known of a cell that has not been in view; no cell code

_MOVES = np.array(MOVES)
_FAR = 1 << 30
# The finaliser of SplitMix64: G. L. Steele et al., "Fast splittable pseudorandom number
# generators", 2014.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)
_HALF, _LOW = np.uint64(32), np.uint64(0xFFFFFFFF)


class Generalist(Remembering):
    """Plays all envs of a batch from what has been in view: `Generalist(env)()` is actions [N].

    It knows the cue, the rules of moving, and the cells that have been in its 7 x 7 view in this
    episode, but not the top left one, which the cue covers. Once it has seen the cued object, and a
    way there through floor that it has seen, it goes the shortest such way. Until then it moves to
    whichever neighbouring floor cell it has been to least often in this episode, and touches no
    object. Between cells alike it chooses by a hash of the env's random stream, which is left as it
    is, and of the step: the same in a batch of any size.

    It may be asked in envs in which another policy acts. It then remembers what was in view, and
    where the agent stood, at every step at which it was asked. Where it was not asked from the
    first step of an episode on, its memory begins when it was. Asked again before the envs have
    moved, it gives the same actions.
    Raises ValueError: the batch is not one of a single gridworld level.

    Args:
        env: the batch.
        memory: False: it knows what is in view now and nothing else, and moves to a random
            neighbouring cell until it sees a way to the cued object.
    """

    remembered = ("_known", "_visits", "_episodes", "_streams", "_lengths")

    def __init__(self, env: GridworldVectorEnv, *, memory: bool = True) -> None:
        require_gridworld(env, "generalist")
        self._env = env
        self._memory = memory
        shape = (env.num_envs, *env.level.maps.codes.shape[1:])
        # By cell of the board with its margin, as in `Maps.codes`.
        self._known = np.full(shape, UNSEEN, dtype=np.uint8)
        self._visits = np.zeros(shape, dtype=np.int32)
        # The episode that is remembered, and its length when this was last called.
        self._episodes = np.zeros((env.num_envs, 2), dtype=np.int64)
        self._streams = np.zeros((env.num_envs, 4), dtype=np.uint64)
        self._lengths = np.full(env.num_envs, -1, dtype=np.int64)

    def __call__(self) -> NDArray[np.int64]:
        """The next action of every env, int64 [N]."""
        env, maps = self._env, self._env.level.maps
        _look(
            self._memory, env._envs, env._streams, env._lengths, maps.codes,
            self._episodes, self._streams, self._lengths, self._known, self._visits,
        )  # fmt: skip
        actions = np.empty(env.num_envs, dtype=np.int64)
        envs = env._envs
        goals = maps.cells[envs[:, MAP], envs[:, TARGET]] + PAD
        cues = maps.codes[envs[:, MAP], goals[:, 0], goals[:, 1]]
        places = envs[:, ROW : COLUMN + 1] + PAD
        ties = _hashes(env._streams, env._lengths)
        _choose(places, cues, self._known, self._visits, ties, actions)
        return actions


@compiled()
def _look(memory, envs, streams, lengths, codes, episodes, last, asked, known, visits):
    """Follows the envs: forgets the episodes before, and adds what is in view now.

    Args:
        memory: False: everything is forgotten first.
        envs, streams, lengths: the state of the envs.
        codes: of `Maps`.
        episodes, last, asked: map and target, stream, and length of the episode when an env was
            last looked at, int64 [N, 2], uint64 [N, 4] and int64 [N], written.
        known: cell codes that have been seen, uint8 [N, rows + 6, columns + 6], written.
        visits: at how many steps the agent was in a cell, int32 of that shape, written.
    """
    for i in range(len(envs)):
        map, row, column = envs[i, MAP], envs[i, ROW], envs[i, COLUMN]
        same = lengths[i] > 0 and lengths[i] >= asked[i]
        for k in range(2):
            same &= episodes[i, k] == envs[i, k]
            episodes[i, k] = envs[i, k]
        for k in range(4):
            same &= last[i, k] == streams[i, k]
            last[i, k] = streams[i, k]
        if not same or not memory:
            known[i] = UNSEEN
            visits[i] = 0
        if not same or not memory or lengths[i] != asked[i]:
            visits[i, row + PAD, column + PAD] += 1
        asked[i] = lengths[i]
        for r in range(VIEW):
            for c in range(VIEW):
                if r > 0 or c > 0:  # the cue covers the top left cell
                    known[i, row + r, column + c] = codes[map, row + r, column + c]


@compiled()
def _hashes(streams, lengths):
    """A pseudo-random number for each env and step, uint64 [N]."""
    found = np.empty(len(lengths), np.uint64)
    for i in range(len(lengths)):
        value = streams[i, 0]
        for word in (streams[i, 1], np.uint64(lengths[i])):
            value = (value ^ word) + _GOLDEN
            value = (value ^ (value >> _SHIFT_1)) * _MIX_1
            value = (value ^ (value >> _SHIFT_2)) * _MIX_2
            value ^= value >> _SHIFT_3
        found[i] = value
    return found


@compiled()
def _choose(places, cues, known, visits, ties, actions):
    """Chooses actions int64 [N] from what is known of the envs, and from nothing else.

    Args:
        places: row and column of the agents in `known`, int64 [N, 2].
        cues: codes of the objects to find, uint8 [N].
        known, visits: see `_look`.
        ties: random numbers, uint64 [N].
    """
    rows, columns = known.shape[1:]
    steps = np.empty((rows, columns), np.int32)
    queue = np.empty((rows * columns, 2), np.int64)
    for i in range(len(places)):
        row, column = places[i]
        action = _way(known[i], row, column, cues[i], steps, queue)
        if action < 0:
            action = _wander(known[i], visits[i], row, column, ties[i])
        actions[i] = action


@compiled()
def _is_open(known, row, column, down, right):
    """Whether walls that are known leave a move possible, and no unknown ones may block it."""
    if known[row + down, column + right] == WALL:
        return False
    if down == 0 or right == 0:
        return True
    beside, below = known[row, column + right], known[row + down, column]
    return (beside != WALL and beside != UNSEEN) or (below != WALL and below != UNSEEN)


@compiled()
def _way(known, row, column, cue, steps, queue):
    """The first move of the shortest known way to the cued object, or -1 if none is known.
    A breadth-first search from the object on; `steps` and `queue` are overwritten."""
    goal_row = goal_column = -1
    rows, columns = known.shape
    for r in range(rows):
        for c in range(columns):
            if known[r, c] == cue:
                goal_row, goal_column = r, c
    if goal_row < 0:
        return -1
    steps[:] = _FAR
    steps[goal_row, goal_column] = 0
    queue[0, 0], queue[0, 1] = goal_row, goal_column
    first, last = 0, 1
    while first < last and steps[row, column] == _FAR:
        r, c = queue[first]
        first += 1
        for move in range(len(_MOVES)):
            down, right = _MOVES[move]
            # The way back is open where this one is.
            if not _is_open(known, r, c, down, right):
                continue
            to_row, to_column = r + down, c + right
            if known[to_row, to_column] == FLOOR and steps[to_row, to_column] == _FAR:
                steps[to_row, to_column] = steps[r, c] + 1
                queue[last, 0], queue[last, 1] = to_row, to_column
                last += 1
    best, chosen = steps[row, column], -1
    if best == _FAR:
        return -1
    for move in range(len(_MOVES)):
        down, right = _MOVES[move]
        if _is_open(known, row, column, down, right) and steps[row + down, column + right] < best:
            best, chosen = steps[row + down, column + right], move
    return chosen


@compiled()
def _wander(known, visits, row, column, tie):
    """A move to the least visited neighbouring floor cell; any move if objects leave none."""
    least, count = _FAR, 0
    candidates = np.empty(len(_MOVES), np.int64)
    for move in range(len(_MOVES)):
        down, right = _MOVES[move]
        if known[row + down, column + right] != FLOOR or not _is_open(
            known, row, column, down, right
        ):
            continue
        visited = visits[row + down, column + right]
        if visited < least:
            least, count = visited, 0
        if visited == least:
            candidates[count] = move
            count += 1
    if count == 0:
        return np.int64(((tie & _LOW) * np.uint64(len(_MOVES))) >> _HALF)
    return candidates[np.int64(((tie & _LOW) * np.uint64(count)) >> _HALF)]
