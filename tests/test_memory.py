"""Memories: unrolling equals stepping, and nothing crosses an episode's end."""

import numpy as np
import pytest
import torch

from zipf.agents.memory import LSTMOptions, MLPOptions, build_memory

MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=6, layers=2),
    "lstm": LSTMOptions(name="lstm", size=6),
}
FORGETS_NOTHING_TO_FORGET = {"mlp"}


def sequence(seed: int, steps: int = 20, batch: int = 4, features: int = 3):
    rng = np.random.default_rng(seed)
    inputs = torch.tensor(rng.normal(size=(steps, batch, features)), dtype=torch.float32)
    return inputs, torch.tensor(rng.random((steps, batch)) < 0.2)


def random_state(memory, batch):
    state = memory.initial_state(batch)
    return {name: torch.randn_like(part) for name, part in state.items()}


@pytest.mark.parametrize("name", MEMORIES)
@pytest.mark.parametrize("seed", range(4))
def test_unrolled_equals_stepped(name, seed):
    torch.manual_seed(seed)
    memory = build_memory(3, MEMORIES[name])
    inputs, is_first = sequence(seed)
    state = random_state(memory, 4)
    unrolled, after = memory(inputs, is_first, state)
    outputs = []
    for t in range(len(inputs)):
        output, state = memory(inputs[t : t + 1], is_first[t : t + 1], state)
        outputs.append(output[0])
    torch.testing.assert_close(unrolled, torch.stack(outputs))
    assert after.keys() == state.keys()
    for part in after:
        torch.testing.assert_close(after[part], state[part])


@pytest.mark.parametrize("name", MEMORIES)
def test_an_episode_is_read_as_if_nothing_had_been_before(name):
    torch.manual_seed(0)
    memory = build_memory(3, MEMORIES[name])
    inputs, is_first = sequence(0)
    is_first[:] = False
    is_first[7, 2] = True
    outputs, _ = memory(inputs, is_first, random_state(memory, 4))
    alone, _ = memory(inputs[7:], is_first[7:], memory.initial_state(4))
    torch.testing.assert_close(outputs[7:, 2], alone[:, 2])
    if name not in FORGETS_NOTHING_TO_FORGET:
        assert not torch.allclose(outputs[7:, 1], alone[:, 1])


def test_lstm_equals_torch():
    torch.manual_seed(0)
    memory = build_memory(3, MEMORIES["lstm"])
    reference = torch.nn.LSTM(3, 6)
    with torch.no_grad():
        reference.weight_ih_l0.copy_(memory.input_gates.weight)
        reference.bias_ih_l0.copy_(memory.input_gates.bias)
        reference.weight_hh_l0.copy_(memory.recurrent_gates.weight)
        reference.bias_hh_l0.zero_()
    inputs, is_first = sequence(0)
    state = random_state(memory, 4)
    expected, _ = reference(inputs, (state["hidden"][None], state["cell"][None]))
    outputs, _ = memory(inputs, torch.zeros_like(is_first), state)
    torch.testing.assert_close(outputs, expected)
