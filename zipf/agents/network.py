"""Encoder, memory and heads, assembled from options."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import ClassVar, NamedTuple, TypeVar

import gymnasium as gym
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from zipf.agents.capture import is_recording
from zipf.agents.critics import CRITICS, SCALAR
from zipf.agents.encoders import Encoder
from zipf.agents.episodic import NO_EPISODIC, EpisodicOptions, build_dictionary
from zipf.agents.memory import MEMORIES, State
from zipf.agents.network_options import NetworkOptions
from zipf.options import Options

Module = TypeVar("Module", bound=nn.Module)


class Inputs(NamedTuple):
    """The inputs of an agent, with leading axes `[T, B]` in a network and `[B]` when acting."""

    observation: dict[str, Tensor]
    previous_action: Tensor  # int64, -1 where an episode begins
    previous_reward: Tensor  # float32, 0 where an episode begins
    is_first: Tensor  # bool: an episode begins here

    @classmethod
    def of(cls, steps: TensorDict) -> Inputs:
        """The agent's inputs among the steps of an unroll."""
        observation = {name: steps["observation", name] for name in steps["observation"].keys()}
        return cls(
            observation, steps["previous_action"], steps["previous_reward"], steps["is_first"]
        )

    def unsqueeze(self) -> Inputs:
        """`[B]` -> `[1, B]`."""
        observation = {name: part.unsqueeze(0) for name, part in self.observation.items()}
        return Inputs(observation, *(part.unsqueeze(0) for part in self[1:]))


class Outputs(NamedTuple):
    """The outputs of an actor-critic, with leading axes `[T, B]`; float32."""

    logits: Tensor  # [T, B, actions]
    value: Tensor  # [T, B], the critic's risk measure of the returns; by default their mean
    core: Tensor  # [T, B, memory size], the memory's output, which auxiliary losses read
    state: State  # {name: [B, ...]} after the last frame
    baseline: Tensor  # [T, B, critic.size], the outputs that the critic's loss reads


def head(inputs: int, hidden: int, outputs: int) -> nn.Module:
    """A linear head, or one with a hidden layer where `hidden` is not 0."""
    if hidden == 0:
        return nn.Linear(inputs, outputs)
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))


def frozen_copy(module: Module) -> Module:
    """A copy of a network that gradients do not reach.

    On CUDA the weights of an LSTM lie in one block of memory, or else are gathered at every call;
    in a copy they lie apart until `flatten_parameters`.
    """
    copy = deepcopy(module).requires_grad_(False)
    for part in copy.modules():
        if isinstance(part, nn.RNNBase):
            part.flatten_parameters()
    return copy


