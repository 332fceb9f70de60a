"""Rounding to integers, by one instruction.

For `math.floor` and `math.ceil` numba calls a function of the C library, around which every vector
register is saved and restored.
"""

import numpy as np

from zipf.compiled import compiled


@compiled(references=False)
def floor(x):
    """The greatest integer that is not above `x`."""
    return np.int64(np.floor(x))


@compiled(references=False)
def ceil(x):
    """The least integer that is not below `x`."""
    return np.int64(np.ceil(x))
