"""What light does, and how near and far is seen: the same in all kernels."""

import math

import numpy as np

from zipf.compiled import compiled

NEAR = 0.02
FAR = 4000.0

SUN = (0.36, 0.48, 0.8)
SURFACE_DARK, SURFACE_SUN = 0.62, 0.38
MESH_DARK, MESH_SUN = 0.34, 0.66
FADE = 14.0
"""Metres at which distance halves the light."""

UNIT_SUN = tuple(np.float32(s / math.sqrt(sum(s * s for s in SUN))) for s in SUN)
FADE2 = 1.0 / FADE**2


@compiled(error_model="numpy")
def light_on(x, y, z, dark, sun):
    """The light on a surface with the unit normal x, y, z: wrapped around, to shade all sides."""
    return dark + sun * (0.5 + 0.5 * (x * UNIT_SUN[0] + y * UNIT_SUN[1] + z * UNIT_SUN[2]))
