"""Imitation by DAgger (Ross et al. 2011): the agent acts, and a teacher says what it would do.

The teacher is a scripted player of the worlds' family (`zipf.envs.SCRIPTED`). The learner takes one
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

from typing import Annotated, Any, Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from pydantic import Field
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.agent import Agent, Setting, register
from zipf.agents.auxiliary import build_auxiliary
from zipf.agents.averaging import average_gradients
from zipf.agents.episodic import NO_EPISODIC, EpisodicOptions, build_dictionary, build_recorder
from zipf.agents.hindsight import NoHindsightOptions, matching_loss
from zipf.agents.memory import MemoryOptions, State
from zipf.agents.network import Inputs, Torso, autocast, head, in_full, sampled
from zipf.agents.network_options import NetworkOptions
from zipf.agents.reweighting import weighted
from zipf.agents.unroll import Unroll
from zipf.options import Options

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, lt=1)]


class ImitationOptions(Options):
    """The options; `configs/agent/imitation.yaml` has the sources of their values.

    `teacher` is a scripted player of the worlds, `teacher_share` the probability that it acts in a
    step in the agent's place.
    """

    name: Literal["imitation"]
    teacher: Literal["expert", "generalist"]
    teacher_share: Annotated[float, Field(ge=0, le=1)]
    learning_rate: Positive
    adam_beta1: Fraction
    adam_beta2: Fraction
    adam_epsilon: Positive
    max_gradient_norm: Positive


class Policy(Torso):
    """The network of an agent that acts, with a head for the policy alone."""

    def __init__(
        self,
        observation_space: gym.spaces.Dict,
        action_space: gym.Space,
        network: NetworkOptions,
        memory: MemoryOptions,
        episodic: EpisodicOptions = NO_EPISODIC,
    ):
        super().__init__(observation_space, action_space, network, memory)
        self.policy = head(self.memory.size, network.head_size, self.actions)
        self.dictionary = build_dictionary(self.memory.size, self.actions, episodic)

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, Tensor, State]:
        """Logits float32 [T, B, actions], the memory's outputs [T, B, size], and its state."""
        _, core, state = self.remember(inputs, state)
        with in_full(core) as exact:
            read = exact if self.dictionary is None else self.dictionary(exact)
            return self.policy(read), core, state


