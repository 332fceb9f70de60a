"""A run's folder: what describes it and the checkpoint that it can go on from."""

from __future__ import annotations

import json
import platform
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import ValidationError
from yaml import YAMLError

import zipf
from zipf.envs import levels
from zipf.experiments import checkpoint
from zipf.experiments.config import Config
from zipf.experiments.errors import UserError
from zipf.experiments.evaluator import KINDS


def find_checkpoint(config: Config) -> dict[str, Any] | None:
    """The state to resume from, or None for a new run, as `config.resume` allows.

    Raises:
        UserError: there is none and `must`; there is one and `never`; it is damaged or was made
            with other options.
    """
    path = config.folder / "checkpoint.pt"
    if not path.exists():
        if config.resume == "must":
            raise UserError(f"resume=must: there is no checkpoint {path}")
        return None
    if config.resume == "never":
        raise UserError(
            f"resume=never: {config.folder} holds a run already; remove it, or choose another "
            "run_root or condition"
        )
    saved = checkpoint.load(path)
    check_options(path, saved, config)
    if saved["update"] > config.updates:
        raise UserError(f"{path}: is at update {saved['update']}, past updates={config.updates}")
    return saved


def check_options(path: Path, saved: dict[str, Any], config: Config) -> None:
    """Raises `UserError` where a checkpoint was made with other options than these."""
    there, here = saved["options"], config.what_is_learned
    differing = [
        f"{name}={there.get(name)} there, {here.get(name)} here"
        for name in sorted(there.keys() | here.keys())
        if there.get(name) != here.get(name)
    ]
    if differing:
        raise UserError(
            f"{path}: was made with other options ({'; '.join(differing)}); choose another "
            "run_root or condition, or the same options"
        )


def write_description(config: Config) -> None:
    """Writes `config.yaml` and `run.json`: what is run, how and with what.

    Raises:
        UserError: the folder cannot be written.
    """
    split = levels.split(config.environment.split)
    chance = {kind: levels.chance(getattr(split, kind), **config.level_options) for kind in KINDS}
    description = {
        "experiment": config.experiment,
        "condition": config.condition,
        "seed": config.seed,
        "split": config.environment.split,
        "command": shlex.join(["python", "-m", "zipf.train", *sys.argv[1:]]),
        "commit": _commit(),
        "version": zipf.__version__,
        "torch": torch.__version__,
        "device": _device_name(config.torch_device),
        "precision": config.precision,
        "window": config.schedule.window,
        "num_updates": config.updates,
        "python": platform.python_version(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "chance": chance,
        "environment": config.level_options,
        "paper": config.environment.split if config.is_released_benchmark else None,
    }
    try:
        config.folder.mkdir(parents=True, exist_ok=True)
        (config.folder / "config.yaml").write_text(OmegaConf.to_yaml(config.model_dump()))
        (config.folder / "run.json").write_text(json.dumps(description, indent=2) + "\n")
    except OSError as error:
        raise UserError(f"{config.folder}: cannot be written: {error.strerror}") from None


def read_config(folder: Path) -> Config:
    """The configuration that a run was started with.

    Raises:
        UserError: the folder holds no run, or one that this version cannot read.
    """
    path = folder / "config.yaml"
    if not path.is_file():
        raise UserError(f"{folder}: is no run's folder (it has no config.yaml)")
    try:
        return Config.model_validate(OmegaConf.to_container(OmegaConf.load(path)))
    except (ValidationError, OmegaConfBaseException, YAMLError, OSError) as error:
        first = str(error).splitlines()[0]
        raise UserError(f"{path}: is not a configuration of this version ({first})") from None


def read_description(folder: Path) -> dict[str, Any]:
    """What `write_description` wrote to `run.json`."""
    try:
        return json.loads((folder / "run.json").read_text())
    except (OSError, ValueError) as error:
        raise UserError(f"{folder / 'run.json'}: cannot be read: {error}") from None


def _commit() -> str | None:
    """The commit of the checkout that runs, marked where it was changed; None for a wheel."""
    here = Path(zipf.__file__).parent
    git = ["git", "-C", str(here)]
    try:
        tracked = subprocess.run(
            [*git, "ls-files", "--error-unmatch", "train.py"], capture_output=True
        )
        if tracked.returncode:
            return None
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        changes = subprocess.run(
            [*git, "status", "--porcelain", "--", ".", "../configs"], capture_output=True, text=True
        )
    except OSError:
        return None
    return head.stdout.strip() + ("+changes" if changes.stdout.strip() else "")


def _device_name(device: str) -> str:
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    return f"cpu ({platform.machine()}), {torch.get_num_threads()} threads"
