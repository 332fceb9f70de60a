"""The psychlab level with a comparison: has the array of figures changed after a delay?"""

from __future__ import annotations

import numpy as np

from zipf.envs.labyrinth.levels.psychlab import CENTRE, LEFT, RIGHT, Psychlab, Staircase
from zipf.envs.labyrinth.materials import WHITE, Colour
from zipf.envs.labyrinth.screen import Place
from zipf.envs.labyrinth.state import FRAMES_PER_SECOND
from zipf.envs.labyrinth.world import World

STEP = 8  # units a side of a cell of the array in the middle of the screen, which has 64
POSITIONS = range(4, 60, STEP)  # positions of cells, in units from the array's left or top
START, UNIT = 16, 1.5
"""The array's left and top, and a unit, in pixels of the screen; it covers 0.75 of it."""
_BUTTON_AREA = (12, 20, 36, 44)
CELLS = tuple(
    (x, y) for y in POSITIONS for x in POSITIONS if not (x in _BUTTON_AREA and y in _BUTTON_AREA)
)
"""Where figures may be: not where the button that ends the study phase may be."""
BUTTON, RIM = 0.09375, 0.015625  # side of that button, and thickness of its frame
BUTTON_STARTS = (0.3125, 0.5625)  # its possible left and top
TURQUOISE: Colour = (59, 165, 170)
DELAYS = (8, 16, 32, 64, 128, 256)
"""Frames."""
COLOURS: tuple[Colour, ...] = (
    (255, 0, 0), (255, 191, 0), (127, 255, 0), (0, 255, 255), (0, 63, 255), (127, 0, 255),
    (255, 0, 191),
)  # fmt: skip
SQUARE, ORIENTATIONS = 0, 4
"""Form of a square; forms 1 .. 4 are the letter E, open to the left, right, top and bottom."""
DOMAINS = ("letters", "letter colours", "letter orientations", "squares", "all")
"""What the figures of a trial are; see `SequentialComparison`."""
Figure = tuple[int, int]  # form and colour

_FIGURE = 10  # pixels of the screen, of the 12 of a cell


def _forms() -> np.ndarray:
    """Masks of the forms, bool [5, 10, 10]: an E is a square with two notches."""
    forms = np.ones((1 + ORIENTATIONS, _FIGURE, _FIGURE), np.bool_)
    notch, deep = _FIGURE // 5, _FIGURE * 3 // 5
    right = forms[2]
    for start in (notch, 3 * notch):
        right[start : start + notch, _FIGURE - deep :] = False
    forms[1], forms[3], forms[4] = right[:, ::-1], np.rot90(right), np.rot90(right, -1)
    return forms


_IMAGES = np.where(
    _forms()[:, None, :, :, None],
    np.array([(*colour, 255) for colour in COLOURS], np.uint8)[None, :, None, None, :],
    np.uint8(255),
)
"""RGBA uint8 [forms, colours, 10, 10, 4], on white."""


