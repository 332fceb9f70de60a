"""V-MPO (Song et al. 2020): on-policy maximum a posteriori policy optimisation, top to bottom.

The target network acts; every `target_period` updates it becomes a copy of the learned one. There
is one optimiser step per unroll. Of its T x B steps D, let D~ be those with the largest
advantages A = G - V, where G is the return, bootstrapped at the unroll's end. Then, where sg stops
the gradient, the loss is the sum of (their equations 3 to 6)

    L_pi    = -sum_D~ psi log pi(a|x)                      psi = softmax of A / eta over D~
    L_eta   = eta epsilon_eta + eta log mean_D~ exp(A / eta)
    L_alpha = mean_D[ alpha (epsilon_alpha - sg(KL)) + sg(alpha) KL ]    KL = KL(pi_target || pi)
    L_V     = mean_D[ (V(x) - G)^2 ] / 2

plus the auxiliary loss (`zipf.agents.auxiliary`) and that of relabelled episodes
(`zipf.agents.hindsight`). With a critic that learns a distribution (`zipf.agents.critics`) its loss
takes the place of L_V, and its risk measure that of V, in advantages and where returns bootstrap.
Where frames have weights w, all is as if they had been drawn w times: sums and means over D and D~
are weighted by w, psi is proportional to w exp(A / eta), and D~ is chosen as without them. The
temperature eta and the multiplier alpha are
learned by an optimiser of their own, and projected to be positive after each of its steps, as in
the paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor, nn

from zipf.agents import fixed
from zipf.agents.agent import AgentSpec, register
from zipf.agents.hindsight import hindsight_loss
from zipf.agents.learner import Learner, LearnerOptions, Loss
from zipf.agents.memory import State
from zipf.agents.network import ActorCritic, Inputs, action_log_probability, frozen_copy, sampled
from zipf.agents.returns import lambda_returns
from zipf.agents.unroll import Unroll
from zipf.options import Context, Fraction, Positive, Share, Size

SMALLEST_DUAL = 1e-8  # Song et al. 2020


class VMPOOptions(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values."""

    name: Literal["vmpo"]
    dual_learning_rate: Positive
    discount: Share
    target_period: Size
    top_fraction: Fraction
    epsilon_eta: Positive
    epsilon_alpha: Positive
    initial_eta: Positive
    initial_alpha: Positive

    def problems(self, context: Context) -> Iterator[str]:
        if self.target_period % context.updates_per_unroll:
            yield (
                f"agent.target_period={self.target_period}: should be a multiple of "
                f"{context.updates_per_unroll}, the updates of an unroll"
            )


