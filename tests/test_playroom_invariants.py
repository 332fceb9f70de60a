"""Under any actions, objects stay in the room, outside of each other, and finite."""

import numpy as np
import pytest
from conftest import slow_but
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from playroom_envs import check_held

from zipf.envs.playroom.actions import ACTIONS, GRAB
from zipf.envs.playroom.constants import AGENT_RADIUS, CEILING, FURNITURE_SIZE, ROOM
from zipf.envs.playroom.falling import STILL_STEPS
from zipf.envs.playroom.hand import HIGHEST, LOWEST, NEAREST_HOLD
from zipf.envs.playroom.state import AIR, AX, AY, BASE, FLOOR, HELD, HOLD, ON_BED, PITCH, YAW, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

LEVELS = ("lift/lift_shape_uniform", "put/put_on_bed_tray_all", "put/lift_shape_many_zipf1")
N = 3
OVERLAP = 0.15
"""How deep an object may be in a wall or in furniture for a moment, metres: the agent moves 0.09 m
in one frame."""


class Endless(PlayroomVectorEnv):
    """Episodes do not terminate, so that anything can happen in them."""

    def _advance(self, actions: NDArray[np.int64], mask: NDArray[np.bool_]) -> tuple:
        reward, terminated, truncated, success = super()._advance(actions, mask)
        assert ((reward == 0) | (reward == 1)).all()
        assert (success == (reward == 1)).all()
        assert not (terminated & truncated).any()
        return reward, np.zeros_like(terminated), truncated, success


