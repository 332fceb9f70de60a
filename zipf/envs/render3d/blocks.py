"""Sixteen pixels of a line at a time, as instructions on vectors.

Compilers do not turn the loops over pixels into such instructions by themselves: they read textures
at places that depend on the pixel, and write only some pixels. Here every pixel of a block is
computed, and a mask says which are kept. Lines of the buffers therefore have a block to spare.

The functions decorated with `intrinsic` are called from compiled code with addresses and numbers.
"""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic as _intrinsic

intrinsic: Any = _intrinsic  # its annotations do not know what it makes of a function

LANES = 16

_INT = ir.IntType(32)
_FLOAT = ir.FloatType()
_BYTE = ir.IntType(8)
_ADDRESS, _I, _F = types.intp, types.int32, types.float32
_CONTRACT = ("contract",)  # a * b + c may be rounded once


class _Vector:
    """A vector of floats, of 32-bit integers or of truth values, while code is being written."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder = builder
        self.value = value
        self.floats = value.type.element == _FLOAT

    def _like(self, other: Any) -> Any:
        if isinstance(other, _Vector):
            return other.value
        return ir.Constant(self.value.type, [other] * self.value.type.count)

    def _make(self, floating: str, integer: str, other: Any) -> "_Vector":
        if self.floats:
            make = getattr(self.builder, floating)
            return _Vector(self.builder, make(self.value, self._like(other), flags=_CONTRACT))
        return _Vector(self.builder, getattr(self.builder, integer)(self.value, self._like(other)))

    def _compare(self, operator: str, other: Any) -> "_Vector":
        compare = self.builder.fcmp_ordered if self.floats else self.builder.icmp_signed
        return _Vector(self.builder, compare(operator, self.value, self._like(other)))

    def __add__(self, other: Any) -> "_Vector":
        return self._make("fadd", "add", other)

    def __sub__(self, other: Any) -> "_Vector":
        return self._make("fsub", "sub", other)

    def __mul__(self, other: Any) -> "_Vector":
        return self._make("fmul", "mul", other)

    def __truediv__(self, other: Any) -> "_Vector":
        return self._make("fdiv", "sdiv", other)

    def __and__(self, other: Any) -> "_Vector":
        return self._make("", "and_", other)

    def __or__(self, other: Any) -> "_Vector":
        return self._make("", "or_", other)

    def __lshift__(self, other: Any) -> "_Vector":
        return self._make("", "shl", other)

    def __rshift__(self, other: Any) -> "_Vector":
        return self._make("", "ashr", other)

    def __lt__(self, other: Any) -> "_Vector":
        return self._compare("<", other)

    def __le__(self, other: Any) -> "_Vector":
        return self._compare("<=", other)

    def __gt__(self, other: Any) -> "_Vector":
        return self._compare(">", other)

    def __ge__(self, other: Any) -> "_Vector":
        return self._compare(">=", other)

    def like(self, number: float) -> "_Vector":
        """`number` in every lane."""
        return _Vector(self.builder, self._like(number))

    def choose(self, yes: "_Vector", no: "_Vector") -> "_Vector":
        return _Vector(self.builder, self.builder.select(self.value, yes.value, no.value))

    def least(self, other: Any) -> "_Vector":
        other = _Vector(self.builder, self._like(other))
        return (self < other).choose(self, other)

    def most(self, other: Any) -> "_Vector":
        other = _Vector(self.builder, self._like(other))
        return (self > other).choose(self, other)

    def floats_(self) -> "_Vector":
        kind = ir.VectorType(_FLOAT, self.value.type.count)
        return _Vector(self.builder, self.builder.sitofp(self.value, kind))

    def truncated(self) -> "_Vector":
        kind = ir.VectorType(_INT, self.value.type.count)
        return _Vector(self.builder, self.builder.fptosi(self.value, kind))

    def bits(self) -> "_Vector":
        kind = ir.VectorType(_INT, self.value.type.count)
        return _Vector(self.builder, self.builder.bitcast(self.value, kind))

    def any(self) -> Any:
        kind = ir.IntType(self.value.type.count)
        return self.builder.icmp_unsigned(
            "!=", self.builder.bitcast(self.value, kind), ir.Constant(kind, 0)
        )


class _Code:
    """Writes code that works on so many pixels from column `x` of a line on."""

    def __init__(self, builder: Any, lanes: int = LANES) -> None:
        self.builder = builder
        self.lanes = lanes

    def splat(self, value: Any) -> _Vector:
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(
            ir.Constant(kind, ir.Undefined), value, ir.Constant(_INT, 0)
        )
        zeros = ir.Constant(ir.VectorType(_INT, self.lanes), [0] * self.lanes)
        return _Vector(self.builder, self.builder.shuffle_vector(first, first, zeros))

    def columns(self, x: Any) -> _Vector:
        kind = ir.VectorType(_INT, self.lanes)
        return self.splat(x) + _Vector(self.builder, ir.Constant(kind, list(range(self.lanes))))

    def _pointer(self, address: Any, kind: Any) -> Any:
        return self.builder.inttoptr(address, kind.as_pointer())

    def load(self, address: Any, element: Any) -> _Vector:
        pointer = self._pointer(address, ir.VectorType(element, self.lanes))
        return _Vector(self.builder, self.builder.load(pointer, align=4))

    def store(self, vector: _Vector, address: Any) -> None:
        pointer = self._pointer(address, vector.value.type)
        self.builder.store(vector.value, pointer, align=4)

    def look_up(self, address: Any, indices: _Vector, element: Any) -> _Vector:
        """The elements at `indices` of an array, widened to 32 bits with their sign."""
        start = self._pointer(address, element)
        found = ir.Constant(ir.VectorType(_INT, self.lanes), ir.Undefined)
        # Taken out two at a time: that is the slow part.
        pairs = self.builder.bitcast(indices.value, ir.VectorType(ir.IntType(64), self.lanes // 2))
        for lane in range(self.lanes):
            place = ir.Constant(_INT, lane)
            pair = self.builder.extract_element(pairs, ir.Constant(_INT, lane // 2))
            if lane % 2:
                index = self.builder.lshr(pair, ir.Constant(pair.type, 32))
            else:
                index = self.builder.zext(self.builder.trunc(pair, _INT), pair.type)
            value = self.builder.load(self.builder.gep(start, [index]))
            if element.width < 32:
                value = self.builder.sext(value, _INT)
            found = self.builder.insert_element(found, value, place)
        return _Vector(self.builder, found)

    def shade(self, texels: _Vector, light: Sequence[_Vector]) -> _Vector:
        """Colours 0x00BBGGRR times three factors of at most 1."""
        colour = None
        for channel, factor in enumerate(light):
            part = ((texels >> 8 * channel) & 255).floats_() * factor
            bits = part.truncated() << 8 * channel
            colour = bits if colour is None else colour | bits
        assert colour is not None
        return colour

    def keep(self, mask: _Vector, inverse: _Vector, depth: Any, paint: _Vector, color: Any) -> None:
        """Writes the pixels of `mask` to both buffers."""
        # Loaded before the first store, or LLVM makes masked stores of them: slow on some CPUs.
        old_inverse, old_paint = self.load(depth, _FLOAT), self.load(color, _INT)
        self.store(mask.choose(inverse, old_inverse), depth)
        self.store(mask.choose(paint, old_paint), color)


def _written(kinds: Sequence[Any], write: Callable[..., None]) -> Any:
    """What an intrinsic returns: the types of its arguments and what writes its code."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        write(builder, *args)
        return context.get_dummy_value()

    return types.void(*kinds), codegen


