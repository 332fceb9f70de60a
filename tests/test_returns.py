"""Returns against loops written from their definitions; V-trace also against TorchRL's."""

import numpy as np
import pytest
import torch

from zipf.agents.returns import lambda_returns, vtrace

DISCOUNT = 0.9


def case(seed: int, steps: int = 12, batch: int = 5) -> dict[str, torch.Tensor]:
    rng = np.random.default_rng(seed)
    ended = rng.random((steps, batch)) < 0.3
    cut = rng.random((steps, batch)) < 0.5
    return {
        "log_ratios": torch.tensor(rng.normal(size=(steps, batch)), dtype=torch.float32),
        "rewards": torch.tensor(rng.normal(size=(steps, batch)), dtype=torch.float32),
        "values": torch.tensor(rng.normal(size=(steps + 1, batch)), dtype=torch.float32),
        "terminated": torch.tensor(ended & ~cut),
        "truncated": torch.tensor(ended & cut),
        "truncation_values": torch.tensor(rng.normal(size=(steps, batch)), dtype=torch.float32),
    }


def oracle(x, discount, clip_rho, clip_pg_rho, clip_c, lambda_):
    """v_s = V(x_s) + sum_t gamma^(t-s) (prod c) delta_t, summed forward for every s on its own."""
    x = {name: tensor.double().numpy() for name, tensor in x.items()}
    steps, batch = x["rewards"].shape
    ratio = np.exp(x["log_ratios"])

    def successor(t, b, following):
        if x["terminated"][t, b]:
            return 0.0
        return x["truncation_values"][t, b] if x["truncated"][t, b] else following

    targets = np.zeros((steps, batch))
    advantages = np.zeros((steps, batch))
    for b in range(batch):
        for s in range(steps):
            targets[s, b] = x["values"][s, b]
            weight = 1.0
            for t in range(s, steps):
                following = successor(t, b, x["values"][t + 1, b])
                error = x["rewards"][t, b] + discount * following - x["values"][t, b]
                targets[s, b] += weight * min(clip_rho, ratio[t, b]) * error
                if x["terminated"][t, b] or x["truncated"][t, b]:
                    break
                weight *= discount * lambda_ * min(clip_c, ratio[t, b])
        for s in range(steps):
            target = targets[s + 1, b] if s + 1 < steps else x["values"][steps, b]
            advantages[s, b] = min(clip_pg_rho, ratio[s, b]) * (
                x["rewards"][s, b] + discount * successor(s, b, target) - x["values"][s, b]
            )
    return targets, advantages


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("clip_rho", "clip_pg_rho", "clip_c", "lambda_"),
    [(1.0, 1.0, 1.0, 1.0), (2.0, 1.5, 0.7, 0.8), (1e9, 1e9, 1e9, 1.0)],
)
def test_vtrace_equals_the_definition(seed, clip_rho, clip_pg_rho, clip_c, lambda_):
    x = case(seed)
    assert x["terminated"].any()
    assert x["truncated"].any()
    options = {
        "clip_rho": clip_rho,
        "clip_pg_rho": clip_pg_rho,
        "clip_c": clip_c,
        "lambda_": lambda_,
    }
    result = vtrace(**x, discount=DISCOUNT, **options)
    targets, advantages = oracle(x, DISCOUNT, **options)
    np.testing.assert_allclose(result.targets, targets, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(result.advantages, advantages, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_vtrace_equals_torchrl(seed):
    functional = pytest.importorskip("torchrl.objectives.value.functional")
    x = case(seed)
    result = vtrace(**x, discount=DISCOUNT)
    following = torch.where(x["truncated"], x["truncation_values"], x["values"][1:])

    def batch_first(tensor):
        return tensor.transpose(0, 1).unsqueeze(-1)

    advantages, targets = functional.vtrace_advantage_estimate(
        DISCOUNT,
        batch_first(x["log_ratios"]),
        torch.zeros_like(batch_first(x["log_ratios"])),
        batch_first(x["values"][:-1]),
        batch_first(following),
        batch_first(x["rewards"]),
        batch_first(x["terminated"] | x["truncated"]),
        terminated=batch_first(x["terminated"]),
    )
    torch.testing.assert_close(batch_first(result.targets), targets, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(batch_first(result.advantages), advantages, rtol=1e-4, atol=1e-4)


def returns_by_hand(x, discount, lambda_):
    """The average of n-step returns with weights (1 - lambda) lambda^(n-1), the longest with what
    is left (Sutton and Barto 2018, equation 12.3), for every step on its own."""
    x = {name: tensor.double().numpy() for name, tensor in x.items()}
    steps, batch = x["rewards"].shape
    returns = np.zeros((steps, batch))
    for b in range(batch):
        for t in range(steps):
            rewards, weight = 0.0, 1.0
            for n in range(1, steps - t + 1):
                last = t + n - 1
                rewards += discount ** (n - 1) * x["rewards"][last, b]
                value = x["values"][last, b]
                if x["terminated"][last, b]:
                    value = 0.0
                if x["truncated"][last, b]:
                    value = x["truncation_values"][last, b]
                is_longest = (
                    last == steps - 1 or x["terminated"][last, b] or x["truncated"][last, b]
                )
                share = weight if is_longest else weight * (1 - lambda_)
                returns[t, b] += share * (rewards + discount**n * value)
                weight *= lambda_
                if is_longest:
                    break
    return returns


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lambda_", [0.0, 0.3, 0.95, 1.0])
def test_lambda_returns_are_averages_of_n_step_returns(seed, lambda_):
    x = case(seed)
    assert x["terminated"].any()
    assert x["truncated"].any()
    del x["log_ratios"]
    x["values"] = x["values"][1:]
    result = lambda_returns(**x, discount=DISCOUNT, lambda_=lambda_)
    expected = returns_by_hand(x, DISCOUNT, lambda_)
    np.testing.assert_allclose(result, expected, rtol=1e-4, atol=1e-5)
