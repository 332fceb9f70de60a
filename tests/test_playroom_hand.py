"""The hand: gripping, holding, throwing and releasing objects, and pushing by the body."""

import math
from typing import Any

import numpy as np
import pytest
from playroom_envs import BED, TRAY, act, arrange, check_held, look_at, playroom

from zipf.envs.playroom.actions import ACTIONS, CONTROL_TABLE
from zipf.envs.playroom.constants import AGENT_RADIUS, CEILING, EYE, FURNITURE_SIZE, ROOM
from zipf.envs.playroom.geometry import rectangle_gap
from zipf.envs.playroom.holding import CLEARANCE
from zipf.envs.playroom.state import ANGLE, FLOOR, HELD, HOLD, ON_BED, ON_TRAY, PITCH, YAW, X, Y, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

FREE = "put/put_on_bed_tray_all"  # lifting does not end the episode


def held(env: PlayroomVectorEnv) -> int:
    """The held object, or -1; checks that `hands` and `status` agree."""
    item = int(env.envs.hands[0])
    np.testing.assert_array_equal(
        np.flatnonzero(env.envs.status[0] == HELD), [item] if item >= 0 else []
    )
    return item


def gap(env: PlayroomVectorEnv, item: int, piece: int) -> float:
    """The distance of an object's centre from a piece of furniture, 0 above it."""
    x, y = env.envs.objects[0, item, :2]
    return rectangle_gap(env.envs.furniture[0, piece], FURNITURE_SIZE[piece], x, y)


def distances(env: PlayroomVectorEnv) -> np.ndarray:
    """The distances of the objects from the agent."""
    return np.linalg.norm(env.envs.objects[0, :, :2] - env.envs.agents[0, :2], axis=1)


def half_width(env: PlayroomVectorEnv) -> float:
    """Of the first object."""
    return float(env.envs.extents[env.envs.ranks[0, 0], 0]) / 2


# Gripping.


@pytest.mark.parametrize(
    ("distance", "reach", "taken"),
    [(0.7, 2.0, True), (1.7, 2.0, True), (2.1, 2.0, False), (1.7, 1.5, False), (2.1, 2.5, True)],
)
def test_the_hand_reaches_two_metres(distance: float, reach: float, taken: bool) -> None:
    env = playroom(reach=reach)
    arrange(env, (-1.5, 0, 0, 0), {0: (-1.5 + distance, 0)})
    look_at(env, 0)
    act(env, "GRAB")
    assert held(env) == (0 if taken else -1)


def test_the_hand_grips_the_object_it_points_at() -> None:
    env = playroom()
    poses = {0: (1.0, 0.4), 1: (1.0, -0.4), 2: (0.9, 0.0)}
    for item in range(3):
        arrange(env, items=poses)
        look_at(env, item)
        act(env, "GRAB")
        assert held(env) == item
    arrange(env, (0, 0, 0, 0), poses)
    act(env, "GRAB")  # at the wall
    assert held(env) == -1


@pytest.mark.parametrize(("aside", "taken"), [(0.1, True), (0.16, False)])
def test_the_hand_may_point_slightly_beside_an_object(aside: float, taken: bool) -> None:
    env = playroom()
    arrange(env, items={0: (1.0, 0.0)}, names=("bottle", "dice", "robot"))
    look_at(env, 0)
    env.envs.agents[0, YAW] += aside
    act(env, "GRAB")
    assert held(env) == (0 if taken else -1)


@pytest.mark.parametrize("distance", [1.15, 2.0])
def test_the_nearer_object_is_gripped(distance: float) -> None:
    env = playroom()
    arrange(env, items={0: (1.5, 0), 1: (distance, 0)}, names=("bottle", "chair", "robot"))
    look_at(env, 0)
    act(env, "GRAB")
    assert held(env) == (1 if distance < 1.5 else 0)


