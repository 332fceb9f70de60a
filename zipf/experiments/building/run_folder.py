"""A run's folder: what describes it and the checkpoint that it can go on from."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

import zipf
from zipf import envs
from zipf.envs import EngineError
from zipf.errors import UserError, reading, writing
from zipf.experiments.building import checkpoint
from zipf.experiments.options.runtime import TorchrunOptions
from zipf.experiments.options.schema import Config, schema
from zipf.experiments.records import results
from zipf.experiments.records.replacing import replace_text
from zipf.experiments.records.result_table import check_tables, ends_at, last_update


def find_checkpoint(config: Config) -> dict[str, Any] | None:
    """The state to resume from, or None for a new run, as `config.resume` allows.
    Raises UserError: there is none and `must`; there is one and `never`; it is damaged or was made
    with other options."""
    path = config.folder / "checkpoint.pt"
    check_resumed(config)
    if not path.exists():
        for name in ("metrics.csv", "evaluations.csv"):
            last = last_update(config.folder / name)
            if last not in (None, "0"):
                raise UserError(
                    f"{config.folder / name}: holds results up to update {last:.40}, and their "
                    "checkpoint is missing; restore it, or remove the folder, or choose another "
                    "run_root or name"
                )
        return None
    if config.resume == "never":
        raise UserError(
            f"resume=never: {config.folder} holds a run already; remove it, or choose another "
            "run_root or name"
        )
    saved = checkpoint.load(path)
    check_options(path, saved, config)
    with fits(path):
        update = saved["update"]
    if update > config.updates:
        raise UserError(
            f"{path}: is at update {update}, past updates={config.updates}; give more, or another "
            "name or run_root"
        )
    if update == config.updates and ends_at(config.folder / "evaluations.csv", update):
        saved["evaluated"] = update  # the evaluation that ends a run comes after its checkpoint
    return saved


def check_resumed(config: Config) -> None:
    """Raises `UserError` where there is no checkpoint and there should be one."""
    path = config.folder / "checkpoint.pt"
    if config.resume == "must" and not path.exists():
        raise UserError(f"resume=must: there is no checkpoint {path}")


def is_finished(config: Config) -> bool:
    """Whether a run has nothing left to do, by its files alone: no envs or networks are made.
    False also where something is wrong, such as a damaged file: the run itself will tell."""
    try:
        folder = config.folder
        if config.resume == "never" or not ends_at(folder / "evaluations.csv", config.updates):
            return False
        saved = find_checkpoint(config)
        if saved is None:
            return False
        done = bool(saved["evaluated"] == saved["update"] == config.updates)
        if done:
            check_description(config)
            check_tables(folder, config.updates, saved["tables"])
        return done
    except (UserError, OSError, RuntimeError, ValueError):  # the last three: no such folder can be
        return False


def agent_file(folder: Path) -> Path:
    """The file that a run's agent is loaded from: its checkpoint or, where there is none, its
    weights. Raises UserError: it has neither."""
    for name in ("checkpoint.pt", "weights.pt"):
        if (folder / name).is_file():
            return folder / name
    raise UserError(f"{folder.as_posix()}: has no agent (neither checkpoint.pt nor weights.pt)")


def check_options(path: Path, saved: dict[str, Any], config: Config) -> None:
    """Raises `UserError` where a checkpoint was made with other options than these."""
    with fits(path):
        there, here = {**saved["options"]}, config.what_is_learned
    differing = [
        f"{name}={there.get(name)} there, {here.get(name)} here"
        for name in sorted(there.keys() | here.keys())
        if there.get(name) != here.get(name)
    ]
    if differing:
        raise UserError(
            f"{path}: was made with other options ({'; '.join(differing)}); choose another "
            "run_root or name, or the same options"
        )


@contextmanager
def fits(path: Path) -> Iterator[None]:
    """Raises `UserError` where what a checkpoint holds does not fit the parts of this version."""
    try:
        yield
    except EngineError:  # of an environment whose episodes are replayed
        raise
    except (LookupError, RuntimeError, TypeError, AttributeError, ValueError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise UserError(f"{path}: does not fit this version of zipf ({first})") from None


def write_description(
    config: Config,
    situation: dict[str, int],
    words: Sequence[str],
    *,
    resumed_at: int | None,
    pretrained: dict[str, Any] | None = None,
) -> None:
    """Writes `config.yaml` and `run.json`: what is run, how (by a command with the arguments
    `words`) and with what, and with which run's weights a new one began (`pretrained`).

    A resumed run keeps the description of how it began; how it went on is added to `resumed`.
    Raises UserError: the folder cannot be written, or a resumed run's description is gone or
    damaged.
    """
    split = config.split
    how: dict[str, Any] = {
        "command": shlex.join([*_started_by(config), "-m", "zipf.train", *words]),
        "commit": commit(),
        "version": zipf.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "device": _device_name(config.torch_device),
        "images": len(envs.family_of_split(split.name).image_changes),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }
    resumed: list[dict[str, Any]] = []
    if resumed_at is not None:
        began = check_description(config, situation)
        resumed = [*began.get("resumed", []), {"update": resumed_at, **how}]
        how = {name: began.get(name) for name in how}
        pretrained = began.get("pretrained")
        described = with_further_kinds(began["levels"], split, config.level_options)
    else:
        described = describe_levels(
            split, config.level_options, chance_episodes=config.evaluation.chance_episodes
        )
    description = {
        "experiment": config.experiment,
        "condition": config.condition,
        "row": config.row.model_dump(),
        "seed": config.seed,
        "split": split.name,
        "spread": split.spread,
        "precision": config.precision,
        "window": config.schedule.window,
        "num_updates": config.updates,
        "levels": described,
        "situation": situation,
        "environment": config.level_options,
        "paper": split.paper if config.is_released_benchmark else None,
        "external": None,
        **how,
        "pretrained": pretrained,
        "resumed": resumed,
    }
    texts = {
        "config.yaml": OmegaConf.to_yaml(config.model_dump()),
        "run.json": json.dumps(description, indent=2) + "\n",
    }
    with writing(config.folder):
        for name, text in texts.items():
            replace_text(config.folder / name, text)


def describe_levels(
    split: envs.Split,
    options: dict[str, Any],
    *,
    chance_episodes: int = 0,
    kinds: Collection[str] | None = None,
) -> list[dict[str, Any]]:
    """The levels of a run, of these kinds (None: all), each with its weight and the scores of those
    baselines that are known, as `LevelDescription` reads them. Where chance is not known it is
    measured over `chance_episodes`, if any."""
    described = []
    for kind in split.kinds if kinds is None else kinds:
        for level in split.levels(kind):
            baselines = {}
            for one in envs.BASELINES:
                known = envs.baseline(one.name, level, **options)
                if known is None and one.name == "chance" and chance_episodes:
                    known = envs.measure_chance(level, episodes=chance_episodes, **options)
                if known is not None:
                    baselines[one.name] = _described(level, known)
            described.append(
                {
                    "level_kind": kind,
                    "level": level.name,
                    "weight": level.weight,
                    "normalised": level.normalisation is not None,
                    "references": baselines,
                }
            )
    return described


def with_further_kinds(
    described: list[dict[str, Any]], split: envs.Split, options: dict[str, Any]
) -> list[dict[str, Any]]:
    """The levels of a run, and those of the kinds that its split did not have when it began."""
    kinds = {one["level_kind"] for one in described}
    new = [kind for kind in split.kinds if kind not in kinds]
    return described + describe_levels(split, options, kinds=new)


def _described(level: envs.SplitLevel, known: envs.BaselineScore) -> dict[str, Any]:
    return {
        "score": level.normalised(known.score),
        "episodes": known.episodes,
        "by_rank": {
            name: [level.normalised(value) for value in values]
            for name, values in known.by_rank.items()
        },
        **({"policy": known.policy} if known.policy else {}),
    }


def mean_of_levels(described: list[dict[str, Any]], kind: str, baseline: str) -> float | None:
    """The weighted mean of a baseline over a kind's levels; None where one is not known."""
    levels = [level for level in described if level["level_kind"] == kind]
    if not levels or any(baseline not in level["references"] for level in levels):
        return None
    total = sum(level["weight"] for level in levels)
    weighted = (level["weight"] * level["references"][baseline]["score"] for level in levels)
    return sum(weighted) / total


