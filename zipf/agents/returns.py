"""Return estimators on time-major tensors."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class VTrace(NamedTuple):
    """What V-trace gives the two losses; neither carries a gradient."""

    targets: Tensor  # float32 [T, B], v_t: what the baseline regresses to
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

    A terminated step has no successor. A truncated one has: the observation its episode was cut at,
    which is not the next row of the unroll (that row begins another episode), so its value comes
    separately and no correction flows back across the cut.

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
