"""A device that there is not: what would read on the host, or wait for it, raises.

Tensors on it have shapes and dtypes, and no numbers. `FakeTensorMode` could imitate "cuda" too, but
PyTorch's builds without CUDA refuse indexing and writing in place there; they know "meta".
"""

import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")


class FakeDevice(TorchDispatchMode):
    """Within it functions run on tensors that `put` has moved.

    `.item()`, `bool(tensor)`, `nonzero` and boolean indexing raise, and so does everything that
    makes or reads a tensor of another device: copies, and tensors made from numbers of the host.
    """

    def __init__(self):
        super().__init__()
        self.mode = FakeTensorMode()

    def __enter__(self):
        self.mode.__enter__()
        return super().__enter__()

    def __exit__(self, *error):
        super().__exit__(*error)
        return self.mode.__exit__(*error)

    def put(self, value):
        """A nested value with all its tensors on the device."""
        return tree_map(self._put, value)

    def _put(self, leaf):
        if not isinstance(leaf, torch.Tensor):
            return leaf
        return FakeTensor(self.mode, leaf.to("meta"), DEVICE)

    def put_attributes(self, one):
        """Moves an object's tensors, in place; its generator stays where it is."""
        for name, value in vars(one).items():
            setattr(one, name, DEVICE if name == "device" else self.put(value))

    def __torch_dispatch__(self, function, types, arguments=(), named=None):
        out = function(*arguments, **(named or {}))
        for leaf in tree_leaves((arguments, named, out)):
            if isinstance(leaf, torch.Tensor) and leaf.device != DEVICE:
                raise RuntimeError(f"{function} has a tensor on {leaf.device}")
        return out
