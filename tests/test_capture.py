"""Captured agents against the same agents uncaptured, bit for bit; a tape takes a graph's place."""

from copy import deepcopy
from functools import partialmethod

import gymnasium as gym
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from conftest import TINY, assert_equal, learned, random_unroll, slow_but
from networks import compact
from tape import Tape
from test_auxiliary import HORIZON, VISION
from test_hindsight import OPTIONS as HINDSIGHT
from test_hindsight import episodes_of
from test_impala import OPTIONS
from test_r2d2 import agent as r2d2_agent
from test_r2d2 import unrolls as r2d2_unrolls
from test_vmpo import OPTIONS as VMPO_OPTIONS

from zipf.agents import fixed, learner
from zipf.agents.agent import AgentSpec
from zipf.agents.auxiliary import Auxiliary
from zipf.agents.capture import Captured, CaptureFailed
from zipf.agents.impala import Impala
from zipf.agents.learner import Learner, Loss
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.agents.vmpo import VMPO
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.training import runner

pytestmark = pytest.mark.usefixtures("all_patches")

ACTIONS, STEPS, BATCH = 3, 6, 4
MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=16, layers=1),
    "lstm": LSTMOptions(name="lstm", size=16, layers=2),
}


def build(memory="mlp", captured=False, agent=Impala, options=OPTIONS, **parts):
    made = agent(
        options.model_copy(update={"max_gradient_norm": 0.1}),
        AgentSpec(
            gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
            gym.spaces.Discrete(ACTIONS),
            compact(),
            MEMORIES[memory],
            num_envs=BATCH,
            unroll_length=STEPS,
            **parts,
        ),
    )
    if captured:
        made.capture(Tape)
    return made


def unroll(seed, memory="mlp", weighted=False):
    """Steps with bonuses and truncations."""
    drawn = random_unroll(STEPS, BATCH, ACTIONS, seed)
    drawn.memory = memory_of(seed) if memory == "lstm" else {}
    if weighted:
        generator = torch.Generator().manual_seed(seed)
        drawn.steps["weight"] = torch.rand(STEPS + 1, BATCH, generator=generator)
    return drawn


def memory_of(seed):
    lower, upper = (random_unroll(1, BATCH, 1, number).memory for number in (seed, seed + 100))
    return lower | {f"above.{name}": part for name, part in upper.items()}


def numbers(metrics):
    return {name: float(value) for name, value in metrics.items()}


def saved(agent):
    return deepcopy(agent.state_dict())


def learn_alike(one, other, seeds, **kinds):
    for seed in seeds:
        metrics = [numbers(agent.update(unroll(seed, **kinds))) for agent in (one, other)]
        assert metrics[0] == metrics[1]
    assert_equal(saved(one), saved(other))


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("memory", MEMORIES)
def test_captured_updates_equal_others(memory, weighted):
    kinds = {"memory": memory, "weighted": weighted}
    eager, captured = build(memory), build(memory, captured=True)
    learn_alike(eager, captured, range(10), **kinds)
    assert eager.updates_made == captured.updates == captured.updates_made == 10


def lasting(auxiliary):
    """The generator as it is on a device: always the same."""
    if auxiliary._generator is None:
        auxiliary._generator = torch.Generator().manual_seed(auxiliary.seed + auxiliary.updates)
    return auxiliary._generator


def one_hot(index, size):
    """As on CUDA: on a CPU PyTorch's reads the largest index on the host."""
    return (index.unsqueeze(-1) == torch.arange(size)).long()


