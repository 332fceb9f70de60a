"""The base class of agents and their registry: what holds for every agent."""

from copy import deepcopy
from typing import Literal

import gymnasium as gym
import noise
import numpy as np
import pytest
import torch
from conftest import assert_equal
from networks import compact

from zipf.agents.agent import Agent, AgentSpec, agents, register, unsupported
from zipf.agents.auxiliary.reconstruction import VisionOptions
from zipf.agents.critics import SCALAR
from zipf.agents.episodic import DictionaryOptions
from zipf.agents.memory import LSTMOptions
from zipf.agents.network import Inputs
from zipf.agents.unroll import Unroll
from zipf.experiments.hooks.labels import Labels
from zipf.experiments.hooks.reweighting import InverseCountOptions
from zipf.experiments.options.config_files import find
from zipf.experiments.training.host_collector import HostCollector
from zipf.options import Options

ACTIONS, ENVS, STEPS = 2, 4, 5
SPACE = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8))
ACTION_SPACE = gym.spaces.Discrete(ACTIONS)
NETWORK = compact()
LSTM = LSTMOptions(name="lstm", size=8, layers=1)


def options_of(name):
    """An agent's options as shipped, small and at once ready to learn."""
    values = dict(find("agent", name).values)
    if name == "r2d2":
        values |= {"burn_in": 2, "replay_min": ENVS, "replay_capacity": 64, "storage": "ram"}
    if name == "vmpo":
        values |= {"target_period": 1}
    return agents()[name].Options.model_validate(values)


def build(name, seed=0, space=SPACE, actions=ACTION_SPACE, network=NETWORK, **changes):
    batch = {"num_envs": ENVS, "unroll_length": STEPS}
    spec = AgentSpec(space, actions, network, LSTM, seed=seed, **batch, **changes)
    made = agents()[name](options_of(name), spec)
    made.begin_learning()
    return made


class RandomLabels:
    """A teacher of envs without a scripted policy."""

    def __init__(self):
        self.rng = np.random.default_rng(0)

    def __call__(self):
        return self.rng.integers(ACTIONS, size=ENVS)


def unrolls(made, count):
    """Unrolls that the agent, which does not learn meanwhile, collects."""
    env = noise.Noise(ENVS, made.spec.observation_space)
    hooks = [Labels(RandomLabels(), 0.0)] if made.needs.teacher else []
    collector = HostCollector(env, made, unroll_length=STEPS, seed=0, hooks=hooks)
    for _ in range(count):
        unroll = collector.collect()
        final = None if unroll.final is None else unroll.final.clone()
        yield Unroll(unroll.steps.clone(), unroll.memory, unroll.late_memory, final)


def answer(made, seed=0):
    """What `act` and `value` return for some frames, as a list of tensors."""
    generator = torch.Generator().manual_seed(seed)
    image = torch.randint(256, (ENVS, 9, 9, 3), generator=generator, dtype=torch.uint8)
    first = torch.ones(ENVS, dtype=torch.bool)
    inputs = Inputs({"image": image}, torch.full((ENVS,), -1), torch.zeros(ENVS), first)
    memory = made.initial_memory(ENVS)
    action, after, extra = made.act(inputs, memory, generator, training=False)
    return [action, made.value(inputs, memory), *after.values(), *extra.values()]


def weights(module):
    return [parameter.detach().clone() for parameter in module.parameters()]


def equal(one, other):
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


NAMES = sorted(agents())


@pytest.mark.parametrize("name", NAMES)
def test_the_weights_follow_the_seed(name):
    one, same, other = (weights(build(name, seed=seed).network) for seed in (1, 1, 2))
    assert equal(one, same)
    assert not equal(one, other)


@pytest.mark.parametrize("name", NAMES)
def test_the_optimiser_has_the_values_of_the_options(name):
    values = {"learning_rate": 0.02, "adam_beta1": 0.7, "adam_beta2": 0.9, "adam_epsilon": 0.1}
    if name == "r2d2":
        values["weight_decay"] = 0.3
    options = options_of(name).model_copy(update=values)
    batch = {"num_envs": ENVS, "unroll_length": STEPS}
    made = agents()[name](options, AgentSpec(SPACE, ACTION_SPACE, NETWORK, LSTM, **batch))
    (group,) = made.optimisers["optimiser"].param_groups
    assert group["lr"] == 0.02
    assert group["betas"] == (0.7, 0.9)
    assert group["eps"] == 0.1
    assert group["weight_decay"] == values.get("weight_decay", 0)


