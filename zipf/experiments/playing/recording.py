"""Recordings: frames to a GIF or an MP4 file, without a screen."""

from __future__ import annotations

import os
from math import ceil
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError

ENDINGS = (".gif", ".mp4")
GIF_MAX_FPS = 50  # browsers play frames shorter than 1/50 s five times slower than meant

_GIF_TICKS = 100  # a GIF counts time in hundredths of a second


def usual_fps(env: ZipfVectorEnv) -> float:
    """Frames per second of a recording of envs: as fast as they are, where a GIF can be so."""
    return min(env.metadata["render_fps"], GIF_MAX_FPS)


class Recording:
    """A video file that frames are added to.

    The file is written when the recording ends, also by an exception, with the frames added until
    then; without any frame none is written. An earlier file of that name is kept until then.

        with Recording(Path("out.gif"), fps=8) as recording:
            recording.add(frame)

    A GIF has its own palette of 256 colours for each frame, so that images of few colours are
    exact; its frames stay in RAM until it is written. An MP4 is H.264 with 4:2:0 chroma, the format
    that every browser plays; it needs even sizes, so that an odd one gains a row or a column.

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
        self._ending = path.suffix.lower()
        check_recording(path, fps)
        self._writer: Any = None
        self._durations: list[int] = []  # milliseconds, of each frame of a GIF
        self._last = np.zeros((0, 0, 3), np.uint8)
        self._temporary = path.with_name(path.name + ".new")
        try:
            self._file = open(self._temporary, "wb")  # noqa: SIM115
        except OSError as error:
            raise self._cannot_be_written(error) from None

    def add(self, frame: NDArray[np.uint8], *, repeat: int = 1) -> None:
        """Adds a frame, uint8 [height, width, 3], all of one size, `repeat` times."""
        self._last = frame
        try:
            if self._writer is None:
                self.size = (frame.shape[1], frame.shape[0])
                self._writer = self._open()
            for _ in range(repeat):
                self._write(frame)
                self.frames += 1
        except OSError as error:
            raise self._cannot_be_written(error) from None

    def hold(self, seconds: float) -> None:
        """Shows the last frame for so long more, in whole frames."""
        self.add(self._last, repeat=ceil(seconds * self.fps))

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._writer is not None:
                self._writer.close()
                self._file.close()
                os.replace(self._temporary, self.path)
                self.written = True
        except OSError as error:
            raise self._cannot_be_written(error) from None
        finally:
            self._file.close()
            self._temporary.unlink(missing_ok=True)

    def _open(self) -> Any:
        if self._ending == ".gif":
            return iio.imopen(self._file, "w", plugin="pillow", extension=".gif")
        writer: Any = iio.imopen(self._file, "w", plugin="pyav", extension=".mp4", container="mp4")
        writer.init_video_stream("libx264", fps=self.fps, pixel_format="yuv420p")
        return writer

    def _write(self, frame: NDArray[np.uint8]) -> None:
        if self._ending == ".gif":
            # Frames end at the nearest whole tick, so that the whole lasts as long as it should.
            start, end = (round(i * _GIF_TICKS / self.fps) for i in (self.frames, self.frames + 1))
            self._durations.append(1000 // _GIF_TICKS * (end - start))
            # Without save_all Pillow takes no list of durations for a GIF of one frame.
            timing = {"duration": self._durations, "save_all": True, "loop": 0, "disposal": 1}
            self._writer.write(frame, **timing)
        else:
            width, height = self.size
            even = ((0, height % 2), (0, width % 2), (0, 0))
            self._writer.write_frame(np.pad(frame, even, mode="edge"))

    def _cannot_be_written(self, error: OSError) -> UserError:
        return UserError(f"record={self.path}: cannot be written: {error.strerror or error}")


def check_recording(path: Path, fps: float) -> None:
    """Raises UserError for a recording that cannot be made, whatever it shows."""
    if path.suffix.lower() not in ENDINGS:
        raise UserError(f"record={path}: should end in {' or '.join(ENDINGS)}")
    if path.suffix.lower() == ".gif" and fps > GIF_MAX_FPS:
        raise UserError(f"fps={fps}: a GIF shows at most {GIF_MAX_FPS} frames per second")
    if path.suffix.lower() == ".mp4":
        _check_video_library()


def _check_video_library() -> None:
    try:
        import av  # noqa: F401
    except ImportError:
        raise UserError(
            'record: an .mp4 needs PyAV: pip install ".[video]" in a clone of zipf; a .gif needs '
            "nothing more"
        ) from None
