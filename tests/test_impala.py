"""IMPALA's update against its definition, computed step by step, and what it learns."""

import gymnasium as gym
import numpy as np
import pytest
import tiny_gridworld
import torch
from conftest import random_unroll
from networks import compact

from zipf.agents.agent import AgentSpec
from zipf.agents.impala import Impala, ImpalaOptions
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs, autocast
from zipf.agents.returns import vtrace

ACTIONS, STEPS, BATCH = 3, 6, 4
OPTIONS = ImpalaOptions(
    name="impala",
    learning_rate=1e-3,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-8,
    max_gradient_norm=1e9,
    discount=0.9,
    baseline_cost=0.6,
    entropy_cost=0.05,
    clip_rho=1.0,
    clip_pg_rho=1.0,
    clip_c=1.0,
    trace_lambda=1.0,
)


def unroll(seed=0):
    return random_unroll(STEPS, BATCH, ACTIONS, seed)


def agent(**changes):
    spec = AgentSpec(
        gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
        gym.spaces.Discrete(ACTIONS),
        compact(),
        LSTMOptions(name="lstm", size=16, layers=1),
    )
    return Impala(OPTIONS.model_copy(update=changes), spec)


def by_hand(impala, data):
    """The losses of the definition, one env and one step at a time."""
    o, steps = impala.options, data.steps
    with torch.no_grad():
        outputs = impala.network(Inputs.of(steps), data.memory)
    policy_loss = baseline_loss = entropy = 0.0
    for b in range(BATCH):
        value = outputs.value[:, b].double()
        log_pi = outputs.logits[:, b].double().log_softmax(-1)
        log_mu = steps["logits"][:, b].double().log_softmax(-1)
        following_target = value[STEPS]
        for t in reversed(range(STEPS)):
            a = steps["action"][t, b]
            ratio = (log_pi[t, a] - log_mu[t, a]).exp()
            reward = steps["reward"][t, b] + steps["bonus"][t, b]
            next_value, next_target = value[t + 1], following_target
            if steps["terminated"][t, b]:
                next_value = next_target = torch.tensor(0.0)
            if steps["truncated"][t, b]:
                next_value = next_target = steps["truncation_value"][t, b]
            rho, pg_rho, c = (ratio.clamp(max=m) for m in (o.clip_rho, o.clip_pg_rho, o.clip_c))
            target = (
                value[t]
                + rho * (reward + o.discount * next_value - value[t])
                + o.discount * o.trace_lambda * c * (next_target - next_value)
            )
            advantage = pg_rho * (reward + o.discount * next_target - value[t])
            policy_loss -= log_pi[t, a] * advantage
            baseline_loss += 0.5 * (target - value[t]) ** 2
            entropy -= (log_pi[t].exp() * log_pi[t]).sum()
            following_target = target
    n = STEPS * BATCH
    parts = policy_loss / n, baseline_loss / n, entropy / n
    return parts, parts[0] + o.baseline_cost * parts[1] - o.entropy_cost * parts[2]


BOUNDS = {"clip_rho": 0.9, "clip_pg_rho": 1.5, "clip_c": 0.6, "trace_lambda": 0.8}


@pytest.mark.parametrize("changes", [{}, BOUNDS], ids=["papers", "different"])
@pytest.mark.parametrize("seed", range(3))
def test_losses_equal_the_definition(seed, changes):
    impala, data = agent(**changes), unroll(seed)
    assert data.steps["terminated"].any()
    assert data.steps["truncated"].any()
    (policy_loss, baseline_loss, entropy), loss = by_hand(impala, data)
    metrics = impala.update(data)
    assert metrics["policy_loss"] == pytest.approx(policy_loss.item(), rel=1e-4)
    assert metrics["baseline_loss"] == pytest.approx(baseline_loss.item(), rel=1e-4)
    assert metrics["entropy"] == pytest.approx(entropy.item(), rel=1e-4)
    assert metrics["loss"] == pytest.approx(loss.item(), rel=1e-4)


