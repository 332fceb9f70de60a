"""PPO (Schulman et al. 2017): clipped policy gradients, for epochs over minibatches, top to bottom.

The actor samples from the policy mu. An update takes `epochs` x `minibatches` optimiser steps on
one unroll. Before the first, the network's values V_old of all frames give the advantages A, by
GAE(lambda) (Schulman et al. 2016), and the returns G = A + V_old; all steps share them. In every
epoch the envs are shuffled and dealt to the minibatches: whole sequences of T frames, which the
memory reads from what it was before the unroll. On the frames of its minibatch a step descends

    mean_{t,b}[ -min(r A', clip(r, 1 - eps, 1 + eps) A')
                + c_b/2 (G - V(x))^2 + c_e sum_a pi log pi ]

where r = pi(a|x) / mu(a|x), eps is `clip_ratio`, and A' are the minibatch's advantages less their
mean, divided by their standard deviation; each frame's terms times its weight if it has one, plus
the auxiliary loss (`zipf.agents.auxiliary`). With `clip_value` delta the value's loss is the larger
of that of V and of V_old + clip(V - V_old, -delta, delta), as in OpenAI's Baselines
(Dhariwal et al. 2017). With a critic that learns a distribution (`zipf.agents.critics`) its loss
against G takes the place of (G - V)^2 / 2, and its risk measure that of V.

Counts of updates, such as `updates`, `evaluation.every` and `learning_rate_decay`, are of unrolls:
rates fall from update to update, and are the same for all steps of one. What is saved as the
agent's `updates` counts optimiser steps. Metrics are means over the steps of an update.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from zipf.agents.agent import AgentSpec, register
from zipf.agents.capture import Captured, CudaGraph, Graph
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.memory import State
from zipf.agents.network import ActorCritic, Inputs, action_log_probability, sampled
from zipf.agents.returns import lambda_returns
from zipf.agents.unroll import Unroll, weighted
from zipf.options import Context, NotNegative, Positive, Share, Size

SMALLEST_DEVIATION = 1e-8  # added to that of the advantages; OpenAI's Baselines


class PPOOptions(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values."""

    name: Literal["ppo"]
    discount: Share
    gae_lambda: Share
    epochs: Size
    minibatches: Size
    clip_ratio: Positive
    clip_value: Positive | None
    baseline_cost: NotNegative
    entropy_cost: NotNegative

    def problems(self, context: Context) -> Iterator[str]:
        num_envs = context.num_envs
        if num_envs % self.minibatches:
            yield (
                f"agent.minibatches={self.minibatches}: should divide "
                f"collector.num_envs={num_envs}, as every minibatch has as many envs"
            )
        elif num_envs * context.unroll_length == self.minibatches:
            yield (
                f"agent.minibatches={self.minibatches}: leaves one frame to each, whose advantage "
                "less the mean is 0; should be smaller"
            )
        critic = context.chosen["critic"].name
        if self.clip_value is not None and critic != "scalar":
            yield (
                f"agent.clip_value={self.clip_value}: critic={critic} has no single value to "
                "clip; choose null, or critic=scalar"
            )


