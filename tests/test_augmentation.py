"""Augmentation: what it does to observations and actions, and that rules stay the same."""

import itertools

import gymnasium as gym
import numpy as np
import pytest
import torch
from test_collector import build

from zipf import envs
from zipf.agents.hindsight import AchievedOptions
from zipf.envs.gridworld.maps import MOVES
from zipf.envs.playroom.actions import ACTIONS, TURN_LEFT, TURN_RIGHT
from zipf.envs.policies import Teacher
from zipf.experiments.hooks.augmentation import Augmentation, RandomAugmentationOptions
from zipf.experiments.hooks.labels import Labels
from zipf.experiments.hooks.relabelling import Hindsight
from zipf.experiments.training.collector import Collector

IMAGE = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (6, 8, 3), np.uint8))
DECLARED = [family for family in envs.families().values() if family.symmetries is not None]
SPLITS = [split for family in DECLARED for split in family.splits]


def options(**changes):
    off = {"symmetries": False, "channels": False, "shift": 0, "cutout": 0}
    return RandomAugmentationOptions(name="random", **off | changes)


def everywhere(n):
    return np.ones(n, np.bool_)


def random_images(n, shape=(6, 8, 3)):
    return np.random.default_rng(0).integers(1, 256, (n, *shape), dtype=np.uint8)


@pytest.mark.parametrize("more", [{}, {"scale": [0.4, 2.5]}], ids=["as large", "scaled"])
def test_images_are_changed_as_the_options_say(more):
    """Each pixel by its definition; the envs outside of the mask as they were."""
    n = 40
    chosen = options(channels=True, shift=2, cutout=3, **more)
    augmentation = Augmentation(chosen, IMAGE, n, seed=0)
    augmentation.begin(everywhere(n))
    before, mask = random_images(n), np.arange(n) % 4 > 0
    image = before.copy()
    augmentation.observe({"image": image}, mask)
    state = augmentation.state_dict()
    assert np.array_equal(image[~mask], before[~mask])
    for i in np.flatnonzero(mask):
        down, right = state["shift"][i]
        top, left = (state["centre"][i] * (6, 8)).astype(int) - 1
        scale = state["scale"][i]
        for r, c, k in itertools.product(range(6), range(8), range(3)):
            if top <= r < top + 3 and left <= c < left + 3:
                assert image[i, r, c, k] == 0
            else:
                # From the image's centre, so many pixels times the scale are seen before the shift.
                row = np.clip(np.round((r - down - 2.5) / scale + 2.5), 0, 5).astype(int)
                column = np.clip(np.round((c - right - 3.5) / scale + 3.5), 0, 7).astype(int)
                assert image[i, r, c, k] == before[i, row, column, state["order"][i, k]]
    assert len(np.unique(state["order"], axis=0)) == 6
    assert set(state["shift"].ravel()) == {-2, -1, 0, 1, 2}
    least, largest = chosen.scale
    assert least <= state["scale"].min() <= state["scale"].max() <= largest
    assert (state["scale"] <= 1).mean() > 0.3  # on a logarithmic scale half of them


def test_draws_last_for_an_episode():
    augmentation = Augmentation(options(channels=True), IMAGE, 50, seed=0)
    augmentation.begin(everywhere(50))
    before = augmentation.state_dict()
    some = np.arange(50) < 25
    augmentation.begin(some)
    after = augmentation.state_dict()
    assert np.array_equal(after["order"][~some], before["order"][~some])
    assert not np.array_equal(after["order"][some], before["order"][some])
    other = Augmentation(options(channels=True), IMAGE, 50, seed=1)
    del after["scale"]  # as before images were scaled
    other.load_state_dict(after)
    for one in (augmentation, other):
        one.begin(everywhere(50))
    assert np.array_equal(other.state_dict()["order"], augmentation.state_dict()["order"])


@pytest.mark.parametrize("split", SPLITS, ids=lambda split: split.name)
def test_declared_symmetries_are_permutations_with_inverses(split):
    """The first is the identity, each has an inverse, and none is there twice. What a symmetry
    makes of an observation is an observation of the space."""
    env = envs.make_train(split, 3)
    symmetries = envs.symmetries(split, env)
    actions = symmetries.actions
    assert actions.shape == (symmetries.count, env.single_action_space.n)
    assert np.array_equal(np.sort(actions), np.tile(np.arange(actions.shape[1]), (len(actions), 1)))
    assert np.array_equal(actions[0], np.arange(actions.shape[1]))
    rows = {row.tobytes() for row in actions}
    for row in actions:
        assert np.argsort(row).tobytes() in rows
    seen = set()
    for which in range(symmetries.count):
        observation, _ = env.reset(seed=5)
        shown = {name: part.copy() for name, part in observation.items()}
        symmetries(shown, np.full(3, which), everywhere(3))
        assert all(space.contains(shown[k][0]) for k, space in env.single_observation_space.items())
        if which == 0:
            assert all(np.array_equal(shown[k], observation[k]) for k in shown)
        seen.add(b"".join(part.tobytes() for part in shown.values()))
    assert len(seen) == symmetries.count


