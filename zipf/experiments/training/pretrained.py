"""Weights of another run, which a new run begins with (`pretrained.run`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor

from zipf.agents.agent import Agent
from zipf.agents.learner import Learner
from zipf.agents.network import Torso
from zipf.errors import UserError
from zipf.experiments.building import run_folder
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.options.schema import Config
from zipf.experiments.training.runtime import OnlyLearner


def begin(config: Config, agent: Agent, learner: OnlyLearner) -> dict[str, Any] | None:
    """Gives an agent the weights that `config.pretrained` names, before anything else is done with
    it. Of several learners the first reads them.

    Returns what `run.json` says of where they are from; None where there are to be none.

    Raises:
        UserError: there is no such run, it cannot be loaded, or its network or this one has no such
            part, or another in its place.
    """
    run = config.pretrained.run
    if run is None:
        return None
    weights, described = learner.of_first(_read(config, run) if learner.is_first else None)
    try:
        if not isinstance(agent, Learner):
            raise ValueError("this agent has no network that takes the weights of another")
        agent.begin_with(weights)
    except ValueError as error:
        raise UserError(
            f"pretrained.run={run}: {error}; choose the same network, memory and observations, or "
            "fewer pretrained.parts"
        ) from None
    return described


def message(described: dict[str, Any]) -> str:
    """A line about where the weights are from."""
    return (
        f"begins with the {', '.join(described['parts'])} of {described['experiment']} "
        f"{described['condition']} seed {described['seed']} at update {described['update']}"
    )


def _outputs(critic: Any) -> str:
    """What the outputs of a value's head mean to a critic; a measure of risk is no part of it."""
    options = critic.model_dump(exclude={"name", "risk", "risk_level"})
    return " ".join([critic.name, *(f"{name}={value}" for name, value in options.items())])


def _read(config: Config, run: str) -> tuple[dict[str, dict[str, Tensor]], dict[str, Any]]:
    """The weights by part of the network, and where they are from."""
    folder = Path(run).expanduser()
    trained = load_agent(folder, "cpu", config.plugins)
    actor = trained.agent.actor if isinstance(trained.agent, Learner) else None
    if isinstance(actor, Torso):
        parts = actor.parts()
    else:
        parts = {} if actor is None else dict(actor.named_children())
    wanted = config.pretrained.parts
    if unknown := [name for name in wanted if name not in parts]:
        raise UserError(
            f"pretrained.parts=[{','.join(wanted)}]: the agent of {run} has no {unknown[0]!r}; it "
            f"has {', '.join(parts) or 'no parts with weights'}"
        )
    there = trained.config
    heads = actor.value_heads if isinstance(actor, Torso) else ()
    if taken := [name for name in wanted if name in heads]:
        # As many outputs may have another meaning, such as other bins of a histogram.
        one, other = (_outputs(options) for options in (config.critic, there.critic))
        if one != other:
            raise UserError(
                f"pretrained.parts=[{','.join(wanted)}]: {taken[0]} of {run} is for critic={other}"
                f", and this run has critic={one}; choose the same critic, or leave it out"
            )
    before = run_folder.read_description(folder).get("pretrained") or {"frames": 0}
    frames = trained.update * there.frames_per_update
    described = {
        "experiment": there.experiment,
        "condition": there.condition,
        "seed": there.seed,
        "update": trained.update,
        "frames": before["frames"] + frames,
        "parts": wanted,
    }
    return {name: parts[name].state_dict() for name in wanted}, described
