"""Imitation by DAgger (Ross et al. 2011): the agent acts, and a teacher says what it would do.

The teacher is a scripted policy of the envs' family (`zipf.envs.SCRIPTED`). The learner takes one
optimiser step per unroll on

    -mean_{t,b}[ log pi(label_t|x_t) ]

each frame's term times its weight if it has one, plus the auxiliary loss and that of episodic
memory. With hindsight it also imitates the actions of relabelled episodes (Ghosh et al. 2021;
`zipf.agents.hindsight`): c_p times the same mean over their frames is added. The agent is not told
of rewards other than by its inputs. Where the teacher acts in all steps (`teacher_share` 1) this is
behavioural cloning (Pomerleau 1991).

Scores show what a long tail costs an agent that need not explore; they are not those of
reinforcement learning.
"""

from __future__ import annotations

from typing import Any, Literal

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.agent import AgentSpec, register
from zipf.agents.episodic import NO_EPISODIC, EpisodicOptions, build_dictionary
from zipf.agents.hindsight import NoHindsightOptions, matching_loss
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.memory import State
from zipf.agents.network import Inputs, Torso, in_full, sampled
from zipf.agents.unroll import Needs, Unroll, weighted
from zipf.options import Share


class ImitationOptions(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values.

    `teacher` is a scripted policy of the envs, `teacher_share` the probability that it acts in a
    step in the agent's place. With `likeliest` the agent is scored by its likeliest actions, which
    are what it takes for its teacher's (as in Ross et al. 2011), else by samples.
    """

    name: Literal["imitation"]
    teacher: Literal["expert", "generalist"]
    teacher_share: Share
    likeliest: bool = True


class Policy(Torso):
    """The network of an agent that acts, with a head for the policy alone."""

    def __init__(self, *torso: Any, episodic: EpisodicOptions = NO_EPISODIC):
        super().__init__(*torso)
        self.policy = self.make_head(self.actions)
        self.dictionary = build_dictionary(self.memory.size, self.actions, episodic)

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, Tensor, State]:
        """Logits float32 [T, B, actions], the memory's outputs [T, B, size], and its state."""
        core, state = self.remember(inputs, state)
        with in_full(core) as exact:
            read = exact if self.dictionary is None else self.dictionary(exact)
            return self.policy(read), core, state


@register
class Imitation(Learner):
    """The agent: samples actions from its policy in training, and learns its teacher's."""

    Options = ImitationOptions
    captures = True
    host_envs_only = True  # its teacher is a script that reads them
    supports = frozenset({"auxiliary", "episodic", "hindsight", "reweighting"})
    largest_lag = 1  # labels do not depend on the weights that acted
    options: ImitationOptions
    network: Policy
    actor: Policy

    def __init__(self, options: ImitationOptions, spec: AgentSpec):
        super().__init__(options, spec)
        self.needs = Needs(teacher=options.teacher, teacher_share=options.teacher_share)

    def make_network(self) -> Policy:
        return Policy(*self.spec.torso, episodic=self.spec.episodic)

    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Actions in each of B envs, int64 [B]: samples, or the likeliest ones (`likeliest`) where
        it does not train, and there with the `logits`."""
        outputs, _, memory = self.forward_actor(inputs.unsqueeze(), memory)
        logits = outputs[0]
        draws = training or not self.options.likeliest
        action = sampled(logits, generator) if draws else logits.argmax(-1)
        return action, memory, {} if training else {"logits": logits}

    def loss(self, unroll: Unroll) -> Loss:
        """The loss of the unroll's first T rows.

        The metric `accuracy` is the share of frames in which the likeliest action is the teacher's.
        """
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with self.autocast():
            outputs, core, _ = self.network(inputs, unroll.memory)
            auxiliary_loss, auxiliary_metrics = self.auxiliary(inputs, core)
            episodic_loss, episodic_metrics = self.recorder(self.network.encoder)
        logits, label = outputs[:-1], steps["label"][:-1]
        losses = F.cross_entropy(logits.flatten(0, 1), label.flatten(), reduction="none")
        imitation_loss = weighted(losses.view_as(label), steps[:-1]).mean()
        relabelled_loss, relabelled_metrics = self._hindsight_loss(unroll.episodes)
        loss = imitation_loss + auxiliary_loss + episodic_loss + relabelled_loss

        log_policy = logits.detach().log_softmax(-1)
        metrics = {
            "imitation_loss": imitation_loss,
            "accuracy": (logits.argmax(-1) == label).float().mean(),
            "entropy": -(log_policy.exp() * log_policy).sum(-1).mean(),
            **auxiliary_metrics,
            **episodic_metrics,
            **relabelled_metrics,
        }
        return Loss(loss, metrics, {"core": core, "action": steps["label"]})

    def _hindsight_loss(
        self, episodes: TensorDict | None
    ) -> tuple[Tensor | float, dict[str, Tensor]]:
        """The loss of relabelled episodes [L, E], unrolled from before their first frame, and
        metrics."""
        options = self.spec.hindsight
        if isinstance(options, NoHindsightOptions):
            return 0.0, {}
        matching, matched = matching_loss(
            self.network.encoder, episodes, options, precision=self.precision
        )
        if episodes is None:
            return matching, {"hindsight_accuracy": torch.tensor(float("nan")), **matched}
        mask, action = episodes["mask"], episodes["action"]
        with self.autocast():
            logits, _, _ = self.network(Inputs.of(episodes), self.initial_memory(mask.shape[1]))
        loss = F.cross_entropy(logits[mask], action[mask])
        accuracy = (logits.argmax(-1) == action)[mask].float().mean()
        cost = options.policy_cost * options.share(self.updates)
        return cost * loss + matching, {"hindsight_accuracy": accuracy, **matched}
