"""The rules of the labyrinth's levels: rewards, starts, lengths, and what is particular to each."""

import math

import numpy as np
import pytest
from conftest import slow_but
from labyrinth_levels import KINDS, REWARDS, batch, record_rewards

from zipf.envs.labyrinth import engine
from zipf.envs.labyrinth.grids import distances
from zipf.envs.labyrinth.levels import LEVELS, by_name
from zipf.envs.labyrinth.mover import ABOVE, BELOW, WIDE
from zipf.envs.labyrinth.state import VZ, YAW, X, Y, Z
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.labyrinth.words import SHAPES
from zipf.envs.labyrinth.world import middle

ALL = pytest.mark.parametrize("level", LEVELS)


def put_player(env: LabyrinthVectorEnv, world: int, x: float, y: float, z: float = BELOW) -> None:
    env.envs.bodies[world, :3] = x, y, z
    env.envs.bodies[world, 3:6] = 0.0


def touch(env: LabyrinthVectorEnv, world: int, item: int) -> None:
    """Puts a player on an item; the next step picks it up."""
    put_player(env, world, *env.envs.places[world, item].tolist())


def wait(env: LabyrinthVectorEnv) -> tuple[float, bool, bool]:
    """Fires, which does nothing, in the only env; reward, terminated and truncated."""
    _, reward, terminated, truncated, _ = env.step(np.full(env.num_envs, 14))
    return float(reward[0]), bool(terminated[0]), bool(truncated[0])


@ALL
def test_what_the_levels_say_of_themselves(level: str) -> None:
    found = LEVELS[level]
    rules = found.load()
    text = rules.__doc__ or ""
    assert all(word in text for word in ("Goal:", "Layout:", "Rules", "ewards"))
    assert found.human > found.random
    assert by_name(f"labyrinth/{level}") is found


def test_names_of_the_paper() -> None:
    assert by_name("labyrinth/skymaze_irreversible_path_hard_v2").name.endswith("_hard")
    assert by_name("skymaze_irreversible_path_varied_v2").name.endswith("_varied")
    with pytest.raises(ValueError, match="did you mean 'rooms_watermaze'"):
        by_name("rooms_water_maze")
    with pytest.raises(ValueError, match="unknown level 'rooms_watermaze_v2'"):
        by_name("rooms_watermaze_v2")


@pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
def test_random_actions_are_rewarded_as_described(level: str, monkeypatch) -> None:
    rewards = record_rewards(monkeypatch)
    env = batch(level, 16)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    total = 0.0
    for _ in range(250):
        observation, reward, *_ = env.step(rng.integers(15, size=16))
        total += float(reward.sum())
        assert observation["instruction"].any() == level.startswith("language")
        assert np.isfinite(env.envs.bodies).all()
    assert set(rewards) <= REWARDS[level]
    assert total == sum(rewards)


@pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
def test_players_start_free_and_touch_nothing(level: str) -> None:
    env = batch(level, 24)
    env.reset(seed=3)
    for _ in range(3):
        for world in range(env.num_envs):
            assert_free(env, world)
            env._begin_map(world)


