"""How a player moves, against a slow version of the kinematics and against its published table."""

import math

import numpy as np
import pytest

from zipf.envs import make_vec
from zipf.envs.labyrinth.actions import EXTENDED, IMPALA, commands
from zipf.envs.labyrinth.levels.skymaze import UNIT
from zipf.envs.labyrinth.mover import BELOW, WIDE, move
from zipf.envs.labyrinth.state import PITCH, VX, VY, VZ, YAW, Envs, X, Y, Z, make_envs

FRAMES_A_STEP = 4


class BoundPolicy:
    """Quake III's walk on endless level ground, written out."""

    def __init__(self) -> None:
        self.place = [0.0, 0.0]
        self.velocity = [0.0, 0.0]
        self.yaw = 0.0

    def frame(self, turn: float, strafe: float, forward: float) -> None:
        self.yaw += turn
        speed = math.sqrt(self.velocity[0] ** 2 + self.velocity[1] ** 2)
        if speed > 0:
            dropped = max(speed, 100.0) * 6.0 * 0.016
            kept = max(0.0, speed - dropped) / speed
            self.velocity = [kept * v for v in self.velocity]
        ahead = math.cos(self.yaw), math.sin(self.yaw)
        right = math.sin(self.yaw), -math.cos(self.yaw)
        wish = [forward * ahead[k] + strafe * right[k] for k in range(2)]
        length = math.sqrt(wish[0] ** 2 + wish[1] ** 2)
        if length > 0:
            wish = [w / length for w in wish]
            along = sum(v * w for v, w in zip(self.velocity, wish, strict=True))
            gain = min(10.0 * 0.016 * 320.0, 320.0 - along)
            if gain > 0:
                self.velocity = [v + gain * w for v, w in zip(self.velocity, wish, strict=True)]
        self.place = [p + v * 0.016 for p, v in zip(self.place, self.velocity, strict=True)]


def grid(solid: list[str]) -> Envs:
    """An env with a text map, rows from the north; `#` is solid, a digit a height of 10 units."""
    envs = make_envs(1)
    rows, columns = len(solid), len(solid[0])
    envs.cells[0] = rows, columns
    envs.solid[0] = True
    for row, line in enumerate(solid[::-1]):
        for column, letter in enumerate(line):
            envs.solid[0, row, column] = letter == "#"
            envs.floor[0, row, column] = 10.0 * int(letter) if letter.isdigit() else 0.0
    return envs


def plain() -> Envs:
    """Endless level ground."""
    return make_envs(1)


def stand(envs: Envs, x: float, y: float, yaw: float = 0.0, floor: float = 0.0) -> np.ndarray:
    body = envs.bodies[0]
    body[:] = 0.0
    body[X], body[Y], body[Z], body[YAW] = x, y, floor + BELOW, yaw
    return body


def frames(envs: Envs, count: int, *, strafe: float = 0.0, forward: float = 0.0) -> None:
    for _ in range(count):
        move(envs, 0, 0.0, 0.0, strafe, forward)


def speed(body: np.ndarray) -> float:
    return math.hypot(body[VX], body[VY])


def test_random_walks_are_those_of_the_slow_version() -> None:
    envs, slow = plain(), BoundPolicy()
    body = stand(envs, 0.0, 0.0)
    rng = np.random.default_rng(0)
    table = commands(15)
    for action in rng.integers(15, size=400).tolist():
        turn, rise, strafe, forward = table[action, :4].tolist()
        for _ in range(FRAMES_A_STEP):
            move(envs, 0, turn, rise, strafe, forward)
            slow.frame(turn, strafe, forward)
            assert body[X:Z].tolist() == pytest.approx(slow.place, abs=1e-6)
            assert body[VX:VZ].tolist() == pytest.approx(slow.velocity, abs=1e-6)
    assert body[Z] == BELOW
    assert body[VZ] == 0.0
    assert math.hypot(*slow.place) > 100


