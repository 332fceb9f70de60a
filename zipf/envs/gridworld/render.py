"""Frames for people to watch: the whole map of one env."""

import numpy as np
from numpy.typing import NDArray

from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.maps import PAD, VIEW, Maps

_SCALE = 3  # screen pixels per sprite pixel
_CELL = _SCALE * sprites.CELL
_LINE = 2  # thickness of outlines in screen pixels

_BACKGROUND = (24, 26, 32)
_SEEN = (235, 235, 235)
_TARGET = (255, 190, 60)

# Walls of 40 of 255, as in the agent's image, would be invisible where the map is darkened.
_SPRITES = sprites.SPRITES.copy()
_SPRITES[0, sprites.WALL] = 96
_SPRITES = _SPRITES.repeat(_SCALE, axis=2).repeat(_SCALE, axis=3)


def frame(maps: Maps, map: int, target: int, row: int, column: int) -> NDArray[np.uint8]:
    """The whole map of one env, with the cue above it.

    The agent's view is bright and outlined in white, the rest is darker. The cue and the target on
    the map are outlined in amber. Returns uint8 [height, width, 3], 27 pixels a cell.

    Args:
        maps: the level's maps.
        map, target: the situation.
        row, column: where the agent is on the board.
    """
    board = maps.boards[map].copy()
    goal_row, goal_column = maps.cells[map, target].tolist()
    cue = board[goal_row, goal_column]
    if board[row, column] == sprites.FLOOR:
        board[row, column] = sprites.AGENT
    height, width = board.shape
    drawn = _SPRITES[0][board].swapaxes(1, 2).reshape(height * _CELL, width * _CELL, 3)

    top, left = max(row - PAD, 0), max(column - PAD, 0)
    seen = np.s_[top * _CELL : (row + PAD + 1) * _CELL, left * _CELL : (column + PAD + 1) * _CELL]
    shown = drawn // 8 * 5
    shown[seen] = drawn[seen]

    # One cell of margin on each side, and a row of its own for the cue.
    header = 3 * _CELL
    canvas = np.full(
        (header + (height + 1) * _CELL, (width + 2) * _CELL, 3), _BACKGROUND, dtype=np.uint8
    )
    canvas[header:-_CELL, _CELL:-_CELL] = shown
    canvas[_CELL : 2 * _CELL, _CELL : 2 * _CELL] = _SPRITES[1, cue]
    _outline(canvas, header + (row - PAD) * _CELL, (column - PAD + 1) * _CELL, VIEW, _SEEN)
    _outline(canvas, _CELL, _CELL, 1, _TARGET)
    _outline(canvas, header + goal_row * _CELL, (goal_column + 1) * _CELL, 1, _TARGET)
    return canvas


def _outline(
    canvas: NDArray[np.uint8], top: int, left: int, cells: int, colour: tuple[int, int, int]
) -> None:
    """Draws a square frame around `cells` x `cells` cells, clipped to the canvas."""
    rows = np.arange(canvas.shape[0])[:, None]
    columns = np.arange(canvas.shape[1])
    size = cells * _CELL
    # The distance from the square, negative inside it.
    outside = np.maximum(
        np.maximum(top - rows, rows - (top + size - 1)),
        np.maximum(left - columns, columns - (left + size - 1)),
    )
    canvas[(outside > 0) & (outside <= _LINE)] = colour
