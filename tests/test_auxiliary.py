"""Auxiliary losses against their definitions, and what the memory learns from them."""

import math
from typing import Literal

import gymnasium as gym
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from networks import compact
from tensordict import TensorDict
from test_impala import OPTIONS as OF_IMPALA
from test_vmpo import OPTIONS as OF_VMPO

from zipf import envs
from zipf.agents.agent import AgentSpec
from zipf.agents.auxiliary import (
    AUXILIARIES,
    NO_AUXILIARY,
    Auxiliary,
    AuxiliaryOptions,
    build_auxiliary,
)
from zipf.agents.auxiliary.byol import (
    BYOLFrameOptions,
    BYOLHorizonOptions,
    BYOLOptions,
    random_shift,
)
from zipf.agents.auxiliary.reconstruction import (
    LanguageOptions,
    Reconstruction,
    VisionLanguageOptions,
    VisionOptions,
)
from zipf.agents.impala import Impala
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import ActorCritic, Inputs
from zipf.agents.network_options import ResNetOptions, ShallowOptions
from zipf.agents.unroll import Unroll
from zipf.agents.vmpo import VMPO
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.options import command_line

ACTIONS, STEPS, BATCH, WORDS, LENGTH = 3, 7, 4, 6, 5
COMPACT = compact(patch=None, channels=8, size=16, head_size=0)
OF_PARTS = {"code_channels": 4, "code_size": 6, "vector_layers": [5]}
RESNET = ResNetOptions(name="resnet", channels=[4, 6, 5], blocks=2, **OF_PARTS, head_size=0)
SHALLOW = ShallowOptions(
    name="shallow",
    channels=[4, 6],
    kernels=[6, 3],
    strides=[3, 2],
    size=16,
    normalise=False,
    **OF_PARTS,
    head_size=0,
)
NETWORKS = {"compact": COMPACT, "resnet": RESNET, "shallow": SHALLOW}
MEMORIES = {
    "mlp": MLPOptions(name="mlp", size=16, layers=1),
    "lstm": LSTMOptions(name="lstm", size=16, layers=1),
}

VISION = VisionOptions(name="vision", vision_weight=0.7, fraction=1.0)
VISION_LANGUAGE = VisionLanguageOptions(
    name="vision_language", vision_weight=0.7, language_weight=0.3, fraction=1.0
)
SIZES = {
    "weight": 0.6,
    "fraction": 1.0,
    "target_rate": 0.9,
    "forward_hidden": 10,
    "projection_hidden": 12,
    "prediction_hidden": 9,
    "projection_size": 8,
}
BYOL = BYOLOptions(name="byol", **SIZES)
FRAME = BYOLFrameOptions(name="byol_frame", shift=0, unshifted=0, **SIZES)
HORIZON = BYOLHorizonOptions(name="byol_horizon", horizon=3, shift=0, unshifted=0, **SIZES)
OPTIONS = {o.name: o for o in (VISION, VISION_LANGUAGE, BYOL, FRAME, HORIZON)}


def space(height=27, width=18):
    return gym.spaces.Dict(
        image=gym.spaces.Box(0, 255, (height, width, 3), np.uint8),
        instruction=gym.spaces.Box(0, WORDS - 1, (LENGTH,), np.int64),
    )


def build(options, network=COMPACT, memory="lstm", shape=(27, 18), seed=0):
    """An actor-critic and its auxiliary loss."""
    torch.manual_seed(0)
    actor = ActorCritic(space(*shape), gym.spaces.Discrete(ACTIONS), network, MEMORIES[memory])
    return actor, build_auxiliary(options, space(*shape), network, actor, seed)


def inputs(seed=0, shape=(27, 18)):
    """Rows of several short episodes, with instructions of all lengths."""
    rng = np.random.default_rng(seed)
    rows = (STEPS + 1, BATCH)
    words = rng.integers(1, WORDS, size=(*rows, LENGTH))
    words[np.arange(LENGTH) >= rng.integers(LENGTH + 1, size=(*rows, 1))] = 0
    is_first = rng.random(rows) < 0.25
    actions = np.where(is_first, -1, rng.integers(ACTIONS, size=rows))
    return Inputs(
        {
            "image": torch.tensor(rng.integers(256, size=(*rows, *shape, 3)), dtype=torch.uint8),
            "instruction": torch.tensor(words),
        },
        torch.tensor(actions),
        torch.zeros(rows),
        torch.tensor(is_first),
    )


