"""IMPALA (Espeholt et al. 2018): an actor-critic with V-trace corrections, top to bottom.

The actor samples from the policy; the learner takes one optimiser step per unroll on

    mean_{t,b}[ -log pi(a_t|x_t) A_t + c_b/2 (v_t - V(x_t))^2 + c_e sum_a pi log pi ]

with v_t and A_t from V-trace, each frame's terms times its weight if it has one, plus the losses of
auxiliary tasks (`zipf.agents.auxiliary`), of episodic memory (`zipf.agents.episodic`) and of
relabelled episodes (`zipf.agents.hindsight`).

With a critic that learns a distribution (`zipf.agents.critics`) its loss against v_t takes the
place of (v_t - V)^2 / 2, and its risk measure that of V: V-trace bootstraps from it and subtracts
it in A_t. With a risk other than neutral this is ours. The policy gradient is still that of the
mean of what follows, as any baseline leaves it, but what follows ends in the risk measure of the
state that is reached, so that states with varied returns are avoided (averse) or sought (seeking).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from torch import Tensor

from zipf.agents.agent import Agent, Setting, register
from zipf.agents.auxiliary import build_auxiliary
from zipf.agents.averaging import average_gradients
from zipf.agents.episodic import build_recorder
from zipf.agents.hindsight import hindsight_loss
from zipf.agents.memory import State
from zipf.agents.network import ActorCritic, Inputs, action_log_probability, autocast, sampled
from zipf.agents.returns import vtrace
from zipf.agents.reweighting import weighted
from zipf.agents.unroll import Unroll
from zipf.options import Options

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, lt=1)]


class ImpalaOptions(Options):
    """The options; `configs/agent/impala.yaml` has the sources of their values."""

    name: Literal["impala"]
    learning_rate: Positive
    adam_beta1: Fraction
    adam_beta2: Fraction
    adam_epsilon: Positive
    max_gradient_norm: Positive
    discount: Annotated[float, Field(ge=0, le=1)]
    baseline_cost: NotNegative
    entropy_cost: NotNegative
    clip_rho: Positive
    clip_pg_rho: Positive
    clip_c: Positive
    trace_lambda: Annotated[float, Field(ge=0, le=1)]


@register
class Impala(Agent):
    """The agent: samples actions from the policy and learns from unrolls."""

    Options = ImpalaOptions
    auxiliary_losses = True
    any_critic = True
    episodic_memory = True
    weighted_losses = True
    averages_gradients = True
    learns_from_hindsight = True
    largest_lag = 1  # V-trace corrects for it
    options: ImpalaOptions
    actor: ActorCritic

    def __init__(self, options: ImpalaOptions, setting: Setting):
        super().__init__(options, setting)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setting.seed)
            self.network = ActorCritic(
                setting.observation_space,
                setting.action_space,
                setting.network,
                setting.memory,
                setting.critic,
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
        """Samples an action in each of B worlds, in training and evaluation alike.

        Returns actions int64 [B], the memory after this frame, and the behaviour policy's `logits`
        float32 [B, actions], which `update` needs.
        """
        with autocast(self.device, self.precision):
            outputs = self.actor(inputs.unsqueeze(), memory)
        logits = outputs.logits[0]
        return sampled(logits, generator), outputs.state, {"logits": logits}

    @torch.no_grad()
    def value(self, inputs: Inputs, memory: State) -> Tensor:
        """V of each of B worlds, float32 [B]."""
        with autocast(self.device, self.precision):
            return self.actor(inputs.unsqueeze(), memory).value[0]

    def update(self, unroll: Unroll) -> dict[str, float]:
        """One optimiser step; returns the losses and other metrics.

        Raises:
            FloatingPointError: learning has diverged; no weights were changed.
        """
        o = self.options
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with autocast(self.device, self.precision):
            outputs = self.network(inputs, unroll.memory)
            auxiliary_loss, auxiliary_metrics = self.auxiliary(inputs, outputs.core)
            episodic_loss, episodic_metrics = self.recorder(self.network.encoder)

        steps = steps[:-1]
        log_policy = outputs.logits[:-1].log_softmax(-1)
        log_pi = action_log_probability(log_policy, steps["action"])
        log_mu = action_log_probability(steps["logits"].log_softmax(-1), steps["action"])
        returns = vtrace(
            log_ratios=log_pi.detach() - log_mu,
            rewards=steps["reward"] + steps["bonus"],
            values=outputs.value.detach(),
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=steps["truncation_value"],
            discount=o.discount,
            clip_rho=o.clip_rho,
            clip_pg_rho=o.clip_pg_rho,
            clip_c=o.clip_c,
            lambda_=o.trace_lambda,
        )
        policy_loss = -weighted(log_pi * returns.advantages, steps).mean()
        errors = self.network.critic.loss(outputs.baseline[:-1], returns.targets)
        baseline_loss = weighted(errors, steps).mean()
        entropy = -weighted((log_policy.exp() * log_policy).sum(-1), steps).mean()
        loss = policy_loss + o.baseline_cost * baseline_loss - o.entropy_cost * entropy
        relabelled_loss, relabelled_metrics = hindsight_loss(
            self.network,
            unroll.episodes,
            self.setting.hindsight,
            discount=o.discount,
            updates=self.updates,
            precision=self.precision,
        )
        loss = loss + auxiliary_loss + episodic_loss + relabelled_loss

        self.optimiser.zero_grad()
        loss.backward()
        average_gradients(self.learned)
        gradient_norm = torch.nn.utils.clip_grad_norm_(self.learned, o.max_gradient_norm)
        if not gradient_norm.isfinite():
            raise FloatingPointError(f"the gradient's norm is {gradient_norm.item()}")
        self.optimiser.step()
        self.updates += 1
        self.auxiliary.after_update(self.network.encoder)
        self.recorder.record(
            self.network.dictionary, unroll.steps, outputs.core, unroll.steps["action"]
        )
        metrics = {
            "loss": loss,
            "policy_loss": policy_loss,
            "baseline_loss": baseline_loss,
            "entropy": entropy,
            "gradient_norm": gradient_norm,
            "value": outputs.value.mean(),
            "importance_ratio": (log_pi - log_mu).exp().mean(),
            **auxiliary_metrics,
            **episodic_metrics,
            **relabelled_metrics,
        }
        return {name: metric.item() for name, metric in metrics.items()}

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
