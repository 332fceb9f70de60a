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
from typing import Annotated, Any, Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.agent import Agent, Setting, register
from zipf.agents.auxiliary import build_auxiliary
from zipf.agents.averaging import average_gradients
from zipf.agents.hindsight import hindsight_loss
from zipf.agents.memory import State
from zipf.agents.network import (
    ActorCritic,
    Inputs,
    action_log_probability,
    autocast,
    frozen_copy,
    sampled,
)
from zipf.agents.returns import bootstrapped_returns
from zipf.agents.reweighting import NO_REWEIGHTING, weighted
from zipf.agents.unroll import Unroll
from zipf.options import Options

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, lt=1)]

SMALLEST_DUAL = 1e-8  # Song et al. 2020


class VMPOOptions(Options):
    """The options; `configs/agent/vmpo.yaml` has the sources of their values."""

    name: Literal["vmpo"]
    learning_rate: Positive
    dual_learning_rate: Positive
    adam_beta1: Fraction
    adam_beta2: Fraction
    adam_epsilon: Positive
    max_gradient_norm: Positive
    discount: Annotated[float, Field(ge=0, le=1)]
    target_period: Annotated[int, Field(ge=1)]
    top_fraction: Annotated[float, Field(gt=0, le=1)]
    epsilon_eta: Positive
    epsilon_alpha: Positive
    initial_eta: Positive
    initial_alpha: Positive


