"""Tensor environments: the self-check, what it finds, and what the gridworld's have in addition."""

import numpy as np
import pytest
import torch
from fake_cuda import DEVICE, capture_safe, fake_cuda

from zipf import envs
from zipf.envs.distributions import by_name
from zipf.envs.gridworld.tensor import GridworldTensorEnv
from zipf.envs.splits import Split, SplitLevel
from zipf.envs.tensor import Stepped
from zipf.envs.testing import check_tensor_env
from zipf.experiments.hooks.kernels import add_hashes

OTHER_SIZES = {"num_maps": 5, "num_rooms": [2, 4], "room_size": [2, 5], "num_objects": 7}


def both(level="zipf_2", n=6, tensor=GridworldTensorEnv, **options):
    """A tensor environment, and a batch with what `check_tensor_env` compares in addition."""
    batch = envs.make_vec(f"gridworld/{level}", n, **options)
    more = {
        "goal": envs.goal(f"gridworld/{level}", batch),
        "symmetries": envs.symmetries(envs.split("gridworld"), batch),
    }
    return tensor(n, level, device="cpu", **options), batch, more


def shown(n=64, seed=0, **options):
    """Codes of envs after some steps, and what a batch of the same situations shows."""
    tensor, batch, more = both("uniform", n, **options)
    rng = np.random.default_rng(seed)
    ranks = {name: rng.integers(size, size=n) for name, size in tensor.situation.items()}
    observation, _ = batch.reset(seed=seed, options=ranks)
    tensor.reset(seed)
    tensor.begin(torch.ones(n, dtype=torch.bool), torch.tensor(np.stack(list(ranks.values()))))
    walking = np.ones(n, np.bool_)
    for _ in range(4):
        actions = rng.integers(8, size=n)
        observation, _, terminated, truncated, _ = batch.step(actions)
        tensor.step(torch.tensor(actions))
        walking &= ~(terminated | truncated)
    codes = {name: part[torch.tensor(walking)] for name, part in tensor.observe().items()}
    return tensor, codes, {k: part[walking] for k, part in observation.items()}, more["symmetries"]


@pytest.mark.parametrize(
    ("level", "options"),
    [
        ("zipf_2", {}),
        ("zipf_0.5", {}),
        ("uniform", {}),
        ("rare", {}),
        ("validation", OTHER_SIZES),
        ("fresh", {}),
        ("zipf_2", {"observation": "tiles"}),
        ("uniform", OTHER_SIZES),
        ("fresh", {**OTHER_SIZES, "observation": "tiles"}),
        ("uniform", {"max_steps": 1}),
        ("zipf_1", {"max_steps": 2}),
        ("uniform", {"num_maps": 1, "num_rooms": [1, 1], "num_objects": 1, "max_steps": 20}),
    ],
)
def test_it_is_the_batch_on_a_device(level, options):
    tensor, batch, more = both(level, **options)
    counts = check_tensor_env(tensor, batch, steps=150, **more)
    assert counts["achieved"] > 0


class WrongReward(GridworldTensorEnv):
    def step(self, action):
        stepped = super().step(action)
        return stepped._replace(reward=stepped.terminated.float())


class LastObservationIsOfTheNextEpisode(GridworldTensorEnv):
    def step(self, action):
        return super().step(action)._replace(final=self.observe())


class NothingForced(GridworldTensorEnv):
    def begin(self, mask, forced=None):
        super().begin(mask)


class BeginsEverywhere(GridworldTensorEnv):
    def begin(self, mask, forced=None):
        super().begin(torch.ones_like(mask), forced)


class OneBuffer(GridworldTensorEnv):
    def observe(self):
        if not hasattr(self, "kept"):
            self.kept = super().observe()
        for name, part in super().observe().items():
            self.kept[name].copy_(part)
        return self.kept


class Rebinds(GridworldTensorEnv):
    def step(self, action):
        self._length = self._length.clone()
        return super().step(action)


class NeverTruncates(GridworldTensorEnv):
    def step(self, action):
        stepped = super().step(action)
        return stepped._replace(truncated=torch.zeros_like(stepped.truncated))


class AchievesWhatWasAsked(GridworldTensorEnv):
    def step(self, action):
        stepped = super().step(action)
        if self._reports_achieved:
            stepped.outcome["achieved"] = stepped.final["cue"]
        return stepped


