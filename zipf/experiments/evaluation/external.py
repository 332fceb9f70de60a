"""Rows of our tables for agents of other programs."""

from __future__ import annotations

import csv
import io
import json
import platform
import re
import sys
import time
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

import zipf
from zipf import envs
from zipf.envs.arguments import whole
from zipf.errors import UserError, writing
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.policies import plain_option
from zipf.experiments.evaluation.scoring import (
    HOW_STEPPED,
    Evaluation,
    as_split,
    check_options,
    env_options,
    score,
)
from zipf.experiments.records.csv_files import read_fields, read_lines
from zipf.experiments.records.descriptions import COLOUR_PATTERN, RunDescription, first_problem
from zipf.experiments.records.replacing import replace_text

LIBRARIES = ("torch", "tensordict", "torchrl", "stable_baselines3", "sb3_contrib", "onnxruntime")
"""Whose versions are recorded where they are in use."""

MOST_FRAMES = 10**15 - 1  # that the report reads
MOST_SEED = 2**63 - 1


def record(
    policy: Any,
    split: str | envs.Split,
    folder: str | Path,
    *,
    name: str,
    frames: int,
    update: int | None = None,
    seconds: float = 0.0,
    seed: int = 0,
    experiment: str | None = None,
    order: int | None = None,
    colour: str | None = None,
    line: Literal["solid", "dashed"] = "solid",
    episodes: int | None = None,
    num_envs: int = 250,
    batched: bool = True,
    chance_episodes: int = 0,
    **level_options: Any,
) -> Evaluation:
    """Scores somebody else's agent and makes it a row of the tables of `python -m zipf.report`.

    The folder becomes a run's folder with `run.json`, `evaluations.csv` and `situations.csv`, and
    is marked as external: no configuration of our agents belongs to it, and there is no agent in
    it to evaluate or play. Call this again with other `frames` as training goes on for a learning
    curve, in any order; the same `update` again replaces its evaluation, and all others stay. Every
    agent and every seed has a folder of its own.

    The row stands in the table of the runs of the same experiment, split and constructor options,
    with the score of its last evaluation.

    Args:
        policy: see `score`.
        split: the benchmark, by its name or as an object.
        folder: the run's folder, for instance `runs/demo/ppo/seed0`.
        name: of the agent: the row's title, the same for all seeds.
        frames: environment steps that it was trained for so far; 1e6 is 1000000.
        update: by which its evaluations are counted; None: `frames`.
        seconds: that training has taken so far, 0 where it is not known.
        seed: of the agent's training. The envs of the evaluation are seeded from it and `update`.
        experiment: whose table the row stands in; None: the split's name.
        order: the row's place among the conditions; None: after those that have one, by name.
        colour: of the row's curves, "#rrggbb"; None: one is chosen.
        line: of its curves.
        episodes, num_envs, batched: see `score`.
        chance_episodes: measure the score of random actions over so many episodes, at the first
            record, on levels on which it is not known; 0: do not.
        level_options: constructor options of the levels; see `score`.

    Raises:
        ValueError, TypeError: see `score`; or the report could not read what is given
            here: a count that is not whole or negative, an empty name. Nothing is played then.
        zipf.errors.UserError: the folder holds another run, or cannot be written.
    """
    from zipf.experiments.building.run_folder import (  # imports PyTorch
        describe_levels,
        with_further_kinds,
    )

    split = as_split(split)
    check_options(split, level_options)
    folder = Path(folder).expanduser()
    frames = _whole("frames", frames, 0, MOST_FRAMES)
    update = frames if update is None else _whole("update", update, 0, MOST_FRAMES)
    seed = _whole("seed", seed, -MOST_SEED, MOST_SEED)
    chance_episodes = _whole("chance_episodes", chance_episodes, 0)
    if not isinstance(seconds, Real) or not 0 <= seconds < np.inf:
        raise ValueError(f"seconds={seconds!r}: should be a number, at least 0")
    experiment = split.name if experiment is None else experiment
    for option, text in (("name", name), ("experiment", experiment)):
        if not isinstance(text, str) or not text.strip() or len(text.splitlines()) > 1:
            raise ValueError(f"{option}={text!r}: should be one line of text")
    if colour is not None and not re.fullmatch(COLOUR_PATTERN, str(colour)):
        raise ValueError(f"colour={colour!r}: should be '#rrggbb', six hexadecimal digits")
    if line not in ("solid", "dashed"):
        raise ValueError(f"line={line!r}: should be 'solid' or 'dashed'")
    given = {
        "experiment": experiment,
        "condition": name,
        "row": {"title": name, "order": order, "colour": colour, "line": line},
        "seed": seed,
        "split": split.name,
        "spread": split.spread,
        "environment": _environment(split, level_options),
        "paper": _paper(split, level_options),
        "situation": envs.ranks_of(split, **level_options),
        "external": {"name": name, "env_options": env_options(split, **level_options)},
        "version": zipf.__version__,
        "images": _images(split),
        "python": platform.python_version(),
        **{library: _version(library) for library in LIBRARIES},
        "recorded": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }
    description = _as_json(given)
    levels = _recorded_levels(folder, description, split)
    if levels:
        description["levels"] = with_further_kinds(levels, split, dict(level_options))
    else:
        description["levels"] = describe_levels(split, level_options)
    try:
        RunDescription.model_validate_json(json.dumps(description))
    except ValidationError as error:
        raise ValueError(f"the report could not read this: {first_problem(error)}") from None
    evaluation = score(
        policy,
        split,
        episodes=episodes,
        num_envs=num_envs,
        seed=derive_seed(seed, "evaluation", update),
        batched=batched,
        details=True,
        **level_options,
    )
    if not levels and chance_episodes:
        description["levels"] = describe_levels(
            split, level_options, chance_episodes=chance_episodes
        )
    when = {"update": update, "frames": frames, "seconds": seconds}
    tables: dict[str, list[dict[str, Any]]] = {
        "evaluations.csv": [{**when, **result.row()} for result in evaluation.results],
        "situations.csv": [
            {"update": update, **{str(name): value for name, value in row.items()}}
            for row in evaluation.situations.to_dict("records")
        ],
    }
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        replace_text(folder / "run.json", json.dumps(description, indent=2) + "\n")
        for file, rows in tables.items():
            replace_text(folder / file, _with_rows(folder / file, update, rows))
    return evaluation