def assert_free(env: LabyrinthVectorEnv, world: int) -> None:
    envs = env.envs
    x, y, z = envs.bodies[world, :3].tolist()
    rows = int(envs.cells[world, 0])
    for dx in (-WIDE, WIDE):
        for dy in (-WIDE, WIDE):
            if rows:
                cell = int((y + dy) // 100), int((x + dx) // 100)
                assert not envs.solid[world, cell[0], cell[1]]
                assert envs.floor[world, cell[0], cell[1]] == pytest.approx(z - BELOW)
            for normal_x, normal_y, far in envs.planes[world, : envs.plane_count[world]]:
                assert normal_x * (x + dx) + normal_y * (y + dy) <= far
    for x0, y0, z0, x1, y1, z1 in envs.boxes[world, : envs.box_count[world]]:
        apart = x + WIDE <= x0 or x - WIDE >= x1 or y + WIDE <= y0 or y - WIDE >= y1
        assert apart or z - BELOW >= z1 or z + ABOVE <= z0
    for px, py, radius in envs.pillars[world, : envs.pillar_count[world]]:
        assert math.hypot(px - x, py - y) >= radius
    assert engine._touched(envs, world) == -1
    assert not envs.inside[world].any()
    assert engine._entered(envs, world) == -1


@ALL
def test_the_time_limit_truncates(level: str) -> None:
    env = batch(level, 2, autoreset_mode="Disabled")
    env.reset(seed=0)
    found = LEVELS[level]
    assert found.seconds * 15 == env._steps(found)
    if found.seconds == 12:
        for _ in range(179):
            assert wait(env)[1:] == (False, False)
    else:
        env.envs.clock[:] = found.frames - 4
    assert wait(env)[1:] == (False, True)
    assert env.envs.clock.tolist() == [found.frames] * 2


def test_other_action_repeats_have_the_same_length_in_time() -> None:
    env = batch("rooms_select_nonmatching_object", 1, action_repeat=7, autoreset_mode="Disabled")
    env.reset(seed=0)
    steps = 0
    while not wait(env)[2]:
        steps += 1
    assert steps + 1 == math.ceil(720 / 7)


def test_episodes_can_be_cut_short() -> None:
    env = batch(
        "rooms_select_nonmatching_object", 1, action_repeat=7, max_steps=5,
        autoreset_mode="Disabled",
    )  # fmt: skip
    env.reset(seed=0)
    assert [wait(env)[1:] for _ in range(5)] == [(False, False)] * 4 + [(False, True)]
    longer = batch("rooms_select_nonmatching_object", 1, max_steps=10_000)
    longer.reset(seed=0)
    assert longer.envs.limit.tolist() == [720]


@pytest.mark.parametrize(
    "level", ["rooms_collect_good_objects_train", "rooms_exploit_deferred_effects_train"]
)
def test_the_tenth_object_ends_the_episode(level: str) -> None:
    env = batch(level, 1, autoreset_mode="Disabled")
    env.reset(seed=1)
    for count in range(10):
        touch(env, 0, int(np.flatnonzero(env.envs.present[0] & env.envs.touchable[0])[0]))
        reward, terminated, truncated = wait(env)
        assert reward != 0
        assert not truncated
        assert not terminated
        assert (env.envs.ending[0] > 0) == (count == 9)
    put_player(env, 0, -250.0, -250.0)
    # 12 frames after the last, which was touched in the first frame of a step.
    assert [wait(env)[1] for _ in range(3)] == [False, False, True]


def test_kinds_of_good_and_bad_objects() -> None:
    env = batch("rooms_collect_good_objects_train", 40)
    env.reset(seed=0)
    seen = set()
    for i, episode in enumerate(env.episodes):
        kinds = episode.good, episode.bad
        assert [len(items) for items in kinds] == [10, 10]
        shapes = [{int(env._scenery.shape[i, item]) for item in items} for items in kinds]
        assert all(len(one) == 1 for one in shapes)
        seen.add((min(shapes[0]), min(shapes[1]), int(env._scenery.scenes.wall_looks[i, 0, 0])))
    assert len(seen) == 3


def test_configurations_of_deferred_effects() -> None:
    env = batch("rooms_exploit_deferred_effects_train", 60)
    env.reset(seed=0)
    seen = set()
    for i, episode in enumerate(env.episodes):
        bright = bool(env._scenery.scenes.flat_tint[i, episode.floors[0]].any())
        assert len(episode.apples) == 10
        assert len(episode.cakes) == 10 * (episode.rooms - 1)
        seen.add((episode.rooms, episode.box >= 0, bright, episode.open))
        if episode.box >= 0:
            touch(env, i, episode.box)
    assert seen == {(1, True, False, False), (2, False, False, False), (2, False, True, True)}
    _, reward, *_ = env.step(np.full(60, 14))
    for i, episode in enumerate(env.episodes):
        if episode.box >= 0:  # the box costs three and lights the floor
            assert reward[i] == -3
            assert env._scenery.scenes.flat_tint[i, episode.floors[0]].all()


def test_a_trial_of_the_nonmatching_object() -> None:
    env = batch("rooms_select_nonmatching_object", 1)
    env.reset(seed=0)
    episode = env.episodes[0]
    match, others, sides = episode.match, set(), set()
    for right in (True, False) * 6:
        assert env.envs.bodies[0, [X, Y, YAW]].tolist() == [-232.0, -64.0, 0.0]
        shapes = env._scenery.shape[0]
        assert shapes[episode.sample] == shapes[episode.same] != shapes[episode.other]
        others.add(int(shapes[episode.other]))
        sides.add(tuple(env.envs.places[0, episode.other]))
        # What is shown cannot be touched.
        x, y, _ = env.envs.places[0, episode.sample].tolist()
        put_player(env, 0, x - 60, y)
        assert wait(env)[0] == 0
        put_player(env, 0, 64.0, -64.0)
        assert wait(env)[0] == 1
        assert env.envs.bodies[0, X] > 256
        assert env.envs.bodies[0, YAW] == 0
        touch(env, 0, episode.other if right else episode.same)
        assert wait(env)[0] == (10 if right else -10)
        wait(env)
        put_player(env, 0, -232.0, -64.0)
        assert env.episodes[0] is episode
        assert episode.match == match
    assert len(others) > 3
    assert len(sides) == 2


def test_a_visit_of_the_platform() -> None:
    env = batch("rooms_watermaze", 1)
    env.reset(seed=0)
    episode = env.episodes[0]
    place = episode.place
    assert not env.envs.present[0, episode.platform]
    starts = set()
    for _ in range(6):
        starts.add((round(env.envs.bodies[0, X]), round(env.envs.bodies[0, Y])))
        put_player(env, 0, *place)
        total, steps = 0.0, 0
        while True:
            reward, *_ = wait(env)
            total, steps = total + reward, steps + 1
            if math.dist(env.envs.bodies[0, :2], place) > 60:
                break
            assert env.envs.bodies[0, :2].tolist() == pytest.approx(place)
            assert env.envs.present[0, episode.platform]
        assert total == 5
        assert steps == pytest.approx(2.2 * 15, abs=2)
        assert env.episodes[0].place == place
        assert not env.envs.present[0, episode.platform]
    assert len(starts) > 2
    radii = []
    for seed in range(40):
        env.reset(seed=seed)
        radii.append(math.hypot(*env.episodes[0].place))
    assert max(radii) <= 580
    assert np.mean(radii) == pytest.approx(387, abs=60)


def test_keys_open_doors_of_their_colour_once() -> None:
    env = batch("rooms_keys_doors_puzzle", 60)
    env.reset(seed=0)
    opened = 0
    for i, episode in enumerate(env.episodes):
        first = episode.keys[0]
        colour = episode.plan.keys[0][1]
        doors = {
            k: door for k, door in episode.doors.items() if episode.plan.links[episode.links[k][0]]
        }
        same = [k for k in doors if episode.links[k][1] == colour]
        other = [k for k in doors if episode.links[k][1] != colour]
        if len(same) < 2 or not other:
            continue
        opened += 1
        shown = env._scenery.scenes.overlay_count

        def do(x: float, y: float, i: int = i) -> float:
            put_player(env, i, x, y)
            return float(env.step(np.full(60, 14))[1][i])

        def closed(k: int, i: int = i, episode=episode) -> bool:
            return bool(env.envs.boxes[i, episode.doors[k]].any())

        assert all(closed(k) for k in doors)
        assert not shown[i]
        assert do(*middle(episode.link_cells[same[0]])) == 0
        assert closed(same[0])
        assert do(*env.envs.places[i, first, :2].tolist()) == 1
        assert shown[i]
        assert do(*middle(episode.link_cells[other[0]])) == 0
        assert closed(other[0])
        assert do(*middle(episode.link_cells[same[0]])) == 1
        assert not closed(same[0])
        assert not shown[i]
        assert do(*middle(episode.link_cells[same[1]])) == 0
        assert closed(same[1])
        if opened == 3:
            break
    assert opened == 3


def test_another_key_replaces_the_one_carried() -> None:
    env = batch("rooms_keys_doors_puzzle", 30)
    env.reset(seed=0)
    found = 0
    for i, episode in enumerate(env.episodes):
        colours = [colour for _, colour in episode.plan.keys]
        if len(set(colours)) < 2:
            continue
        second = next(k for k, colour in enumerate(colours) if colour != colours[0])
        for key in (0, second):
            touch(env, i, episode.keys[key])
            assert env.step(np.full(30, 14))[1][i] == 1
        assert episode.carried == colours[second]
        found += 1
    assert found


@pytest.mark.parametrize("level", [name for name in LEVELS if name.startswith("skymaze")])
def test_the_goal_of_a_skymaze_ends_the_episode(level: str) -> None:
    env = batch(level, 1, autoreset_mode="Disabled")
    env.reset(seed=0)
    touch(env, 0, env.episodes[0].trophy)
    steps = [wait(env) for _ in range(4)]
    assert sum(reward for reward, *_ in steps) == 100
    assert [over for _, over, _ in steps] == [False, False, False, True]


def test_nobody_climbs_in_a_skymaze() -> None:
    env = batch("skymaze_irreversible_path_hard", 16)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    start = env.envs.bodies[:, Z].copy()
    stood = start.copy()  # the lowest platform that each has stood on
    for _ in range(600):
        env.step(rng.choice([0, 0, 10, 11, 12, 13], size=16))
        z, falling = env.envs.bodies[:, Z], env.envs.bodies[:, VZ] < 0
        assert (z <= stood + 1e-6).all()
        stood = np.where(falling, stood, z)
    assert (stood < start - 90).sum() > 8


def test_mushrooms_grow_again_where_they_were() -> None:
    env = batch("natlab_varying_map_regrowth", 1)
    env.reset(seed=0)
    item = next(iter(env.episodes[0].mushrooms))
    far = next(place for place in env.episodes[0].terrain.starts)
    waits = []
    for _ in range(3):
        place = env.envs.places[0, item].copy()
        touch(env, 0, item)
        assert wait(env)[0] == 1
        assert not env.envs.present[0, item]
        put_player(env, 0, *far, 1e4)
        taken = int(env.envs.clock[0])
        waits.append((env.envs.returning[0, item] - taken) / 60)
        assert 24 - 0.1 <= waits[-1] <= 108
        env.envs.clock[0] = env.envs.returning[0, item] - 2
        env.envs.limit[0] = 10**9
        put_player(env, 0, *far, env.episodes[0].terrain.height(*far) + BELOW)
        wait(env)
        assert env.envs.present[0, item]
        assert (env.envs.places[0, item] == place).all()
    assert len(set(waits)) == 3


@pytest.mark.parametrize("level", ["natlab_fixed_large_map", "natlab_varying_map_randomized"])
def test_mushrooms_of_other_levels_do_not_grow_again(level: str) -> None:
    env = batch(level, 2)
    env.reset(seed=0)
    touch(env, 0, next(iter(env.episodes[0].mushrooms)))
    assert wait(env)[0] == 1
    assert (env.envs.returning == -1).all()


def test_deserts_of_the_natlab_levels() -> None:
    env = batch("natlab_fixed_large_map", 12)
    env.reset(seed=0)
    assert len({id(episode.terrain) for episode in env.episodes}) == 1
    assert len({env._scenery.scenes.sky[i].tobytes() for i in range(12)}) == 3
    env = batch("natlab_varying_map_randomized", 12)
    env.reset(seed=0)
    assert len({id(episode.terrain) for episode in env.episodes}) > 8


@pytest.mark.parametrize("size", ["small", "large"])
def test_the_goal_begins_a_new_map_and_stays_where_it_is(size: str) -> None:
    env = batch(f"explore_goal_locations_{size}", 1)
    env.reset(seed=0)
    goal = env.episodes[0].goal_cell
    spawns = set()
    for _ in range(8):
        touch(env, 0, env.episodes[0].goal)
        rewards = wait(env)[0]
        assert rewards == 10
        assert env.episodes[0].goal_cell == goal
        spawns.add(env.episodes[0].spawn)
    assert len(spawns) > 3


@pytest.mark.parametrize("size", ["small", "large"])
def test_a_way_to_the_goal_is_always_open(size: str) -> None:
    env = batch(f"explore_obstructed_goals_{size}", 12)
    env.reset(seed=0)
    shares = []
    for _ in range(4):
        for i, episode in enumerate(env.episodes):
            shut = [cell for cell, door in episode.doors.items() if env.envs.boxes[i, door].any()]
            blocked = episode.maze.solid.copy()
            for cell in shut:
                blocked[cell] = True
            assert distances(blocked, *episode.goal_cell)[episode.spawn] >= 0
            shares.append(len(shut) / len(episode.doors))
            env._begin_map(i)
    assert 0.1 < np.mean(shares) < 0.5
    assert len(set(shares)) > 5


@pytest.mark.parametrize("size", ["small", "large"])
def test_apples_come_back_when_all_are_taken(size: str) -> None:
    env = batch(f"explore_object_locations_{size}", 1)
    env.reset(seed=0)
    episode = env.episodes[0]
    count = len(episode.apples)
    assert count == sum(map(len, episode.maze.objects)) // 2
    for _ in range(2):
        for k, apple in enumerate(episode.apples):
            touch(env, 0, apple)
            assert wait(env)[0] == 1
            assert env.envs.present[0].sum() == (count - k - 1 or count)


@pytest.mark.parametrize(("level", "kinds"), [("few", 4), ("many", 8)])
def test_kinds_of_objects_with_rewards(level: str, kinds: int) -> None:
    env = batch(f"explore_object_rewards_{level}", 1)
    env.reset(seed=0)
    episode = env.episodes[0]
    assert len(episode.objects) == kinds
    assert len(episode.good) == kinds // 2
    assert len(episode.places) == 2 * kinds
    patterns = env._scenery.scenes.pattern[0, episode.objects]
    assert (patterns >= 0).all()  # none is a mesh with parts of either colour
    assert len(np.unique(patterns)) > 1
    cells = dict(episode.cells)
    touch(env, 0, episode.objects[-1])
    assert wait(env)[0] == -1
    for item in episode.good:
        touch(env, 0, item)
        assert wait(env)[0] == 2
    assert env.envs.present[0].sum() == kinds  # a new map
    assert episode.cells != cells
    assert set(episode.cells.values()) <= set(episode.places)
    assert len(set(SHAPES)) == 40