def cores(seed=0):
    return torch.tensor(
        np.random.default_rng(seed).normal(size=(STEPS + 1, BATCH, 16)), dtype=torch.float32
    )


# The losses


def test_the_image_loss_equals_the_definition():
    _, loss_of = build(VISION)
    data, core = inputs(), cores()
    images = data.observation["image"][:STEPS].reshape(STEPS * BATCH, -1)
    start = []  # the mean image, within 1 and 99 percent
    for column in images.T.tolist():
        mean = min(max(sum(column) / len(column) / 255, 0.01), 0.99)
        start.append(math.log(mean / (1 - mean)))
    total, channels = 0.0, 0
    for t in range(STEPS):
        for b in range(BATCH):
            logits = loss_of.image(core[t, b][None])[0].flatten().tolist()
            pixels = data.observation["image"][t, b].flatten().tolist()
            for mean, logit, pixel in zip(start, logits, pixels, strict=True):
                p = 1 / (1 + math.exp(-mean - logit))
                y = pixel / 255
                total -= y * math.log(p) + (1 - y) * math.log(1 - p)
                channels += 1
    loss, metrics = loss_of(data, core)
    assert metrics.keys() == {"auxiliary_vision"}
    assert metrics["auxiliary_vision"].item() == pytest.approx(total / channels, rel=1e-5)
    assert loss.item() == pytest.approx(0.7 * total / channels, rel=1e-5)


def test_the_language_loss_equals_the_definition():
    """A textbook LSTM that reads the true words, one at a time."""
    _, loss_of = build(VISION_LANGUAGE)
    data, core = inputs(), cores()
    decoder = loss_of.instruction
    w_in, w_hidden, b_in, b_hidden = decoder.lstm.parameters()
    total, words = 0.0, 0
    with torch.no_grad():
        for t in range(STEPS):
            for b in range(BATCH):
                hidden, cell = decoder.state(core[t, b]).chunk(2)
                before = 0
                for word in data.observation["instruction"][t, b].tolist():
                    gates = w_in @ decoder.embedding.weight[before] + b_in
                    enter, forget, new, leave = (gates + w_hidden @ hidden + b_hidden).chunk(4)
                    cell = forget.sigmoid() * cell + enter.sigmoid() * new.tanh()
                    hidden = leave.sigmoid() * cell.tanh()
                    if word != 0:
                        total -= decoder.words(hidden).log_softmax(-1)[word].item()
                        words += 1
                    before = word
    assert 0 < words < STEPS * BATCH * LENGTH
    loss, metrics = loss_of(data, core)
    assert metrics.keys() == {"auxiliary_vision", "auxiliary_language"}
    assert metrics["auxiliary_language"].item() == pytest.approx(total / words, rel=1e-5)
    vision = metrics["auxiliary_vision"].item()
    assert loss.item() == pytest.approx(0.7 * vision + 0.3 * total / words, rel=1e-5)


def test_a_level_without_words_has_no_language_loss():
    _, loss_of = build(VISION_LANGUAGE)
    data = inputs()
    data.observation["instruction"].zero_()
    _, metrics = loss_of(data, cores())
    assert metrics["auxiliary_language"] == 0


def mlp_by_hand(mlp, rows):
    """Linear, batch normalisation over these rows, ReLU, linear: [N, inputs] -> [N, outputs]."""
    hidden = torch.stack([mlp.enter(row) for row in rows])
    columns = []
    for i, column in enumerate(hidden.T):
        deviation = math.sqrt(column.var(unbiased=False).item() + 1e-5)
        columns.append(mlp.scale[i] * (column - column.mean()) / deviation + mlp.offset[i])
    return torch.stack([mlp.leave(row.relu()) for row in torch.stack(columns).T])