@pytest.mark.parametrize(
    "auxiliary",
    [
        VISION.model_copy(update={"fraction": 0.5}),
        HORIZON.model_copy(update={"fraction": 0.5, "shift": 2, "unshifted": 3}),
    ],
    ids=lambda options: options.name,
)
def test_captured_updates_draw_what_others_draw(auxiliary, monkeypatch):
    """From the first update, and in a run that goes on."""
    monkeypatch.setattr(Auxiliary, "generator", lasting)
    monkeypatch.setattr(Auxiliary, "generators", lambda one: [lasting(one)])
    monkeypatch.setattr(fixed, "shapes", lambda tensor: True)
    monkeypatch.setattr(F, "one_hot", one_hot)
    eager, captured = (build("lstm", one, auxiliary=auxiliary) for one in (False, True))
    learn_alike(eager, captured, range(5), memory="lstm")
    resumed = build("lstm", captured=True, auxiliary=auxiliary)
    resumed.load_state_dict(saved(eager))
    learn_alike(eager, resumed, range(5, 8), memory="lstm")


@pytest.mark.parametrize("weighted", [False, True])
def test_vmpo_is_captured(weighted, monkeypatch):
    """Its target follows every second update, and its duals have an optimiser of their own."""
    monkeypatch.setattr(fixed, "shapes", lambda tensor: True)
    options = VMPO_OPTIONS.model_copy(update={"target_period": 2})
    kinds = {"agent": VMPO, "options": options, "weighted": weighted}
    eager, captured = (build("lstm", one, **kinds) for one in (False, True))
    for seed in range(7):
        learn_alike(eager, captured, [seed], memory="lstm", weighted=weighted)
        one, other = (acted(agent, agent.initial_memory(BATCH), 1) for agent in (eager, captured))
        assert_equal(one, other)


def test_costs_fade_in_what_is_captured():
    """Up to how their factor is rounded."""
    options = HINDSIGHT.model_copy(update={"fade": 4})
    eager, captured = (build("mlp", one, hindsight=options) for one in (False, True))
    for seed in range(6):
        metrics = []
        for agent in (eager, captured):
            data = unroll(seed)
            data.episodes = episodes_of([2, 4], actions=ACTIONS)
            metrics.append(numbers(agent.update(data)))
        assert metrics[0] == pytest.approx(metrics[1], rel=1e-5, nan_ok=True)


def test_r2d2_is_captured(monkeypatch):
    """With sequences from its replay, whose priorities follow from what the loss keeps."""
    monkeypatch.setattr(fixed, "shapes", lambda tensor: True)
    eager, captured = (r2d2_agent(target_period=2) for _ in range(2))
    captured.capture(Tape)
    steps = 0
    for one, other in zip(r2d2_unrolls(8), r2d2_unrolls(8), strict=True):
        metrics = [numbers(agent.update(data)) for agent, data in ((eager, one), (captured, other))]
        np.testing.assert_equal(*metrics)
        steps += np.isfinite(metrics[0]["loss"])
    assert steps > 3
    assert_equal(saved(eager), saved(captured))


def test_heads_are_what_they_are_in_bfloat16():
    eager, captured = (build(precision="bfloat16", captured=one) for one in (False, True))
    learn_alike(eager, captured, range(4))


@pytest.mark.parametrize("first", [False, True], ids=["eager first", "captured first"])
def test_checkpoints_of_either_kind_load_into_the_other(first):
    one, other = build("lstm", captured=first), build("lstm", captured=not first, seed=1)
    learn_alike(one, build("lstm"), range(3), memory="lstm")
    other.load_state_dict(deepcopy(one.state_dict()))
    learn_alike(one, other, range(3, 8), memory="lstm")
    assert other.updates_made == 8
    (group,) = other.state_dict()["optimiser"]["param_groups"]
    assert (group["lr"], group["capturable"]) == (OPTIONS.learning_rate, False)


@pytest.mark.parametrize("updates", [0, 3])
def test_a_recorded_agent_loads_in_place(updates):
    """Also the state of before the first update, which has none of an optimiser."""
    eager, captured = build(), build(captured=True, seed=1)
    for seed in range(updates):
        eager.update(unroll(seed))
    for seed in range(2):
        captured.update(unroll(seed + 50))
    captured.load_state_dict(deepcopy(eager.state_dict()))
    assert_equal(captured.state_dict()["network"], eager.state_dict()["network"])
    learn_alike(eager, captured, range(10, 13))