@intrinsic
def wall_block(
    typingctx, color, depth, texels, x, last, z, dz, u, du, v, dv, area, fade, red, green,
    blue, solid,
):  # fmt: skip
    """Pixels x .. x + 15, but none past the column last, of a wall.

    1/t is z + dz * x, texel coordinates over t likewise; a pixel covers area * t**3 texels; light
    is red, green, blue over 1 + fade * t**2. Holes are kept where `solid` is not 0.
    """

    def write(builder, color, depth, texels, x, last, z, dz, u, du, v, dv, area, fade, red,
              green, blue, solid):  # fmt: skip
        code = _Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        inverse = splat(z) + splat(dz) * place
        mask = (column <= splat(last)) & (inverse > code.load(depth, _FLOAT))
        with builder.if_then(mask.any()):
            # t and the light of one division: 1/t**2 + fade is the denominator of both.
            square = inverse * inverse
            lit = square + splat(fade)
            both = lit.like(1.0) / (inverse * lit)
            t = lit * both
            dim = square * inverse * both
            # Half of the exponent of the texels in a pixel, which is from bit 23 on, less 127.
            texels_each = (splat(area) * (t * t * t)).most(1.0).least(4096.0)
            level = (texels_each.bits() - (127 << 23)) >> 24
            iu = ((splat(u) + splat(du) * place) * t).truncated() & 63
            iv = ((splat(v) + splat(dv) * place) * t).truncated() & 63
            index = ((iv >> level) << 7) + (iu >> level) + 128 - (level.like(128) >> level)
            texel = code.look_up(texels, index, _INT)
            mask = mask & ((texel | splat(solid)) < 0)
            paint = code.shade(texel, [dim * splat(c) for c in (red, green, blue)])
            code.keep(mask, inverse, depth, paint, color)

    return _written([_ADDRESS] * 3 + [_I] * 2 + [_F] * 11 + [_I], write)


