"""The labyrinth's generalist: what is in view, what it knows, and how it scores."""

import math
from functools import partial

import numpy as np
import pytest
from conftest import slow_but
from labyrinth_levels import batch, play_out

from zipf import envs
from zipf.envs.labyrinth import in_view
from zipf.envs.labyrinth.generalist import Generalist
from zipf.envs.labyrinth.in_view import NEVER, RAYS
from zipf.envs.labyrinth.state import CELL, PITCH, YAW, X, Y
from zipf.envs.testing import check_policy

IMAGE = (3, 4)
"""Of the paper's proportions."""

FLOORS = {
    "rooms_collect_good_objects_train": 8,
    "rooms_exploit_deferred_effects_train": 9,
    "rooms_select_nonmatching_object": 60,
    "rooms_watermaze": 70,
    "rooms_keys_doors_puzzle": 50,
    "language_select_described_object": 500,
    "language_select_located_object": 280,
    "language_execute_random_task": 250,
    "language_answer_quantitative_question": 300,
    "lasertag_one_opponent_small": 6,
    "natlab_varying_map_regrowth": 15,
    "skymaze_irreversible_path_varied": 100,
    "psychlab_arbitrary_visuomotor_mapping": 58,
    "explore_object_locations_small": 50,
    "explore_obstructed_goals_small": 150,
    "explore_goal_locations_large": 120,
    "explore_object_rewards_few": 60,
}
"""Mean returns of three episodes, a level for each kind of rules."""


@pytest.mark.parametrize("level", slow_but(FLOORS, "explore_goal_locations_large"))
def test_it_reaches_its_floor(level: str) -> None:
    env = batch(level, 3, image_size=IMAGE)
    env.reset(seed=11)
    returns, _ = play_out(env, Generalist(env))
    assert returns.mean() >= FLOORS[level]


@pytest.mark.parametrize("level", ["natlab_varying_map_regrowth", "language_execute_random_task"])
def test_it_can_label_what_another_policy_does(level: str) -> None:
    full = f"labyrinth/{level}"
    make = partial(envs.make_vec, full, image_size=IMAGE)
    check_policy(partial(envs.generalist, full), make, steps=8)


def seen_by_small_steps(solid, x, y, yaw, wide):
    """The cells that lines of sight reach, followed a tenth of a unit at a time."""
    seen = np.zeros(solid.shape, np.bool_)
    for k in range(RAYS + 1):
        angle = yaw + math.atan(wide * (2 * k / RAYS - 1))
        along = np.arange(0.0, 3000.0, 0.1)
        rows = np.floor((y + along * math.sin(angle)) / CELL).astype(int)
        columns = np.floor((x + along * math.cos(angle)) / CELL).astype(int)
        stop = int(np.argmax(solid[rows.clip(0, len(solid) - 1), columns.clip(0, len(solid) - 1)]))
        seen[rows[: stop + 1], columns[: stop + 1]] = True
    return seen


def test_cells_in_view_are_those_that_lines_of_sight_reach() -> None:
    rng = np.random.default_rng(0)
    differ = count = 0
    for _ in range(30):
        solid = rng.random((9, 9)) < 0.3
        solid[[0, -1]] = solid[:, [0, -1]] = True
        solid[4, 4] = False
        body = np.zeros(8)
        body[[X, Y]] = rng.uniform(410, 490, 2)
        body[YAW] = rng.uniform(0, 2 * math.pi)
        seen_at = np.full((63, 63), NEVER)
        in_view.see_cells(solid, body, 1.0, 0.75, 7, seen_at)
        assert set(np.unique(seen_at)) == {NEVER, 7}
        expected = seen_by_small_steps(solid, body[X], body[Y], body[YAW], 1.0)
        differ += (expected != (seen_at[:9, :9] == 7)).sum()  # a step may jump over a corner
        count += expected.sum()
        body[PITCH] = math.radians(40)  # the horizon is below the image
        seen_at[:] = NEVER
        in_view.see_cells(solid, body, 1.0, 0.75, 7, seen_at)
        assert (seen_at == NEVER).all()
    assert count > 200
    assert differ <= 0.01 * count


