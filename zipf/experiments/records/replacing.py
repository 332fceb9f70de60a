"""Files that are there as a whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Writes a text file, UTF-8, in the place of the one that may be there, which stays as it is
    until the new one is on the disk. Raises OSError: it cannot be written."""
    replacement = path.with_name(f"{path.name}.new")
    try:
        with open(replacement, "w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        replacement.replace(path)
    except OSError:
        replacement.unlink(missing_ok=True)
        raise
