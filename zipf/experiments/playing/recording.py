"""Recordings: frames to a GIF or an MP4 file, with no screen."""

from __future__ import annotations

import itertools
import os
from collections import deque
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import IO, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from zipf.experiments.errors import UserError

ENDINGS = (".gif", ".mp4")
GIF_MAX_FPS = 50  # browsers play frames shorter than 1/50 s five times slower than meant

_GIF_TICKS = 100  # a GIF counts time in hundredths of a second


class _Encoder(Protocol):
    def add(self, frame: NDArray[np.uint8]) -> None: ...

    def finish(self) -> None: ...


class Recording:
    """A video file that frames are added to.

    The file is there when the recording ends, however it ends, with the frames added until then;
    without any, none is written. A file that was there before is kept until then.

        with Recording(Path("out.gif"), fps=8) as recording:
            recording.add(frame)

    Args:
        path: ends in `.gif` or `.mp4`.
        fps: frames per second.

    Raises (here and in every method):
        UserError: another ending, no encoder for it, too many frames per second for a GIF, or
            the file cannot be written.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path = path
        self.fps = fps
        self.frames = 0
        self.size = (0, 0)  # width, height
        self.written = False
        ending = path.suffix.lower()
        if ending not in ENDINGS:
            raise UserError(f"record={path}: should end in {' or '.join(ENDINGS)}")
        if ending == ".gif" and fps > GIF_MAX_FPS:
            raise UserError(f"fps={fps}: a GIF shows at most {GIF_MAX_FPS} frames per second")
        self._make_encoder = _Gif if ending == ".gif" else _Mp4
        if ending == ".mp4":
            _av()
        self._encoder: _Encoder | None = None
        self._last = np.zeros((0, 0, 3), np.uint8)
        self._temporary = path.with_name(path.name + ".new")
        try:
            self._file = open(self._temporary, "wb")  # noqa: SIM115
        except OSError as error:
            raise UserError(f"record={path}: cannot be written: {error.strerror}") from None

    def add(self, frame: NDArray[np.uint8], *, repeat: int = 1) -> None:
        """Adds a frame, uint8 [height, width, 3], all of one size, `repeat` times."""
        self._last = frame
        try:
            if self._encoder is None:
                self.size = (frame.shape[1], frame.shape[0])
                self._encoder = self._make_encoder(self._file, self.fps, self.size)
            for _ in range(repeat):
                self._encoder.add(frame)
                self.frames += 1
        except OSError as error:
            raise UserError(f"record={self.path}: cannot be written: {error.strerror}") from None

    def hold(self, seconds: float) -> None:
        """Shows the last frame for so long more, in whole frames."""
        self.add(self._last, repeat=ceil(seconds * self.fps))

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._encoder is not None:
                self._encoder.finish()
                self._file.close()
                os.replace(self._temporary, self.path)
                self.written = True
        except OSError as problem:
            raise UserError(f"record={self.path}: cannot be written: {problem.strerror}") from None
        finally:
            self._file.close()
            self._temporary.unlink(missing_ok=True)


class _Gif:
    """Keeps all frames until the end, with one byte a pixel: a GIF is for what is short."""

    def __init__(self, file: IO[bytes], fps: float, size: tuple[int, int]) -> None:
        self.file = file
        self.fps = fps
        self.frames: deque[Image.Image] = deque()

    def add(self, frame: NDArray[np.uint8]) -> None:
        # Each frame has its own palette; the gridworld's, of few colours, are exact.
        image = Image.fromarray(frame)
        self.frames.append(image.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE))

    def finish(self) -> None:
        ends = [round(i * _GIF_TICKS / self.fps) for i in range(len(self.frames) + 1)]
        lasts = [1000 // _GIF_TICKS * (b - a) for a, b in itertools.pairwise(ends)]
        first = self.frames.popleft()
        rest = (self.frames.popleft() for _ in range(len(self.frames)))
        first.save(
            self.file, "GIF", save_all=True, append_images=rest, duration=lasts, loop=0, disposal=1
        )


class _Mp4:
    """H.264, as every browser plays it: an even number of pixels each way, 4:2:0."""

    def __init__(self, file: IO[bytes], fps: float, size: tuple[int, int]) -> None:
        self.av = _av()
        width, height = size
        self.margin = ((0, height % 2), (0, width % 2), (0, 0))
        self.container = self.av.open(file, "w", format="mp4")
        self.stream = self.container.add_stream(
            "libx264", rate=Fraction(fps).limit_denominator(1000)
        )
        self.stream.width, self.stream.height = width + width % 2, height + height % 2
        self.stream.pix_fmt = "yuv420p"
        self.stream.options = {"crf": "18"}  # no loss that the eye sees

    def add(self, frame: NDArray[np.uint8]) -> None:
        padded = np.ascontiguousarray(np.pad(frame, self.margin, mode="edge"))
        self._write(self.av.VideoFrame.from_ndarray(padded, format="rgb24"))

    def finish(self) -> None:
        self._write(None)
        self.container.close()

    def _write(self, frame: object) -> None:
        for packet in self.stream.encode(frame):
            self.container.mux(packet)


def _av():
    try:
        import av
    except ImportError:
        raise UserError(
            'record: an .mp4 needs PyAV: pip install "zipf-rl[video]"; a .gif needs nothing more'
        ) from None
    return av
