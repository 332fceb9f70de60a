"""The paper's supervised classifier: left or right, from an episode's first frame.

It is trained by cross-entropy and has the network of the agents that act. Its envs ask one
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

from typing import Any, Literal

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.agent import register
from zipf.agents.hindsight import NoHindsightOptions, matching_loss
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.memory import State
from zipf.agents.network import Inputs, Torso, in_full
from zipf.agents.unroll import Unroll, weighted


class SupervisedOptions(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values."""

    name: Literal["supervised"]


class Classifier(Torso):
    """The network of an agent that acts, with one head for the two answers."""

    def __init__(self, *torso: Any):
        super().__init__(*torso)
        self.answer = self.make_head(self.actions)

    def forward(self, inputs: Inputs, state: State) -> Tensor:
        """Logits of the answers, float32 [T, B, 2]."""
        core, _ = self.remember(inputs, state)
        with in_full(core) as exact:
            return self.answer(exact)


@register
class Supervised(Learner):
    """The classifier, as an agent: answers batches of questions and learns from unrolls of them.
    Raises ValueError: there are not two answers."""

    Options = SupervisedOptions
    supports = frozenset({"hindsight", "reweighting"})
    largest_lag = 1  # its answers in training do not depend on what it has learned
    answers_questions = True
    options: SupervisedOptions
    network: Classifier
    actor: Classifier

    def make_network(self) -> Classifier:
        network = Classifier(*self.spec.torso)
        if network.actions != 2:
            raise ValueError(f"a classifier chooses one of two answers, not of {network.actions}")
        return network

    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Answers in each of B envs, int64 [B]: random in training, else the likelier one."""
        batch = len(inputs.is_first)
        if training:
            return torch.randint(2, (batch,), generator=generator), memory, {}
        logits = self.forward_actor(inputs.unsqueeze(), memory)
        return logits[0].argmax(-1), memory, {}

    def loss(self, unroll: Unroll) -> Loss:
        """The loss of the unroll's first T rows.

        The metric `accuracy` is that on their labels, which are random where both objects are the
        same.
        """
        steps = unroll.steps[:-1]
        label = torch.where(steps["reward"] > 0, steps["action"], 1 - steps["action"])
        with self.autocast():
            logits = self.network(Inputs.of(steps), unroll.memory)
        losses = F.cross_entropy(logits.flatten(0, 1), label.flatten(), reduction="none")
        relabelled_loss, relabelled_metrics = self._hindsight_loss(unroll.episodes)
        loss = weighted(losses.view_as(label), steps).mean() + relabelled_loss

        accuracy = (logits.argmax(-1) == label).float().mean()
        return Loss(loss, {"accuracy": accuracy, **relabelled_metrics})

    def _hindsight_loss(
        self, questions: TensorDict | None
    ) -> tuple[Tensor | float, dict[str, Tensor]]:
        """The loss of relabelled questions [1, E], to which the answers are right, and metrics."""
        options = self.spec.hindsight
        if isinstance(options, NoHindsightOptions):
            return 0.0, {}
        matching, matched = matching_loss(
            self.network.encoder, questions, options, precision=self.precision
        )
        if questions is None:
            return matching, {"hindsight_accuracy": torch.tensor(float("nan")), **matched}
        answer = questions["action"][0]
        with self.autocast():
            logits = self.network(Inputs.of(questions), self.initial_memory(len(answer)))[0]
        loss = options.policy_cost * options.share(self.updates) * F.cross_entropy(logits, answer)
        accuracy = (logits.argmax(-1) == answer).float().mean()
        return loss + matching, {"hindsight_accuracy": accuracy, **matched}