@pytest.mark.parametrize(("options", "horizon"), [(FRAME, 0), (BYOL, 1), (HORIZON, 3)])
def test_the_byol_loss_equals_the_definition(options, horizon):
    """One env, row and distance at a time, except batch normalisation, which is over all rows."""
    _, loss_of = build(options)
    data, core = inputs(), cores()
    with torch.no_grad():  # as after some updates
        for name, parameter in loss_of.named_parameters():
            if name.endswith(("scale", "offset")):
                parameter.add_(torch.randn(parameter.shape))
    forward_map = loss_of.forward_map

    def encoded(t, b):
        seen = {name: part[t, b][None] for name, part in data.observation.items()}
        return loss_of.target_encoder(seen)[0]

    with torch.no_grad():
        places = [
            (t, b)
            for t in range(1, STEPS + 1)
            for b in range(BATCH)
            if horizon == 0 or not data.is_first[t, b]
        ]
        codes = mlp_by_hand(loss_of.target_projector, [encoded(t, b) for t, b in places])
        target = dict(zip(places, codes, strict=True))

        features = {k: {} for k in range(min(1, horizon), horizon + 1)}
        if horizon == 0:
            features[0] = {(t, b): forward_map.layers(core[t, b]) for t, b in places}
        for b in range(BATCH):
            for t in range(STEPS):
                state = None
                for k in range(1, horizon + 1):
                    if t + k > STEPS or data.is_first[t + k, b]:
                        break
                    action = F.one_hot(data.previous_action[t + k, b], ACTIONS).float()
                    if horizon == 1:
                        now = forward_map.layers(torch.cat([core[t, b], action]))
                    else:
                        state = forward_map.begin(core[t, b]).tanh() if state is None else state
                        state = forward_map.gru(action, state)
                        now = forward_map.end(state)
                    features[k][t + k, b] = now

        total, pairs = 0.0, 0
        for at in features.values():
            predicted = mlp_by_hand(
                loss_of.predictor, mlp_by_hand(loss_of.projector, list(at.values()))
            )
            for code, place in zip(predicted, at, strict=True):
                cosine = code @ target[place] / (code.norm() * target[place].norm())
                total += 2 - 2 * cosine.item()
                pairs += 1
        directions = [code / code.norm() for code in codes]
        mean = sum(directions) / len(directions)
        spread = math.sqrt(sum((d - mean).square().sum().item() for d in directions) / len(codes))
    assert pairs > 0
    assert pairs == STEPS * BATCH if horizon == 0 else pairs < STEPS * BATCH * horizon
    loss, metrics = loss_of(data, core)
    assert metrics.keys() == {"auxiliary_byol", "auxiliary_byol_spread"}
    assert metrics["auxiliary_byol"].item() == pytest.approx(total / pairs, rel=1e-4)
    assert metrics["auxiliary_byol_spread"].item() == pytest.approx(spread, rel=1e-4)
    assert loss.item() == pytest.approx(0.6 * total / pairs, rel=1e-4)


@pytest.mark.parametrize("options", [BYOL, HORIZON], ids=lambda o: o.name)
def test_the_next_episode_is_not_predicted(options):
    """With the memory's outputs held constant, frames matter as targets only."""
    _, loss_of = build(options)
    core = cores()
    loss, _ = loss_of(inputs(), core)
    for b in range(BATCH):
        for row in range(STEPS + 1):
            data = inputs()
            data.observation["image"][row, b] ^= 255
            changed = loss_of(data, core)[0] != loss
            assert changed == (row > 0 and not data.is_first[row, b]), (row, b)


def test_the_loss_is_0_for_episodes_of_one_frame():
    _, loss_of = build(HORIZON)
    data = inputs()
    data.is_first.fill_(True)
    loss, _ = loss_of(data, cores())
    assert loss == 0


@pytest.mark.parametrize("options", [VISION, VISION_LANGUAGE], ids=lambda o: o.name)
def test_the_first_row_of_the_next_unroll_is_left_out(options):
    _, loss_of = build(options)
    core = cores()
    loss, _ = loss_of(inputs(), core)
    for row in range(STEPS + 1):
        data = inputs()
        data.observation["image"][row, 1] ^= 255
        assert (loss_of(data, core)[0] != loss) == (row < STEPS)


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_bfloat16_computes_the_same(options):
    actor, loss_of = build(options)
    data = inputs()
    losses = []
    for enabled in (False, True):
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            outputs = actor(data, actor.memory.initial_state(BATCH))
            loss, metrics = loss_of(data, outputs.core)
        loss.backward()
        assert loss.dtype == torch.float32
        assert all(metric.dtype == torch.float32 for metric in metrics.values())
        losses.append(loss.item())
    assert losses[0] == pytest.approx(losses[1], rel=0.05)
    assert losses[0] != losses[1]


# What they are made of


