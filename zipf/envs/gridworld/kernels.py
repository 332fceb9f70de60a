"""The gridworld's rules and observations for a batch of envs, compiled.

An env's state is one row of `envs`, int64 [N, 4]: map, target, row, column. Its observation
depends on nothing else.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from zipf.compiled import compiled
from zipf.envs.gridworld.maps import MOVES, PAD, VIEW
from zipf.envs.gridworld.sprites import AGENT, CELL, FIRST_LOOK, FLOOR, NUM_CODES, SPRITES, WALL
from zipf.envs.pcg64 import choice

MAP, TARGET, ROW, COLUMN = range(4)

_BLOCK = 32
_STRIPE = 3 * CELL  # bytes of one pixel row of a cell
_LINE = VIEW * _STRIPE  # bytes of one pixel row of an image
_SPRITE = CELL * _BLOCK  # bytes of a sprite in STRIPES
_MOVES = np.array(MOVES)

STRIPES = np.zeros((2, NUM_CODES, CELL, _BLOCK), dtype=np.uint8)
"""`SPRITES`, with each pixel row padded to one block."""
STRIPES[..., :_STRIPE] = SPRITES.reshape(2, NUM_CODES, CELL, _STRIPE)


def _copier(size: int) -> Any:
    """A compiled function that copies `size` bytes between two addresses in one load and store.
    Numba compiles a copy of 27 bytes to a loop or a call; a vector of 32 takes two instructions."""

    def copy(typingctx: Any, destination: Any, source: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            vector = ir.VectorType(ir.IntType(8), size).as_pointer()
            value = builder.load(builder.inttoptr(args[1], vector), align=1)
            builder.store(value, builder.inttoptr(args[0], vector), align=1)
            return context.get_dummy_value()

        return types.void(types.intp, types.intp), codegen

    return intrinsic(copy)


_copy_block = _copier(_BLOCK)
_copy_half = _copier(_BLOCK // 2)


@compiled()
def begin(mask, forced, map_cdf, target_cdf, cells, streams, envs):
    """Starts an episode in every env of `mask` (bool [N]).

    Map and target are always drawn, in this order, and then replaced by `forced` (int64 [2, N])
    where that is not negative: forcing a situation does not shift an env's random stream.
    """
    for i in range(len(envs)):
        if not mask[i]:
            continue
        map = choice(streams[i], map_cdf)
        target = choice(streams[i], target_cdf)
        if forced[0, i] >= 0:
            map = forced[0, i]
        if forced[1, i] >= 0:
            target = forced[1, i]
        envs[i, MAP] = map
        envs[i, TARGET] = target
        envs[i, ROW] = cells[map, -1, 0]
        envs[i, COLUMN] = cells[map, -1, 1]


@compiled(references=False)
def move_one(env, action, codes, cells):
    """Steps one environment, whose state int64 [4] is written, by an action in 0 .. 7. Returns
    whether the agent touches the target, and whether it touches any object."""
    map, row, column = env[MAP], env[ROW] + PAD, env[COLUMN] + PAD
    down, right = _MOVES[action, 0], _MOVES[action, 1]
    blocked = codes[map, row + down, column + right] == WALL
    if down != 0 and right != 0:
        blocked |= codes[map, row + down, column] == WALL and (
            codes[map, row, column + right] == WALL
        )
    if not blocked:
        row += down
        column += right
        env[ROW] = row - PAD
        env[COLUMN] = column - PAD
    goal = cells[map, env[TARGET]]
    touched = codes[map, row, column] >= FIRST_LOOK
    return goal[0] == row - PAD and goal[1] == column - PAD, touched


@compiled()
def move(mask, actions, codes, cells, max_steps, lengths, envs, reward, terminated, truncated):
    """Steps the envs of `mask`, whose state is written.

    Args:
        max_steps: the length at which an episode is truncated.
        lengths: of the episodes with this step, int64 [N].
        reward, terminated, truncated: float64, bool, bool [N], written.
    """
    for i in range(len(envs)):
        if not mask[i]:
            continue
        reward[i], touched = move_one(envs[i], actions[i], codes, cells)
        terminated[i] = touched
        truncated[i] = not touched and lengths[i] >= max_steps


@compiled()
def draw_tiles(mask, envs, codes, cells, tiles, cue):
    """Writes the observations of the envs of `mask` as cell codes: the agent's view uint8 [N, 7, 7]
    to `tiles`, the code of the target uint8 [N, 1] to `cue`."""
    for i in range(len(envs)):
        if not mask[i]:
            continue
        map, row, column = envs[i, MAP], envs[i, ROW], envs[i, COLUMN]
        tiles[i] = codes[map, row : row + VIEW, column : column + VIEW]
        if tiles[i, PAD, PAD] == FLOOR:
            tiles[i, PAD, PAD] = AGENT
        tiles[i, 0, 0] = FLOOR
        goal = cells[map, envs[i, TARGET]]
        cue[i, 0] = codes[map, goal[0] + PAD, goal[1] + PAD]


@compiled()
def draw_images(mask, envs, codes, cells, stripes, image):
    """Draws the observations of the envs of `mask` to `image`, uint8 [N, 63, 63, 3].

    A pixel row of a cell has 27 bytes. It is written as one block of 32, of which the next cell
    overwrites the last 5. In the last cell of a line it is written as two blocks of 16 that
    overlap, so that the second one ends where the line does.
    """
    sprites = np.empty((VIEW, VIEW), dtype=np.intp)
    source = stripes.ctypes.data
    for i in range(len(envs)):
        if not mask[i]:
            continue
        map, row, column = envs[i, MAP], envs[i, ROW], envs[i, COLUMN]
        for r in range(VIEW):
            for c in range(VIEW):
                sprites[r, c] = source + _SPRITE * np.intp(codes[map, row + r, column + c])
        if codes[map, row + PAD, column + PAD] == FLOOR:
            sprites[PAD, PAD] = source + _SPRITE * AGENT
        goal = cells[map, envs[i, TARGET]]
        cue = np.intp(codes[map, goal[0] + PAD, goal[1] + PAD])
        sprites[0, 0] = source + _SPRITE * (NUM_CODES + cue)

        line = image[i].ctypes.data
        for r in range(VIEW):
            for stripe in range(CELL):
                offset = stripe * _BLOCK
                for c in range(VIEW - 1):
                    _copy_block(line + c * _STRIPE, sprites[r, c] + offset)
                last = sprites[r, VIEW - 1] + offset
                _copy_half(line + _LINE - _STRIPE, last)
                _copy_half(line + _LINE - _BLOCK // 2, last + _STRIPE - _BLOCK // 2)
                line += _LINE