def make(folder: Path) -> None:
    """Makes a run's folder. Raises `UserError` where it cannot be made."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Holds a run's folder against other processes, until this one ends, however it ends.
    Raises UserError: another process is training there, or the folder cannot be written."""
    import fcntl  # here: Windows has none, and only training locks

    make(folder)
    with writing(folder):
        file = open(folder / "lock", "a")  # noqa: SIM115
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"{folder}: another process is training there") from None
    with file:
        yield


def read_config(folder: Path, plugins: Collection[str] = ()) -> Config:
    """The configuration that a run was started with, while these plugins are loaded. Those that the
    run was made with are never imported because its file says so: a run's folder may come from
    anywhere.

    Raises UserError: the folder holds no run, one that needs other plugins, one that this version
    cannot read, or the record of an agent of another program; or it is damaged.
    """
    description = read_description(folder)
    if external := description["external"]:
        raise UserError(
            f"{folder}: records the scores of an agent of another program, {external['name']}; "
            "the agent is not there"
        )
    config = _read_options(folder, plugins)
    _check_same(folder, description, config)
    return config


def check_description(config: Config, situation: dict[str, int] | None = None) -> dict[str, Any]:
    """The contents of `run.json`, in the folder of a run that there is, whose envs have this
    situation (None: not compared). Raises UserError: `run.json` or `config.yaml` is gone, damaged
    or another run's."""
    description = read_description(config.folder)
    known = {} if situation is None else {"situation": situation}
    _check_same(config.folder, description, config, **known)
    there = _read_options(config.folder, config.plugins)
    if there.what_is_learned != config.what_is_learned:
        raise UserError(
            f"{config.folder / 'config.yaml'}: has other options than the run's checkpoint; "
            f"{_REMEDY}"
        )
    return description


