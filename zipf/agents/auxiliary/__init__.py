"""Auxiliary losses: what the memory's output has to predict beside policy and value.

`reconstruction` (Hill et al. 2020) predicts the current frame and instruction, `byol` (Grill et al.
2020, in the forms that reinforcement learning gave it) the encoded frames to come. Both read the
memory's output, so that their gradients reach memory and encoder. An agent adds the loss to its
own, gives `learned()` to its optimiser and calls `after_update` and `count` after each step:

    loss, metrics = auxiliary(inputs, outputs.core)
    ...
    auxiliary.after_update(network.encoder)
    auxiliary.count(updates)
"""

# Importing these two registers their losses.
from zipf.agents.auxiliary import byol, reconstruction
from zipf.agents.auxiliary.base import (
    AUXILIARIES,
    NO_AUXILIARY,
    Auxiliary,
    AuxiliaryOptions,
    build_auxiliary,
    sample,
)

__all__ = [
    "AUXILIARIES", "NO_AUXILIARY", "Auxiliary", "AuxiliaryOptions", "build_auxiliary", "byol",
    "reconstruction", "sample",
]  # fmt: skip