@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_a_turned_gridworld_has_the_same_rules(observation):
    """Where the agent moves, what is in view moves against it, as in an env that is not turned,
    and the cue stays as it is."""
    n = 64
    env = envs.make_vec("gridworld/uniform", n, observation=observation)
    symmetries = envs.symmetries(envs.split("gridworld"), env)
    rng, moved = np.random.default_rng(0), 0
    which = rng.integers(symmetries.count, size=n)

    def cells(seen):
        shown = {name: part.copy() for name, part in seen.items()}
        symmetries(shown, which, everywhere(n))
        if observation == "tiles":
            assert (shown["tiles"][:, 0, 0] == 0).all()  # hidden, as in the envs
            return shown["tiles"].reshape(n, 7, 7, 1), shown["cue"]
        grid = shown["image"].reshape(n, 7, 9, 7, 9, 3).swapaxes(2, 3).reshape(n, 7, 7, -1)
        return grid, grid[:, 0, 0]

    before, cue = cells(env.reset(seed=0)[0])
    for _ in range(12):
        actions = rng.integers(8, size=n)
        worlds = symmetries.actions[which, actions]
        state = env.get_state()["worlds"][:, 2:]
        seen, _, terminated, truncated, _ = env.step(worlds)
        after, next_cue = cells(seen)
        stepped = env.get_state()["worlds"][:, 2:] - state
        went = (stepped == np.array(MOVES)[worlds]).all(1) & ~terminated & ~truncated
        for i in np.flatnonzero(went):
            assert np.array_equal(cue[i], next_cue[i])
            down, right = MOVES[actions[i]]
            for r, c in itertools.product(range(7), range(7)):
                corners = {(0, 0), (0, 6), (6, 0), (6, 6), (3, 3)}
                there = r + down, c + right
                # The corners hide something, and the agent stands in the middle.
                if {(r, c), there} & corners or not (0 <= there[0] < 7 and 0 <= there[1] < 7):
                    continue
                assert np.array_equal(after[i, r, c], before[i, *there])
            moved += 1
        before, cue = after, next_cue
    assert moved > 200


def test_what_is_turned_back_is_as_it_was():
    """But for the corners: in the gridworld one is hidden."""
    env = envs.make_vec("gridworld/uniform", 64)
    symmetries = envs.symmetries(envs.split("gridworld"), env)
    image = env.reset(seed=0)[0]["image"]
    turned = {"image": image.copy()}
    which = np.arange(64) % symmetries.count
    symmetries(turned, which, everywhere(64))
    board, picture = np.divmod(which, 4)
    boards = symmetries.actions[::4]
    back = np.array([(boards == row.argsort()).all(1).argmax() for row in boards])
    inverse = back[board] * 4 + -picture % 4
    symmetries(turned, inverse, everywhere(64))
    cells = np.ones((7, 7), np.bool_)
    cells[[0, 0, 6, 6], [0, 6, 0, 6]] = False
    cells[0, 0] = True
    pixels = np.kron(cells, np.ones((9, 9), np.bool_))
    assert np.array_equal(turned["image"][:, pixels], image[:, pixels])


def test_a_mirrored_playroom_is_turned_the_other_way():
    """Turning to the right in the mirror shows what turning to the left shows outside of it."""
    env, other = (envs.make_vec("playroom/lift/lift_shape_uniform", 4) for _ in range(2))
    symmetries = envs.symmetries(envs.split("playroom_lift"), env)
    which = np.ones(4, np.int64)
    for one in (env, other):
        one.reset(seed=0)
    image = env.step(symmetries.actions[which, TURN_RIGHT])[0]["image"]
    expected = other.step(np.full(4, TURN_LEFT))[0]["image"]
    assert np.array_equal(image, expected)
    shown = {"image": image.copy()}
    symmetries(shown, which, np.array([True, True, False, True]))
    assert np.array_equal(shown["image"][0], image[0, :, ::-1])
    assert np.array_equal(shown["image"][2], image[2])
    named = {ACTIONS[a]: ACTIONS[b] for a, b in enumerate(symmetries.actions[1])}
    assert named["GRAB_AND_SPIN_RIGHT"] == "GRAB_AND_SPIN_LEFT"
    assert named["LOOK_UP_MID"] == "LOOK_UP_MID"
    assert named["MOVE_LEFT_SLIGHTLY"] == "MOVE_RIGHT_SLIGHTLY"


