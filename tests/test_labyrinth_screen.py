"""The psychlab levels: the gaze, the screen, the pictures, and the batches."""

import math
import pickle
from functools import partial

import numpy as np
import pytest
from labyrinth_levels import batch
from psychlab_trials import ALL, BLACK, RECOGNITION, SEARCH, begin

from zipf.envs import Mixture, expert, make, make_vec
from zipf.envs.labyrinth import pictures
from zipf.envs.labyrinth.gaze import NOWHERE, gaze
from zipf.envs.labyrinth.levels.psychlab_search import VisualSearch
from zipf.envs.labyrinth.state import PITCH, YAW
from zipf.envs.testing import check_vector_env

# The gaze.


def test_where_the_player_looks() -> None:
    """By the formulas of the description, from a level's measures alone."""
    env, _ = begin(SEARCH)
    body = env.envs.bodies[0]
    rng = np.random.default_rng(0)
    for _ in range(50):
        right, down = rng.uniform(-1.2, 1.2, 2)
        body[YAW], body[PITCH] = math.pi / 2 - right, -down
        x = 0.5 + 90 * math.tan(right) / 112
        y = 0.5 + 1 / 112 + 90 * math.tan(down) / (math.cos(right) * 112)
        assert gaze(env.envs, 0) == pytest.approx((x, y))
    body[YAW], body[PITCH] = math.pi / 2, 0.0
    assert gaze(env.envs, 0) == pytest.approx((0.5, 0.509), abs=1e-3)
    for yaw in (-math.pi / 2, 0.0, math.pi, 4.0):
        body[YAW] = yaw
        assert gaze(env.envs, 0) == (NOWHERE, NOWHERE)


def test_the_gaze_is_the_middle_of_the_view() -> None:
    env, episode = begin(SEARCH, image_size=(73, 97))
    rng = np.random.default_rng(1)
    image = np.zeros((1, 73, 97, 3), np.uint8)
    for _ in range(20):
        x, y = rng.uniform(0.05, 0.95, 2)
        env.envs.bodies[0, [YAW, PITCH]] = episode.screen.direction(x, y)
        assert episode.screen.gaze == pytest.approx((x, y))
        episode.screen.clear()
        episode.screen.fill((x - 0.025, y - 0.025, x + 0.025, y + 0.025), BLACK)
        env._scenery.draw(image, np.ones(1, np.bool_))
        assert image[0, 36, 48].max() < 60


def test_how_large_the_screen_is() -> None:
    env, episode = begin(SEARCH, image_size=(72, 96))
    episode.screen.clear()
    env.envs.bodies[0, [YAW, PITCH]] = math.pi / 2, 0.0
    image = np.zeros((1, 72, 96, 3), np.uint8)
    env._scenery.draw(image, np.ones(1, np.bool_))
    white = (image[0] == 255).all(-1)
    assert white[36].sum() == pytest.approx(2 * 48 * 56 / 90, abs=1)
    assert white[:, 48].sum() == pytest.approx(2 * 48 * 56 / 90, abs=1)


@ALL
def test_the_player_only_looks(level: str) -> None:
    env = batch(level, 200)
    env.reset(seed=0)
    bodies = env.envs.bodies
    off = np.degrees(bodies[:, YAW]) - 90
    assert abs(off).max() <= 22.5
    assert np.ptp(off) > 40
    assert abs(off.mean()) < 3
    assert (bodies[:, PITCH] == 0).all()
    before = bodies.copy()
    rng = np.random.default_rng(0)
    for _ in range(20):
        env.step(rng.integers(15, size=200))
    assert (bodies[:, :YAW] == before[:, :YAW]).all()
    assert (bodies[:, YAW] != before[:, YAW]).mean() > 0.9
    assert (bodies[:, PITCH] != before[:, PITCH]).mean() > 0.5


# The pictures.