@pytest.mark.parametrize("shape", [(63, 63), (72, 96), (36, 48), (64, 45)])
@pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS)
def test_every_network_has_a_decoder_that_mirrors_it(network, shape):
    actor, loss_of = build(VISION, network, shape=shape)
    assert loss_of.image(torch.zeros(2, 16)).shape == (2, *shape, 3)
    decoder, encoder = loss_of.image, actor.encoder.reader("image")
    if network is COMPACT:
        assert decoder.patch == encoder.patch
        assert decoder.unembed.weight.shape == encoder.embed.weight.T.shape
        assert decoder.unmix.out_features == encoder.mix.in_features
        return

    def filters(module):
        layers = torch.nn.Conv2d, torch.nn.ConvTranspose2d
        return [layer.weight.shape for layer in module.modules() if isinstance(layer, layers)]

    assert filters(decoder) == filters(encoder)[::-1]
    assert len(filters(decoder)) == (15 if network is RESNET else 2)


def test_the_patch_decoder_is_a_transposed_convolution():
    _, loss_of = build(VISION)
    decoder = loss_of.image
    core = cores()[0]
    embedded = decoder.unmix(core).relu().view(BATCH, 3, 2, 8).permute(0, 3, 1, 2)
    kernel = decoder.unembed.weight.view(9, 9, 3, 8).permute(3, 2, 0, 1)
    expected = F.conv_transpose2d(embedded, kernel, stride=9).permute(0, 2, 3, 1)
    expected = expected + decoder.unembed.bias.view(9, 9, 3).repeat(3, 2, 1)
    torch.testing.assert_close(decoder(core), expected)


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS)
def test_gradients_reach_memory_and_encoder(options, memory, network):
    actor, loss_of = build(options, network, memory)
    data = inputs()
    outputs = actor(data, actor.memory.initial_state(BATCH))
    loss_of(data, outputs.core)[0].backward()
    for name, parameter in actor.named_parameters():
        if name.startswith(("encoder", "memory")):
            assert parameter.grad.abs().sum() > 0, name
        else:
            assert parameter.grad is None, name
    for name, parameter in loss_of.named_parameters():
        assert (parameter.grad is None) == name.startswith("target"), name
    slow = [p for name, p in loss_of.named_parameters() if name.startswith("target")]
    assert bool(slow) == ("byol" in options.name)
    assert len(loss_of.learned()) == len(list(loss_of.parameters())) - len(slow)


@pytest.mark.parametrize("rate", [0.0, 0.9, 0.99, 1.0])
def test_the_target_is_a_moving_average(rate):
    actor, loss_of = build(BYOL.model_copy(update={"target_rate": rate}))
    online = [*actor.encoder.parameters(), *loss_of.projector.parameters()]
    target = [*loss_of.target_encoder.parameters(), *loss_of.target_projector.parameters()]
    for slow, fast in zip(target, online, strict=True):
        assert torch.equal(slow, fast)  # it begins there
    with torch.no_grad():
        for parameter in online:
            parameter.add_(torch.randn(parameter.shape))
    before = [slow.clone() for slow in target]
    loss_of.after_update(actor.encoder)
    for slow, was, fast in zip(target, before, online, strict=True):
        expected = rate * was + (1 - rate) * fast.detach()
        torch.testing.assert_close(slow, expected, rtol=1e-6, atol=1e-6)


def test_the_mean_image_is_that_of_the_first_update():
    _, loss_of = build(VISION)
    loss_of(inputs(0), cores())
    first = loss_of.mean_image.clone()
    assert first.shape == (27, 18, 3)
    loss_of.count(1)
    loss_of(inputs(1), cores())
    assert torch.equal(loss_of.mean_image, first)


# The shift


def test_an_image_is_shifted_and_its_cue_is_not():
    """Pixel by pixel, also those shifted into or out of the cue's square."""
    most, cue, n, height, width = 4, 9, 200, 15, 17
    rng = np.random.default_rng(0)
    images = rng.integers(200, size=(n, height, width, 3), dtype=np.uint8)
    images[:, :cue, :cue] += 56  # the cue's channels are not the others'
    images[:, :cue, :cue] |= 1 << 7
    images[:, cue:] &= 127
    images[:, :, cue:] &= 127
    draws = torch.Generator().manual_seed(3)
    down, right = torch.randint(0, 2 * most + 1, (2, n), generator=draws).numpy() - most
    assert set(zip(down.tolist(), right.tolist(), strict=True)) >= {(0, 0), (4, -4), (-4, 4)}

    shifted = random_shift(
        torch.from_numpy(images), most, cue, torch.Generator().manual_seed(3)
    ).numpy()
    for i in range(n):
        for y in range(height):
            for x in range(width):
                from_y = min(max(y + down[i], 0), height - 1)
                from_x = min(max(x + right[i], 0), width - 1)
                if (y < cue and x < cue) or (from_y < cue and from_x < cue):
                    from_y, from_x = y, x
                assert (shifted[i, y, x] == images[i, from_y, from_x]).all()
    is_cue = shifted >= 128
    assert is_cue[:, :cue, :cue].all()
    assert is_cue.sum() == n * cue * cue * 3
    assert (shifted != images).any((1, 2, 3)).sum() > 0.9 * n


