"""Captured agents against the same agents uncaptured, bit for bit; a tape is replayed for a graph."""

from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import assert_equal, random_unroll
from networks import compact
from tape import Tape
from test_impala import OPTIONS

from zipf.agents.agent import AgentSpec
from zipf.agents.impala import Impala
from zipf.agents.memory import LSTMOptions, MLPOptions

ACTIONS, STEPS, BATCH = 3, 6, 4
MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=16, layers=1),
    "lstm": LSTMOptions(name="lstm", size=16, layers=2),
}


def build(memory="mlp", captured=False, precision="float32", **parts):
    space = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8))
    spec = AgentSpec(
        space,
        gym.spaces.Discrete(ACTIONS),
        compact(),
        MEMORIES[memory],
        num_envs=BATCH,
        unroll_length=STEPS,
        precision=precision,
        **parts,
    )
    made = Impala(OPTIONS.model_copy(update={"max_gradient_norm": 0.1}), spec)
    if captured:
        made.capture(Tape)
    return made


def unroll(seed, memory="mlp", weighted=False):
    drawn = random_unroll(STEPS, BATCH, ACTIONS, seed)
    drawn.memory = {}
    if memory == "lstm":
        above = {f"above.{name}": part for name, part in lstm_memory(seed + 100).items()}
        drawn.memory = lstm_memory(seed) | above
    if weighted:
        generator = torch.Generator().manual_seed(seed)
        drawn.steps["weight"] = torch.rand(STEPS + 1, BATCH, generator=generator)
    return drawn


def lstm_memory(seed):
    return random_unroll(1, BATCH, 1, seed).memory


def numbers(metrics):
    return {name: float(value) for name, value in metrics.items()}


def learned_alike(one, other, seeds, **kinds):
    for seed in seeds:
        metrics = [numbers(agent.update(unroll(seed, **kinds))) for agent in (one, other)]
        assert metrics[0] == metrics[1]
    assert_equal(saved(one), saved(other))


def saved(agent):
    state = deepcopy(agent.state_dict())
    del state["auxiliary"]["_extra_state"]
    return state


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("memory", MEMORIES)
def test_captured_updates_equal_others(memory, weighted):
    kinds = {"memory": memory, "weighted": weighted}
    eager, captured = build(memory), build(memory, captured=True)
    learned_alike(eager, captured, range(10), **kinds)
    assert captured.updates == captured.updates_made == 10
