"""What agents compute can be recorded as a CUDA graph: nothing waits for the device, shapes do not
depend on numbers, and no tensor is the host's. And in fixed shapes it is what it is without."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import random_unroll
from fake_cuda import DEVICE, DeviceGenerator, HostTensor, backward, capture_safe, fake_cuda
from networks import compact
from tensordict import TensorDict
from test_hindsight import OPTIONS as HINDSIGHT
from test_impala import OPTIONS as IMPALA
from test_ppo import OPTIONS as PPO
from test_vmpo import OPTIONS as VMPO
from torch._subclasses.fake_tensor import DataDependentOutputException, DynamicOutputShapeException

from zipf.agents import agents, fixed
from zipf.agents.agent import AgentSpec
from zipf.agents.hindsight import NO_HINDSIGHT, hindsight_loss
from zipf.agents.memory import MLPOptions
from zipf.agents.vmpo import vmpo_losses

ACTIONS, STEPS, BATCH, LENGTH, EPISODES = 3, 5, 4, 6, 3
MLP = MLPOptions(name="mlp", size=16, layers=2)
AGENTS = {"impala": IMPALA, "ppo": PPO.model_copy(update={"minibatches": 2}), "vmpo": VMPO}

# PyTorch's copies of tensors without numbers ask for their address.
pytestmark = pytest.mark.filterwarnings("ignore:Accessing the data pointer of FakeTensor")


def make(name, memory=MLP, device=DEVICE, **choices):
    spec = AgentSpec(
        gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
        gym.spaces.Discrete(ACTIONS),
        compact(),
        memory,
        num_envs=BATCH,
        unroll_length=STEPS,
        device=device,
        **choices,
    )
    return agents()[name](AGENTS[name], spec)


def relabelled(seed=0):
    """Episodes [LENGTH, EPISODES], one of them shorter, and no episode in the last place."""
    steps = random_unroll(LENGTH - 1, EPISODES, ACTIONS, seed).steps
    mask = torch.ones(LENGTH, EPISODES, dtype=torch.bool)
    mask[4:, 1] = mask[:, -1] = False
    rewards = steps["reward"].masked_fill(~mask, 0.0)
    return TensorDict(
        {**steps.select("observation", "previous_action", "previous_reward", "is_first", "action")}
        | {"reward": rewards, "mask": mask},
        steps.batch_size,
    )


def unroll_of(agent):
    """An unroll as the agent's options need it."""
    data = random_unroll(STEPS, BATCH, ACTIONS)
    if agent.spec.weighted:
        data.steps["weight"] = torch.ones(STEPS + 1, BATCH)
    if agent.spec.hindsight != NO_HINDSIGHT:
        data.episodes = relabelled()
    data.memory = agent.initial_memory(BATCH)
    return data.to(DEVICE)


@pytest.mark.parametrize("choices", [{}, {"weighted": True, "hindsight": HINDSIGHT}])
@pytest.mark.parametrize("name", ["impala", "vmpo"])
def test_actor_critics_learn(name, choices):
    with fake_cuda():
        agent = make(name, **choices)
        data = unroll_of(agent)
        with capture_safe():
            loss, metrics, _ = agent.loss(data)
            backward(loss)
        assert all(parameter.grad is not None for parameter in agent.learned)
        assert {metric.device.type for metric in metrics.values()} == {"cuda"}