class TurnsOtherwise(GridworldTensorEnv):
    def decode(self, codes, symmetry=None):
        return super().decode(codes, None if symmetry is None else symmetry ^ 1)


class WritesGoalsInPlace(GridworldTensorEnv):
    def write_goal(self, codes, goals):
        codes["cue"].copy_(goals)
        return dict(codes)


class ForgetsTheGenerator(GridworldTensorEnv):
    def set_state(self, state):
        super().set_state({**state, "generator": self.generator.get_state()})


class HashesCodes(GridworldTensorEnv):
    def hashes(self, weights):
        super().hashes(weights)
        return lambda codes: codes["tiles"].long().sum((-2, -1))


class WrongDtype(GridworldTensorEnv):
    def step(self, action):
        stepped = super().step(action)
        return stepped._replace(reward=stepped.reward.double())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (WrongReward, "'reward', of envs"),
        (LastObservationIsOfTheNextEpisode, "the decoded last observation"),
        (NothingForced, "the decoded observation"),
        (BeginsEverywhere, "an episode has not ended after"),
        (OneBuffer, "the decoded observation"),
        (Rebinds, "written in place"),
        (NeverTruncates, "max_steps is 20, and an episode has not ended after [2-6]"),
        (AchievesWhatWasAsked, "the goal achieved"),
        (TurnsOtherwise, "under symmetries"),
        (WritesGoalsInPlace, "codes, after write_goal"),
        (ForgetsTheGenerator, "set_state"),
        (HashesCodes, "hashes differs"),
        (WrongDtype, "reward must be torch.float32"),
    ],
)
def test_the_check_finds(wrong, message):
    tensor, batch, more = both(tensor=wrong, max_steps=20)
    with pytest.raises(AssertionError, match=message):
        check_tensor_env(tensor, batch, steps=60, **more)


def test_the_check_finds_another_level():
    tensor, batch, _ = both(max_steps=20)
    with pytest.raises(AssertionError, match="single_observation_space differs"):
        check_tensor_env(tensor, envs.make_vec("gridworld/zipf_2", 6, observation="tiles"))
    with pytest.raises(AssertionError, match="'truncated', of envs"):
        check_tensor_env(tensor, envs.make_vec("gridworld/zipf_2", 6, max_steps=19), steps=60)
    with pytest.raises(AssertionError, match="check with more steps"):
        check_tensor_env(tensor, batch, steps=2)


@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_every_symmetry_shows_what_the_drawn_observation_becomes(observation):
    tensor, codes, observed, symmetries = shown(observation=observation)
    n = len(codes["cue"])
    assert n > 20
    which = np.repeat(np.arange(symmetries.count)[:, None], n, 1)
    every = {name: part.expand(symmetries.count, *part.shape) for name, part in codes.items()}
    decoded = tensor.decode(every, torch.tensor(which))
    for k in range(symmetries.count):
        expected = {name: part.copy() for name, part in observed.items()}
        symmetries(expected, which[k], np.ones(n, np.bool_))
        for name, part in expected.items():
            np.testing.assert_array_equal(decoded[name][k].numpy(), part, f"symmetry {k}")
    assert len(decoded[observation].flatten(2)[:, 0].unique(dim=0)) == symmetries.count


@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_codes_may_have_any_leading_axes(observation):
    tensor, codes, observed, _ = shown(observation=observation)
    for axes in ([], [1], [2, 3], [1, 2, 3]):
        some = torch.arange(int(np.prod(axes))).reshape(axes)
        decoded = tensor.decode({name: part[some] for name, part in codes.items()})
        for name, part in observed.items():
            np.testing.assert_array_equal(decoded[name].numpy(), part[some.numpy()], strict=True)


@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_hashes_are_those_of_the_kernel(observation):
    tensor, codes, observed, _ = shown(observation=observation)
    rng = np.random.default_rng(1)
    hashes = np.zeros(len(codes["cue"]), np.uint64)
    weights = {}
    for name, part in observed.items():
        flat = part.reshape(len(part), -1)
        one = rng.integers(2**64, size=flat.shape[1], dtype=np.uint64)
        weights[name] = torch.from_numpy(one.view(np.int64))
        add_hashes(flat, one, np.ones(len(part), np.bool_), hashes)
    hashed = tensor.hashes(weights)(codes)
    np.testing.assert_array_equal(hashed.numpy().view(np.uint64), hashes)


