"""Recordings: frames to a film, a GIF or an MP4, or one to a still; without a screen."""

from __future__ import annotations

import os
import struct
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from zipf.errors import UserError

STILL = ".png"
ENDINGS = (".gif", ".mp4", STILL)
GIF_MAX_FPS = 10  # ours: of a faster recording a GIF shows every so many-th frame

_GIF_TICKS = 100  # a GIF counts time in hundredths of a second
_LONGEST = 2**16 - 1  # ticks that a GIF shows a frame
_COLOURS = 255  # of a frame of a GIF, and one that stands for no change


class Recording:
    """A file that frames are added to: a film (`.gif`, `.mp4`) or a still (`.png`), of one frame.

    It takes its name when the recording ends, also by an exception, with the frames added until
    then; without any frame there is none. An earlier file of that name is kept until then.

        with Recording(Path("out.gif"), fps=8) as recording:
            recording.add(frame)

    Frames are written as they come. In a GIF each has its own palette: images of at most 255
    colours are exact. An MP4 is H.264 with 4:2:0 chroma, the format that every browser plays; it
    needs even sizes, so that an odd one gains a row or a column.

    Args:
        path: ends in `.gif`, `.mp4` or `.png`.
        fps: frames per second. Of more than 10 a GIF shows every so many-th, at their time.

    Attributes:
        frames: how many were added.
        size: width and height of the frames, in pixels.
        bytes: how large the file is so far.
        written: whether the file has its name.

    Raises (here and in every method):
        UserError: another ending, no encoder for it, or the file cannot be written.
    """

    def __init__(self, path: Path, fps: float) -> None:
        check_recording(path)
        self.path = path
        self.fps = fps
        self.frames = 0
        self.size = (0, 0)
        self.written = False
        self._ending = path.suffix.lower()
        self._every = ceil(fps / GIF_MAX_FPS) if self._ending == ".gif" else 1
        self._encoder: _Encoder | None = None
        self._last = np.zeros((0, 0, 3), np.uint8)
        self._temporary = path.with_name(path.name + ".new")
        try:
            self._file = open(self._temporary, "wb")  # noqa: SIM115
        except OSError as error:
            raise self._cannot_be_written(error) from None

    @property
    def due(self) -> bool:
        """Whether the next frame will be shown; if not, any other can be added for it."""
        return self.frames % self._every == 0

    @property
    def bytes(self) -> int:
        return self._file.tell()

    def add(self, frame: NDArray[np.uint8] | None) -> None:
        """Adds a frame, uint8 [height, width, 3], all of one size. None: the last one again."""
        if frame is not None:
            self._last = frame
        try:
            if self._encoder is None:
                self.size = (self._last.shape[1], self._last.shape[0])
                self._encoder = self._open()
            self._encoder.write(self._last)
            self.frames += 1
        except OSError as error:
            raise self._cannot_be_written(error) from None

    def hold(self, seconds: float) -> None:
        """Shows the last frame for so long more, in whole frames."""
        for _ in range(ceil(seconds * self.fps)):
            self.add(None)

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._encoder is not None:
                self._encoder.close()
                self._file.close()
                os.replace(self._temporary, self.path)
                self.written = True
        except OSError as error:
            raise self._cannot_be_written(error) from None
        finally:
            self._file.close()
            self._temporary.unlink(missing_ok=True)

    def _open(self) -> _Encoder:
        if self._ending == STILL:
            return _Still(self._file)
        if self._ending == ".gif":
            return _Gif(self._file, self.fps, self.size)
        return _Mp4(self._file, self.fps, self.size)

    def _cannot_be_written(self, error: OSError) -> UserError:
        return UserError(f"record={self.path}: cannot be written: {error.strerror or error}")


