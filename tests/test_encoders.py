"""Encoders and the actor-critic against plain versions of themselves."""

import gymnasium as gym
import numpy as np
import pytest
import torch
import torch.nn.functional as F

from zipf.agents.encoders import CompactOptions, Encoder, ResNetOptions, ShallowOptions
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import ActorCritic, Inputs

COMPACT = CompactOptions(name="compact", patch=9, channels=5, size=7, head_size=0)
SHALLOW = ShallowOptions(
    name="shallow", channels=[16, 32], kernels=[8, 4], strides=[4, 2], size=256, head_size=0
)
RESNET = ResNetOptions(name="resnet", channels=[16, 32, 32], blocks=2, head_size=8)


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
    patches = encoder.image
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


def test_the_resnet_sees_pixels_between_0_and_1():
    torch.manual_seed(0)
    encoder = Encoder(gym.spaces.Dict(image=image_space(8, 8)), RESNET)
    image = images(3, 8, 8)
    expected = encoder.image.layers(image.permute(0, 3, 1, 2).double().float() / 255)
    torch.testing.assert_close(encoder({"image": image}), expected)


def test_tiles_are_told_apart():
    torch.manual_seed(0)
    space = gym.spaces.Dict(
        tiles=gym.spaces.Box(0, 227, (7, 7), np.uint8), cue=gym.spaces.Box(0, 227, (1,), np.uint8)
    )
    encoder = Encoder(space, COMPACT)
    tiles = torch.zeros(3, 7, 7, dtype=torch.uint8)
    cue = torch.full((3, 1), 227, dtype=torch.uint8)
    tiles[1, 3, 4] = 5
    cue[2] = 5
    one, other, third = encoder({"tiles": tiles, "cue": cue})
    assert not torch.equal(one, other)
    assert not torch.equal(one, third)
    assert not torch.equal(other, third)


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


@pytest.mark.parametrize(
    ("space", "options"),
    [
        (gym.spaces.Dict(sound=image_space()), COMPACT),
        (gym.spaces.Dict(tiles=image_space(), cue=image_space()), RESNET),
        (gym.spaces.Dict(image=image_space(64, 64)), COMPACT),
    ],
)
def test_what_cannot_be_read_is_refused(space, options):
    with pytest.raises(ValueError, match="resnet"):
        Encoder(space, options)


@pytest.mark.parametrize(
    "memory", [MLPOptions(name="mlp", size=6, layers=1), LSTMOptions(name="lstm", size=6, layers=1)]
)
def test_the_last_action_and_reward_are_seen(memory):
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