@register
class VMPO(Agent):
    """The agent: samples actions from the target policy and learns from unrolls.

    Its losses do not correct for a behaviour policy that is not the target policy, so that
    collection may not run ahead of learning.
    """

    Options = VMPOOptions
    auxiliary_losses = True
    any_critic = True
    weighted_losses = True
    averages_gradients = True
    learns_from_hindsight = True
    options: VMPOOptions
    actor: ActorCritic

    def __init__(self, options: VMPOOptions, setting: Setting):
        super().__init__(options, setting)
        self.updates = 0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setting.seed)
            self.network = ActorCritic(
                setting.observation_space,
                setting.action_space,
                setting.network,
                setting.memory,
                setting.critic,
            )
            self.auxiliary = build_auxiliary(
                setting.auxiliary,
                setting.observation_space,
                setting.network,
                self.network,
                setting.seed,
            )
        self.network.to(self.device)
        self.auxiliary.to(self.device)
        self.learned = [*self.network.parameters(), *self.auxiliary.learned()]
        self.target = frozen_copy(self.network)
        self.actor = self.target
        initial = {"eta": options.initial_eta, "alpha": options.initial_alpha}
        self.duals = nn.ParameterDict(
            {name: nn.Parameter(torch.tensor(value)) for name, value in initial.items()}
        ).to(self.device)
        self.optimiser = torch.optim.Adam(
            self.learned,
            lr=options.learning_rate,
            betas=(options.adam_beta1, options.adam_beta2),
            eps=options.adam_epsilon,
            fused=True,
        )
        self.dual_optimiser = torch.optim.Adam(
            self.duals.parameters(), lr=options.dual_learning_rate
        )

    def initial_memory(self, batch: int) -> State:
        """The memory before the first frame of `batch` worlds."""
        return self.target.memory.initial_state(batch)

    @torch.no_grad()
    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """Samples an action of the target policy in each of B worlds, in training and evaluation
        alike.

        Returns actions int64 [B], the memory after this frame, and the target policy's `logits`
        float32 [B, actions], which `update` needs.
        """
        with autocast(self.device, self.precision):
            outputs = self.actor(inputs.unsqueeze(), memory)
        logits = outputs.logits[0]
        return sampled(logits, generator), outputs.state, {"logits": logits}

    @torch.no_grad()
    def value(self, inputs: Inputs, memory: State) -> Tensor:
        """The target network's V of each of B worlds, float32 [B]; the memory is the target's."""
        with autocast(self.device, self.precision):
            return self.actor(inputs.unsqueeze(), memory).value[0]

    def update(self, unroll: Unroll) -> dict[str, float]:
        """One step of both optimisers; returns the losses and other metrics.

        Raises:
            FloatingPointError: learning has diverged; no weights were changed.
        """
        o = self.options
        steps = unroll.steps
        inputs = Inputs.of(steps)
        with autocast(self.device, self.precision):
            outputs = self.network(inputs, unroll.memory)
            auxiliary_loss, auxiliary_metrics = self.auxiliary(inputs, outputs.core)

        steps = steps[:-1]
        returns = bootstrapped_returns(
            rewards=steps["reward"] + steps["bonus"],
            final_value=outputs.value[-1].detach(),
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=steps["truncation_value"],
            discount=o.discount,
        )
        if not (returns.isfinite().all() and outputs.value.isfinite().all()):
            raise FloatingPointError("a value or a return is not finite")
        losses = vmpo_losses(
            log_policy=outputs.logits[:-1].log_softmax(-1),
            log_target=steps["logits"].log_softmax(-1),
            actions=steps["action"],
            values=outputs.value[:-1].detach(),
            returns=returns,
            weights=steps["weight"] if self.setting.reweighting != NO_REWEIGHTING else None,
            eta=self.duals["eta"],
            alpha=self.duals["alpha"],
            epsilon_eta=o.epsilon_eta,
            epsilon_alpha=o.epsilon_alpha,
            top_fraction=o.top_fraction,
        )
        errors = self.network.critic.loss(outputs.baseline[:-1], returns)
        baseline_loss = weighted(errors, steps).mean()
        relabelled_loss, relabelled_metrics = hindsight_loss(
            self.network,
            unroll.episodes,
            self.setting.hindsight,
            discount=o.discount,
            updates=self.updates,
            precision=self.precision,
        )
        loss = losses.policy + losses.eta + losses.alpha + baseline_loss + auxiliary_loss
        loss = loss + relabelled_loss

        self.optimiser.zero_grad()
        self.dual_optimiser.zero_grad()
        loss.backward()
        average_gradients([*self.learned, *self.duals.parameters()])
        gradient_norm = nn.utils.clip_grad_norm_(self.learned, o.max_gradient_norm)
        for name, number in (("loss", loss), ("gradient's norm", gradient_norm)):
            if not number.isfinite():
                raise FloatingPointError(f"the {name} is {number.item()}")
        metrics = {
            "loss": loss,
            "policy_loss": losses.policy,
            "eta_loss": losses.eta,
            "alpha_loss": losses.alpha,
            "baseline_loss": baseline_loss,
            "kl": losses.kl,
            "entropy": losses.entropy,
            "eta": self.duals["eta"],
            "alpha": self.duals["alpha"],
            "gradient_norm": gradient_norm,
            "value": outputs.value.mean(),
            **auxiliary_metrics,
            **relabelled_metrics,
        }
        numbers = {name: metric.item() for name, metric in metrics.items()}

        self.optimiser.step()
        self.dual_optimiser.step()
        self.auxiliary.after_update(self.network.encoder)
        with torch.no_grad():
            for dual in self.duals.parameters():
                dual.clamp_(min=SMALLEST_DUAL)
        self.updates += 1
        if self.updates % o.target_period == 0:
            self.target.load_state_dict(self.network.state_dict())
        return numbers

    def state_dict(self) -> dict[str, Any]:
        """Everything that `update` changes."""
        return {
            "network": self.network.state_dict(),
            "target": self.target.state_dict(),
            "auxiliary": self.auxiliary.state_dict(),
            "duals": self.duals.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "dual_optimiser": self.dual_optimiser.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self.network.load_state_dict(state["network"])
        self.target.load_state_dict(state["target"])
        self.auxiliary.load_state_dict(state["auxiliary"])
        self.duals.load_state_dict(state["duals"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.dual_optimiser.load_state_dict(state["dual_optimiser"])
        self.updates = state["updates"]


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

    def mean(frames: Tensor) -> Tensor:
        return (frames if weights is None else weights * frames).mean()

    advantages = returns - values
    top = is_top(advantages, top_fraction)
    best = advantages[top]
    # Subtracting the maximum keeps the exponentials finite and eta's gradient exact, however
    # small eta is: eta log mean exp(A / eta) = max A + eta log mean exp((A - max A) / eta).
    scaled, total = (best - best.max()) / eta, float(len(best))
    if weights is not None:
        scaled, total = scaled + weights[top].log(), weights[top].sum().item()
    psi = scaled.detach().softmax(0)
    log_mean = scaled.logsumexp(0) - math.log(total)

    log_pi = action_log_probability(log_policy, actions)
    kl = mean((log_target.exp() * (log_target - log_policy)).sum(-1))
    return VMPOLosses(
        policy=-(psi * log_pi[top]).sum(),
        eta=best.max() + eta * (epsilon_eta + log_mean),
        alpha=alpha * (epsilon_alpha - kl.detach()) + alpha.detach() * kl,
        kl=kl.detach(),
        entropy=-(log_policy.detach().exp() * log_policy.detach()).sum(-1).mean(),
    )


def is_top(advantages: Tensor, fraction: float) -> Tensor:
    """Mask, bool, of the largest `fraction` of all advantages: at least one, and all ties."""
    count = math.ceil(fraction * advantages.numel())
    last = advantages.flatten().kthvalue(advantages.numel() - count + 1).values
    return advantages >= last
