"""Distances and orientations."""

import math

from zipf.compiled import compiled


@compiled(references=False)
def rectangle_gap(pose, size, x, y):
    """The distance of the point (x, y) from a rectangle, 0 inside: `pose` is its x, y and angle,
    `size` its half length and half width."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    out_x = max(abs(cos * dx + sin * dy) - size[0], 0.0)
    out_y = max(abs(cos * dy - sin * dx) - size[1], 0.0)
    return math.sqrt(out_x * out_x + out_y * out_y)


@compiled(references=False)
def footprint(extent):
    """The radius of a disc that contains an object of this size on the floor at any angle."""
    return 0.5 * math.sqrt(extent[0] * extent[0] + extent[1] * extent[1])


@compiled(references=False)
def rectangles_gap(one, one_size, two, two_size):
    """The distance of two rectangles that do not cross; poses and sizes as in `rectangle_gap`."""
    return min(_corner_gap(one, one_size, two, two_size), _corner_gap(two, two_size, one, one_size))


@compiled(references=False)
def _corner_gap(one, one_size, two, two_size):
    """The least distance of a corner of the first rectangle from the second."""
    cos, sin = math.cos(one[2]), math.sin(one[2])
    gap = math.inf
    for side_x in (-1.0, 1.0):
        for side_y in (-1.0, 1.0):
            x, y = side_x * one_size[0], side_y * one_size[1]
            corner_x, corner_y = one[0] + cos * x - sin * y, one[1] + sin * x + cos * y
            gap = min(gap, rectangle_gap(two, two_size, corner_x, corner_y))
    return gap


@compiled(references=False)
def half_width(frame, extent, x, y, z):
    """Half the width along the unit vector (x, y, z) of a box with the rotation matrix `frame` and
    the size `extent` before the rotation, [3]."""
    total = 0.0
    for c in range(3):
        along = frame[0, c] * x + frame[1, c] * y + frame[2, c] * z
        total += abs(along) * extent[c]
    return 0.5 * total


@compiled(references=False)
def upright(angle):
    """The rows of the rotation about the vertical by `angle`."""
    cos, sin = math.cos(angle), math.sin(angle)
    return ((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0))


@compiled(references=False)
def set_rows(frame, rows):
    """Writes the rows of a rotation to `frame`, float64 [3, 3]."""
    for r in range(3):
        for c in range(3):
            frame[r, c] = rows[r][c]


@compiled(references=False)
def set_upright(frame, angle):
    """Writes the rotation about the vertical by `angle` to `frame`, float64 [3, 3]."""
    set_rows(frame, upright(angle))
