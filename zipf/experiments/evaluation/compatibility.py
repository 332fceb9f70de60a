"""The worlds that a policy is to play, and whether it was made for such."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gymnasium import spaces


@dataclass(frozen=True)
class Worlds:
    """What a policy must match.

    Attributes:
        split: its name.
        observation_space, action_space: of one world, alike on all levels of the split.
        geometry: each level's constructor options.
    """

    split: str
    observation_space: spaces.Dict
    action_space: spaces.Discrete
    geometry: Mapping[str, Mapping[str, Any]]


def check_geometry(geometry: Mapping[str, Any] | None, worlds: Worlds) -> None:
    """Raises `ValueError` where a policy was made for levels with other constructor options.

    Args:
        geometry: the options that matter to the policy; None where it names none.
        worlds: what the policy is to play.
    """
    differing = []
    for name, value in (geometry or {}).items():
        for level, options in worlds.geometry.items():
            if name not in options:
                differing.append(f"{name}={value} of the policy, and {level} has no {name}")
            elif _plain(value) != _plain(options[name]):
                differing.append(f"{name}={value} of the policy, {options[name]} of {level}")
    if differing:
        raise ValueError(
            f"the policy's geometry differs from that of split {worlds.split!r}: "
            f"{'; '.join(differing)}"
        )


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
