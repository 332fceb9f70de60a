"""Playrooms with given poses, for the tests of rules and actions."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zipf.envs.playroom import actions
from zipf.envs.playroom.constants import AGENT_RADIUS, CEILING, EYE, ROOM
from zipf.envs.playroom.layout import begin
from zipf.envs.playroom.state import AIR, AX, AY, PITCH, YAW, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

KINDS = ("lift/lift_shape_zipf3", "put/put_on_bed_tray_all", "supervised/find_shape_uniform")
"""A level for each task."""
BED = (-1.2, 0.0, 0.0)
"""Against the western wall: x from -1.9 to -0.5, y from -0.45 to 0.45."""
TRAY = (0.8, 1.2, 0.0)
"""x from 0.5 to 1.1, y from 0.975 to 1.425."""
AWAY = ((1.7, 1.7), (-1.7, 1.7), (1.7, -1.7), (-1.7, -1.7), (-0.6, 1.7), (-0.6, -1.7))
"""Positions in corners, where objects do not interfere."""


def playroom(level: str = "lift/lift_shape_uniform", **options: Any) -> PlayroomVectorEnv:
    """One env without autoreset, with an image of one pixel unless `image_size` is given."""
    options = {"image_size": (1, 1), "autoreset_mode": "Disabled", **options}
    return PlayroomVectorEnv(1, level, **options)


def arrange(
    env: PlayroomVectorEnv,
    agent: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    items: Mapping[int, Sequence[float]] | None = None,
    names: Sequence[str] = ("bottle", "candle", "robot", "train", "boat", "mug"),
    *,
    task: str | None = None,
    furniture: Sequence[Sequence[float]] = (BED, TRAY),
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Begins an episode and then sets the poses.

    Args:
        env: one env.
        agent: x, y, yaw and pitch.
        items: x, y, angle and height of objects, 0 being the target; the others are in corners.
        names: the objects, target first.
        task: such as "on bed".

    Returns:
        The observation.
    """
    count = env.envs.ranks.shape[1]
    ranks = dict(
        zip(env.situation, [env.object_names.index(name) for name in names[:count]], strict=False)
    )
    if task is not None:
        ranks["task"] = ("lift", "near bed", "near tray", "on bed", "on tray").index(task)
    env.reset(seed=seed, options=ranks)
    env.envs.agents[0, :4] = agent
    env.envs.objects[0] = 0.0
    env.envs.objects[0, :, :2] = AWAY[:count]
    for j, pose in (items or {}).items():
        env.envs.objects[0, j, : len(pose)] = pose
    env.envs.furniture[0] = furniture
    everywhere = np.ones(1, np.bool_)
    begin(everywhere, env.envs)
    env.envs.status[0, env.envs.objects[0, :, Z] > 0] = AIR
    env._furnish(0)
    env._view.begin(everywhere)
    return env.observations()


def act(env: PlayroomVectorEnv, *names: str | int) -> Any:
    """Takes actions by name or number; returns the last step's result."""
    result = None
    for name in names:
        action = actions.ACTIONS.index(name) if isinstance(name, str) else name
        result = env.step(np.full(env.num_envs, action))
    return result


def look_at(env: PlayroomVectorEnv, item: int) -> None:
    """Turns the agent's view to the middle of an object, at once."""
    agent = env.envs.agents[0]
    x, y, _, z, _ = env.envs.objects[0, item]
    middle = z + env.envs.extents[env.envs.ranks[0, item], 2] / 2
    dx, dy = x - agent[AX], y - agent[AY]
    agent[YAW] = np.arctan2(dy, dx)
    agent[PITCH] = np.arctan2(middle - EYE, np.hypot(dx, dy))


def outcome(result: Any) -> tuple[float, bool, bool, bool | None]:
    """Reward, terminated, truncated and success (None while the episode goes on)."""
    _, reward, terminated, truncated, info = result
    success = bool(info["success"][0]) if "success" in info else None
    return float(reward[0]), bool(terminated[0]), bool(truncated[0]), success


RUNS = (0.0, False, False, None)
DONE = (1.0, True, False, True)
FAILED = (0.0, True, False, False)
TIMEOUT = (0.0, False, True, False)


def wait(env: PlayroomVectorEnv, limit: int = 12) -> tuple[float, bool, bool, bool | None]:
    """Takes NOOP until the episode ends, at most `limit` times; returns the outcome."""
    for _ in range(limit):
        end = outcome(act(env, "NOOP"))
        if end != RUNS:
            return end
    return RUNS


def check_held(env: PlayroomVectorEnv, i: int) -> None:
    """Raises unless the held object of env `i` is in view, in the room and outside of the agent.

    By the corners of its rotated bounding box and points between them.
    """
    envs = env.envs
    item, (x, y, yaw, pitch) = envs.hands[i], envs.agents[i, :4]
    frame, extent = envs.orientation[i, item], envs.extents[envs.ranks[i, item]]
    surface = np.array(list(itertools.product((-0.5, -0.25, 0, 0.25, 0.5), repeat=3)))
    offsets = (surface * extent) @ frame.T
    middle = np.append(envs.objects[i, item, :2], envs.objects[i, item, Z] - offsets[:, 2].min())
    points = middle + offsets
    assert np.abs(points[:, :2]).max() <= ROOM / 2 + 1e-6
    assert points[:, 2].min() >= -1e-6
    assert points[:, 2].max() <= CEILING + 1e-6
    assert np.hypot(points[:, 0] - x, points[:, 1] - y).min() > AGENT_RADIUS
    ahead = middle - (x, y, EYE)
    aside = np.cos(yaw) * ahead[1] - np.sin(yaw) * ahead[0]
    flat = np.cos(yaw) * ahead[0] + np.sin(yaw) * ahead[1]
    assert abs(np.arctan2(aside, flat)) < 1e-6
    assert abs(np.arctan2(ahead[2], flat) - pitch) < np.radians(25) + 1e-6
