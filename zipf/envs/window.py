"""Windows on the screen; they need pygame and a display."""

import os
import sys
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray


def open_display(instead: str = "") -> Any:
    """pygame, with its display opened. Raises ImportError if pygame is not installed, and
    RuntimeError if there is no display; the message ends with what to do `instead`."""
    try:
        import pygame
    except ImportError as error:
        raise ImportError(
            'a window needs pygame: pip install ".[human]" in a clone of zipf'
        ) from error
    missing = RuntimeError(f"a window needs a display, and none was found{instead}")
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in displays):
        raise missing  # without these SDL would try the bare console, or a window nobody sees
    try:
        pygame.display.init()
    except pygame.error as error:
        raise missing from error
    if pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in os.environ:
        pygame.display.quit()
        raise missing
    return pygame


class Window:
    """A window on the screen that shows frames at a steady rate.

    pygame has one window on the screen, which all these share: it shows the frame that came last,
    and is closed with the last of them.

    Raises:
        ImportError: if pygame is not installed.
        RuntimeError: if there is no display to open a window on.
    """

    def __init__(self, title: str, fps: int) -> None:
        self._pygame = open_display('; use render_mode="rgb_array"')
        self._fps = fps
        self._pygame.display.set_caption(title)
        self._clock = self._pygame.time.Clock()
        _OPEN.add(self)

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Shows a frame, uint8 [height, width, 3], and waits for its turn."""
        height, width, _ = frame.shape
        screen = self._pygame.display.get_surface()
        if screen is None or screen.get_size() != (width, height):
            screen = self._pygame.display.set_mode((width, height))
        self._pygame.event.pump()
        self._pygame.surfarray.blit_array(screen, frame.swapaxes(0, 1))
        self._pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        _OPEN.discard(self)
        if not _OPEN:
            self._pygame.display.quit()


_OPEN: weakref.WeakSet[Window] = weakref.WeakSet()
"""The windows that were not closed. Those that nobody has any more do not count."""