def _whole(option: str, value: Any, least: int, most: int | None = None) -> int:
    """A whole number, also where it is given as a float, as 1e6 is."""
    if isinstance(value, float | np.floating) and value.is_integer():
        value = int(value)
    return whole(option, value, least, most)


def _as_json(description: Mapping[str, Any]) -> dict[str, Any]:
    """The description as it is read from `run.json`: without tuples and NumPy's numbers.

    Raises:
        ValueError: something in it, such as a constructor option, has no place in JSON.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        raise ValueError(f"{value!r} cannot be written to run.json")

    written: dict[str, Any] = json.loads(json.dumps(description, default=plain))
    return written


def _environment(split: envs.Split, level_options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that all levels are made with, as a run of ours has them."""
    options = {}
    if split.name in envs.all_splits():
        options = envs.family_of_split(split.name).options_class().model_dump()
    plain = {
        name: plain_option(value)
        for name, value in level_options.items()
        if name not in HOW_STEPPED
    }
    return options | plain


def _paper(split: envs.Split, level_options: Mapping[str, Any]) -> str | None:
    """The paper's experiment, where the envs are those of the benchmark."""
    return split.paper if _environment(split, level_options) == _environment(split, {}) else None


def _images(split: envs.Split) -> int:
    """The version of the images, as a run of ours has it."""
    if split.name not in envs.all_splits():
        return 0
    return len(envs.family_of_split(split.name).image_changes)


def _version(library: str) -> str | None:
    return getattr(sys.modules.get(library), "__version__", None)


def _recorded_levels(
    folder: Path, description: Mapping[str, Any], split: envs.Split
) -> list[dict[str, Any]] | None:
    """The levels as an earlier record of the same agent described them; None where there is none.
    The split may have levels of further kinds since.

    Raises:
        UserError: the folder belongs to something else.
    """
    path = folder / "run.json"
    ours = f"{folder}: holds a run of zipf.train; choose another folder"
    if (folder / "config.yaml").exists() or (folder / "checkpoint.pt").exists():
        raise UserError(ours)
    if not path.exists():
        return None
    same = ("condition", "seed", "experiment", "split", "environment", "external")
    try:
        there = json.loads(path.read_text(encoding="utf-8-sig"))
        if not there["external"]:
            raise UserError(ours)
        levels = there["levels"]
        kinds = {one["level_kind"] for one in levels}
        new = {one.name for kind in split.kinds if kind not in kinds for one in split.levels(kind)}
        new -= {one["level"] for one in levels}
        given = description["external"]["env_options"].items()
        external = {"env_options": {name: one for name, one in given if name not in new}}
        here = {**description, "external": {**description["external"], **external}}
        differing = [line for key in same for line in _differences(key, there[key], here[key])]
    except (OSError, ValueError, KeyError, TypeError):
        raise UserError(f"{path}: is not a run's description; choose another folder") from None
    if differing:
        raise UserError(
            f"{folder}: holds another record ({'; '.join(differing)}); choose another folder"
        )
    return levels


def _differences(name: str, there: Any, here: Any) -> list[str]:
    """What differs between two nests of dictionaries."""
    if isinstance(there, dict) and isinstance(here, dict):
        keys = dict.fromkeys([*there, *here])
        return [
            line
            for key in keys
            for line in _differences(f"{name}.{key}", there.get(key), here.get(key))
        ]
    return [] if there == here else [f"{name} {there} there, {here} here"]


def _with_rows(path: Path, update: int, rows: Sequence[Mapping[str, Any]]) -> str:
    """The file's rows of other updates, then these.

    Raises:
        UserError: the file is damaged.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    lines, _ = read_lines(path)
    if lines and read_fields(path, lines)[0] != list(rows[0]):
        raise UserError(f"{path}, line 1: has other columns than its record; choose another folder")
    writer.writeheader()
    text.writelines(f"{one}\n" for one in lines[1:] if one.split(",")[0] != str(update))
    writer.writerows(rows)
    return text.getvalue()
