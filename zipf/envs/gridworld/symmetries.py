"""The gridworld's symmetries: the view turned and mirrored, and what cells show likewise."""

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.gridworld.maps import MOVES, VIEW
from zipf.envs.gridworld.sprites import CELL

# The eight turns and reflections of a square, as matrices of (row, column); the first changes
# nothing.
_TURN = np.array([[0, 1], [-1, 0]])
_TURNS = [np.linalg.matrix_power(_TURN, k) for k in range(4)]
SQUARE = np.array(_TURNS + [turn @ np.diag([1, -1]) for turn in _TURNS])


class Symmetries:
    """Shows envs of another board: the same rules hold there.

    With images there are 32: 8 of the board times 4 turns of the objects' pictures, which are their
    own mirror images. The board turns about the agent while the cue stays in its corner. What the
    cue hid remains unknown: where it would come into view there is floor, and another cell is
    hidden instead. With tiles there are the 8 of the board.
    """

    def __init__(self, observations: gym.spaces.Dict, actions: gym.Space):
        pictures = len(_TURNS) if "image" in observations.spaces else 1
        self.count = 8 * pictures
        board = np.repeat(np.arange(8), pictures)
        moves = [tuple(move) for move in MOVES]
        turned = [[moves.index(tuple(turn @ move)) for move in moves] for turn in SQUARE]
        self.actions: NDArray[np.int64] = np.array(turned)[board]
        cells = sources(VIEW)
        places = np.where(np.arange(VIEW**2) == 0, 0, cells)  # the first cell is hidden
        if pictures > 1:
            pixels = _pixels_of_cells(cells, sources(CELL)[:pictures])
            places = (3 * pixels[..., None] + np.arange(3)).reshape(len(pixels), -1)
        self._places = places.astype(np.uint16)

    def __call__(
        self, observation: dict[str, NDArray], which: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> None:
        """Changes the observations `{name: [N, ...]}`, in place, where `mask` [N]."""
        shown = observation["image"] if "image" in observation else observation["tiles"]
        _turn(shown.reshape(len(shown), -1), which, mask, self._places)


def sources(side: int) -> NDArray[np.int64]:
    """For each symmetry and each place in a square, the place whose contents it shows, int64 [8,
    side * side]."""
    middle = side // 2
    places = np.indices((side, side)).reshape(2, -1) - middle
    rows, columns = np.moveaxis(SQUARE @ places, 1, 0) + middle
    return rows * side + columns


def _pixels_of_cells(cells: NDArray[np.int64], pictures: NDArray[np.int64]) -> NDArray[np.int64]:
    """As `sources`, for the pixels of the image and each symmetry of cells and pictures, int64
    [8 * len(pictures), 63 * 63]; 63 * 63 where there is floor in the place of the cue."""
    side = VIEW * CELL
    rows, columns = np.indices((side, side)).reshape(2, -1)
    cell, inside = rows // CELL * VIEW + columns // CELL, rows % CELL * CELL + columns % CELL
    found = []
    for board in cells:
        for picture in pictures:
            source = np.where(cell == 0, 0, board[cell])
            row = source // VIEW * CELL + picture[inside] // CELL
            column = source % VIEW * CELL + picture[inside] % CELL
            hidden = (cell != 0) & (source == 0)
            found.append(np.where(hidden, side * side, row * side + column))
    return np.array(found)


@compiled()
def _turn(shown, which, mask, sources):
    """Moves the bytes of observations uint8 [N, bytes] in place; black where the source is in a
    pixel past the last."""
    size = shown.shape[1]
    before = np.zeros(size + 3, np.uint8)
    for i in range(len(shown)):
        if mask[i] and which[i]:
            before[:size] = shown[i]
            target, places = shown[i], sources[which[i]]
            for j in range(size):
                target[j] = before[places[j]]
