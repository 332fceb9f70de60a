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
from zipf.experiments.hooks.augmentation import (
    UNCHANGED,
    Draws,
    RandomAugmentation,
    RandomAugmentationOptions,
)
from zipf.experiments.hooks.labels import Labels
from zipf.experiments.hooks.relabelling import Hindsight
from zipf.experiments.training.host_collector import HostCollector

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


def shown(augmentation, observation, draw):
    """Observations {name: [N, ...]} as arrays, changed."""
    parts = {name: torch.from_numpy(part) for name, part in observation.items()}
    changed = augmentation(parts, torch.from_numpy(draw))
    return {name: part.numpy() for name, part in changed.items()}


@pytest.mark.parametrize("more", [{}, {"scale": [0.4, 2.5]}], ids=["as large", "scaled"])
def test_images_are_changed_as_the_options_say(more):
    """Each pixel by its definition, in a copy; a draw of zeros, which stands for no frame, and that
    which changes nothing leave zeros and the image as they are."""
    n = 40
    chosen = options(channels=True, shift=2, **more)
    augmentation = RandomAugmentation(chosen.model_copy(update={"cutout": 3}), IMAGE)
    draw = augmentation.draw(np.random.default_rng(0), n)
    order, shift = draw[:, 1:4].astype(int), draw[:, 4:6].astype(int)
    before = random_images(n)
    image = shown(augmentation, {"image": before}, draw)["image"]
    assert np.array_equal(before, random_images(n))
    for i in range(n):
        (down, right), scale = shift[i], draw[i, 6]
        top, left = (draw[i, 7:] * (6, 8)).astype(int) - 1
        for r, c, k in itertools.product(range(6), range(8), range(3)):
            if top <= r < top + 3 and left <= c < left + 3:
                assert image[i, r, c, k] == 0
            else:
                # From the image's centre, so many pixels times the scale are seen before the shift.
                row = np.clip(np.round((r - down - 2.5) / scale + 2.5), 0, 5).astype(int)
                column = np.clip(np.round((c - right - 3.5) / scale + 3.5), 0, 7).astype(int)
                assert image[i, r, c, k] == before[i, row, column, order[i, k]]
    assert len(np.unique(order, axis=0)) == 6
    assert set(shift.ravel()) == {-2, -1, 0, 1, 2}
    least, largest = chosen.scale
    assert least <= draw[:, 6].min() <= draw[:, 6].max() <= largest
    assert (draw[:, 6] <= 1).mean() > 0.3  # on a logarithmic scale half of them

    augmentation = RandomAugmentation(chosen, IMAGE)
    same = shown(augmentation, {"image": before}, UNCHANGED.repeat(n, 0))["image"]
    assert np.array_equal(same, before)
    nothing = {"image": np.zeros_like(before)}
    assert not shown(augmentation, nothing, np.zeros_like(draw))["image"].any()


def test_frames_of_an_unroll_are_changed_as_single_frames_are():
    augmentation = RandomAugmentation(options(channels=True, shift=2), IMAGE)
    draw = augmentation.draw(np.random.default_rng(0), 12)
    images = random_images(12)
    single = shown(augmentation, {"image": images}, draw)["image"]
    unroll = {"image": torch.from_numpy(images).view(4, 3, 6, 8, 3).transpose(0, 1)}
    together = augmentation(unroll, torch.from_numpy(draw).view(4, 3, 9).transpose(0, 1))
    assert np.array_equal(together["image"].transpose(0, 1).reshape(12, 6, 8, 3).numpy(), single)


def drawn(draws, n):
    fields = {"draw": torch.zeros(n, 9, dtype=torch.float64)}
    draws.show(fields)
    return fields["draw"].numpy()


def test_draws_last_for_an_episode():
    augmentation = RandomAugmentation(options(channels=True), IMAGE)
    draws = Draws(augmentation, 50, seed=0)
    draws.begin({}, torch.ones(50, dtype=torch.bool))
    before = drawn(draws, 50)
    some = torch.arange(50) < 25
    draws.begin({}, some)
    after = drawn(draws, 50)
    assert np.array_equal(after[~some], before[~some])
    assert not np.array_equal(after[some], before[some])
    other = Draws(augmentation, 50, seed=1)
    other.load_state_dict(draws.state_dict())
    assert np.array_equal(drawn(other, 50), after)
    for one in (draws, other):
        one.begin({}, torch.ones(50, dtype=torch.bool))
    assert np.array_equal(drawn(other, 50), drawn(draws, 50))


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


def augmented_agent(augmentation):
    agent = build()[0]
    agent.augmentation = augmentation
    return agent


