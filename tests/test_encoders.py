"""Encoders against plain versions of themselves, and that they read every kind of space."""

import itertools

import gymnasium as gym
import noise
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from networks import compact

from zipf import envs
from zipf.agents import image_networks
from zipf.agents.auxiliary.reconstruction import InstructionDecoder, word_cross_entropy
from zipf.agents.encoders import CodeEncoder, Encoder, InstructionEncoder, VectorEncoder
from zipf.agents.image_networks import ResNet, distinct_patches
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import ActorCritic, Inputs
from zipf.agents.network_options import (
    CompactOptions,
    ComparingOptions,
    ResNetOptions,
    ShallowOptions,
)

COMPACT = compact(patch=9, channels=5, size=7, head_size=0)
SIZES = {"code_channels": 4, "code_size": 6, "vector_layers": [5]}
SHALLOW = ShallowOptions(
    name="shallow",
    channels=[16, 32],
    kernels=[8, 4],
    strides=[4, 2],
    size=256,
    normalise=False,
    **SIZES,
    head_size=0,
)
NORMALISED = SHALLOW.model_copy(update={"normalise": True})
RESNET = ResNetOptions(name="resnet", channels=[16, 32, 32], blocks=2, **SIZES, head_size=8)


def image_space(height=63, width=63):
    return gym.spaces.Box(0, 255, (height, width, 3), np.uint8)


def words_space(length=6, vocabulary=11):
    return gym.spaces.Box(0, vocabulary - 1, (length,), np.int64)


def images(n, height=63, width=63):
    rng = np.random.default_rng(0)
    return torch.from_numpy(rng.integers(256, size=(n, height, width, 3), dtype=np.uint8))


def test_the_patch_encoder_is_a_convolution():
    torch.manual_seed(0)
    encoder = Encoder(gym.spaces.Dict(image=image_space(18, 27)), COMPACT)
    image = images(4, 18, 27)
    patches = encoder.reader("image")
    kernel = patches.embed.weight.view(5, 9, 9, 3).permute(0, 3, 1, 2)
    pixels = image.permute(0, 3, 1, 2) / 255
    embedded = F.conv2d(pixels, kernel, patches.embed.bias, stride=9).relu()
    expected = patches.mix(embedded.permute(0, 2, 3, 1).flatten(1)).relu()
    torch.testing.assert_close(encoder({"image": image}), expected)


@pytest.mark.parametrize(("shape", "size"), [((63, 63), 2048), ((72, 96), 3456)])
def test_the_papers_network_flattens_to_the_known_size(shape, size):
    """(72, 96): 9 x 12 x 32, as in the released IMPALA; (63, 63): 8 x 8 x 32."""
    encoder = Encoder(gym.spaces.Dict(image=image_space(*shape)), RESNET)
    assert encoder.size == size
    assert encoder({"image": images(2, *shape)}).shape == (2, size)
    convolutions = [layer for layer in encoder.modules() if isinstance(layer, torch.nn.Conv2d)]
    assert [layer.out_channels for layer in convolutions] == [16] * 5 + [32] * 10


def test_the_shallow_network_is_the_one_of_the_impala_paper():
    """On 72 x 96: 17 x 23 x 16, then 7 x 10 x 32, then 256."""
    torch.manual_seed(0)
    encoder = Encoder(gym.spaces.Dict(image=image_space(72, 96)), SHALLOW)
    image = images(3, 72, 96)
    shapes = [tuple(p.shape) for p in encoder.parameters()]
    assert shapes == [(16, 3, 8, 8), (16,), (32, 16, 4, 4), (32,), (256, 2240), (256,)]
    first, first_bias, second, second_bias, dense, dense_bias = encoder.parameters()
    hidden = F.conv2d(image.permute(0, 3, 1, 2) / 255, first, first_bias, stride=4).relu()
    hidden = F.conv2d(hidden, second, second_bias, stride=2).relu()
    expected = F.linear(hidden.flatten(1), dense, dense_bias).relu()
    torch.testing.assert_close(encoder({"image": image}), expected)
    with pytest.raises(ValueError, match="leaves nothing of an image of 9 x 9"):
        Encoder(gym.spaces.Dict(image=image_space(9, 9)), SHALLOW)


