"""Random network distillation: its bonus, its statistics and its state."""

from copy import deepcopy

import gymnasium as gym
import noise
import numpy as np
import pytest
import torch
from conftest import assert_equal

from zipf.experiments.building import checkpoint
from zipf.experiments.hooks.rnd import LARGEST_INPUT, RNDBonus, RNDOptions, Statistics

OPTIONS = RNDOptions(
    name="rnd",
    scale=0.5,
    hidden=32,
    features=16,
    image_side=12,
    learned_share=0.5,
    batch_size=16,
    learning_rate=1e-3,
    discount=0.9,
)
EVERYTHING = noise.SPACES["everything"]
N = 8


def samples(space, count, seed):
    """Observations [count, ...] drawn from a space."""
    space.seed(seed)
    drawn = [space.sample() for _ in range(count)]
    return {
        name: np.stack([np.asarray(one[name], part.dtype) for one in drawn])
        for name, part in space.items()
    }


EVERY = np.ones(N, np.bool_)


@pytest.mark.parametrize("name", noise.SPACES)
def test_any_observation_has_a_bonus(name):
    space = noise.SPACES[name]
    bonus = RNDBonus(OPTIONS, space, seed=0)
    for seed in range(5):
        result = bonus(samples(space, N, seed), EVERY)
        assert result.dtype == torch.float32
        assert result.shape == (N,)
        assert np.isfinite(result).all()
        assert (result > 0).all()


LARGE = [name for name in noise.SPACES if name not in ("a number", "a code from 3")]


@pytest.mark.parametrize("name", LARGE)  # too large for eight samples to have all there is
def test_what_repeats_becomes_known_and_what_is_new_does_not(name):
    space = noise.SPACES[name]
    bonus = RNDBonus(OPTIONS, space, seed=0)
    seen, new = samples(space, N, 0), samples(space, N, 1)
    differs = np.array(
        [
            not any(all(np.array_equal(new[k][i], seen[k][j]) for k in seen) for j in range(N))
            for i in range(N)
        ]
    )
    first = [bonus(seen, EVERY) for _ in range(5)][-1]
    for _ in range(300):
        last = bonus(seen, EVERY)
    assert last.mean() < 0.2 * first.mean()
    assert bonus(new, EVERY)[differs].mean() > 2 * last.mean()


def test_masked_observations_leave_no_trace():
    one, other = (RNDBonus(OPTIONS, EVERYTHING, seed=0) for _ in range(2))
    mask = np.arange(N) % 3 == 0
    for seed in range(8):
        seen, noise_of_others = samples(EVERYTHING, N, seed), samples(EVERYTHING, N, 100 + seed)
        shown = {
            name: np.where(mask.reshape(-1, *[1] * (part.ndim - 1)), part, noise_of_others[name])
            for name, part in seen.items()
        }
        result = one(seen, mask)
        np.testing.assert_array_equal(result, other(shown, mask))
        assert not result[~mask].any()
        assert (result[mask] > 0).all()
        assert not one(seen, np.zeros(N, np.bool_)).any()
    assert_equal(one.state_dict(), other.state_dict())


def test_statistics_equal_those_of_all_rows():
    rng = np.random.default_rng(0)
    rows = rng.normal(3, 2, size=(40, 5))
    statistics = Statistics(5)
    for part in np.split(rows, [1, 7, 30]):
        statistics.update(part)
    # One row of mean 0 and variance 1 before them is two rows of -1 and 1 with half the weight.
    weights = np.concatenate([[0.5, 0.5], np.ones(40)])[:, None]
    every = np.concatenate([-np.ones((1, 5)), np.ones((1, 5)), rows])
    mean = (weights * every).sum(0) / 41
    variance = (weights * (every - mean) ** 2).sum(0) / 41
    np.testing.assert_allclose(statistics.now()[0], mean)
    np.testing.assert_allclose(statistics.now()[1] ** 2, variance)


def test_the_bonus_equals_the_definition():
    """With networks that do not learn: inputs and errors are normalised as NumPy does it."""
    options = OPTIONS.model_copy(update={"learning_rate": 1e-30})
    space = gym.spaces.Dict(x=gym.spaces.Box(-np.inf, np.inf, (3,), np.float32))
    bonus = RNDBonus(options, space, seed=0)
    rng = np.random.default_rng(0)
    seen, sums, total = [np.array([-1.0] * 3), np.array([1.0] * 3)], [-1.0, 1.0], np.zeros(N)
    for step in range(20):
        x = rng.normal([1, -2, 0], [0.1, 3, 1], size=(N, 3)).astype(np.float32)
        x[0, 2] = 100.0 if step == 19 else x[0, 2]  # beyond what is not clipped
        result = bonus({"x": x}, EVERY)
        seen.extend(x.astype(np.float64))
        weights = np.concatenate([[0.5, 0.5], np.ones(len(seen) - 2)])
        mean = np.average(seen, 0, weights)
        normal = (x - mean) / np.sqrt(np.average((seen - mean) ** 2, 0, weights))
        assert (abs(normal) > LARGEST_INPUT).any() or step < 19
        clipped = torch.tensor(normal.clip(-5, 5), dtype=torch.float32)
        with torch.no_grad():
            error = (bonus.predictor(clipped) - bonus.target(clipped)).numpy() ** 2
        total = 0.9 * total + error.mean(-1)
        sums.extend(total)
        middle = np.average(sums, 0, weights)
        deviation = np.sqrt(np.average((sums - middle) ** 2, 0, weights))
        np.testing.assert_allclose(result, 0.5 * error.mean(-1) / deviation, rtol=1e-3)