def _flat(patchwork: bool) -> Callable[..., Any]:
    def write(builder, color, depth, texels, x, last, z, u, du, v, dv, level, red, green,
              blue, solid, tiles, c, dc, columns, r, dr, rows):  # fmt: skip
        code = _Code(builder)
        splat = code.splat
        column = code.columns(x)
        place = column.floats_()
        mask = (column <= splat(last)) & (splat(z) > code.load(depth, _FLOAT))
        with builder.if_then(mask.any()):
            iu = (splat(u) + splat(du) * place).truncated() & 63
            iv = (splat(v) + splat(dv) * place).truncated() & 63
            shift = splat(level)
            index = ((iv >> shift) << 7) + (iu >> shift) + 128 - (shift.like(128) >> shift)
            if patchwork:
                ic = (splat(c) + splat(dc) * place).truncated().most(0).least(splat(columns) - 1)
                ir_ = (splat(r) + splat(dr) * place).truncated().most(0).least(splat(rows) - 1)
                tile = code.look_up(tiles, ir_ * splat(columns) + ic, ir.IntType(16))
                mask = mask & (tile >= 0)
                index = index + (tile.most(0) << 13)
            texel = code.look_up(texels, index, _INT)
            mask = mask & ((texel | splat(solid)) < 0)
            paint = code.shade(texel, [splat(factor) for factor in (red, green, blue)])
            code.keep(mask, splat(z), depth, paint, color)

    return write


_FLAT = [_ADDRESS] * 3 + [_I] * 2 + [_F] * 5 + [_I] + [_F] * 3 + [_I]


@intrinsic
def flat_block(
    typingctx, color, depth, texels, x, last, z, u, du, v, dv, level, red, green, blue,
    solid,
):  # fmt: skip
    """Pixels x .. x + 15, but none past the column last, of a flat.

    1/t, the light and the size of texels are the same along a line, texel coordinates are affine.
    """
    write = _flat(patchwork=False)
    return _written(_FLAT, lambda builder, *args: write(builder, *args, *[None] * 7))


