"""The paper's supervised classifier: left or right, from an episode's first frame.

It is trained by cross-entropy and has the network of the agents that act. Its worlds ask one
question an episode: the action is the answer, and the reward is 1 if it is right. In training the
answers are random, which gives the label just as well: of two answers, either this one or the
other is right. Where both are right, because the two objects are the same, the label is random.

An update learns from num_envs x unroll_length first frames, each of an episode of its own. That is
as many images as the agents that act learn from in an update, so that frames, updates and times
compare; the paper does not give the size of its classifier's batches. Frames with weights have
their losses multiplied by them. The two answers are equally likely, whatever is asked for: there is
no imbalance of labels to correct, as by adjusted logits (Menon et al. 2021).

With hindsight it also learns from questions as if what was asked for were on the side that was
answered, the other object where the answer was wrong. Their mean cross-entropy is added, times
`policy_cost`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from pydantic import Field
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.agent import Agent, Setting, register
from zipf.agents.averaging import average_gradients
from zipf.agents.hindsight import NoHindsightOptions, matching_loss
from zipf.agents.memory import MemoryOptions, State
from zipf.agents.network import Inputs, Torso, autocast, head, in_full
from zipf.agents.network_options import NetworkOptions
from zipf.agents.reweighting import weighted
from zipf.agents.unroll import Unroll
from zipf.options import Options

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, lt=1)]


class SupervisedOptions(Options):
    """The options; `configs/agent/supervised.yaml` has the sources of their values."""

    name: Literal["supervised"]
    learning_rate: Positive
    adam_beta1: Fraction
    adam_beta2: Fraction
    adam_epsilon: Positive
    max_gradient_norm: Positive


class Classifier(Torso):
    """The network of an agent that acts, with one head for the two answers."""

    def __init__(
        self,
        observation_space: gym.spaces.Dict,
        action_space: gym.Space,
        network: NetworkOptions,
        memory: MemoryOptions,
    ):
        super().__init__(observation_space, action_space, network, memory)
        self.answer = head(self.memory.size, network.head_size, self.actions)

    def forward(self, inputs: Inputs, state: State) -> Tensor:
        """Logits of the answers, float32 [T, B, 2]."""
        _, core, _ = self.remember(inputs, state)
        with in_full(core) as exact:
            return self.answer(exact)


@register
class Supervised(Agent):
    """The classifier, as an agent: answers batches of questions and learns from unrolls of them.

    Raises:
        ValueError: there are not two answers.
    """

    Options = SupervisedOptions
    largest_lag = 1  # its answers in training do not depend on what it has learned
    weighted_losses = True
    learns_from_hindsight = True
    averages_gradients = True
    answers_questions = True
    learns_from_rewards = False
    options: SupervisedOptions
    actor: Classifier

    def __init__(self, options: SupervisedOptions, setting: Setting):
        super().__init__(options, setting)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setting.seed)
            self.network = Classifier(
                setting.observation_space, setting.action_space, setting.network, setting.memory
            )
        if self.network.actions != 2:
            raise ValueError(
                f"a classifier chooses one of two answers, not of {self.network.actions}"
            )
        self.network.to(self.device)
        self.actor = self.network
        self.optimiser = torch.optim.Adam(
            self.network.parameters(),
            lr=options.learning_rate,
            betas=(options.adam_beta1, options.adam_beta2),
            eps=options.adam_epsilon,
            fused=True,
        )
        self.updates = 0

    def initial_memory(self, batch: int) -> State:
        """The memory before the first frame of `batch` worlds, and at any later time: every
        episode is one frame long."""
        return self.network.memory.initial_state(batch)

    @torch.no_grad()
    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Answers in each of B worlds, int64 [B]: random in training, else the likelier one."""
        batch = len(inputs.is_first)
        if training:
            return torch.randint(2, (batch,), generator=generator), memory, {}
        with autocast(self.device, self.precision):
            logits = self.actor(inputs.unsqueeze(), memory)
        return logits[0].argmax(-1), memory, {}

    def update(self, unroll: Unroll) -> dict[str, float]:
        """One optimiser step on the unroll's first T rows.

        The metric `accuracy` is that on their labels, which are random where both objects are the
        same.

        Raises:
            FloatingPointError: learning has diverged; no weights were changed.
        """
        steps = unroll.steps[:-1]
        label = torch.where(steps["reward"] > 0, steps["action"], 1 - steps["action"])
        with autocast(self.device, self.precision):
            logits = self.network(Inputs.of(steps), unroll.memory)
        losses = F.cross_entropy(logits.flatten(0, 1), label.flatten(), reduction="none")
        relabelled_loss, relabelled_metrics = self._hindsight_loss(unroll.episodes)
        loss = weighted(losses.view_as(label), steps).mean() + relabelled_loss

        self.optimiser.zero_grad()
        loss.backward()
        parameters = list(self.network.parameters())
        average_gradients(parameters)
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.options.max_gradient_norm)
        if not norm.isfinite():
            raise FloatingPointError(f"the gradient's norm is {norm.item()}")
        self.optimiser.step()
        self.updates += 1
        accuracy = (logits.argmax(-1) == label).float().mean()
        metrics = {
            "loss": loss,
            "accuracy": accuracy,
            "gradient_norm": norm,
            **relabelled_metrics,
        }
        return {name: metric.item() for name, metric in metrics.items()}

    def _hindsight_loss(
        self, questions: TensorDict | None
    ) -> tuple[Tensor | float, dict[str, Tensor]]:
        """The loss of relabelled questions [1, E], to which the answers are right, and metrics."""
        options = self.setting.hindsight
        if isinstance(options, NoHindsightOptions):
            return 0.0, {}
        matching, matched = matching_loss(
            self.network.encoder, questions, options, precision=self.precision
        )
        if questions is None:
            return matching, {"hindsight_accuracy": torch.tensor(float("nan")), **matched}
        answer = questions["action"][0]
        with autocast(self.device, self.precision):
            logits = self.network(Inputs.of(questions), self.initial_memory(len(answer)))[0]
        loss = options.policy_cost * options.share(self.updates) * F.cross_entropy(logits, answer)
        accuracy = (logits.argmax(-1) == answer).float().mean()
        return loss + matching, {"hindsight_accuracy": accuracy, **matched}

    def state_dict(self) -> dict[str, Any]:
        """Everything that `update` changes."""
        return {
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.updates = state["updates"]
