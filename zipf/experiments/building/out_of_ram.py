"""What a lack of RAM, or of a GPU's, looks like: one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from zipf.errors import UserError


@contextmanager
def enough_ram(smaller: str) -> Iterator[None]:
    """Turns Python's, NumPy's and PyTorch's errors into a `UserError`; `smaller` says what would
    need less."""
    try:
        yield
    except MemoryError as error:
        raise _error("RAM", str(error), smaller) from None
    except torch.OutOfMemoryError as error:
        raise _error("memory on the GPU", str(error), smaller) from None
    except RuntimeError as error:  # PyTorch's allocator on CPUs has no class of its own
        if "DefaultCPUAllocator" not in str(error):
            raise
        raise _error("RAM", str(error).partition("DefaultCPUAllocator: ")[2], smaller) from None


def _error(where: str, message: str, smaller: str) -> UserError:
    first = next(iter(message.strip().splitlines()), "")
    return UserError(f"not enough {where}{f' ({first})' if first else ''}; {smaller}")
