"""Exploration bonuses: rewards of the learner's own making.

A bonus is added to the reward that the agent learns from and to nothing else: scores, logs of
returns and the agent's last-reward input see the task's reward alone.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numba import njit, prange  # noqa: F401
from pydantic import Field

from zipf.agents.options import Options


class NoExplorationOptions(Options):
    """No bonus, as in the paper."""

    name: Literal["none"]


class CountOptions(Options):
    """A bonus of `scale / sqrt(visits)` for the observation that an action led to."""

    name: Literal["count"]
    scale: Annotated[float, Field(gt=0)]
    table_size: Annotated[int, Field(ge=1, le=2**30)]


ExplorationOptions = Annotated[NoExplorationOptions | CountOptions, Field(discriminator="name")]
