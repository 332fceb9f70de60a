"""Zipfian environment families. Importing this registers them with Gymnasium."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from zipf.envs.baselines import BaselineScore
from zipf.envs.errors import EngineError, EnvError
from zipf.envs.family import (
    OURS,
    SCRIPTED,
    Family,
    Scripted,
    all_splits,
    baseline,
    expert,
    families,
    family_of_split,
    find_family,
    find_level,
    generalist,
    goal,
    has_tensor,
    keys,
    make,
    make_scored,
    make_tensor,
    make_train,
    make_vec,
    questions,
    ranks_of,
    register,
    scripted,
    sliceable,
    split,
    symmetries,
)
from zipf.envs.splits import Normalisation, Split, SplitLevel
from zipf.lazy import lazily
from zipf.protocol import BASELINES, KINDS, PAPER_KINDS, Baseline

if TYPE_CHECKING:
    from zipf.envs.episodes import measure_chance
    from zipf.envs.gymnasium.vector import GymnasiumVectorEnv
    from zipf.envs.gymnasium.zipfian import zipfian
    from zipf.envs.mixture import Mixture
    from zipf.envs.single import SingleEnv
    from zipf.envs.tensor import TensorEnv
    from zipf.envs.vector import ZipfVectorEnv
else:  # imported when first asked for: these bring numba, and `import zipf` is to be quick
    __getattr__, __dir__ = lazily(
        __name__,
        {
            "GymnasiumVectorEnv": "zipf.envs.gymnasium.vector",
            "Mixture": "zipf.envs.mixture",
            "SingleEnv": "zipf.envs.single",
            "TensorEnv": "zipf.envs.tensor",
            "ZipfVectorEnv": "zipf.envs.vector",
            "measure_chance": "zipf.envs.episodes",
            "zipfian": "zipf.envs.gymnasium.zipfian",
        },
    )

__all__ = [
    "BASELINES", "KINDS", "PAPER_KINDS", "SCRIPTED", "Baseline", "BaselineScore", "EngineError",
    "EnvError", "Family", "GymnasiumVectorEnv", "Mixture", "Normalisation", "Scripted", "SingleEnv",
    "Split", "SplitLevel", "TensorEnv", "ZipfVectorEnv", "all_splits", "baseline", "expert",
    "families", "family_of_split", "find_family", "find_level", "generalist", "goal", "has_tensor",
    "keys", "make", "make_scored", "make_tensor", "make_train", "make_vec", "measure_chance",
    "questions", "ranks_of", "register", "scripted", "sliceable", "split", "symmetries", "zipfian",
]  # fmt: skip

for _package in OURS:
    register(importlib.import_module(f"zipf.envs.{_package}").FAMILY)
