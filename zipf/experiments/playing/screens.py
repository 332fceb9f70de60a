"""Screens that show a picture with text below it and read keys: a window, a terminal."""

from __future__ import annotations

import codecs
import os
import re
import select
import sys
import textwrap
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from zipf.envs.keyboard import LEAVE
from zipf.envs.pictures import fit
from zipf.envs.window import open_display
from zipf.errors import UserError
from zipf.experiments.playing.captions import BACKGROUND, BRIGHT, DIM, FONT


@dataclass(frozen=True)
class Text:
    """The text below the picture."""

    lines: tuple[str, ...]  # always the same number, so that the layout is stable
    keys: tuple[str, ...]  # what the keys do, a few words each
    success: bool | None = None  # how the episode has ended; None: it goes on, or neither

    def wrapped(self, columns: int) -> tuple[list[str], list[str]]:
        """Lines and keys, wrapped to at most this number of columns."""
        lines = [part for line in self.lines for part in textwrap.wrap(line, columns) or [""]]
        # The words about one key stay on one line.
        words = "   ".join(key.replace(" ", "\N{NO-BREAK SPACE}") for key in self.keys)
        keys = textwrap.wrap(words, columns, break_on_hyphens=False)
        return lines, [line.replace("\N{NO-BREAK SPACE}", " ") for line in keys]


class Screen(Protocol):
    """A screen is open inside its context, and restores everything afterwards."""

    in_characters: bool  # whether pictures are drawn in characters, with few pixels

    def __enter__(self) -> Screen: ...

    def __exit__(self, *_: object) -> None: ...

    def show(self, picture: NDArray[np.uint8], text: Text) -> None:
        """Shows a picture, uint8 [height, width, 3], and the text."""

    def key(self, timeout: float | None) -> str | None:
        """The next key, by its name in `zipf.envs.keyboard`; `LEAVE` when the screen is closed.
        Waits for at most `timeout` seconds (None: without limit); None if no key was pressed."""


def open_screen(kind: str) -> Screen:
    """A screen of this kind: "window", "terminal", or "auto" for a window if possible.
    Raises UserError: this screen cannot be opened here; says why."""
    if kind == "terminal":
        return Terminal()
    try:
        return Window()
    except (ImportError, RuntimeError) as error:
        if kind == "window":
            raise UserError(f"screen=window: {error}; use screen=terminal") from None
        try:
            return Terminal()
        except UserError as other:
            raise UserError(f"no screen: {error}; {other}") from None


def _is_terminal() -> bool:
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout))


class Terminal:
    """The terminal: two pixels per character, upper and lower half, in 24-bit colour.

    Ctrl-C interrupts as usual. Ctrl-Z does nothing.
    Raises UserError: standard input or output is not a terminal, or on Windows.
    """

    in_characters = True

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise UserError("screen=terminal: needs Linux or macOS; choose screen=window")
        if not _is_terminal():
            raise UserError(
                "screen=terminal: standard input and output are not a terminal; "
                "policy=<name> record=FILE.gif records without a screen"
            )
        self._input, self._output = sys.stdin.fileno(), sys.stdout.fileno()
        self._decoder = codecs.getincrementaldecoder("utf-8")("ignore")
        self._keys: deque[str] = deque()
        self._size = os.terminal_size((0, 0))
        self._shown: tuple[NDArray[np.uint8], Text] | None = None

    def __enter__(self) -> Terminal:
        import termios  # here: Windows has none
        import tty

        self._before = termios.tcgetattr(self._input)
        tty.setcbreak(self._input)
        attributes = termios.tcgetattr(self._input)
        attributes[6][termios.VSUSP] = b"\0"  # Ctrl-Z would leave the terminal in this mode
        termios.tcsetattr(self._input, termios.TCSADRAIN, attributes)
        self._write("\x1b[?1049h\x1b[?25l")  # the alternate screen, no cursor
        return self

    def __exit__(self, *_: object) -> None:
        import termios

        try:
            self._write("\x1b[0m\x1b[?25h\x1b[?1049l")
            termios.tcsetattr(self._input, termios.TCSAFLUSH, self._before)
        except (OSError, termios.error):
            pass  # the terminal is gone

    def show(self, picture: NDArray[np.uint8], text: Text) -> None:
        self._shown = picture, text
        self._draw()

    def key(self, timeout: float | None) -> str | None:
        ends = time.monotonic() + (float("inf") if timeout is None else timeout)
        while not self._keys:
            left = ends - time.monotonic()
            ready, _, _ = select.select([self._input], [], [], max(min(left, 0.2), 0))
            if ready:
                self._keys.extend(self._read())
            elif left <= 0:
                return None
            elif self._shown and os.get_terminal_size(self._output) != self._size:
                self._draw()
        return self._keys.popleft()

    def _read(self) -> Iterator[str]:
        typed = ""
        while True:
            try:
                some = os.read(self._input, 1024)
            except OSError:
                some = b""
            if not some:
                yield LEAVE
                return
            typed += self._decoder.decode(some)
            # The bytes of a key may come in pieces; only waiting tells a lone Escape from others.
            if not _UNFINISHED.search(typed) or not select.select([self._input], [], [], 0.05)[0]:
                break
        yield from key_names(typed)

    def _draw(self) -> None:
        assert self._shown
        picture, text = self._shown
        self._size = os.get_terminal_size(self._output)
        columns, rows = self._size.columns or 80, self._size.lines or 24  # some report 0, 0
        lines, keys = text.wrapped(max(columns - 1, 1))
        below = [f"\x1b[1m{line}\x1b[0m" for line in lines] + [f"\x1b[2m{k}\x1b[0m" for k in keys]
        below = below[: max(rows - _FEWEST_ROWS, 0)]
        drawn = half_blocks(fit(picture, columns, 2 * (rows - len(below))))
        # Erasing after a line that fills its row would erase its last character.
        page = "\r\n".join(f"\x1b[K{line}" for line in drawn + below)
        self._write(f"\x1b[?2026h\x1b[H{page}\x1b[J\x1b[?2026l")  # one update, where supported

    def _write(self, text: str) -> None:
        left = memoryview(text.encode())
        while left:
            left = left[os.write(self._output, left) :]


