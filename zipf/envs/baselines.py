"""Scores of the policies of `zipf.protocol` on levels: exact, or measured and kept in files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module, resources
from typing import Any

from zipf.envs import distributions


@dataclass(frozen=True)
class BaselineScore:
    """The mean return of an episode of a baseline on a level.

    Attributes:
        score: the mean return.
        episodes: how many it was measured over; None if it is exact.
        by_rank: the mean return at each value of a rank of the situation, by the rank's name, on a
            level on which all others are drawn as here; without those that are not known.
        error: the standard error of a measured score; None if it is not known.
        policy: the text of the policy that has it, see `zipf.envs.floors`; None for others.
    """

    score: float
    episodes: int | None = None
    by_rank: Mapping[str, tuple[float, ...]] = field(default_factory=dict, hash=False)
    error: float | None = None
    policy: str | None = None


def measured(package: str, name: str) -> Callable[..., BaselineScore | None]:
    """A baseline as `scripts/measure_baselines.py` wrote it to `baselines.json` in a package.

    Args:
        package: has the family as `FAMILY`.
        name: of the baseline.

    Returns:
        A function of a level's name and constructor options, as in `Family.baselines`. It returns
        None for levels and options that were not measured. It makes no difference how they are
        written: `zipf_2.0` is `zipf_2`, and (3, 3) is [3, 3]. The file has for each baseline and
        level a list of figures, with the options that are not the family's defaults:

        {"chance": {"lift/lift_shape_zipf3": [
            {"score": 0.03, "error": 0.005, "episodes": 1000, "options": {"max_steps": 100}, ...}]}}
    """

    def baseline(level: str, **options: Any) -> BaselineScore | None:
        family = import_module(package).FAMILY
        defaults = family.options_class().model_dump(exclude=set(family.appearance))
        asked = _as_json({**defaults, **options})
        for figure in _figures(package).get(name, {}).get(distributions.usual_name(level), []):
            if asked == _as_json({**defaults, **figure["options"]}):
                return BaselineScore(
                    figure["score"],
                    figure["episodes"],
                    error=figure["error"],
                    policy=figure.get("policy"),
                )
        return None

    return baseline


def higher_floor(
    package: str, exact: Callable[..., BaselineScore | None]
) -> Callable[..., BaselineScore | None]:
    """The blind baseline of a family: the higher one of what was reasoned, `exact`, and of what
    `scripts/search_floors.py` found, as `measured` reads it.

    What was found counts only where it is three standard errors above the other, as it is the best
    of several policies.
    """
    found = measured(package, "blind")

    def baseline(level: str, **options: Any) -> BaselineScore | None:
        known, cheat = exact(level, **options), found(level, **options)
        if known is None or cheat is None:
            return known or cheat
        return cheat if cheat.score > known.score + 3 * (cheat.error or 0.0) else known

    return baseline


def _as_json(value: Any) -> Any:
    """A value as it would be read from the file, in which every sequence is a list."""
    if isinstance(value, Mapping):
        return {key: _as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(item) for item in value]
    return value


@cache
def _figures(package: str) -> dict[str, dict[str, list[dict[str, Any]]]]:
    path = resources.files(package) / "baselines.json"
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}  # nothing measured yet
