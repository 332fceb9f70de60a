"""Critics against slow oracles, the losses of agents that have them, and what they learn."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest
import tiny_gridworld
import torch
from conftest import random_unroll
from networks import compact
from recall import Recall
from test_impala import OPTIONS as IMPALA
from test_r2d2 import BURN_IN, ENVS, NETWORK, STEPS, h, random_memory, sequences
from test_r2d2 import LEARNER as R2D2_LEARNER
from test_r2d2 import OPTIONS as R2D2

from zipf.agents import AgentSpec, agents
from zipf.agents.critics import (
    SCALAR,
    HLGauss,
    HLGaussOptions,
    Quantile,
    QuantileOptions,
    Scalar,
    cvar,
)
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.returns import lambda_returns, unrescale, vtrace
from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.training.host_collector import HostCollector

ACTIONS = 3
SPACES = (
    gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
    gym.spaces.Discrete(ACTIONS),
)
LSTM = LSTMOptions(name="lstm", size=16, layers=1)
GAUSS = HLGaussOptions(
    name="hl_gauss", bins=21, low=-2.0, high=3.0, sigma=0.75, risk="neutral", risk_level=0.25
)
QUANTILES = QuantileOptions(
    name="quantile", quantiles=8, kappa=0.1, risk="neutral", risk_level=0.25
)
DISTRIBUTIONS = [GAUSS, QUANTILES]
RISKS = ["neutral", "averse", "seeking"]


def named(options):
    return options.name


def with_risk(options, risk):
    return options.model_copy(update={"risk": risk})


# Histograms


def gaussian_histogram(y, options):
    """The probabilities of the definition, by the standard library's error function."""
    width = (options.high - options.low) / options.bins
    edges = [options.low + i * width for i in range(options.bins + 1)]
    y = min(max(y, options.low), options.high)
    below = [
        0.5 * (1 + math.erf((edge - y) / (options.sigma * width * math.sqrt(2)))) for edge in edges
    ]
    return [(b - a) / (below[-1] - below[0]) for a, b in itertools.pairwise(below)]


def test_hl_gauss_equals_its_definition():
    """Also of targets at the range's ends and beyond."""
    rng = np.random.default_rng(0)
    targets = torch.tensor([-5.0, -2.0, -1.9, 0.0, 0.3, 2.99, 3.0, 4.0], dtype=torch.float32)
    outputs = torch.tensor(rng.normal(size=(8, 21)), dtype=torch.float32)
    critic = HLGauss(GAUSS)
    probabilities, loss = critic.probabilities(targets), critic.loss(outputs, targets)
    for i, y in enumerate(targets.tolist()):
        expected = gaussian_histogram(y, GAUSS)
        np.testing.assert_allclose(probabilities[i], expected, rtol=1e-4, atol=1e-6)
        logits = outputs[i].double().tolist()
        total = sum(math.exp(one) for one in logits)
        cross = -sum(
            p * math.log(math.exp(one) / total) for p, one in zip(expected, logits, strict=True)
        )
        assert loss[i].item() == pytest.approx(cross * (0.75 * 5 / 21) ** 2, rel=1e-5)
        mean = sum(
            math.exp(one) / total * (-2 + 5 / 21 * (k + 0.5)) for k, one in enumerate(logits)
        )
        assert critic.mean(outputs[i]).item() == pytest.approx(mean, rel=1e-4, abs=1e-6)


def test_the_mean_of_a_targets_histogram_is_the_target():
    """Three standard deviations inside the range; beyond it, it is near its end."""
    critic = HLGauss(GAUSS)
    margin = 3 * 0.75 * 5 / 21
    targets = torch.linspace(-2 + margin, 3 - margin, 77)
    means = critic.mean(critic.probabilities(targets).log())
    torch.testing.assert_close(means, targets, rtol=0, atol=2e-3)
    ends = critic.mean(critic.probabilities(torch.tensor([-100.0, 100.0])).log())
    assert -2 < ends[0] < -1.8
    assert 2.8 < ends[1] < 3


