"""Collection beside learning: what it computes, how it goes on, and how it ends."""

import os
import signal
import threading

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from conftest import TINY, assert_equal, learned

from zipf import envs
from zipf.agents.unroll import Unroll
from zipf.errors import UserError
from zipf.experiments.building import loading, run_folder
from zipf.experiments.building.factory import build_agent
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.hooks.exploration import BONUSES
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.training import runner
from zipf.experiments.training.host_collector import Abandoned, HostCollector
from zipf.experiments.training.rollouts import BackgroundRollouts


@pytest.fixture(autouse=True)
def _one_thread_per_operator():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def _no_thread_is_left_behind():
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


def config_of(folder, *overrides):
    return loading.load([*TINY, "collector.lag=1", f"run_root={folder}", "name=row", *overrides])


def copied(unroll):
    final = None if unroll.final is None else unroll.final.clone()
    rest = unroll.memory, unroll.late_memory, final, unroll.episodes
    return Unroll(unroll.steps.clone(), *rest)


def in_turn(config, updates):
    """The definition, one thing after another and with an agent for each role: update k learns from
    what was played with the weights before update k - 1."""
    env = envs.make_train(config.split, config.collector.num_envs, **config.level_options)
    actor, learner = build_agent(config, env), build_agent(config, env)
    learner.begin_learning()
    collector = HostCollector(
        env,
        actor,
        unroll_length=config.collector.unroll_length,
        seed=derive_seed(config.seed, "training"),
        hooks=[
            BONUSES.build(
                config.exploration,
                env.single_observation_space,
                derive_seed(config.seed, "exploration"),
            )
        ],
    )
    rows = []
    unroll = copied(collector.collect())
    for _ in range(updates):
        following = copied(collector.collect())
        rows.append(learner.update(unroll))
        actor.load_state_dict(learner.state_dict())
        unroll = following
    return learner.state_dict(), collector.state_dict(), rows


R2D2 = ["agent.burn_in=2", "agent.replay_min=12", "agent.replay_capacity=24"]
AGENTS = {
    "impala": [],
    "impala in bfloat16": ["precision=bfloat16"],
    "impala with a transformer": ["condition=impala_transformer", "memory.memory_length=6"],
    "impala with random network distillation": ["exploration=rnd", "exploration.batch_size=4"],
    "impala with a histogram of returns": ["critic=hl_gauss", "critic.risk=averse"],
    "r2d2 with quantiles of returns": [
        *("condition=r2d2", "agent.storage=ram", "critic=quantile"),
        *("agent.burn_in=2", "agent.replay_min=12", "agent.replay_capacity=24"),
    ],
    "r2d2": ["condition=r2d2", "agent.storage=ram", *R2D2],
}


@pytest.mark.parametrize("overrides", AGENTS.values(), ids=AGENTS)
def test_it_equals_the_definition_bit_for_bit(overrides, tmp_path):
    if "condition=impala_transformer" in overrides:
        overrides = [*overrides, "memory=gtrxl", "memory.heads=2", "memory.mlp_size=8"]
    config = config_of(tmp_path, *overrides)
    agent, collector, rows = in_turn(config, updates=8)
    run_folder.make(config.folder)
    with runner.Run(config) as run:
        metrics = [run.step()[1] for _ in range(8)]
        assert_equal(run.agent.state_dict(), agent)
        state = run.rollouts.collector.state_dict()
    for name in ("environment", "memory", "generator", "inputs", "exploration"):
        assert_equal(state[name], collector[name], name)
    torch.testing.assert_close(metrics, rows, rtol=0, atol=0, equal_nan=True)
    if "importance_ratio" in metrics[0]:
        assert metrics[0]["importance_ratio"] == pytest.approx(1, abs=1e-6)
        assert all(abs(row["importance_ratio"] - 1) > 1e-6 for row in metrics[1:])


def test_an_unroll_that_was_not_learned_from_stays_in_ram(tmp_path):
    """Its memory alone is on the device, as that of a collected one: augmentation of what the host
    steps is NumPy's."""
    config = config_of(tmp_path, "augmentation=random")
    run_folder.make(config.folder)
    with runner.Run(config) as run:
        run.step()
        state = run.rollouts.state_dict()
        run.rollouts.collector.device = "meta"
        run.rollouts.load_state_dict(state)
        pending = run.rollouts._pending
        assert {part.device.type for part in pending.memory.values()} == {"meta"}
        assert_equal(pending.steps.to_dict(), state["pending"]["steps"])
        pending.changed(run.agent.augmentation)


def test_episodes_are_counted_in_the_unrolls_that_were_learned_from(tmp_path):
    config = config_of(tmp_path, "updates=8", "environment.max_steps=4")
    run_folder.make(config.folder)
    ended = 0
    with runner.Run(config) as run:
        for _ in range(8):
            unroll, _ = run.step()
            over = (unroll.steps["terminated"] | unroll.steps["truncated"])[:-1]
            ended += int(over.sum())
            assert run.rollouts.visits.state_dict()["episodes"].sum() == ended
        assert ended > 20
        assert len(run.rollouts._episodes["return"]) == ended
        assert run.rollouts.metrics()["episode_length"] <= 4
        assert np.isnan(run.rollouts.metrics()["episode_length"])


