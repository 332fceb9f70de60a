"""V-MPO's update against its definition, computed step by step, and what it learns."""

import copy

import gymnasium as gym
import numpy as np
import pytest
import tiny_gridworld
import torch
from conftest import assert_equal, random_unroll
from networks import compact

from zipf.agents.agent import AgentSpec
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.vmpo import SMALLEST_DUAL, VMPO, VMPOOptions, is_top, vmpo_losses

ACTIONS, STEPS, BATCH = 3, 5, 5
OPTIONS = VMPOOptions(
    name="vmpo",
    learning_rate=1e-3,
    dual_learning_rate=0.1,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-8,
    max_gradient_norm=1e9,
    discount=0.9,
    target_period=3,
    top_fraction=0.5,
    epsilon_eta=0.1,
    epsilon_alpha=0.2,
    initial_eta=0.7,
    initial_alpha=1.5,
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
    return VMPO(OPTIONS.model_copy(update=changes), spec)


def as_acted_by(vmpo, data):
    """The same unroll with the target policy's logits."""
    with torch.no_grad():
        data.steps["logits"] = vmpo.target(Inputs.of(data.steps), data.memory).logits
    return data


def everything(vmpo):
    return copy.deepcopy(vmpo.state_dict())


def by_hand(vmpo, data):
    """The four losses of the definition in double precision, one env and one step at a time."""
    o, steps = vmpo.options, data.steps
    eta, alpha = vmpo.duals["eta"].item(), vmpo.duals["alpha"].item()
    with torch.no_grad():
        outputs = vmpo.network(Inputs.of(steps), data.memory)
    value = outputs.value.double().numpy()
    log_pi = outputs.logits.double().log_softmax(-1).numpy()
    log_target = steps["logits"].double().log_softmax(-1).numpy()
    kls, errors, judged = [], [], []
    for b in range(BATCH):
        following = value[STEPS, b]
        for t in reversed(range(STEPS)):
            if steps["terminated"][t, b]:
                following = 0.0
            if steps["truncated"][t, b]:
                following = steps["truncation_value"][t, b].item()
            reward = steps["reward"][t, b].item() + steps["bonus"][t, b].item()
            following = reward + o.discount * following
            errors.append(0.5 * (value[t, b] - following) ** 2)
            judged.append((following - value[t, b], log_pi[t, b, steps["action"][t, b]]))
            kl = 0.0
            for a in range(ACTIONS):
                kl += np.exp(log_target[t, b, a]) * (log_target[t, b, a] - log_pi[t, b, a])
            kls.append(kl)
    judged.sort(reverse=True)
    top = judged[: (len(judged) + 1) // 2]
    total = sum(np.exp(advantage / eta) for advantage, _ in top)
    return {
        "policy_loss": -sum(np.exp(advantage / eta) / total * log for advantage, log in top),
        "eta_loss": eta * o.epsilon_eta + eta * np.log(total / len(top)),
        "alpha_loss": np.mean([alpha * (o.epsilon_alpha - kl) + alpha * kl for kl in kls]),
        "baseline_loss": np.mean(errors),
        "kl": np.mean(kls),
    }


@pytest.mark.parametrize("seed", range(3))
def test_losses_equal_the_definition(seed):
    vmpo, data = agent(), unroll(seed)
    assert data.steps["terminated"].any()
    assert data.steps["truncated"].any()
    expected = by_hand(vmpo, data)
    metrics = vmpo.update(data)
    for name, number in expected.items():
        assert metrics[name] == pytest.approx(number, rel=1e-4), name
    parts = ("policy_loss", "eta_loss", "alpha_loss", "baseline_loss")
    assert metrics["loss"] == pytest.approx(sum(expected[part] for part in parts), rel=1e-4)


LEARNED = ("logits", "eta", "alpha")


def loose_losses(seed, dtype=torch.float64, eta=0.7, alpha=1.5):
    """The losses for random inputs, and these inputs."""
    rng = np.random.default_rng(seed)

    def floats(*tail):
        return torch.tensor(rng.normal(size=(4, 3, *tail)), dtype=dtype)

    learned = {
        "logits": floats(ACTIONS),
        "eta": torch.tensor(eta, dtype=dtype),
        "alpha": torch.tensor(alpha, dtype=dtype),
    }
    for tensor in learned.values():
        tensor.requires_grad_()
    given = {
        "log_target": floats(ACTIONS).log_softmax(-1),
        "actions": torch.tensor(rng.integers(ACTIONS, size=(4, 3))),
        "values": floats(),
        "returns": floats(),
    }
    losses = vmpo_losses(
        log_policy=learned["logits"].log_softmax(-1),
        eta=learned["eta"],
        alpha=learned["alpha"],
        **given,
        epsilon_eta=0.1,
        epsilon_alpha=0.2,
        top_fraction=0.5,
    )
    return losses, learned, given


def gradients(loss, learned):
    found = torch.autograd.grad(loss, list(learned.values()), retain_graph=True, allow_unused=True)
    return dict(zip(learned, found, strict=True))


@pytest.mark.parametrize(
    ("loss", "reaches"),
    [
        ("policy", {"logits"}),
        ("eta", {"eta"}),
        ("alpha", {"logits", "alpha"}),
    ],
)
def test_each_loss_has_gradients_for_its_own_parameters_only(loss, reaches):
    losses, learned, _ = loose_losses(0)
    found = gradients(getattr(losses, loss), learned)
    assert {name for name in LEARNED if found[name] is not None} == reaches


@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_the_definition(seed):
    """Each loss with all held constant that the definition holds constant."""
    losses, learned, given = loose_losses(seed)
    eta, alpha = 0.7, 1.5
    pi = learned["logits"].detach().softmax(-1)
    target = given["log_target"].exp()
    advantages = given["returns"] - given["values"]
    top = np.sort(advantages.flatten())[6:]
    psi = (advantages >= top[0]) * (advantages / eta).exp() / np.exp(top / eta).sum()
    kl = (target * (given["log_target"] - pi.log())).sum(-1).mean()
    chosen = torch.nn.functional.one_hot(given["actions"], ACTIONS)

    def eta_loss(eta):
        return eta * 0.1 + eta * np.log(np.mean(np.exp(top / eta)))

    expected = {
        "policy": {"logits": psi.unsqueeze(-1) * (pi - chosen)},
        "eta": {"eta": (eta_loss(eta + 1e-5) - eta_loss(eta - 1e-5)) / 2e-5},
        "alpha": {"logits": alpha * (pi - target) / 12, "alpha": 0.2 - kl},
    }
    for loss, parts in expected.items():
        found = gradients(getattr(losses, loss), learned)
        for name, gradient in parts.items():
            np.testing.assert_allclose(found[name], gradient, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("eta", [SMALLEST_DUAL, 1e-4, 1e4])
def test_the_gradient_of_eta_is_exact_for_extreme_values(eta):
    losses, learned, _ = loose_losses(0, torch.float32, eta)
    exact, learned_exactly, _ = loose_losses(0, torch.float64, eta)
    found = gradients(losses.eta, learned)["eta"]
    expected = gradients(exact.eta, learned_exactly)["eta"]
    assert found.item() == pytest.approx(expected.item(), rel=1e-3)


@pytest.mark.parametrize(
    ("advantages", "fraction", "top"),
    [
        ([3, 1, 2, 4], 0.5, [1, 0, 0, 1]),
        ([3, 1, 2, 4, 5], 0.5, [1, 0, 0, 1, 1]),  # the middle one counts
        ([1, 2, 2, 2, 3, 0], 0.5, [0, 1, 1, 1, 1, 0]),  # which of the equal would be a whim
        ([7, 7, 7, 7], 0.5, [1, 1, 1, 1]),
        ([-1], 0.5, [1]),
        ([3, 1, 2, 4], 0.25, [0, 0, 0, 1]),
        ([3, 1, 2, 4], 1.0, [1, 1, 1, 1]),
    ],
)
def test_the_top_fraction(advantages, fraction, top):
    found = is_top(torch.tensor(advantages, dtype=torch.float32), fraction)
    assert found.int().tolist() == top


def test_the_top_fraction_is_of_the_whole_batch():
    advantages = torch.tensor([[1.0, 10.0], [2.0, 20.0]])
    assert is_top(advantages, 0.5).tolist() == [[False, True], [False, True]]


def test_alpha_rises_when_the_divergence_exceeds_its_bound():
    """And falls when it is below."""
    far, near = agent(epsilon_alpha=0.01), agent(epsilon_alpha=10.0)
    for vmpo, sign in ((far, 1), (near, -1)):
        metrics = vmpo.update(unroll())
        assert (metrics["kl"] > vmpo.options.epsilon_alpha) == (sign == 1)
        assert (vmpo.duals["alpha"].item() - metrics["alpha"]) * sign > 0.09


def test_eta_rises_when_the_weights_are_further_from_uniform_than_the_bound():
    """And falls when they are nearer."""
    for eta, sign in ((0.01, 1), (100.0, -1)):
        vmpo = agent(initial_eta=eta)
        vmpo.update(unroll())
        assert (vmpo.duals["eta"].item() - eta) * sign > 0.09


def test_the_duals_stay_positive():
    vmpo = agent(initial_eta=1e3, initial_alpha=1e-3, epsilon_alpha=1e3, dual_learning_rate=2e3)
    for _ in range(2):
        vmpo.update(unroll())
    assert vmpo.duals["alpha"].item() == pytest.approx(SMALLEST_DUAL)
    assert vmpo.duals["eta"].item() >= 0.99 * SMALLEST_DUAL


def test_a_large_alpha_keeps_the_policy_near_the_target():
    moved = []
    for alpha in (0.01, 100.0):
        vmpo = agent(initial_alpha=alpha, target_period=100, learning_rate=1e-2)
        data = as_acted_by(vmpo, unroll())
        for _ in range(30):
            metrics = vmpo.update(data)
        moved.append(metrics["kl"])
    assert moved[1] < 0.1 * moved[0]


def test_the_target_acts_and_is_copied_once_in_a_period():
    vmpo, data = agent(learning_rate=0.1), unroll()
    inputs = Inputs.of(data.steps[0])
    generator = torch.Generator().manual_seed(0)

    def now():
        _, _, behaviour = vmpo.act(inputs, data.memory, generator)
        return behaviour["logits"], vmpo.value(inputs, data.memory)

    def learned():
        with torch.no_grad():
            outputs = vmpo.network(inputs.unsqueeze(), data.memory)
        return outputs.logits[0], outputs.value[0]

    for _ in range(2):
        logits, value = now()
        assert torch.equal(logits, learned()[0])
        for _ in range(OPTIONS.target_period - 1):
            vmpo.update(data)
            assert torch.equal(now()[0], logits)
            assert torch.equal(now()[1], value)
            assert not torch.allclose(learned()[0], logits)
        vmpo.update(data)
        assert not torch.allclose(now()[0], logits)
        assert not torch.allclose(now()[1], value)


def test_the_divergence_is_0_when_the_target_was_just_copied():
    vmpo = agent(learning_rate=0.01)
    kls = [vmpo.update(as_acted_by(vmpo, unroll(i)))["kl"] for i in range(6)]
    assert kls[0] == pytest.approx(0, abs=1e-6)
    assert kls[3] == pytest.approx(0, abs=1e-6)
    assert min(kls[1], kls[2], kls[4], kls[5]) > 1e-5


def test_actions_better_than_expected_become_likelier_and_the_value_follows():
    vmpo = agent(learning_rate=1e-2, initial_alpha=0.1)

    def now():
        data = unroll()
        with torch.no_grad():
            outputs = vmpo.network(Inputs.of(data.steps), data.memory)
        return outputs.logits[:-1].softmax(-1)[..., 1].mean(), outputs.value[:-1].mean()

    before, _ = now()
    for seed in range(100):
        data = unroll(seed)  # of a policy that does each of the three as often
        data.steps["reward"] = (data.steps["action"] == 1).float()
        data.steps["bonus"].zero_()
        data.steps["terminated"].fill_(True)
        data.steps["truncated"].fill_(False)
        vmpo.update(as_acted_by(vmpo, data))
    after, value = now()
    assert after > before + 0.2
    assert value == pytest.approx(1 / 3, abs=0.15)


@pytest.mark.parametrize("name", ["reward", "truncation_value", "logits"])
def test_divergence_changes_no_weights(name):
    vmpo, data = agent(), unroll()
    vmpo.update(unroll(1))
    before = everything(vmpo)
    data.steps["truncated"][0, 0], data.steps["terminated"][0, 0] = True, False
    data.steps[name][0, 0] = float("inf")
    with pytest.raises(FloatingPointError):
        vmpo.update(data)
    assert_equal(everything(vmpo), before)


def test_values_that_are_no_numbers_are_divergence():
    vmpo = agent()
    torch.nn.init.constant_(vmpo.network.baseline.bias, float("nan"))
    before = copy.deepcopy(vmpo.network.policy.state_dict())
    with pytest.raises(FloatingPointError):
        vmpo.update(unroll())
    assert_equal(dict(vmpo.network.policy.state_dict()), dict(before))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_vmpo_learns_a_tiny_gridworld(seed):
    options = OPTIONS.model_copy(
        update={
            "learning_rate": 2e-3,
            "dual_learning_rate": 1e-2,
            "max_gradient_norm": 1.0,
            "discount": 0.95,
            "target_period": 10,
            "epsilon_alpha": 0.01,
            "initial_eta": 0.3,
            "initial_alpha": 1.0,
        }
    )
    network = compact(channels=16, size=64)
    memory = MLPOptions(name="mlp", size=32, layers=1)
    episodes = tiny_gridworld.after_learning(
        lambda *spaces: VMPO(options, AgentSpec(*spaces, network, memory, seed=seed)), seed
    )
    assert episodes["success"].mean() >= 0.95
    assert episodes["length"].mean() <= 2.2