def test_speeding_up_and_slowing_down() -> None:
    """The table: full speed after about 10 frames, half of it 7 frames after letting go, rest
    after about 22; 20.5 units a step."""
    envs = plain()
    body = stand(envs, 0.0, 0.0)
    ramp = []
    for _ in range(30):
        frames(envs, 1, forward=1.0)
        ramp.append(speed(body))
    assert next(k for k, v in enumerate(ramp, 1) if v > 319.9) in range(8, 13)
    assert ramp[-1] == pytest.approx(320.0)
    before = body[X]
    frames(envs, FRAMES_A_STEP, forward=1.0)
    assert body[X] - before == pytest.approx(20.48, abs=1e-6)
    stop = []
    for _ in range(30):
        frames(envs, 1)
        stop.append(speed(body))
    assert next(k for k, v in enumerate(stop, 1) if v <= 160) == 7
    assert next(k for k, v in enumerate(stop, 1) if v == 0) in range(20, 24)


def test_who_walks_askew_is_not_faster() -> None:
    envs = plain()
    body = stand(envs, 0.0, 0.0)
    frames(envs, 40, strafe=1.0, forward=1.0)
    assert speed(body) == pytest.approx(320.0)
    assert body[X] == pytest.approx(-body[Y])  # to the right is to the south


@pytest.mark.parametrize(
    ("count", "name", "degrees"),
    [
        (15, "look slightly left", 4.22),
        (15, "look slightly right", -4.22),
        (15, "look left", 25.34),
        (15, "forward and right", -25.34),
        (9, "look left", 8.45),
        (9, "forward and right", -8.45),
    ],
)
def test_turns(count: int, name: str, degrees: float) -> None:
    env = make_vec(
        "labyrinth/explore_goal_locations_small", 1, num_actions=count, image_size=(1, 1)
    )
    env.reset(seed=0)
    yaw = env.envs.bodies[0, YAW]
    names = [action.name for action in (EXTENDED if count == 15 else IMPALA)]
    env.step(np.array([names.index(name)]))
    turned = math.degrees((env.envs.bodies[0, YAW] - yaw + math.pi) % (2 * math.pi) - math.pi)
    assert turned == pytest.approx(degrees, abs=0.01)


def test_looking_up_and_down_ends_near_the_vertical() -> None:
    env = make_vec("labyrinth/rooms_watermaze", 1, image_size=(1, 1))
    env.reset(seed=0)
    names = [action.name for action in EXTENDED]
    env.step(np.array([names.index("look up")]))
    assert math.degrees(env.envs.bodies[0, PITCH]) == pytest.approx(4.22, abs=0.01)
    for name, limit in (("look up", 89), ("look down", -89)):
        for _ in range(50):
            env.step(np.array([names.index(name)]))
        assert math.degrees(env.envs.bodies[0, PITCH]) == pytest.approx(limit)


def test_a_wall_stops_and_lets_slide() -> None:
    envs = grid(["#####", "#   #", "#####"])
    body = stand(envs, 150.0, 150.0, yaw=math.pi / 4)
    frames(envs, 10, forward=1.0)
    frames(envs, 30, forward=1.0)
    assert body[Y] == pytest.approx(200.0 - WIDE, abs=1e-3)  # at the north wall
    assert body[VY] == 0.0
    # Along it: half a second of more than 0.7 of the speed.
    assert body[X] > 150.0 + 0.7 * 320 * 30 * 0.016 - 40 or body[X] == pytest.approx(385.0)
    frames(envs, 100, forward=1.0)
    assert body[X] == pytest.approx(400.0 - WIDE, abs=1e-3)  # in the corner
    assert speed(body) < 60