def test_the_shallow_network_normalised():
    encoder = Encoder(gym.spaces.Dict(image=image_space(72, 96)), NORMALISED)
    image = images(3, 72, 96)
    first, first_bias, second, second_bias, dense, dense_bias, scale, shift = encoder.parameters()
    with torch.no_grad():
        scale.uniform_()
        shift.uniform_()
    seen = image.permute(0, 3, 1, 2) / 255 * 2 - 1
    hidden = F.conv2d(seen, first, first_bias, stride=4).relu()
    hidden = F.conv2d(hidden, second, second_bias, stride=2).relu()
    hidden = F.linear(hidden.flatten(1), dense, dense_bias)
    mean, variance = hidden.mean(1, keepdim=True), hidden.var(1, correction=0, keepdim=True)
    expected = ((hidden - mean) / (variance + 1e-5).sqrt() * scale + shift).relu()
    torch.testing.assert_close(encoder({"image": image}), expected)


def comparing(comparison, **changes):
    options = COMPACT.model_dump() | {
        "name": "comparing",
        "comparison": comparison,
        "key_size": 8,
        "width": 6,
        "convolutions": 2,
    }
    return ComparingOptions(**options | changes)


def test_patches_are_compared_by_the_cosines_of_their_keys():
    torch.manual_seed(0)
    image = images(3, 18, 27)
    image[0, :9, :9] = 200  # of one colour
    encoder = Encoder(gym.spaces.Dict(image=image_space(18, 27)), comparing("learned"))
    network = encoder.reader("image")
    alike = torch.zeros(3, 6, 6)
    for n in range(3):
        keys = []
        for row, column in itertools.product(range(2), range(3)):
            patch = image[n, 9 * row : 9 * row + 9, 9 * column : 9 * column + 9].flatten() / 255.0
            key = network.key.weight.detach() @ (patch - patch.mean())
            keys.append(key / max(float(key.norm()), 0.1))
        for i, j in itertools.product(range(6), range(6)):
            alike[n, i, j] = keys[i] @ keys[j]
    patches, place = network.cut(image)
    assert place is None  # all patches but those of one colour differ
    keys = network.placed(network.keys(patches, network.key), place)
    torch.testing.assert_close(keys @ keys.transpose(1, 2), alike, atol=1e-4, rtol=0)
    torch.testing.assert_close(alike[0, 0], torch.zeros(6), atol=1e-4, rtol=0)
    assert alike[1, 0, 0] > 0.999
    embedded = network.placed(network.embedded(patches), place)
    sharpened = (network.sharpness * (alike - 1)).exp()
    grid = network.describe(torch.cat([embedded, sharpened], -1)).relu().view(3, 2, 3, -1)
    for convolution in network.convolutions:
        grid = convolution(grid.permute(0, 3, 1, 2)).relu().permute(0, 2, 3, 1)
    expected = network.mix(grid.flatten(1)).relu()
    torch.testing.assert_close(encoder({"image": image}), expected, atol=1e-4, rtol=1e-3)


def test_the_given_comparison_finds_what_the_cue_shows():
    """In the gridworld, whose cue has another background; walls and floor show nothing."""
    env = envs.make_vec("gridworld/uniform", 20)
    image = torch.from_numpy(env.reset(seed=0)[0]["image"])
    network = Encoder(env.single_observation_space, comparing("given")).reader("image")
    patches, place = network.cut(image)
    looks = network.placed(network.look(patches), place)
    same = (looks.unsqueeze(1) == looks.unsqueeze(2)) & (looks != 0).unsqueeze(1)
    tiles = envs.make_vec("gridworld/uniform", 20, observation="tiles")
    codes, _ = tiles.reset(seed=0)
    squares = torch.from_numpy(codes["tiles"].reshape(20, 49).astype(np.int64))
    cue = torch.from_numpy(codes["cue"].astype(np.int64))
    expected = squares == cue
    assert expected[:, 1:].any()
    assert torch.equal(same[:, 0, 1:], expected[:, 1:])
    assert torch.equal(same, same.transpose(1, 2))


def repeated(n, patch, columns=4, kinds=3, channels=3):
    """Images of 3 rows of patches, each of which is one of `kinds`, and which each is."""
    kind = torch.randint(kinds, (n, 3, columns))
    looks = torch.randint(0, 256, (kinds, patch, patch, channels)).byte()
    image = looks[kind].permute(0, 1, 3, 2, 4, 5).reshape(n, 3 * patch, columns * patch, channels)
    return image, kind.flatten(1)


