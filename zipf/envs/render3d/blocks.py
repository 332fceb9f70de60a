"""Vector instructions for blocks of sixteen pixels, vertices or triangles.

The compiler does not vectorise the loops over pixels by itself, because they read textures at
addresses that depend on the pixel, and write only some of the pixels. Here all pixels of a block
are computed, and a mask selects those that are written. So lines of the buffers end with an unused
block.

The functions decorated with `intrinsic` are called from compiled code with addresses and numbers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic as _intrinsic

from zipf.compiled import compiled
from zipf.envs.render3d.lanes import (
    ADDRESS,
    BYTE,
    F32,
    FLOAT,
    I32,
    INT,
    LANES,
    Code,
    Vector,
    written,
)
from zipf.envs.render3d.optics import STRIP, STRIP_DARK
from zipf.envs.render3d.scene import EAST, NORTH, SOUTH, TILE_SIDES, TILE_TEXTURE, WEST
from zipf.envs.render3d.textures import SIZE

TEXTURE = (2 * SIZE * SIZE).bit_length() - 1  # binary logarithm of the texels of a texture

intrinsic: Any = _intrinsic  # its annotations do not say that it returns a function


@compiled(references=False)
def address(array):
    """The address of an array's first element."""
    # Signed, because numba adds unsigned and signed integers as floats.
    return np.intp(array.ctypes.data)


@intrinsic
def wall_block(
    typingctx, colour, depth, texels, x, last, z, dz, u, du, v, dv, area, fade, foot, per_foot, red,
    green, blue, solid,
):  # fmt: skip
    """Draws the pixels x .. min(x + 15, last) of a wall.

    1/t is z + dz * x, and texel coordinates divided by t likewise; a pixel covers area * t**3
    texels; the light is red, green, blue divided by 1 + fade * t**2, and less where v is above
    `foot`: by STRIP_DARK where it is more by 1 / per_foot. Holes are transparent where `solid` is 0
    and drawn where it is OPAQUE.
    """

    def write(builder, colour, depth, texels, x, last, z, dz, u, du, v, dv, area, fade, foot,
              per_foot, red, green, blue, solid):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        inverse = splat(z) + splat(dz) * place
        mask = (column <= splat(last)) & (inverse > code.load(depth, FLOAT))
        with builder.if_then(mask.any()):
            t, dim = code.distance(inverse, fade)
            iu, iv = ((splat(a) + splat(da) * place) * t for a, da in ((u, du), (v, dv)))
            texel = code.sample(texels, splat(area) * (t * t * t), iu, iv)
            mask = mask & ((texel | splat(solid)) < 0)
            near = ((iv - splat(foot)) * splat(per_foot)).most(0.0)
            dim = dim - dim * near * near * STRIP_DARK
            paint = code.shade(texel, [dim * splat(c) for c in (red, green, blue)])
            code.keep(mask, inverse, depth, paint, colour)

    return written([ADDRESS] * 3 + [I32] * 2 + [F32] * 13 + [I32], write)


@intrinsic
def screen_block(
    typingctx, colour, depth, texels, x, last, z, dz, dz_row, u, du, du_row, v, dv, dv_row, rows,
    columns,
):  # fmt: skip
    """Draws the pixels x .. min(x + 15, last) of a screen, RGBA [rows, columns].

    1/t is z + dz * x + dz_row * y for rows y below this one, and texel coordinates divided by t
    likewise. A pixel is the mean of the texels in the middles of its upper left and lower right
    quarter, so that of a picture of twice the size at which it is seen no line is left out; within
    a pixel, coordinates are taken to be affine.
    """

    def write(builder, colour, depth, texels, x, last, z, dz, dz_row, u, du, du_row, v, dv,
              dv_row, rows, columns):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        inverse = splat(z) + splat(dz) * place
        mask = (column <= splat(last)) & (inverse > code.load(depth, FLOAT))
        with builder.if_then(mask.any()):
            t = inverse.like(1.0) / inverse
            quarter = t * 0.25
            samples = []
            for start, step, step_row, count in ((u, du, du_row, columns), (v, dv, dv_row, rows)):
                middle = (splat(start) + splat(step) * place) * t
                ray = splat(dz) + splat(dz_row)
                aside = (splat(step) + splat(step_row) - middle * ray) * quarter
                most = splat(count) - 1
                samples.append(
                    [at.truncated().most(0).least(most) for at in (middle - aside, middle + aside)]
                )
            first, second = (
                code.look_up(texels, at_v * splat(columns) + at_u, INT)
                for at_u, at_v in zip(*samples, strict=True)
            )
            evens = (first & 0xFF00FF) + (second & 0xFF00FF) + 0x010001
            odds = ((first >> 8) & 255) + ((second >> 8) & 255) + 1
            paint = ((evens >> 1) & 0xFF00FF) | ((odds >> 1) << 8)
            code.keep(mask, inverse, depth, paint, colour)

    return written([ADDRESS] * 3 + [I32] * 2 + [F32] * 9 + [I32] * 2, write)


