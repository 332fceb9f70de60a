"""Runtimes: the processes that a training run consists of, and their options."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated, Literal

from pydantic import Field

from zipf.options import Options, Size


class LocalOptions(Options):
    """One process; see `collector.lag` for its threads."""

    name: Literal["local"]


class RayOptions(Options):
    """`actors` processes in a Ray cluster play for one learner.

    `address` is that of the cluster, or "auto" for the one that this machine belongs to; None: one
    of the run's own, on this machine. `ahead` is how many unrolls may be asked for from an actor
    and not yet learned from.
    """

    name: Literal["ray"]
    address: Annotated[str, Field(min_length=1)] | None
    actors: Size
    ahead: Annotated[int, Field(ge=1, le=2)]


class TorchrunOptions(Options):
    """`learners` processes that torchrun starts train one run; each has its share of the envs."""

    name: Literal["torchrun"]
    learners: Size


RuntimeOptions = Annotated[LocalOptions | RayOptions | TorchrunOptions, Field(discriminator="name")]


def has_ray() -> bool:
    """Whether Ray is installed."""
    return find_spec("ray") is not None
