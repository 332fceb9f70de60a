"""The compiled calls of Chipmunk beside pymunk's own methods."""

from typing import Any

import numpy as np
import pytest

from zipf.envs.playroom import chipmunk
from zipf.envs.playroom.constants import FRAME, FRAMES, FURNITURE_SIZE
from zipf.envs.playroom.falling import _fall
from zipf.envs.playroom.room import Room
from zipf.envs.playroom.state import ANGLE, AX, AY, ON_BED, YAW, X, Y, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

ENVS, OBJECTS = 3, 4


def rooms(seed: int) -> list[Room]:
    """Rooms whose objects lie around the agent, so that it pushes them."""
    rng = np.random.default_rng(seed)
    made = [Room(OBJECTS, furnished=True) for _ in range(ENVS)]
    for room in made:
        places = rng.uniform(-1.5, 1.5, (OBJECTS, 2))
        sizes = rng.uniform(0.1, 0.5, (OBJECTS, 2))
        angles = rng.uniform(-3, 3, (OBJECTS, 1))
        objects = np.concatenate([places, angles, sizes], axis=1)
        room.begin([0.0, 0.0], objects.tolist(), [[1.2, 1.5, 0.3], [-1.5, -1.5, 0.1]])
    return made


@pytest.mark.parametrize("seed", range(3))
def test_compiled_physics_is_pymunks(seed: int) -> None:
    """To the bit, for the envs of the mask, where others stay as they are."""
    ours, theirs = rooms(seed), rooms(seed)
    found = [room.addresses() for room in ours]
    spaces = np.array([space for space, _ in found])
    bodies = np.array([of_room for _, of_room in found])
    agents, objects = np.zeros((ENVS, 6)), np.zeros((ENVS, OBJECTS, 5))
    rng = np.random.default_rng(seed)
    pushed = 0.0
    for step in range(60):
        forces = rng.uniform(-400, 400, (ENVS, 2)) * (rng.random((ENVS, 1)) < 0.8)
        mask = rng.random(ENVS) < 0.7
        before = agents.copy(), objects.copy()
        chipmunk.simulate(mask, chipmunk.functions(), spaces, bodies, forces, agents, objects)
        for i, room in enumerate(theirs):
            if not mask[i]:
                assert (agents[i] == before[0][i]).all()
                assert (objects[i] == before[1][i]).all()
                continue
            for _ in range(FRAMES):
                room.agent.force = tuple(forces[i])
                room.space.step(FRAME)
            assert tuple(agents[i, [AX, AY]]) == tuple(room.agent.position)
            for j, body in enumerate(room.objects):
                assert tuple(objects[i, j, [X, Y, ANGLE]]) == (*body.position, body.angle)
        if step:
            pushed = max(pushed, abs(objects[:, :, X] - before[1][:, :, X])[mask].max(initial=0))
    assert pushed > 0.05
    assert not agents[:, YAW].any()


def carry(room: Room, held: int, agent: Any, item: Any, drive: Any) -> None:
    """What `chipmunk.move_held` does, by pymunk's own methods."""
    body = room.agent
    (x, y), (vx, vy) = body.position, body.velocity
    dx, dy = agent[0] - x, agent[1] - y
    if dx != 0 or dy != 0:
        body.position = agent[0], agent[1]
        back = (vx * dx + vy * dy) / (dx * dx + dy * dy)
        if back < 0:
            body.velocity = vx - back * dx, vy - back * dy
    if held >= 0:
        vx, vy = body.velocity
        room.objects[held].position = item[0], item[1]
        room.objects[held].velocity = vx + drive[0], vy + drive[1]
        room.objects[held].angular_velocity = 0.0


@pytest.mark.parametrize("seed", range(3))
def test_what_is_held_moves_as_by_pymunk(seed: int) -> None:
    """To the bit: held, just released and neither, in the envs of the mask."""
    ours, theirs = rooms(seed), rooms(seed)
    bodies = np.array([room.addresses()[1] for room in ours])
    rng = np.random.default_rng(seed)
    slowed = 0
    for _ in range(40):
        mask = rng.random(ENVS) < 0.8
        hands = rng.integers(-1, OBJECTS, ENVS)
        turned = np.where(hands < 0, rng.integers(-1, OBJECTS, ENVS), -1)
        agents, objects = rng.normal(size=(ENVS, 6)), rng.normal(size=(ENVS, OBJECTS, 5))
        drives, velocities = rng.normal(size=(ENVS, 2)), rng.normal(size=(ENVS, 2))
        for i in range(ENVS):
            for room in (ours[i], theirs[i]):
                room.agent.velocity = tuple(velocities[i])
            if rng.random() < 0.3:
                agents[i, [AX, AY]] = ours[i].agent.position
        chipmunk.move_held(
            mask, chipmunk.functions(), bodies, hands, turned, drives, agents, objects
        )
        for i in range(ENVS):
            if mask[i] and max(hands[i], turned[i]) >= 0:
                item = objects[i, hands[i], [X, Y]]
                carry(theirs[i], hands[i], agents[i, [AX, AY]], item, drives[i])
            for one, two in zip(ours[i].bodies, theirs[i].bodies, strict=True):
                assert one.position == two.position
                assert one.velocity == two.velocity
                assert one.angular_velocity == two.angular_velocity
            slowed += tuple(ours[i].agent.velocity) != tuple(velocities[i])
    assert slowed


def test_a_world_without_a_room_is_not_simulated() -> None:
    """The compiled code would work on what is at address 0."""
    env = PlayroomVectorEnv(2, image_size=(1, 1))
    env.reset(seed=0)
    env._spaces[1] = 0
    with pytest.raises(AssertionError, match="no physics of an env"):
        env.step(np.zeros(2, np.int64))


def test_addresses_are_of_the_episode() -> None:
    """A new episode has another space, and the same bodies."""
    room = rooms(0)[0]
    space, bodies = room.addresses()
    kept = room.space  # or its memory might be used again
    room.begin([0.5, 0.0], [[1.0, 1.0, 0.0, 0.2, 0.2]] * OBJECTS, [[1.2, 1.5, 0.3]] * 2)
    assert room.space is not kept
    assert room.addresses()[0] != space
    assert room.addresses()[1] == bodies


@pytest.mark.parametrize(("height", "lands"), [(0.36, True), (0.34, False)])
def test_what_flies_in_above_the_edge_of_the_bed_lands_on_it(height: float, lands: bool) -> None:
    """Also where it has fallen below the edge within the step: the physics lets it through the
    sides that were below it when the step began."""
    furniture = np.array([[0.0, 0.0, 0.0], [1.5, 1.5, 0.0]])
    item = np.array([-0.6, 0.0, 0.0, height, 0.0])  # 0.1 m inside in the last of four frames
    status = _fall(item, np.array([-1.3, 0.0]), True, furniture)
    assert (status == ON_BED) == lands
    assert (item[Z] == FURNITURE_SIZE[0, 2]) == lands