def test_nobody_gets_through_walls() -> None:
    """A thousand steps in a narrow maze; the box never touches a solid cell."""
    envs = grid(["#######", "#     #", "# ### #", "# # # #", "#   # #", "#######"])
    body = stand(envs, 150.0, 150.0)
    rng = np.random.default_rng(1)
    table = commands(15)
    visited = set()
    for action in rng.choice([0, 0, 1, 2, 3, 6, 7, 12, 13], size=1000).tolist():
        for _ in range(FRAMES_A_STEP):
            move(envs, 0, *table[action, :4])
            for x in (body[X] - WIDE, body[X] + WIDE):
                for y in (body[Y] - WIDE, body[Y] + WIDE):
                    assert not envs.solid[0, int(y // 100), int(x // 100)]
        visited.add((int(body[Y] // 100), int(body[X] // 100)))
    assert len(visited) >= 5


def test_a_wall_also_stops_who_is_closer_than_bodies_are_kept() -> None:
    """In the air a step can be shorter than the distance that is kept from walls."""
    envs = grid(["####", "#  #", "#  #", "####"])
    envs.box_count[0] = 1
    envs.boxes[0, 0] = 100.0, 280.0, 0.0, 300.0, 300.0, 80.0
    for yaw, axis, face in ((0.0, X, 300.0), (math.pi / 2, Y, 280.0)):
        body = stand(envs, 200.0, 200.0, yaw)
        body[axis] = face - WIDE - 5e-7
        frames(envs, 30, forward=1.0)
        assert face - WIDE - 1e-5 < body[axis] < face - WIDE


def test_boxes_block_and_low_ones_do_not() -> None:
    envs = plain()
    envs.box_count[0] = 1
    for top, blocked in ((18.0, False), (18.5, True), (80.0, True)):
        envs.boxes[0, 0] = 100.0, -50.0, 0.0, 130.0, 50.0, top
        body = stand(envs, 0.0, 0.0)
        frames(envs, 60, forward=1.0)
        assert (body[X] == pytest.approx(100.0 - WIDE, abs=1e-3)) == blocked
    envs.boxes[0, 0] = 100.0, -50.0, 60.0, 130.0, 50.0, 80.0  # above the head
    body = stand(envs, 0.0, 0.0)
    frames(envs, 60, forward=1.0)
    assert body[X] > 150


def test_steps_of_eighteen_units_can_be_climbed() -> None:
    envs = grid(["#####", "#012#", "#####"])
    body = stand(envs, 150.0, 150.0)
    frames(envs, 60, forward=1.0)
    assert body[X] > 350
    assert body[Z] == pytest.approx(20.0 + BELOW)
    envs = grid(["#####", "#02 #", "#####"])
    body = stand(envs, 150.0, 150.0)
    frames(envs, 60, forward=1.0)
    assert body[X] == pytest.approx(200.0 - WIDE, abs=1e-3)
    assert body[Z] == BELOW
    assert UNIT > 18.0  # no platform of the skymazes can be climbed


def test_falling() -> None:
    """800 units per second squared, in frames of 0.016 s, and little control in the air."""
    envs = grid(["####", "#9 #", "####"])
    body = stand(envs, 150.0, 150.0, floor=90.0)
    while body[Z] == 90.0 + BELOW:
        frames(envs, 1, forward=1.0)
    height, fall, count = 90.0, 0.0, 0
    heights = [body[Z] - BELOW]
    while body[Z] > BELOW:
        frames(envs, 1)
        heights.append(body[Z] - BELOW)
    while height > 0:
        fall += 800 * 0.016
        height -= fall * 0.016
        count += 1
    assert len(heights) == pytest.approx(count, abs=1)
    drops = -np.diff(heights)[:-1]
    assert np.diff(drops) == pytest.approx(np.full(len(drops) - 1, 800 * 0.016**2), abs=1e-6)


def test_a_round_room_holds_the_player() -> None:
    env = make_vec("labyrinth/rooms_watermaze", 8, image_size=(1, 1))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(300):
        env.step(rng.choice([0, 0, 0, 12, 13], size=8))
        for i in range(8):
            body, planes = env.envs.bodies[i], env.envs.planes[i, : env.envs.plane_count[i]]
            reach = planes[:, :2] @ body[:2] + WIDE * abs(planes[:, :2]).sum(1)
            assert (reach <= planes[:, 2] + 1.0).all()


def test_on_a_desert_the_soles_are_on_the_ground() -> None:
    env = make_vec("labyrinth/natlab_varying_map_regrowth", 8, image_size=(1, 1))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    moved = np.zeros(8)
    for _ in range(300):
        before = env.envs.bodies[:, :2].copy()
        env.step(rng.choice([0, 0, 0, 12, 13], size=8))
        moved += np.hypot(*(env.envs.bodies[:, :2] - before).T)
        for i, episode in enumerate(env.episodes):
            x, y, z = env.envs.bodies[i, :3].tolist()
            side = 2048.0
            assert WIDE - 1 <= x <= side - WIDE + 1
            assert WIDE - 1 <= y <= side - WIDE + 1
            assert z - BELOW >= episode.terrain.height(x, y) - 1e-6
    assert (moved > 500).all()