def check_recording(path: Path) -> None:
    """Raises UserError for a recording that cannot be made, whatever it shows."""
    if path.suffix.lower() not in ENDINGS:
        raise UserError(f"record={path}: should end in {', '.join(ENDINGS[:-1])} or {STILL}")
    if path.is_dir():
        raise UserError(f"record={path}: is a folder; should be a file in one")
    if not path.expanduser().parent.is_dir():
        raise UserError(f"record={path}: there is no folder {path.parent}")
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


class _Encoder(Protocol):
    def write(self, frame: NDArray[np.uint8]) -> None: ...

    def close(self) -> None: ...


class _Still:
    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def write(self, frame: NDArray[np.uint8]) -> None:
        Image.fromarray(frame).save(self._file, "png", optimize=True)

    def close(self) -> None: ...


class _Gif:
    """Writes what changes from frame to frame. Pillow's own way keeps all frames in RAM, and looks
    for their palettes seven times as long."""

    def __init__(self, file: IO[bytes], fps: float, size: tuple[int, int]) -> None:
        self._file = file
        self._fps = fps
        self._frames = 0
        self._shown: NDArray[np.uint8] | None = None
        # What has changed last, which is written when it is known for how long it is shown: the
        # pixels of a part of the frame, which of them changed, and the part's place; and the number
        # of the frame that it came with.
        self._part: tuple[NDArray[np.uint8], NDArray[np.bool_], tuple[int, int]] | None = None
        self._since = 0
        forever = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"
        file.write(b"GIF89a" + struct.pack("<HHBBB", *size, 0x70, 0, 0) + forever)

    def write(self, frame: NDArray[np.uint8]) -> None:
        changed = np.ones(frame.shape[:2], np.bool_)
        if self._shown is not None and frame is not self._shown:
            changed = (frame != self._shown).any(axis=2)
        if frame is not self._shown and changed.any():
            self._finish()
            rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
            part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            self._part = frame[part], changed[part], (int(columns[0]), int(rows[0]))
            self._shown, self._since = frame, self._frames
        self._frames += 1

    def close(self) -> None:
        self._finish()
        self._file.write(b";")

    def _finish(self) -> None:
        if self._part is None:
            return
        # Frames end at the nearest whole tick, so that the whole lasts as long as it should.
        start, end = (round(i * _GIF_TICKS / self._fps) for i in (self._since, self._frames))
        pixels, changed, place = self._part
        image = Image.fromarray(np.ascontiguousarray(pixels))
        few = image.getcolors(_COLOURS) is not None
        # On images of few colours the first is exact; on others the second is as good and fast.
        way = Image.Quantize.MEDIANCUT if few else Image.Quantize.FASTOCTREE
        reduced = image.quantize(_COLOURS, way, dither=Image.Dither.NONE)
        palette = (reduced.getpalette() or [])[: 3 * _COLOURS]
        shown = Image.fromarray(np.where(changed, np.asarray(reduced), _COLOURS).astype(np.uint8))
        shown.putpalette(palette + [0] * (768 - len(palette)))
        lasts = 1000 // _GIF_TICKS * min(end - start, _LONGEST)
        self._file.writelines(
            GifImagePlugin.getdata(
                shown, place, duration=lasts, disposal=1, transparency=_COLOURS,
                include_color_table=True,
            )
        )  # fmt: skip


class _Mp4:
    def __init__(self, file: IO[bytes], fps: float, size: tuple[int, int]) -> None:
        import av

        self._frame = av.VideoFrame
        self._container: Any = av.open(file, "w", format="mp4")
        rate = Fraction(fps).limit_denominator(1000)
        self._stream: Any = self._container.add_stream("libx264", rate=rate)
        self._stream.pix_fmt = "yuv420p"
        self._stream.width, self._stream.height = (side + side % 2 for side in size)

    def write(self, frame: NDArray[np.uint8]) -> None:
        height, width, _ = frame.shape
        even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        self._container.mux(self._stream.encode(self._frame.from_ndarray(even, format="rgb24")))

    def close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