def test_the_collector_shows_and_acts_through_the_augmentation(monkeypatch):
    """A twin batch that is given the envs' actions shows what is in the unroll, and, once changed,
    what the agent was given; labels and final observations are the agent's, too; saved and loaded
    it goes on alike."""
    n, steps = 16, 40
    env = envs.make_vec("gridworld/uniform", n, max_steps=7)
    split = envs.split("gridworld")
    space, symmetries = env.single_observation_space, envs.symmetries(split, env)
    chosen = options(symmetries=True, channels=True)
    augmentation = RandomAugmentation(chosen, space, symmetries=symmetries)
    agent, given, valued = augmented_agent(augmentation), [], []
    act, value = agent.act, agent.value
    monkeypatch.setattr(agent, "act", lambda inputs, *a: (given.append(inputs), act(inputs, *a))[1])
    monkeypatch.setattr(
        agent, "value", lambda inputs, m: (valued.append(inputs), value(inputs, m))[1]
    )
    labels = Labels(Teacher("expert", split, env), 0.0, augmentation)
    hooks = [Draws(augmentation, n, seed=3), labels]
    collector = HostCollector(env, agent, unroll_length=steps, seed=0, hooks=hooks)
    twin = envs.make_vec("gridworld/uniform", n, max_steps=7)
    draws, expert = Draws(augmentation, n, seed=3), envs.expert("gridworld/uniform", twin)
    observation, _ = twin.reset(seed=0)
    draws.begin({}, torch.ones(n, dtype=torch.bool))
    unroll = collector.collect()
    rows = unroll.steps
    for t in range(steps):
        draw, image = drawn(draws, n), observation["image"].copy()
        assert np.array_equal(rows["observation", "image"][t].numpy(), image)
        assert np.array_equal(rows["draw"][t].numpy(), draw)
        expected = shown(augmentation, {"image": image}, draw)["image"]
        assert np.array_equal(given[t].observation["image"].numpy(), expected)
        assert np.array_equal(rows["label"][t].numpy(), augmentation.to_agent(expert(), draw))
        actions = rows["action"][t].numpy()
        played = augmentation.to_env(actions, draw)
        assert np.array_equal(augmentation.to_agent(played, draw), actions)
        observation, reward, terminated, truncated, info = twin.step(played)
        assert np.array_equal(rows["reward"][t].numpy(), reward)
        if truncated.any():
            final = {"image": info["final_obs"]["image"][truncated]}
            expected = shown(augmentation, final, draw[truncated])["image"]
            assert np.array_equal(valued.pop(0).observation["image"].numpy(), expected)
        draws.begin({}, torch.from_numpy(terminated | truncated))
    assert rows["truncated"].any()
    seen = unroll.changed(augmentation).steps["observation", "image"]
    assert torch.equal(seen[:-1], torch.stack([one.observation["image"] for one in given]))

    state = collector.state_dict()
    following = collector.collect().steps.clone()
    collector.load_state_dict(state)
    again = collector.collect().steps
    for name in (("observation", "image"), "draw", "action"):
        assert torch.equal(again[name], following[name])


def test_what_cannot_be_augmented_is_refused():
    with pytest.raises(ValueError, match="declare no symmetries"):
        RandomAugmentation(options(symmetries=True), IMAGE)
    codes = gym.spaces.Dict(codes=gym.spaces.MultiDiscrete([3, 3]))
    with pytest.raises(ValueError, match=r"shift: the observations have no image; choose 0"):
        RandomAugmentation(options(shift=1), codes)
    grey = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (8, 8, 1), np.uint8))
    with pytest.raises(ValueError, match=r"channels=true: the images have no colours"):
        RandomAugmentation(options(channels=True), grey)
    with pytest.raises(ValueError, match="changes nothing"):
        RandomAugmentation(options(), IMAGE)
    with pytest.raises(ValueError, match="should not be larger"):
        options(scale=[2, 1])


def test_hindsight_relabels_what_the_augmentation_shows():
    """A relabelled episode is what an env that was asked for what it achieved would have shown,
    through the augmentation of the episode."""
    n, steps = 6, 40
    split, env = envs.split("gridworld"), envs.make_vec("gridworld/uniform", n)
    chosen = options(symmetries=True, channels=True)
    space, symmetries = env.single_observation_space, envs.symmetries(split, env)
    augmentation = RandomAugmentation(chosen, space, symmetries=symmetries)
    draws = Draws(augmentation, n, seed=3)
    relabelling = AchievedOptions(
        name="achieved", episodes=100, length=None, kept_per_goal=None, reward=1.0,
        advantage="none", policy_cost=1.0, value_cost=0.0, fade=None,
    )  # fmt: skip
    goal = envs.goal("gridworld/uniform", env)
    collector = HostCollector(
        env,
        augmented_agent(augmentation),
        unroll_length=steps,
        seed=0,
        hooks=[draws, Hindsight(relabelling, goal, env, seed=0, draws=draws)],
    )
    unroll = collector.collect().changed(augmentation)
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
