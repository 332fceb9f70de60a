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
from zipf.envs.errors import EngineError
from zipf.envs.playroom.constants import FRAME, FRAMES
from zipf.envs.playroom.state import ANGLE, AX, AY, X, Y
from zipf.envs.render3d.lanes import written

if sys.platform == "win32":
    raise EngineError("the playroom needs Linux or macOS: on Windows, run it in WSL")

_STEP, _SET_FORCE, _POSITION, _ANGLE, _VELOCITY, _MOVE, _SET_VELOCITY, _SET_SPIN = range(8)
_NAMES = (
    "cpSpaceStep", "cpBodySetForce", "cpBodyGetPosition", "cpBodyGetAngle", "cpBodyGetVelocity",
    "cpBodySetPosition", "cpBodySetVelocity", "cpBodySetAngularVelocity",
)  # fmt: skip


def address(pointer: Any) -> int:
    """Where a space, a body or a function of Chipmunk is in memory."""
    return int(ffi.cast("intptr_t", pointer))


@cache
def functions() -> NDArray[np.int64]:
    """The addresses of the functions of `_NAMES`, int64 [8]. They differ between processes."""
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
def _tell(typingctx: Any, function: Any, of: Any, number: Any) -> Any:
    """Steps a space by so many seconds, or sets the spin of a body."""
    return written([types.int64, types.int64, types.float64], _call)


@_intrinsic
def _set(typingctx: Any, function: Any, body: Any, x: Any, y: Any) -> Any:
    """Sets a vector of a body: its force, position or velocity."""
    return written([types.int64, types.int64, types.float64, types.float64], _call)


@_intrinsic
def _get(typingctx: Any, function: Any, body: Any) -> Any:
    """A vector of a body: its position or velocity."""

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


@compiled(references=False)
def simulate(mask, called, spaces, bodies, forces, agents, objects):
    """Simulates the frames of one action in the envs of `mask`; places, and angles of objects, are
    written.

    Args:
        called: of `functions()`.
        spaces: addresses of the envs' spaces, int64 [N].
        bodies: addresses of the agent and the C objects, int64 [N, C + 1].
        forces: on the agents, float64 [N, 2], newtons.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        x, y = forces[i, 0], forces[i, 1]
        for _ in range(FRAMES):
            if x != 0 or y != 0:
                _set(called[_SET_FORCE], bodies[i, 0], x, y)  # cleared by the step
            _tell(called[_STEP], spaces[i], FRAME)
        agents[i, AX], agents[i, AY] = _get(called[_POSITION], bodies[i, 0])
        for j in range(objects.shape[1]):
            body = bodies[i, j + 1]
            objects[i, j, X], objects[i, j, Y] = _get(called[_POSITION], body)
            objects[i, j, ANGLE] = _angle(called[_ANGLE], body)


@compiled(references=False)
def move_held(mask, called, bodies, hands, turned, drives, agents, objects):
    """Puts held objects, and the agents that hold or have just released one, where they are.

    A held object moves with the agent and by a velocity of its own. Arguments are as in `simulate`,
    and fields of `Commands`.
    """
    for i in range(mask.size):
        held = hands[i]
        if not mask[i] or (held < 0 and turned[i] < 0):
            continue
        agent = bodies[i, 0]
        _move_agent(called, agent, agents[i, AX], agents[i, AY])
        if held >= 0:
            body = bodies[i, held + 1]
            vx, vy = _get(called[_VELOCITY], agent)
            _set(called[_MOVE], body, objects[i, held, X], objects[i, held, Y])
            _set(called[_SET_VELOCITY], body, vx + drives[i, 0], vy + drives[i, 1])
            _tell(called[_SET_SPIN], body, 0.0)


@compiled(references=False)
def _move_agent(called, agent, x, y):
    """Puts an agent where a held object has pushed it, with no velocity back from there."""
    before_x, before_y = _get(called[_POSITION], agent)
    dx, dy = x - before_x, y - before_y
    if dx == 0 and dy == 0:
        return
    _set(called[_MOVE], agent, x, y)
    vx, vy = _get(called[_VELOCITY], agent)
    back = (vx * dx + vy * dy) / (dx * dx + dy * dy)
    if back < 0:
        _set(called[_SET_VELOCITY], agent, vx - back * dx, vy - back * dy)
