"""Distances and orientations."""

import math

from zipf.compiled import compiled


@compiled()
def rectangle_gap(pose, size, x, y):
    """The distance of the point (x, y) from a rectangle, 0 inside.

    Args:
        pose: x, y, angle of the rectangle.
        size: its half length and half width.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    out_x = max(abs(cos * dx + sin * dy) - size[0], 0.0)
    out_y = max(abs(cos * dy - sin * dx) - size[1], 0.0)
    return math.sqrt(out_x * out_x + out_y * out_y)


@compiled()
def footprint(extent):
    """The radius of a disc that contains an object of this size on the floor at any angle."""
    return 0.5 * math.sqrt(extent[0] * extent[0] + extent[1] * extent[1])


@compiled()
def set_upright(frame, angle):
    """Writes the rotation about the vertical by `angle` to `frame`, float64 [3, 3]."""
    cos, sin = math.cos(angle), math.sin(angle)
    frame[0, 0], frame[0, 1], frame[0, 2] = cos, -sin, 0.0
    frame[1, 0], frame[1, 1], frame[1, 2] = sin, cos, 0.0
    frame[2, 0], frame[2, 1], frame[2, 2] = 0.0, 0.0, 1.0