_FEWEST_ROWS = 4  # of a picture, in the smallest terminal
_UNFINISHED = re.compile(r"\x1b(\[[0-9;]*|O)?$")
_KEY = re.compile(r"\x1b\[([0-9;]*)([A-Za-z~])|\x1bO(.)|(.)", re.DOTALL)
_FINALS = {
    **{"A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end"},
    **{chr(ord("p") + digit): str(digit) for digit in range(10)},  # the numeric pad
    "M": "enter",
}
_NUMBERS = {"1": "home", "7": "home", "4": "end", "8": "end", "5": "pageup", "6": "pagedown"}
_CONTROLS = {
    **{" ": "space", "\t": "tab", "\r": "enter", "\n": "enter"},
    **{"\x7f": "backspace", "\b": "backspace"},
}


def key_names(typed: str) -> Iterator[str]:
    """The names of the keys whose bytes a terminal sent."""
    for number, final, pad, character in _KEY.findall(typed):
        if final == "~":
            name = _NUMBERS.get(number.split(";")[0])
        elif final or pad:
            name = _FINALS.get(final or pad)
        elif character in _CONTROLS:
            name = _CONTROLS[character]
        else:
            name = character.lower() if character.isprintable() else None
        if name:
            yield name


def half_blocks(picture: NDArray[np.uint8]) -> list[str]:
    """The picture as lines of characters, one for every two rows of pixels."""
    if len(picture) % 2:
        picture = np.concatenate([picture, np.zeros_like(picture[:1])])
    lines = []
    for upper, lower in zip(picture[::2].tolist(), picture[1::2].tolist(), strict=True):
        line, last_upper, last_lower = [], None, None
        for above, below in zip(upper, lower, strict=True):
            if above != last_upper:
                line.append("\x1b[38;2;{};{};{}m".format(*above))
                last_upper = above
            if below != last_lower:
                line.append("\x1b[48;2;{};{};{}m".format(*below))
                last_lower = below
            line.append("▀")
        lines.append("".join([*line, "\x1b[0m"]))
    return lines


class Window:
    """A window, by pygame. Raises ImportError if that is not installed, and RuntimeError without a
    display."""

    in_characters = False

    def __init__(self) -> None:
        # Otherwise pygame prints a greeting.
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        self._pygame: Any = open_display()
        self._size = (0, 0)
        self._names = {
            getattr(self._pygame, f"K_{constant}"): name for constant, name in _CONSTANTS.items()
        }

    def __enter__(self) -> Window:
        self._pygame.font.init()
        self._pygame.display.set_caption("zipf")
        self._pygame.key.set_repeat(300, 70)  # milliseconds
        self._font = self._pygame.font.Font(FONT, _FONT_SIZE)
        return self

    def __exit__(self, *_: object) -> None:
        self._pygame.display.quit()
        self._pygame.font.quit()

    def show(self, picture: NDArray[np.uint8], text: Text) -> None:
        height, width, _ = picture.shape
        wide = max(width, _NARROWEST)
        columns = (wide - 2 * _MARGIN) // self._font.size("n")[0]
        lines, keys = text.wrapped(columns)
        colours = [BRIGHT] * len(lines) + [DIM] * len(keys)
        step = self._font.get_linesize()
        size = (wide, height + step * len(colours) + 2 * _MARGIN)
        if size != self._size:
            self._size = size
            self._surface = self._pygame.display.set_mode(size)
        self._surface.fill(BACKGROUND)
        surface = self._pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        self._surface.blit(surface, ((wide - width) // 2, 0))
        for i, (line, colour) in enumerate(zip(lines + keys, colours, strict=True)):
            drawn = self._font.render(line, True, colour)
            self._surface.blit(drawn, (_MARGIN, height + _MARGIN + i * step))
        self._pygame.display.flip()

    def key(self, timeout: float | None) -> str | None:
        ends = time.monotonic() + (float("inf") if timeout is None else timeout)
        while True:
            left = max(ends - time.monotonic(), 0)
            # Short waits, so that Ctrl-C in the terminal works.
            event = self._pygame.event.wait(max(int(1000 * min(left, 0.1)), 1))
            if event.type == self._pygame.QUIT:
                return LEAVE
            if event.type == self._pygame.VIDEOEXPOSE:
                self._pygame.display.flip()
            if event.type == self._pygame.KEYDOWN:
                name = self._names.get(event.key)
                if name is None and event.unicode.isprintable():
                    name = event.unicode.lower()
                if name:
                    return name
            # Whatever waits is read even where there is no time, as with a slow policy.
            if not left and event.type == self._pygame.NOEVENT:
                return None


_FONT_SIZE = 14
_MARGIN = 10  # pixels
_NARROWEST = 480  # pixels, of a window
_CONSTANTS = {
    **{"UP": "up", "DOWN": "down", "LEFT": "left", "RIGHT": "right"},
    **{"HOME": "home", "END": "end", "PAGEUP": "pageup", "PAGEDOWN": "pagedown"},
    **{"SPACE": "space", "TAB": "tab", "BACKSPACE": "backspace"},
    **{"RETURN": "enter", "KP_ENTER": "enter"},
    **{f"KP{digit}": str(digit) for digit in range(10)},
}
