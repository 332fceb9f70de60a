"""The contents of cells and their appearance: cell codes, colours, shapes and 9 x 9 sprites.

Codes (uint8): 0 floor, 1 wall, 2 agent, and `3 + 15 * colour + shape` for an object of that
colour and shape.
"""

import numpy as np
from numpy.typing import NDArray

FLOOR, WALL, AGENT, FIRST_LOOK = 0, 1, 2, 3
CELL = 9  # pixels
CUE_BACKGROUND = 180

COLOURS: dict[str, tuple[int, int, int]] = {
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
    "purple": (128, 0, 128),
    "orange": (255, 165, 0),
    "yellow": (255, 255, 0),
    "brown": (128, 64, 0),
    "pink": (255, 64, 255),
    "cyan": (0, 255, 255),
    "dark_green": (0, 100, 0),
    "dark_red": (100, 0, 0),
    "dark_blue": (0, 0, 100),
    "teal": (0, 100, 100),
    "lavender": (215, 200, 255),
    "rose": (255, 205, 230),
}


def _shapes() -> dict[str, NDArray[np.bool_]]:
    i, j = np.indices((CELL, CELL))
    middle = CELL // 2
    radius = (i - middle) ** 2 + (j - middle) ** 2
    border = [0, 1, 7, 8]
    centre_row, centre_column = abs(i - middle) <= 1, abs(j - middle) <= 1
    plus = centre_row | centre_column
    ex = (abs(i - j) <= 1) | (abs(8 - i - j) <= 1)
    sides = (j <= 2) | (j >= 6)
    return {
        "triangle": i >= 2 * abs(j - middle),
        "empty_square": np.isin(i, border) | np.isin(j, border),
        "plus": plus,
        "inverse_plus": ~plus,
        "ex": ex,
        "inverse_ex": ~ex,
        "circle": radius <= 16,
        "empty_circle": abs(radius - 16) < 6,
        "tee": centre_column | (i <= 2),
        "upside_down_tee": centre_column | (i >= 6),
        "h": sides | centre_row,
        "u": sides | (i >= 6),
        "upside_down_u": sides | (i <= 2),
        "vertical_stripes": j % 2 == 0,
        "horizontal_stripes": i % 2 == 0,
    }


SHAPES = _shapes()
NUM_LOOKS = len(COLOURS) * len(SHAPES)
NUM_CODES = FIRST_LOOK + NUM_LOOKS

_COLOUR_NAMES, _SHAPE_NAMES = list(COLOURS), list(SHAPES)


def code(colour: str, shape: str) -> int:
    """The cell code of an object of this colour and shape."""
    return FIRST_LOOK + _COLOUR_NAMES.index(colour) * len(SHAPES) + _SHAPE_NAMES.index(shape)


def _sprites() -> NDArray[np.uint8]:
    drawn = np.zeros((2, NUM_CODES, CELL, CELL, 3), dtype=np.uint8)
    drawn[0, WALL] = 40
    drawn[0, AGENT] = 255
    for colour, rgb in COLOURS.items():
        for shape, mask in SHAPES.items():
            drawn[0, code(colour, shape)] = mask[..., None] * np.array(rgb, dtype=np.uint8)
    drawn[1] = drawn[0]
    drawn[1][(drawn[1] == 0).all(axis=-1)] = CUE_BACKGROUND
    return drawn


SPRITES = _sprites()
"""uint8 [2, codes, 9, 9, 3]: the sprite of each code on black, and as a cue on grey."""
SPRITES.flags.writeable = False