@intrinsic
def patchwork_block(
    typingctx, color, depth, texels, x, last, z, u, du, v, dv, level, red, green, blue,
    solid, tiles, c, dc, columns, r, dr, rows,
):  # fmt: skip
    """Like `flat_block`; the texture is found in `tiles` [rows, columns] at affine coordinates."""
    return _written(_FLAT + [_ADDRESS, _F, _F, _I, _F, _F, _I], _flat(patchwork=True))


@intrinsic
def vertex_block(
    typingctx, vertices, vertex_line, seen, seen_line, xx, xy, xz, xw, yx, yy, yz, yw, zx, zy, zz,
    zw, focal, middle_x, middle_y,
):  # fmt: skip
    """Transforms 16 vertices, lines x, y, z of an array whose lines are so many bytes apart.

    Writes where they are seen from the eye (right, up, ahead), their pixels and 1/t as the six
    lines of `seen`; the last three are meaningless for vertices that are not ahead.
    """

    def write(builder, vertices, vertex_line, seen, seen_line, xx, xy, xz, xw, yx, yy, yz, yw, zx,
              zy, zz, zw, focal, middle_x, middle_y):  # fmt: skip
        code = _Code(builder)
        splat = code.splat

        def line(start: Any, step: Any, number: int) -> Any:
            return builder.add(start, builder.mul(step, ir.Constant(step.type, number)))

        x, y, z = (code.load(line(vertices, vertex_line, k), _FLOAT) for k in range(3))
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

    return _written([_ADDRESS] * 4 + [_F] * 15, write)


@intrinsic
def light_block(
    typingctx, normals, line, lit, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z, base, slope
):  # fmt: skip
    """Writes the light on 16 triangles, 0 on those that face away from the eye.

    `normals` are lines x, y, z and distance from the origin, so many bytes apart.
    """

    def write(builder, normals, line, lit, eye_x, eye_y, eye_z, sun_x, sun_y, sun_z, base, slope):
        code = _Code(builder)
        splat = code.splat
        x, y, z, plane = (
            code.load(builder.add(normals, builder.mul(line, ir.Constant(line.type, k))), _FLOAT)
            for k in range(4)
        )
        front = splat(eye_x) * x + splat(eye_y) * y + splat(eye_z) * z > plane
        light = splat(sun_x) * x + splat(sun_y) * y + splat(sun_z) * z
        light = splat(base) + splat(slope) * light
        code.store(front.choose(light, light.like(0.0)), lit)

    return _written([_ADDRESS] * 3 + [_F] * 8, write)


TRIANGLE_LANES = 8


@intrinsic
def triangle_block(
    typingctx, color, depth, x, paint, z, dz, a, da, b, db, c, dc
):  # fmt: skip
    """Pixels x .. x + 7 of a triangle: those where a, b and c are positive."""

    def write(builder, color, depth, x, paint, z, dz, a, da, b, db, c, dc):
        code = _Code(builder, TRIANGLE_LANES)
        splat = code.splat
        place = code.columns(x).floats_()
        inverse = splat(z) + splat(dz) * place
        mask = inverse > code.load(depth, _FLOAT)
        for start, step in ((a, da), (b, db), (c, dc)):
            mask = mask & (splat(start) + splat(step) * place > 0.0)
        code.keep(mask, inverse, depth, splat(paint), color)

    kinds = [_ADDRESS, _ADDRESS, _I, _I] + [_F] * 8
    return _written(kinds, write)


@intrinsic
def pack_block(typingctx, color, out):
    """Writes 16 colours 0x00BBGGRR as 48 bytes."""

    def write(builder, color, out):
        pointer = builder.inttoptr(color, ir.VectorType(_BYTE, 4 * LANES).as_pointer())
        colours = builder.load(pointer, align=4)
        order = [4 * pixel + channel for pixel in range(LANES) for channel in range(3)]
        chosen = ir.Constant(ir.VectorType(_INT, len(order)), order)
        packed = builder.shuffle_vector(colours, colours, chosen)
        builder.store(packed, builder.inttoptr(out, packed.type.as_pointer()), align=1)

    return _written([_ADDRESS, _ADDRESS], write)
