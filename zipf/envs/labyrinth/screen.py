"""A square screen in front of the player, with parts that tell when it looks at them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth.gaze import gaze
from zipf.envs.labyrinth.materials import WHITE, Colour
from zipf.envs.labyrinth.mover import EYE
from zipf.envs.labyrinth.scenery import SCREEN_PIXELS, Scenery
from zipf.envs.labyrinth.state import WIDGETS, Envs, X, Y, Z

Place = tuple[float, float, float, float]
"""Left, top, right and bottom, as shares of the screen's side from its top left corner."""


class Screen:
    """The screen of an env: white, without widgets.

    What is shown is painted at once into the image that the renderer samples, at events only.
    """

    def __init__(self, envs: Envs, scenery: Scenery, number: int) -> None:
        self._envs = envs
        self._number = number
        self._image = scenery.scenes.screen[number]
        self.clear()

    def clear(self) -> None:
        """Removes everything."""
        self._image[:] = 255
        self._widgets = 0
        self._envs.widgets[self._number] = 0.0
        self._envs.watched[self._number] = -1

    def add_widget(self, place: Place) -> int:
        """Adds a part that tells when it is looked at; the number of those since `clear`."""
        widget = self._widgets
        if widget >= WIDGETS:
            raise ValueError(f"a screen has room for {WIDGETS} widgets")
        self._widgets += 1
        self._envs.widgets[self._number, widget] = place
        return widget

    def fill(self, place: Place, colour: Colour = WHITE) -> None:
        """Paints a rectangle."""
        left, top, right, bottom = (round(SCREEN_PIXELS * share) for share in place)
        self._image[top:bottom, left:right] = *colour, 255

    def paste(self, image: NDArray[np.uint8], left: int, top: int) -> None:
        """Paints an image, RGBA uint8 [height, width, 4], with its top left corner at a pixel."""
        height, width, _ = image.shape
        self._image[top : top + height, left : left + width] = image

    # What oracles read.

    @property
    def gaze(self) -> tuple[float, float]:
        """x and y of where the player looks; see `gaze.gaze`."""
        x, y = gaze(self._envs, self._number)
        return float(x), float(y)

    def direction(self, x: float, y: float) -> tuple[float, float]:
        """Yaw and pitch at which the player looks at a point of the screen, radians."""
        body = self._envs.bodies[self._number]
        east, north, height, side = self._envs.screen[self._number]
        right, ahead = east + (x - 0.5) * side - body[X], north - body[Y]
        up = height + (0.5 - y) * side - (body[Z] + EYE)
        return math.atan2(ahead, right), math.atan2(up, math.hypot(ahead, right))
