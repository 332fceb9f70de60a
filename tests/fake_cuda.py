"""Agents on a CUDA device where there is none: tensors that have a shape, a dtype and a device, and
no numbers, and a check of what a CUDA graph cannot record.

    with fake_cuda():
        agent = make(AgentSpec(..., device=DEVICE))
        with capture_safe():
            backward(agent.loss(unroll).loss)

`capture_safe` refuses what reads a number on the host (`.item()`, `.tolist()`, `bool(tensor)`),
what has a shape that depends on numbers (`nonzero`, an index by a mask), and every tensor that is
not on the device: copies to it and from it, numbers that the host has made into a tensor, and draws
of a generator that is the host's. It does not see Python numbers that change from call to call, nor
attributes that are bound to other tensors.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

DEVICE = "cuda:0"  # with an index: where there is no CUDA, nothing says which is the current one


class HostTensor(AssertionError):
    """A tensor of the host among what is to be captured."""


class Generator(torch.Generator):
    """A generator that says it is a device's. What it draws here is never looked at."""

    def __new__(cls, device: torch.device | str = "cpu") -> Generator:
        return super().__new__(cls)

    def __init__(self, device: torch.device | str = "cpu"):
        self._device = torch.device(device)

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        return self._device


@contextmanager
def fake_cuda() -> Iterator[None]:
    """Within, tensors and generators can be made on `DEVICE`, modules moved there, and gradients
    computed by `backward`; autocast computes in bfloat16, as on the device."""
    with (
        _guard_of_cuda(),
        mock.patch("torch.amp.autocast_mode.torch.cuda.is_bf16_supported", return_value=True),
        mock.patch("torch.cuda.amp.common.amp_definitely_not_available", return_value=False),
        mock.patch("torch._meta_registrations.rnn_cell_checkSizes", _check_cell),
        mock.patch.object(torch, "Generator", Generator),
        mock.patch.object(FakeTensorMode, "__deepcopy__", lambda mode, _: mode, create=True),
        mock.patch.object(nn.Module, "to", _moved),
        FakeTensorMode(),
    ):
        yield


@contextmanager
def capture_safe() -> Iterator[None]:
    """Within, all tensors are on `DEVICE`, and nothing waits for it.
    Raises HostTensor, or PyTorch's errors of tensors without numbers."""
    with _Draws(), _OnDevice():
        yield


def on_device(value: Any) -> Any:
    """Tensors, nested in any way, as they would be on `DEVICE`: of their shapes and dtypes."""
    return tree_map_only(
        Tensor, lambda part: torch.empty(part.shape, dtype=part.dtype, device=DEVICE), value
    )


@torch.no_grad()
def backward(loss: Tensor) -> None:
    """`loss.backward()` where autograd's own engine would ask the device for its streams."""
    order, seen = [], set()
    waiting = [(loss.grad_fn, False)]
    while waiting:  # depth first: each node before those that it reads gradients of
        node, done = waiting.pop()
        if done:
            order.append(node)
        elif node is not None and node not in seen:
            seen.add(node)
            waiting += [(node, True), *((other, False) for other, _ in node.next_functions)]
    gradients: dict[Any, list[Tensor | None]] = {loss.grad_fn: [torch.ones_like(loss)]}
    for node in reversed(order):
        given = gradients.pop(node, None)
        if given is None:
            continue
        if hasattr(node, "variable"):
            node.variable.grad = given[0]
            continue
        found = node(*given)
        found = found if isinstance(found, tuple) else (found,)
        for (other, place), gradient in zip(node.next_functions, found, strict=True):
            if other is not None and gradient is not None:
                into = other._input_metadata
                gradient = gradient.sum_to_size(into[place].shape).to(into[place].dtype)
                sums = gradients.setdefault(other, [None] * len(into))
                before = sums[place]
                sums[place] = gradient if before is None else before + gradient


class _Draws(TorchFunctionMode):
    """Looks at generators, and hides them from operations that refuse one without numbers."""

    def __torch_function__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        generator = kwargs.pop("generator", None)
        if generator is not None and generator.device.type != "cuda":
            raise HostTensor(f"{function}: a generator of the host")
        return function(*args, **kwargs)


class _OnDevice(TorchDispatchMode):
    """Looks at the tensors of every operation."""

    def __torch_dispatch__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        result = SHAPES.get(function, function)(*args, **kwargs)
        for part in tree_leaves((args, kwargs, result)):
            if isinstance(part, Tensor) and part.device.type != "cuda":
                raise HostTensor(f"{function}: a tensor {list(part.shape)} of the host")
        return result


def _gru_cell(gates: Tensor, _: Tensor, hidden: Tensor, *biases: Tensor) -> tuple[Tensor, ...]:
    return torch.empty_like(hidden), hidden.new_empty(len(hidden), 5 * hidden.shape[1])


def _gru_cell_backward(gradient: Tensor, workspace: Tensor, has_bias: bool) -> tuple[Tensor, ...]:
    batch, size = gradient.shape
    gates, biases = [(batch, 3 * size)] * 2, [(3 * size,)] * 2
    return tuple(gradient.new_empty(shape) for shape in (*gates, (batch, size), *biases))


SHAPES = {  # of operations for which PyTorch has none
    torch.ops.aten._thnn_fused_gru_cell.default: _gru_cell,
    torch.ops.aten._thnn_fused_gru_cell_backward.default: _gru_cell_backward,
}


@contextmanager
def _guard_of_cuda() -> Iterator[None]:
    """Where PyTorch was built without CUDA, autograd asks a guard for the device that is not there:
    here it gets that of the CPU, which does nothing."""
    if torch.backends.cuda.is_built():
        yield
        return
    library = next((Path(torch.__file__).parent / "lib").glob("libc10.*"))
    name = "_ZN3c104impl26device_guard_impl_registryE"  # by type of device: the CPU is 0, CUDA 1
    guards = (ctypes.c_void_p * 2).in_dll(ctypes.CDLL(str(library)), name)
    guards[1] = guards[0]
    try:
        yield
    finally:
        guards[1] = None


def _check_cell(
    gates: Tensor, recurrent: Tensor, bias: None, other: None, factor: int, cell: Tensor
) -> None:
    """What an LSTM's fused cell reads; PyTorch's own check forgets that it may have no bias."""
    assert gates.shape == recurrent.shape == (len(cell), factor * cell.shape[1])
    assert gates.dtype == recurrent.dtype == cell.dtype == torch.float32
    assert bias is other is None


def _moved(module: nn.Module, device: Any = None, memory_format: Any = None) -> nn.Module:
    """`nn.Module.to`, which cannot replace parameters without numbers; their order in memory stays
    as it is."""
    for part in module.modules() if device is not None else ():
        for name, parameter in part._parameters.items():
            if parameter is not None:
                moved = parameter.detach().to(device)
                setattr(part, name, nn.Parameter(moved, requires_grad=parameter.requires_grad))
        for name, buffer in part._buffers.items():
            if buffer is not None:
                part._buffers[name] = buffer.to(device)
    return module
