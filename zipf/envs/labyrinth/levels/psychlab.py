"""What the psychlab levels share: a player who only looks, a screen, trials and a staircase."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.screen import Place
from zipf.envs.labyrinth.state import FRAMES_PER_SECOND
from zipf.envs.labyrinth.steering import look_at
from zipf.envs.labyrinth.world import World

DISTANCE, HEIGHT, SIDE = 90.0, 51.0, 112.0
"""The screen's distance from the eye, its middle's height above the soles, its side; units."""
_FRAME, _DEEP, _PEDESTAL = 7.0, 4.0, 26.0
_DARK: Colour = (48, 50, 58)
START = math.radians(22.5)
"""The player looks at most this far to the left or right of the screen's middle at first."""
CENTRE: Place = (0.475, 0.475, 0.525, 0.525)  # the part of the fixation mark that begins a trial
_MARK, _ARM = 0.1, 0.03
LEFT: Place = (0.0, 0.45, 0.1, 0.55)
RIGHT: Place = (0.9, 0.45, 1.0, 0.55)
RED: Colour = (255, 0, 0)
BLACK: Colour = (0, 0, 0)
CORRECT: Colour = (100, 255, 100)
WRONG: Colour = (255, 100, 100)
_FRAME_SECONDS = 1.0 / FRAMES_PER_SECOND


class Psychlab(Episode):
    """Trials on a screen: look at the fixation mark, see something, look at a button.

    The player stands on a pedestal in the sky and cannot leave it: of an action only turning,
    looking up and looking down have an effect. A trial begins as soon as the gaze meets the middle
    of a red plus on the white screen. A button changes colour while it is looked at; when the gaze
    leaves it, the answer is given and rewarded. Then the screen is empty for a frame, and the next
    trial's plus appears. One frame of looking is enough for everything.

    Approximated: the screen has 128 x 128 pixels, the original's 512 or 256, of which a view of
    96 x 72 shows about 60; its frame, the pedestal and the sky are ours.
    """

    trials: ClassVar[int] = 60  # of an episode, at most; it ends after the last one

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        half, edge = _PEDESTAL / 2, SIDE / 2 + _FRAME
        world.add_floor((-half, -half), (half, half), "floor_10", repeat=_PEDESTAL)
        world.add_block((-half, -half, -20.0), (half, half, 0.0), "wall_10")
        world.add_block(
            (-edge, DISTANCE + 1.0, HEIGHT - edge),
            (edge, DISTANCE + _DEEP, HEIGHT + edge),
            "plain",
            tint=_DARK,
        )
        self.screen = world.add_screen(DISTANCE, HEIGHT, SIDE)
        self.buttons: tuple[Place, ...] = ()  # of the latest trial
        self.done = 0  # trials that have been answered

    def begin_map(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.world.place_player(0.0, 0.0, math.pi / 2 + rng.uniform(-START, START))
        self.world.hold_player(0.0, 0.0, 0.0)
        self._fixate()

    def _fixate(self) -> None:
        self.screen.clear()
        for wide, high in ((_MARK, _ARM), (_ARM, _MARK)):
            place = (0.5 - wide / 2, 0.5 - high / 2, 0.5 + wide / 2, 0.5 + high / 2)
            self.screen.fill(place, RED)
        self.screen.add_widget(CENTRE)
        self.wanted = CENTRE  # where the scripted policies look
        self.fixating = True

    @abstractmethod
    def begin_trial(self) -> None:
        """Shows a trial on the empty screen."""

    def answered(self, correct: bool) -> None:
        """A trial has ended."""

    def ask(self, buttons: tuple[Place, ...], right: int) -> None:
        """Shows black buttons, which answer the trial, at these places; `right` is one's number."""
        self.buttons, self.right = buttons, right
        for button in buttons:
            self.screen.add_widget(button)
            self.screen.fill(button, BLACK)
        self.wanted = buttons[right]

    def react(self, button: int) -> None:
        """A button is being looked at: shows whether it is right."""
        self.screen.fill(self.buttons[button], CORRECT if button == self.right else WRONG)

    def looked_at(self, widget: int) -> None:
        self.wanted = CENTRE
        if self.fixating:
            self.fixating = False
            self.screen.clear()
            self.begin_trial()
        else:
            self.react(widget)

    def looked_away(self, widget: int) -> None:
        correct = widget == self.right
        if correct:
            self.world.reward(1)
        self.answered(correct)
        self.screen.clear()
        self.done += 1
        if self.done == self.trials:
            self.world.end_episode()
        else:
            self.world.set_timer(_FRAME_SECONDS)

    def went_off(self) -> None:
        self._fixate()

    def act(self, known: Knowledge) -> int:
        """Looks at what is wanted. The screen shows, or has shown, all that tells what that is."""
        return look_at(self.world, self.screen, self.wanted)

    def guess(self, number: int) -> int:
        answering = self.wanted in self.buttons
        return look_at(self.world, self.screen, self.buttons[number] if answering else self.wanted)


class Staircase:
    """Difficulty that follows the answers, in blocks of as many trials as the level it is at.

    A block without errors leads a level up; one with at most half of the answers right, rounded
    down, leads a level down, but not below 1.
    """

    def __init__(self) -> None:
        self.level = 1  # from 1
        self._trials = self._correct = 0

    def count(self, correct: bool) -> None:
        """Counts an answer."""
        self._trials += 1
        self._correct += correct
        if self._trials < self.level:
            return
        if self._correct == self._trials:
            self.level += 1
        elif self._correct <= self._trials // 2:
            self.level = max(self.level - 1, 1)
        self._trials = self._correct = 0
