"""PPO's update against its definition, computed step by step, and what it learns."""

from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest
import tiny_gridworld
import torch
from conftest import TINY, assert_equal, random_unroll
from networks import compact
from tape import Tape

from zipf.agents import image_networks
from zipf.agents.agent import AgentSpec
from zipf.agents.auxiliary.reconstruction import VisionOptions
from zipf.agents.gtrxl import GTrXLOptions
from zipf.agents.learner import Learner
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.ppo import PPO, PPOOptions, normalised
from zipf.errors import UserError
from zipf.experiments.building import loading

pytestmark = pytest.mark.usefixtures("all_patches")

ACTIONS, STEPS, BATCH = 3, 5, 6
LSTM = LSTMOptions(name="lstm", size=16, layers=1)
MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=16, layers=1),
    "lstm": LSTM,
    "gtrxl": GTrXLOptions(
        name="gtrxl", size=16, layers=1, heads=2, memory_length=4, mlp_size=16, gate_bias=2.0
    ),
}
OPTIONS = PPOOptions(
    name="ppo",
    learning_rate=1e-2,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-5,
    max_gradient_norm=0.5,
    discount=0.9,
    gae_lambda=0.8,
    epochs=2,
    minibatches=3,
    clip_ratio=0.2,
    clip_value=None,
    baseline_cost=0.6,
    entropy_cost=0.05,
)


def agent(memory=LSTM, weighted=False, auxiliary=None, **changes):
    parts = {"auxiliary": auxiliary} if auxiliary else {}
    spec = AgentSpec(
        gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
        gym.spaces.Discrete(ACTIONS),
        compact(),
        memory,
        num_envs=BATCH,
        unroll_length=STEPS,
        weighted=weighted,
        **parts,
    )
    return PPO(OPTIONS.model_copy(update=changes), spec)


def unroll(seed=0, made=None, weighted=False):
    """Of random numbers; with an agent, acted by it, but for the memory before."""
    drawn = random_unroll(STEPS, BATCH, ACTIONS, seed)
    if weighted:
        generator = torch.Generator().manual_seed(seed)
        drawn.steps["weight"] = 2 * torch.rand(STEPS + 1, BATCH, generator=generator)
    if made is not None:
        if made.spec.memory != LSTM:
            drawn.memory = made.initial_memory(BATCH)
        with torch.no_grad():
            drawn.steps["logits"] = made.network(Inputs.of(drawn.steps), drawn.memory).logits
    return drawn


def advantages_by_hand(x, values, discount, lambda_):
    """Sums of later errors, for every frame on its own: Schulman et al. 2016, equation 16."""
    x = {name: part.numpy() for name, part in x.items()}
    values = values.double().numpy()
    found = np.zeros((STEPS, BATCH))
    for b in range(BATCH):
        for t in range(STEPS):
            for later in range(t, STEPS):
                following = values[later + 1, b]
                if x["truncated"][later, b]:
                    following = x["truncation_values"][later, b]
                if x["terminated"][later, b]:
                    following = 0.0
                error = x["rewards"][later, b] + discount * following - values[later, b]
                found[t, b] += (discount * lambda_) ** (later - t) * error
                if x["terminated"][later, b] or x["truncated"][later, b]:
                    break
    return torch.tensor(found)


def returns_of(data):
    steps = data.steps[:-1]
    return {
        "rewards": steps["reward"] + steps["bonus"],
        "terminated": steps["terminated"],
        "truncated": steps["truncated"],
        "truncation_values": steps["truncation_value"],
    }


# Updates


