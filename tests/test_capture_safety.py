"""What agents compute can be recorded as a CUDA graph: nothing waits for the device, shapes do not
depend on numbers, and no tensor is the host's. And in fixed shapes it is what it is without."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import assert_equal, random_unroll
from fake_cuda import DEVICE, Generator, HostTensor, backward, capture_safe, fake_cuda
from networks import compact
from tensordict import TensorDict
from test_auxiliary import BYOL, FRAME, HORIZON, VISION
from test_critics import DISTRIBUTIONS
from test_encoders import RESNET, SHALLOW, comparing
from test_hindsight import OPTIONS as HINDSIGHT
from test_impala import OPTIONS as IMPALA
from test_memory import GTRXL
from test_ppo import OPTIONS as PPO
from test_r2d2 import BURN_IN
from test_r2d2 import OPTIONS as R2D2
from test_vmpo import OPTIONS as VMPO
from torch._subclasses.fake_tensor import DataDependentOutputException, DynamicOutputShapeException

from zipf.agents import agents, fixed
from zipf.agents.agent import AgentSpec
from zipf.agents.encoders import Encoder
from zipf.agents.hindsight import NO_HINDSIGHT, hindsight_loss
from zipf.agents.memory import LSTMMemory, LSTMOptions, MLPOptions
from zipf.agents.network import Inputs, autocast
from zipf.agents.r2d2 import Replayed
from zipf.agents.truncations import Finals
from zipf.agents.unroll import no_observations
from zipf.agents.vmpo import vmpo_losses

ACTIONS, STEPS, BATCH, LENGTH, EPISODES = 3, 5, 4, 6, 3
MLP = MLPOptions(name="mlp", size=16, layers=2)
LSTM = LSTMOptions(name="lstm", size=16, layers=2)
MEMORIES = {"mlp": MLP, "lstm": LSTM, "gtrxl": GTRXL}
PPO = PPO.model_copy(update={"minibatches": 2})
AGENTS = {"impala": IMPALA, "ppo": PPO, "vmpo": VMPO, "r2d2": R2D2}
HALF = {"fraction": 0.5}
AUXILIARIES = {
    "vision": VISION.model_copy(update=HALF),
    "byol": BYOL.model_copy(update=HALF),
    "byol_frame": FRAME.model_copy(update=HALF | {"shift": 2, "unshifted": 3}),
    "byol_horizon": HORIZON.model_copy(update=HALF | {"shift": 2, "unshifted": 3}),
}
CRITICS = [one.model_copy(update={"risk": "averse"}) for one in DISTRIBUTIONS]

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


def learn(agent, batch):
    """The loss of a batch, its gradients, and what follows an optimiser step."""
    with capture_safe():
        loss, metrics, kept = agent.loss(batch)
        backward(loss)
        agent.after_step(batch, kept)
    assert all(parameter.grad is not None for parameter in agent.learned)
    assert {part.device.type for part in (*metrics.values(), *kept.values())} == {"cuda"}


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("name", ["impala", "vmpo"])
def test_actor_critics_learn(name, memory, precision):
    with fake_cuda():
        agent = make(name, MEMORIES[memory], precision=precision)
        data = unroll_of(agent)
        learn(agent, data)
        assert agent.auxiliary.generators() == []
        with capture_safe():
            values = agent.value(Inputs.of(data.steps[0]), data.memory)
        assert (values.shape, values.device) == ((BATCH,), torch.device(DEVICE))


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("auxiliary", AUXILIARIES)
def test_auxiliary_losses(auxiliary, precision):
    with fake_cuda():
        agent = make("vmpo", auxiliary=AUXILIARIES[auxiliary], precision=precision)
        learn(agent, unroll_of(agent))
        assert [one.device.type for one in agent.auxiliary.generators()] == ["cuda"]


SPACE = gym.spaces.Dict(
    image=gym.spaces.Box(0, 255, (36, 36, 3), np.uint8),
    tiles=gym.spaces.MultiDiscrete([5] * 49),
    vector=gym.spaces.Box(-np.inf, np.inf, (4,), np.float32),
)
NETWORKS = [RESNET, SHALLOW, compact(), comparing("learned"), comparing("given")]


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("network", NETWORKS, ids=lambda options: options.name)
def test_encoders(network, precision):
    with fake_cuda():
        encoder = Encoder(SPACE, network).to(DEVICE)
        parts = no_observations(SPACE, 4)
        observation = {name: part.to(DEVICE) for name, part in parts.items()}
        with capture_safe():
            with autocast(DEVICE, precision):
                encoded = encoder(observation)
            backward(encoded.sum())
        assert all(parameter.grad is not None for parameter in encoder.parameters())


@pytest.mark.parametrize("critic", CRITICS)
def test_critics(critic):
    with fake_cuda():
        agent = make("vmpo", critic=critic)
        learn(agent, unroll_of(agent))


@pytest.mark.parametrize("name", ["impala", "vmpo"])
def test_actor_critics_learn_with_weights_and_from_hindsight(name):
    with fake_cuda():
        agent = make(name, weighted=True, hindsight=HINDSIGHT)
        learn(agent, unroll_of(agent))


@pytest.mark.parametrize("memory", MEMORIES)
def test_ppo_learns(memory):
    with fake_cuda():
        agent = make("ppo", MEMORIES[memory], weighted=True)
        data = unroll_of(agent)
        with capture_safe():
            data.steps["old_value"], data.steps["advantage"] = agent.estimates(data)
        learn(agent, data)


def replayed(agent, device=DEVICE):
    """Sequences as replay gives them."""
    rows, finals = BURN_IN + STEPS + 1, agent.options.final_observations
    data = random_unroll(rows - 1, BATCH, ACTIONS)
    data.steps["weight"] = torch.ones(rows, BATCH)
    steps = data.steps.select(*agent.sequences._names).transpose(0, 1)
    final = steps[:, :finals].select("observation", "previous_action", "previous_reward")
    final["is_first"] = torch.zeros(BATCH, finals, dtype=torch.bool)
    final["step"] = torch.full((BATCH, finals), -1)
    memory = TensorDict(agent.initial_memory(BATCH), BATCH)
    items = TensorDict({"steps": steps, "final": final, "memory": memory}, BATCH)
    return Replayed(items.to(device), torch.ones(BATCH, device=device))


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("memory", MEMORIES)
def test_r2d2_learns_and_acts(memory, precision):
    with fake_cuda():
        agent = make("r2d2", MEMORIES[memory], precision=precision, weighted=True)
        learn(agent, replayed(agent))
        inputs = Inputs.of(random_unroll(STEPS, BATCH, ACTIONS).steps[0].to(DEVICE))
        memory, generator = agent.initial_memory(BATCH), Generator(DEVICE)
        with capture_safe():
            action, memory, _ = agent.act(inputs, memory, generator)
        assert action.device.type == "cuda"


def fused_cell(gates, recurrent, cell):
    """What `_thnn_fused_lstm_cell` computes on CUDA."""
    assert gates.dtype == recurrent.dtype == cell.dtype == torch.float32
    enter, forget, candidate, leave = (gates + recurrent).chunk(4, -1)
    after = forget.sigmoid() * cell + enter.sigmoid() * candidate.tanh()
    return leave.sigmoid() * after.tanh(), after, None


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_the_fused_lstm(precision, monkeypatch):
    """Outputs, state and gradients are those of the other one; in bfloat16 nearly."""
    monkeypatch.setattr(torch.ops.aten, "_thnn_fused_lstm_cell", fused_cell)
    torch.manual_seed(0)
    memory = LSTMMemory(5, LSTM)
    inputs, state = torch.randn(STEPS, BATCH, 5), memory.initial_state(BATCH)
    state = {name: torch.randn_like(part) for name, part in state.items()}
    is_first = torch.rand(STEPS, BATCH) < 0.3

    def computed():
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bfloat16"):
            outputs, after = memory(inputs, is_first, state)
        gradients = torch.autograd.grad(outputs.square().sum(), list(memory.parameters()))
        return [outputs, *after.values(), *gradients]

    expected = computed()
    monkeypatch.setattr(LSTMMemory, "unroll", LSTMMemory.unroll_fused)
    found = computed()
    within = {"rtol": 0.02, "atol": 0.02} if precision == "bfloat16" else {}
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, **within)


@pytest.mark.parametrize("cuts", [[], [(0, 1)], [(0, 1), (4, 1), (2, 3)]])
def test_r2d2_in_fixed_shapes(cuts, monkeypatch):
    """Losses and gradients, with and without room for all final observations."""
    made = make("r2d2", device="cpu", weighted=True)
    data = replayed(made, "cpu")
    data.items["steps"]["truncated"].zero_()
    for step, env in cuts:
        place = (data.items["final"]["step"][env] >= 0).sum()
        data.items["final"]["step"][env, place] = step
        data.items["steps"]["truncated"][env, BURN_IN + step] = True

    def computed(fixed_shapes):
        monkeypatch.setattr(fixed, "shapes", lambda tensor: fixed_shapes)
        losses, errors, values = made._losses(data.items)
        return [losses, errors, values, *torch.autograd.grad(losses.sum(), made.learned)]

    for one, other in zip(computed(True), computed(False), strict=True):
        torch.testing.assert_close(one, other)
    finals = Finals(data.items["final"].transpose(0, 1), STEPS + 1)
    assert len(finals.places) == min(len(cuts), 2)


def test_vision_in_fixed_shapes(monkeypatch):
    """Over several updates, of which the first has the mean image."""

    def trained(fixed_shapes):
        monkeypatch.setattr(fixed, "shapes", lambda tensor: fixed_shapes)
        made = make("impala", device="cpu", auxiliary=AUXILIARIES["vision"])
        for seed in range(3):
            data = random_unroll(STEPS, BATCH, ACTIONS, seed)
            data.memory = {}
            made.update(data)
        return made.state_dict()

    found, expected = trained(True), trained(False)
    assert_equal(found, expected)
    assert expected["auxiliary"]["mean_image"].any()


def test_draws_on_a_device_follow_from_the_seed_and_the_number_of_updates():
    with fake_cuda():
        auxiliary = make("impala", auxiliary=AUXILIARIES["byol_horizon"], seed=5).auxiliary
        (generator,) = auxiliary.generators()
        assert auxiliary.generator() is generator
        for updates in range(3):
            auxiliary.count(updates)
            assert generator.initial_seed() == 5 + updates
        auxiliary.set_extra_state(7)
        assert generator.initial_seed() == 12


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
    return numbers + torch.rand(3, generator=Generator(), device=DEVICE)


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
        noise = torch.rand(3, generator=Generator(DEVICE), device=DEVICE)
        found = torch.where(numbers > noise, numbers, 2 * numbers.exponential_()).sum()
        assert found.device == torch.device(DEVICE)
