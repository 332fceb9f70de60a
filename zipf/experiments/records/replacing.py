"""Files that are there as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file to write in the place of the one that may be there, which stays as it is until the
    new one is on the disk; whatever the block raises, no half of a file is left. Raises OSError: it
    cannot be written."""
    replacement = path.with_name(f"{path.name}.new")
    try:
        with open(replacement, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(replacement, path)
    except BaseException:
        replacement.unlink(missing_ok=True)
        raise


def replace_text(path: Path, text: str) -> None:
    """`replacing` with a text in UTF-8."""
    with replacing(path) as file:
        file.write(text.encode())
