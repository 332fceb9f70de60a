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

from typing import Literal

import torch
from torch import Tensor

from zipf.agents.agent import register
from zipf.agents.hindsight import hindsight_loss
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.memory import State
from zipf.agents.network import ActorCritic, Inputs, action_log_probability, sampled
from zipf.agents.returns import vtrace
from zipf.agents.unroll import Unroll, weighted
from zipf.options import NotNegative, Positive, Share


class ImpalaOptions(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values."""

    name: Literal["impala"]
    discount: Share
    baseline_cost: NotNegative
    entropy_cost: NotNegative
    clip_rho: Positive
    clip_pg_rho: Positive
    clip_c: Positive
    trace_lambda: Share


@register
class Impala(Learner):
    """The agent: samples actions from the policy and learns from unrolls."""

    Options = ImpalaOptions
    captures = True
    supports = frozenset(
        {"auxiliary", "critic", "episodic", "exploration", "hindsight", "reweighting"}
    )
    largest_lag = 1  # V-trace corrects for it
    learns_from_parts = True  # likewise
    options: ImpalaOptions
    network: ActorCritic
    actor: ActorCritic

    def make_network(self) -> ActorCritic:
        spec = self.spec
        return ActorCritic(*spec.torso, spec.critic, spec.episodic)

    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Samples an action, in training and evaluation alike; `logits` float32 [B, actions] are
        for `update`."""
        outputs = self.forward_actor(inputs.unsqueeze(), memory)
        logits = outputs.logits[0]
        return sampled(logits, generator), outputs.state, {"logits": logits}

    def value(self, inputs: Inputs, memory: State) -> Tensor:
        envs = len(inputs.is_first)
        inputs, memory = self.filled_up(inputs, memory)
        return self.forward_actor(inputs.unsqueeze(), memory).value[0, :envs]

    def loss(self, unroll: Unroll) -> Loss:
        o = self.options
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with self.autocast():
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
            self.spec.hindsight,
            discount=o.discount,
            updates=self.progress,
            precision=self.precision,
        )
        loss = loss + auxiliary_loss + episodic_loss + relabelled_loss

        metrics = {
            "policy_loss": policy_loss,
            "baseline_loss": baseline_loss,
            "entropy": entropy,
            "value": outputs.value.mean(),
            "importance_ratio": (log_pi - log_mu).exp().mean(),
            **auxiliary_metrics,
            **episodic_metrics,
            **relabelled_metrics,
        }
        kept = {"core": outputs.core, "action": unroll.steps["action"]}
        return Loss(loss, metrics, kept)