def by_hand(made, data):
    """An update with plain autograd and Adam in double precision; returns the weights after it,
    and for every optimiser step its losses."""
    o = made.options
    network = deepcopy(made.network).double()
    parameters = list(network.parameters())
    adam = torch.optim.Adam(
        parameters, o.learning_rate, (o.adam_beta1, o.adam_beta2), o.adam_epsilon
    )
    memory = {name: part.double() for name, part in data.memory.items()}
    inputs, steps = Inputs.of(data.steps), data.steps[:-1]

    def forward(envs):
        observation = {name: part[:, envs] for name, part in inputs.observation.items()}
        chosen = Inputs(observation, *(part[:, envs] for part in inputs[1:]))
        chosen = chosen._replace(previous_reward=chosen.previous_reward.double())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(image_networks, "compute_dtype", lambda _: torch.float64)
            core, _ = network.remember(chosen, {n: part[envs] for n, part in memory.items()})
            return network.policy(core), network.baseline(core).squeeze(-1)

    with torch.no_grad():
        old = forward(torch.arange(BATCH))[1]
    advantage = advantages_by_hand(returns_of(data), old, o.discount, o.gae_lambda)
    shuffling, losses = torch.Generator(), []
    shuffling.set_state(made.shuffling.get_state())
    for _ in range(o.epochs):
        for envs in torch.randperm(BATCH, generator=shuffling).chunk(o.minibatches):
            logits, value = forward(envs)
            part = advantage[:, envs]
            mean, deviation = part.numpy().mean(), part.numpy().std()
            terms = []
            for t in range(STEPS):
                for place, b in enumerate(envs.tolist()):
                    log_pi = logits[t, place].log_softmax(-1)
                    log_mu = steps["logits"][t, b].double().log_softmax(-1)
                    a = steps["action"][t, b]
                    ratio = (log_pi[a] - log_mu[a]).exp()
                    better = (part[t, place] - mean) / (deviation + 1e-8)
                    bound = 1 + o.clip_ratio if better > 0 else 1 - o.clip_ratio
                    is_far = ratio > bound if better > 0 else ratio < bound
                    surrogate = better * (torch.tensor(bound) if is_far else ratio)
                    target = part[t, place] + old[t, b]
                    error = (value[t, place] - target) ** 2 / 2
                    if o.clip_value is not None:
                        change = (value[t, place] - old[t, b]).clamp(-o.clip_value, o.clip_value)
                        error = max(error, (old[t, b] + change - target) ** 2 / 2)
                    entropy = -(log_pi.exp() * log_pi).sum()
                    weight = steps["weight"][t, b] if "weight" in steps.keys() else 1.0
                    apart = float(abs(ratio - 1) > o.clip_ratio)
                    kl = (log_mu.exp() * (log_mu - log_pi)).sum()
                    weighed = [weight * term for term in (-surrogate, error, entropy)]
                    terms.append(torch.stack([*weighed, torch.tensor(apart), kl]))
            found = torch.stack(terms).mean(0)
            loss = found[0] + o.baseline_cost * found[1] - o.entropy_cost * found[2]
            adam.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(parameters, o.max_gradient_norm)
            adam.step()
            losses.append(torch.stack([loss, *found]).detach())
    return network.state_dict(), torch.stack(losses)