def test_ppo_learns():
    with fake_cuda():
        agent = make("ppo", weighted=True)
        data = unroll_of(agent)
        with capture_safe():
            data.steps["old_value"], data.steps["advantage"] = agent.estimates(data)
            loss, metrics, _ = agent.loss(data)
            backward(loss)
        assert all(parameter.grad is not None for parameter in agent.learned)
        assert {metric.device.type for metric in metrics.values()} == {"cuda"}


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("ties", [False, True])
def test_vmpo_in_fixed_shapes(weighted, ties, monkeypatch):
    """Loss and gradients, with more than half of the advantages among the largest, too."""
    rng = np.random.default_rng(0)
    shape = (STEPS, BATCH)

    def floats(*tail):
        return torch.tensor(rng.normal(size=(*shape, *tail)), dtype=torch.float32)

    returns = floats().clamp(max=-0.4) if ties else floats()
    frames = {"returns": returns, "values": torch.zeros(shape), "log_target": floats(ACTIONS)}
    frames["actions"] = torch.tensor(rng.integers(ACTIONS, size=shape))
    frames["weights"] = floats().abs() if weighted else None
    logits = floats(ACTIONS)

    def computed(fixed_shapes):
        monkeypatch.setattr(fixed, "shapes", lambda tensor: fixed_shapes)
        learned = [part.clone().requires_grad_() for part in (logits, *torch.tensor([0.7, 1.5]))]
        found = vmpo_losses(
            log_policy=learned[0].log_softmax(-1),
            **(frames | {"log_target": frames["log_target"].log_softmax(-1)}),
            eta=learned[1],
            alpha=learned[2],
            epsilon_eta=0.1,
            epsilon_alpha=0.2,
            top_fraction=0.5,
        )
        return [*found, *torch.autograd.grad(found.policy + found.eta + found.alpha, learned)]

    assert (returns == returns.max()).sum() > (STEPS * BATCH / 2 if ties else 0)
    for one, other in zip(computed(True), computed(False), strict=True):
        torch.testing.assert_close(one, other)


def test_an_empty_place_among_relabelled_episodes_changes_nothing():
    made, episodes = make("impala", device="cpu"), relabelled()

    def learned(episodes, updates=0, options=HINDSIGHT):
        loss, metrics = hindsight_loss(
            made.network, episodes, options, discount=0.9, updates=updates
        )
        gradients = torch.autograd.grad(loss, list(made.network.parameters()))
        return metrics, *gradients

    torch.testing.assert_close(learned(episodes), learned(episodes[:, :-1]))
    assert learned(episodes)[0]["hindsight_episodes"] == EPISODES - 1
    empty = episodes.clone()
    empty["mask"].zero_()
    metrics, *gradients = learned(empty)
    assert metrics.pop("hindsight_episodes") == 0
    assert all(metric.isnan() for metric in metrics.values())
    assert not any(gradient.any() for gradient in gradients)


def test_hindsight_fades_by_a_tensor():
    made, episodes = make("impala", device="cpu"), relabelled()
    fading = HINDSIGHT.model_copy(update={"fade": 8})
    counter = torch.tensor(0)
    for updates in (0, 2, 8, 9):
        counter.fill_(updates)
        one, expected = (
            hindsight_loss(made.network, episodes, fading, discount=0.9, updates=number)
            for number in (counter, updates)
        )
        torch.testing.assert_close(one[0], torch.as_tensor(expected[0]))
        torch.testing.assert_close(one[1], expected[1], equal_nan=True)
    assert fading.share(torch.tensor(2)) == 0.75
    assert HINDSIGHT.share(torch.tensor(2)) == HINDSIGHT.share(2) == 1


def read(numbers):
    return numbers.sum().item()


def compare(numbers):
    return 1 if numbers.sum() > 0 else 2


def pick(numbers):
    return numbers[numbers > 0]


def add(numbers):
    return numbers + torch.tensor(0.5)


def add_there(numbers):
    return numbers + torch.tensor(0.5, device=DEVICE)


def multiply(numbers):
    return numbers * torch.tensor([0.5, 1.0, 2.0])


def copy(numbers):
    return numbers.cpu()


def draw(numbers):
    return numbers + torch.rand(3, generator=torch.Generator(), device=DEVICE)


REFUSED = {
    DataDependentOutputException: [read, compare],
    DynamicOutputShapeException: [pick],
    HostTensor: [add, add_there, multiply, copy, draw],
}


@pytest.mark.parametrize(
    ("error", "function"), [(error, one) for error, those in REFUSED.items() for one in those]
)
def test_what_a_graph_cannot_record_is_refused(error, function):
    with fake_cuda():
        numbers = torch.zeros(3, device=DEVICE)
        with capture_safe(), pytest.raises(error):
            function(numbers)


def test_what_a_graph_can_record_is_not():
    with fake_cuda(), capture_safe():
        numbers = torch.full((3,), 0.5, device=DEVICE)
        noise = torch.rand(3, generator=DeviceGenerator(), device=DEVICE)
        found = torch.where(numbers > noise, numbers, 2 * numbers.exponential_()).sum()
        assert found.device == torch.device(DEVICE)