def test_images_are_averaged_down():
    """To at most 12 pixels a side; squares of 3 x 3 of 36 x 32 pixels, the last of 3 x 2."""
    image = np.random.default_rng(0).integers(256, size=(N, 36, 32, 3), dtype=np.uint8)
    space = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (36, 32, 3), np.uint8))
    rows = np.array([1, 4, 5])
    read = RNDBonus(OPTIONS, space, seed=0)._read({"image": image}, rows).numpy()
    assert read.shape == (3, 12 * 11 * 3)
    for found, i in zip(read.reshape(3, 12, 11, 3), rows, strict=True):
        for y in range(12):
            for x in range(11):
                square = image[i, 3 * y : 3 * y + 3, 3 * x : 3 * x + 3] / 255
                np.testing.assert_allclose(found[y, x], square.mean((0, 1)), rtol=1e-5)


def test_one_share_is_learned_from_in_batches():
    bonus = RNDBonus(OPTIONS, EVERYTHING, seed=0)
    before = deepcopy(bonus.predictor.state_dict())
    learned = 0
    for seed in range(100):
        bonus(samples(EVERYTHING, N, seed % 10), EVERY)
        same = all(torch.equal(a, before[name]) for name, a in bonus.predictor.state_dict().items())
        steps = int(bonus.optimiser.state_dict()["state"].get(0, {"step": 0})["step"])
        assert same == (steps == 0)
        learned = 16 * steps + len(bonus.waiting)
        assert len(bonus.waiting) < 16
    assert abs(learned - 0.5 * 100 * N) < 4 * np.sqrt(100 * N) / 2


def test_what_a_batch_leaves_over_is_learned_from_later():
    options = OPTIONS.model_copy(update={"learned_share": 1.0, "batch_size": 2 * N - 3})
    bonus = RNDBonus(options, EVERYTHING, seed=0)
    for seed in range(2):
        bonus(samples(EVERYTHING, N, seed), EVERY)
    last = bonus._read(samples(EVERYTHING, N, 1), np.arange(N))
    mean, deviation = (torch.from_numpy(x).float() for x in bonus.inputs.now())
    normal = ((last - mean) / deviation).clamp(-5, 5)
    assert torch.equal(bonus.waiting, normal[-3:])
    assert all(weight.grad is None for weight in bonus.target.parameters())


@pytest.mark.parametrize(("height", "places"), [(11, 11), (12, 12), (13, 7), (24, 12), (25, 9)])
def test_images_are_read_at_most_as_large_as_the_options_say(height, places):
    space = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (height, 5, 1), np.uint8))
    bonus = RNDBonus(OPTIONS.model_copy(update={"image_side": 12}), space, seed=0)
    square = -(-height // 12)
    assert bonus.waiting.shape[1] == places * -(-5 // square)


def test_state_dict_continues_bit_for_bit(tmp_path):
    """Also through a file, from which a collector gets arrays."""
    one = RNDBonus(OPTIONS, EVERYTHING, seed=0)
    for seed in range(10):
        one(samples(EVERYTHING, N, seed), EVERY)
    assert len(one.waiting)
    checkpoint.save(tmp_path / "state.pt", one.state_dict())
    others = [RNDBonus(OPTIONS, EVERYTHING, seed=1) for _ in range(2)]
    others[0].load_state_dict(deepcopy(one.state_dict()))
    others[1].load_state_dict(checkpoint.arrays(checkpoint.load(tmp_path / "state.pt")))
    for seed in range(10, 18):
        expected = one(samples(EVERYTHING, N, seed), EVERY)
        for other in others:
            np.testing.assert_array_equal(other(samples(EVERYTHING, N, seed), EVERY), expected)
    for other in others:
        assert_equal(other.state_dict(), one.state_dict())


def test_a_state_stays_as_it_was_taken():
    bonus = RNDBonus(OPTIONS, EVERYTHING, seed=0)
    bonus(samples(EVERYTHING, N, 0), EVERY)
    taken = bonus.state_dict()
    before = deepcopy({name: taken[name] for name in ("sum", "waiting")})
    bonus(samples(EVERYTHING, N, 1), EVERY)
    assert_equal({name: taken[name] for name in before}, before)


def test_weights_begin_orthogonal_and_biases_at_zero():
    """As in the code of Burda et al. 2019: W W^T or W^T W is twice the identity."""
    bonus = RNDBonus(OPTIONS, EVERYTHING, seed=0)
    for network in (bonus.target, bonus.predictor):
        layers = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
        for layer in layers:
            weight = layer.weight.detach()
            short = weight if weight.shape[0] <= weight.shape[1] else weight.T
            torch.testing.assert_close(short @ short.T, 2 * torch.eye(len(short)))
            assert not layer.bias.any()


def test_the_seed_chooses_what_is_learned_from():
    learned = []
    for seed in (0, 1):
        bonus = RNDBonus(OPTIONS.model_copy(update={"batch_size": 1000}), EVERYTHING, seed=seed)
        bonus(samples(EVERYTHING, N, 0), EVERY)
        learned.append(bonus.waiting)
    assert not torch.equal(*learned)


def test_the_seed_decides_and_other_draws_do_not():
    torch.manual_seed(0)
    one, again, other = (RNDBonus(OPTIONS, EVERYTHING, seed=seed) for seed in (0, 0, 1))
    drawn = torch.rand(1)
    torch.manual_seed(0)
    assert torch.equal(drawn, torch.rand(1))
    seen = samples(EVERYTHING, N, 0)
    results = [bonus(seen, EVERY) for bonus in (one, again, other)]
    np.testing.assert_array_equal(results[0], results[1])
    assert (results[0] != results[2]).all()
