"""An agent with a memory recalls a cue after ten steps; one without cannot."""

import numpy as np
import pytest
from networks import compact
from recall import CUES, Recall
from test_impala import OPTIONS

from zipf.agents.agent import AgentSpec
from zipf.agents.gtrxl import GTrXLOptions
from zipf.agents.impala import Impala
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.training.host_collector import HostCollector

pytestmark = pytest.mark.slow

DELAY = 10
IMPALA = OPTIONS.model_copy(
    update={
        "learning_rate": 5e-3,
        "max_gradient_norm": 1.0,
        "discount": 0.95,
        "baseline_cost": 0.5,
        "entropy_cost": 0.01,
    }
)
NETWORK = compact(channels=16, size=16)


def trained(memory, updates, **changes):
    """Episodes played after that many updates."""
    env = Recall(64, DELAY)
    spaces = env.single_observation_space, env.single_action_space
    agent = Impala(IMPALA.model_copy(update=changes), AgentSpec(*spaces, NETWORK, memory))
    collector = HostCollector(env, agent, unroll_length=2 * (DELAY + 1), seed=0)
    for _ in range(updates):
        agent.update(collector.collect())
    policy = AgentPolicy(agent, seed=1)
    return play(policy, Recall(100, DELAY), episodes=1000, seed=2)


GTRXL = GTrXLOptions(
    name="gtrxl", size=32, layers=1, heads=2, memory_length=DELAY, mlp_size=32, gate_bias=2.0
)


@pytest.mark.parametrize(
    ("memory", "learning_rate", "updates"),
    [
        (LSTMOptions(name="lstm", size=32, layers=1), 5e-3, 400),
        (LSTMOptions(name="lstm", size=32, layers=2), 5e-3, 600),
        (GTRXL, 2e-3, 400),
    ],
    ids=["lstm", "lstm of two layers", "gtrxl"],
)
def test_memories_recall(memory, learning_rate, updates):
    options = {"learning_rate": learning_rate, "entropy_cost": 0.03, "adam_beta2": 0.95}
    episodes = trained(memory, updates, **options)
    assert episodes["success"].mean() >= 0.95


def test_an_agent_without_memory_is_at_chance():
    episodes = trained(MLPOptions(name="mlp", size=32, layers=1), updates=400)
    sigma = np.sqrt(1 / CUES * (1 - 1 / CUES) / 1000)
    assert episodes["success"].mean() <= 1 / CUES + 4 * sigma
    assert episodes["return"].mean() > 0.9  # it did learn to wait, worth 0.1 a step


@pytest.mark.parametrize("world", range(3))
def test_the_worlds_rules(world):
    """Answering the cue succeeds; another answer, or moving while waiting, fails."""
    env = Recall(3, DELAY)
    for answer_right, stay in ((True, True), (False, True), (True, False)):
        _, info = env.reset(seed=world)
        for t in range(DELAY):
            wait = np.full(3, CUES) if stay or t != 4 else np.zeros(3, np.int64)
            _, _, terminated, _, _ = env.step(wait)
            assert not terminated.any()
        answer = info["cue"] if answer_right else (info["cue"] + 1) % CUES
        _, _, terminated, _, info = env.step(answer)
        assert terminated.all()
        assert (info["final_info"]["success"] == (answer_right and stay)).all()
