"""Return estimators on time-major tensors."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class VTrace(NamedTuple):
    """The results of V-trace, both without gradient."""

    targets: Tensor  # float32 [T, B], v_t, the baseline's regression targets
    advantages: Tensor  # float32 [T, B], for the policy gradient


@torch.no_grad()
def vtrace(
    *,
    log_ratios: Tensor,
    rewards: Tensor,
    values: Tensor,
    terminated: Tensor,
    truncated: Tensor,
    truncation_values: Tensor,
    discount: float,
    clip_rho: float = 1.0,
    clip_pg_rho: float = 1.0,
    clip_c: float = 1.0,
    lambda_: float = 1.0,
) -> VTrace:
    """V-trace targets and advantages (Espeholt et al. 2018, equation 1 and section 4.2).

    A terminated step has no successor. A truncated one has: the observation its episode was cut at.
    That is not the next row of the unroll, which begins another episode; so its value is a separate
    argument, and corrections do not flow back across the cut.

    Args:
        log_ratios: float32 [T, B], log pi(a_t|x_t) - log mu(a_t|x_t).
        rewards: float32 [T, B], r_t, the reward that followed a_t.
        values: float32 [T + 1, B], V(x_t); the last row bootstraps.
        terminated: bool [T, B], the episode ended for good after a_t.
        truncated: bool [T, B], the episode was cut after a_t.
        truncation_values: float32 [T, B], V(observation the episode was cut at); read where
            `truncated`.
        discount: gamma.
        clip_rho, clip_pg_rho, clip_c: upper bounds of the importance ratios of the temporal
            difference, of the policy gradient and of the trace.
        lambda_: factor of the trace.
    """
    ratios = log_ratios.exp()
    rho = ratios.clamp(max=clip_rho)
    trace = lambda_ * ratios.clamp(max=clip_c) * discount * ~(terminated | truncated)

    def successor(following: Tensor) -> Tensor:
        return torch.where(truncated, truncation_values, following).masked_fill(terminated, 0.0)

    deltas = rho * (rewards + discount * successor(values[1:]) - values[:-1])
    corrections = torch.empty_like(deltas)
    correction = torch.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        correction = deltas[t] + trace[t] * correction
        corrections[t] = correction
    targets = values[:-1] + corrections
    following = torch.cat([targets[1:], values[-1:]])
    advantages = ratios.clamp(max=clip_pg_rho) * (
        rewards + discount * successor(following) - values[:-1]
    )
    return VTrace(targets, advantages)


@torch.no_grad()
def lambda_returns(
    *,
    rewards: Tensor,
    values: Tensor,
    terminated: Tensor,
    truncated: Tensor,
    truncation_values: Tensor,
    discount: float,
    lambda_: float,
) -> Tensor:
    """Peng's Q(lambda) (Peng and Williams 1996): returns that bootstrap a little at every step,

        G_t = r_t + gamma ((1 - lambda) v_{t+1} + lambda G_{t+1}),  G_T = v_T

    whatever the behaviour was: traces are not cut where an action was not the greedy one. A
    terminated step has no successor; a truncated one bootstraps from the value of its own, and
    returns do not flow across the cut. On-policy, G_t - v_t are the generalised advantage
    estimates, GAE(lambda) (Schulman et al. 2016, equation 16), and with lambda = 1 G_t are the
    T-step returns of Song et al. (2020, equation 6).

    Args:
        rewards: float32 [T, B], r_t, the reward that followed a_t.
        values: float32 [T, B], v_1 to v_T: of the row after each, V, or Q of the action chosen.
        terminated: bool [T, B], the episode ended for good after a_t.
        truncated: bool [T, B], the episode was cut after a_t.
        truncation_values: float32 [T, B], the value of the observation it was cut at; read where
            `truncated`.
        discount: gamma.
        lambda_: 0 for one-step returns, 1 for returns to the end.

    Returns:
        float32 [T, B], in the units of rewards.
    """
    returns = torch.empty_like(rewards)
    following = values[-1]
    for t in reversed(range(len(rewards))):
        following = (1 - lambda_) * values[t] + lambda_ * following
        following = torch.where(truncated[t], truncation_values[t], following)
        following = rewards[t] + discount * following.masked_fill(terminated[t], 0.0)
        returns[t] = following
    return returns


RESCALING_EPSILON = 1e-3  # Pohlen et al. 2018, and the paper's R2D2 tables


def rescale(x: Tensor) -> Tensor:
    """h(x) = sign(x) (sqrt(|x| + 1) - 1) + epsilon x (Pohlen et al. 2018), for returns of any size.

    Written without the difference of two numbers that are nearly equal for small x.
    """
    return x / ((x.abs() + 1).sqrt() + 1) + RESCALING_EPSILON * x


def unrescale(y: Tensor) -> Tensor:
    """The inverse of `rescale`:

    sign(y) (((sqrt(1 + 4 epsilon (|y| + 1 + epsilon)) - 1) / (2 epsilon))^2 - 1)

    With s the root and u = 2 |y| / (s + 1 + 2 epsilon), which is the quotient minus 1, this is
    sign(y) u (u + 2), again without differences of nearly equal numbers.
    """
    epsilon, size = RESCALING_EPSILON, y.abs()
    root = (1 + 4 * epsilon * (size + 1 + epsilon)).sqrt()
    u = 2 * size / (root + 1 + 2 * epsilon)
    return y.sign() * u * (u + 2)
