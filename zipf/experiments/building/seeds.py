"""Seeds of a run's purposes: envs, actions, networks, evaluations."""

from __future__ import annotations

import hashlib


def derive_seed(*parts: int | str) -> int:
    """A seed for one purpose, 62 bits hashed from a run's seed and the purpose's name."""
    digest = hashlib.sha256(repr(parts).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 2