@register
class PPO(Learner):
    """The agent: samples actions from the policy and learns from unrolls.

    Each minibatch is one of `learn`'s batches; with several learners its gradients are averaged,
    and all shuffle alike. Where an update diverges, the steps before have changed the weights.

    Attributes:
        shuffling: deals envs to minibatches; on the CPU wherever the agent computes.
    """

    Options = PPOOptions
    captures = True
    supports = frozenset({"auxiliary", "critic", "exploration", "reweighting"})
    options: PPOOptions
    network: ActorCritic
    actor: ActorCritic

    def __init__(self, options: PPOOptions, spec: AgentSpec):
        super().__init__(options, spec)
        self.shuffling = torch.Generator().manual_seed(spec.seed)

    def make_network(self) -> ActorCritic:
        return ActorCritic(*self.spec.torso, self.spec.critic)

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

    def capture(self, graph: Callable[[str], Graph] = CudaGraph) -> None:
        super().capture(graph)
        self.estimates = Captured(  # type: ignore[assignment]  # which is called alike
            self.estimates, graph(self.device), list, name="the advantages of an update"
        )

    def update(self, unroll: Unroll) -> dict[str, Tensor]:
        if not self._sees_on_device:
            unroll = unroll.changed(self.augmentation)
        unroll = unroll.to(self.device)
        steps = unroll.steps.clone(recurse=False)
        steps["old_value"], steps["advantage"] = self.estimates(unroll)
        unroll = replace(unroll, steps=steps)
        found = []
        for _ in range(self.options.epochs):
            order = torch.randperm(steps.shape[1], generator=self.shuffling)
            for envs in order.view(self.options.minibatches, -1).to(self.device):
                metrics, _ = self.learn(of_envs(unroll, envs))
                found.append(torch.stack(list(metrics.values())))
        return dict(zip(metrics, torch.stack(found).mean(0).unbind(), strict=True))

    @torch.no_grad()
    def estimates(self, unroll: Unroll) -> tuple[Tensor, Tensor]:
        """V and advantages of an unroll's frames, float32 [T + 1, B] each; in row T the advantages
        are 0 and mean nothing."""
        with self.autocast():
            values = self.network(Inputs.of(self.seen(unroll).steps), unroll.memory).value
        steps = unroll.steps[:-1]
        returns = lambda_returns(
            rewards=steps["reward"] + steps["bonus"],
            values=values[1:],
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=steps["truncation_value"],
            discount=self.options.discount,
            lambda_=self.options.gae_lambda,
        )
        return values, torch.cat([returns, values[-1:]]) - values

    def loss(self, unroll: Unroll) -> Loss:
        """The loss of a minibatch, an unroll whose steps have `old_value` and `advantage`, the
        `estimates`."""
        o = self.options
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with self.autocast():
            outputs = self.network(inputs, unroll.memory)
            auxiliary_loss, auxiliary_metrics = self.auxiliary(inputs, outputs.core)

        steps = steps[:-1]
        log_policy = outputs.logits[:-1].log_softmax(-1)
        log_mu = steps["logits"].log_softmax(-1)
        log_pi = action_log_probability(log_policy, steps["action"])
        ratio = (log_pi - action_log_probability(log_mu, steps["action"])).exp()
        clipped = ratio.clamp(1 - o.clip_ratio, 1 + o.clip_ratio)
        advantages = normalised(steps["advantage"])
        surrogate = torch.minimum(ratio * advantages, clipped * advantages)
        policy_loss = -weighted(surrogate, steps).mean()

        critic, baseline = self.network.critic, outputs.baseline[:-1]
        returns = steps["advantage"] + steps["old_value"]
        errors = critic.loss(baseline, returns)
        if o.clip_value is not None:  # the scalar critic's outputs are its values
            old = steps["old_value"].unsqueeze(-1)
            near = old + (baseline - old).clamp(-o.clip_value, o.clip_value)
            errors = torch.maximum(errors, critic.loss(near, returns))
        baseline_loss = weighted(errors, steps).mean()

        entropy = -weighted((log_policy.exp() * log_policy).sum(-1), steps).mean()
        loss = policy_loss + o.baseline_cost * baseline_loss - o.entropy_cost * entropy
        metrics = {
            "policy_loss": policy_loss,
            "baseline_loss": baseline_loss,
            "entropy": entropy,
            "value": outputs.value.mean(),
            "clip_fraction": ((ratio - 1).abs() > o.clip_ratio).float().mean(),
            "kl": (log_mu.exp() * (log_mu - log_policy)).sum(-1).mean(),
            **auxiliary_metrics,
        }
        return Loss(loss + auxiliary_loss, metrics)

    def state_dict(self) -> dict[str, Any]:
        return super().state_dict() | {"shuffling": self.shuffling.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.shuffling.set_state(state["shuffling"].cpu())


def normalised(advantages: Tensor) -> Tensor:
    """Advantages of a minibatch [T, B], less their mean and divided by their standard deviation."""
    deviation = advantages.std(correction=0)
    return (advantages - advantages.mean()) / (deviation + SMALLEST_DEVIATION)


def of_envs(unroll: Unroll, envs: Tensor) -> Unroll:
    """A copy of the sequences of some envs, int64 [B'], and of their memory."""
    memory = {name: part[envs] for name, part in unroll.memory.items()}
    return Unroll(unroll.steps[:, envs], memory)
