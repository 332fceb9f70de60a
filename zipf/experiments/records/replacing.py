"""Files that are there as a whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """`replace_bytes` of a text in UTF-8."""
    replace_bytes(path, text.encode())


def replace_bytes(path: Path, content: bytes) -> None:
    """Writes a file in the place of the one that may be there, which stays as it is until the new
    one is on the disk. Raises OSError: it cannot be written."""
    replacement = path.with_name(f"{path.name}.new")
    try:
        with open(replacement, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        replacement.replace(path)
    except OSError:
        replacement.unlink(missing_ok=True)
        raise