# What is drawn at random


def test_a_random_fraction_of_the_frames_is_used():
    """Other frames every update, and the same ones in a resumed run."""
    half = VISION.model_copy(update={"fraction": 0.5})
    _, loss_of = build(half)
    data, core = inputs(), cores().requires_grad_()

    def frames_read(module):
        core.grad = None
        module(data, core)[0].backward()
        return core.grad.abs().sum(-1) > 0

    first = frames_read(loss_of)
    assert first.sum() == STEPS * BATCH / 2
    assert not first[STEPS].any()
    assert torch.equal(frames_read(loss_of), first)
    loss_of.count(1)
    second = frames_read(loss_of)
    assert not torch.equal(second, first)
    _, again = build(half)
    again.load_state_dict(loss_of.state_dict())
    assert torch.equal(frames_read(again), second)
    _, other = build(half, seed=1)
    assert not torch.equal(frames_read(other), first)

    _, loss_of = build(BYOL.model_copy(update={"fraction": 0.5}))
    assert frames_read(loss_of).any(0).sum() == BATCH / 2


def test_targets_are_shifted_anew_every_update():
    _, loss_of = build(HORIZON.model_copy(update={"shift": 4, "unshifted": 9}))
    data = inputs()
    before = {name: part.clone() for name, part in data.observation.items()}
    first = loss_of.targets(data, loss_of.generator())
    assert torch.equal(loss_of.targets(data, loss_of.generator()), first)
    loss_of.count(1)
    assert not torch.equal(loss_of.targets(data, loss_of.generator()), first)
    for name, part in data.observation.items():
        assert torch.equal(part, before[name])


# In the agents

IMPALA = OF_IMPALA.model_copy(update={"max_gradient_norm": 0.01})
V_MPO = OF_VMPO.model_copy(update={"max_gradient_norm": 0.01, "target_period": 2})
DRAWING = {
    "vision": VISION.model_copy(update={"fraction": 0.5}),
    "vision_language": VISION_LANGUAGE.model_copy(update={"fraction": 0.5}),
    "byol": BYOL,
    "byol_frame": FRAME.model_copy(update={"shift": 4}),
    "byol_horizon": HORIZON.model_copy(update={"fraction": 0.5, "shift": 4, "unshifted": 9}),
}


def agent(kind, options, seed=0):
    build_agent, agent_options = {"impala": (Impala, IMPALA), "vmpo": (VMPO, V_MPO)}[kind]
    spaces = space(), gym.spaces.Discrete(ACTIONS)
    spec = AgentSpec(*spaces, COMPACT, MEMORIES["lstm"], options, seed=seed)
    return build_agent(agent_options, spec)


def unroll(seed=0):
    rng = np.random.default_rng(seed)
    data, rows = inputs(seed), (STEPS + 1, BATCH)
    ends = torch.cat([data.is_first[1:], torch.zeros(1, BATCH, dtype=torch.bool)])

    def floats(*tail):
        return torch.tensor(rng.normal(size=(*rows, *tail)), dtype=torch.float32)

    steps = TensorDict(
        {
            "observation": TensorDict(data.observation, batch_size=rows),
            "previous_action": data.previous_action,
            "previous_reward": data.previous_reward,
            "is_first": data.is_first,
            "action": torch.tensor(rng.integers(ACTIONS, size=rows)),
            "reward": floats(),
            "bonus": floats(),
            "terminated": ends,
            "truncated": torch.zeros(rows, dtype=torch.bool),
            "truncation_value": torch.zeros(rows),
            "logits": floats(ACTIONS),
        },
        batch_size=rows,
    )
    return Unroll(steps, {part: torch.zeros(BATCH, 16) for part in ("hidden", "cell")})


