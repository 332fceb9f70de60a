"""Darkens what has been drawn: soft shadows on horizontal surfaces, of any kind."""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.blocks import address, shadow_block
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.optics import FAR, NEAR, SHADOW_DEPTH
from zipf.envs.render3d.rounding import ceil, floor
from zipf.envs.render3d.spans import narrow

DARKNESS = 0.55
_INNER = 0.6
"""Share of an object's footprint."""
_SOFTNESS = 0.07  # how far a shadow reaches beyond an object on the floor, metres
_SPREAD = 0.25  # how much farther for every metre of height
_FAINT = 0.5  # height at which half of the darkness is left, metres


@compiled(references=False)
def cast(shadow, x, y, z, angle, half_length, half_width, height):
    """Writes a row of `Scenes.shadows`: that of an object of this footprint, so high above z.

    It is darkest below the inner part of the object, and fainter and softer the higher that is;
    the numbers are ours.
    """
    shadow[0], shadow[1], shadow[2], shadow[3] = x, y, z, angle
    shadow[4], shadow[5] = _INNER * half_length, _INNER * half_width
    shadow[6] = (1 - _INNER) * min(half_length, half_width) + _SOFTNESS + _SPREAD * height
    shadow[7] = DARKNESS / (1 + height / _FAINT)


@compiled(references=False, error_model="numpy", fastmath=True)
def draw_shadow(shadow, view, projection, image, width):
    """Darkens the pixels that show a point in a shadow, a row of `Scenes.shadows`.

    The depth buffer tells which do: on a horizontal plane the depth is the same along a row, so a
    pixel of another depth shows something above or below the plane. Colours of `image` are written.
    """
    up = shadow[2] - view.z
    darkness = shadow[7]
    if up >= 0.0:
        return
    soft = np.float64(shadow[6])
    half_length, half_width = np.float64(shadow[4]), np.float64(shadow[5])
    length, breadth = half_length + soft, half_width + soft
    middle_x, middle_y = shadow[0] - view.x, shadow[1] - view.y
    frame, slant_x, slant_y = projection.frame, projection.slant_x, projection.slant_y
    radius = math.sqrt(length * length + breadth * breadth)
    right = frame[0, 0] * middle_x + frame[0, 1] * middle_y
    over = frame[1, 0] * middle_x + frame[1, 1] * middle_y + frame[1, 2] * up
    ahead = frame[2, 0] * middle_x + frame[2, 1] * middle_y + frame[2, 2] * up
    if (
        ahead + radius < NEAR
        or abs(right) * slant_x[1] - ahead * slant_x[0] > radius
        or abs(over) * slant_y[1] - ahead * slant_y[0] > radius
    ):
        return
    # The rows between its least and its greatest depth.
    rise0, drise = view.rise0, view.drise
    level = math.sqrt(frame[2, 0] * frame[2, 0] + frame[2, 1] * frame[2, 1])
    top, bottom = 0, len(image.depth) - 1
    if level > 1e-3:
        most = 1.0 / max(ahead - radius * level, NEAR)
        least = 1.0 / max(ahead + radius * level, NEAR)
        one, two = (most * up - rise0) / drise, (least * up - rise0) / drise
        top = max(ceil(min(max(min(one, two), -1.0), bottom + 1.0)), 0)
        bottom = min(floor(max(min(max(one, two), bottom + 1.0), -1.0)), bottom)
    cos, sin = math.cos(shadow[3]), math.sin(shadow[3])
    hx, hy, a0, da = view.hx, view.hy, view.a0, view.da
    slack, per_soft = SHADOW_DEPTH / -up, 1.0 / max(soft, 1e-6)
    line, depths = address(image.colour), address(image.depth)
    line_bytes = 4 * image.colour.shape[1]
    for y in range(top, bottom + 1):
        inverse = (rise0 + drise * y) / up
        if not 1.0 / FAR < inverse < 1.0 / NEAR:
            continue
        t = 1.0 / inverse
        c = (view.c0 + view.dc * y) * t
        px, dx = hx * c + hy * a0 * t - middle_x, hy * da * t
        py, dy = hy * c - hx * a0 * t - middle_y, -hx * da * t
        u, du = cos * px + sin * py, cos * dx + sin * dy
        v, dv = cos * py - sin * px, cos * dy - sin * dx
        low, high = narrow(0.0, width - 1.0, u + length, du)
        low, high = narrow(low, high, length - u, -du)
        low, high = narrow(low, high, v + breadth, dv)
        low, high = narrow(low, high, breadth - v, -dv)
        if low > high:
            continue
        first, last = ceil(low), floor(high)
        for x in range(first, last + 1, LANES):
            at = y * line_bytes + 4 * x
            shadow_block(
                line + at, depths + at, x, last, inverse, slack, u, du, v, dv, half_length,
                half_width, per_soft, darkness,
            )  # fmt: skip
