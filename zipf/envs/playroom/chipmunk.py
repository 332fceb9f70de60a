"""The physics of many rooms at once: compiled code that calls Chipmunk, pymunk's library in C.

Functions are called by address, without Python in between. Chipmunk passes vectors (two doubles) by
value; in the calling conventions of Linux and macOS, on x86-64 and AArch64, that is in two
registers, as two doubles are passed and as LLVM returns a pair. On Windows it is not.
"""

import sys
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from zipf.compiled import compiled
from zipf.envs.playroom.constants import FRAME, FRAMES
from zipf.envs.playroom.state import ANGLE, AX, AY, X, Y
from zipf.envs.render3d.lanes import written

_STEP, _SET_FORCE, _POSITION, _ANGLE = range(4)
_NAMES = ("cpSpaceStep", "cpBodySetForce", "cpBodyGetPosition", "cpBodyGetAngle")


def address(pointer: Any) -> int:
    """Where a space, a body or a function of Chipmunk is in memory."""
    if sys.platform == "win32":
        raise RuntimeError("the playroom's physics runs on Linux and macOS, not on Windows")
    return int(ffi.cast("intptr_t", pointer))


@cache
def functions() -> NDArray[np.int64]:
    """The addresses of what `simulate` calls, int64 [4]. They differ between processes."""
    return np.array([address(ffi.addressof(lib, name)) for name in _NAMES])


_intrinsic: Any = intrinsic  # whose type has an argument too many for those who call the result

_NUMBER, _POINTER = ir.DoubleType(), ir.IntType(8).as_pointer()
_NOTHING, _VECTOR = ir.VoidType(), ir.LiteralStructType([_NUMBER, _NUMBER])


def _call(builder: Any, function: Any, of: Any, *numbers: Any, returns: Any = _NOTHING) -> Any:
    """Calls the function at an address with a pointer, given as an address, and numbers."""
    taken = [_POINTER] + [_NUMBER] * len(numbers)
    pointer = builder.inttoptr(function, ir.FunctionType(returns, taken).as_pointer())
    return builder.call(pointer, [builder.inttoptr(of, _POINTER), *numbers])


@_intrinsic
def _step(typingctx: Any, function: Any, space: Any, seconds: Any) -> Any:
    return written([types.int64, types.int64, types.float64], _call)


@_intrinsic
def _set_force(typingctx: Any, function: Any, body: Any, x: Any, y: Any) -> Any:
    return written([types.int64, types.int64, types.float64, types.float64], _call)


@_intrinsic
def _position(typingctx: Any, function: Any, body: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = _call(builder, *args, returns=_VECTOR)
        both = [builder.extract_value(vector, k) for k in range(2)]
        return context.make_tuple(builder, signature.return_type, both)

    return types.UniTuple(types.float64, 2)(types.int64, types.int64), codegen


@_intrinsic
def _angle(typingctx: Any, function: Any, body: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _call(builder, *args, returns=_NUMBER)

    return types.float64(types.int64, types.int64), codegen


@compiled()
def simulate(mask, called, spaces, bodies, forces, agents, objects):
    """Simulates the frames of one action in the worlds of `mask`.

    Args:
        mask: bool [N].
        called: of `functions()`.
        spaces: addresses of the worlds' spaces, int64 [N].
        bodies: addresses of the agent and the C objects, int64 [N, C + 1].
        forces: on the agents, float64 [N, 2], newtons.
        agents, objects: of `Worlds`; places, and angles of objects, are written.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        x, y = forces[i, 0], forces[i, 1]
        for _ in range(FRAMES):
            if x != 0 or y != 0:
                _set_force(called[_SET_FORCE], bodies[i, 0], x, y)  # cleared by the step
            _step(called[_STEP], spaces[i], FRAME)
        agents[i, AX], agents[i, AY] = _position(called[_POSITION], bodies[i, 0])
        for j in range(objects.shape[1]):
            body = bodies[i, j + 1]
            objects[i, j, X], objects[i, j, Y] = _position(called[_POSITION], body)
            objects[i, j, ANGLE] = _angle(called[_ANGLE], body)