def test_the_collector_shows_and_acts_through_the_augmentation():
    """A twin batch that is given the envs' actions shows, once augmented, what is in the unroll;
    labels and final observations are the agent's, too; saved and loaded it goes on alike."""
    n, steps = 16, 40
    env = envs.make_vec("gridworld/uniform", n, max_steps=7)
    split = envs.split("gridworld")

    def augmentation(seed):
        chosen = options(symmetries=True, channels=True)
        space, symmetries = env.single_observation_space, envs.symmetries(split, env)
        return Augmentation(chosen, space, n, seed=seed, symmetries=symmetries)

    first = augmentation(3)
    collector = Collector(
        env,
        build()[0],
        unroll_length=steps,
        seed=0,
        augmentation=first,
        hooks=[Labels(Teacher("expert", split, env), 0.0, first)],
    )
    twin = envs.make_vec("gridworld/uniform", n, max_steps=7)
    shown, expert = augmentation(3), envs.expert("gridworld/uniform", twin)
    observation, _ = twin.reset(seed=0)
    shown.begin(everywhere(n))
    unroll = collector.collect().steps
    for t in range(steps):
        expected = {"image": observation["image"].copy()}
        shown.observe(expected, everywhere(n))
        assert np.array_equal(unroll["observation", "image"][t].numpy(), expected["image"])
        assert np.array_equal(unroll["label"][t].numpy(), shown.from_envs(expert()))
        actions = unroll["action"][t].numpy()
        assert np.array_equal(shown.from_envs(shown.to_envs(actions)), actions)
        observation, reward, terminated, truncated, _ = twin.step(shown.to_envs(actions))
        assert np.array_equal(unroll["reward"][t].numpy(), reward)
        shown.begin(terminated | truncated)
    assert unroll["truncated"].any()

    state = collector.state_dict()
    following = collector.collect().steps.clone()
    collector.load_state_dict(state)
    assert torch.equal(
        collector.collect().steps["observation", "image"], following["observation", "image"]
    )


def test_what_cannot_be_augmented_is_refused():
    with pytest.raises(ValueError, match="declare no symmetries"):
        Augmentation(options(symmetries=True), IMAGE, 2, seed=0)
    codes = gym.spaces.Dict(codes=gym.spaces.MultiDiscrete([3, 3]))
    with pytest.raises(ValueError, match=r"shift: the observations have no image; choose 0"):
        Augmentation(options(shift=1), codes, 2, seed=0)
    with pytest.raises(ValueError, match="changes nothing"):
        Augmentation(options(), IMAGE, 2, seed=0)
    with pytest.raises(ValueError, match="should not be larger"):
        options(scale=[2, 1])


def test_hindsight_relabels_what_the_augmentation_shows():
    """A relabelled episode is what an env that was asked for what it achieved would have shown,
    through the augmentation of the episode."""
    n, steps = 6, 40
    split, env = envs.split("gridworld"), envs.make_vec("gridworld/uniform", n)
    chosen = options(symmetries=True, channels=True)
    space, symmetries = env.single_observation_space, envs.symmetries(split, env)
    augmentation = Augmentation(chosen, space, n, seed=3, symmetries=symmetries)
    relabelling = AchievedOptions(
        name="achieved", episodes=100, length=None, kept_per_goal=None, reward=1.0,
        advantage="none", policy_cost=1.0, value_cost=0.0, fade=None,
    )  # fmt: skip
    goal = envs.goal("gridworld/uniform", env)
    collector = Collector(
        env,
        build()[0],
        unroll_length=steps,
        seed=0,
        augmentation=augmentation,
        hooks=[Hindsight(relabelling, goal, env, seed=0, augmentation=augmentation)],
    )
    unroll = collector.collect()
    episodes = unroll.episodes
    assert episodes is not None
    seen = unroll.steps["observation", "image"].numpy()
    found = 0
    for e in range(episodes.batch_size[1]):
        length = int(episodes["mask"][:, e].sum())
        relabelled = episodes["observation", "image"][:length, e].numpy()
        for world in range(n):
            for start in range(steps - length + 1):
                original = seen[start : start + length, world]
                same = (relabelled == original).reshape(length, 7, 9, 7, 9, 3)
                cells = same.all((0, 2, 4, 5))
                if cells[1:].all() and cells[0, 1:].all():
                    found += 1
                    cue = relabelled[0, :9, :9]
                    assert (cue != original[0, :9, :9]).any()
                    # What it touched stands in the view before the last step, turned likewise.
                    shape = (cue != 180).any(-1)
                    grid = relabelled[-1].reshape(7, 9, 7, 9, 3).swapaxes(1, 2)[2:5, 2:5]
                    touched = [
                        np.array_equal(cell[shape], cue[shape]) and not cell[~shape].any()
                        for cell in grid.reshape(9, 9, 9, 3)
                    ]
                    assert any(touched)
    assert found >= episodes.batch_size[1] > 3
