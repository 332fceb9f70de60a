"""The psychlab levels with pictures: which response belongs to one, and has it been seen before?"""

from __future__ import annotations

import numpy as np

from zipf.envs.labyrinth import pictures
from zipf.envs.labyrinth.levels.psychlab import CORRECT, LEFT, RIGHT, WRONG, Psychlab
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.screen import Place
from zipf.envs.labyrinth.world import World

SIZE, START = 96, 16
"""Side of a picture, 0.75 of the screen's, and its left and top, in pixels of the screen."""
BUTTONS: tuple[Place, ...] = ((0.45, 0.0, 0.55, 0.1), (0.45, 0.9, 0.55, 1.0), LEFT, RIGHT)
"""Buttons of the mapping: north, south, and what the original calls east and west."""
_TOLD_CORRECT: Colour = (100, 200, 100)
_TOLD_WRONG: Colour = (200, 100, 100)


class _Pictures(Psychlab):
    """Trials that show a picture."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        # different ones, in the order in which they first appear
        self.pictures = rng.choice(pictures.COUNT, self.trials, replace=False)

    def show(self, number: int) -> None:
        """Shows one of the episode's pictures."""
        self.screen.paste(pictures.draw(int(self.pictures[number]), SIZE), START, START)


class ArbitraryVisuomotorMapping(_Pictures):
    """Goal: learn which of four responses belongs to each picture.

    Layout: a screen; see `psychlab.Psychlab`. Buttons are in the middle of its four edges.
    Rules: a trial shows a picture and four black buttons. When one is looked at, the right one is
    green and the others are red. A pair of picture and response that is shown for the first time
    in the episode gives the answer away: its buttons are green and red, but dull, from the start.
    One pair is to be remembered at first. A block shows each pair once, in random order; after a
    block without errors there is one more pair. Pictures do not occur in two pairs; responses are
    drawn evenly.
    Rewards: +1 for leaving the right button.
    Length: 60 trials, or the time limit. Two of the buttons need looking up and down: with nine
    actions only the others can be answered.
    Approximated: pictures are procedural, see `pictures.py`; the original has 2400 photographs of
    objects that may not be passed on.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.responses = rng.integers(len(BUTTONS), size=self.trials)  # of each pair
        self.size = self.shown = 0  # how many pairs are to be remembered, and have been shown
        self.block: list[int] = []
        self.perfect = True

    def begin_trial(self) -> None:
        if not self.block:
            self.size += self.perfect
            self.perfect = True
            self.block = self.rng.permutation(self.size).tolist()
        self.pair = self.block.pop()
        self.show(self.pair)
        self.ask(BUTTONS, int(self.responses[self.pair]))
        if self.pair == self.shown:
            self.shown += 1
            self._colour(_TOLD_CORRECT, _TOLD_WRONG)

    def react(self, button: int) -> None:
        self._colour(CORRECT, WRONG)

    def answered(self, correct: bool) -> None:
        self.perfect &= correct

    def _colour(self, correct: Colour, wrong: Colour) -> None:
        for button, place in enumerate(BUTTONS):
            self.screen.fill(place, correct if button == self.right else wrong)


class ContinuousRecognition(_Pictures):
    """Goal: tell whether a picture has been shown before in the episode.

    Layout: a screen; see `psychlab.Psychlab`. In the middle of its left edge is the button for new
    pictures, in that of the right edge the one for old ones.
    Rules: the first picture is new. From then on one is new with probability 1/2, or else any of
    those that were shown before. The button that is looked at turns green if it is right, else red.
    Rewards: +1 for leaving the right button.
    Length: 60 trials, or the time limit. It needs no looking up and down.
    Approximated: pictures are procedural, see `pictures.py`; the original has 2400 photographs of
    objects that may not be passed on.
    """

    NEW, OLD = 0, 1

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.seen = 0  # how many pictures have been shown

    def begin_trial(self) -> None:
        old = self.seen > 0 and self.rng.random() < 0.5
        self.picture = int(self.rng.integers(self.seen)) if old else self.seen
        self.seen += not old
        self.show(self.picture)
        self.ask((LEFT, RIGHT), self.OLD if old else self.NEW)
