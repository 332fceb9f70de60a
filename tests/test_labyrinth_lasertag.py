"""Laser tag: gadgets, damage, supplies, tags and points, opponents, and what is seen of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labyrinth_levels import batch

from zipf.envs.labyrinth.lasertag import fight, opponents, shooting, sight, walking
from zipf.envs.labyrinth.lasertag.arena import (
    ARMOUR,
    ARMOUR_PACK,
    BEAM,
    DISC,
    DROP_LIFE,
    ENEMY,
    GADGET,
    HEALTH,
    HEALTH_PACK,
    IMPULSE,
    LOADED,
    NOTHING,
    ORB,
    RAPID,
    SHOOTER,
    SLIDE,
    SUPPLIES,
    TAGGED_AT,
    TAGS,
    WAIT,
)
from zipf.envs.labyrinth.lasertag.view import opponents_colours
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.mover import BELOW, EYE, move
from zipf.envs.labyrinth.state import GRID, VX, VY, VZ, YAW, X, Y
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.render3d import TILE_TEXTURE

ALL = [level for level in LEVELS if level.startswith("lasertag")]
FIRE = 14
GONE = 10**9
"""When a fighter was tagged that never comes back."""


class Scene:
    """One env, emptied: a floor of 19 x 19 cells, the player, and opponents that stand still."""

    def __init__(self, opponents: int = 1, **options: object) -> None:
        name = "lasertag_one_opponent_small" if opponents == 1 else "lasertag_three_opponents_large"
        self.env: LabyrinthVectorEnv = batch(name, 1, **options)
        self.env.reset(seed=0)
        self.envs, self.combat = self.env.envs, self.env.envs.combat
        self.envs.solid[0] = True
        self.envs.solid[0, 1:20, 1:20] = False
        self.env._scenery.scenes.wall_count[0] = 0
        self.env._scenery.scenes.grid[0] = 0
        self.combat.kinds[0] = NOTHING
        self.envs.present[0] = False
        self.status = self.combat.status[0]
        self.status[1:, TAGGED_AT] = GONE
        self.put(0, 500, 500)

    def put(self, fighter: int, x: float, y: float, yaw: float = 0.0, health: int = 100) -> None:
        body = np.array([x, y, BELOW, 0, 0, 0, yaw, 0])
        self.combat.bodies[0, fighter] = body
        if fighter == 0:
            self.envs.bodies[0] = body
        self.status[fighter, [TAGGED_AT, WAIT, SLIDE, HEALTH]] = -1, 0, 0, health

    def give(self, gadget: int, shots: int, fighter: int = 0) -> None:
        self.status[fighter, [GADGET, LOADED + gadget, WAIT]] = gadget, shots, 0

    def lay(self, kind: int, x: float, y: float, k: int = 0) -> None:
        self.combat.kinds[0, k] = kind
        self.combat.until[0, k] = -1
        self.envs.places[0, k] = x, y, BELOW
        self.envs.present[0, k] = True

    def frames(self, count: int, fire: bool = False) -> None:
        """Only the fights, without the rest of the level."""
        for _ in range(count):
            self.envs.clock[0] += 1
            fight.fight(self.envs, 0, 0.0, 0.0, 0.0, 0.0, fire)

    def shoot(self, gadget: int, fighter: int = 0) -> None:
        self.give(gadget, 10, fighter)
        shooting.shoot(self.envs, 0, fighter)

    def health(self, fighter: int) -> int:
        return int(self.status[fighter, HEALTH])


# Layout.


@pytest.mark.parametrize("level", ALL)
def test_arenas_have_what_they_should(level: str) -> None:
    env = batch(level, 20)
    env.reset(seed=0)
    large, three = level.endswith("large"), "three" in level
    hues, gadgets, supplies = set(), [], []
    for world, episode in enumerate(env.episodes):
        combat, maze = env.envs.combat, episode.maze
        assert combat.fighters[world] == (4 if three else 2)
        assert maze.solid.shape == ((21, 21) if large else (11, 11))
        assert all(len(room) == 3 for room in maze.spawns)
        spawns = {cell for room in maze.spawns for cell in room}
        assert len(spawns) == combat.spawn_count[world]
        kinds = combat.kinds[world]
        count = 6 if large else 3
        assert (kinds[count:] == NOTHING).all()
        gadgets += kinds[: count // 3].tolist()
        supplies += kinds[count // 3 : count].tolist()
        cells = {episode.ways.cell_of(x, y) for x, y, _ in env.envs.places[world, :count]}
        assert len(cells) == count
        assert not cells & spawns
        assert not any(maze.solid[cell] for cell in cells)
        starts = [
            episode.ways.cell_of(*episode.match.place(f)) for f in range(combat.fighters[world])
        ]
        assert len(set(starts)) == len(starts)
        assert set(starts) <= spawns
        hues.add(env._scenery.scenes.colours[world, -60].tobytes())
        # Rooms look different, corridors the same.
        textures = env._scenery.scenes.tiles[world, : maze.solid.size] & TILE_TEXTURE
        textures = textures.reshape(maze.solid.shape)
        floors = [set(textures[maze.room == k].tolist()) for k in range(len(maze.spawns))]
        assert all(len(floor) == 1 for floor in floors)
        assert len(set(textures[~maze.solid & (maze.room < 0)].tolist())) == 1
    assert set(gadgets) == {ORB, BEAM, DISC}
    assert set(supplies) == {HEALTH_PACK, ARMOUR_PACK}
    assert abs(supplies.count(HEALTH_PACK) / len(supplies) - 0.5) < 0.25


def test_opponents_have_three_hues() -> None:
    assert opponents_colours(0) == [((255, 0, 0), (0, 255, 0)), ((0, 0, 255), (245, 248, 255))]
    assert opponents_colours(60)[0][0] == (255, 255, 0)


# Gadgets.


def test_damage_is_shared_by_armour_and_pushes() -> None:
    scene = Scene()
    scene.put(1, 800, 500)
    scene.shoot(DISC)
    assert scene.health(1) == 0
    assert scene.combat.points[0].tolist() == [1, 0]
    scene.put(1, 800, 500)
    scene.status[1, ARMOUR] = 50
    scene.shoot(DISC)
    assert scene.status[1, [HEALTH, ARMOUR]].tolist() == [50, 0]  # armour took 50 of 66
    assert scene.combat.bodies[0, 1, VX] == pytest.approx(500)
    assert scene.status[1, SLIDE] == 200
    scene.put(1, 800, 500)
    scene.status[1, ARMOUR] = 200
    scene.shoot(RAPID)
    assert scene.status[1, [HEALTH, ARMOUR]].tolist() == [98, 195]  # ceil(0.66 * 7) = 5
    assert np.hypot(*scene.combat.bodies[0, 1, [VX, VY]]) == pytest.approx(35, abs=0.1)
    assert scene.status[1, SLIDE] == 50


@pytest.mark.parametrize(
    ("gadget", "reach", "damage"),
    [(IMPULSE, 60, 50), (RAPID, 1400, 7), (BEAM, 790, 8), (DISC, 1400, 100)],
)
def test_reach_and_damage_of_gadgets(gadget: int, reach: float, damage: int) -> None:
    """Reach is that of the gadget and 14 to its muzzle and 15 into the body."""
    scene = Scene()
    scene.put(0, 150, 500)
    for away, taken in ((reach, damage), (reach + 25, 0)):
        if away > 1400 and taken == 0:  # out of the arena
            continue
        scene.put(1, 150 + away, 500, health=200)
        scene.shoot(gadget)
        assert 200 - scene.health(1) == taken
    # Impulse is spent on contact only, and needs no ammunition.
    scene.put(1, 150 + 300, 500, health=200)
    scene.give(gadget, 10)
    shooting.shoot(scene.envs, 0, 0)
    spent = scene.status[0, WAIT]
    assert spent == (0 if gadget == IMPULSE else {RAPID: 100, BEAM: 50, DISC: 1500}[gadget])
    assert scene.status[0, LOADED + gadget] == (10 if gadget == IMPULSE else 9)


def test_walls_stop_shots() -> None:
    scene = Scene()
    scene.put(1, 900, 500)
    scene.envs.solid[0, 5, 7] = True
    for gadget in (RAPID, BEAM, DISC):
        scene.shoot(gadget)
    assert scene.health(1) == 100
    assert scene.combat.traces[0, :3, 3] == pytest.approx([700] * 3, abs=1)


def test_a_disc_goes_through_and_others_do_not() -> None:
    scene = Scene(opponents=3)
    for fighter in (1, 2, 3):
        scene.put(fighter, 500 + 100 * fighter, 500, health=300)
    scene.shoot(DISC)
    assert [scene.health(f) for f in (1, 2, 3)] == [200, 200, 200]
    scene.shoot(BEAM)
    assert [scene.health(f) for f in (1, 2, 3)] == [192, 200, 200]


def test_rapid_spreads_by_up_to_a_degree_and_a_half() -> None:
    scene = Scene()
    scene.put(0, 150, 1000)
    ends = []
    for _ in range(300):
        scene.put(0, 150, 1000)
        scene.shoot(RAPID)
        ends.append(scene.combat.traces[0, (scene.combat.written[0, 0] - 1) % 12, 3:6].copy())
    x, y, z = np.array(ends).T
    away = x - 164
    off = np.degrees(np.arctan(np.hypot(y - 1000, z - BELOW - EYE) / away))
    assert 1.2 < off.max() <= 1.4 + 1e-6
    assert off.mean() == pytest.approx(0.7, abs=0.08)  # uniform in the radius
    assert np.abs(y - 1000).mean() == pytest.approx(np.abs(z - BELOW - EYE).mean(), rel=0.25)


@pytest.mark.parametrize(("gadget", "period"), [(RAPID, 100), (ORB, 800), (BEAM, 50), (DISC, 1500)])
def test_gadgets_fire_at_their_rate(gadget: int, period: int) -> None:
    scene = Scene()
    scene.put(0, 1900, 1000, yaw=math.pi)
    scene.give(gadget, 200)
    scene.frames(300, fire=True)
    assert 200 - scene.status[0, LOADED + gadget] == pytest.approx(300 * 16 / period, abs=1)


def test_an_orb_flies_bursts_and_hurts_around() -> None:
    scene = Scene(opponents=3)
    scene.put(1, 1100, 500, health=300)
    scene.put(2, 1100, 570, health=300)
    scene.put(3, 1100, 700, health=300)
    scene.shoot(ORB)
    before = scene.combat.shots[0, 0, X]
    shooting.fly(scene.envs, 0)
    assert scene.combat.shots[0, 0, X] - before == pytest.approx(900 * 0.016)
    for _ in range(100):
        shooting.fly(scene.envs, 0)
    assert (scene.combat.shots[0, :, SHOOTER] < 0).all()
    assert scene.health(1) == 200
    # 70 units beside where it burst less half a body, and as far as the orb was before the body.
    away = math.hypot(70 - 15, 1.0)
    assert 300 - scene.health(2) == pytest.approx(100 * (1 - away / 120), abs=1)
    assert scene.combat.bodies[0, 2, VY] > 0
    assert scene.health(3) == 300


def test_tagging_oneself_costs_a_point_and_hurts_half() -> None:
    scene = Scene()
    scene.put(0, 1960, 1000, health=100)
    scene.shoot(ORB)
    for _ in range(10):
        shooting.fly(scene.envs, 0)
    lost = 100 - scene.health(0)
    assert 40 <= lost <= 50
    assert scene.combat.bodies[0, 0, VX] < -300  # the push is not halved
    scene.put(0, 1960, 1000, health=30)
    scene.envs.bodies[0] = scene.combat.bodies[0, 0]
    scene.shoot(ORB)
    _, reward, *_ = scene.env.step([FIRE])
    assert reward[0] == -1
    assert scene.status[0, TAGS] == -1


def test_dry_gadgets_are_exchanged_for_the_best() -> None:
    scene = Scene()
    status = scene.status[0]
    status[LOADED + ORB], status[LOADED + RAPID] = 3, 100
    scene.give(DISC, 1)
    shooting.shoot(scene.envs, 0, 0)
    assert status[GADGET] == ORB
    assert status[WAIT] == 1500 + 450
    scene.give(ORB, 1)
    shooting.shoot(scene.envs, 0, 0)
    assert status[GADGET] == RAPID
    scene.give(RAPID, 1)
    shooting.shoot(scene.envs, 0, 0)
    assert status[GADGET] == IMPULSE


# Supplies.


@pytest.mark.parametrize(
    ("kind", "before", "after", "seconds"),
    [
        ((HEALTH_PACK, HEALTH), 30, 80, 35),
        ((HEALTH_PACK, HEALTH), 70, 100, 35),
        ((HEALTH_PACK, HEALTH), 100, None, 35),
        ((ARMOUR_PACK, ARMOUR), 0, 50, 25),
        ((ARMOUR_PACK, ARMOUR), 170, 200, 25),
        ((ARMOUR_PACK, ARMOUR), 200, None, 25),
        ((ORB, LOADED + ORB), 0, 10, 5),
        ((BEAM, LOADED + BEAM), 40, 100, 5),
        ((DISC, LOADED + DISC), 10, 11, 5),
        ((BEAM, LOADED + BEAM), 200, 200, 5),
    ],
)
def test_supplies(kind: tuple[int, int], before: int, after: int | None, seconds: int) -> None:
    scene = Scene()
    supply, column = kind
    scene.put(0, 500, 500)
    scene.status[0, column] = before
    gadget = int(scene.status[0, GADGET])
    scene.lay(supply, 530, 510)
    clock = int(scene.envs.clock[0])
    scene.frames(1)
    taken = scene.status[0, column]
    if after is None:
        assert taken == before
        assert scene.envs.present[0, 0]
        return
    assert taken in (after, after - 1)  # what is above 100 decays
    assert not scene.envs.present[0, 0]
    assert scene.envs.returning[0, 0] == clock + 1 + 60 * seconds
    is_gadget = supply in (ORB, BEAM, DISC)
    assert scene.status[0, GADGET] == (supply if is_gadget else gadget)
    assert (scene.status[0, WAIT] > 400) == is_gadget
    # It is there again, and opponents take supplies too.
    scene.envs.clock[0] = scene.envs.returning[0, 0] - 4
    scene.put(0, 1500, 1500)
    scene.env.step([FIRE])
    assert scene.envs.present[0, 0]
    scene.put(1, 530, 500, health=20)
    scene.status[1, ARMOUR] = 0
    scene.frames(1)
    assert not scene.envs.present[0, 0]


def test_a_supply_of_no_use_does_not_hide_another() -> None:
    scene = Scene()
    scene.put(0, 500, 500)
    scene.lay(HEALTH_PACK, 500, 505)
    scene.lay(DISC, 505, 500, k=1)
    scene.frames(1)
    assert scene.envs.present[0, :2].tolist() == [True, False]
    assert scene.status[0, GADGET] == DISC


def test_who_is_tagged_drops_the_gadget_in_hand_for_half_a_minute() -> None:
    scene = Scene()
    scene.put(1, 800, 500, health=5)
    scene.give(BEAM, 7, fighter=1)
    scene.shoot(RAPID)
    assert scene.combat.kinds[0, 0] == BEAM
    assert scene.envs.places[0, 0].tolist() == [800, 500, BELOW]
    scene.status[1, TAGGED_AT] = GONE
    clock = int(scene.envs.clock[0])
    scene.frames(DROP_LIFE - 1)
    assert scene.envs.present[0, 0]
    scene.frames(1)
    assert not scene.envs.present[0, 0]
    assert scene.envs.clock[0] == clock + 1800
    scene.put(1, 900, 500, health=5)  # Rapid is not dropped
    scene.give(RAPID, 50, fighter=1)
    scene.shoot(RAPID)
    assert not scene.envs.present[0, :SUPPLIES].any()


def test_health_decays_to_100() -> None:
    scene = Scene()
    scene.put(0, 500, 500, health=125)
    scene.status[0, ARMOUR] = 110
    scene.frames(63 * 8)  # 63 frames have 1008 ms
    assert scene.health(0) == 117
    assert scene.status[0, ARMOUR] == 102
    scene.frames(63 * 30)
    assert scene.health(0) == 100
    assert scene.status[0, ARMOUR] == 100


# Tags and points.


def test_tags_of_the_player_are_rewarded_and_those_of_others_are_not() -> None:
    scene = Scene(opponents=3)
    scene.put(1, 800, 500, health=5)
    scene.give(RAPID, 50)
    _, reward, *_ = scene.env.step([FIRE])
    assert reward[0] == 1
    scene.status[1, TAGGED_AT] = GONE
    scene.put(2, 500, 900, yaw=-math.pi / 2, health=100)
    scene.put(0, 500, 500, health=50)
    scene.give(DISC, 5, fighter=2)
    shooting.shoot(scene.envs, 0, 2)
    assert scene.health(0) == 0
    assert scene.status[2, TAGS] == 1
    _, reward, *_ = scene.env.step([0])
    assert reward[0] == 0
    assert scene.status[0, TAGS] == 1


@pytest.mark.parametrize(("action", "frames"), [(FIRE, 102), (0, 1302)])
def test_the_player_respawns_by_firing_or_much_later(action: int, frames: int) -> None:
    scene = Scene()
    scene.status[0, TAGGED_AT] = scene.envs.clock[0]
    scene.give(ORB, 5)
    place = scene.envs.bodies[0].copy()
    waited = 0
    while scene.status[0, TAGGED_AT] >= 0:
        assert (scene.envs.bodies[0] == place).all()  # a still camera
        scene.env.step([action])
        waited += 4
    assert frames <= waited < frames + 4
    assert scene.status[0, [HEALTH, ARMOUR, GADGET]].tolist() == [125, 0, RAPID]
    assert scene.status[0, LOADED:].tolist() in ([0, 100, 0, 0, 0], [0, 99, 0, 0, 0])
    cell = [int(scene.envs.bodies[0, Y] // 100), int(scene.envs.bodies[0, X] // 100)]
    count = scene.combat.spawn_count[0]
    assert cell in scene.combat.spawns[0, :count].tolist()


def test_fighters_respawn_where_nobody_is() -> None:
    scene = Scene()
    count = int(scene.combat.spawn_count[0])
    found = set()
    for _ in range(200):
        row, column = scene.combat.spawns[0, 0]
        scene.put(1, 100 * column + 50, 100 * row + 50)
        fight.respawn(scene.combat, 0, 0)
        x, y = scene.combat.bodies[0, 0, :2]
        found.add((int(y // 100), int(x // 100)))
    everywhere = {tuple(cell) for cell in scene.combat.spawns[0, :count].tolist()}
    taken = {c for c in everywhere if abs(c[0] - row) < 1 and abs(c[1] - column) < 1}
    assert found == everywhere - taken


# Movement and sight.


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_fighters_move_as_all_players_do(seed: int) -> None:
    env = batch("lasertag_one_opponent_small", 1)
    env.reset(seed=seed)
    envs, combat = env.envs, env.envs.combat
    combat.status[0, 1, TAGGED_AT] = GONE
    bodies = combat.bodies[0]
    bodies[0] = envs.bodies[0]
    rng = np.random.default_rng(seed)
    for _ in range(60):
        command = [float(rng.uniform(-0.2, 0.2)), 0.05, *rng.integers(-1, 2, 2).astype(float)]
        if rng.random() < 0.1:  # a push
            envs.bodies[0, [VX, VY, VZ]] += rng.uniform(-300, 300, 3)
            bodies[0] = envs.bodies[0]
        for _ in range(4):
            move(envs, 0, *command)
            walking.walk(envs.solid[0], bodies, combat.status[0], 2, 0, *command)
        np.testing.assert_allclose(bodies[0], envs.bodies[0], atol=1e-9)


def test_fighters_do_not_walk_through_each_other() -> None:
    scene = Scene()
    scene.put(1, 700, 505)
    for _ in range(60):
        walking.walk(
            scene.envs.solid[0], scene.combat.bodies[0], scene.status, 2, 0, 0.0, 0.0, 0.0, 1.0
        )
    assert 650 < scene.combat.bodies[0, 0, X] <= 670
    assert scene.combat.bodies[0, 0, VX] == 0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sight_is_that_of_many_points_on_the_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((GRID, GRID)) < 0.3
    solid[[0, -1]] = solid[:, [0, -1]] = True
    free = np.argwhere(~solid)
    (y, x), (to_y, to_x) = (
        100 * (free[rng.integers(len(free), size=2)] + rng.random((2, 2)))
    ).tolist()
    along = np.linspace(0, 1, 20001)
    rows, columns = (y + (to_y - y) * along) // 100, (x + (to_x - x) * along) // 100
    blocked = solid[rows.astype(int), columns.astype(int)]
    assert sight.in_view(solid, x, y, to_x, to_y) == (not blocked.any())
    if blocked.any():
        found = sight.to_wall(solid, x, y, to_x - x, to_y - y, 1.0)
        assert found == pytest.approx(along[blocked.argmax()], abs=1e-3)


def test_rays_enter_bodies() -> None:
    body = np.array([500.0, 500, BELOW, 0, 0, 0, 0, 0])
    assert sight.to_body(body, 300, 500, 50, 1.0, 0.0, 0.0) == 185
    assert sight.to_body(body, 300, 514, 50, 1.0, 0.0, 0.0) == 185
    assert sight.to_body(body, 300, 516, 50, 1.0, 0.0, 0.0) == math.inf
    assert sight.to_body(body, 300, 500, 60, 1.0, 0.0, 0.0) == math.inf
    assert sight.to_body(body, 300, 500, 50, -1.0, 0.0, 0.0) == math.inf
    assert sight.to_body(body, 500, 500, 30, 1.0, 0.0, 0.0) == 0


# Opponents.


def test_opponents_react_after_a_second_and_turn_slowly() -> None:
    scene = Scene()
    scene.put(0, 900, 500, health=10**6)
    scene.put(1, 500, 500, yaw=math.radians(40))
    opponents.forget(scene.combat.minds[0, 1])
    scene.give(RAPID, 200, fighter=1)
    yaws, first = [], None
    for frame in range(300):
        scene.status[0, HEALTH] = 10**6
        scene.put(0, 900, 500, health=10**6)
        scene.frames(1)
        yaws.append(float(scene.combat.bodies[0, 1, YAW]))
        if first is None and scene.status[1, LOADED + RAPID] < 200:
            first = frame
    turns = np.abs((np.diff(yaws) + math.pi) % (2 * math.pi) - math.pi)
    assert turns.max() <= math.radians(4) + 1e-9
    assert first is not None
    assert 60 <= first <= 150
    assert scene.combat.minds[0, 1, ENEMY] == 0


def test_opponents_play_at_the_pace_of_people() -> None:
    """About one tag in 15 to 20 s each where the way is short, and none stands still for long."""
    env = batch("lasertag_three_opponents_small", 8, autoreset_mode="Disabled")
    env.reset(seed=0)
    combat = env.envs.combat
    for world in range(8):
        combat.status[world, 0, TAGGED_AT] = GONE  # opponents among themselves
    places, still = [], 0.0
    steps = 900
    for _ in range(steps // 15):
        for _ in range(15):
            env.step(np.zeros(8, np.int64))
        now = combat.bodies[:, 1:, :2].copy()
        if places:
            still += float((np.abs(now - places[-1]).max(-1) < 20).mean())
        places.append(now)
    tags = combat.status[:, 1:, TAGS].sum() / (8 * 3)
    assert 8 < (steps / 15) / tags < 30
    assert still / (steps // 15) < 0.35
    assert (combat.status[:, 1:, TAGS].sum(0) > 0).all()


@pytest.mark.parametrize("level", ALL)
def test_fights_are_replayed_bit_for_bit(level: str) -> None:
    env = batch(level, 3)
    env.reset(seed=4)
    rng = np.random.default_rng(0)
    for _ in range(700):
        env.step(rng.choice([0, 0, 10, 11, 12, 13, 14], size=3))
    assert (env.envs.combat.status[:, :, TAGS] > 0).any()
    other = batch(level, 3)
    other.reset(seed=5)
    other.set_state(env.get_state())
    for name in ("status", "minds", "stream", "kinds", "shots"):
        np.testing.assert_equal(
            getattr(other.envs.combat, name), getattr(env.envs.combat, name), err_msg=name
        )
    np.testing.assert_equal(other.envs.bodies, env.envs.bodies)


# The view.


def drawn(scene: Scene) -> np.ndarray:
    scene.envs.bodies[0] = scene.combat.bodies[0, 0]
    image: np.ndarray = scene.env._scenery.large_views()[0].astype(int)
    return image


def test_opponents_and_shots_are_seen() -> None:
    scene = Scene()
    empty = drawn(scene)
    changed = []
    for away in (100, 500):
        scene.put(1, 500 + away, 500)
        changed.append(int((drawn(scene) != empty).any(-1).sum()))
    assert changed[0] > 4000
    assert changed[1] > 140  # as many as 9 pixels of the agent's view
    scene.status[1, TAGGED_AT] = GONE
    assert (drawn(scene) == empty).all()
    scene.give(DISC, 10)
    empty = drawn(scene)
    shooting.shoot(scene.envs, 0, 0)
    scene.status[0, LOADED + DISC] = 10
    assert (drawn(scene) != empty).any(-1).sum() > 200
    scene.envs.clock[0] += 120
    assert (drawn(scene) == empty).all()


def test_what_was_dropped_is_seen_at_once() -> None:
    scene = Scene()
    scene.combat.kinds[0, 20] = ORB
    scene.envs.places[0, 20] = 650, 500, BELOW
    empty = drawn(scene)
    scene.envs.present[0, 20] = True
    looks = []
    for kind in (ORB, BEAM, DISC, HEALTH_PACK, ARMOUR_PACK):
        scene.combat.kinds[0, 20] = kind
        looks.append(drawn(scene))
        assert (looks[-1] != empty).any(-1).sum() > 300
    for k in range(5):
        for n in range(k):
            assert (looks[k] != looks[n]).any(-1).sum() > 200


def test_bars_show_health_and_ammunition() -> None:
    scene = Scene()
    scene.put(0, 500, 500, health=125)
    scene.give(RAPID, 100)

    def lengths() -> tuple[int, int]:
        line = drawn(scene)[int(0.95 * 288)]
        left, right = line[:192], line[192:]
        health = (left == (70, 225, 90)).all(-1) | (left == (240, 60, 50)).all(-1)
        return int(health.sum()), int((right == (255, 226, 60)).all(-1).sum())

    full = round(0.44 * 384)
    assert lengths() == pytest.approx((full, full), abs=1)
    scene.status[0, HEALTH], scene.status[0, LOADED + RAPID] = 25, 50
    assert lengths() == pytest.approx((full / 5, full / 2), abs=1)
    eye = float(scene.env._scenery.scenes.camera[0, 2])
    scene.status[0, [HEALTH, TAGGED_AT]] = 0, 5
    assert lengths() == (0, 0)
    assert eye == pytest.approx(0.5)
    assert scene.env._scenery.scenes.camera[0, 2] == pytest.approx(0.08)


def test_other_levels_have_no_combat_after_one() -> None:
    scene = Scene()
    drawn(scene)
    env = scene.env
    assert (env._scenery.scenes.mesh[0] >= 0).any() or env._scenery.scenes.overlay_count[0] == 6
    env._scenery.clear(0)
    from zipf.envs.labyrinth.state import clear

    clear(env.envs, 0)
    assert env.envs.combat.fighters[0] == 0
    assert env._scenery.scenes.overlay_count[0] == 0
    env._scenery._update(np.ones(1, np.bool_))
    assert (env._scenery.scenes.mesh[0] == -1).all()
