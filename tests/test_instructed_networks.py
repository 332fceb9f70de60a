"""Networks that read images by an instruction, against their definitions."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from zipf.agents.encoders import Encoder
from zipf.agents.network_options import (
    AttentionOptions,
    FiLMOptions,
    MatchingOptions,
    ShallowOptions,
)

VALUES = {
    "channels": [3, 5],
    "kernels": [4, 3],
    "strides": [2, 1],
    "size": 7,
    "normalise": False,
    "code_channels": 4,
    "code_size": 4,
    "vector_layers": [4],
    "head_size": 0,
}
SHALLOW = ShallowOptions(name="shallow", **VALUES)
FILM = FiLMOptions(name="film", **VALUES)
ATTENTION = AttentionOptions(name="attention", heads=2, key_size=3, **VALUES)
MATCHING = MatchingOptions(name="matching", match_channels=[4, 6], key_size=5, **VALUES)
OWN_CONVOLUTIONS = {"match_kernels": [3, 2], "match_strides": [2, 2]}
IMAGE = gym.spaces.Box(0, 255, (12, 14, 3), np.uint8)
TEXT = gym.spaces.Box(0, 9, (4,), np.int64)
SPACE = gym.spaces.Dict(image=IMAGE, instruction=TEXT)


def observations(n=3):
    SPACE.seed(0)
    samples = [SPACE.sample() for _ in range(n)]
    return {name: torch.from_numpy(np.stack([s[name] for s in samples])) for name in SPACE}


def built(options):
    torch.manual_seed(0)
    encoder = Encoder(SPACE, options)
    return encoder, *encoder.encoders


def convolved(convolution, seen):
    """One image [C, H, W] without padding, place by place."""
    kernel, stride = convolution.weight.shape[-1], convolution.stride[0]
    rows, columns = ((side - kernel) // stride + 1 for side in seen.shape[1:])
    out = torch.zeros(convolution.out_channels, rows, columns)
    for r in range(rows):
        for c in range(columns):
            patch = seen[:, r * stride : r * stride + kernel, c * stride : c * stride + kernel]
            out[:, r, c] = (convolution.weight * patch).sum((1, 2, 3)) + convolution.bias
    return out


def scaled(image, normalise):
    """One image [H, W, C] as [C, H, W]."""
    image = image.permute(2, 0, 1)
    return image / 255 * 2 - 1 if normalise else image / 255


def found_by(convolutions, image, normalise):
    """What convolutions without padding find in one image [H, W, C], a ReLU behind each."""
    seen = scaled(image, normalise)
    for convolution in convolutions:
        seen = convolved(convolution, seen).clamp(min=0)
    return seen


def dense(network, features, normalise):
    """The dense layer of a network, on one vector."""
    outputs = network.dense[0](features)
    if normalise:
        norm, spread = network.dense[1], outputs.var(correction=0) + 1e-5
        outputs = (outputs - outputs.mean()) / spread.sqrt() * norm.weight + norm.bias
    return outputs.clamp(min=0)


@pytest.mark.parametrize("normalise", [False, True])
@torch.no_grad()
def test_film_is_its_definition(normalise):
    encoder, network, reader = built(FILM.model_copy(update={"normalise": normalise}))
    for modulation in network.modulations:
        torch.nn.init.normal_(modulation.weight)
        torch.nn.init.normal_(modulation.bias)
    given = observations()
    told, encoded = reader(given["instruction"]), encoder(given)
    assert encoded.shape == (3, 7 + 32) == (3, encoder.size)
    for n in range(3):
        seen = scaled(given["image"][n], normalise)
        for convolution, modulation in zip(network.convolutions, network.modulations, strict=True):
            numbers = modulation(told[n])
            seen = convolved(convolution, seen)
            for channel in range(len(seen)):
                scale, shift = numbers[channel], numbers[len(seen) + channel]
                seen[channel] = ((1 + scale) * seen[channel] + shift).clamp(min=0)
        expected = dense(network, seen.flatten(), normalise)
        torch.testing.assert_close(encoded[n, :7], expected)
        torch.testing.assert_close(encoded[n, 7:], told[n])


@torch.no_grad()
def test_film_begins_as_the_shallow_network():
    encoder, network, _ = built(FILM)
    _, plain, _ = built(SHALLOW)
    for mine, other in zip(
        [*network.convolutions, network.dense[0]],
        [m for m in plain.layers if hasattr(m, "weight")],
        strict=True,
    ):
        mine.load_state_dict(other.state_dict())
    given = observations()
    torch.testing.assert_close(encoder(given)[:, :7], plain(given["image"]))


@pytest.mark.parametrize("normalise", [False, True])
@torch.no_grad()
def test_attention_is_its_definition(normalise):
    encoder, network, reader = built(ATTENTION.model_copy(update={"normalise": normalise}))
    given = observations()
    told, encoded = reader(given["instruction"]), encoder(given)
    for n in range(3):
        seen = found_by(network.convolutions, given["image"][n], normalise)
        places = seen.flatten(1).T
        found, weights = [], []
        for head in range(2):
            query = network.query(told[n])[3 * head : 3 * head + 3]
            scores = torch.stack([query @ network.key(place) / 3**0.5 for place in places])
            shares = scores.exp() / scores.exp().sum()
            found.append(sum(share * place for share, place in zip(shares, places, strict=True)))
            weights.append(shares)
        parts = torch.cat([seen.flatten(), *found, *weights])
        expected = dense(network, parts, normalise)
        torch.testing.assert_close(encoded[n, :7], expected, atol=1e-5, rtol=1e-4)


def padded(seen):
    return torch.nn.functional.pad(seen, (1, 1, 1, 1))


def scores_of(matcher, image, words, normalise):
    """The scores of one image [H, W, C] and one instruction [L], place by place."""
    *strided, last = matcher.convolutions
    seen = found_by(strided, image, normalise)
    seen = convolved(last, padded(seen)).clamp(min=0)
    (table,) = matcher.words
    query = matcher.query + sum(table.weight[word] for word in words if word > 0)
    scores = []
    for place in seen.flatten(1).T:
        key = matcher.key(place)
        cosine = key @ query / (key.norm() * query.norm())
        scores.append(matcher.sharpness.exp() * cosine + matcher.offset(place)[0])
    return torch.stack(scores)


@pytest.mark.parametrize(
    ("normalise", "own", "rows", "columns"),
    [(False, {}, 3, 4), (True, {}, 3, 4), (False, OWN_CONVOLUTIONS, 2, 3)],
)
@torch.no_grad()
def test_matching_is_its_definition(normalise, own, rows, columns):
    encoder, network, _ = built(MATCHING.model_copy(update={"normalise": normalise, **own}))
    given = observations()
    network.matcher.words[0].weight[1:].normal_()
    told, encoded = given["instruction"], encoder(given)
    for n in range(3):
        seen = found_by(network.convolutions, given["image"][n], normalise)
        scores = scores_of(network.matcher, given["image"][n], told[n], normalise)
        weights = scores.exp() / scores.exp().sum()
        x = sum(weights[i] * (2 * (i % columns) / (columns - 1) - 1) for i in range(rows * columns))
        y = sum(weights[i] * (2 * (i // columns) / (rows - 1) - 1) for i in range(rows * columns))
        mean = (weights * scores).sum()
        parts = torch.cat([seen.flatten(), scores / 4, torch.stack([x, y, mean / 4])])
        torch.testing.assert_close(
            encoded[n, :7], dense(network, parts, normalise), atol=1e-5, rtol=1e-4
        )
    asked = {"instruction": given["instruction"][:2]}
    matches = encoder.match(given, asked)
    for n in range(3):
        for g in range(2):
            scores = scores_of(network.matcher, given["image"][n], told[g], normalise)
            torch.testing.assert_close(matches[n, :, g], scores)


def test_places_are_where_the_matcher_reads():
    """A change of pixels around a place's centre changes its scores, and those of places further
    than a receptive field away stay."""
    encoder, _, _ = built(MATCHING)
    given = observations()
    height, width = given["image"].shape[1:3]
    before = encoder.match(given, {"instruction": given["instruction"]})
    places = encoder.places()
    assert len(places) == before.shape[1] == 12
    reach = {side: 0.0 for side in ("down", "across")}
    for r in range(height):
        for c in range(width):
            changed = given["image"].clone()
            changed[:, r, c] = 255 - changed[:, r, c]
            after = encoder.match(
                {**given, "image": changed}, {"instruction": given["instruction"]}
            )
            moved = (after != before).any(2).any(0)
            for place in places[moved]:
                reach["down"] = max(reach["down"], abs(place[0].item() * height - r - 0.5))
                reach["across"] = max(reach["across"], abs(place[1].item() * width - c - 0.5))
    # Kernels 4 and 3, strides 2 and 1, then 3 x 3: 12 pixels, half of them on either side.
    assert reach == pytest.approx({"down": 5.5, "across": 5.5})


@torch.no_grad()
def test_the_instruction_can_be_left_to_the_matcher():
    encoder, _, _ = built(MATCHING)
    encoder.reader("image").matcher.words[0].weight.normal_()
    alone, network = built(MATCHING.model_copy(update={"remember_instruction": False}))
    network.load_state_dict(encoder.reader("image").state_dict())
    given = observations()
    assert encoder.size - alone.size == 32
    # The image comes first and the instruction last.
    torch.testing.assert_close(alone(given), encoder(given)[:, : alone.size])
    other = {**given, "instruction": given["instruction"].roll(1, 0)}
    assert not torch.allclose(alone(other), alone(given))


def test_a_fixed_matcher_learns_nothing():
    encoder, network, _ = built(MATCHING.model_copy(update={"matcher": "fixed"}))
    encoder(observations()).square().sum().backward()
    fixed = set(network.matcher.parameters())
    for name, parameter in encoder.named_parameters():
        assert (parameter.grad is None) == (parameter in fixed), name


def test_a_matcher_does_not_read_words_that_it_has_not_learned():
    """Wherever in the text they are. Those of its instructions it learns."""
    _, network, _ = built(MATCHING)
    given = observations()
    given["instruction"] = torch.tensor([[3, 0, 0, 0], [4, 1, 0, 0], [1, 3, 0, 0]])
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
    for _ in range(10):
        optimiser.zero_grad()
        network(given["image"], [given["instruction"]]).sum().backward()
        optimiser.step()
    (table,) = network.matcher.words
    assert table.weight.any(1).tolist() == [word in (1, 3, 4) for word in range(10)]
    texts = torch.tensor([[3, 0, 0, 0], [5, 2, 3, 0], [9, 3, 7, 5], [4, 0, 0, 0]])
    alone, *among, other = network.matcher._queries([texts])
    for query in among:
        torch.testing.assert_close(query, alone)
    assert not torch.allclose(other, alone)


@pytest.mark.parametrize(
    "options", [FILM, ATTENTION, MATCHING], ids=["film", "attention", "matching"]
)
def test_the_instruction_changes_what_is_read_of_the_image(options):
    """Every parameter learns, and in bfloat16, too; without an instruction there is an error."""
    encoder, network, _ = built(options)
    given = observations()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.5)
    with torch.autocast("cpu", torch.bfloat16, enabled=options is FILM):
        encoded = encoder(given)
    encoded.float().square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.any(), name
    others = given | {"instruction": given["instruction"].flip(0)}
    changed = encoder(others)[0, :7]
    assert not torch.equal(changed, encoder(given)[0, :7])
    with pytest.raises(ValueError, match="by an instruction, and the observations have none"):
        Encoder(gym.spaces.Dict(image=IMAGE), options)
    assert encoder.compile_images(fixed=False) == 1
