"""An agent of one's own: advantage actor-critic (A2C, Mnih et al. 2016), on-policy.

One optimiser step per unroll on

    mean_{t,b}[ -log pi(a_t|x_t) (G_t - V(x_t)) + c_b/2 (G_t - V(x_t))^2 + c_e sum_a pi log pi ]

where G_t is the return from step t to the unroll's end, and the value of the observation there.
"""

from typing import Literal

import torch

from zipf.agents import register
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.network import ActorCritic, Inputs
from zipf.agents.returns import lambda_returns


class A2COptions(LearnerOptions):
    """The options, `agent.learning_rate` and so on. With defaults they need no file."""

    name: Literal["a2c"]
    learning_rate: float = 1e-3
    adam_beta1: float = 0.9
    adam_beta2: float = 0.999
    adam_epsilon: float = 1e-8
    max_gradient_norm: float = 1.0
    discount: float = 0.99
    baseline_cost: float = 0.5
    entropy_cost: float = 0.01


@register
class A2C(Learner):
    Options = A2COptions

    def make_network(self):
        return ActorCritic(*self.spec.torso)

    @torch.no_grad()
    def act(self, inputs, memory, generator, *, training=True):
        outputs = self.actor(inputs.unsqueeze(), memory)  # one frame is an unroll of length 1
        logits = outputs.logits[0]
        actions = logits.softmax(-1).cpu().multinomial(1, generator=generator).squeeze(-1)
        return actions, outputs.state, {"logits": logits}  # for `deterministic=True`

    @torch.no_grad()
    def value(self, inputs, memory):
        return self.actor(inputs.unsqueeze(), memory).value[0]

    def loss(self, unroll):
        outputs = self.network(Inputs.of(unroll.steps), unroll.memory)
        steps = unroll.steps[:-1]  # the last row belongs to the next unroll
        values, log_policy = outputs.value[:-1], outputs.logits[:-1].log_softmax(-1)
        returns = lambda_returns(
            rewards=steps["reward"] + steps["bonus"],
            values=outputs.value[1:].detach(),
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=steps["truncation_value"],
            discount=self.options.discount,
            lambda_=1.0,  # to the unroll's end
        )
        log_pi = log_policy.gather(-1, steps["action"].unsqueeze(-1)).squeeze(-1)
        policy_loss = -(log_pi * (returns - values.detach())).mean()
        baseline_loss = 0.5 * (returns - values).square().mean()
        entropy = -(log_policy.exp() * log_policy).sum(-1).mean()
        loss = (
            policy_loss
            + self.options.baseline_cost * baseline_loss
            - self.options.entropy_cost * entropy
        )
        return Loss(loss, {"entropy": entropy})
