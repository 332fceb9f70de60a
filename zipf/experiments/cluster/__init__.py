"""Runs of several processes: Ray and torchrun, behind one door (`runtime_of`)."""

from __future__ import annotations

from zipf.experiments.options.runtime import RayOptions, TorchrunOptions
from zipf.experiments.options.schema import Config
from zipf.experiments.training.runtime import Runtime


def runtime_of(config: Config) -> Runtime:
    """The processes of a run, as its option `runtime` says."""
    if isinstance(config.runtime, RayOptions):
        from zipf.experiments.cluster.ray_actors import RayRuntime

        return RayRuntime(config)
    if isinstance(config.runtime, TorchrunOptions):
        from zipf.experiments.cluster.torchrun import TorchrunRuntime

        return TorchrunRuntime(config)
    return Runtime(config)
