"""The psychlab level with a search: is there a pink T?"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.levels.psychlab import Psychlab, Staircase
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.screen import Place
from zipf.envs.labyrinth.world import World

START, CELLS, CELL = 15, 7, 14
"""Left and top of the cells in pixels of the screen, cells a side, and pixels of a cell. The
original's area of 0.8 of the screen, less its margin."""
SHAPES: dict[str, str] = {
    "T": "111 010 010",
    "inverted T": "010 010 111",
    "L": "100 100 111",
    "mirrored L": "001 001 111",
    "R": "111 100 100",
    "mirrored R": "111 001 001",
    "S": "011 010 110",
    "Z": "110 010 011",
}
"""Dots by name, rows from the top; the first is the target's."""
COLOURS: tuple[Colour, ...] = (
    (255, 0, 191), (255, 191, 0), (0, 255, 255), (0, 63, 255), (127, 0, 255)
)  # fmt: skip
"""The first is the target's."""
LADDER = (1, 1, 1, 2, 2, 4, 8, 16, 24, 32)
"""How many glyphs there are at each level of the staircase; from its last level on the last."""
MODES = ("shape", "colour", "conjunction")  # properties in which distractors differ from the target
BUTTONS: tuple[Place, ...] = ((0.35, 0.9, 0.45, 1.0), (0.55, 0.9, 0.65, 1.0))
ABSENT, PRESENT = 0, 1

_GAP = 2  # from a cell's left and top to its figure, pixels
_BITMAPS = np.array(
    [[[dot == "1" for dot in row] for row in rows.split()] for rows in SHAPES.values()]
)


def _images() -> NDArray[np.uint8]:
    """All figures on white, RGBA uint8 [shapes, colours, 11, 11, 4]. A dot is 3.5 pixels wide."""
    masks = np.zeros((len(SHAPES), 22, 22))
    masks[:, :21, :21] = _BITMAPS.repeat(7, 1).repeat(7, 2)
    share = masks.reshape(-1, 11, 2, 11, 2).mean((2, 4))[:, None, :, :, None]
    colours = np.array([(*colour, 255) for colour in COLOURS])[None, :, None, None, :]
    images: NDArray[np.uint8] = np.round(255 + share * (colours - 255)).astype(np.uint8)
    return images


_IMAGES = _images()


class VisualSearch(Psychlab):
    """Goal: tell whether a pink T is among the figures.

    Layout: a screen; see `psychlab.Psychlab`. Near the middle of its lower edge are, to the left,
    the button for an absent T and, to the right, the one for a present T.
    Rules: figures stand in different ones of 7 x 7 cells. There is a pink T with probability 1/2;
    the others, or all, are distractors, which in a trial differ from it either in shape (any other
    shape, pink), or in colour (a T of any other colour), or in either or both. A staircase sets how
    many figures there are, 1 to 32. The button that is looked at turns green if it is right, else
    red.
    Rewards: +1 for leaving the right button.
    Length: 80 trials, or the time limit. The buttons need looking down: with nine actions nothing
    can be answered.
    Approximated: the edges of figures are smoothed, since a dot is 3.5 pixels of the screen wide.
    """

    trials: ClassVar[int] = 80

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.staircase = Staircase()  # its level is that of `LADDER`, from 1

    def begin_trial(self) -> None:
        count = LADDER[min(self.staircase.level, len(LADDER)) - 1]
        present = bool(self.rng.integers(2))
        self.mode = MODES[int(self.rng.integers(len(MODES)))]
        self.figures = [self._distractor() for _ in range(count)]
        if present:  # the target, as (shape, colour)
            self.figures[0] = 0, 0
        cells = self.rng.choice(CELLS * CELLS, count, replace=False)
        for (shape, colour), cell in zip(self.figures, cells.tolist(), strict=True):
            row, column = divmod(cell, CELLS)
            left, top = (START + along * CELL + _GAP for along in (column, row))
            self.screen.paste(_IMAGES[shape, colour], left, top)
        self.ask(BUTTONS, PRESENT if present else ABSENT)

    def _distractor(self) -> tuple[int, int]:
        """Shape and colour of a figure that is no target."""
        if self.mode == "shape":
            return int(self.rng.integers(1, len(SHAPES))), 0
        if self.mode == "colour":
            return 0, int(self.rng.integers(1, len(COLOURS)))
        shape, colour = divmod(int(self.rng.integers(1, len(SHAPES) * len(COLOURS))), len(COLOURS))
        return shape, colour

    def answered(self, correct: bool) -> None:
        self.staircase.count(correct)