@register
class VMPO(Learner):
    """The agent: samples actions from the target policy and learns from unrolls.

    Its losses do not correct for a behaviour policy that is not the target policy, so that
    collection may not run ahead of learning.
    """

    Options = VMPOOptions
    learns_from_parts = True  # the target network acts, and follows between unrolls
    captures = True
    supports = frozenset({"auxiliary", "critic", "exploration", "hindsight", "reweighting"})
    options: VMPOOptions
    network: ActorCritic
    actor: ActorCritic

    def __init__(self, options: VMPOOptions, spec: AgentSpec):
        super().__init__(options, spec)
        self.target = frozen_copy(self.network)
        self.actor = self.target
        initial = {"eta": options.initial_eta, "alpha": options.initial_alpha}
        self.duals = nn.ParameterDict(
            {name: nn.Parameter(torch.tensor(value)) for name, value in initial.items()}
        ).to(self.device)
        fused = True if fixed.shapes(self.duals["eta"]) else None  # a graph needs it
        duals = torch.optim.Adam(
            self.duals.parameters(), lr=options.dual_learning_rate, fused=fused
        )
        self.optimisers["dual_optimiser"] = duals
        self.parts |= {"target": self.target, "duals": self.duals, "dual_optimiser": duals}

    def make_network(self) -> ActorCritic:
        return ActorCritic(*self.spec.torso, self.spec.critic)

    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Samples an action of the target policy, in training and evaluation alike; its `logits`
        float32 [B, actions] are for `update`."""
        outputs = self.forward_actor(inputs.unsqueeze(), memory)
        logits = outputs.logits[0]
        return sampled(logits, generator), outputs.state, {"logits": logits}

    def value(self, inputs: Inputs, memory: State) -> Tensor:
        """The target network's V, float32 [B]; the memory is the target's."""
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

        steps = steps[:-1]
        returns = lambda_returns(
            rewards=steps["reward"] + steps["bonus"],
            values=outputs.value[1:].detach(),
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=steps["truncation_value"],
            discount=o.discount,
            lambda_=1.0,
        )
        weights = steps.get("weight", None)
        losses = vmpo_losses(
            log_policy=outputs.logits[:-1].log_softmax(-1),
            log_target=steps["logits"].log_softmax(-1),
            actions=steps["action"],
            values=outputs.value[:-1].detach(),
            returns=returns,
            weights=weights,
            eta=self.duals["eta"],
            alpha=self.duals["alpha"],
            epsilon_eta=o.epsilon_eta,
            epsilon_alpha=o.epsilon_alpha,
            top_fraction=o.top_fraction,
        )
        errors = self.network.critic.loss(outputs.baseline[:-1], returns)
        baseline_loss = _mean(errors, weights)
        relabelled_loss, relabelled_metrics = hindsight_loss(
            self.network,
            unroll.episodes,
            self.spec.hindsight,
            discount=o.discount,
            updates=self.progress,
            precision=self.precision,
        )
        loss = losses.policy + losses.eta + losses.alpha + baseline_loss + auxiliary_loss
        loss = loss + relabelled_loss

        metrics = {
            "policy_loss": losses.policy,
            "eta_loss": losses.eta,
            "alpha_loss": losses.alpha,
            "baseline_loss": baseline_loss,
            "kl": losses.kl,
            "entropy": losses.entropy,
            "eta": self.duals["eta"].detach().clone(),
            "alpha": self.duals["alpha"].detach().clone(),
            "value": outputs.value.mean(),
            **auxiliary_metrics,
            **relabelled_metrics,
        }
        return Loss(loss, metrics)

    def after_step(self, batch: Any, kept: dict[str, Tensor]) -> None:
        """Projects the duals."""
        super().after_step(batch, kept)
        with torch.no_grad():
            for dual in self.duals.parameters():
                dual.clamp_(min=SMALLEST_DUAL)

    def after_update(self) -> None:
        """Lets the target network follow."""
        super().after_update()
        if self.updates % self.options.target_period == 0:
            self.target.load_state_dict(self.network.state_dict())


class VMPOLosses(NamedTuple):
    """The losses but that of the values, and two metrics; float32 scalars."""

    policy: Tensor
    eta: Tensor
    alpha: Tensor
    kl: Tensor  # mean over the steps; carries no gradient
    entropy: Tensor  # likewise


def vmpo_losses(
    *,
    log_policy: Tensor,
    log_target: Tensor,
    actions: Tensor,
    values: Tensor,
    returns: Tensor,
    weights: Tensor | None = None,
    eta: Tensor,
    alpha: Tensor,
    epsilon_eta: float,
    epsilon_alpha: float,
    top_fraction: float,
) -> VMPOLosses:
    """The losses of Song et al. 2020, equations 3 to 5.

    Args:
        log_policy: float32 [T, B, actions], log pi of the learned network.
        log_target: float32 [T, B, actions], log pi of the target network, which acted.
        actions: int64 [T, B], its actions.
        values: float32 [T, B], V of the learned network, without gradient.
        returns: float32 [T, B], G.
        weights: float32 [T, B], those of the frames; None: all alike.
        eta, alpha: float32 [], the temperature and the multiplier of the bound on KL.
        epsilon_eta: bound on how far the weights psi may be from uniform.
        epsilon_alpha: bound on how far the learned policy may be from the target's.
        top_fraction: the fraction of the steps that the policy is fitted to.
    """

    advantages = returns - values
    top = is_top(advantages, top_fraction)
    in_fixed_shapes = fixed.shapes(advantages)

    def of_top(frames: Tensor) -> Tensor:
        """[T, B] -> [D~]; or with all others in [D], to be masked."""
        return frames.flatten() if in_fixed_shapes else frames[top]

    best = of_top(advantages)
    # Subtracting the maximum keeps the exponentials finite and eta's gradient exact, however
    # small eta is: eta log mean exp(A / eta) = max A + eta log mean exp((A - max A) / eta).
    scaled = (best - best.max()) / eta
    if weights is not None:
        scaled = scaled + of_top(weights).log()
    if in_fixed_shapes:
        scaled = scaled.masked_fill(~top.flatten(), -torch.inf)
    total = (top if weights is None else of_top(weights * top)).sum()
    psi = scaled.detach().softmax(0)
    log_mean = scaled.logsumexp(0) - total.double().log().float()

    log_pi = action_log_probability(log_policy, actions)
    kl = _mean((log_target.exp() * (log_target - log_policy)).sum(-1), weights)
    return VMPOLosses(
        policy=-(psi * of_top(log_pi)).sum(),
        eta=best.max() + eta * (epsilon_eta + log_mean),
        alpha=alpha * (epsilon_alpha - kl.detach()) + alpha.detach() * kl,
        kl=kl.detach(),
        entropy=-(log_policy.detach().exp() * log_policy.detach()).sum(-1).mean(),
    )


def _mean(frames: Tensor, weights: Tensor | None) -> Tensor:
    """The weighted mean, float32 [], of [T, B]; only the ratios of weights count."""
    return frames.mean() if weights is None else (weights * frames).sum() / weights.sum()


def is_top(advantages: Tensor, fraction: float) -> Tensor:
    """Mask, bool, of the largest `fraction` of all advantages: at least one, and all ties; with
    any NaN among them, all that are not below the last, so that the loss is NaN, too."""
    count = math.ceil(fraction * advantages.numel())
    last = advantages.flatten().topk(count).values[-1]
    return ~(advantages < last)