@pytest.mark.parametrize("options", DRAWING.values(), ids=DRAWING)
@pytest.mark.parametrize("kind", ["impala", "vmpo"])
def test_an_agent_adds_the_loss_to_its_own(kind, options):
    plain, both = agent(kind, NO_AUXILIARY), agent(kind, options)
    for one, other in zip(plain.network.parameters(), both.network.parameters(), strict=True):
        assert torch.equal(one, other)  # the same weights, with and without
    data = unroll()
    loss, metrics = both.auxiliary(
        Inputs.of(data.steps), both.network(Inputs.of(data.steps), data.memory).core
    )
    before = [p.detach().clone() for p in both.learned]
    without, joint = plain.update(data), both.update(data)
    assert joint.keys() == without.keys() | metrics.keys()
    for name, metric in metrics.items():
        assert joint[name] == pytest.approx(metric.item(), rel=1e-5)
    assert joint["loss"] == pytest.approx((without["loss"] + loss).item(), rel=1e-5)
    norms = torch.stack([p.grad.norm() for p in both.learned])
    assert norms.norm().item() == pytest.approx(0.01, rel=1e-3)  # clipped together
    changed = [not torch.equal(p, was) for p, was in zip(both.learned, before, strict=True)]
    assert all(changed)


@pytest.mark.parametrize("options", DRAWING.values(), ids=DRAWING)
@pytest.mark.parametrize("kind", ["impala", "vmpo"])
def test_state_dict_continues_bit_for_bit(kind, options, tmp_path):
    whole = agent(kind, options)
    for seed in range(3):
        whole.update(unroll(seed))
    checkpoint.save(tmp_path / "checkpoint.pt", whole.state_dict())
    resumed = agent(kind, options, seed=0)
    resumed.load_state_dict(checkpoint.load(tmp_path / "checkpoint.pt"))
    for seed in range(3, 6):
        assert whole.update(unroll(seed)) == resumed.update(unroll(seed))
    for one, other in zip(whole.learned, resumed.learned, strict=True):
        assert torch.equal(one, other)
    one, other = whole.auxiliary.state_dict(), resumed.auxiliary.state_dict()
    assert one.keys() == other.keys()
    assert one.pop("_extra_state") == other.pop("_extra_state") == 6
    for name, value in one.items():
        assert torch.equal(value, other[name]), name


class SpeedOptions(AuxiliaryOptions):
    """Options of a loss of somebody else's."""

    name: Literal["speed"]
    weight: float


class Speed(Auxiliary):
    """The mean square of the memory's output."""

    def __init__(self, options, seed):
        super().__init__(seed)
        self.weight = options.weight

    def forward(self, inputs, core):
        size = core[:-1].square().mean()
        return self.weight * size, {"auxiliary_speed": size.detach()}


def test_an_auxiliary_loss_of_ones_own(own_registries):
    def build(options, space, network, torso, seed):
        assert set(space) == {"image", "instruction"}
        assert torso.memory.size == 16
        return Speed(options, seed)

    AUXILIARIES.register(SpeedOptions, build)
    assert AUXILIARIES.options["speed"] is SpeedOptions
    with pytest.raises(ValueError, match="auxiliary 'speed' is already registered"):
        AUXILIARIES.register(SpeedOptions, build)
    with_it = agent("impala", SpeedOptions(name="speed", weight=100.0))
    without = agent("impala", SpeedOptions(name="speed", weight=0.0))
    for _ in range(20):
        sizes = [a.update(unroll())["auxiliary_speed"] for a in (with_it, without)]
    assert sizes[0] < 0.5 * sizes[1]


def test_the_registry_has_the_losses_by_the_names_of_their_options():
    assert set(AUXILIARIES.options) >= {"none", *OPTIONS}
    assert sorted(command_line.choices("auxiliary")) == sorted(AUXILIARIES.options)