@pytest.mark.parametrize(("patch", "channels"), [(9, 3), (4, 3), (1, 1), (5, 4), (8, 1)])
def test_patches_that_repeat_are_found_once(patch, channels):
    torch.manual_seed(0)
    image, kind = repeated(20, patch, channels=channels)
    for given in (image, image.transpose(1, 2).contiguous().transpose(1, 2), image.float()):
        patches, place = distinct_patches(given, patch)
        assert patches.shape == (3, patch * patch * channels)
        assert patches.dtype == given.dtype
        cut = image.unfold(1, patch, patch).unfold(2, patch, patch).permute(0, 1, 2, 4, 5, 3)
        assert torch.equal(patches[place], cut.reshape(20, 12, -1).to(given.dtype))
    assert torch.equal(place == place[0, 0], kind == kind[0, 0])


def test_patches_that_hardly_repeat_are_not_gathered():
    torch.manual_seed(0)
    assert distinct_patches(images(5, 18, 27), 9) is None


def test_patches_of_one_hash_are_told_apart():
    """The two here have one: 2^63 times the sum of two odd weights is 0 in 64 bits."""
    image = torch.zeros(10, 4, 8, 1).byte()
    image[0, 1, 3] = image[0, 3, 3] = 128  # the last bytes of both words of a patch
    assert distinct_patches(image, 4) is None
    patches, place = distinct_patches(image[1:], 4)
    assert len(patches) == 1
    assert not place.any()


@pytest.mark.parametrize("n", [4, 40])
@pytest.mark.parametrize("options", [COMPACT, comparing("learned"), comparing("given")])
def test_patches_that_repeat_are_encoded_as_any_others(options, n, monkeypatch):
    """Outputs and gradients, for few and for many images of 12 patches."""
    torch.manual_seed(0)
    image, _ = repeated(n, 9)
    network = Encoder(gym.spaces.Dict(image=image_space(27, 36)), options).reader("image")
    results = []
    for once in (True, False):
        if not once:
            monkeypatch.setattr(image_networks, "distinct_patches", lambda image, patch: None)
        assert (network.cut(image)[1] is not None) == once
        assert network.cut(image.float().requires_grad_())[1] is None
        network.zero_grad()
        output = network(image)
        (output * torch.linspace(-1, 1, output.numel()).view_as(output)).sum().backward()
        results.append([output, *(parameter.grad for parameter in network.parameters())])
    for found, expected in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


def test_the_resnet_reads_pixels_between_0_and_1():
    torch.manual_seed(0)
    encoder = Encoder(gym.spaces.Dict(image=image_space(8, 8)), RESNET)
    image = images(3, 8, 8)
    expected = encoder.reader("image").layers(image.permute(0, 3, 1, 2).double().float() / 255)
    torch.testing.assert_close(encoder({"image": image}), expected)


TILES = gym.spaces.Dict(
    tiles=gym.spaces.Box(0, 227, (7, 7), np.uint8), cue=gym.spaces.Box(0, 227, (1,), np.uint8)
)


def test_the_code_encoder_embeds_all_codes_by_one_table():
    """For the gridworld's tiles: one table, the tiles before the cue."""
    torch.manual_seed(0)
    encoder = Encoder(TILES, COMPACT)
    codes = encoder.reader("tiles")
    assert codes is encoder.reader("cue")
    assert [tuple(p.shape) for p in encoder.parameters()] == [(228, 5), (7, 250), (7,)]
    rng = np.random.default_rng(0)
    tiles = torch.from_numpy(rng.integers(228, size=(3, 7, 7), dtype=np.uint8))
    cue = torch.from_numpy(rng.integers(228, size=(3, 1), dtype=np.uint8))
    cells = torch.cat([tiles.flatten(1), cue], -1).long()
    expected = codes.mix(codes.embed.weight[cells].relu().flatten(1)).relu()
    torch.testing.assert_close(encoder({"tiles": tiles, "cue": cue}), expected)


def test_codes_count_from_their_start():
    torch.manual_seed(0)
    shifted = gym.spaces.Dict(
        cell=gym.spaces.Discrete(4, start=-2), more=gym.spaces.MultiDiscrete([3, 5], start=[7, 1])
    )
    plain = gym.spaces.Dict(cell=gym.spaces.Discrete(4), more=gym.spaces.MultiDiscrete([3, 5]))
    encoder, other = Encoder(shifted, COMPACT), Encoder(plain, COMPACT)
    other.load_state_dict(encoder.state_dict())
    cell, more = torch.tensor([0, 3]), torch.tensor([[2, 4], [0, 0]])
    torch.testing.assert_close(
        encoder({"cell": cell - 2, "more": more + torch.tensor([7, 1])}),
        other({"cell": cell, "more": more}),
    )