def test_learning_rates_are_read_at_every_update():
    eager, captured = build(), build(captured=True)
    before = deepcopy(captured.state_dict()["network"])
    for agent in (eager, captured):
        agent.scale_learning_rates(0.0)
        agent.update(unroll(0))
    assert_equal(captured.state_dict()["network"], before)
    for seed, factor in enumerate([1.0, 0.3, 0.7], start=1):
        for agent in (eager, captured):
            agent.scale_learning_rates(factor)
        learn_alike(eager, captured, [seed])
    (group,) = captured.state_dict()["optimiser"]["param_groups"]
    assert group["lr"] == 0.7 * OPTIONS.learning_rate
    assert group["initial_lr"] == OPTIONS.learning_rate


@pytest.mark.parametrize("first", [0, 2], ids=["at the first update", "later"])
@pytest.mark.parametrize("what", ["gradient's norm", "loss"])
def test_divergence_changes_nothing_until_it_is_reported(what, first):
    captured = build(captured=True)
    factor = torch.ones(())
    if what == "loss":
        loss = captured.loss
        captured.loss = lambda batch: Loss((found := loss(batch)).loss + factor.log(), *found[1:])
    else:
        captured.network.policy.weight.register_hook(lambda gradient: gradient * factor)
    for seed in range(first):
        captured.update(unroll(seed))
    captured.check_finite()
    before = saved(captured)
    for value in (torch.nan, 1.0):  # what follows is finite, and changes nothing, either
        factor.fill_(value)
        captured.update(unroll(5))
    after = saved(captured)
    assert captured.updates_made == first
    for name in ("updates", "auxiliary"):  # what the host counts
        assert after.pop(name) != before.pop(name)
    if not first:  # the optimiser has a state now, of zeros
        state = after["optimiser"].pop("state")
        assert all((part == 0).all() for one in state.values() for part in one.values())
        assert before["optimiser"].pop("state") == {}
    assert_equal(after, before)
    with pytest.raises(FloatingPointError, match=f"^the {what} is nan$"):
        captured.check_finite()
    captured.check_finite()  # it is reported once
    captured.update(unroll(6))
    assert not torch.equal(
        saved(captured)["network"]["policy.bias"], after["network"]["policy.bias"]
    )


def test_gradients_are_averaged_between_the_graphs(monkeypatch):
    """At every update, also at the first one, and none of it is recorded."""
    means = []

    def halve(parameters):
        parameters = [one for one in parameters if one.grad is not None]
        means.append(len(parameters))
        for one in parameters:
            one.grad.mul_(0.5 / len(means))  # not the same at every update

    monkeypatch.setattr(learner, "average_gradients", halve)
    captured = build(captured=True)
    found = [numbers(captured.update(unroll(seed))) for seed in range(3)]
    assert means == [len(captured.learned)] * 3
    means.clear()
    eager = build()
    assert found == [numbers(eager.update(unroll(seed))) for seed in range(3)]
    assert_equal(saved(eager), saved(captured))


def test_what_is_captured_has_one_shape():
    made = build(captured=True)
    made.update(unroll(0))
    longer = random_unroll(STEPS + 1, BATCH, ACTIONS)
    longer.memory = {}
    with pytest.raises(ValueError, match=r"the loss of an update: input 0\.steps\.\S+ is torch"):
        made.update(longer)
    with pytest.raises(ValueError, match=r"0\.steps\.weight is torch.*, and was not there when"):
        made.update(unroll(1, weighted=True))


def acted(agent, memory, seed, envs=BATCH):
    steps = random_unroll(STEPS, envs, ACTIONS, seed).steps
    generator = torch.Generator().manual_seed(seed)
    rows = []
    for t in range(STEPS):
        action, memory, behaviour = agent.act(Inputs.of(steps[t]), memory, generator)
        rows.append({"action": action, "memory": memory, **behaviour})
    return rows


