"""Checkpoints: one file, replaced atomically, guarded by a checksum, loaded without running code.

The file is a line `zipf checkpoint 1 <sha256 of the rest>` and what `torch.save` wrote. It is
hashed as it is written and read, so that no copy of it is in memory: a replay may be most of what
there is.
"""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, BinaryIO, cast

import numpy as np
import torch

from zipf.errors import UserError, reading
from zipf.experiments.records.replacing import replacing

_MAGIC = b"zipf checkpoint 1 "


def save(path: Path, state: dict[str, Any]) -> None:
    """Writes nested dictionaries and lists of tensors, arrays, numbers and strings.

    The file at `path` is the old one or the new one, never something between.
    Raises UserError: the disk is full or cannot be written; the old file is as it was.
    """
    try:
        with replacing(path) as file:
            file.write(_header(hashlib.sha256()))
            payload = _Hashed(file)
            torch.save(_map(state, np.ndarray, torch.from_numpy), cast(BinaryIO, payload))
            if payload.error:
                raise payload.error
            file.seek(0)
            file.write(_header(payload.hash))
    except OSError as error:
        kept = "; the checkpoint before it is kept" if path.exists() else ""
        raise UserError(f"{path}: cannot be written: {error.strerror}{kept}") from None


def load(path: Path) -> dict[str, Any]:
    """Reads what `save` wrote; arrays come back as tensors on the CPU.
    Raises UserError: the file is missing or is not, to the last bit, what was written."""
    try:
        with reading(path), open(path, "rb") as file:
            header = file.read(len(_header(hashlib.sha256())))
            if not header.startswith(_MAGIC):
                raise UserError(
                    f"{path}: is not a checkpoint of this version, or its head is damaged"
                )
            if header != _header(hashlib.file_digest(file, "sha256")):
                raise UserError(
                    f"{path}: is damaged (its checksum does not match); restore it from a copy, or "
                    "remove its folder to train anew"
                )
            rest = _Rest(file, len(header))
            return torch.load(cast(BinaryIO, rest), map_location="cpu", weights_only=True)
    except UnpicklingError:
        raise UserError(f"{path}: holds more than data and was not loaded") from None
    except (RuntimeError, EOFError, KeyError, ValueError) as error:
        raise UserError(f"{path}: is not a checkpoint of this version ({error})") from None


def arrays(state: Any) -> Any:
    """The same with NumPy arrays in the place of tensors."""
    return _map(state, torch.Tensor, lambda tensor: tensor.numpy())


def _header(hash: Any) -> bytes:
    return _MAGIC + hash.hexdigest().encode() + b"\n"


def tensors(state: Any) -> Any:
    """The same with tensors in the place of NumPy arrays, which they do not share RAM with."""
    return _map(state, np.ndarray, lambda array: torch.from_numpy(array.copy()))


class _Hashed:
    """A file that is hashed as it is written.

    What goes wrong is kept for later: raised in the midst of PyTorch's writer, it would be lost.
    """

    def __init__(self, file: BinaryIO):
        self.file = file
        self.hash = hashlib.sha256()
        self.error: OSError | None = None

    def write(self, content: bytes) -> int:
        self.hash.update(content)
        try:
            if self.error is None:
                self.file.write(content)
        except OSError as error:
            self.error = error
        return len(content)

    def flush(self) -> None: ...


class _Rest(io.RawIOBase):
    """A file from some byte on."""

    def __init__(self, file: BinaryIO, start: int):
        self.file = file
        self.start = start
        file.seek(start)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        return self.file.readinto(buffer)  # type: ignore[attr-defined]

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        if whence == os.SEEK_SET:
            offset += self.start
        return self.file.seek(offset, whence) - self.start

    def tell(self) -> int:
        return self.file.tell() - self.start


def _map(value: Any, kind: type, convert: Any) -> Any:
    if isinstance(value, kind):
        return convert(value)
    if isinstance(value, dict):
        return {key: _map(item, kind, convert) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_map(item, kind, convert) for item in value)
    return value
