"""What of a run can be done on the device of its agent: stepping envs, in CUDA graphs, compiled."""

from __future__ import annotations

import os
import shutil
import sysconfig
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from zipf import envs
from zipf.agents.agent import agents
from zipf.agents.episodic import NO_EPISODIC
from zipf.agents.hindsight import AchievedOptions
from zipf.agents.network_options import ResNetOptions
from zipf.experiments.hooks.augmentation import RandomAugmentationOptions
from zipf.experiments.hooks.exploration import CountOptions
from zipf.experiments.hooks.tensor import host_alone
from zipf.experiments.options.runtime import RayOptions, TorchrunOptions
from zipf.experiments.options.schema import Config


def on_device(config: Config) -> bool:
    """Whether the envs are stepped as tensors on the agent's device."""
    where = config.collector.envs
    if where == "host" or list(only_on_the_host(config)):
        return False
    return where == "device" or config.torch_device.startswith("cuda")


def only_on_the_host(config: Config) -> Iterator[str]:
    """The options that take host environments, such as `exploration=rnd`, and those of plugins,
    which may derive from ours."""
    if not envs.has_tensor(envs.split(config.environment.split)):
        yield f"environment.split={config.environment.split}"
    if isinstance(config.runtime, RayOptions):
        yield "runtime=ray"
    agent = agents()[config.agent.name]
    if agent.host_envs_only or not agent.captures:
        yield f"agent={config.agent.name}"
    if type(config.exploration) is not CountOptions and config.exploration.name != "none":
        yield f"exploration={config.exploration.name}"
    if config.reweighting.name != "none":
        yield f"reweighting={config.reweighting.name}"
    if config.episodic != NO_EPISODIC:
        yield f"episodic={config.episodic.name}"
    hindsight, augmentation = config.hindsight, config.augmentation
    if type(hindsight) is AchievedOptions:
        for name in ("kept_per_goal", "matching_cost"):
            if value := getattr(hindsight, name):
                yield f"hindsight.{name}={value}"
    elif hindsight.name != "none":
        yield f"hindsight={hindsight.name}"
    if type(augmentation) is RandomAugmentationOptions:
        if problem := host_alone(augmentation):
            yield problem
    elif augmentation.name != "none":
        yield f"augmentation={augmentation.name}"


def captures(config: Config) -> bool:
    """Whether functions are captured as CUDA graphs."""
    return (
        config.capture and config.torch_device.startswith("cuda") and not list(not_captured(config))
    )


def compiles(config: Config) -> bool:
    """Whether image encoders are compiled. `auto` does so where it was seen to gain: the ResNet on
    CUDA, where there is what Triton needs, a C compiler and Python's headers."""
    if config.compile != "auto":
        return config.compile
    if not config.torch_device.startswith("cuda") or not isinstance(config.network, ResNetOptions):
        return False
    compilers = (os.environ.get("CC", "cc"), "gcc", "clang")  # as Triton looks for them
    headers = Path(sysconfig.get_path("include"), "Python.h")
    has_compiler = any(shutil.which(one) for one in compilers)
    return find_spec("triton") is not None and has_compiler and headers.is_file()


def not_captured(config: Config) -> Iterator[str]:
    """The options whose functions have shapes that depend on data, or wait for the device."""
    if not agents()[config.agent.name].captures:
        yield f"agent={config.agent.name}"
    if config.hindsight.name != "none" and not on_device(config):
        yield f"hindsight={config.hindsight.name}"
    if config.episodic != NO_EPISODIC:
        yield f"episodic={config.episodic.name}"
    if isinstance(config.runtime, TorchrunOptions) and config.auxiliary.averages:
        yield f"auxiliary={config.auxiliary.name}"
