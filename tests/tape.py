"""A CPU's stand-in for CUDA graphs: replays what PyTorch's operators did, and nothing else.

As in a graph, Python numbers are those of the recording, tensors are those that were there then,
and what a host would have to read or to wait for is refused.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from zipf.agents.capture import Function

aten = torch.ops.aten
REFUSED = {
    aten._local_scalar_dense.default,
    aten.equal.default,
    aten.masked_select.default,
    aten.nonzero.default,
    aten._unique2.default,
    aten.unique_dim.default,
}
INDEXING = {aten.index.Tensor, aten.index_put.default, aten.index_put_.default}


class Tape(TorchDispatchMode):
    """The same protocol as `zipf.agents.capture.CudaGraph`.

    Attributes:
        replays: how often it was replayed.
    """

    def __init__(self, device: str = "cpu"):
        super().__init__()
        self.replays = 0
        self._steps: list[tuple[Any, Any, Any, list[Tensor]]] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):  # type: ignore[override]
        kwargs = kwargs or {}
        masks = func in INDEXING and any(
            part is not None and part.dtype in (torch.bool, torch.uint8) for part in args[1]
        )
        if func in REFUSED or masks:
            raise RuntimeError(f"{func}: operation not permitted when stream is capturing")
        out = func(*args, **kwargs)
        self._steps.append((func, args, kwargs, _tensors(out)))
        return out

    def warm_up(self, function: Function) -> None:
        for _ in range(2):
            function()

    def record(self, function: Function, generators: Sequence[torch.Generator] = ()) -> Any:
        """Runs the function; what it changes is changed."""
        with self:
            return function()

    @torch.no_grad()
    def replay(self) -> None:
        self.replays += 1
        for func, args, kwargs, outputs in self._steps:
            for old, new in zip(outputs, _tensors(func(*args, **kwargs)), strict=True):
                if old.data_ptr() != new.data_ptr():
                    old.detach().copy_(new)


def _tensors(nest: Any) -> list[Tensor]:
    return [leaf for leaf in tree_leaves(nest) if isinstance(leaf, Tensor)]