def _flat(patchwork: bool) -> Callable[..., Any]:
    def write(builder, colour, depth, texels, x, last, z, u, du, v, dv, each, red, green,
              blue, sides, c, dc, wide, r, dr, high, tiles, columns, rows):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        mask = (column <= splat(last)) & (splat(z) > code.load(depth, FLOAT))
        with builder.if_then(mask.any()):
            iu, iv, at_c, at_r = (
                splat(a) + splat(da) * place for a, da in ((u, du), (v, dv), (c, dc), (r, dr))
            )
            start = None
            walled = splat(sides)
            if patchwork:
                ic = at_c.truncated().most(0).least(splat(columns) - 1)
                ir_ = at_r.truncated().most(0).least(splat(rows) - 1)
                tile = code.look_up(tiles, ir_ * splat(columns) + ic, ir.IntType(16))
                mask = mask & (tile >= 0)
                tile = tile.most(0)
                walled = tile >> TILE_SIDES
                start = (tile & TILE_TEXTURE) << TEXTURE
                at_c, at_r = at_c - ic.floats_(), at_r - ir_.floats_()
            texel = code.sample(texels, splat(each), iu, iv, start)
            light = at_c.like(1.0)
            plain = builder.block
            with builder.if_then((walled >= EAST).any()):
                darker = light
                # How near to the walls at the east or west, and north or south, from 0 to 1.
                for at, size, first, second in (
                    (at_c, wide, EAST, WEST), (at_r, high, NORTH, SOUTH)
                ):  # fmt: skip
                    far = at.like(1.0 / STRIP)
                    from_first = ((walled & first) > 0).choose(
                        (at.like(1.0) - at) * splat(size), far
                    )
                    from_second = ((walled & second) > 0).choose(at * splat(size), far)
                    near = (at.like(1.0) - from_first.least(from_second) * (1.0 / STRIP)).most(0.0)
                    darker = darker - darker * near * near * STRIP_DARK
                walls = builder.block
            left = builder.phi(light.value.type)
            left.add_incoming(light.value, plain)
            left.add_incoming(darker.value, walls)
            light = Vector(builder, left)
            paint = code.shade(texel, [splat(factor) * light for factor in (red, green, blue)])
            code.keep(mask, splat(z), depth, paint, colour)

    return write


_FLAT = [ADDRESS] * 3 + [I32] * 2 + [F32] * 9 + [I32] + [F32] * 6


@intrinsic
def flat_block(
    typingctx, colour, depth, texels, x, last, z, u, du, v, dv, each, red, green, blue, sides, c,
    dc, wide, r, dr, high,
):  # fmt: skip
    """Draws the pixels x .. min(x + 15, last) of a flat.

    1/t, the light and the number of texels `each` that a pixel covers are the same along a line;
    texel coordinates are affine. So are c and r, the shares of the flat's size along x and y, which
    is `wide` and `high`, metres; at its `sides` EAST .. SOUTH it is darker.
    """
    write = _flat(patchwork=False)
    return written(_FLAT, lambda builder, *args: write(builder, *args, *[None] * 3))


@intrinsic
def patchwork_block(
    typingctx, colour, depth, texels, x, last, z, u, du, v, dv, each, red, green, blue, sides, c,
    dc, wide, r, dr, high, tiles, columns, rows,
):  # fmt: skip
    """Like `flat_block`, with texture and sides from `tiles` [rows, columns], at the column c and
    the row r; `wide` and `high` are a tile's, and `sides` is ignored."""
    return written(_FLAT + [ADDRESS, I32, I32], _flat(patchwork=True))