@pytest.mark.parametrize(
    "level",
    [
        "explore_goal_locations_small",
        "rooms_exploit_deferred_effects_train",
        "natlab_fixed_large_map",
    ],
)
def test_items_in_view_are_those_that_are_drawn(level: str) -> None:
    """From random places: no pixel shows an item that is not in view, or hardly one, and one that
    is in view is always drawn."""
    env = batch(level, 1, image_size=(90, 120))
    rng = np.random.default_rng(1)
    wide, drawn_and_known, missed = 1.0, 0, 0
    item = 0
    for trial in range(150):
        if trial % 30 == 0:
            env.reset(seed=trial)
            episode = env.episodes[0]
            if level.startswith("natlab"):
                item = next(iter(episode.mushrooms))
        body, worlds = env.envs.bodies[0], env.envs
        at = worlds.places[0, item]
        worlds.present[0] = False
        # Somewhere around the item, looking roughly there.
        angle, away = rng.uniform(0, 2 * math.pi), rng.uniform(80, 500)
        x, y = at[0] + away * math.cos(angle), at[1] + away * math.sin(angle)
        if level.startswith("explore"):
            rows, columns = worlds.cells[0]
            row, column = int(y // CELL), int(x // CELL)
            if not (0 <= row < rows and 0 <= column < columns) or worlds.solid[0, row, column]:
                continue
        elif level.startswith("rooms") and not (-250 < x < 320 and -250 < y < 250):
            continue
        height = body[2]
        if level.startswith("natlab"):
            if not (50 < x < 3500 and 50 < y < 3500):
                continue
            height = episode.terrain.height(x, y) + 24.0
        body[:3] = x, y, height
        body[YAW] = angle + math.pi + rng.uniform(-1.2, 1.2)
        body[PITCH] = rng.uniform(-0.2, 0.2)
        without = env.observations()["image"].astype(int)
        worlds.present[0, item] = True
        pixels = (env.observations()["image"] != without).any(-1).sum()
        known = np.zeros(worlds.present.shape[1], np.bool_)
        in_view.see_items(worlds, 0, worlds.opaque[0], worlds.see_through[0], wide, 0.75, known)
        if known[item]:
            assert pixels > 0
            drawn_and_known += 1
        elif pixels > 12:
            missed += 1  # its edge is in view, its middle is not
    assert drawn_and_known > 20
    assert missed <= 0.2 * drawn_and_known


def test_what_is_unseen_changes_nothing() -> None:
    """The same answers in mazes with other walls and another goal where nothing has been seen."""
    level, n = "explore_goal_locations_small", 6
    env, other = (batch(level, n, image_size=IMAGE) for _ in range(2))
    player, pretender = Generalist(env), Generalist(other)
    rng = np.random.default_rng(0)
    changed = compared = 0
    for t in range(60):
        if t == 0:
            env.reset(seed=3)
        answers = player()
        if t % 6 == 0:
            other.reset(seed=3)
            other.set_state(env.get_state())
            for i, episode in enumerate(other.episodes):
                if player._ever[i, episode.goal]:
                    continue
                shape = episode.maze.solid.shape
                unseen = player._seen_at[i, : shape[0], : shape[1]] == NEVER
                unseen[[0, -1]] = unseen[:, [0, -1]] = False
                solid = np.where(unseen, rng.random(shape) < 0.5, episode.maze.solid)
                free = np.argwhere(unseen & ~solid)
                if not len(free):
                    continue
                changed += (solid != episode.maze.solid).sum()
                for walls in (other.envs.solid[i], other.envs.opaque[i]):
                    walls[: shape[0], : shape[1]] = solid
                episode.maze.solid[:] = solid
                episode.goal_cell = tuple(free[rng.integers(len(free))].tolist())
                other.envs.places[i, episode.goal, :2] = CELL * (free[0][::-1] + 0.5)
            pretender.set_state(player.get_state())
            np.testing.assert_array_equal(pretender(), answers)
            compared += 1
        env.step(answers)
    assert compared == 10
    assert changed > 100


def test_closed_doors_hide_what_is_behind_them_and_are_looked_at_anew_in_every_map() -> None:
    env = batch("explore_obstructed_goals_small", 1, image_size=IMAGE)
    player = Generalist(env)
    env.reset(seed=0)
    episode = env.episodes[0]
    worlds = env.envs
    closed = {cell for cell in episode.doors if worlds.opaque[0][cell]}
    assert closed
    assert closed == {cell for cell in episode.doors if episode.blocked[cell]}
    first = env.maps[0]
    for _ in range(300):
        env.step(player())
        if env.maps[0] > first:
            break
    assert env.maps[0] == first + 1
    before, doors = player._seen_at[0] > NEVER, np.zeros((63, 63), np.bool_)
    doors[tuple(zip(*episode.doors, strict=True))] = True
    assert (before & doors).any()
    player()
    now = player._seen_at[0]
    assert set(now[doors].tolist()) <= {NEVER, int(worlds.clock[0])}
    assert (now[before & ~doors] > NEVER).all()  # walls stay where they were


def test_which_objects_are_good_is_found_out() -> None:
    """In the first map some bad ones are taken, later none."""
    env = batch("explore_object_rewards_few", 4, image_size=IMAGE)
    player = Generalist(env)
    env.reset(seed=0)
    first, bad = env.maps.copy(), {True: 0, False: 0}
    for _ in range(800):
        is_first = env.maps == first
        _, reward, *_ = env.step(player())
        for i in np.flatnonzero(reward == -1):
            bad[bool(is_first[i])] += 1
    assert bad[True] > 0
    assert bad[False] == 0
    assert (env.maps > first + 5).all()


def test_it_needs_fifteen_actions_and_our_engine() -> None:
    with pytest.raises(ValueError, match="the generalist needs num_actions=15, got 9"):
        Generalist(batch("rooms_watermaze", 1, num_actions=9))