def test_vectors_are_scaled_by_their_bounds_or_by_symlog():
    space = gym.spaces.Dict(
        {
            "a": gym.spaces.Box(np.float32([-4, -np.inf, 0]), np.float32([4, np.inf, np.inf])),
            "b": gym.spaces.Box(10, 30, (2,), np.int32),
            "c": gym.spaces.MultiBinary(2),
            "d": gym.spaces.Box(-3e38, 3e38, (1,), np.float32),  # bounds that stand for none
            "e": gym.spaces.Box(5, 5, (1,), np.float32),
            "f": gym.spaces.Box(1e9, 1e9 + 10, (1,), np.float64),
            "g": gym.spaces.Box(2_000_000_000, 2_000_000_100, (1,), np.int64),
        }
    )
    vectors = Encoder(space, COMPACT).reader("a")
    read = []
    vectors.layers.register_forward_pre_hook(lambda _, inputs: read.append(inputs[0]))
    vectors(
        torch.tensor([[2.0, -100.0, 3.0]]),
        torch.tensor([[10, 25]], dtype=torch.int32),
        torch.tensor([[0, 1]], dtype=torch.int8),
        torch.tensor([[1e4]]),
        torch.tensor([[5.0]]),
        torch.tensor([[1e9 + 7.5]], dtype=torch.float64),
        torch.tensor([[2_000_000_025]]),
    )
    expected = [0.5, -np.log(101), np.log(4), -1.0, 0.5, -1.0, 1.0, np.log(10001), -1.0, 0.5, -0.5]
    np.testing.assert_allclose(read[0][0], expected, rtol=1e-5)


def test_vectors_go_through_an_mlp():
    torch.manual_seed(0)
    options = COMPACT.model_copy(update={"vector_layers": [6, 3]})
    encoder = Encoder(gym.spaces.Dict(x=gym.spaces.Box(-1, 1, (4,))), options)
    assert encoder.size == 3
    first, first_bias, second, second_bias = encoder.parameters()
    x = torch.rand(5, 4)
    expected = F.linear(F.linear(x, first, first_bias).relu(), second, second_bias).relu()
    torch.testing.assert_close(encoder({"x": x}), expected)


KINDS = {
    ResNet: ["image", "arm.camera"],
    InstructionEncoder: ["instruction", "mission"],
    CodeEncoder: ["cell", "cells", "tiles", "cue", "board"],
    VectorEncoder: ["position", "lights", "ram", "counts", "switches"],
}


@pytest.mark.parametrize("space", noise.SPACES)
def test_the_space_of_a_part_decides_which_encoder_reads_it(space):
    encoder = Encoder(noise.SPACES[space], RESNET)
    known = 0
    for kind, names in KINDS.items():
        for name in set(names) & set(noise.SPACES[space]):
            assert type(encoder.reader(name)) is kind, name
            known += 1
    assert known or set(noise.SPACES[space]) == {"x"}
    each = {name for names in encoder.names for name in names}
    assert each == set(noise.SPACES[space])


@pytest.mark.parametrize(
    "options",
    [RESNET, SHALLOW, NORMALISED, COMPACT, comparing("learned"), comparing("given")],
    ids=["resnet", "shallow", "normalised", "compact", "learned", "given"],
)
@pytest.mark.parametrize("space", noise.SPACES)
def test_every_network_reads_every_space(space, options):
    """Every part changes the result, and gradients reach every parameter."""
    torch.manual_seed(0)
    if isinstance(options, CompactOptions):
        options = options.model_copy(update={"patch": None})
    encoder = Encoder(noise.SPACES[space], options)
    noise.SPACES[space].seed(0)
    samples = [noise.SPACES[space].sample() for _ in range(4)]
    parts = {
        name: torch.from_numpy(np.stack([sample[name] for sample in samples]))
        for name in noise.SPACES[space]
    }
    encoded = encoder(parts)
    assert encoded.shape == (4, encoder.size)
    encoded.square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad.any(), name
    for name, part in parts.items():
        others = parts | {name: part.flip(0)}
        assert not torch.equal(encoder(others), encoded), name


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (RESNET, None),
        (COMPACT.model_copy(update={"patch": None}), None),
        (COMPACT, r"network.patch=9 does not divide the image of 7 x 7 .*null is the largest"),
        (SHALLOW, "leaves nothing of an image of 7 x 7 .* or network=compact"),
    ],
)
def test_small_images(options, told):
    space = gym.spaces.Dict(image=image_space(7, 7))
    if told is None:
        assert Encoder(space, options)({"image": images(2, 7, 7)}).shape[0] == 2
    else:
        with pytest.raises(ValueError, match=told):
            Encoder(space, options)