def test_the_loss_of_a_histogram_is_as_steep_as_that_of_a_number():
    """Far from the range's ends."""
    returns = torch.linspace(-0.7, 1.7, 25, requires_grad=True)
    targets = torch.full_like(returns, 0.4)
    critic = HLGauss(GAUSS)
    deviations = (critic.centres - returns[:, None]) / (0.75 * 5 / 21)
    critic.loss(-0.5 * deviations.square(), targets).sum().backward()
    torch.testing.assert_close(returns.grad, returns.detach() - targets, rtol=0.02, atol=5e-3)


@pytest.mark.parametrize("low", [10, 11])
def test_an_empty_range_is_one_clear_line(low):
    with pytest.raises(UserError) as error:
        loading.load(["experiment=demo", "critic=hl_gauss", f"critic.low={low}"])
    assert str(error.value) == f"critic.low={low}.0: should be less than critic.high=10.0"


# Quantiles


def test_the_quantile_loss_equals_its_definition():
    rng = np.random.default_rng(0)
    options = QUANTILES.model_copy(update={"kappa": 0.7})
    outputs, targets = rng.normal(size=(5, 8)), rng.normal(size=5)
    found = Quantile(options).loss(torch.tensor(outputs), torch.tensor(targets))
    for b in range(5):
        expected = 0.0
        for i in range(8):
            tau, error = (i + 0.5) / 8, targets[b] - outputs[b, i]
            if abs(error) <= 0.7:
                huber = 0.5 * error**2
            else:
                huber = 0.7 * (abs(error) - 0.35)
            expected += abs(tau - (error < 0)) * huber / 0.7 / 8
        assert found[b].item() == pytest.approx(expected, rel=1e-6)


def test_quantiles_of_a_known_distribution_are_found():
    """Of a mixture of two Gaussians, from samples, by gradient descent."""
    rng = np.random.default_rng(0)
    options = QUANTILES.model_copy(update={"kappa": 0.01})
    critic, outputs = Quantile(options), torch.zeros(8, requires_grad=True)
    optimiser = torch.optim.SGD([outputs], lr=5.0)
    for step in range(600):
        for group in optimiser.param_groups:
            group["lr"] = 5.0 / (1 + step / 50)
        samples = rng.normal(size=1000) * 0.5 + np.where(rng.random(1000) < 0.3, -2.0, 1.0)
        loss = critic.loss(outputs.expand(1000, -1), torch.tensor(samples).float()).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    many = rng.normal(size=100_000) * 0.5 + np.where(rng.random(100_000) < 0.3, -2.0, 1.0)
    expected = np.quantile(many, (np.arange(8) + 0.5) / 8)
    np.testing.assert_allclose(outputs.detach(), expected, atol=0.08)


# Risk


@pytest.mark.parametrize("level", [0.01, 0.1, 0.25, 0.6, 1.0])
def test_cvar_is_the_mean_of_the_lowest_samples(level):
    """Of a histogram whose probabilities are multiples of a thousandth."""
    rng = np.random.default_rng(0)
    returns = np.sort(rng.normal(size=7))
    counts = rng.multinomial(1000, np.full(7, 1 / 7))
    counts[2], counts[3] = 0, counts[2] + counts[3]
    samples = np.repeat(returns, counts)
    lowest = samples[: round(level * 1000)].mean()
    found = cvar(torch.tensor(returns), torch.tensor(counts / 1000), level)
    assert found.item() == pytest.approx(lowest, rel=1e-6)