@intrinsic
def shadow_block(
    typingctx, colour, depth, x, last, z, slack, u, du, v, dv, half_u, half_v, per_soft, dark
):  # fmt: skip
    """Darkens those of the pixels x .. min(x + 15, last) whose 1/t is that of a shadow's plane.

    Exactly, those where it differs from z by no more than its share `slack`. The share of light
    that is taken away is `dark` where the coordinates u and v, affine in x, are within +-half_u and
    +-half_v; outside it falls to 0 at a distance of 1 / per_soft.
    """

    def write(builder, colour, depth, x, last, z, slack, u, du, v, dv, half_u, half_v, per_soft,
              dark):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        inverse = code.load(depth, FLOAT)
        gap = inverse - splat(z)
        mask = (column <= splat(last)) & (gap.most(gap * -1.0) <= splat(slack) * inverse)
        with builder.if_then(mask.any()):
            left = inverse.like(1.0)
            for start, step, half in ((u, du, half_u), (v, dv, half_v)):
                along = splat(start) + splat(step) * place
                out = (along.most(along * -1.0) - splat(half)).most(0.0) * splat(per_soft)
                left = left - out * out
            left = left.most(0.0)
            share = left.like(1.0) - splat(dark) * left * left
            paint = code.load(colour, INT)
            code.store(mask.choose(code.shade(paint, [share] * 3), paint), colour)

    return written([ADDRESS, ADDRESS, I32, I32] + [F32] * 10, write)


@intrinsic
def vertex_block(
    typingctx, vertices, vertex_line, seen, seen_line, xx, xy, xz, xw, yx, yy, yz, yw, zx, zy, zz,
    zw, focal, middle_x, middle_y,
):  # fmt: skip
    """Transforms 16 vertices, given as lines x, y, z of an array.

    Writes six lines to `seen`: coordinates in the eye's frame (right, up, ahead), pixel column and
    row, and 1/t; the last three are meaningless for vertices that are not ahead. `vertex_line` and
    `seen_line` are the bytes from one line to the next.
    """

    def write(builder, vertices, vertex_line, seen, seen_line, xx, xy, xz, xw, yx, yy, yz, yw, zx,
              zy, zz, zw, focal, middle_x, middle_y):  # fmt: skip
        code = Code(builder)
        splat = code.splat

        def line(start: Any, step: Any, number: int) -> Any:
            return builder.add(start, builder.mul(step, ir.Constant(step.type, number)))

        x, y, z = (code.load(line(vertices, vertex_line, k), FLOAT) for k in range(3))
        right, up, ahead = (
            splat(a) * x + splat(b) * y + splat(c) * z + splat(d)
            for a, b, c, d in ((xx, xy, xz, xw), (yx, yy, yz, yw), (zx, zy, zz, zw))
        )
        inverse = ahead.like(1.0) / ahead
        scale = splat(focal) * inverse
        across = splat(middle_x) + scale * right
        down = splat(middle_y) - scale * up
        for k, value in enumerate((right, up, ahead, across, down, inverse)):
            code.store(value, line(seen, seen_line, k))

    return written([ADDRESS] * 4 + [F32] * 15, write)


@intrinsic
def light_block(
    typingctx, normals, line, lit, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z, base, slope
):  # fmt: skip
    """Writes the light on 16 triangles, 0 on those that face away from the eye.
    `normals` has the lines x, y, z and distance from the origin, `line` bytes apart."""

    def write(builder, normals, line, lit, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z, base, slope):
        code = Code(builder)
        splat = code.splat
        x, y, z, plane = (
            code.load(builder.add(normals, builder.mul(line, ir.Constant(line.type, k))), FLOAT)
            for k in range(4)
        )
        front = splat(eye_x) * x + splat(eye_y) * y + splat(eye_z) * z > plane
        light = splat(sun_x) * x + splat(sun_y) * y + splat(sun_z) * z
        light = splat(base) + splat(slope) * light
        code.store(front.choose(light, light.like(0.0)), lit)

    return written([ADDRESS] * 3 + [F32] * 8, write)


TRIANGLE_LANES = 8


@intrinsic
def triangle_block(
    typingctx, colour, depth, x, paint, z, dz, a, da, b, db, c, dc
):  # fmt: skip
    """Draws those of the pixels x .. x + 7 where a, b and c, affine in x, are positive."""

    def write(builder, colour, depth, x, paint, z, dz, a, da, b, db, c, dc):
        code = Code(builder, TRIANGLE_LANES)
        splat = code.splat
        place = code.columns(x).floats_()
        inverse = splat(z) + splat(dz) * place
        mask = inverse > code.load(depth, FLOAT)
        for start, step in ((a, da), (b, db), (c, dc)):
            mask = mask & (splat(start) + splat(step) * place > 0.0)
        code.keep(mask, inverse, depth, splat(paint), colour)

    kinds = [ADDRESS, ADDRESS, I32, I32] + [F32] * 8
    return written(kinds, write)


