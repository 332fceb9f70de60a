"""Checkpoints: one file, replaced atomically, guarded by a checksum, loaded without running code.

The file is a line `zipf checkpoint 1 <sha256 of the rest>` and what `torch.save` wrote.
"""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch

from zipf.experiments.errors import UserError

_MAGIC = b"zipf checkpoint 1 "


def save(path: Path, state: dict[str, Any]) -> None:
    """Writes nested dictionaries and lists of tensors, arrays, numbers and strings.

    The file at `path` is the old one or the new one, never something between.

    Raises:
        UserError: the disk is full or cannot be written; the old file is as it was.
    """
    buffer = io.BytesIO()
    torch.save(_map(state, np.ndarray, torch.from_numpy), buffer)
    payload = buffer.getbuffer()
    header = _MAGIC + hashlib.sha256(payload).hexdigest().encode() + b"\n"
    temporary = path.with_name(path.name + ".new")
    try:
        with open(temporary, "wb") as file:
            file.write(header)
            file.write(payload)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        kept = "; the checkpoint before it is kept" if path.exists() else ""
        raise UserError(f"{path}: cannot be written: {error.strerror}{kept}") from None


def load(path: Path) -> dict[str, Any]:
    """Reads what `save` wrote; arrays come back as tensors on the CPU.

    Raises:
        UserError: the file is missing or is not, to the last bit, what was written.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    header, newline, payload = content.partition(b"\n")
    if not newline or not header.startswith(_MAGIC):
        raise UserError(f"{path}: is not a checkpoint of this version, or its head is damaged")
    if header.removeprefix(_MAGIC).decode(errors="replace") != hashlib.sha256(payload).hexdigest():
        raise UserError(
            f"{path}: is damaged (its checksum does not match); restore it from a copy, or remove "
            "its folder to train anew"
        )
    try:
        state = torch.load(io.BytesIO(payload), map_location="cpu", weights_only=True)
    except UnpicklingError:
        raise UserError(f"{path}: holds more than data and was not loaded") from None
    except (RuntimeError, EOFError, KeyError, ValueError) as error:
        raise UserError(f"{path}: is not a checkpoint of this version ({error})") from None
    return state


def arrays(state: Any) -> Any:
    """The same with NumPy arrays in the place of tensors."""
    return _map(state, torch.Tensor, lambda tensor: tensor.numpy())


def _map(value: Any, kind: type, convert: Any) -> Any:
    if isinstance(value, kind):
        return convert(value)
    if isinstance(value, dict):
        return {key: _map(item, kind, convert) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_map(item, kind, convert) for item in value)
    return value