@pytest.mark.parametrize("risk", RISKS)
def test_the_risk_of_quantiles_is_that_of_their_sorted_outputs(risk):
    outputs = torch.randn(4, 8, generator=torch.Generator().manual_seed(0))
    found = Quantile(with_risk(QUANTILES, risk)).value(outputs)
    ordered = np.sort(outputs.numpy(), -1)
    chosen = {"neutral": ordered, "averse": ordered[:, :2], "seeking": ordered[:, -2:]}[risk]
    np.testing.assert_allclose(found, chosen.mean(-1), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("options", DISTRIBUTIONS, ids=named)
def test_risk_moves_a_value_to_its_side_and_all_of_the_returns_are_the_mean(options):
    outputs = torch.randn(50, 21, generator=torch.Generator().manual_seed(0))
    outputs = outputs[:, : 8 if options is QUANTILES else 21]
    build = Quantile if options is QUANTILES else HLGauss
    low, mean, high = (
        build(with_risk(options, risk)).value(outputs) for risk in ("averse", "neutral", "seeking")
    )
    assert (low < mean).all()
    assert (mean < high).all()
    for risk in ("averse", "seeking"):
        whole = build(with_risk(options, risk).model_copy(update={"risk_level": 1.0}))
        torch.testing.assert_close(whole.value(outputs), mean, rtol=1e-5, atol=1e-5)


def test_the_averse_and_the_seeking_value_mirror_each_other():
    """In a symmetric range."""
    options = GAUSS.model_copy(update={"low": -3.0})
    outputs = torch.randn(50, 21, generator=torch.Generator().manual_seed(0))
    averse, seeking = (HLGauss(with_risk(options, risk)) for risk in ("averse", "seeking"))
    torch.testing.assert_close(averse.value(outputs), -seeking.value(outputs.flip(-1)))


# Agents


def build(name, options, critic, envs=ENVS, network=NETWORK, memory=LSTM, spaces=SPACES):
    spec = AgentSpec(*spaces, network, memory, critic=critic, num_envs=envs, unroll_length=STEPS)
    made = agents()[name](options, spec)
    made.begin_learning()
    return made


def test_the_scalar_critic_adds_no_weights_and_is_half_the_squared_error():
    outputs, targets = torch.randn(3, 4, 1), torch.randn(3, 4)
    assert not Scalar().state_dict()
    assert torch.equal(Scalar().value(outputs), outputs[..., 0])
    expected = 0.5 * (targets - outputs[..., 0]) ** 2
    torch.testing.assert_close(Scalar().loss(outputs, targets), expected)
    plain, explicit = build("impala", IMPALA, SCALAR), AgentSpec(*SPACES, NETWORK, LSTM)
    again = agents()["impala"](IMPALA, explicit)
    for one, other in zip(plain.learned, again.learned, strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("risk", RISKS)
@pytest.mark.parametrize("critic", DISTRIBUTIONS, ids=named)
def test_impalas_losses_equal_the_definition(critic, risk):
    """V-trace with the risk measure in the place of V; the critic's loss against its targets."""
    made, data = build("impala", IMPALA, with_risk(critic, risk)), random_unroll(STEPS, 4, ACTIONS)
    network, steps = made.network, data.steps
    with torch.no_grad():
        outputs = network(Inputs.of(steps), data.memory)
        core, _ = network.remember(Inputs.of(steps), data.memory)
        raw = network.baseline(core)
    steps = steps[:-1]
    chosen = steps["action"].unsqueeze(-1)
    log_pi = outputs.logits[:-1].log_softmax(-1).gather(-1, chosen).squeeze(-1)
    log_mu = steps["logits"].log_softmax(-1).gather(-1, chosen).squeeze(-1)
    values = torch.empty(STEPS + 1, 4)
    for t in range(STEPS + 1):
        for b in range(4):
            values[t, b] = share_of(raw[t, b], critic, risk)
    returns = vtrace(
        log_ratios=log_pi - log_mu,
        rewards=steps["reward"] + steps["bonus"],
        values=values,
        terminated=steps["terminated"],
        truncated=steps["truncated"],
        truncation_values=steps["truncation_value"],
        discount=IMPALA.discount,
    )
    losses = [
        network.critic.loss(raw[t, b], returns.targets[t, b])
        for t in range(STEPS)
        for b in range(4)
    ]
    metrics = made.update(data)
    expected = -(log_pi * returns.advantages).mean().item()
    assert metrics["policy_loss"] == pytest.approx(expected, rel=1e-3, abs=1e-5)
    assert metrics["baseline_loss"] == pytest.approx(np.mean(losses), rel=1e-3)
    assert metrics["value"] == pytest.approx(values.mean().item(), rel=1e-3, abs=1e-5)


def share_of(outputs, critic, risk):
    """The mean of 25 % of a distribution, or of all of it, by a list of 8000 samples."""
    if critic is QUANTILES:
        samples = np.sort(np.repeat(outputs.numpy(), 1000))
    else:
        centres = -2 + 5 / 21 * (np.arange(21) + 0.5)
        below = outputs.double().softmax(-1).cumsum(-1).numpy()
        samples = centres[np.searchsorted(below, (np.arange(8000) + 0.5) / 8000)]
    share = {"neutral": samples, "averse": samples[:2000], "seeking": samples[-2000:]}[risk]
    return float(share.mean())


@pytest.mark.parametrize("risk", RISKS)
@pytest.mark.parametrize("critic", DISTRIBUTIONS, ids=named)
def test_r2d2s_losses_equal_the_definition(critic, risk):
    """Actions by risk, values by the mean of the target network; a loss against h(G) each."""
    options = R2D2.model_copy(update={"final_observations": 0})
    made = build("r2d2", options, with_risk(critic, risk))
    with torch.no_grad():
        for parameter in made.network.parameters():
            parameter *= 3
        for parameter in made.target.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=torch.Generator())
    items = sequences(5, places=0)
    assert items["steps"]["truncated"][:, BURN_IN:-1].any()
    steps = items["steps"].transpose(0, 1)
    memory = random_memory(5)
    raw, target = [], []
    with torch.no_grad():
        online, slow = memory, memory
        for t in range(len(steps)):
            frame = Inputs.of(steps[t : t + 1])
            outputs, online = made.network.outputs(frame, online)
            outputs_of_target, slow = made.target.outputs(frame, slow)
            raw.append(outputs[0])
            target.append(outputs_of_target[0])
    raw, target, steps = raw[BURN_IN:], target[BURN_IN:], steps[BURN_IN:]
    values = torch.empty(STEPS + 1, 5)
    differ = 0
    for t in range(STEPS + 1):
        for b in range(5):
            shares = [share_of(raw[t][b, a], critic, risk) for a in range(ACTIONS)]
            means = [share_of(raw[t][b, a], critic, "neutral") for a in range(ACTIONS)]
            differ += np.argmax(shares) != np.argmax(means)
            chosen = target[t][b, int(np.argmax(shares))]
            values[t, b] = unrescale(made.network.critic.mean(chosen))
    assert (differ > 0) == (risk != "neutral")
    steps = steps[:-1]
    cut = steps["truncated"]
    returns = lambda_returns(
        rewards=torch.where(cut, values[:-1], steps["reward"]),
        values=values[1:],
        terminated=steps["terminated"],
        truncated=cut,
        truncation_values=torch.zeros(STEPS, 5),
        discount=R2D2.discount,
        lambda_=R2D2.trace_lambda,
    )
    losses, errors, _ = made._losses(items)
    for t in range(STEPS):
        for b in range(5):
            outputs = raw[t][b, int(steps["action"][t, b])]
            goal = torch.tensor(h(float(returns[t, b])))
            loss = 0.0 if cut[t, b] else float(made.network.critic.loss(outputs, goal.float()))
            error = 0.0 if cut[t, b] else float(goal - made.network.critic.mean(outputs))
            assert losses[t, b].item() == pytest.approx(loss, rel=1e-3, abs=1e-4)
            assert errors[t, b].item() == pytest.approx(error, rel=1e-3, abs=1e-4)


def test_r2d2_prefers_the_certain_or_the_varied_action_by_its_risk():
    """Action 0 always returns 0.5, action 1 from -1 to 1.6 and action 2 always 0."""
    quantiles = torch.stack([torch.full((8,), 0.5), torch.linspace(-1, 1.6, 8), torch.zeros(8)], -1)
    inputs = Inputs(
        {"image": torch.zeros(1, 9, 9, 3, dtype=torch.uint8)},
        torch.full((1,), -1),
        torch.zeros(1),
        torch.ones(1, dtype=torch.bool),
    )
    chosen = {}
    for risk in RISKS:
        made = build("r2d2", R2D2, with_risk(QUANTILES, risk), envs=1)
        with torch.no_grad():
            for parameter in made.network.parameters():
                parameter.zero_()
            made.network.value[-1].bias.copy_(quantiles.mean(-1))
            made.network.advantage[-1].bias.copy_(quantiles.flatten())
        memory, generator = made.initial_memory(1), torch.Generator()
        action, _, _ = made.act(inputs, memory, generator, training=False)
        chosen[risk] = int(action)
    assert chosen == {"neutral": 0, "averse": 0, "seeking": 1}


NAMES = [name for name, agent in agents().items() if "critic" in agent.supports]


def test_the_agents_that_have_any_critic():
    assert set(NAMES) == {"impala", "ppo", "r2d2", "vmpo"}


@pytest.mark.parametrize("name", sorted(set(agents()) - set(NAMES)))
def test_agents_without_a_critic_refuse_one(name):
    overrides = ["experiment=playroom_find", f"condition={name}", "critic=quantile"]
    with pytest.raises(UserError) as error:
        loading.load(overrides)
    assert len(str(error.value).splitlines()) == 1
    assert f"critic=quantile: agent={name} learns no distribution" in str(error.value)
    assert "choose critic=scalar, or agent=impala or ppo or r2d2 or vmpo" in str(error.value)


# Learning

RETURNS = [  # for returns between 0 and 1
    GAUSS.model_copy(update={"low": -1.0, "high": 1.0}),
    QUANTILES.model_copy(update={"quantiles": 16}),
]


@pytest.mark.slow
@pytest.mark.parametrize("critic", RETURNS, ids=named)
def test_impala_learns_a_tiny_gridworld(critic):
    options = IMPALA.model_copy(
        update={
            "learning_rate": 5e-3,
            "max_gradient_norm": 1.0,
            "discount": 0.95,
            "entropy_cost": 0.01,
        }
    )
    network, memory = compact(channels=16, size=64), MLPOptions(name="mlp", size=32, layers=1)
    episodes = tiny_gridworld.after_learning(
        lambda *spaces: build(
            "impala", options, critic, network=network, memory=memory, spaces=spaces
        ),
        seed=0,
    )
    assert episodes["success"].mean() >= 0.95
    assert episodes["length"].mean() <= 2.2


@pytest.mark.slow
@pytest.mark.parametrize("critic", RETURNS, ids=named)
def test_r2d2_recalls_a_cue(critic):
    """Of the frame before, where a blank one asks for it; chance is 1/4."""
    delay = 1
    options = R2D2_LEARNER.model_copy(
        update={"burn_in": 0, "learning_rate": 5e-3, "max_gradient_norm": 10.0}
    )
    env = Recall(32, delay)
    spec = AgentSpec(
        env.single_observation_space,
        env.single_action_space,
        compact(channels=16, size=16),
        LSTMOptions(name="lstm", size=32, layers=1),
        critic=critic,
        num_envs=32,
        unroll_length=2 * (delay + 1),
    )
    made = agents()["r2d2"](options, spec)
    made.begin_learning()
    collector = HostCollector(env, made, unroll_length=2 * (delay + 1), seed=0)
    for _ in range(400 if critic.name == "hl_gauss" else 250):
        made.update(collector.collect())
    policy = AgentPolicy(made, seed=0)
    assert play(policy, Recall(100, delay), episodes=300, seed=2)["success"].mean() >= 0.95
