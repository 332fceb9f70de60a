"""Shapes that no number decides, which CUDA graphs need.

On a CPU it is faster to pick the frames that count and to compute with these alone. On a GPU the
host would have to wait for their number, and a graph could not be recorded: there all frames are
computed with, and those that do not count are masked. The results are the same but for rounding.
"""

from __future__ import annotations

from torch import Tensor

from zipf.agents.capture import is_recording


def shapes(tensor: Tensor) -> bool:
    """Whether what is computed from this tensor has to have fixed shapes."""
    return is_recording() or tensor.device.type != "cpu"