def test_zeros_between_other_codes_are_no_padding():
    """An int64 part may hold codes of which 0 is one: all that stands behind it is read."""
    torch.manual_seed(0)
    reader = InstructionEncoder(9)
    codes = torch.tensor([[5, 0, 7, 0], [5, 0, 8, 0], [5, 7, 0, 0], [0, 0, 7, 0], [0, 0, 0, 0]])
    outputs = reader(codes)
    distances = torch.cdist(outputs, outputs) + torch.eye(len(codes))
    assert distances.min() > 1e-3
    torch.testing.assert_close(outputs[:1], reader(codes[:1, :3]))
    every, _ = reader.lstm(reader.embedding(codes))
    torch.testing.assert_close(outputs, every[range(5), [2, 2, 1, 2, 0]])


def test_an_instruction_is_read_to_its_last_word():
    torch.manual_seed(0)
    space = gym.spaces.Dict(image=image_space(9, 9), instruction=words_space())
    encoder = Encoder(space, COMPACT)
    assert encoder.size == 7 + 32
    short = torch.tensor([[4, 9, 2, 0, 0, 0]])
    image = images(1, 9, 9)
    padded = encoder({"image": image, "instruction": short})
    unpadded = encoder({"image": image, "instruction": short[:, :3]})
    torch.testing.assert_close(padded, unpadded)
    longer = torch.tensor([[4, 9, 2, 5, 0, 0]])
    assert not torch.allclose(padded, encoder({"image": image, "instruction": longer}))
    reordered = torch.tensor([[9, 4, 2, 0, 0, 0]])
    assert not torch.allclose(padded, encoder({"image": image, "instruction": reordered}))


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32"])
@torch.no_grad()
def test_an_instruction_may_be_of_any_integers(dtype):
    torch.manual_seed(0)
    words = gym.spaces.Box(0, 10, (6,), dtype)
    encoder = Encoder(gym.spaces.Dict(instruction=words), COMPACT)
    decoder = InstructionDecoder(5, 11)
    codes, core = np.array([[4, 9, 2, 0, 0, 0]]), torch.randn(1, 5)
    told, usual = torch.from_numpy(codes.astype(dtype)), torch.from_numpy(codes)
    assert torch.equal(encoder({"instruction": told}), encoder({"instruction": usual}))
    logits = decoder(core, told)
    assert torch.equal(logits, decoder(core, usual))
    assert word_cross_entropy(logits, told) == word_cross_entropy(logits, usual)


@torch.no_grad()
def test_instructions_are_read_in_float32_under_autocast():
    """Which all CPUs can; what is returned has the precision of the rest."""
    torch.manual_seed(0)
    reader = InstructionEncoder(50)
    codes = torch.randint(50, (6, 5))
    exact = reader(codes)
    assert (exact != exact.bfloat16().float()).any()
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(reader(codes), exact.bfloat16())


@pytest.mark.parametrize(
    ("space", "told"),
    [
        (gym.spaces.Dict(words=gym.spaces.Text(9)), "no encoder reads 'words'.*Text.*MultiBinary"),
        (gym.spaces.Dict(arm=gym.spaces.Dict(x=gym.spaces.Discrete(2))), "no encoder reads 'arm'"),
        (gym.spaces.Dict(), "nothing to read"),
    ],
)
def test_what_no_encoder_reads_is_refused(space, told):
    with pytest.raises(ValueError, match=told):
        Encoder(space, COMPACT)


@pytest.mark.parametrize(
    "memory", [MLPOptions(name="mlp", size=6, layers=1), LSTMOptions(name="lstm", size=6, layers=1)]
)
def test_the_network_reads_the_last_action_and_reward(memory):
    torch.manual_seed(0)
    network = ActorCritic(
        gym.spaces.Dict(image=image_space(9, 9)), gym.spaces.Discrete(4), COMPACT, memory
    )
    image = images(1, 9, 9)[None]

    def logits(action, reward):
        inputs = Inputs(
            {"image": image},
            torch.tensor([[action]]),
            torch.tensor([[reward]]),
            torch.tensor([[False]]),
        )
        return network(inputs, network.memory.initial_state(1)).logits

    plain = logits(-1, 0.0)
    assert not torch.allclose(plain, logits(0, 0.0))
    assert not torch.allclose(logits(1, 0.0), logits(0, 0.0))
    assert not torch.allclose(plain, logits(-1, 1.0))
    torch.testing.assert_close(logits(-1, 1.0), logits(-1, 5.0))  # clipped
