"""Functions of tensors that run as CUDA graphs: recorded at their first call, replayed ever after.

A graph is the list of kernels that a function ran, with the addresses that they read and wrote. To
replay it costs one launch and no Python. So a function that is captured

    reads and writes tensors that stay where they are: what lasts is written in place;
    never waits for the device, as `.item()`, boolean indexing and copies to the host do;
    reads no Python number that changes: what changes over time is a tensor.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor


class CaptureFailed(RuntimeError):
    """A function cannot be captured."""


class OtherShapes(CaptureFailed, ValueError):
    """A captured function was called with inputs of other shapes or dtypes than at first."""


Function = Callable[[], Any]


class Graph(Protocol):
    """Records one function, and replays it."""

    def warm_up(self, function: Function) -> None:
        """Runs the function before it is recorded, so that what is made once is made."""

    def record(self, function: Function, generators: Sequence[torch.Generator] = ()) -> Any:
        """Records the function, which draws from these generators; returns what it returned, of
        which `replay` alone computes the values. Raises RuntimeError: it cannot be recorded."""

    def replay(self) -> None:
        """Computes it once more."""


class CudaGraph:
    """A CUDA graph on a device."""

    def __init__(self, device: str):
        self.device = torch.device(device)
        self._graph = torch.cuda.CUDAGraph()

    def warm_up(self, function: Function) -> None:
        """Runs the function twice, on a stream of its own: the second time nothing is new."""
        with torch.cuda.device(self.device):
            side = torch.cuda.Stream()
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                for _ in range(2):
                    function()
            torch.cuda.current_stream().wait_stream(side)

    def record(self, function: Function, generators: Sequence[torch.Generator] = ()) -> Any:
        """Records the function without running it; other threads may use the device meanwhile."""
        for generator in generators:
            if generator.device.type == "cuda":
                self._graph.register_generator_state(generator)
        with torch.cuda.device(self.device):
            stream = torch.cuda.Stream()
            mode = "thread_local"
            with torch.cuda.graph(self._graph, stream=stream, capture_error_mode=mode):
                return function()

    def replay(self) -> None:
        self._graph.replay()


class Captured:
    """A function of nests of tensors that is recorded at its first call and then replayed.

    A nest is a tensor, a TensorDict, a mapping, a tuple, a dataclass of these, or None. Inputs are
    copied into those that were recorded, `inputs`, but for tensors that are these. What is returned
    is overwritten by the next call. Called while another function is recorded, it is a part of that
    one.

    Args:
        function: what is captured.
        graph: records it.
        state: gives all tensors that the function writes, beside what it returns. Recording leaves
            them as they were; those that the function made then are set to 0.
        generators: those that it draws from, beside PyTorch's own.
        name: of the function, for errors.

    Raises (when called):
        CaptureFailed: the function cannot be recorded.
        OtherShapes: inputs that differ in shape or dtype from those of the first call.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        graph: Graph,
        state: Callable[[], Sequence[Tensor]],
        *,
        generators: Sequence[torch.Generator] = (),
        name: str,
    ):
        self.function = function
        self.graph = graph
        self.state = state
        self.generators = generators
        self.name = name
        self.inputs: tuple[Any, ...] = ()
        self.outputs: Any = None
        self._flat: dict[str, Tensor] | None = None  # `inputs`, once it is recorded

    def __call__(self, *inputs: Any) -> Any:
        if is_recording():
            return self.function(*inputs)
        if self._flat is None:
            self._record(inputs)
        else:
            self._copy(flat(inputs))
        self.graph.replay()
        return self.outputs

    def _record(self, inputs: tuple[Any, ...]) -> None:
        self.inputs = mapped(inputs, lambda _, tensor: tensor.detach().clone())
        with _recording():
            restore = _snapshot(self.state, self.generators)
            try:
                self.graph.warm_up(lambda: self.function(*self.inputs))
                restore()
                try:
                    self.outputs = self.graph.record(
                        lambda: self.function(*self.inputs), self.generators
                    )
                except RuntimeError as error:
                    raise CaptureFailed(
                        f"{self.name} cannot be captured ({_first_line(error)}); choose "
                        "capture=false"
                    ) from error
            finally:
                restore()
        self._flat = flat(self.inputs)

    def _copy(self, given: dict[str, Tensor]) -> None:
        assert self._flat is not None
        for name in sorted(given.keys() | self._flat.keys()):
            own, other = _described(self._flat.get(name)), _described(given.get(name))
            if own != other:
                raise OtherShapes(
                    f"{self.name}: input {name} is {other}, and was {own} when it was captured; "
                    "choose capture=false"
                )
        for name, static in self._flat.items():
            if static.data_ptr() != given[name].data_ptr():
                static.copy_(given[name], non_blocking=True)


def mapped(nest: Any, function: Callable[[str, Tensor], Any], name: str = "") -> Any:
    """A nest with `function(name, tensor)` in the place of each tensor."""

    def inside(part: Any, key: object) -> Any:
        return mapped(part, function, f"{name}.{key}" if name else str(key))

    match nest:
        case None:
            return None
        case Tensor():
            return function(name, nest)
        case TensorDictBase():
            parts = {key: inside(part, key) for key, part in nest.items()}
            return type(nest)(parts, nest.batch_size)
        case Mapping():
            return {key: inside(part, key) for key, part in nest.items()}
        case tuple() if hasattr(nest, "_fields"):
            return type(nest)(*map(inside, nest, nest._fields))
        case tuple():
            return tuple(map(inside, nest, range(len(nest))))
        case _ if is_dataclass(nest) and not isinstance(nest, type):
            names = [field.name for field in fields(nest)]
            return replace(nest, **{key: inside(getattr(nest, key), key) for key in names})
    raise TypeError(f"{name} is a {type(nest).__name__}: expected tensors")


def flat(nest: Any) -> dict[str, Tensor]:
    """The tensors of a nest by their names in it."""
    found: dict[str, Tensor] = {}
    mapped(nest, found.__setitem__)
    return found


_here = threading.local()
_one_at_a_time = threading.Lock()


def is_recording() -> bool:
    """Whether this thread records a captured function, or warms it up."""
    return getattr(_here, "recording", False)


@contextmanager
def _recording() -> Iterator[None]:
    with _one_at_a_time:
        _here.recording = True
        try:
            yield
        finally:
            _here.recording = False


@torch.no_grad()
def _snapshot(
    state: Callable[[], Sequence[Tensor]], generators: Sequence[torch.Generator]
) -> Callable[[], None]:
    """Copies a state; returns what writes it back, and zeros into tensors that are new then."""
    before = {id(tensor): (tensor, tensor.clone()) for tensor in state()}
    defaults = [torch.default_generator]
    if torch.cuda.is_initialized():
        defaults += torch.cuda.default_generators
    draws = [(generator, generator.get_state()) for generator in (*defaults, *generators)]

    @torch.no_grad()
    def restore() -> None:
        for tensor in state():
            if id(tensor) not in before:
                tensor.zero_()
        for tensor, value in before.values():
            tensor.copy_(value)
        for generator, drawn in draws:
            generator.set_state(drawn)

    return restore


def _described(tensor: Tensor | None) -> str:
    return "not there" if tensor is None else f"{tensor.dtype} {list(tensor.shape)}"


def _first_line(error: BaseException) -> str:
    """Of an error, or of the one before it: to end a capture that has failed raises another."""
    if isinstance(error.__context__, RuntimeError):
        error = error.__context__
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
