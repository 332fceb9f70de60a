"""Our own agents as policies of the evaluator."""

from __future__ import annotations

import torch
from numpy.typing import NDArray

from zipf.agents.agent import Agent
from zipf.agents.network import Inputs


class AgentPolicy:
    """An agent with its memory; its actions are drawn by a generator of its own.

    Args:
        agent: acts as it does when it is scored, without exploration.
        seed: of the draws.

    Attributes:
        deterministic: take the most probable action in the place of a draw, of an agent whose `act`
            returns `logits`. Others, such as R2D2, are taken to draw nothing when they are scored.
    """

    def __init__(self, agent: Agent, *, seed: int):
        self.agent = agent
        self.device = agent.device
        self.deterministic = False
        self.generator = torch.Generator().manual_seed(seed)

    def start(self, num_envs: int) -> None:
        self.memory = self.agent.initial_memory(num_envs)
        self.action = torch.full((num_envs,), -1, device=self.device)

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        first = torch.from_numpy(is_first).to(self.device)
        inputs = Inputs(
            {name: torch.from_numpy(part).to(self.device) for name, part in observation.items()},
            self.action.masked_fill(first, -1),
            torch.from_numpy(reward).to(self.device).masked_fill(first, 0.0),
            first,
        )
        self.action, self.memory, of_step = self.agent.act(
            inputs, self.memory, self.generator, training=False
        )
        if self.deterministic and "logits" in of_step:
            self.action = of_step["logits"].argmax(-1)
        self.action = self.action.to(self.device)  # an agent may draw on the host
        return self.action.cpu().numpy()