def test_the_papers_sizes():
    paper = loading.load(["experiment=playroom_lift", "auxiliary=byol"]).auxiliary
    assert (paper.forward_hidden, paper.projection_hidden) == (100, 200)
    assert (paper.prediction_hidden, paper.projection_size) == (100, 50)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            ["auxiliary=vision_language"],
            ["needs an instruction", "only image", "auxiliary=vision reconstructs the image alone"],
        ),
        (["auxiliary=language"], ["auxiliary=language needs an instruction", "only image"]),
        (
            ["auxiliary=vision", "environment.observation=tiles"],
            ["auxiliary=vision needs an image", "only cue, tiles"],
        ),
        (
            ["auxiliary=vision_language", "environment.observation=tiles"],
            ["needs an image and an instruction"],
        ),
        (
            ["auxiliary=byol_horizon", "environment.observation=tiles"],
            ["auxiliary=byol_horizon needs an image"],
        ),
        (["auxiliary=byol", "auxiliary.horizon=5"], ["auxiliary.horizon", "no such option"]),
        (["auxiliary=vision", "auxiliary.fraction=0.0"], ["auxiliary.fraction=0.0", "greater"]),
        (["auxiliary=bootstrap"], ["auxiliary=bootstrap", "byol_horizon"]),
        (["agent=r2d2", "auxiliary=byol"], ["auxiliary=byol: agent=r2d2 has no auxiliary losses"]),
    ],
)
def test_impossible_choices_are_one_clear_line(overrides, told):
    with pytest.raises(UserError) as error:
        loading.load(["experiment=gridworld_compact", *overrides])
    message = str(error.value)
    assert len(message.splitlines()) == 1
    for words in told:
        assert words in message


def test_byol_reads_tiles():
    loading.load(
        ["experiment=gridworld_compact", "auxiliary=byol", "environment.observation=tiles"]
    )


# What they teach


def learn(actor, loss_of, batches, learning_rate=3e-3):
    """Optimises the loss alone over the batches; returns its metrics of each."""
    learned = [*actor.encoder.parameters(), *actor.memory.parameters(), *loss_of.learned()]
    optimiser = torch.optim.Adam(learned, lr=learning_rate, fused=True)
    logged = []
    for data in batches:
        state = actor.memory.initial_state(data.is_first.shape[1])
        loss, metrics = loss_of(data, actor(data, state).core)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        loss_of.after_update(actor.encoder)
        loss_of.count(loss_of.updates + 1)
        logged.append({name: metric.item() for name, metric in metrics.items()})
    return logged


def test_reconstruction_can_learn_a_few_frames():
    """Black and white squares, whose cross-entropy can become 0."""
    actor, loss_of = build(VISION_LANGUAGE)
    data = inputs()
    squares = torch.rand(STEPS + 1, BATCH, 3, 2, 1) < 0.5
    image = squares.repeat_interleave(9, 2).repeat_interleave(9, 3) * 255
    data.observation["image"][:] = image
    logged = learn(actor, loss_of, [data] * 150, learning_rate=1e-2)
    assert logged[-1]["auxiliary_vision"] < 0.2 * logged[0]["auxiliary_vision"]
    assert logged[-1]["auxiliary_language"] < 0.2 * logged[0]["auxiliary_language"]


GOALS = 6


def walks(worlds, seed):
    """Three frames of random walks on one map of the gridworld, and the goal that the cue shows."""
    env = envs.make_vec("gridworld/uniform", worlds, num_maps=1, num_objects=GOALS)
    rng = np.random.default_rng(seed)
    seen, info = env.reset(seed=seed)
    ended, action = np.ones(worlds, np.bool_), np.full(worlds, -1)
    images, goals, is_first, actions = [], [], [], []
    for _ in range(3):
        images.append(seen["image"].copy())
        goals.append(info["target"].copy())
        is_first.append(ended)
        actions.append(np.where(ended, -1, action))
        action = rng.integers(8, size=worlds)
        seen, _, terminated, truncated, info = env.step(action)
        ended = terminated | truncated
    parts = (torch.from_numpy(np.stack(part)) for part in (images, actions, is_first, goals))
    image, previous_action, first, goal = parts
    return Inputs({"image": image}, previous_action, torch.zeros(first.shape), first), goal


def share_decoded(actor, train, test):
    """The share of test frames whose goal a linear map decodes from the frozen memory's output."""

    def features(data):
        with torch.no_grad():
            core = actor(data, actor.memory.initial_state(data.is_first.shape[1])).core
        return F.pad(core.flatten(0, 1), (0, 1), value=1.0).double()

    (data, goal), (other_data, other_goal) = train, test
    known, wanted = features(data), F.one_hot(goal.flatten(), GOALS).double()
    ridge = 1e-3 * torch.eye(known.shape[1], dtype=torch.float64)
    weights = torch.linalg.solve(known.T @ known + ridge, known.T @ wanted)
    decoded = (features(other_data) @ weights).argmax(-1)
    return (decoded == other_goal.flatten()).double().mean().item()


