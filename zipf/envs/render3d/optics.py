"""Constants of light and distance that all surfaces share."""

import math

import numpy as np

from zipf.compiled import compiled

NEAR = 0.02
FAR = 4000.0
"""The depths between which surfaces are drawn, metres."""
GROW = 0.0005
"""Walls and flats are drawn this many metres larger on every side, so that there is no gap where
two of them meet."""
OPAQUE = -(1 << 31)  # combined with a texel by a bitwise or, this makes it opaque

SUN = (0.36, 0.48, 0.8)  # direction of the light, unless a scene has another
SURFACE_DARK, SURFACE_SUN = 0.62, 0.38
"""Light on walls and flats: on the side away from the sun, and how much the sun adds."""
MESH_DARK, MESH_SUN = 0.34, 0.66  # the same for meshes and terrains
FADE = 14.0  # distance at which half of the light is left, metres

PATTERN = 0.32  # after how many metres a pattern on a mesh repeats

STRIP, STRIP_DARK = 0.2, 0.4
"""Where a wall meets a floor both are darker: up to which distance from there, metres, and which
share of the light they lack at the edge."""
SHADOW_DEPTH = 0.005
"""A shadow lies on everything whose height differs from its own by no more than this, metres."""

UNIT_SUN = tuple(np.float32(s / math.sqrt(sum(s * s for s in SUN))) for s in SUN)
FADE2 = 1.0 / FADE**2


@compiled(references=False, error_model="numpy")
def light_on(x, y, z, dark, bright, sun):
    """The light on a surface with the unit normal x, y, z, which falls smoothly to all sides.

    It is `dark` where the surface faces away from the sun, whose direction is the unit vector
    `sun`, and dark + bright where it faces the sun.
    """
    return dark + bright * (0.5 + 0.5 * (x * sun[0] + y * sun[1] + z * sun[2]))