@pytest.mark.parametrize("level", ["lift/lift_shape_uniform", FREE])
def test_an_object_behind_the_bed_is_not_gripped(level: str) -> None:
    env = playroom(level)
    arrange(env, (-1.2, 1.1, 0, 0), {0: (-1.2, -0.6)})
    look_at(env, 0)
    act(env, "GRAB")
    assert held(env) == (-1 if env.level.furnished else 0)


@pytest.mark.parametrize(("place", "height"), [(BED, 0.35), (TRAY, 0.03)])
def test_an_object_on_a_support_is_gripped(place: Any, height: float) -> None:
    env = playroom(FREE)
    arrange(env, items={0: (0.8 * place[0], 0.9 * place[1], 0, height)}, task="on bed")
    look_at(env, 0)
    act(env, "GRAB")
    assert held(env) == 0


# Holding.


def test_further_gripping_keeps_the_object() -> None:
    env = playroom(FREE)
    arrange(env, items={0: (1.0, 0.3), 1: (1.0, -0.3)}, task="on bed")
    look_at(env, 0)
    for _ in range(4):
        act(env, "GRAB")
        assert held(env) == 0
    for _ in range(6):  # past the other object
        act(env, "GRAB_AND_LOOK_RIGHT_MID")
        assert held(env) == 0


@pytest.mark.parametrize("action", np.flatnonzero(CONTROL_TABLE[:, -1] == 0))
def test_the_first_action_that_does_not_grip_lets_go(action: int) -> None:
    env = playroom(FREE)
    arrange(env, items={0: (1.0, 0.0)}, task="on bed")
    look_at(env, 0)
    act(env, "GRAB", *["GRAB_AND_LOOK_UP_FULL"] * 3)
    height = env.envs.objects[0, 0, Z]
    assert height > 0.3
    act(env, int(action))
    assert held(env) == -1, ACTIONS[action]
    assert env.envs.objects[0, 0, Z] < height


@pytest.mark.parametrize("action", np.flatnonzero(CONTROL_TABLE[:, -1] == 1))
def test_every_gripping_action_holds(action: int) -> None:
    env = playroom(FREE)
    arrange(env, items={0: (1.0, 0.0)}, task="on bed")
    look_at(env, 0)
    act(env, "GRAB", int(action), int(action))
    assert held(env) == 0, ACTIONS[action]


def test_looking_up_raises_an_object_to_the_ceiling_at_most() -> None:
    env = playroom(FREE)
    arrange(env, items={0: (1.2, 0.0)}, task="on bed")
    look_at(env, 0)
    act(env, "GRAB", *["GRAB_AND_PUSH_AWAY_FULL"] * 6, *["GRAB_AND_LOOK_UP_FULL"] * 9)
    top = env.envs.objects[0, 0, Z] + env.envs.extents[env.envs.ranks[0, 0], 2]
    assert top == pytest.approx(CEILING)
    act(env, *["GRAB_AND_LOOK_DOWN_FULL"] * 14)
    assert env.envs.objects[0, 0, Z] == 0


