"""The 46 actions: names and magnitudes are the published ones, signs are tested by rendering."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from playroom_envs import act, arrange, look_at, playroom

from zipf.envs.playroom.actions import ACTIONS, CONTROL_TABLE, CONTROLS
from zipf.envs.playroom.constants import DAMPING, EYE, STEP
from zipf.envs.playroom.geometry import set_upright
from zipf.envs.playroom.hand import HIGHEST, LOWEST
from zipf.envs.playroom.state import AX, AY, HOLD, PITCH, YAW, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

# Carvalho et al. 2021, table 7; magnitudes from public code for Hill et al. 2020.
MOVES = [
    ("MOVE_FORWARD_FULL", "move", 1.0),
    ("MOVE_BACKWARD_FULL", "move", -1.0),
    ("MOVE_RIGHT_FULL", "strafe", 1.0),
    ("MOVE_LEFT_FULL", "strafe", -1.0),
    ("LOOK_RIGHT_FULL", "turn", 1.0),
    ("LOOK_LEFT_FULL", "turn", -1.0),
    ("LOOK_DOWN_FULL", "look", -1.0),
    ("LOOK_UP_FULL", "look", 1.0),
    ("MOVE_RIGHT_SLIGHTLY", "strafe", 0.05),
    ("MOVE_LEFT_SLIGHTLY", "strafe", -0.05),
    ("LOOK_DOWN_MID", "look", -0.03),
    ("LOOK_UP_MID", "look", 0.03),
    ("LOOK_RIGHT_MID", "turn", 0.2),
    ("LOOK_LEFT_MID", "turn", -0.2),
    ("LOOK_RIGHT_SLIGHTLY", "turn", 0.05),
    ("LOOK_LEFT_SLIGHTLY", "turn", -0.05),
]
SPINS = [
    ("SPIN_RIGHT", "spin_right", 1.0),
    ("SPIN_LEFT", "spin_right", -1.0),
    ("SPIN_UP", "spin_up", 1.0),
    ("SPIN_DOWN", "spin_up", -1.0),
    ("SPIN_FORWARD", "spin_forward", 1.0),
    ("SPIN_BACKWARD", "spin_forward", -1.0),
    ("PULL_CLOSER_FULL", "push", -1.0),
    ("PUSH_AWAY_FULL", "push", 1.0),
    ("PULL_CLOSER_MID", "push", -0.5),
    ("PUSH_AWAY_MID", "push", 0.5),
]


def test_the_table_is_the_published_one() -> None:
    rows: list[tuple[str, dict[str, float]]] = [("NOOP", {})]
    rows += [(name, {control: value}) for name, control, value in MOVES]
    rows += [("GRAB", {"grip": 1.0})]
    rows += [
        (f"GRAB_AND_{name}", {control: value, "grip": 1.0})
        for name, control, value in MOVES + SPINS
    ]
    rows += [(name, {control: value}) for name, control, value in SPINS[-2:]]
    assert len(rows) == 46
    assert tuple(name for name, _ in rows) == ACTIONS
    for (name, expected), given in zip(rows, CONTROL_TABLE, strict=True):
        pressed = {c: v for c, v in zip(CONTROLS, given.tolist(), strict=True) if v}
        assert pressed == expected, name


# Signs, in the image.


def watched(level: str = "lift/lift_shape_uniform") -> PlayroomVectorEnv:
    return playroom(level, image_size=(72, 96))


def pixels(env: PlayroomVectorEnv, item: int = 0) -> NDArray[np.bool_]:
    """The pixels that show an object, bool [72, 96]: those that change when it is hidden."""
    with_it = env.observations()["image"][0]
    scenes = env._view.scenes
    mesh = int(scenes.mesh[0, item])
    scenes.mesh[0, item] = -1
    without = env.observations()["image"][0]
    scenes.mesh[0, item] = mesh
    return (with_it != without).any(-1)


def middle(seen: NDArray[np.bool_]) -> tuple[float, float]:
    """Mean row and column of the pixels."""
    assert seen.sum() > 5
    row, column = np.argwhere(seen).mean(0)
    return float(row), float(column)


@pytest.mark.parametrize(
    ("action", "down", "right"),
    [
        ("MOVE_RIGHT_FULL", 0, -1),
        ("MOVE_LEFT_FULL", 0, 1),
        ("LOOK_RIGHT_FULL", 0, -1),
        ("LOOK_LEFT_FULL", 0, 1),
        ("LOOK_RIGHT_MID", 0, -1),
        ("LOOK_LEFT_MID", 0, 1),
        ("LOOK_UP_FULL", 1, 0),
        ("LOOK_DOWN_FULL", -1, 0),
    ],
)
@pytest.mark.parametrize("hand", ["", "GRAB_AND_"])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_image_moves_against_the_view(
    action: str, down: int, right: int, hand: str, yaw: float
) -> None:
    env = watched()
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    arrange(env, (*-0.7 * ahead, yaw, -0.3), {0: 1.4 * ahead})
    before = middle(pixels(env))
    act(env, hand + action)
    assert env.envs.hands[0] == -1  # it is out of reach
    moved = np.subtract(middle(pixels(env)), before)
    along = moved @ [down, right]
    assert along > 1
    assert along > 2 * abs(moved @ [right, down])


def test_slight_strafing_has_the_same_sign() -> None:
    env = watched()
    arrange(env)
    act(env, *["MOVE_RIGHT_SLIGHTLY"] * 8)
    assert env.envs.agents[0, AY] < -0.01
    arrange(env)
    act(env, *["GRAB_AND_MOVE_LEFT_SLIGHTLY"] * 8)
    assert env.envs.agents[0, AY] > 0.01


def test_going_forward_enlarges_objects_ahead() -> None:
    env = watched()
    arrange(env, (-0.5, 0, 0, -0.3), {0: (1.2, 0)})
    sizes = [pixels(env).sum()]
    act(env, *["MOVE_FORWARD_FULL"] * 4)
    sizes.append(pixels(env).sum())
    act(env, *["MOVE_BACKWARD_FULL"] * 9)
    sizes.append(pixels(env).sum())
    assert sizes[1] > 1.2 * sizes[0]
    assert sizes[2] < 0.9 * sizes[1]


def test_looking_up_shows_the_ceiling_and_down_the_floor() -> None:
    env = watched()
    arrange(env)

    def seen(flat: int) -> float:
        """The share of the image that a flat covers: the floor or the ceiling."""
        image = env.observations()["image"]
        scenes = env._view.scenes
        looks = scenes.flat_looks[0, flat].copy()
        scenes.flat_looks[0, flat] = -1
        hidden = env.observations()["image"]
        scenes.flat_looks[0, flat] = looks
        return float((image != hidden).any(-1).mean())

    act(env, *["LOOK_UP_FULL"] * 12)
    assert env.envs.agents[0, PITCH] == HIGHEST
    assert seen(1) > 0.5
    assert seen(0) == 0
    act(env, *["LOOK_DOWN_FULL"] * 20)
    assert env.envs.agents[0, PITCH] == LOWEST
    assert seen(0) > 0.5
    assert seen(1) == 0


# Amounts.


@pytest.mark.parametrize(
    ("action", "column", "degrees"),
    [
        ("LOOK_RIGHT_FULL", YAW, -16),
        ("LOOK_LEFT_FULL", YAW, 16),
        ("LOOK_RIGHT_MID", YAW, -3.2),
        ("LOOK_LEFT_MID", YAW, 3.2),
        ("LOOK_RIGHT_SLIGHTLY", YAW, -0.8),
        ("LOOK_LEFT_SLIGHTLY", YAW, 0.8),
        ("LOOK_DOWN_FULL", PITCH, -12),
        ("LOOK_UP_FULL", PITCH, 12),
        ("LOOK_DOWN_MID", PITCH, -0.36),
        ("LOOK_UP_MID", PITCH, 0.36),
    ],
)
@pytest.mark.parametrize("hand", ["", "GRAB_AND_"])
def test_how_far_an_action_turns(action: str, column: int, degrees: float, hand: str) -> None:
    env = playroom()
    arrange(env)
    act(env, *[hand + action] * 3)
    turned = env.envs.agents[0, [YAW, PITCH]]
    expected = np.where(np.array([YAW, PITCH]) == column, 3 * degrees, 0)
    np.testing.assert_allclose(np.degrees(turned), expected, atol=1e-9)
    np.testing.assert_allclose(env.envs.agents[0, :2], 0, atol=1e-9)


def test_yaw_wraps_around() -> None:
    env = playroom()
    arrange(env)
    yaws = []
    for _ in range(50):
        act(env, "LOOK_LEFT_FULL")
        yaws.append(env.envs.agents[0, YAW])
    assert -math.pi <= min(yaws) < -3
    assert 3 < max(yaws) <= math.pi
    assert yaws[44] == pytest.approx(0, abs=1e-9)  # 45 times 16 degrees are two turns


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -2.5])
@pytest.mark.parametrize(
    ("action", "aside"),
    [
        ("MOVE_FORWARD_FULL", 0.0),
        ("MOVE_LEFT_FULL", math.pi / 2),
        ("MOVE_BACKWARD_FULL", math.pi),
        ("MOVE_RIGHT_FULL", -math.pi / 2),
    ],
)
def test_the_agent_has_momentum(yaw: float, action: str, aside: float) -> None:
    env = playroom()
    heading = np.array([math.cos(yaw + aside), math.sin(yaw + aside)])
    start = -1.5 * heading / np.abs(heading).max()
    corners = [(1.7, 1.7), (1.7, -1.7), (-1.7, 1.7), (-1.7, -1.7)]
    free = sorted(corners, key=lambda corner: abs(np.dot(corner, heading)))  # out of the way
    arrange(env, (*start, yaw, 0), dict(enumerate([*free[:2], free[2]])))
    places = [env.envs.agents[0, :2].copy()]
    for name in [action] * 6 + ["NOOP"] * 6:
        act(env, name)
        places.append(env.envs.agents[0, :2].copy())
    moves = np.diff(places, axis=0) / STEP
    speeds = moves @ heading
    np.testing.assert_allclose(moves, np.outer(speeds, heading), atol=1e-9)
    # It takes time to start ...
    assert (np.diff(speeds[:6]) > 0).all()
    assert speeds[0] < 0.5 * speeds[5]
    # ... and to stop: half of the speed is left after each action.
    assert speeds[6] > 0.7 * speeds[5]
    slower = math.exp(-DAMPING * STEP)
    np.testing.assert_allclose(speeds[7:] / speeds[6:-1], slower, rtol=1e-6)


def test_the_agents_top_speed() -> None:
    env = playroom()
    for action, share in (("MOVE_FORWARD_FULL", 1.0), ("MOVE_RIGHT_SLIGHTLY", 0.05)):
        arrange(env, (-1.7, 0, 0 if share == 1 else math.pi / 2, 0))
        speeds = []
        for _ in range(9):
            before = env.envs.agents[0, AX]
            act(env, action)
            speeds.append((env.envs.agents[0, AX] - before) / STEP)
        assert 0.96 * share * 2.7 < max(speeds[:7]) < share * 2.75


# The held object, in the image.


def holding(name: str = "duck", facing: float = 0.0, distance: float = 1.2) -> PlayroomVectorEnv:
    """An env whose agent holds an object near the floor, turned by `facing` radians."""
    env = watched("put/put_on_bed_tray_all")  # lifting does not end the episode
    arrange(
        env, (0, 0, 0, 0), {0: (distance, 0, facing)}, [name, "candle", "dice"], furniture=APART
    )
    look_at(env, 0)
    act(env, "GRAB")
    assert env.envs.hands[0] == 0
    return env


APART = ((-1.2, 0.0, 0.0), (-0.2, 1.4, 0.0))


@pytest.mark.parametrize("action", ["LOOK_RIGHT_FULL", "LOOK_LEFT_FULL", "LOOK_UP_FULL"])
def test_a_held_object_stays_in_the_middle_of_the_view(action: str) -> None:
    env = holding("bottle")
    before = env.envs.agents.copy()
    act(env, *[f"GRAB_AND_{action}"] * 4, "GRAB")
    row, column = middle(pixels(env))
    assert abs(row - 35.5) < 3
    assert abs(column - 47.5) < 3
    assert np.degrees(np.abs(env.envs.agents - before).max()) > 45


def test_looking_up_raises_the_held_object() -> None:
    env = holding()
    heights = [env.envs.objects[0, 0, Z]]
    for _ in range(5):
        act(env, "GRAB_AND_LOOK_UP_FULL")
        heights.append(env.envs.objects[0, 0, Z])
    assert (np.diff(heights) > 0.05).all()
    act(env, "GRAB_AND_LOOK_DOWN_FULL")
    assert env.envs.objects[0, 0, Z] < heights[-1]


@pytest.mark.parametrize("amount", ["FULL", "MID"])
def test_pushing_makes_it_smaller_and_pulling_larger(amount: str) -> None:
    env = holding()
    act(env, *["GRAB_AND_LOOK_UP_FULL"] * 2)
    sizes = [pixels(env).sum()]
    act(env, *[f"GRAB_AND_PUSH_AWAY_{amount}"] * 2, "GRAB")
    sizes.append(pixels(env).sum())
    act(env, *[f"GRAB_AND_PULL_CLOSER_{amount}"] * 4, "GRAB")
    sizes.append(pixels(env).sum())
    assert sizes[1] < 0.95 * sizes[0]
    assert sizes[2] > 1.05 * sizes[0]


def test_how_far_an_action_pushes() -> None:
    env = holding()
    distance = env.envs.agents[0, HOLD]
    for action, step in (
        ("GRAB_AND_PULL_CLOSER_FULL", -2 / 15),
        ("GRAB_AND_PULL_CLOSER_MID", -1 / 15),
        ("GRAB_AND_PUSH_AWAY_FULL", 2 / 15),
        ("GRAB_AND_PUSH_AWAY_MID", 1 / 15),
    ):
        act(env, action)
        distance += step
        assert env.envs.agents[0, HOLD] == pytest.approx(distance)


@pytest.mark.parametrize(("action", "right"), [("SPIN_RIGHT", 1), ("SPIN_LEFT", -1)])
def test_spinning_right_turns_the_front_to_the_right(action: str, right: int) -> None:
    """The duck's head is above its front, so it appears on that side of the body."""
    env = holding("duck")
    act(env, "GRAB_AND_LOOK_UP_FULL", *[f"GRAB_AND_{action}"] * 4)
    seen = pixels(env)
    rows = np.flatnonzero(seen.any(1))
    head, body = seen.copy(), seen.copy()
    head[rows[len(rows) // 3] :] = False
    body[: rows[len(rows) // 2]] = False
    assert np.sign(middle(head)[1] - middle(body)[1]) == right
    assert abs(middle(head)[1] - middle(body)[1]) > 1.5
    front = env.envs.orientation[0, 0, :, 0]
    np.testing.assert_allclose(np.degrees(np.arctan2(front[1], front[0])), -96 * right)


@pytest.mark.parametrize(("action", "right"), [("SPIN_FORWARD", 1), ("SPIN_BACKWARD", -1)])
def test_spinning_forward_tips_the_top_to_the_right(action: str, right: int) -> None:
    env = holding("bottle")
    act(env, "GRAB_AND_LOOK_UP_FULL", f"GRAB_AND_{action}")
    rows, columns = np.argwhere(pixels(env)).T
    assert np.cov(rows, columns)[0, 1] * right < -5  # rows are counted from the top
    assert env.envs.orientation[0, 0, 2, 2] == pytest.approx(math.cos(math.radians(24)))


@pytest.mark.parametrize(("action", "up"), [("SPIN_UP", 1), ("SPIN_DOWN", -1)])
@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_spinning_up_turns_the_front_up(action: str, up: int, yaw: float) -> None:
    """From the agent's right side, where the agent's forward direction is to the right."""
    env = holding("bus")
    env.envs.agents[0, YAW] = yaw
    act(env, *["GRAB"] * 4)
    set_upright(env.envs.orientation[0, 0], yaw)
    act(env, "GRAB_AND_LOOK_UP_FULL", f"GRAB_AND_{action}")
    x, y, _, z, _ = env.envs.objects[0, 0]
    env.envs.agents[0, :4] = (
        x + 1.2 * math.sin(yaw),
        y - 1.2 * math.cos(yaw),
        yaw + math.pi / 2,
        0,
    )
    env.envs.agents[0, PITCH] = math.atan2(z + 0.1 - EYE, 1.2)
    rows, columns = np.argwhere(pixels(env)).T
    assert np.cov(rows, columns)[0, 1] * up < -3
    assert env.envs.orientation[0, 0, 2, 0] == pytest.approx(up * math.sin(math.radians(24)))


def test_opposite_spins_cancel() -> None:
    env = holding("duck", 0.7)
    before = env.envs.orientation.copy()
    spins = ["SPIN_RIGHT", "SPIN_UP", "SPIN_FORWARD"]
    back = ["SPIN_BACKWARD", "SPIN_DOWN", "SPIN_LEFT"]
    act(env, *[f"GRAB_AND_{name}" for name in spins])
    assert np.abs(env.envs.orientation - before).max() > 0.3
    act(env, *[f"GRAB_AND_{name}" for name in back])
    np.testing.assert_allclose(env.envs.orientation, before, atol=1e-12)


@pytest.mark.parametrize("action", ["PULL_CLOSER_MID", "PUSH_AWAY_MID"])
def test_an_empty_hand_pushes_nothing(action: str) -> None:
    env = watched()
    arrange(env, items={0: (0.8, 0)})
    look_at(env, 0)
    before = env.observations()["image"]
    image = act(env, action)[0]["image"]
    np.testing.assert_array_equal(image, before)
