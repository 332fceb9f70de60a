"""Emits LLVM instructions on vectors, for the functions of `blocks.py`."""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types

from zipf.envs.render3d.textures import SIZE

LANES = 16
ENLARGED = 0.2
"""Pixels that cover less of a texel show a mixture of texels."""

INT = ir.IntType(32)
FLOAT = ir.FloatType()
BYTE = ir.IntType(8)
ADDRESS, I32, F32 = types.intp, types.int32, types.float32
_CONTRACT = ("contract",)  # a * b + c may be rounded once


class Vector:
    """A vector of floats, 32-bit integers or truth values in the code that is being emitted."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder = builder
        self.value = value
        self.floats = value.type.element == FLOAT

    def _like(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return other.value
        return ir.Constant(self.value.type, [other] * self.value.type.count)

    def _make(self, floating: str, integer: str, other: Any) -> "Vector":
        if self.floats:
            make = getattr(self.builder, floating)
            return Vector(self.builder, make(self.value, self._like(other), flags=_CONTRACT))
        return Vector(self.builder, getattr(self.builder, integer)(self.value, self._like(other)))

    def _compare(self, operator: str, other: Any) -> "Vector":
        compare = self.builder.fcmp_ordered if self.floats else self.builder.icmp_signed
        return Vector(self.builder, compare(operator, self.value, self._like(other)))

    def __add__(self, other: Any) -> "Vector":
        return self._make("fadd", "add", other)

    def __sub__(self, other: Any) -> "Vector":
        return self._make("fsub", "sub", other)

    def __mul__(self, other: Any) -> "Vector":
        return self._make("fmul", "mul", other)

    def __truediv__(self, other: Any) -> "Vector":
        return self._make("fdiv", "sdiv", other)

    def __and__(self, other: Any) -> "Vector":
        return self._make("", "and_", other)

    def __or__(self, other: Any) -> "Vector":
        return self._make("", "or_", other)

    def __lshift__(self, other: Any) -> "Vector":
        return self._make("", "shl", other)

    def __rshift__(self, other: Any) -> "Vector":
        return self._make("", "ashr", other)

    def __lt__(self, other: Any) -> "Vector":
        return self._compare("<", other)

    def __le__(self, other: Any) -> "Vector":
        return self._compare("<=", other)

    def __gt__(self, other: Any) -> "Vector":
        return self._compare(">", other)

    def __ge__(self, other: Any) -> "Vector":
        return self._compare(">=", other)

    def like(self, number: float) -> "Vector":
        """`number` in every lane."""
        return Vector(self.builder, self._like(number))

    def choose(self, yes: "Vector", no: "Vector") -> "Vector":
        return Vector(self.builder, self.builder.select(self.value, yes.value, no.value))

    def least(self, other: Any) -> "Vector":
        other = Vector(self.builder, self._like(other))
        return (self < other).choose(self, other)

    def most(self, other: Any) -> "Vector":
        other = Vector(self.builder, self._like(other))
        return (self > other).choose(self, other)

    def floats_(self) -> "Vector":
        kind = ir.VectorType(FLOAT, self.value.type.count)
        return Vector(self.builder, self.builder.sitofp(self.value, kind))

    def truncated(self) -> "Vector":
        kind = ir.VectorType(INT, self.value.type.count)
        return Vector(self.builder, self.builder.fptosi(self.value, kind))

    def bits(self) -> "Vector":
        kind = ir.VectorType(INT, self.value.type.count)
        return Vector(self.builder, self.builder.bitcast(self.value, kind))

    def as_floats(self) -> "Vector":
        kind = ir.VectorType(FLOAT, self.value.type.count)
        return Vector(self.builder, self.builder.bitcast(self.value, kind))

    def any(self) -> Any:
        kind = ir.IntType(self.value.type.count)
        return self.builder.icmp_unsigned(
            "!=", self.builder.bitcast(self.value, kind), ir.Constant(kind, 0)
        )


class Code:
    """Emits code that works on `lanes` neighbouring pixels of a line."""

    def __init__(self, builder: Any, lanes: int = LANES) -> None:
        self.builder = builder
        self.lanes = lanes

    def splat(self, value: Any) -> Vector:
        kind = ir.VectorType(value.type, self.lanes)
        first = self.builder.insert_element(
            ir.Constant(kind, ir.Undefined), value, ir.Constant(INT, 0)
        )
        zeros = ir.Constant(ir.VectorType(INT, self.lanes), [0] * self.lanes)
        return Vector(self.builder, self.builder.shuffle_vector(first, first, zeros))

    def columns(self, x: Any) -> Vector:
        kind = ir.VectorType(INT, self.lanes)
        return self.splat(x) + Vector(self.builder, ir.Constant(kind, list(range(self.lanes))))

    def _pointer(self, address: Any, kind: Any) -> Any:
        return self.builder.inttoptr(address, kind.as_pointer())

    def load(self, address: Any, element: Any) -> Vector:
        pointer = self._pointer(address, ir.VectorType(element, self.lanes))
        return Vector(self.builder, self.builder.load(pointer, align=4))

    def store(self, vector: Vector, address: Any) -> None:
        pointer = self._pointer(address, vector.value.type)
        self.builder.store(vector.value, pointer, align=4)

    def look_up(self, address: Any, indices: Vector, element: Any) -> Vector:
        """The elements at `indices` of an array, sign-extended to 32 bits."""
        start = self._pointer(address, element)
        found = ir.Constant(ir.VectorType(INT, self.lanes), ir.Undefined)
        # Indices are extracted in pairs, because extracting is slow.
        pairs = self.builder.bitcast(indices.value, ir.VectorType(ir.IntType(64), self.lanes // 2))
        for lane in range(self.lanes):
            place = ir.Constant(INT, lane)
            pair = self.builder.extract_element(pairs, ir.Constant(INT, lane // 2))
            if lane % 2:
                index = self.builder.lshr(pair, ir.Constant(pair.type, 32))
            else:
                index = self.builder.zext(self.builder.trunc(pair, INT), pair.type)
            value = self.builder.load(self.builder.gep(start, [index]))
            if element.width < 32:
                value = self.builder.sext(value, INT)
            found = self.builder.insert_element(found, value, place)
        return Vector(self.builder, found)

    def distance(self, inverse: Vector, fade: Any) -> tuple[Vector, Vector]:
        """t and 1 / (1 + fade * t**2), the share of light that is left, where 1/t is `inverse`."""
        # One division is enough, because 1/t**2 + fade is a factor of both denominators.
        square = inverse * inverse
        lit = square + self.splat(fade)
        both = lit.like(1.0) / (inverse * lit)
        return lit * both, square * inverse * both

    def sample(
        self, texels: Any, texels_each: Vector, u: Vector, v: Vector, start: Vector | None = None
    ) -> Vector:
        """What textures show at u, v to pixels that cover so many texels each. Textures begin at
        the offset `start` (None: 0); see `pack_textures`.

        A pixel shows one texel of a smaller version, which the filter of that version makes smooth.
        Where a texel is larger than several pixels, the nearest four are mixed.
        """
        # Half of the exponent of half the number of texels, which starts at bit 23 and is biased
        # by 127: a pixel covers from two to eight texels of the version that it shows.
        level = (texels_each.most(2.0).least(2.0 * SIZE * SIZE).bits() - (128 << 23)) >> 24
        line = level.like(SIZE.bit_length() - 1) - level
        row, column = ((at.truncated() & SIZE - 1) >> level for at in (v, u))
        index = (((level.like(1) << line) + row) << line) + column
        if start is not None:
            index = index + start
        small = self.look_up(texels, index, INT)
        before = self.builder.block
        enlarged = texels_each < ENLARGED
        with self.builder.if_then(enlarged.any()):
            first = level.like(SIZE * SIZE) if start is None else start + SIZE * SIZE
            columns, right = self._neighbours(u)
            rows, below = self._neighbours(v)
            top, bottom = (
                self._mixed(
                    self.look_up(texels, first + row * SIZE + columns[0], INT),
                    self.look_up(texels, first + row * SIZE + columns[1], INT),
                    right,
                )
                for row in rows
            )
            mixed = enlarged.choose(self._mixed(top, bottom, below), small)
            inside = self.builder.block
        shown = self.builder.phi(small.value.type)
        shown.add_incoming(small.value, before)
        shown.add_incoming(mixed.value, inside)
        return Vector(self.builder, shown)

    def _neighbours(self, at: Vector) -> tuple[tuple[Vector, Vector], Vector]:
        """The two texels whose middles are around a coordinate, and the share of the second, in
        256ths. Coordinates are above -SIZE."""
        place = (at * 256.0 + (SIZE * 256.0 - 128.0)).truncated()
        first = place >> 8
        return (first & SIZE - 1, (first + 1) & SIZE - 1), place & 255

    def _mixed(self, one: Vector, two: Vector, share: Vector) -> Vector:
        """Two colours mixed: so many 256ths of the second."""
        rest = share.like(256) - share
        evens = (one & 0xFF00FF) * rest + (two & 0xFF00FF) * share + 0x800080
        odds = ((one >> 8) & 0xFF00FF) * rest + ((two >> 8) & 0xFF00FF) * share + 0x800080
        return ((evens >> 8) & 0xFF00FF) | (odds & -0xFF0100)

    def shade(self, texels: Vector, light: Sequence[Vector]) -> Vector:
        """Colours 0x00BBGGRR times three factors of at most 1."""
        colour = None
        for channel, factor in enumerate(light):
            part = ((texels >> 8 * channel) & 255).floats_() * factor
            bits = part.truncated() << 8 * channel
            colour = bits if colour is None else colour | bits
        assert colour is not None
        return colour

    def keep(self, mask: Vector, inverse: Vector, depth: Any, paint: Vector, colour: Any) -> None:
        """Writes the pixels of `mask` to both buffers."""
        # Both are loaded before the first store; otherwise LLVM emits masked stores, which are slow
        # on some CPUs.
        old_inverse, old_paint = self.load(depth, FLOAT), self.load(colour, INT)
        self.store(mask.choose(inverse, old_inverse), depth)
        self.store(mask.choose(paint, old_paint), colour)


def written(kinds: Sequence[Any], write: Callable[..., None]) -> Any:
    """The signature and the code generator that a function decorated by `intrinsic` returns."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        write(builder, *args)
        return context.get_dummy_value()

    return types.void(*kinds), codegen
