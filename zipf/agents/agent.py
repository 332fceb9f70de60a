"""What an agent is: its base class, what it is built from, and the registry of all agents.

An agent acts on batches of observations and learns from unrolls. To add one, derive from `Agent`,
or from `zipf.agents.learner.Learner`, which has all that learning by gradients takes; give it a
class of options and register it:

    class MyOptions(Options):
        name: Literal["mine"]
        learning_rate: float

    @register
    class Mine(Agent):
        Options = MyOptions
        ...

`zipf.agents.impala` is a complete example.

**All losses here are means** over the time and the batch that an update learns from, auxiliary
losses included. So the bound on the gradient's norm and Adam's epsilon keep their meaning with
another batch size or unroll length. Where a source takes sums over n terms, its bound and its
epsilon are divided by n, which leaves Adam's steps as they were; the files in `configs/` say where
that was done.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import gymnasium as gym
import torch
from torch import Tensor

from zipf.agents.auxiliary import NO_AUXILIARY, AuxiliaryOptions
from zipf.agents.critics import SCALAR
from zipf.agents.episodic import NO_EPISODIC, EpisodicOptions
from zipf.agents.hindsight import NO_HINDSIGHT, HindsightOptions
from zipf.agents.memory import State
from zipf.agents.network import Inputs
from zipf.agents.network_options import NetworkOptions
from zipf.agents.unroll import Augmentation, Needs, Unroll
from zipf.options import Context, Options, name_of
from zipf.registry import Registry


@dataclass(frozen=True)
class AgentSpec:
    """What an agent is built from, beside its own options.

    Attributes:
        observation_space, action_space: of one env.
        network, memory, auxiliary, critic, episodic: options of the encoder, the memory, the
            auxiliary loss, what is learned about returns, and episodic memory.
        num_envs, unroll_length: B and T of the unrolls that the agent will learn from; with several
            learners, of each of them.
        seed: of the initial weights and of all that an agent draws by itself.
        device: where it computes, as PyTorch names it.
        precision: "float32", or "bfloat16" for automatic mixed precision.
        weighted: whether the frames of unrolls have a `weight`.
        hindsight: options of hindsight; unless "none", unrolls have relabelled `episodes`.
        augmentation: of what the agent sees in training; unless None, unrolls have a `draw`.
        unroll_space: observations as unrolls hold them, before the augmentation; None: those of
            `observation_space`.
    """

    observation_space: gym.spaces.Dict
    action_space: gym.Space
    network: NetworkOptions
    memory: Options
    auxiliary: AuxiliaryOptions = NO_AUXILIARY
    critic: Options = SCALAR
    episodic: EpisodicOptions = NO_EPISODIC
    num_envs: int = 1
    unroll_length: int = 1
    seed: int = 0
    device: str = "cpu"
    precision: Literal["float32", "bfloat16"] = "float32"
    weighted: bool = False
    hindsight: HindsightOptions = NO_HINDSIGHT
    augmentation: Augmentation | None = None
    unroll_space: gym.spaces.Dict | None = None

    @property
    def torso(self) -> tuple[gym.spaces.Dict, gym.Space, NetworkOptions, Options]:
        """The arguments of a `zipf.agents.network.Torso`."""
        return self.observation_space, self.action_space, self.network, self.memory

    @property
    def context(self) -> Context:
        """What an agent's options check themselves against; of the envs only the spaces are
        known."""
        chosen = {name: getattr(self, name) for name in _PARTS}
        return Context("", True, self.num_envs, self.unroll_length, chosen)


_PARTS = ("network", "memory", "auxiliary", "critic", "episodic", "hindsight")

LACKING = {
    "auxiliary": "has no auxiliary losses",
    "critic": "learns no distribution of returns",
    "episodic": "has no episodic memory",
    "exploration": "does not learn from rewards",
    "hindsight": "does not learn from hindsight",
    "reweighting": "does not weigh its losses",
}
"""Groups of options that not every agent supports, and what is said of one that does not."""


class Agent(ABC):
    """The base of all agents.

    Attributes:
        Options: the class of its options; their `name: Literal["..."]` names the agent.
        supports: the groups of options that it learns with, of `LACKING`. In the others only
            the plain choice is accepted: no such part, or the scalar critic.
        largest_lag: how many unrolls collection may run ahead of learning on one machine. With 0
            an agent is on-policy: it learns only from unrolls of its newest weights. With more it
            can also learn from actors in a cluster, whose weights are older by some updates; such
            an agent is a `zipf.agents.learner.Learner`, which has weights to publish.
        learns_from_parts: whether an update may learn from a part of an unroll's envs, so that the
            weights that played the last part are older than those of the first.
        captures: whether `act`, `value` and what an update computes are functions of tensors in
            fixed shapes, without waiting for the device, so that they can be captured as CUDA
            graphs, and the agent can learn from envs that are stepped on its device.
        host_envs_only: whether something that it learns from, such as labels of a scripted teacher,
            comes from envs that are stepped on the host.
        averages_gradients: whether it learns from the mean of several learners' gradients
            (`zipf.agents.averaging`), so that its state stays the same in all of them.
        answers_questions: whether it is a classifier, which answers a question about an episode's
            first frame and takes no other action.
        needs: what it needs of unrolls beyond what all have.
        augmentation: that of `spec`. `act` and `value` are given observations that it has changed;
            `update` has `Unroll.changed` for it.

    Raises:
        ValueError: options that do not go together, a line for each problem.
    """

    Options: ClassVar[type[Options]]
    supports: ClassVar[frozenset[str]] = frozenset({"exploration"})
    largest_lag: ClassVar[int] = 0
    learns_from_parts: ClassVar[bool] = False
    captures: ClassVar[bool] = False
    host_envs_only: ClassVar[bool] = False
    averages_gradients: ClassVar[bool] = False
    answers_questions: ClassVar[bool] = False
    needs: Needs = Needs()
    augmentation: Augmentation | None = None

    def __init__(self, options: Any, spec: AgentSpec):
        wrong = [*options.problems(spec.context), *unsupported(type(self), spec.context.chosen)]
        if wrong:
            raise ValueError("\n".join(wrong))
        self.options = options
        self.spec = spec
        self.device = spec.device
        self.augmentation = spec.augmentation

    def initial_memory(self, batch: int) -> State:
        """The memory before the first frame of `batch` envs, {name: [B, ...]}; empty for an agent
        without one."""
        return {}

    @abstractmethod
    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """One action in each of B envs.

        Args:
            inputs: of one frame, with leading axis [B].
            memory: before this frame.
            generator: of all random draws, which are made on its device: the CPU's wherever the
                agent computes, so that a run can move between devices, or one of the agent's own.
            training: False where the agent is scored: then it does not explore.

        Returns:
            Actions int64 [B], the memory after this frame, and tensors [B, ...] by name that
            `update` will find in the unroll's steps. An agent that draws actions returns their
            `logits` [B, A] here, of which `deterministic=True` takes the largest.
        """

    def value(self, inputs: Inputs, memory: State) -> Tensor:
        """The value, float32 [B], of the observations that episodes were truncated at; zeros for
        an agent that does not bootstrap from them."""
        return torch.zeros(len(inputs.is_first), device=self.device)

    def begin_learning(self, folder: Path | None = None, every: int = 0) -> list[str]:
        """Allocates what learning alone needs; called once before the first `update` or
        `load_state_dict` of a run, and not for an agent that only acts.

        Args:
            folder: where the agent may keep files; None where there is no such place.
            every: updates between two checkpoints, at most.

        Returns:
            Lines to show to the user.

        Raises:
            ValueError: this machine lacks the RAM or the disk space.
        """
        return []

    @abstractmethod
    def update(self, unroll: Unroll) -> Mapping[str, float | Tensor]:
        """One update from an unroll, in RAM or, where envs are stepped there, on the device. The
        next unroll overwrites it. Returns metrics to log, numbers or tensors [], which the next
        update may overwrite.

        Raises:
            FloatingPointError: learning has diverged; no weights were changed.
            OSError: files could not be written.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Everything that later calls of `act` and `update` depend on."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""