@pytest.mark.parametrize("name", NAMES)
def test_a_loaded_agent_continues_bit_for_bit(name):
    one, other = build(name), build(name, seed=1)
    collected = list(unrolls(one, 6))
    for unroll in collected[:3]:
        one.update(unroll)
    other.load_state_dict(deepcopy(one.state_dict()))
    for unroll in collected[3:]:
        one.update(unroll)
        other.update(unroll)
    assert_equal(one.state_dict(), other.state_dict())


def test_the_registry_has_the_agents_by_the_names_of_their_options():
    assert {"imitation", "impala", "ppo", "r2d2", "supervised", "vmpo"} <= set(agents())
    for name, agent in agents().items():
        assert agent.Options.model_fields["name"].annotation == Literal[name]


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
@pytest.mark.parametrize("name", NAMES)
def test_a_gradient_that_is_not_finite_changes_no_weights(name, value):
    made = build(name)
    first, second, third = unrolls(made, 3)
    for unroll in (first, second):
        made.update(unroll)
    before = weights(made.network)
    parameter = next(p for p in made.network.parameters() if p.requires_grad)
    parameter.register_hook(lambda gradient: torch.full_like(gradient, value))
    with pytest.raises(FloatingPointError):
        made.update(third)
    assert equal(weights(made.network), before)


@pytest.mark.parametrize("name", ["impala", "ppo", "vmpo"])
def test_actions_follow_the_policy(name):
    made, n = build(name), 4000
    generator = torch.Generator().manual_seed(0)
    image = torch.full((n, 9, 9, 3), 200, dtype=torch.uint8)
    first = torch.ones(n, dtype=torch.bool)
    inputs = Inputs({"image": image}, torch.full((n,), -1), torch.zeros(n), first)
    action, _, behaviour = made.act(inputs, made.initial_memory(n), generator)
    probabilities = behaviour["logits"][0].softmax(-1).numpy()
    assert probabilities.max() - probabilities.min() > 0.01
    frequencies = np.bincount(action.numpy(), minlength=ACTIONS) / n
    sigma = np.sqrt(probabilities * (1 - probabilities) / n)
    assert (abs(frequencies - probabilities) < 4 * sigma).all()


@pytest.mark.parametrize("name", NAMES)
def test_separate_acting_uses_the_weights_that_were_published_last(name):
    """Updates change the weights that are learned alone; `publish` makes the two equal again."""
    made, learner = build(name), build(name)
    made.separate_acting()
    before = weights(made.actor), answer(made)
    data = list(unrolls(made, 3))
    for unroll in data:
        one, other = ({k: float(v) for k, v in of.update(unroll).items()} for of in (made, learner))
        assert one == pytest.approx(other, nan_ok=True)
    assert equal(before[0], weights(made.actor))
    assert equal(before[1], answer(made))
    assert not equal(before[0], weights(learner.actor))
    places = [parameter.data_ptr() for parameter in made.actor.parameters()]
    made.publish()
    assert equal(weights(made.actor), weights(learner.actor))
    assert equal(answer(made), answer(learner))
    assert places == [parameter.data_ptr() for parameter in made.actor.parameters()]


@pytest.mark.parametrize("name", NAMES)
def test_separate_acting_does_not_change_what_is_saved(name):
    made, learner = build(name), build(name)
    made.separate_acting()
    assert made.state_dict().keys() == learner.state_dict().keys()
    for unroll in unrolls(made, 3):
        made.update(unroll)
    other = build(name, seed=1)
    other.separate_acting()
    other.load_state_dict(made.state_dict())
    other.publish()
    made.publish()
    assert equal(answer(made), answer(other))


ROWS = DictionaryOptions.model_validate(
    {
        **find("episodic", "dictionary").values,
        "capacity": 16,
        "key_size": 4,
    }
)


@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize(
    ("name", "parts"),
    [(name, {}) for name in NAMES]
    + [(name, {"episodic": ROWS}) for name in NAMES if "episodic" in agents()[name].supports],
    ids=lambda value: value if isinstance(value, str) else "+".join(value),
)
def test_weights_are_all_that_acting_needs(name, parts, separate):
    """Also those that were learned after the last `publish`, and the rows of a dictionary."""
    made, other = build(name, **parts), build(name, seed=1, **parts)
    if separate:
        made.separate_acting()
    for unroll in unrolls(made, 3):
        made.update(unroll)
    kept = deepcopy(made.weights())
    made.publish()
    assert not equal(answer(made), answer(other))
    other.load_weights(kept)
    assert equal(answer(made), answer(other))