def test_gradients_equal_the_definition():
    """Targets and advantages are constants: finite differences of the loss with both held fixed."""
    impala, data = agent(baseline_cost=0.0, entropy_cost=0.0), unroll()
    before = {name: p.detach().clone() for name, p in impala.network.named_parameters()}
    impala.update(data)
    bias = impala.network.policy.bias.grad.clone()
    impala.network.load_state_dict(before)
    outputs = impala.network(Inputs.of(data.steps), data.memory)
    log_pi = outputs.logits[:-1].log_softmax(-1)
    (expected_loss, _, _), _ = by_hand(impala, data)
    # d/d bias_k of -log pi(a) A is (pi_k - [a = k]) A, averaged.
    chosen = torch.nn.functional.one_hot(data.steps["action"][:-1], ACTIONS)
    taken = (log_pi * chosen).sum(-1)
    s = data.steps[:-1]
    mu = (s["logits"].log_softmax(-1) * chosen).sum(-1)
    advantages = vtrace(
        log_ratios=(taken - mu).detach(),
        rewards=s["reward"] + s["bonus"],
        values=outputs.value.detach(),
        terminated=s["terminated"],
        truncated=s["truncated"],
        truncation_values=s["truncation_value"],
        discount=OPTIONS.discount,
    ).advantages
    expected = ((log_pi.exp() - chosen) * advantages.unsqueeze(-1)).mean((0, 1))
    torch.testing.assert_close(bias, expected.detach(), rtol=1e-4, atol=1e-6)
    assert expected_loss == pytest.approx((-taken * advantages).mean().item(), rel=1e-4)


def test_rewarded_actions_become_likelier_and_the_value_follows():
    impala, data = agent(entropy_cost=0.0, learning_rate=1e-2), unroll()
    steps = data.steps
    steps["reward"] = (steps["action"] == 1).float()
    steps["bonus"].zero_()
    steps["terminated"].fill_(True)
    steps["truncated"].fill_(False)

    def now():
        with torch.no_grad():
            outputs = impala.network(Inputs.of(steps), data.memory)
        return outputs.logits[:-1].softmax(-1)[..., 1].mean(), outputs.value[:-1]

    before, _ = now()
    for _ in range(100):
        impala.update(data)
    after, value = now()
    assert after > before + 0.2
    # The data are of a policy that was rewarded a third of the time; the value is the new policy's.
    assert (value - 1).abs().mean() < 0.2


def test_entropy_cost_keeps_the_policy_broad():
    entropies = []
    for cost in (0.0, 1.0):
        impala, data = agent(entropy_cost=cost, learning_rate=1e-2), unroll()
        for _ in range(60):
            metrics = impala.update(data)
        entropies.append(metrics["entropy"])
    assert entropies[1] > entropies[0] + 0.2
    assert entropies[1] == pytest.approx(np.log(ACTIONS), abs=0.2)


def test_gradients_are_clipped():
    impala = agent(max_gradient_norm=1e-3)
    metrics = impala.update(unroll())
    norms = [p.grad.norm() for p in impala.network.parameters()]
    assert metrics["gradient_norm"] > 1e-3
    assert torch.stack(norms).norm().item() == pytest.approx(1e-3, rel=1e-3)


def test_heads_compute_in_float32_under_bfloat16():
    impala = agent()
    impala.precision = "bfloat16"
    steps = unroll(0).steps
    with autocast(impala.device, impala.precision):
        outputs = impala.network(Inputs.of(steps), impala.initial_memory(steps.shape[1]))
    for exact in (outputs.logits, outputs.value):
        assert exact.dtype == torch.float32
        assert (exact.bfloat16().float() != exact).any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_impala_learns_a_tiny_gridworld(seed):
    options = OPTIONS.model_copy(
        update={
            "learning_rate": 5e-3,
            "max_gradient_norm": 1.0,
            "discount": 0.95,
            "entropy_cost": 0.01,
        }
    )
    network = compact(channels=16, size=64)
    memory = MLPOptions(name="mlp", size=32, layers=1)
    episodes = tiny_gridworld.after_learning(
        lambda *spaces: Impala(options, AgentSpec(*spaces, network, memory, seed=seed)), seed
    )
    assert episodes["success"].mean() >= 0.95
    assert episodes["length"].mean() <= 2.2