@intrinsic
def smooth_triangle_block(
    typingctx, colour, depth, x, z, dz, a, da, b, db, c, dc, light, dlight, red, green, blue
):  # fmt: skip
    """Like `triangle_block`, in a colour 0 .. 255 in a light that is affine in x, 0 .. 1."""

    def write(builder, colour, depth, x, z, dz, a, da, b, db, c, dc, light, dlight, red, green,
              blue):  # fmt: skip
        code = Code(builder, TRIANGLE_LANES)
        splat = code.splat
        place = code.columns(x).floats_()
        inverse = splat(z) + splat(dz) * place
        mask = inverse > code.load(depth, FLOAT)
        for start, step in ((a, da), (b, db), (c, dc)):
            mask = mask & (splat(start) + splat(step) * place > 0.0)
        lit = (splat(light) + splat(dlight) * place).most(0.0).least(1.0)
        paint = (splat(red) * lit).truncated()
        paint = paint | (splat(green) * lit).truncated() << 8
        paint = paint | (splat(blue) * lit).truncated() << 16
        code.keep(mask, inverse, depth, paint, colour)

    return written([ADDRESS, ADDRESS, I32] + [F32] * 13, write)


@intrinsic
def cell_block(typingctx, south, north, line, kinds, right, bottom, near, side):
    """Writes the kinds of 16 cells of a terrain: 0 invisible, 2 cut by the near plane, 1 other.

    `south` and `north` are the addresses of two lines of corners that `vertex_block` has written,
    `line` the bytes between its lines. `right` and `bottom` are the last column and row of the
    image, `side` is half its width at a depth of 1.
    """

    def write(builder, south, north, line, kinds, right, bottom, near, side):
        code = Code(builder)
        splat = code.splat

        def corners(number: int) -> list[Any]:
            start = builder.mul(line, ir.Constant(line.type, number))
            first = [builder.add(start, row) for row in (south, north)]
            return [
                code.load(builder.add(at, ir.Constant(at.type, 4 * k)), FLOAT)
                for at in first
                for k in (0, 1)
            ]

        def bounds(values: Any) -> Any:
            a, b, c, d = values
            return a.least(b).least(c.least(d)), a.most(b).most(c.most(d))

        def holds_a_pixel(values: Any, last: Any) -> Any:
            low, high = bounds(values)
            low, high = low.most(0.0), high.least(splat(last)).most(-1.0)
            return (high >= 0.0) & (high.truncated().floats_() >= low)

        aside, ahead = corners(0), corners(2)
        nearest, farthest = bounds(ahead)
        leftmost, _ = bounds([a - splat(side) * b for a, b in zip(aside, ahead, strict=True)])
        _, rightmost = bounds([a + splat(side) * b for a, b in zip(aside, ahead, strict=True)])
        cut = (farthest > splat(near)) & (leftmost < 0.0) & (rightmost > 0.0)
        whole = holds_a_pixel(corners(3), right) & holds_a_pixel(corners(4), bottom)
        two, one, none = (nearest.truncated().like(k) for k in (2, 1, 0))
        before = nearest > splat(near)
        code.store(before.choose(whole.choose(one, none), cut.choose(two, none)), kinds)

    return written([ADDRESS] * 4 + [F32] * 4, write)


@intrinsic
def terrain_block(
    typingctx, colour, depth, texels, x, light, area, u, u_ray, du_ray, v, v_ray, dv_ray, fade,
    red, green, blue,
):  # fmt: skip
    """Paints the pixels x .. x + 15 of a terrain, which hold the numbers of triangles.

    At a depth of t, texel coordinates are u + (u_ray + du_ray * x) * t. `light` and `area` are by
    triangle, where a pixel covers area * t**3 texels.
    """

    def write(builder, colour, depth, texels, x, light, area, u, u_ray, du_ray, v, v_ray, dv_ray,
              fade, red, green, blue):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        place = code.columns(x).floats_()
        inverse, number = code.load(depth, FLOAT), code.load(colour, INT)
        mask = inverse > 0.0
        with builder.if_then(mask.any()):
            triangle = mask.choose(number, number.like(0))
            t, dim = code.distance(inverse, fade)
            iu, iv = (
                splat(a) + (splat(b) + splat(db) * place) * t
                for a, b, db in ((u, u_ray, du_ray), (v, v_ray, dv_ray))
            )
            lit = code.look_up(light, triangle, INT).as_floats() * dim
            each = code.look_up(area, triangle, INT).as_floats() * (t * t * t)
            texel = code.sample(texels, each, iu, iv)
            paint = code.shade(texel, [lit * splat(c) for c in (red, green, blue)])
            code.store(mask.choose(paint, number), colour)

    return written([ADDRESS] * 3 + [I32] + [ADDRESS] * 2 + [F32] * 10, write)