def inside(pose: NDArray, size: NDArray, x: float, y: float) -> float:
    """How deep a point is in a rectangle, 0 outside."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    depth = min(size[0] - abs(cos * dx + sin * dy), size[1] - abs(cos * dy - sin * dx))
    return max(depth, 0.0)


def check(env: PlayroomVectorEnv, ranks: NDArray[np.int64], overlap: float = OVERLAP) -> None:
    """Raises unless the state of all envs is consistent."""
    envs, half = env.envs, ROOM / 2
    np.testing.assert_array_equal(envs.ranks, ranks)
    for values in (envs.agents, envs.objects, envs.orientation):
        assert np.isfinite(values).all()
    # Everything is in the room.
    assert (np.abs(envs.agents[:, [AX, AY]]) <= half - AGENT_RADIUS + overlap).all()
    width = envs.extents[envs.ranks, :2].min(-1) / 2
    assert (np.abs(envs.objects[:, :, :2]).max(-1) <= half - width + overlap).all()
    heights, tops = envs.objects[:, :, Z], envs.extents[envs.ranks, 2]
    held = envs.status == HELD
    assert (heights >= 0).all()
    assert (heights + tops <= CEILING + 1e-9)[~held].all()
    # Angles and the hand are in range.
    assert (np.abs(envs.agents[:, YAW]) <= np.pi).all()
    assert (envs.agents[:, PITCH] >= LOWEST).all()
    assert (envs.agents[:, PITCH] <= HIGHEST).all()
    assert (held.sum(1) == (envs.hands >= 0)).all()
    for i in np.flatnonzero(envs.hands >= 0):
        assert held[i, envs.hands[i]]
        assert NEAREST_HOLD <= envs.agents[i, HOLD] <= envs.reach
        assert envs.agents[i, BASE] >= 0
        check_held(env, i)
    product = np.einsum("njrk,njrl->njkl", envs.orientation, envs.orientation)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(envs.orientation), 1, atol=1e-9)
    # The status agrees with the poses.
    top = np.array([0, 0, 0, FURNITURE_SIZE[0, 2], FURNITURE_SIZE[1, 2]])
    resting = (envs.status != AIR) & ~held
    np.testing.assert_array_equal(heights[resting], top[envs.status][resting])
    assert (envs.still <= STILL_STEPS).all()
    if not env.level.furnished:
        assert (envs.status <= HELD).all()
        return
    for i in range(env.num_envs):
        pieces = list(zip(envs.furniture[i], FURNITURE_SIZE, strict=True))
        for k, (pose, size) in enumerate(pieces):
            # A held object may slide onto the tray, but reaches the bed only from above.
            assert k == 1 or inside(pose, size, *envs.agents[i, :2]) == 0
            for j in range(envs.objects.shape[1]):
                depth = inside(pose, size, *envs.objects[i, j, :2])
                low = held[i, j] and k == 0 and envs.objects[i, j, Z] < 0.25
                if envs.status[i, j] == ON_BED + k:
                    assert depth > 0
                elif low or envs.status[i, j] == FLOOR:
                    assert depth <= overlap


def play(env: PlayroomVectorEnv, actions: NDArray[np.int64]) -> None:
    ranks = env.envs.ranks.copy()
    for row in actions:
        env.step(row)
        check(env, ranks)
    for _ in range(15):
        env.step(np.zeros(N, np.int64))
    check(env, ranks, 0.03)


def repeated_actions(rng: np.random.Generator, steps: int) -> NDArray[np.int64]:
    """Random actions, each repeated for a while: independent ones would stay in place."""
    actions = np.empty((steps, N), np.int64)
    for i in range(N):
        t = 0
        while t < steps:
            length = int(rng.integers(1, 12))
            closed = GRAB * (rng.random() < 0.6)
            usual = rng.random() < 0.5
            action = closed + int(rng.integers(0, 9)) if usual else int(rng.integers(46))
            actions[t : t + length, i] = action
            t += length
    return actions


@pytest.mark.parametrize("level", slow_but(LEVELS, LEVELS[0]))
@given(seed=st.integers(0, 2**32), repeated=st.booleans())
@example(seed=9638, repeated=True)  # walks with a held object between the bed and a wall
@example(seed=2145, repeated=True)  # walks onto the tray with a held object
@example(seed=2509, repeated=True)  # pushes an object between the bed and a wall
@example(seed=17848, repeated=False)  # throws an object along the floor at the tray
@settings(max_examples=12, deadline=None)
def test_the_state_stays_consistent_under_any_actions(
    level: str, seed: int, repeated: bool
) -> None:
    env = Endless(N, level, image_size=(1, 1))
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    play(env, repeated_actions(rng, 120) if repeated else rng.integers(46, size=(120, N)))


# Tight corners.


def test_pushing_into_corners_for_minutes() -> None:
    """In every env the agent moves with full force and turns now and then."""
    env = Endless(N, LEVELS[2], image_size=(1, 1))
    for seed in range(2):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        actions = np.repeat(rng.choice([1, 1, 1, 2, 3, 4, 5, 6], size=(60, N)), 9, axis=0)
        play(env, actions)


def test_throwing_at_walls_and_furniture() -> None:
    env = Endless(N, LEVELS[1], image_size=(1, 1))
    rng = np.random.default_rng(0)
    turn, up, far = (
        ACTIONS.index(f"GRAB_AND_{name}")
        for name in ("LOOK_LEFT_FULL", "LOOK_UP_FULL", "PUSH_AWAY_FULL")
    )
    flying = 0
    for seed in range(12):
        env.reset(seed=seed)
        for i in range(N):  # held from the start, wherever the object is
            env.envs.hands[i], env.envs.status[i, 0] = 0, HELD
            env.envs.agents[i, HOLD] = 1.5
        ranks = env.envs.ranks.copy()
        swing = [turn] * int(rng.integers(3, 9)) + [up] * int(rng.integers(4)) + [far] * 2 + [turn]
        for action in [*swing, *[0] * 12]:
            before = env.envs.objects[:, 0, :2].copy()
            env.step(np.full(N, action))
            check(env, ranks)
            moved = np.linalg.norm(env.envs.objects[:, 0, :2] - before, axis=1)
            flying += int(((env.envs.status[:, 0] == AIR) & (moved > 0.1)).sum())
    assert flying > 20


def test_overlapping_objects_are_separated() -> None:
    """Six objects in one place, near a corner."""
    for corner in (1.75, 1.0):
        env = Endless(N, LEVELS[2], image_size=(1, 1))
        env.reset(seed=0)
        for i in range(N):
            room = env.rooms[i]
            assert room is not None
            for j, body in enumerate(room.objects):
                sign = np.sign(-env.envs.furniture[i, 0, :2] - env.envs.furniture[i, 1, :2])
                body.position = tuple(sign * (corner - 0.01 * j))
                room.space.reindex_shapes_for_body(body)
        for _ in range(60):
            env.step(np.zeros(N, np.int64))
        assert np.isfinite(env.envs.objects).all()
        assert (np.abs(env.envs.objects[:, :, :2]) < ROOM / 2).all()
        for i in range(N):
            for j in range(1, 6):
                gaps = np.linalg.norm(
                    env.envs.objects[i, :j, :2] - env.envs.objects[i, j, :2], axis=1
                )
                assert gaps.min() > 0.05