def test_all_pictures_are_different_as_they_are_seen() -> None:
    """At the size at which they are seen: each differs from all others, in any of its parts."""
    assert pictures.COUNT == 2400
    small = np.stack([pictures.draw(number, 44)[..., :3] for number in range(pictures.COUNT)])
    points = small.reshape(len(small), 22, 2, 22, 2, 3).mean((2, 4)).reshape(len(small), -1)
    points = points.astype(np.float32)
    squares = (points**2).sum(1)
    apart = squares[:, None] + squares - 2 * points @ points.T
    np.fill_diagonal(apart, np.inf)
    assert math.sqrt(apart.min() / points.shape[1]) > 15


def test_a_picture_is_the_same_for_ever() -> None:
    first = pictures.draw(1234, 96)
    pictures.draw(5, 96)
    assert first.shape == (96, 96, 4)
    assert (pictures.draw(1234, 96) == first).all()
    assert (first[..., 3] == 255).all()


# Batches.


@ALL
def test_a_screen_is_restored_with_its_episode(level: str) -> None:
    """In the middle of trials, of which many have been answered."""
    env, other = batch(level, 3, image_size=(18, 24)), batch(level, 3, image_size=(18, 24))
    env.reset(seed=4)
    other.reset(seed=5)
    player = expert(f"labyrinth/{level}", env)
    assert player is not None
    for _ in range(155):
        env.step(player())
    assert all(episode.done > 2 for episode in env.episodes)
    other.set_state(env.get_state())
    for one in (other, pickle.loads(pickle.dumps(env))):
        np.testing.assert_equal(one.observations(), env.observations())
        np.testing.assert_equal(one._scenery.scenes.screen, env._scenery.scenes.screen)
        np.testing.assert_equal(one.envs, env.envs)
    for _ in range(60):
        actions = player()
        expected = env.step(actions)
        np.testing.assert_equal(other.step(actions)[:4], expected[:4])


def test_other_levels_have_no_screen() -> None:
    """Not even in envs that had one in the episode before."""
    names = (RECOGNITION, "rooms_watermaze")
    makers = {name: partial(make_vec, f"labyrinth/{name}") for name in names}
    env = Mixture(makers, 16, draw="resets", exponent=0.0, image_size=(9, 12))
    envs = env.batches[0].envs
    changes = 0
    for seed in range(8):
        before = env.levels_of_envs.copy()
        env.reset(seed=seed)
        for _ in range(3):
            env.step(np.full(16, 14))
        on_screen = env.levels_of_envs == 0
        changes += int((on_screen[before == 0] == 0).sum())
        assert ((envs.screen[:, 3] > 0) == on_screen).all()
        assert (envs.widgets.any((1, 2)) == on_screen).all()
        assert (envs.watched[~on_screen] == -1).all()
    assert changes > 8


def test_psychlab_keeps_the_contract() -> None:
    """With long steps, for episodes of ten or so."""
    name, options = f"labyrinth/{SEARCH}", {"image_size": (9, 12), "action_repeat": 900}
    check_vector_env(
        partial(make_vec, name, **options), partial(make, name, **options), num_envs=2, steps=30
    )


def test_the_page_of_a_screen_shows_where_the_player_looks() -> None:
    env = batch(SEARCH, 1, render_mode="rgb_array")
    env.reset(seed=0)
    episode = env.episodes[0]
    assert isinstance(episode, VisualSearch)
    episode.screen.clear()
    for x, y in ((0.2, 0.3), (0.8, 0.7)):
        env.envs.bodies[0, [YAW, PITCH]] = episode.screen.direction(x, y)
        frames = env.render()
        assert frames is not None
        page = frames[0][:, 384:]
        rows, columns = np.nonzero((page < 90).all(-1)[40:248, 40:248])
        assert columns.mean() + 40 == pytest.approx(288 * (0.1 + 0.8 * x), abs=2)
        assert rows.mean() + 40 == pytest.approx(288 * (0.1 + 0.8 * y), abs=2)