METRICS = ("loss", "policy_loss", "baseline_loss", "entropy", "clip_fraction", "kl")
KINDS = {
    "plain": {},
    "values clipped": {"clip_value": 0.05},
    "weighted": {"weighted": True},
    "one batch": {"minibatches": 1, "epochs": 1},
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_update_equals_the_definition(kind):
    """Weights and metrics after its optimiser steps."""
    made, weighted = agent(**KINDS[kind]), "weighted" in KINDS[kind]
    data = unroll(0, made, weighted)
    before = {name: part.clone() for name, part in made.network.state_dict().items()}
    expected, losses = by_hand(made, data)
    metrics = made.update(data)
    for name, part in made.network.state_dict().items():
        assert not torch.equal(part, before[name])
        torch.testing.assert_close(part.double(), expected[name], rtol=0, atol=2e-5)
    for name, value in zip(METRICS, losses.mean(0), strict=True):
        assert metrics[name] == pytest.approx(value.item(), rel=1e-3, abs=1e-5), name
    if made.options.epochs > 1:
        assert 0 < metrics["clip_fraction"] < 0.9
    assert made.updates == made.options.epochs * made.options.minibatches


def gradients(made, batch):
    loss = made.loss(batch).loss
    return torch.autograd.grad(loss, made.network.policy.bias)[0]


def minibatch(made, data, advantage):
    data.steps["old_value"] = torch.zeros(STEPS + 1, BATCH)
    data.steps["advantage"] = advantage
    return data


@pytest.mark.parametrize("sign", [1, -1])
def test_ratios_outside_the_clip_have_no_gradient(sign):
    """Where the advantage would move them further; where it moves them back they have one."""
    made = agent(baseline_cost=0.0, entropy_cost=0.0)
    data = unroll(0, made)
    # Half of the frames are good and half bad; the policy that acted took the action of the good
    # ones less often by much, or more often.
    good = (torch.arange(BATCH) < BATCH // 2).expand(STEPS + 1, BATCH)
    advantage = torch.where(good, 1.0, -1.0)
    chosen = torch.nn.functional.one_hot(data.steps["action"], ACTIONS)
    less = torch.where(good, sign * 3.0, -sign * 3.0).unsqueeze(-1) * chosen
    data.steps["logits"] = data.steps["logits"] - less
    found = gradients(made, minibatch(made, data, advantage))
    metrics = made.loss(data).metrics
    assert metrics["clip_fraction"] == 1
    assert (found.abs().max() > 1e-3) == (sign == -1)
    if sign == 1:
        assert (found == 0).all()


def test_advantages_are_normalised_in_every_minibatch(monkeypatch):
    """And not once in the whole batch. The first minibatch's ratios are 1, so that its loss is less
    its mean advantage: that is 0."""
    made = agent(epochs=1)
    data = unroll(0, made)
    data.steps["reward"] += 10.0 * torch.arange(BATCH)  # the envs differ by much
    _, all_of_them = made.estimates(data)
    found, learn = [], Learner.learn

    def watched(self, batch):
        metrics, kept = learn(self, batch)
        found.append((batch.steps["advantage"][:-1], float(metrics["policy_loss"])))
        return metrics, kept

    monkeypatch.setattr(Learner, "learn", watched)
    made.update(data)
    first, policy_loss = found[0]
    whole = all_of_them[:-1]
    assert ((first - whole.mean()) / whole.std(correction=0)).mean().abs() > 0.1
    assert policy_loss == pytest.approx(0, abs=1e-5)
    part = normalised(first)
    assert part.mean().item() == pytest.approx(0, abs=1e-5)
    assert part.std(correction=0).item() == pytest.approx(1, abs=1e-5)


def test_minibatches_are_whole_sequences_of_all_envs(monkeypatch):
    """Each env is in one minibatch of every epoch, its memory with it."""
    made, data, seen, learn = agent(epochs=4), unroll(), [], Learner.learn
    data.steps["reward"][0] = torch.arange(BATCH).float()
    data.memory["hidden"][:, 0] = torch.arange(BATCH).float()

    def watched(self, batch):
        assert batch.steps.shape == (STEPS + 1, BATCH // 3)
        assert torch.equal(batch.memory["hidden"][:, 0], batch.steps["reward"][0])
        envs = batch.steps["reward"][0].long()
        assert torch.equal(batch.steps["logits"], data.steps["logits"][:, envs])
        seen.append(envs.tolist())
        return learn(self, batch)

    monkeypatch.setattr(Learner, "learn", watched)
    made.update(data)
    epochs = [[*seen[i], *seen[i + 1], *seen[i + 2]] for i in range(0, 12, 3)]
    assert all(sorted(epoch) == list(range(BATCH)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 4
    assert "advantage" not in data.steps.keys()


@pytest.mark.parametrize("memory", MEMORIES)
def test_sequences_are_unrolled_from_the_memory_before_the_unroll(memory):
    """What acted step by step is what the first minibatch learns from: its ratios are 1."""

    def make():
        made = agent(MEMORIES[memory], epochs=1, minibatches=1)
        with torch.no_grad():
            made.network.policy.weight *= 10.0  # what is remembered changes the policy by much
        return made

    made, data, generator = make(), unroll(), torch.Generator().manual_seed(0)
    data.memory = made.initial_memory(BATCH)
    with torch.no_grad():  # so that the memory is not empty
        data.memory = made.network(Inputs.of(unroll(1).steps), data.memory).state
    state, inputs, steps = data.memory, Inputs.of(data.steps), data.steps
    for t in range(STEPS):
        row = Inputs({"image": inputs.observation["image"][t]}, *(one[t] for one in inputs[1:]))
        steps["action"][t], state, extra = made.act(row, state, generator)
        steps["logits"][t] = extra["logits"]
    metrics = made.update(data)
    assert metrics["kl"] == pytest.approx(0, abs=1e-6)
    assert metrics["policy_loss"] == pytest.approx(0, abs=1e-5)
    if data.memory:
        data.memory = made.initial_memory(BATCH)
        assert make().update(data)["kl"] > 1e-5


@pytest.mark.parametrize("memory", ["mlp", "lstm"])
def test_captured_updates_equal_others(memory):
    eager, captured = (agent(MEMORIES[memory], max_gradient_norm=0.1) for _ in range(2))
    captured.capture(Tape)
    for seed in range(4):
        data = unroll(seed, eager)
        assert_equal(eager.update(data), captured.update(data))
    one, other = eager.state_dict(), captured.state_dict()
    for state in (one, other):
        del state["auxiliary"]["_extra_state"]
    assert_equal(one, other)
    assert eager.updates == captured.updates_made == 4 * 6


def test_auxiliary_losses_follow_every_step():
    vision = VisionOptions(name="vision", vision_weight=1.0, fraction=0.5)
    made = agent(auxiliary=vision)
    plain, both = agent().update(unroll()), made.update(unroll())
    assert both.keys() - plain.keys() == {"auxiliary_vision"}
    assert both["loss"] > plain["loss"]
    assert made.auxiliary.updates == 6


def test_divergence_in_a_minibatch_ends_the_update():
    made, data = agent(), unroll()
    data.steps["reward"][0, 0] = float("inf")  # the advantages of the other envs are finite
    with pytest.raises(FloatingPointError):
        made.update(data)
    assert made.updates < 3
    assert all(part.isfinite().all() for part in made.network.state_dict().values())


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["agent.minibatches=4"], r"agent\.minibatches=4: should divide collector\.num_envs=6, "),
        (
            ["agent.minibatches=6", "collector.unroll_length=1"],
            r"agent\.minibatches=6: leaves one frame to each",
        ),
        (
            ["agent.minibatches=2", "agent.clip_value=0.1", "critic=quantile"],
            r"agent\.clip_value=0\.1: critic=quantile has no single value to clip; choose null",
        ),
        (["agent.minibatches=2", "hindsight=achieved"], r"hindsight=achieved: agent=ppo does not "),
        (["agent.minibatches=2", "collector.lag=1"], r"collector\.lag=1: agent=ppo does not "),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(overrides, told, tmp_path):
    with pytest.raises(UserError, match=f"^{told}") as error:
        loading.load([*TINY, "agent=ppo", f"run_root={tmp_path}", *overrides])
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_ppo_learns_a_tiny_gridworld():
    options = OPTIONS.model_copy(
        update={
            "learning_rate": 1e-3,
            "discount": 0.95,
            "gae_lambda": 0.95,
            "minibatches": 4,
            "baseline_cost": 0.5,
            "entropy_cost": 0.03,
        }
    )
    network = compact(channels=16, size=64)
    memory = MLPOptions(name="mlp", size=32, layers=1)

    def make(*spaces):
        sizes = {"num_envs": 64, "unroll_length": 8}
        return PPO(options, AgentSpec(*spaces, network, memory, seed=0, **sizes))

    episodes = tiny_gridworld.after_learning(make, seed=0)
    assert episodes["success"].mean() >= 0.95
    assert episodes["length"].mean() <= 2.2
