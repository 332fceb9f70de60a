"""Frames for people to watch: the whole map of one env."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.maps import PAD, VIEW, Maps

SCALE = 3  # screen pixels per sprite pixel
_LINE = 2 / 3  # thickness of outlines in sprite pixels

_BACKGROUND = (24, 26, 32)
_SEEN = (235, 235, 235)
_TARGET = (255, 190, 60)

_WALL = 96  # 40 of 255, as in the agent's image, would be invisible where the map is darkened


@lru_cache(maxsize=2)
def _sprites(scale: int) -> NDArray[np.uint8]:
    """What cells look like to people, uint8 [codes, scale * 9, scale * 9, 3]. Objects have the grey
    background of cues: dark ones would be invisible on black."""
    drawn = sprites.SPRITES[0].copy()
    drawn[sprites.FIRST_LOOK :] = sprites.SPRITES[1, sprites.FIRST_LOOK :]
    drawn[sprites.WALL] = _WALL
    return drawn.repeat(scale, axis=1).repeat(scale, axis=2)


def frame(
    maps: Maps, map: int, target: int, row: int, column: int, scale: int = SCALE
) -> NDArray[np.uint8]:
    """The whole map of one env, with the cue in the corner.

    The agent's view is bright and outlined in white, the rest is darker. The cue and the target on
    the map are outlined in amber. Returns uint8 [height, width, 3], `scale` * 9 pixels a cell.

    Args:
        maps: the level's maps.
        map, target: the situation.
        row, column: where the agent is on the board.
        scale: screen pixels per pixel of the agent's image.
    """
    size = scale * sprites.CELL
    line = max(round(scale * _LINE), 1)
    board = maps.boards[map].copy()
    goal_row, goal_column = maps.cells[map, target].tolist()
    cue = board[goal_row, goal_column]
    if board[row, column] == sprites.FLOOR:
        board[row, column] = sprites.AGENT
    height, width = board.shape
    drawn = _sprites(scale)[board].swapaxes(1, 2).reshape(height * size, width * size, 3)

    top, left = max(row - PAD, 0), max(column - PAD, 0)
    seen = np.s_[top * size : (row + PAD + 1) * size, left * size : (column + PAD + 1) * size]
    shown = drawn // 8 * 5
    shown[seen] = drawn[seen]

    # As much margin as the agent's view extends beyond the board: walls are at its edge.
    margin = (PAD - 1) * size
    canvas = np.full(
        (height * size + 2 * margin, width * size + 2 * margin, 3), _BACKGROUND, dtype=np.uint8
    )
    canvas[margin:-margin, margin:-margin] = shown
    where = margin + row * size, margin + column * size
    if board[row, column] != sprites.AGENT:  # an object that is touched hides the agent
        _outline(canvas, *where, size, 2 * line, _SEEN)
    _outline(canvas, margin + goal_row * size, margin + goal_column * size, size, line, _TARGET)
    top, left = (at - PAD * size for at in where)
    _outline(canvas, top + line, left + line, VIEW * size - 2 * line, line, _SEEN)
    corner = np.s_[size // 2 : size // 2 + size]
    canvas[corner, corner] = _sprites(scale)[cue]
    _outline(canvas, size // 2, size // 2, size, line, _TARGET)
    return canvas


def _outline(
    canvas: NDArray[np.uint8],
    top: int,
    left: int,
    side: int,
    line: int,
    colour: tuple[int, int, int],
) -> None:
    """Frames a square of `side` pixels by lines of `line` pixels, clipped to the canvas."""
    rows = np.arange(canvas.shape[0])[:, None]
    columns = np.arange(canvas.shape[1])
    # The distance from the square, negative inside it.
    outside = np.maximum(
        np.maximum(top - rows, rows - (top + side - 1)),
        np.maximum(left - columns, columns - (left + side - 1)),
    )
    canvas[(outside > 0) & (outside <= line)] = colour
