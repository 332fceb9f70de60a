"""Memories: unrolling equals stepping, and episodes do not affect each other."""

import math

import numpy as np
import pytest
import torch

from zipf.agents import memory as memories
from zipf.agents.gtrxl import Gate, GTrXLOptions
from zipf.agents.memory import LSTMOptions, MLPOptions

FEATURES, STEPS, BATCH, SIZE = 3, 20, 4, 6
GTRXL = GTrXLOptions(
    name="gtrxl", size=SIZE, layers=2, heads=2, memory_length=3, mlp_size=5, gate_bias=2.0
)
MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=SIZE, layers=1),
    "mlp of 2": MLPOptions(name="mlp", size=SIZE, layers=2),
    "lstm": LSTMOptions(name="lstm", size=SIZE, layers=1),
    "lstm of 2": LSTMOptions(name="lstm", size=SIZE, layers=2),
    "gtrxl": GTRXL,
    "gtrxl that remembers all": GTRXL.model_copy(update={"memory_length": 50, "layers": 1}),
    "gtrxl that remembers a frame": GTRXL.model_copy(update={"memory_length": 1}),
}
REMEMBERING = [name for name in MEMORIES if not name.startswith("mlp")]


def build(options, seed=0):
    """A memory with random parameters, also those that are constants at first."""
    torch.manual_seed(seed)
    memory = memories.MEMORIES.build(options, FEATURES)
    with torch.no_grad():
        for parameter in memory.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    return memory


def sequence(seed: int, steps: int = STEPS, ends: float = 0.2):
    rng = np.random.default_rng(seed)
    inputs = torch.tensor(rng.normal(size=(steps, BATCH, FEATURES)), dtype=torch.float32)
    return inputs, torch.tensor(rng.random((steps, BATCH)) < ends)


def some_state(memory):
    """A memory's state within episodes of different ages."""
    with torch.no_grad():
        return memory(*sequence(seed=99), memory.initial_state(BATCH))[1]


def in_parts(memory, inputs, is_first, state, ends):
    outputs, start = [], 0
    for end in ends:
        output, state = memory(inputs[start:end], is_first[start:end], state)
        outputs.append(output)
        start = end
    return torch.cat(outputs), state


def assert_same_state(one, other):
    assert one.keys() == other.keys()
    for name in one:
        torch.testing.assert_close(one[name], other[name])


@pytest.mark.parametrize("name", MEMORIES)
@pytest.mark.parametrize("seed", range(4))
def test_unrolled_equals_stepped(name, seed):
    """And equals any division into several unrolls."""
    memory = build(MEMORIES[name], seed)
    inputs, is_first = sequence(seed)
    state = some_state(memory)
    unrolled, after = memory(inputs, is_first, state)
    assert unrolled.shape == (STEPS, BATCH, memory.size)
    cuts = np.random.default_rng(seed).choice(np.arange(1, STEPS), 4, replace=False)
    for ends in (range(1, STEPS + 1), [*sorted(cuts), STEPS]):
        outputs, state_after = in_parts(memory, inputs, is_first, state, ends)
        torch.testing.assert_close(unrolled, outputs)
        assert_same_state(after, state_after)


@pytest.mark.parametrize("name", MEMORIES)
def test_an_episode_does_not_depend_on_those_before_it(name):
    memory = build(MEMORIES[name])
    inputs, is_first = sequence(0, ends=0.0)
    is_first[7, 2] = True
    state = some_state(memory)
    outputs, _ = memory(inputs, is_first, state)
    alone, _ = memory(inputs[7:], is_first[7:], memory.initial_state(BATCH))
    torch.testing.assert_close(outputs[7:, 2], alone[:, 2])
    if name in REMEMBERING:
        assert not torch.allclose(outputs[7:, 1], alone[:, 1])