def test_captured_acting_equals_other():
    """Before and after an update, in two batch sizes; and memories that are kept stay."""
    eager, captured = build("lstm"), build("lstm", captured=True)
    for seed in range(2):
        for envs in (BATCH, 7):
            one, other = (acted(a, a.initial_memory(envs), seed, envs) for a in (eager, captured))
            assert_equal(one, other)
        learn_alike(eager, captured, [seed], memory="lstm")
    assert sorted(shape for shape in captured._acting) == [(1, BATCH), (1, 7)]


def test_acting_apart_follows_what_is_published():
    eager, captured = build("lstm"), build("lstm", captured=True)
    for agent in (eager, captured):
        acted(agent, agent.initial_memory(BATCH), 0)
        agent.separate_acting()
        before = acted(agent, agent.initial_memory(BATCH), 1)
        agent.update(unroll(0, "lstm"))
        assert_equal(acted(agent, agent.initial_memory(BATCH), 1), before)
        agent.publish()
    one, other = (acted(agent, agent.initial_memory(BATCH), 1) for agent in (eager, captured))
    assert_equal(one, other)
    assert not torch.equal(before[0]["logits"], other[0]["logits"])


def test_values_of_any_number_of_envs_share_a_graph():
    eager, captured = build("lstm"), build("lstm", captured=True)
    for envs in (1, 3, BATCH, BATCH + 1):
        inputs = Inputs.of(random_unroll(STEPS, envs, ACTIONS, envs).steps[0])
        memory = {k: v[:1].expand(envs, -1) for k, v in memory_of(1).items()}
        one, other = (agent.value(inputs, memory) for agent in (eager, captured))
        assert one.shape == (envs,)
        torch.testing.assert_close(one, other)
    assert set(captured._acting) == {(1, BATCH), (1, 2 * BATCH)}