@pytest.mark.parametrize("name", NAMES)
def test_copies_are_compiled_where_the_original_is(name):
    for first, second in (("compile", "separate_acting"), ("separate_acting", "compile")):
        made = build(name)
        getattr(made, first)()
        getattr(made, second)()
        assert made.actor.encoder.reader("image")._compiled_call_impl is not None
        assert made.network.encoder.reader("image")._compiled_call_impl is not None


@pytest.mark.parametrize("name", NAMES)
def test_without_images_there_is_nothing_to_compile(name):
    with pytest.raises(ValueError, match=r"compile=true: .* has none; choose compile=false"):
        build(name, space=noise.SPACES["tiles"]).compile()


@pytest.mark.parametrize("name", NAMES)
def test_an_agent_without_auxiliary_losses_refuses_one(name):
    auxiliary = VisionOptions(name="vision", vision_weight=1.0, fraction=1.0)
    if "auxiliary" in agents()[name].supports:
        build(name, auxiliary=auxiliary)
    else:
        with pytest.raises(ValueError, match="choose auxiliary=none, or agent=imit"):
            build(name, auxiliary=auxiliary)


@pytest.mark.parametrize("name", NAMES)
def test_an_agent_without_episodic_memory_refuses_one(name):
    sizes = {"capacity": 8, "neighbours": 2, "key_size": 4, "kernel_delta": 1e-3}
    options = DictionaryOptions(name="dictionary", **sizes, outcome=True, discount=0.9)
    if "episodic" in agents()[name].supports:
        made = build(name, episodic=options)
        for unroll in unrolls(made, 3):
            made.update(unroll)
        assert int(made.network.dictionary.filled) == options.capacity
    else:
        with pytest.raises(ValueError, match="choose episodic=none, or agent=imitation or impala"):
            build(name, episodic=options)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("space", noise.SPACES)
def test_every_agent_learns_from_any_space(space, name):
    """Two updates, whose gradients reach every encoder."""
    made = build(name, space=noise.SPACES[space], network=compact(patch=None))
    before = {key: value.clone() for key, value in made.network.state_dict().items()}
    for unroll in unrolls(made, 3):  # R2D2's first has no prefix and is not learned from
        metrics = made.update(unroll)
    assert np.isfinite(float(metrics["loss"]))
    after = made.network.state_dict()
    for key in before:
        assert not torch.equal(before[key], after[key]), key


@pytest.mark.parametrize("name", NAMES)
def test_actions_are_discrete(name):
    with pytest.raises(ValueError, match=r"Box\(-1.0, 1.0, \(2,\), float32\).*discrete actions"):
        build(name, actions=gym.spaces.Box(-1, 1, (2,)))


class ConstantOptions(Options):
    """A third party's."""

    name: Literal["constant"]
    action: int


class Constant(Agent):
    """The least that an agent has to define."""

    Options = ConstantOptions

    def act(self, inputs, memory, generator, *, training=True):
        return torch.full((len(inputs.is_first),), self.options.action), memory, {}

    def update(self, unroll):
        return {}

    def state_dict(self):
        return {}

    def load_state_dict(self, state):
        pass


def test_an_agent_of_ones_own_needs_four_methods(own_registries):
    assert register(Constant) is Constant
    options = ConstantOptions(name="constant", action=1)
    spaces = SPACE, ACTION_SPACE
    made = agents()["constant"](options, AgentSpec(*spaces, NETWORK, LSTM))
    assert made.begin_learning() == []
    for unroll in unrolls(made, 2):
        assert (unroll.steps["action"][:-1] == 1).all()
        assert made.update(unroll) == {}
    rare = InverseCountOptions(name="inverse_count", power=1.0, largest_weight=9.0, table_size=64)
    (refused,) = unsupported(agents()["constant"], {"reweighting": rare, "critic": SCALAR})
    assert refused.startswith(
        "reweighting=inverse_count: agent=constant does not weigh its losses; choose "
        "reweighting=none, or agent=imitation or impala or"
    )
    with pytest.raises(ValueError, match="agent 'constant' is already registered"):
        register(Constant)


def test_an_agents_options_name_it():
    class Nameless(Constant):
        Options = Options

    with pytest.raises(ValueError, match="Options: should have a field `name: Literal"):
        register(Nameless)