@register
class Imitation(Agent):
    """The agent: samples actions from its policy in training, and learns its teacher's."""

    Options = ImitationOptions
    auxiliary_losses = True
    episodic_memory = True
    weighted_losses = True
    averages_gradients = True
    learns_from_hindsight = True
    learns_from_rewards = False
    largest_lag = 1  # labels do not depend on the weights that acted
    options: ImitationOptions
    actor: Policy

    def __init__(self, options: ImitationOptions, setting: Setting):
        super().__init__(options, setting)
        self.teacher = options.teacher
        self.teacher_share = options.teacher_share
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setting.seed)
            self.network = Policy(
                setting.observation_space,
                setting.action_space,
                setting.network,
                setting.memory,
                setting.episodic,
            )
            self.auxiliary = build_auxiliary(
                setting.auxiliary,
                setting.observation_space,
                setting.network,
                self.network,
                setting.seed,
            )
        self.recorder = build_recorder(
            setting.episodic,
            setting.observation_space,
            setting.num_envs,
            self.network.memory.size,
            self.network.actions,
            setting.seed,
        )
        self.network.to(self.device)
        self.auxiliary.to(self.device)
        self.recorder.to(self.device)
        self.actor = self.network
        self.learned = [*self.network.parameters(), *self.auxiliary.learned()]
        self.optimiser = torch.optim.Adam(
            self.learned,
            lr=options.learning_rate,
            betas=(options.adam_beta1, options.adam_beta2),
            eps=options.adam_epsilon,
            fused=True,
        )
        self.updates = 0

    def initial_memory(self, batch: int) -> State:
        """The memory before the first frame of `batch` worlds."""
        return self.network.memory.initial_state(batch)

    @torch.no_grad()
    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Actions in each of B worlds, int64 [B]: samples in training, else the likeliest ones,
        which are what the agent takes for its teacher's (as in Ross et al. 2011)."""
        with autocast(self.device, self.precision):
            outputs, _, memory = self.actor(inputs.unsqueeze(), memory)
        logits = outputs[0]
        action = sampled(logits, generator) if training else logits.argmax(-1)
        return action, memory, {}

    def update(self, unroll: Unroll) -> dict[str, float]:
        """One optimiser step on the unroll's first T rows.

        The metric `accuracy` is the share of frames in which the likeliest action is the teacher's.

        Raises:
            FloatingPointError: learning has diverged; no weights were changed.
        """
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with autocast(self.device, self.precision):
            outputs, core, _ = self.network(inputs, unroll.memory)
            auxiliary_loss, auxiliary_metrics = self.auxiliary(inputs, core)
            episodic_loss, episodic_metrics = self.recorder(self.network.encoder)
        logits, label = outputs[:-1], steps["label"][:-1]
        losses = F.cross_entropy(logits.flatten(0, 1), label.flatten(), reduction="none")
        imitation_loss = weighted(losses.view_as(label), steps[:-1]).mean()
        relabelled_loss, relabelled_metrics = self._hindsight_loss(unroll.episodes)
        loss = imitation_loss + auxiliary_loss + episodic_loss + relabelled_loss

        self.optimiser.zero_grad()
        loss.backward()
        average_gradients(self.learned)
        gradient_norm = torch.nn.utils.clip_grad_norm_(self.learned, self.options.max_gradient_norm)
        if not gradient_norm.isfinite():
            raise FloatingPointError(f"the gradient's norm is {gradient_norm.item()}")
        self.optimiser.step()
        self.updates += 1
        self.auxiliary.after_update(self.network.encoder)
        self.recorder.record(self.network.dictionary, steps, core, steps["label"])
        log_policy = logits.detach().log_softmax(-1)
        metrics = {
            "loss": loss,
            "imitation_loss": imitation_loss,
            "accuracy": (logits.argmax(-1) == label).float().mean(),
            "entropy": -(log_policy.exp() * log_policy).sum(-1).mean(),
            "gradient_norm": gradient_norm,
            **auxiliary_metrics,
            **episodic_metrics,
            **relabelled_metrics,
        }
        return {name: metric.item() for name, metric in metrics.items()}

    def _hindsight_loss(
        self, episodes: TensorDict | None
    ) -> tuple[Tensor | float, dict[str, Tensor]]:
        """The loss of relabelled episodes [L, E], unrolled from before their first frame, and
        metrics."""
        options = self.setting.hindsight
        if isinstance(options, NoHindsightOptions):
            return 0.0, {}
        matching, matched = matching_loss(
            self.network.encoder, episodes, options, precision=self.precision
        )
        if episodes is None:
            return matching, {"hindsight_accuracy": torch.tensor(float("nan")), **matched}
        mask, action = episodes["mask"], episodes["action"]
        with autocast(self.device, self.precision):
            logits, _, _ = self.network(Inputs.of(episodes), self.initial_memory(mask.shape[1]))
        loss = F.cross_entropy(logits[mask], action[mask])
        accuracy = (logits.argmax(-1) == action)[mask].float().mean()
        cost = options.policy_cost * options.share(self.updates)
        return cost * loss + matching, {"hindsight_accuracy": accuracy, **matched}

    def state_dict(self) -> dict[str, Any]:
        """Everything that `update` changes."""
        return {
            "network": self.network.state_dict(),
            "auxiliary": self.auxiliary.state_dict(),
            "recorder": self.recorder.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.network.load_state_dict(state["network"])
        self.auxiliary.load_state_dict(state["auxiliary"])
        self.recorder.load_state_dict(state["recorder"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.updates = state["updates"]

    def carried(self) -> dict[str, Any]:
        """What the recorder keeps of the episodes that the worlds are in."""
        return self.recorder.carried()

    def carry(self, carried: dict[str, Any]) -> None:
        """Goes on with other worlds."""
        self.recorder.carry(carried)