class SequentialComparison(Psychlab):
    """Goal: tell whether an array of figures is the same as the one seen before.

    Layout: a screen; see `psychlab.Psychlab`. In the test, the button in the middle of its left
    edge stands for a different array, that of the right edge for the same.
    Rules: a trial shows some figures and, at one of four places around the middle, a small
    turquoise frame, which fills when it is looked at. When the gaze leaves it, the screen is empty
    for 8, 16, 32, 64, 128 or 256 frames. Then the figures are there again: the same with
    probability 1/2, or else exactly one has changed. The button that is looked at turns green if it
    is right, else red. How many figures there are follows a staircase from one on.
    Figures are squares or letters E, open to one of four sides, in seven colours. A trial has
    letters of any colour and orientation, or letters that differ in colour only, or in orientation
    only, or squares of any colour, or all of these. What may differ in a trial may change; with
    all, a square may also become a letter, and the reverse.
    Rewards: +1 for leaving the right button.
    Length: 60 trials, or the time limit. The turquoise frame needs looking up or down: with nine
    actions no test is ever reached.
    Approximated: figures fill five sixths of the side of their cells.
    """

    NEW, OLD = 0, 1

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.staircase = Staircase()  # its level is how many figures there are

    def begin_trial(self) -> None:
        self.domain = DOMAINS[int(self.rng.integers(len(DOMAINS)))]
        cells = self.rng.choice(len(CELLS), self.staircase.level, replace=False)
        common = self._any_figure()
        self.study = {CELLS[cell]: self._figure(common) for cell in cells.tolist()}
        self.test = dict(self.study)
        self.right = int(self.rng.integers(2))
        if self.right == self.NEW:
            changed = CELLS[int(cells[self.rng.integers(len(cells))])]
            self.test[changed] = self._changed(self.study[changed])
        self._show(self.study)
        self.phase = "study"  # then "delay", then "test"
        left, top = (BUTTON_STARTS[k] for k in self.rng.integers(2, size=2).tolist())
        self.button: Place = left, top, left + BUTTON, top + BUTTON
        self.screen.add_widget(self.button)
        self.screen.fill(self.button, TURQUOISE)
        inner = (left + RIM, top + RIM, left + BUTTON - RIM, top + BUTTON - RIM)
        self.screen.fill(inner, WHITE)
        self.wanted = self.button

    def react(self, button: int) -> None:
        if self.phase == "study":
            self.screen.fill(self.button, TURQUOISE)
        else:
            super().react(button)

    def looked_away(self, widget: int) -> None:
        if self.phase == "test":
            super().looked_away(widget)
            return
        self.screen.clear()
        self.phase = "delay"
        delay = DELAYS[int(self.rng.integers(len(DELAYS)))]
        self.world.set_timer(delay / FRAMES_PER_SECOND)
        self.wanted = CENTRE

    def went_off(self) -> None:
        if self.phase == "delay":
            self.phase = "test"
            self._show(self.test)
            self.ask((LEFT, RIGHT), self.right)
        else:
            super().went_off()

    def answered(self, correct: bool) -> None:
        self.staircase.count(correct)

    def _show(self, figures: dict[tuple[int, int], Figure]) -> None:
        for cell, (form, colour) in figures.items():
            left, top = (START + round(UNIT * at) + 1 for at in cell)
            self.screen.paste(_IMAGES[form, colour], left, top)

    def _any_figure(self) -> Figure:
        form = int(self.rng.integers(1, 1 + ORIENTATIONS))
        if self.domain == "squares" or (self.domain == "all" and self.rng.integers(2)):
            form = SQUARE
        return form, int(self.rng.integers(len(COLOURS)))

    def _figure(self, common: Figure) -> Figure:
        """One of the figures of a trial that have something in common."""
        form, colour = self._any_figure()
        if self.domain == "letter colours":
            form = common[0]
        elif self.domain == "letter orientations":
            colour = common[1]
        return form, colour

    def _changed(self, figure: Figure) -> Figure:
        """Another figure, which differs in something that the trial's domain allows."""
        form, colour = figure
        changes = {
            "letters": ("colour", "orientation"),
            "letter colours": ("colour",),
            "letter orientations": ("orientation",),
            "squares": ("colour",),
            "all": ("colour", "form") if form == SQUARE else ("colour", "form", "orientation"),
        }[self.domain]
        change = changes[int(self.rng.integers(len(changes)))]
        if change == "colour":
            return form, (colour + int(self.rng.integers(1, len(COLOURS)))) % len(COLOURS)
        if change == "orientation":
            turn = int(self.rng.integers(1, ORIENTATIONS))
            return 1 + (form - 1 + turn) % ORIENTATIONS, colour
        if form == SQUARE:
            return int(self.rng.integers(1, 1 + ORIENTATIONS)), colour
        return SQUARE, colour
