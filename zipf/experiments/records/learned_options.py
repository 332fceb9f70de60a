"""Which options change what is learned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Options, or groups of them, without effect on learning: they are not part of a condition's name,
# and a run may be resumed with other values of them.
NOT_LEARNED = frozenset({
    "condition", "row", "plugins", "updates", "run_root", "device", "compile", "capture",
    "deterministic", "threads", "processes", "resume", "collector.envs", "evaluation", "schedule",
    "runtime.address", "loggers",
})  # fmt: skip


# Options that runs of this version may lack, because they were made before these were added, with
# the values that change nothing.
ADDED_SINCE = {
    "learning_rate_decay": None,
    "collector.envs_per_update": None,
    "network.matcher": "learned",
    "network.match_kernels": None,
    "network.match_strides": None,
    "network.remember_instruction": True,
    "hindsight.matching_cost": 0.0,
    "augmentation.scale": [1.0, 1.0],
    "agent.likeliest": True,
}


def is_among(option: str, options: frozenset[str]) -> bool:
    """Whether an option, such as `agent.discount`, or its group is among these."""
    return not options.isdisjoint((option, option.split(".")[0]))


def affects_learning(option: str) -> bool:
    """Whether an option, such as `agent.discount`, affects what is learned."""
    return not is_among(option, NOT_LEARNED)


def changes_nothing(option: str, value: Any) -> bool:
    """Whether an option has the value that stands for its absence in older runs."""
    return option in ADDED_SINCE and ADDED_SINCE[option] == value


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested options as a flat dictionary: {"agent.discount": 0.99, ...}; an empty dictionary is an
    entry."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict) and value:
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
