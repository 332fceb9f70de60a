"""Several learners of one run: processes that make the same updates, from mean gradients.

Each learns from envs of its own. They begin with the same weights and change them by the same
gradients, so that the weights stay the same, bit for bit. Without `join` there is one learner, and
everything here leaves what it is given as it is.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
import torch.distributed as dist
from torch import Tensor, nn

_group: dist.ProcessGroup | None = None


def join(group: dist.ProcessGroup) -> None:
    """From now on this process is one of the learners of a group."""
    global _group
    _group = group


def leave() -> None:
    """From now on this process is the only learner."""
    global _group
    _group = None


def average(tensor: Tensor) -> Tensor:
    """The mean of a tensor over learners, of its shape, dtype and device; all of them call this in
    the same order, and the result is the same in all, bit for bit.
    Raises ConnectionError: another learner has ended."""
    if _group is None:
        return tensor
    mean = tensor.clone(memory_format=torch.contiguous_format)
    try:
        dist.all_reduce(mean, group=_group)
    except RuntimeError as error:  # PyTorch's, whichever class its backend raises
        raise ConnectionError(lost(error)) from None
    return mean.div_(dist.get_world_size(_group))


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replaces the gradients of an agent's parameters, all that are learned and in the same order
    in all learners, by their means over learners. Call it after `backward()` and before the
    gradients are read, for example to clip their norm.

    Where a parameter has a gradient in only some learners, zeros stand for it in the others. Raises
    ConnectionError: another learner has ended.
    """
    if _group is None:
        return
    learned = list(parameters)
    gradients = [torch.zeros_like(one) if one.grad is None else one.grad for one in learned]
    present = [float(one.grad is not None) for one in learned]
    counts = torch.tensor(present, dtype=gradients[0].dtype, device=gradients[0].device)
    mean = average(torch.cat([*(one.flatten() for one in gradients), counts]))
    *means, counts = mean.split([*(one.numel() for one in learned), len(learned)])
    there = present if all(present) else counts.tolist()  # which waits for the device
    for one, gradient, part, count in zip(learned, gradients, means, there, strict=True):
        if count:
            one.grad = gradient.copy_(part.view_as(one))  # keeps the order of a weight's elements


def lost(error: Exception) -> str:
    """What to tell of a failed exchange with other learners."""
    first = next(iter(str(error).strip().splitlines()), type(error).__name__)
    return f"another learner has ended or cannot be reached ({first:.200})"