def sampled(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Actions drawn from a policy, [B, actions] -> int64 [B]: the largest of the logits plus Gumbel
    noise, which is drawn on the generator's device."""
    empty = torch.empty(logits.shape, device=generator.device)
    noise = -empty.exponential_(generator=generator).log()
    return (logits + noise.to(logits.device)).argmax(-1)


def action_log_probability(log_policy: Tensor, action: Tensor) -> Tensor:
    """log pi(a|x) of the actions taken: [T, B, actions], [T, B] -> [T, B]."""
    return log_policy.gather(-1, action.unsqueeze(-1)).squeeze(-1)


def autocast(device: str, precision: str) -> torch.autocast:
    """Automatic mixed precision where `precision` is "bfloat16"; with "float32" nothing changes.

    Where a graph is recorded weights that were cast are not kept: all threads share the cache, and
    it is emptied whenever one of them leaves autocast.
    """
    return torch.autocast(
        torch.device(device).type,
        torch.bfloat16,
        enabled=precision == "bfloat16",
        cache_enabled=False if is_recording() else None,
    )


@contextmanager
def in_full(core: Tensor) -> Iterator[Tensor]:
    """The memory's output in float32, with autocast off: for heads. They are cheap, and the two or
    three digits of bfloat16 are too few to compare their outputs."""
    with torch.autocast(core.device.type, enabled=False):
        yield core.float()


class Torso(nn.Module):
    """Encoder and memory: all of an agent's network but its heads.

    The memory reads the encoded observation, the last action (one-hot; zeros where an episode
    begins) and the last reward, clipped to [-1, 1] (Espeholt et al. 2018).

    Attributes:
        value_heads: names of the parts whose outputs a critic reads.

    Raises:
        ValueError: the actions are not discrete, or the network cannot read the observations.
    """

    value_heads: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        observation_space: gym.spaces.Dict,
        action_space: gym.Space,
        network: NetworkOptions,
        memory: Options,
    ):
        super().__init__()
        if not isinstance(action_space, gym.spaces.Discrete):
            raise ValueError(
                f"the action space is {action_space}; agents here choose among discrete actions"
            )
        if action_space.start != 0:
            raise ValueError(f"the action space is {action_space}; actions should count from 0")
        self.actions = int(action_space.n)
        self.head_size = network.head_size
        self.encoder = Encoder(observation_space, network)
        self.memory = MEMORIES.build(memory, self.encoder.size + self.actions + 1)

    def make_head(self, outputs: int) -> nn.Module:
        """A head that reads the memory's outputs."""
        return head(self.memory.size, self.head_size, outputs)

    def parts(self) -> dict[str, nn.Module]:
        """What another network can begin with: children, such as `memory`, and parts of the
        encoder, such as `encoder.instruction`."""
        parts = {f"encoder.{name}": part for name, part in self.encoder.parts().items()}
        return dict(self.named_children()) | parts

    def fixed_parts(self) -> list[str]:
        """Names of the `parts` that do not learn."""
        trained = {
            name: [weight.requires_grad for weight in part.parameters()]
            for name, part in self.parts().items()
        }
        return [name for name, weights in trained.items() if weights and not any(weights)]

    def remember(self, inputs: Inputs, state: State) -> tuple[Tensor, State]:
        """Unrolls `[T, B]` frames from the memory's `state`: its outputs [T, B, memory size], and
        its state after the last frame."""
        steps, batch = inputs.is_first.shape
        encoded = self.encoder({k: v.flatten(0, 1) for k, v in inputs.observation.items()})
        actions = torch.arange(self.actions, device=encoded.device)
        encoded = encoded.view(steps, batch, -1)
        features = torch.cat(
            [
                encoded,
                (inputs.previous_action.unsqueeze(-1) == actions).to(encoded.dtype),
                inputs.previous_reward.clamp(-1, 1).unsqueeze(-1).to(encoded.dtype),
            ],
            -1,
        )
        return self.memory(features, inputs.is_first, state)


class ActorCritic(Torso):
    """Policy and value of a discrete-action agent with a memory.

    With episodic memory both read what is found in its `dictionary`, too.

    Attributes:
        critic: turns the outputs of the value's head, `baseline`, into values and losses.
    """

    value_heads = ("baseline",)

    def __init__(
        self,
        observation_space: gym.spaces.Dict,
        action_space: gym.Space,
        network: NetworkOptions,
        memory: Options,
        critic: Options = SCALAR,
        episodic: EpisodicOptions = NO_EPISODIC,
    ):
        super().__init__(observation_space, action_space, network, memory)
        self.critic = CRITICS.build(critic)
        self.policy = self.make_head(self.actions)
        self.baseline = self.make_head(self.critic.size)
        self.dictionary = build_dictionary(self.memory.size, self.actions, episodic)

    def forward(self, inputs: Inputs, state: State) -> Outputs:
        """Unrolls `[T, B]` frames from the memory's `state`."""
        core, state = self.remember(inputs, state)
        with in_full(core) as exact:
            read = exact if self.dictionary is None else self.dictionary(exact)
            logits, baseline = self.policy(read), self.baseline(read)
            return Outputs(logits, self.critic.value(baseline), core, state, baseline)