@pytest.mark.parametrize("level", ["zipf_2", "uniform", "rare", "validation"])
def test_ranks_follow_the_law(level):
    n = 40_000
    tensor = GridworldTensorEnv(n, level, device="cpu", max_steps=1, observation="tiles")
    tensor.reset(seed=0)
    first = ranks_of(tensor.step(torch.zeros(n, dtype=torch.int64)))
    again = ranks_of(tensor.step(torch.zeros(n, dtype=torch.int64)))  # as the step began them
    p = by_name(level)(20)
    for map, target in (first, again):
        # Sums of squares beyond these have a probability of 1e-4.
        assert chi_square(np.bincount(map, minlength=20), n * p) < 55
        assert chi_square(np.bincount(target, minlength=20), n * p) < 55
        joint = np.bincount(map * 20 + target, minlength=400)
        likely = n * np.outer(p, p).ravel() >= 5
        assert chi_square(joint[likely], (n * np.outer(p, p).ravel())[likely]) < 513
        if level == "zipf_2":
            assert chi_square(np.bincount(map, minlength=20), n * by_name("zipf_1.9")(20)) > 55
    assert not np.array_equal(first, again)
    likely = p > 1 / 30
    assert (np.bincount(first[0][first[0] == again[0]], minlength=20)[likely] > 0).all()


def ranks_of(stepped: Stepped):
    return stepped.outcome["map"].numpy(), stepped.outcome["target"].numpy()


def chi_square(counts, expected):
    assert counts[expected == 0].sum() == 0
    possible = expected > 0
    return (np.square(counts - expected)[possible] / expected[possible]).sum()


def test_as_much_is_drawn_for_any_mask_and_forced_ranks():
    forced = torch.zeros(2, 5, dtype=torch.int64)
    after = []
    for mask, ranks in ((True, None), (False, None), (True, forced), (False, forced)):
        tensor = GridworldTensorEnv(5, device="cpu")
        tensor.reset(3)
        before = tensor.get_state()
        tensor.begin(torch.full((5,), mask), ranks)
        state = tensor.get_state()
        assert not torch.equal(state["generator"], before["generator"])
        if not mask:
            assert all(torch.equal(state[name], before[name]) for name in tensor.tensors())
        after.append(state["generator"])
    assert all(torch.equal(one, after[0]) for one in after)


def test_a_seed_says_what_is_drawn():
    def ranks(seed):
        tensor = GridworldTensorEnv(50, "uniform", device="cpu", max_steps=1)
        tensor.reset(seed)
        return np.stack(ranks_of(tensor.step(torch.zeros(50, dtype=torch.int64))))

    np.testing.assert_array_equal(ranks(1), ranks(1))
    assert (ranks(1) != ranks(2)).any()