def test_reconstruction_teaches_a_memory_the_cue():
    """Starting with an encoder that ignores the cue, so that it cannot be decoded at first."""
    env = envs.make_vec("gridworld/uniform", 1, num_maps=1, num_objects=GOALS)
    network = compact(patch=9, channels=32, size=64, head_size=0)
    memory = LSTMOptions(name="lstm", size=64, layers=1)
    torch.manual_seed(0)
    actor = ActorCritic(env.single_observation_space, env.single_action_space, network, memory)
    with torch.no_grad():
        actor.encoder.reader("image").mix.weight[:, :32] = 0.0  # the first square's share
    loss_of = build_auxiliary(VISION, env.single_observation_space, network, actor, 0)
    train, test = walks(96, 0), walks(96, 1)
    chance = 1 / GOALS
    assert share_decoded(actor, train, test) < chance + 0.1
    logged = learn(actor, loss_of, [train[0]] * 75, learning_rate=1e-3)
    assert logged[-1]["auxiliary_vision"] < 0.9 * logged[0]["auxiliary_vision"]
    assert share_decoded(actor, train, test) > chance + 0.3


def episodes(rng):
    """Every episode shows one of six images, a third of whose pixels are noise."""
    worlds = 24
    scenes = np.random.default_rng(5).integers(256, size=(6, 27, 18, 3))
    images = np.repeat(scenes[rng.integers(6, size=worlds)][None], STEPS + 1, 0)
    images[:, :, :9] = rng.integers(256, size=images[:, :, :9].shape)
    is_first = np.zeros(images.shape[:2], np.bool_)
    is_first[0] = True
    actions = np.where(is_first, -1, rng.integers(ACTIONS, size=is_first.shape))
    return Inputs(
        {
            "image": torch.tensor(images, dtype=torch.uint8),
            "instruction": torch.ones(*is_first.shape, LENGTH, dtype=torch.int64),
        },
        torch.tensor(actions),
        torch.zeros(is_first.shape),
        torch.tensor(is_first),
    )


@pytest.mark.parametrize("options", [BYOL, DRAWING["byol_horizon"]], ids=lambda o: o.name)
@pytest.mark.parametrize("collapses", [False, True])
def test_byol_does_not_collapse(options, collapses, monkeypatch):
    """The targets stay different from each other; where they are learned too, they do not."""
    actor, loss_of = build(options)

    def learned_targets(data, generator):
        later = ~data.is_first[1:]
        seen = {name: part[1:].flatten(0, 1) for name, part in data.observation.items()}
        return loss_of.projector(actor.encoder(seen).unflatten(0, later.shape), later)

    if collapses:
        monkeypatch.setattr(loss_of, "targets", learned_targets)
        monkeypatch.setattr(loss_of.predictor, "forward", lambda code, mask: code)
    rng = np.random.default_rng(0)
    logged = learn(actor, loss_of, [episodes(rng) for _ in range(80)])
    assert logged[0]["auxiliary_byol_spread"] > 0.6
    assert logged[-1]["auxiliary_byol"] < 0.7 * logged[0]["auxiliary_byol"]
    assert (logged[-1]["auxiliary_byol_spread"] < 0.2) == collapses
    assert (logged[-1]["auxiliary_byol_spread"] > 0.5) != collapses


def test_language_alone_is_the_second_loss_of_both_and_decodes_no_image():
    both = build_auxiliary_of(VISION_LANGUAGE)
    alone = build_auxiliary_of(LanguageOptions(name="language", language_weight=0.3, fraction=1.0))
    assert alone.image is None
    assert not any("image" in name for name, _ in alone.named_parameters())
    alone.instruction.load_state_dict(both.instruction.state_dict())
    data = inputs(0)
    core = torch.randn(STEPS + 1, BATCH, 16, generator=torch.Generator().manual_seed(0))
    _, metrics = both(data, core)
    loss, own = alone(data, core)
    assert list(own) == ["auxiliary_language"]
    torch.testing.assert_close(own["auxiliary_language"], metrics["auxiliary_language"])
    torch.testing.assert_close(loss, 0.3 * own["auxiliary_language"])


def build_auxiliary_of(options):
    torch.manual_seed(0)
    return Reconstruction(space(), COMPACT, 16, options, seed=0)
