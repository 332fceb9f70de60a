"""Weights of another run, which a new run begins with (`pretrained.run`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor

from zipf.experiments.config import Config
from zipf.experiments.errors import UserError
from zipf.experiments.running.trained import load_agent


class Pretrained(NamedTuple):
    """Weights by part of the network, and what `run.json` says of where they are from."""

    weights: dict[str, dict[str, Tensor]]
    described: dict[str, Any]


def read(config: Config) -> Pretrained:
    """What `config.pretrained` names.

    Raises:
        UserError: there is no such run, it cannot be loaded, or its network has no such part.
    """
    options = config.pretrained
    assert options.run is not None
    trained = load_agent(Path(options.run).expanduser(), "cpu", config.plugins)
    actor = getattr(trained.agent, "actor", None)  # agents that learn nothing have none
    parts = {} if actor is None else dict(actor.named_children())
    if unknown := [name for name in options.parts if name not in parts]:
        raise UserError(
            f"pretrained.parts=[{','.join(options.parts)}]: the agent of {options.run} has no "
            f"{unknown[0]!r}; it has {', '.join(parts) or 'no parts with weights'}"
        )
    there = trained.config
    described = {
        "experiment": there.experiment,
        "condition": there.condition,
        "seed": there.seed,
        "update": trained.update,
        "frames": trained.update * there.collector.num_envs * there.collector.unroll_length,
        "parts": options.parts,
    }
    return Pretrained({name: parts[name].state_dict() for name in options.parts}, described)


def told(described: dict[str, Any]) -> str:
    """A line about where the weights are from."""
    return (
        f"begins with the {', '.join(described['parts'])} of {described['experiment']} "
        f"{described['condition']} seed {described['seed']} at update {described['update']}"
    )