AGENTS: Registry[Agent] = Registry("agent")
"""Each is built from its options and an agent's `AgentSpec`."""
AnyAgent = TypeVar("AnyAgent", bound=type[Agent])


def register(agent: AnyAgent) -> AnyAgent:
    """Adds a class of agents to the registry, under the name in its options; a class decorator.

    Raises:
        ValueError: its options have no `name: Literal["..."]`, the name is taken, or it has a
            `largest_lag` and nothing to publish.
    """
    if agent.largest_lag and not hasattr(agent, "publish"):
        raise ValueError(
            f"agent {name_of(agent.Options)!r}: largest_lag={agent.largest_lag} is for agents that "
            "publish their weights, as a zipf.agents.learner.Learner does"
        )
    AGENTS.register(agent.Options, agent)
    return agent


def unsupported(agent: type[Agent], chosen: Mapping[str, Any]) -> Iterator[str]:
    """One line for each choice, by the name of its group, that the agent does not support."""
    for group, lacking in LACKING.items():
        plain = "scalar" if group == "critic" else "none"
        choice = chosen[group].name if group in chosen else plain
        if choice != plain and group not in agent.supports:
            others = [key for key, other in agents().items() if group in other.supports]
            name = name_of(agent.Options)
            yield (
                f"{group}={choice}: agent={name} {lacking}; choose {group}={plain}, or "
                f"agent={' or '.join(others)}"
            )


def agents() -> Mapping[str, type[Agent]]:
    """All registered agents by name; `agents()[options.name](options, spec)` builds one."""
    return AGENTS.builds()  # type: ignore[return-value]  # what builds an agent is its class