class Darker:
    """An augmentation of where the agent computes."""

    size = 1
    on_device = True

    def __init__(self):
        self.calls = 0

    def __call__(self, observation, draw):
        self.calls += 1
        assert draw is None
        return {name: part // 2 for name, part in observation.items()}


def test_an_augmentation_on_the_device_is_a_part_of_what_is_captured():
    eager, captured = build(), build(captured=True, augmentation=Darker())
    for seed in range(4):
        plain, dark = unroll(seed), unroll(seed)
        dark.steps["observation", "image"] //= 2
        assert numbers(captured.update(plain)) == numbers(eager.update(dark))
    assert captured.augmentation.calls == 3  # two to warm up, one to record
    assert build(augmentation=Darker()).update(unroll(0))["loss"] < torch.inf


class Reading(Impala):
    """Its loss reads a number on the host."""

    def loss(self, batch):
        found = super().loss(batch)
        return found._replace(loss=found.loss * float(found.loss > -1e9))


def test_what_cannot_be_captured_is_told():
    made = build(captured=True, agent=Reading)
    before = saved(made)
    wrong = (
        r"^the loss of an update cannot be captured \(.*not permitted.*\); choose capture=false$"
    )
    with pytest.raises(CaptureFailed, match=wrong):
        made.update(unroll(0))
    assert_equal(saved(made), before)


class Descending(Impala):
    """Its optimiser has no fused kernel."""

    def make_optimiser(self, parameters):
        return torch.optim.RMSprop(parameters)


def test_an_optimiser_that_cannot_be_captured_is_told():
    with pytest.raises(CaptureFailed, match=r"^RMSprop cannot be captured.*choose capture=false$"):
        build(captured=True, agent=Descending)


# Captured functions alone


class Walk:
    """A sum of draws, times what it is given."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(0)
        self.total = torch.zeros(3)
        self.made = {}

    def state(self):
        return [self.total, *self.made.values()]

    def step(self, batch):
        draws = torch.rand(3, generator=self.generator)
        self.total += batch["scale"] * draws
        self.made.setdefault("count", torch.zeros(())).add_(1)
        return {"total": self.total.clone(), "count": self.made["count"].clone()}


def test_recording_leaves_everything_as_it_was():
    """State, what was made meanwhile, and draws: the first call is the first step."""
    eager, captured = Walk(), Walk()
    run = Captured(
        captured.step, Tape(), captured.state, generators=[captured.generator], name="a walk"
    )
    for scale in (1.0, 2.0, 3.0):
        batch = {"scale": torch.tensor(scale)}
        assert_equal(run(batch), eager.step(batch))
    assert run.graph.replays == 3
    assert torch.equal(captured.generator.get_state(), eager.generator.get_state())


def test_inputs_that_are_the_recorded_ones_are_not_copied():
    walk = Walk()
    run = Captured(walk.step, Tape(), walk.state, generators=[walk.generator], name="a walk")
    run({"scale": torch.tensor(1.0)})
    (static,) = run.inputs
    before = walk.total.clone()
    static["scale"].zero_()
    assert torch.equal(run(static)["total"], before)


def test_a_captured_function_is_a_part_of_another():
    walk = Walk()
    inner = Captured(walk.step, Tape(), walk.state, generators=[walk.generator], name="inner")
    outer = Captured(
        lambda batch: inner(batch)["total"] * 2,
        Tape(),
        walk.state,
        generators=[walk.generator],
        name="outer",
    )
    eager, batch = Walk(), {"scale": torch.tensor(2.0)}
    for _ in range(3):
        assert torch.equal(outer(batch), eager.step(batch)["total"] * 2)
    assert (inner.graph.replays, outer.graph.replays) == (0, 3)
    inner({"scale": torch.tensor(2.0)})  # and can be called by itself
    assert inner.graph.replays == 1


def test_unrolls_are_nests():
    steps = unroll(0, "lstm")
    sums = Captured(
        lambda one: one.steps["reward"].sum() + one.memory["cell"].sum(),
        Tape(),
        list,
        name="sums",
    )
    for seed in range(3):
        steps = unroll(seed, "lstm")
        assert sums(steps) == steps.steps["reward"].sum() + steps.memory["cell"].sum()
    assert isinstance(sums.inputs[0], Unroll)
    with pytest.raises(TypeError, match="0 is a float: expected tensors"):
        Captured(lambda one: one, Tape(), list, name="a number")(1.0)


# Runs


def train(root, *options, captured=True):
    """Trains with captured updates; returns the folder."""
    config = loading.load([*TINY, "name=one", f"run_root={root}", *options])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(runner, "captures", lambda config: captured)
        patched.setattr(Learner, "capture", partialmethod(Learner.capture, Tape))
        # Batches of other sizes are summed up in another order.
        patched.setattr(Learner, "filled_up", lambda agent, inputs, memory: (inputs, memory))
        assert runner.train(config) == 0
    return config.folder


@pytest.mark.parametrize("every", ["schedule.log_every", "schedule.checkpoint_every"])
def test_a_run_that_diverges_ends_before_that_is_logged_or_saved(every, tmp_path):
    never = ["schedule.log_every=100", "schedule.checkpoint_every=100"]
    options = [*never, f"{every}=3", "updates=4", "agent.learning_rate=1e30"]
    with pytest.raises(UserError, match=r"learning diverged by update 3 \(the .* is \w+\)"):
        train(tmp_path, *options)
    (saved,) = tmp_path.rglob("checkpoint.pt")
    assert checkpoint.load(saved)["update"] == 0


@pytest.mark.parametrize("lag", slow_but([0, 1], 0))
def test_a_captured_run_goes_on_as_another(lag, tmp_path):
    """With a learning rate that falls, whichever of both is captured."""
    options = ["agent=impala", "learning_rate_decay=[1,6]", f"collector.lag={lag}"]
    whole = learned(train(tmp_path / "whole", *options, "updates=4", captured=False))
    for first in (False, True):
        root = tmp_path / str(first)
        train(root, *options, "updates=2", captured=first)
        both = learned(train(root, *options, "updates=4", captured=not first))
        assert_equal(both, whole)