def test_evaluation_uses_what_was_learned(tmp_path):
    """The scores in the table are those of the checkpoint, whose weights nobody has acted with."""
    config = config_of(tmp_path, "updates=3", "agent.learning_rate=0.01")
    assert runner.train(config) == 0
    run_folder.make(config.folder)
    with runner.Run(config) as run:
        assert_equal(dict(run.agent.actor.state_dict()), dict(run.agent.network.state_dict()))


def test_an_agent_without_a_correction_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"^collector\.lag=1: agent=vmpo .*at most 0") as error:
        config_of(tmp_path, "agent=vmpo")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("agent", "lag"), [("impala", 1), ("vmpo", 0)])
def test_without_the_option_the_lag_is_what_the_agent_corrects_for(agent, lag, tmp_path):
    chosen = [*TINY, f"agent={agent}", f"run_root={tmp_path}", "name=row"]
    config = loading.load(chosen)
    assert config.lag == lag
    given = loading.load([*chosen, f"collector.lag={lag}"])
    assert given.what_is_learned == config.what_is_learned  # either resumes the other


def test_unrolls_before_the_last_are_left_alone():
    """With a lag of 1, the one before; and an unroll begins where the one before ends."""
    config = config_of("nowhere")
    env = envs.make_train(config.split, 6, **config.level_options)
    collector = HostCollector(env, build_agent(config, env), unroll_length=5, seed=0, lag=1)
    before = collector.collect()
    kept = copied(before)
    for _ in range(3):
        unroll = collector.collect()
        assert (unroll.steps != before.steps).any()
        assert (before.steps == kept.steps).all()
        for name in ("previous_action", "previous_reward", "is_first", "observation"):
            assert (before.steps[name][-1] == unroll.steps[name][0]).all()
        before, kept = unroll, copied(unroll)


# Errors and interrupts


class Envs:
    """A collector whose steps a test watches and breaks."""

    device = "cpu"
    visits = Visits(())

    def take_episodes(self):
        return {}

    def __init__(self, at_step=lambda step: None, steps=1000):
        self.at_step = at_step
        self.steps = steps
        self.done = 0
        self.abandoned = threading.Event()
        self.collected = threading.Event()

    def collect(self):
        if threading.current_thread() is threading.main_thread():
            return "first unroll"
        for step in range(self.steps):
            if self.abandoned.wait(0.005):
                raise Abandoned
            self.at_step(step)
            self.done += 1
        self.collected.set()
        return "unroll"

    def abandon(self):
        self.abandoned.set()


class Nobody:
    """An agent that is told nothing."""

    def separate_acting(self): ...
    def publish(self): ...


@pytest.mark.parametrize("error", [FloatingPointError, KeyboardInterrupt])
def test_an_error_in_learning_stops_collection(error):
    worlds = Envs()
    overlap = BackgroundRollouts(worlds, Nobody())

    def learn(unroll):
        raise error("from learning")

    with pytest.raises(error, match="from learning"):
        overlap.step(learn)
    assert worlds.done < worlds.steps
    overlap.close()


def test_an_error_in_collection_is_raised_after_learning():
    def at_step(step):
        raise MemoryError("from collection")

    overlap = BackgroundRollouts(Envs(at_step), Nobody())
    learned_from = []
    with pytest.raises(MemoryError, match="from collection"):
        overlap.step(learned_from.append)
    assert learned_from == ["first unroll"]
    overlap.close()


def test_an_interrupt_while_waiting_stops_collection(request):
    # A shell's background jobs begin with the signal ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    worlds = Envs(lambda step: os.kill(os.getpid(), signal.SIGINT) if step == 3 else None)
    overlap = BackgroundRollouts(worlds, Nobody())
    with pytest.raises(KeyboardInterrupt):
        overlap.step(lambda unroll: None)
    assert worlds.done < worlds.steps
    overlap.close()


def test_a_run_that_fails_leaves_no_thread(tmp_path):
    """Which the fixture checks; and the checkpoint before it is kept."""
    config = config_of(tmp_path, "updates=6", "agent.learning_rate=1e30")
    with pytest.raises(UserError, match="diverged"):
        runner.train(config)
    assert learned(config.folder)["update"] == 0


def test_autocast_in_one_thread_keeps_the_other_ones_casts():
    """A weight that is used twice is cast once, whatever the second thread does meanwhile."""
    weight, inputs = torch.randn(4, 4, requires_grad=True), torch.randn(2, 4)

    def at_step(step):
        with torch.autocast("cpu", torch.bfloat16):
            F.linear(inputs, weight)

    worlds = Envs(at_step, steps=3)
    overlap = BackgroundRollouts(worlds, Nobody())

    def learn(unroll):
        with torch.autocast("cpu", torch.bfloat16):
            first = F.linear(inputs, weight)
            assert worlds.collected.wait(10)
            second = F.linear(inputs, weight)
        return [casts(output.grad_fn) for output in (first, second)]

    _, (first, second) = overlap.step(learn)
    assert len(first) == 1
    assert first[0] is second[0]
    overlap.close()


def casts(node):
    """The nodes of an autograd graph that cast a tensor."""
    found = [node] if "ToCopy" in node.name() else []
    return found + [cast for after, _ in node.next_functions if after for cast in casts(after)]