@pytest.mark.parametrize("yaw", np.linspace(-3, 3, 7))
def test_a_held_object_stays_in_the_room(yaw: float) -> None:
    env = playroom(FREE)
    place = 0.9 * math.cos(yaw), 0.9 * math.sin(yaw)
    arrange(env, (0, 0, yaw, 0), {0: place}, ("dice", "candle", "robot"), task="on bed",
            furniture=((-1.2, 1.5, 0.0), (1.2, 1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB")
    rng = np.random.default_rng(0)
    for action in rng.choice([18, 18, 18, 20, 22, 23, 24, 25, 41], size=150).tolist():
        act(env, int(action))
        assert held(env) == 0
        check_held(env, 0)
    assert np.abs(env.envs.objects[0, 0, :2]).max() > 1.2


@pytest.mark.parametrize("name", ["bottle", "guitar", "keyboard", "umbrella", "dice"])
@pytest.mark.parametrize("place", [(1.0, 0.0), (1.2, 1.2)])
def test_a_held_object_has_room_at_walls_and_in_corners(
    name: str, place: tuple[float, float]
) -> None:
    env = playroom(FREE)
    arrange(env, (0.2, 0.2, 0, 0), {0: place}, (name, "candle", "robot"), task="on bed",
            furniture=((-1.2, -1.5, 0.0), (1.2, -1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB")
    walk, turn, down = "MOVE_FORWARD_FULL", "LOOK_LEFT_FULL", "LOOK_DOWN_FULL"
    spins = ["SPIN_UP"] * 4 + ["SPIN_FORWARD"] * 3 + ["SPIN_RIGHT"] * 2
    up = ["LOOK_UP_FULL"] * 8
    for move in [*[walk] * 9, *spins, *[turn, walk] * 12, *[down] * 6, *spins, *[turn] * 9, *up]:
        act(env, f"GRAB_AND_{move}")
        assert held(env) == 0
        check_held(env, 0)


def test_a_held_object_keeps_the_agent_from_the_wall() -> None:
    env = playroom(FREE)
    arrange(env, (0.5, 0, 0, 0), {0: (1.3, 0.0)}, ("dice", "candle", "robot"), task="on bed",
            furniture=((-1.2, -1.5, 0.0), (1.2, -1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB", *["GRAB_AND_LOOK_UP_FULL"] * 3, *["GRAB_AND_MOVE_FORWARD_FULL"] * 12)
    wide = env.envs.extents[env.envs.ranks[0, 0], 0]
    assert env.envs.objects[0, 0, X] == pytest.approx(ROOM / 2 - wide / 2, abs=1e-6)
    gap = env.envs.objects[0, 0, X] - env.envs.agents[0, 0]
    assert gap == pytest.approx(AGENT_RADIUS + wide / 2 + CLEARANCE, abs=1e-6)
    # Without the object, the agent reaches the wall.
    act(env, "NOOP", "MOVE_LEFT_FULL", *["MOVE_FORWARD_FULL"] * 20)
    assert env.envs.agents[0, 0] > env.envs.objects[0, 0, X] - wide / 2 - AGENT_RADIUS - 0.05


def test_the_agent_walks_over_the_tray() -> None:
    env = playroom(FREE)
    arrange(env, (-0.5, 1.2, 0, 0), task="on bed")
    act(env, *["MOVE_FORWARD_FULL"] * 8)
    assert env.envs.agents[0, 0] > 1.2
    # But not through an object there.
    arrange(env, (-0.5, 1.2, 0, 0), {0: (0.8, 1.2, 0.0, 0.03)}, task="on bed")
    act(env, "NOOP", *["MOVE_FORWARD_FULL"] * 4)
    assert env.envs.agents[0, 0] < env.envs.objects[0, 0, X] - AGENT_RADIUS
    act(env, *["MOVE_FORWARD_FULL"] * 8)
    assert env.envs.status[0, 0] == FLOOR
    assert env.envs.objects[0, 0, X] > 1.1


@pytest.mark.parametrize("height", [0.0, 0.05, 0.12, 0.2])
@pytest.mark.parametrize("move", ["MOVE_FORWARD_FULL", "PUSH_AWAY_FULL"])
def test_an_object_held_low_does_not_enter_the_bed(height: float, move: str) -> None:
    env = playroom(FREE)
    arrange(env, (0.9, 0.05, math.pi, 0), {0: (-0.2, 0.05)}, task="on tray",
            furniture=(BED, (1.2, 1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB")
    for _ in range(25):
        # Keep it at this height at any distance.
        agent = env.envs.agents[0]
        below = height + env.envs.extents[env.envs.ranks[0, 0], 2] / 2 - EYE
        agent[PITCH] = math.asin(max(below / agent[HOLD], -0.95))
        act(env, f"GRAB_AND_{move}")
        assert held(env) == 0
        assert gap(env, 0, 0) > 0.02
    assert gap(env, 0, 0) < 0.25


def test_an_object_held_high_goes_over_the_bed() -> None:
    env = playroom(FREE)
    arrange(env, (0.4, 0, math.pi, 0), {0: (-0.3, 0)}, task="on tray",
            furniture=(BED, (1.2, 1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB", *["GRAB_AND_LOOK_UP_FULL"] * 2, *["GRAB_AND_MOVE_FORWARD_FULL"] * 8)
    assert gap(env, 0, 0) == 0
    # It cannot be pushed into the mattress.
    act(env, *["GRAB_AND_LOOK_DOWN_FULL"] * 4)
    assert env.envs.objects[0, 0, Z] == 0.35


# Releasing.


def test_a_released_object_falls_to_the_floor() -> None:
    env = playroom(FREE)
    arrange(env, items={0: (1.0, 0.0, 0.0, 1.0)}, task="on bed")
    heights = [1.0]
    while heights[-1] > 0:
        act(env, "NOOP")
        heights.append(env.envs.objects[0, 0, Z])
    # By g t^2 / 2 it takes 0.45 s, between three and four actions.
    assert len(heights) == 5
    assert (np.diff(heights[:4], 2) < 0).all()
    assert env.envs.status[0, 0] == FLOOR
    act(env, *["NOOP"] * 5)
    assert env.envs.objects[0, 0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("place", "height", "where"),
    [(BED, 0.35, ON_BED), (TRAY, 0.03, ON_TRAY)],
)
def test_an_object_released_over_a_support_lands_on_it(
    place: Any, height: float, where: int
) -> None:
    env = playroom(FREE)
    spot = place[0] + 0.1, place[1] - 0.1
    arrange(env, (0, -1.2, 0, 0), {1: (*spot, 0.0, 1.2)}, task="on bed")
    act(env, *["NOOP"] * 8)
    assert env.envs.objects[0, 1, Z] == height
    assert env.envs.status[0, 1] == where
    np.testing.assert_allclose(env.envs.objects[0, 1, :2], spot)


@pytest.mark.parametrize("side", [0.02, 0.1, 0.2])
def test_an_object_that_falls_beside_the_bed_ends_beside_it(side: float) -> None:
    env = playroom(FREE)
    names = ("dice", "candle", "robot")
    arrange(env, (1.0, 0, 0, 0), {0: (-0.5 + side, 0.0, 0.0, 1.0)}, names, task="on bed")
    act(env, *["NOOP"] * 20)
    assert env.envs.objects[0, 0, Z] == 0
    assert env.envs.status[0, 0] == FLOOR
    assert gap(env, 0, 0) > 0.85 * half_width(env)


def test_a_throw_keeps_its_momentum() -> None:
    env = playroom(FREE)
    arrange(env, (-1.0, -1.0, 0, 0), {0: (0.0, -1.0)}, task="on bed",
            furniture=((0, 1.5, 0.0), (-1.2, 1.5, 0.0)))  # fmt: skip
    look_at(env, 0)
    act(env, "GRAB", "GRAB_AND_LOOK_UP_FULL", *["GRAB_AND_LOOK_LEFT_FULL"] * 3)
    before = env.envs.objects[0, 0, :3].copy()
    places = []
    for _ in range(5):
        act(env, "NOOP")
        places.append(env.envs.objects[0, 0, :2].copy())
    flight = places[0] - before[:2]
    tangent = np.array([-math.sin(env.envs.agents[0, YAW]), math.cos(env.envs.agents[0, YAW])])
    assert np.linalg.norm(flight) > 0.1
    assert flight @ tangent > 0.8 * np.linalg.norm(flight)  # the direction of the hand
    moves = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (np.diff(moves) < 0).all()


def test_a_spun_object_stands_up_again() -> None:
    env = playroom(FREE)
    for spins in (["SPIN_UP"] * 7, ["SPIN_FORWARD"] * 4, ["SPIN_RIGHT"] * 3, ["SPIN_DOWN"] * 4):
        arrange(env, items={0: (1.0, 0.0)}, task="on bed")
        look_at(env, 0)
        act(env, "GRAB", "GRAB_AND_LOOK_UP_FULL", *[f"GRAB_AND_{spin}" for spin in spins])
        act(env, *["NOOP"] * 12)
        np.testing.assert_allclose(env.envs.orientation[0, 0, :, 2], [0, 0, 1], atol=1e-12)
        angle = env.envs.objects[0, 0, ANGLE]
        np.testing.assert_allclose(
            env.envs.orientation[0, 0, :2, 0], [math.cos(angle), math.sin(angle)]
        )
        if spins[0] == "SPIN_RIGHT":
            assert math.degrees(angle) == pytest.approx(-72)


def test_an_object_released_on_another_ends_beside_it() -> None:
    env = playroom()
    arrange(env, items={0: (1.0, 0.0, 0.0, 1.0), 1: (1.05, 0.02)}, names=("dice", "dice", "ball"))
    act(env, *["NOOP"] * 30)
    assert env.envs.objects[0, :, Z].tolist() == [0, 0, 0]
    assert np.linalg.norm(
        env.envs.objects[0, 0, :2] - env.envs.objects[0, 1, :2]
    ) > 1.9 * half_width(env)


def test_an_object_that_falls_on_the_agent_ends_beside_it() -> None:
    env = playroom()
    arrange(env, items={0: (0.01, 0.0, 0.0, 2.0)}, names=("dice", "dice", "ball"))
    act(env, *["NOOP"] * 30)
    assert env.envs.objects[0, 0, Z] == 0
    assert np.linalg.norm(
        env.envs.objects[0, 0, :2] - env.envs.agents[0, :2]
    ) > AGENT_RADIUS + 0.85 * half_width(env)


# Pushing with the body.


def test_the_body_pushes_loose_objects() -> None:
    env = playroom()
    arrange(env, (-1.5, 0, 0, 0), {0: (-0.7, 0.0), 1: (0.3, 0.05)}, ("dice", "dice", "ball"))
    act(env, *["MOVE_FORWARD_FULL"] * 9)
    x = env.envs.objects[0, :2, X]
    assert x[0] > 0.0
    assert x[1] > 0.6
    assert env.envs.objects[0, :2, Z].tolist() == [0, 0]
    assert (np.abs(env.envs.objects[0, :, :2]) < ROOM / 2 - 0.05).all()
    np.testing.assert_array_less(AGENT_RADIUS, distances(env))


@pytest.mark.parametrize("place", [BED, TRAY])
def test_furniture_does_not_move(place: Any) -> None:
    env = playroom(FREE)
    arrange(
        env, (0.0, 0, math.pi if place[0] < 0 else 0, 0), {0: (place[0] * 0.3, 0.0)}, task="on bed"
    )
    before = env.envs.furniture.copy()
    act(env, *["MOVE_FORWARD_FULL"] * 25)
    np.testing.assert_array_equal(env.envs.furniture, before)
    piece = 0 if place is BED else 1
    x, y = env.envs.agents[0, :2]
    pose, size = env.envs.furniture[0, piece], FURNITURE_SIZE[piece]
    assert rectangle_gap(pose, size, x, y) > AGENT_RADIUS - 0.02
    assert gap(env, 0, piece) > 0.05
    assert env.envs.objects[0, 0, Z] == 0


def test_the_body_does_not_push_an_object_on_the_bed() -> None:
    env = playroom(FREE)
    arrange(env, (0.5, 0, math.pi, 0), {0: (-0.55, 0.0, 0.0, 0.35)}, task="on bed")
    act(env, *["MOVE_FORWARD_FULL"] * 15)
    np.testing.assert_allclose(env.envs.objects[0, 0, [X, Y, Z]], [-0.55, 0, 0.35])
