"""Every choice of every group is captured as the documentation's table says, by running it."""

import shutil
from types import SimpleNamespace

import pytest
import torch
from tape import Tape

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.building import device_envs, loading
from zipf.experiments.building.device_envs import compiles, not_captured, only_on_the_host
from zipf.experiments.building.factory import build_agent
from zipf.experiments.training.build_collector import build_collector, build_tensor_collector
from zipf.experiments.training.rollouts import SynchronousRollouts, TensorRollouts
from zipf.registry import registries

pytestmark = pytest.mark.usefixtures("all_patches")

SMALL = ["name=x", "collector.num_envs=6", "collector.unroll_length=5", "environment.max_steps=9",
         "memory.size=16", "collector.lag=0"]  # fmt: skip
FURTHER = {
    "r2d2": ["agent.burn_in=2", "agent.replay_min=6", "agent.replay_capacity=24",
             "agent.storage=ram"],
    "ppo": ["agent.minibatches=3"],
    "gtrxl": ["memory.heads=2", "memory.layers=1", "memory.memory_length=4"],
    "imitation": ["exploration=none"],
}  # fmt: skip
CHOICES = [
    (group, one)
    for group, registry in registries().items()
    if not registry.several
    for one in registry.options
]


def config_of(experiment, group, choice, *others):
    given = [f"experiment={experiment}", *SMALL, f"{group}={choice}", *FURTHER.get(choice, [])]
    return loading.load([*given, *others])


def test_resnets_are_compiled_on_cuda_where_there_is_a_compiler(monkeypatch):
    config = loading.load(["experiment=gridworld"])
    compact = loading.load(["experiment=gridworld_compact"])

    def on_cuda(made, has_triton=True):
        monkeypatch.setattr(device_envs, "find_spec", lambda name: name if has_triton else None)
        given = SimpleNamespace(compile=made.compile, network=made.network, torch_device="cuda")
        return compiles(given)

    monkeypatch.setenv("CC", "a-compiler")
    monkeypatch.setattr(shutil, "which", lambda name: name if name == "a-compiler" else None)
    assert on_cuda(config)
    assert not on_cuda(compact)
    assert not on_cuda(config, has_triton=False)
    assert not compiles(config.model_copy(update={"device": "cpu"}))
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not on_cuda(config)
    assert on_cuda(compact.model_copy(update={"compile": True}))
    assert not on_cuda(config.model_copy(update={"compile": False}))


@pytest.mark.parametrize("group", ["exploration", "hindsight", "augmentation"])
def test_a_plugins_choice_takes_the_host(group):
    """Its options may derive from ours, and what it does is its own."""
    choice = {"exploration": "count", "hindsight": "achieved", "augmentation": "random"}[group]
    config = config_of("demo", group, choice)
    assert not list(only_on_the_host(config))
    part = getattr(config, group)
    own = type("Own", (type(part),), {}).model_construct(**dict(part) | {"name": "own"})
    config = config.model_copy(update={group: own})
    assert list(only_on_the_host(config)) == [f"{group}=own"]


@pytest.mark.slow
@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_with_envs_on_the_device(group, choice):
    refused = ""
    try:
        config = config_of("demo", group, choice, "collector.envs=device")
    except UserError as error:
        refused = str(error)
    if refused:  # it takes the host, or what the gridworld does not show
        reasons = ("takes envs on the host", "instruction", "no questions")
        assert any(reason in refused for reason in reasons)
        return
    assert not [*only_on_the_host(config), *not_captured(config)]
    env = envs.make_tensor(config.split, 6, "cpu", **config.level_options)
    agent = build_agent(config, env)
    agent.begin_learning()
    collector = build_tensor_collector(config, env, agent)
    learns_captured(agent, TensorRollouts(collector), collector)


@pytest.mark.slow
@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_with_envs_on_the_host(group, choice):
    try:
        config = config_of("playroom_lift_compact", group, choice, "environment.image_size=[24,32]")
    except UserError:
        pytest.skip("does not go with lifting")
    if list(not_captured(config)):
        return
    # Its recurrent layers keep a workspace that the tape does not renew.
    with torch.backends.mkldnn.flags(enabled=False):
        env = envs.make_train(config.split, 6, **config.level_options)
        agent = build_agent(config, env)
        agent.begin_learning()
        learns_captured(agent, SynchronousRollouts(build_collector(config, env, agent)))


def learns_captured(agent, rollouts, collector=None):
    """Some updates as the tape replays them; what cannot be recorded raises."""
    before = {name: part.clone() for name, part in agent.network.state_dict().items()}
    agent.capture(Tape)
    if collector is not None:
        collector.capture(Tape)
    for _ in range(4):
        rollouts.step(agent.update)
    agent.check_finite()
    after = agent.network.state_dict()
    assert any(not torch.equal(part, after[name]) for name, part in before.items())