@pytest.mark.parametrize("name", MEMORIES)
def test_episodes_do_not_leak_into_each_other(name):
    """Bit for bit, with other frames before it in the unroll and in the state."""
    memory = build(MEMORIES[name])
    inputs, is_first = sequence(0, ends=0.0)
    is_first[5, 0] = is_first[9, 1] = is_first[0, 2] = True
    outputs, after = memory(inputs, is_first, some_state(memory))
    changed = inputs.clone()
    changed[:5, 0] += 100.0
    changed[:9, 1] -= 100.0
    state = {k: v + 3 if v.is_floating_point() else v for k, v in some_state(memory).items()}
    changed_outputs, changed_after = memory(changed, is_first, state)
    assert torch.equal(outputs[5:, 0], changed_outputs[5:, 0])
    assert torch.equal(outputs[9:, 1], changed_outputs[9:, 1])
    assert torch.equal(outputs[:, 2], changed_outputs[:, 2])
    following, none_first = sequence(1, ends=0.0)
    outputs, _ = memory(following, none_first, after)
    changed_outputs, _ = memory(following, none_first, changed_after)
    assert torch.equal(outputs[:, :3], changed_outputs[:, :3])
    if name in REMEMBERING:
        begun, changed_begun = (
            memory(inputs, is_first, before)[0] for before in (some_state(memory), state)
        )
        assert not torch.allclose(begun[0, 3], changed_begun[0, 3])


@pytest.mark.parametrize("name", MEMORIES)
def test_the_state_is_zeros_at_the_start_and_worlds_are_its_rows(name):
    memory = build(MEMORIES[name])
    state = memory.initial_state(BATCH)
    inputs, is_first = sequence(0)
    outputs, after = memory(inputs, is_first, some_state(memory))
    assert after.keys() == state.keys()
    for part in state:
        assert state[part].shape[0] == BATCH
        assert not state[part].any()
        assert after[part].shape == state[part].shape
        assert after[part].dtype == state[part].dtype
        assert after[part].dtype in (torch.float32, torch.int64)
    rows = torch.tensor([False, True, False, True])
    state = {k: v[rows] for k, v in some_state(memory).items()}
    of_rows, after_of_rows = memory(inputs[:, rows], is_first[:, rows], state)
    torch.testing.assert_close(of_rows, outputs[:, rows])
    assert_same_state(after_of_rows, {k: v[rows] for k, v in after.items()})


@pytest.mark.parametrize("name", MEMORIES)
def test_mixed_precision(name):
    """Close to float32 with a state of float32, and unrolled still equals stepped."""
    memory = build(MEMORIES[name])
    inputs, is_first = sequence(0)
    state = some_state(memory)
    expected, _ = memory(inputs, is_first, state)
    with torch.autocast("cpu", torch.bfloat16):
        outputs, after = memory(inputs, is_first, state)
        stepped, _ = in_parts(memory, inputs, is_first, state, range(1, STEPS + 1))
    torch.testing.assert_close(outputs.float(), expected, rtol=0.1, atol=0.1)
    torch.testing.assert_close(outputs, stepped, rtol=0.03, atol=0.03)
    assert outputs.dtype == torch.float32 or name not in REMEMBERING
    for part in after:
        assert after[part].dtype == state[part].dtype
    outputs.float().square().sum().backward()
    assert all(p.grad.isfinite().all() for p in memory.parameters())


@pytest.mark.parametrize("name", MEMORIES)
def test_every_parameter_learns(name):
    memory = build(MEMORIES[name])
    outputs, _ = memory(*sequence(0), memory.initial_state(BATCH))
    (outputs * torch.randn_like(outputs)).sum().backward()
    for parameter in memory.parameters():
        assert parameter.grad.any()