@pytest.mark.parametrize("options", [{}, {"observation": "tiles"}, OTHER_SIZES])
def test_nothing_is_read_on_the_host(options):
    with fake_cuda():
        tensor = GridworldTensorEnv(6, device=DEVICE, **options)
        tensor.report_achieved()
        weights = {
            name: torch.zeros(int(np.prod(space.shape)), dtype=torch.int64, device=DEVICE)
            for name, space in tensor.single_observation_space.items()
        }
        hashed = tensor.hashes(weights)
        zeros = torch.zeros(6, dtype=torch.int64, device=DEVICE)
        mask, forced = zeros == 1, torch.zeros(2, 6, dtype=torch.int64, device=DEVICE)
        with capture_safe():
            stepped = tensor.step(zeros)
            tensor.begin(mask)
            tensor.begin(mask, forced)
            codes = tensor.observe()
            decoded = tensor.decode(codes, zeros)
            tensor.decode(tensor.write_goal(codes, tensor.read_goal(stepped.final)))
            hashed(codes)
        for name, space in tensor.single_observation_space.items():
            assert decoded[name].shape == (6, *space.shape)
        assert stepped.outcome["achieved"].shape == tensor.read_goal(codes).shape == (6, 1)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"place": 0}, "an agent in a wall"),  # of the padding
        ({"place": -1}, "a place out of range"),
        ({"place": 10**9}, "a place out of range"),
        ({"situation": 400}, "a situation out of range"),
        ({"situation": -1}, "a situation out of range"),
        ({"situation": 399}, "an agent on another map"),
        ({"length": -1}, "lengths of episodes"),
    ],
)
def test_damaged_states_are_refused(changed, message):
    tensor = GridworldTensorEnv(3, device="cpu")
    tensor.reset(0)
    before = tensor.get_state()
    state = {name: one.clone() for name, one in before.items()}
    for name, value in changed.items():
        state[name][1] = value
    with pytest.raises(ValueError, match=message):
        tensor.set_state(state)
    for name, one in tensor.get_state().items():
        assert torch.equal(one, before[name])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"more": torch.zeros(3)}, "a state has the keys"),
        ({"length": [0, 0, 0]}, "state 'length' must be a tensor, got a list"),
        ({"length": torch.zeros(3)}, r"must be torch.int64 \(3,\), got torch.float32 \(3,\)"),
        ({"generator": torch.zeros(16, dtype=torch.uint8)}, r"state 'generator' must be .*\(16,\)"),
    ],
)
def test_states_of_another_kind_are_refused(changed, message):
    tensor = GridworldTensorEnv(3, device="cpu")
    state = tensor.get_state()
    with pytest.raises(ValueError, match="the state is damaged: "):
        tensor.set_state({**state, "generator": torch.zeros_like(state["generator"])})
    with pytest.raises(ValueError, match=message):
        tensor.set_state({**tensor.get_state(), **changed})


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((0,), {}, "num_envs must be at least 1"),
        ((1, "zipf"), {}, "unknown level 'zipf'"),
        ((1,), {"max_steps": 0}, "max_steps must be at least 1"),
        ((1,), {"device": "no"}, "device must be one that PyTorch has here, .* got 'no'"),
        ((1,), {"device": None}, "device must be one that PyTorch has here, .* got None"),
    ],
)
def test_wrong_arguments(arguments, options, message):
    with pytest.raises(ValueError, match=message) as error:
        GridworldTensorEnv(*arguments, **{"device": "cpu", **options})
    assert "\n" not in str(error.value)


def test_wrong_weights_and_seeds():
    tensor = GridworldTensorEnv(3, device="cpu")
    with pytest.raises(ValueError, match=r"weights must have the names \['image'\], got \['a'\]"):
        tensor.hashes({"a": torch.zeros(3)})
    with pytest.raises(ValueError, match=r"int64 \(11907,\) on cpu, got torch.float32 \(3,\)"):
        tensor.hashes({"image": torch.zeros(3)})
    with pytest.raises(ValueError, match="seed must be at most"):
        tensor.reset(2**63)


def test_which_splits_have_tensor_environments():
    for name, split in envs.all_splits().items():
        assert envs.has_tensor(split) == name.startswith("gridworld")
        if not envs.has_tensor(split):
            with pytest.raises(ValueError, match=r"has no tensor environments|plays one level"):
                envs.make_tensor(split, 2, "cpu")


def test_make_tensor():
    level = SplitLevel("gridworld/rare", options={"max_steps": 7})
    split = Split("s", level, "gridworld/uniform", "gridworld/rare")
    for one in (split, level):
        tensor = envs.make_tensor(one, 2, device="cpu", max_steps=9, observation="tiles")
        assert (tensor.max_steps, tensor.level.name) == (7, "rare")
        assert isinstance(tensor, envs.TensorEnv)
    with pytest.raises(ValueError, match="unknown gridworld option 'maxsteps'"):
        envs.make_tensor("gridworld/rare", 2, "cpu", maxsteps=3)
    with pytest.raises(ValueError, match="expected a level of gridworld, got 'playroom/lift/"):
        envs.make_tensor(envs.split("playroom_lift"), 2, "cpu")
    with pytest.raises(ValueError, match="the function GridworldTensorEnv"):
        envs.make_tensor(SplitLevel(GridworldTensorEnv), 2, "cpu")
    assert not envs.has_tensor(Split("s", GridworldTensorEnv, "gridworld/rare", "gridworld/rare"))