@intrinsic
def pattern_block(
    typingctx, colour, depth, texels, x, lit, axis, area, px, px_ray, px_step, py, py_ray, py_step,
    pz, pz_ray, pz_step, red, green, blue, to_red, to_green, to_blue,
):  # fmt: skip
    """Paints those of the pixels x .. x + 15 that hold numbers of triangles, which are negative.

    The number of triangle k is k - 2**31. At a depth of t, coordinates in texels are px + (px_ray +
    px_step * x) * t, and so on. `lit`, `axis` and `area` are by triangle: its light; which axis is
    not used; and how many texels a pixel covers, divided by t**3. Where the red channel of the
    texel is 0, the colour is red, green, blue; where it is 255, `to_red` etc. are added.
    """

    def write(builder, colour, depth, texels, x, lit, axis, area, px, px_ray, px_step, py,
              py_ray, py_step, pz, pz_ray, pz_step, red, green, blue, to_red, to_green,
              to_blue):  # fmt: skip
        code = Code(builder)
        splat = code.splat
        number = code.load(colour, INT)
        mask = number < 0
        with builder.if_then(mask.any()):
            place = code.columns(x).floats_()
            triangle = mask.choose(number & 0x7FFFFFFF, number.like(0))
            inverse = code.load(depth, FLOAT)
            t = place.like(1.0) / mask.choose(inverse, inverse.like(1.0))
            at_x, at_y, at_z = (
                splat(a) + (splat(b) + splat(db) * place) * t
                for a, b, db in (
                    (px, px_ray, px_step),
                    (py, py_ray, py_step),
                    (pz, pz_ray, pz_step),
                )
            )
            unused = code.look_up(axis, triangle, INT)
            u, v = (unused < 1).choose(at_y, at_x), (unused > 1).choose(at_y, at_z)
            each = code.look_up(area, triangle, INT).as_floats() * (t * t * t)
            texel = code.sample(texels, each, u, v)
            light = code.look_up(lit, triangle, INT).as_floats()
            share = (texel & 255).floats_() * (1 / 255)
            paint = number.like(0)
            for channel, (start, step) in enumerate(
                ((red, to_red), (green, to_green), (blue, to_blue))
            ):
                part = (splat(start) + splat(step) * share) * light
                paint = paint | part.truncated() << 8 * channel
            code.store(mask.choose(paint, number), colour)

    return written([ADDRESS] * 3 + [I32] + [ADDRESS] * 3 + [F32] * 15, write)


def _pack(streamed: bool) -> Callable[..., None]:
    def write(builder, colour, out):
        pointer = builder.inttoptr(colour, ir.VectorType(BYTE, 4 * LANES).as_pointer())
        colours = builder.load(pointer, align=4)
        order = [4 * pixel + channel for pixel in range(LANES) for channel in range(3)]
        for start in range(0, len(order), STREAMED):
            chosen = ir.Constant(ir.VectorType(INT, STREAMED), order[start : start + STREAMED])
            packed = builder.shuffle_vector(colours, colours, chosen)
            place = builder.add(out, ir.Constant(out.type, start))
            pointer = builder.inttoptr(place, packed.type.as_pointer())
            store = builder.store(packed, pointer, align=STREAMED if streamed else 1)
            if streamed:
                once = builder.module.add_metadata([ir.Constant(INT, 1)])
                store.set_metadata("nontemporal", once)

    return write


STREAMED = 16
"""Bytes of a store that goes past the caches; its address has to be a multiple of them."""


@intrinsic
def pack_block(typingctx, colour, out):
    """Writes 16 colours 0x00BBGGRR as 48 bytes."""
    return written([ADDRESS, ADDRESS], _pack(streamed=False))


@intrinsic
def stream_block(typingctx, colour, out):
    """Like `pack_block`, past the caches, to an address that is a multiple of STREAMED.

    What is written is not kept in the caches, where it would take the place of what is needed
    sooner. Other threads may read it after `end_stream`.
    """
    return written([ADDRESS, ADDRESS], _pack(streamed=True))


@intrinsic
def end_stream(typingctx):
    """Waits until all that `stream_block` has written is in memory."""
    return written([], lambda builder: builder.fence("seq_cst"))