@pytest.mark.parametrize("layers", [1, 2])
def test_lstm_equals_torch(layers):
    memory = build(LSTMOptions(name="lstm", size=SIZE, layers=layers))
    baseline = torch.nn.LSTM(FEATURES, SIZE, layers)
    state = some_state(memory)
    layer, hidden, cell = memory, [], []
    with torch.no_grad():
        for i in range(layers):
            getattr(baseline, f"weight_ih_l{i}").copy_(layer.input_gates.weight)
            getattr(baseline, f"bias_ih_l{i}").copy_(layer.input_gates.bias)
            getattr(baseline, f"weight_hh_l{i}").copy_(layer.recurrent_gates.weight)
            getattr(baseline, f"bias_hh_l{i}").zero_()
            layer = layer.above
            hidden.append(state["above." * i + "hidden"])
            cell.append(state["above." * i + "cell"])
    inputs, is_first = sequence(0, ends=0.0)
    expected, _ = baseline(inputs, (torch.stack(hidden), torch.stack(cell)))
    outputs, _ = memory(inputs, is_first, state)
    torch.testing.assert_close(outputs, expected)


def gtrxl_by_hand(memory, options, inputs, is_first):
    """One env's frames [T, F] in float64, one pair of frames at a time."""
    p = {name: part.detach().double().numpy() for name, part in memory.named_parameters()}
    size, heads, head_size = options.size, options.heads, options.size // options.heads

    def sigmoid(a):
        return 1 / (1 + np.exp(-a))

    def norm(a, name):
        scaled = (a - a.mean()) / np.sqrt(a.var() + 1e-5)
        return scaled * p[f"{name}.weight"] + p[f"{name}.bias"]

    def gate(x, y, name):
        w_r, w_z, w_g = np.split(p[f"{name}.of_y.weight"], 3)
        u_r, u_z = np.split(p[f"{name}.of_x.weight"], 2)
        u_g = p[f"{name}.of_reset_x.weight"]
        r = sigmoid(w_r @ y + u_r @ x)
        z = sigmoid(w_z @ y + u_z @ x - p[f"{name}.bias"])
        h = np.tanh(w_g @ y + u_g @ (r * x))
        return (1 - z) * x + z * h

    def of_distance(d):
        angles = [d / 10_000 ** (2 * k / size) for k in range(size // 2)]
        return np.array([math.sin(a) for a in angles] + [math.cos(a) for a in angles])

    x = [p["embed.weight"] @ one + p["embed.bias"] for one in inputs.double().numpy()]
    for i in range(options.layers):
        name = f"layers.{i}"
        # Each head has its query, key and value side by side.
        of_heads = p[f"{name}.project.weight"].reshape(heads, 3, head_size, size)
        w_kr = p[f"{name}.project_distances.weight"].reshape(heads, head_size, size)
        normed = [norm(one, f"{name}.norm") for one in x]
        above, begin = [], 0
        for t in range(len(x)):
            if is_first[t]:
                begin = t
            attended = []
            for h in range(heads):
                w_q, w_k, w_v = of_heads[h]
                u = p[f"{name}.content_bias"][h, 0]
                v = p[f"{name}.distance_bias"][h, 0]
                q = w_q @ normed[t]
                scores, values = [], []
                for j in range(max(begin, t - options.memory_length), t + 1):
                    k, r = w_k @ normed[j], w_kr[h] @ of_distance(t - j)
                    scores.append((q @ k + q @ r + u @ k + v @ r) / math.sqrt(head_size))
                    values.append(w_v @ normed[j])
                weights = np.exp(scores) / np.exp(scores).sum()
                attended.append(sum(w * value for w, value in zip(weights, values, strict=True)))
            y = p[f"{name}.mix.weight"] @ np.concatenate(attended)
            e = gate(x[t], np.maximum(y, 0), f"{name}.attention_gate")
            hidden = p[f"{name}.mlp.1.weight"] @ norm(e, f"{name}.mlp.0") + p[f"{name}.mlp.1.bias"]
            z = p[f"{name}.mlp.3.weight"] @ np.maximum(hidden, 0) + p[f"{name}.mlp.3.bias"]
            above.append(gate(e, np.maximum(z, 0), f"{name}.mlp_gate"))
        x = above
    return np.stack(x)


@pytest.mark.parametrize("name", [name for name in MEMORIES if name.startswith("gtrxl")])
@pytest.mark.parametrize("cuts", [[STEPS], [2, 9, 10, STEPS]])
def test_gtrxl_equals_its_definition(name, cuts):
    options = MEMORIES[name]
    memory = build(options)
    inputs, is_first = sequence(0, ends=0.1)
    assert is_first.any()
    outputs, _ = in_parts(memory, inputs, is_first, memory.initial_state(BATCH), cuts)
    for world in range(BATCH):
        expected = gtrxl_by_hand(memory, options, inputs[:, world], is_first[:, world])
        np.testing.assert_allclose(
            outputs[:, world].detach().numpy(), expected, rtol=1e-4, atol=1e-5
        )


@pytest.mark.parametrize("layers", [1, 2])
def test_every_layer_of_gtrxl_reaches_memory_length_further_back(layers):
    options = GTRXL.model_copy(update={"layers": layers})
    memory = build(options)
    inputs, is_first = sequence(0, ends=0.0)
    inputs.requires_grad_()
    outputs, _ = memory(inputs, is_first, memory.initial_state(BATCH))
    reach = layers * options.memory_length
    t = 12
    (gradient,) = torch.autograd.grad(outputs[t].square().sum(), inputs)
    seen = gradient.abs().amax((1, 2)) > 0
    assert seen.nonzero().squeeze().tolist() == list(range(t - reach, t + 1))


def test_gtrxl_does_not_attend_to_unused_places_of_the_state():
    memory = build(GTRXL)
    inputs, is_first = sequence(0, ends=0.0)
    state = memory.initial_state(BATCH)
    expected, after = memory(inputs[:2], is_first[:2], state)
    junk = {k: torch.randn_like(v) if v.is_floating_point() else v for k, v in state.items()}
    outputs, after_junk = memory(inputs[:2], is_first[:2], junk)
    assert torch.equal(outputs, expected)
    assert after["length"].tolist() == [2] * BATCH
    assert not torch.equal(after["layer0"], after_junk["layer0"])
    expected, after = memory(inputs[2:], is_first[2:], after)
    outputs, _ = memory(inputs[2:], is_first[2:], after_junk)
    assert torch.equal(outputs, expected)
    assert after["length"].tolist() == [GTRXL.memory_length] * BATCH


def test_gtrxl_gradients_stop_at_the_state():
    memory = build(GTRXL)
    inputs, is_first = sequence(0, ends=0.0)
    inputs.requires_grad_()
    _, after = memory(inputs, is_first, memory.initial_state(BATCH))
    assert not any(part.requires_grad for part in after.values())


def test_a_gate_is_near_the_identity_at_first():
    """The larger its bias, the nearer; with a bias of 0 it is half way to the candidate."""
    torch.manual_seed(0)
    x, y = torch.randn(2, 100, 64)
    moved = {}
    for bias in (0.0, 2.0, 9.0):
        moved[bias] = ((Gate(64, bias)(x, y) - x).norm() / x.norm()).item()
    assert 0.4 < moved[0.0] < 0.7
    assert 0.1 < moved[2.0] < 0.3
    assert moved[9.0] < 1e-3


def test_heads_that_do_not_divide_the_size_are_refused():
    with pytest.raises(ValueError, match=r"memory.heads=4 do not divide memory.size=6"):
        memories.MEMORIES.build(GTRXL.model_copy(update={"heads": 4}), FEATURES)


def test_an_lstm_begins_with_open_forget_gates():
    torch.manual_seed(0)
    memory = memories.MEMORIES.build(LSTMOptions(name="lstm", size=64, layers=2), 7)
    for layer in (memory, memory.above):
        enter, forget, candidate, leave = layer.input_gates.bias.chunk(4)
        for bias, middle in ((enter, 0), (forget, 1), (candidate, 0), (leave, 0)):
            assert (bias - middle).abs().max() <= 1 / 8  # uniform within 1 / sqrt(size)
            assert (bias - middle).abs().max() > 0.1
        for weight in (layer.input_gates.weight, layer.recurrent_gates.weight):
            assert 0.12 < weight.abs().max() <= 1 / 8