def read_description(folder: Path) -> dict[str, Any]:
    """What `write_description`, or `zipf.evaluate.record`, wrote to `run.json`.
    Raises UserError: there is none, or it is damaged."""
    path = folder / "run.json"
    try:
        if not path.is_file():
            raise UserError(f"{folder}: is no run's folder ({_no_run(folder)})")
    except OSError as error:
        raise UserError(f"{folder!s:.200}: cannot be read: {error.strerror}") from None
    results.read_description(path)
    return json.loads(path.read_text(encoding="utf-8-sig"))


def _no_run(folder: Path) -> str:
    if folder.is_file():
        return f"it is a file; its folder: {folder.parent}"
    if not folder.exists():
        return "there is no such folder"
    below = sorted(path.parent for path in folder.glob("*/run.json"))
    return "it has no run.json" + (f"; did you mean {below[0]}?" if below else "")


def other_images(folder: Path) -> str | None:
    """A line for a run that was trained, at least in part, on other images than its family has now;
    None for others. Raises `UserError` as `read_description`."""
    description = read_description(folder)
    family = envs.family_of_split(description["split"])
    parts = [description, *description.get("resumed", [])]
    version = min(part.get("images") or 0 for part in parts)
    if not (changes := family.image_changes[version:]):
        return None
    there = f"{str(family.id).rpartition('-v')[0]}-v{version}"
    return (
        f"{folder}: was trained on the images of {there}, and {family.id} has others "
        f"({'; '.join(changes)}): scores on them differ"
    )


_REMEDY = "restore it from a copy, or remove the run's folder to train anew"


def _read_options(folder: Path, plugins: Collection[str]) -> Config:
    path = folder / "config.yaml"
    if not path.is_file():
        raise UserError(f"{folder}: is no run's folder (it has no config.yaml)")
    try:
        with reading(path):
            values: Any = OmegaConf.to_container(OmegaConf.load(path))
        missing = [name for name in values.get("plugins", ()) if name not in plugins]
        if missing:
            raise UserError(
                f"{folder}: was made with plugins=[{','.join(missing)}], which this command has "
                f"not loaded; if you trust them say plugins=[{','.join(missing)}]"
            )
        return schema().model_validate(values)
    except (ValueError, TypeError, AttributeError, OmegaConfBaseException, YAMLError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise UserError(f"{path}: is not a configuration of this version ({first})") from None


def _check_same(folder: Path, description: dict[str, Any], config: Config, **known: Any) -> None:
    """Raises `UserError` where `run.json` describes another run than the configuration, or has
    other entries than `known`."""
    split = envs.split(config.environment.split)
    described = {one["level_kind"] for one in description["levels"]}
    here = {
        "experiment": config.experiment,
        "condition": config.condition,
        "seed": config.seed,
        "split": split.name,
        "environment": config.level_options,
        # A run of before a split had levels of a further kind may go on.
        "levels": [
            [kind, one.name, one.weight]
            for kind in split.kinds
            for one in split.levels(kind)
            if kind in envs.PAPER_KINDS or kind in described
        ],
        **known,
    }
    there = {name: description.get(name) for name in here} | {
        "levels": [
            [one["level_kind"], one["level"], one["weight"]] for one in description["levels"]
        ]
    }
    if differing := [name for name in here if here[name] != there[name]]:
        raise UserError(
            f"{folder / 'run.json'}: describes another run ({', '.join(differing)}); {_REMEDY}"
        )


def commit() -> str | None:
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


def _started_by(config: Config) -> list[str]:
    if isinstance(config.runtime, TorchrunOptions):
        of_machine = os.environ.get("LOCAL_WORLD_SIZE", config.learners)
        return ["torchrun", f"--nproc-per-node={of_machine}"]
    return ["python"]


def _device_name(device: str) -> str:
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    threads = torch.get_num_threads()
    return f"cpu ({platform.machine()}), {threads} thread{'s' if threads > 1 else ''}"
