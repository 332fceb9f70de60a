"""Rewards and the ends of episodes."""

import math
from typing import Any

import numpy as np
import pytest
from playroom_envs import (
    DONE,
    FAILED,
    RUNS,
    TIMEOUT,
    act,
    arrange,
    look_at,
    outcome,
    playroom,
    wait,
)

from zipf.envs.playroom.achieved import achieved
from zipf.envs.playroom.constants import FURNITURE_SIZE
from zipf.envs.playroom.falling import STILL_MOTION
from zipf.envs.playroom.geometry import rectangle_gap
from zipf.envs.playroom.state import ON_BED, X, Y, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

# Lifting.


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf3", "put/lift_shape_many_zipf1"])
@pytest.mark.parametrize(("item", "end"), [(0, DONE), (1, FAILED), (2, FAILED)])
def test_lifting(level: str, item: int, end: Any) -> None:
    env = playroom(level)
    arrange(env, items={item: (1.0, 0.0)}, task="lift" if level.startswith("put") else None)
    look_at(env, item)
    assert outcome(act(env, "GRAB")) == RUNS
    result = act(env, "GRAB_AND_LOOK_UP_FULL")
    assert env.envs.objects[0, item, Z] >= 0.15
    assert outcome(result) == end


def test_lifting_takes_fifteen_centimetres() -> None:
    env = playroom()
    arrange(env, items={0: (1.0, 0.0)})
    look_at(env, 0)
    result = act(env, "GRAB")
    while env.envs.objects[0, 0, Z] < 0.15:
        assert outcome(result) == RUNS
        result = act(env, "GRAB_AND_LOOK_UP_MID")
    assert outcome(result) == DONE


def test_the_height_counts_from_where_the_object_was() -> None:
    env = playroom("put/lift_shape_uniform")
    arrange(env, items={0: (-0.7, 0.0, 0.0, 0.35)}, task="lift")
    look_at(env, 0)
    result = act(env, "GRAB")
    while env.envs.objects[0, 0, Z] < 0.5:
        assert outcome(result) == RUNS
        result = act(env, "GRAB_AND_LOOK_UP_MID")
    assert outcome(result) == DONE


def test_another_object_of_the_same_rank_counts_as_the_target() -> None:
    env = playroom()
    arrange(env, items={2: (1.0, 0.0)}, names=("bottle", "candle", "bottle"))
    look_at(env, 2)
    act(env, "GRAB")
    assert outcome(act(env, *["GRAB_AND_LOOK_UP_FULL"])) == DONE


def test_pushing_is_not_lifting() -> None:
    env = playroom()
    arrange(env, (-1, 0, 0, 0), items={0: (0.0, 0.0)})
    assert outcome(act(env, *["MOVE_FORWARD_FULL"] * 30)) == RUNS
    assert env.envs.objects[0, 0, X] > 0.3
    assert not env.envs.lifted.any()


# Putting.

PLACES = {
    "on bed": (-0.8, 0.1, 0.0, 0.35),
    "on tray": (0.75, 1.15, 0.0, 0.03),
    "near bed": (-1.1, -0.85),
    "near tray": (0.8, 0.7),
    "far away": (1.0, -1.2),
}


def put(env: PlayroomVectorEnv, item: int, place: str, task: str, lifted: bool = True) -> None:
    """Puts an object somewhere, as if it had just come to rest after it was lifted."""
    arrange(env, (0.2, -0.2, 0, 0), {item: PLACES[place]}, task=task)
    env.envs.lifted[0, item] = lifted


@pytest.mark.parametrize("near_failure", [False, True])
@pytest.mark.parametrize("item", [0, 1, 2])
@pytest.mark.parametrize("place", list(PLACES))
@pytest.mark.parametrize("task", ["on bed", "on tray", "near bed", "near tray"])
def test_putting(task: str, place: str, item: int, near_failure: bool) -> None:
    relation, support = task.split()
    where, what = place.split()
    if place == "far away" or (relation == "on" and where == "near"):
        expected = RUNS
    elif item == 0 and what == support:
        expected = DONE  # where it should be near a support, it may also be on it
    elif where == "near" and not near_failure:
        expected = RUNS  # the paper: near a support, only the right object counts
    else:
        expected = FAILED
    env = playroom(f"put/put_{relation}_bed_tray_frequent", near_failure=near_failure)
    put(env, item, place, task)
    assert outcome(act(env, "NOOP")) == RUNS  # at rest takes two actions
    result = act(env, "NOOP")
    assert outcome(result) == expected
    if expected == RUNS:
        assert outcome(act(env, *["NOOP"] * 5)) == RUNS


def test_another_object_of_the_same_rank_that_was_put_is_what_was_achieved() -> None:
    env = playroom("put/put_near_bed_tray_frequent")
    env.report_achieved()
    items = {1: PLACES["near bed"]}
    arrange(env, (0.2, -0.2, 0, 0), items, ("bottle", "bottle", "candle"), task="near bed")
    env.envs.lifted[0, 1] = True
    assert outcome(act(env, *["NOOP"] * 2)) == DONE
    assert achieved(env.envs, 0) == (1, env.envs.task[0])


@pytest.mark.parametrize("near_failure", [False, True])
def test_what_did_not_end_the_episode_is_not_achieved_when_time_is_up(near_failure: bool) -> None:
    """An episode that had asked for it would have ended before."""
    level = "put/put_near_bed_tray_frequent"
    env = playroom(level, near_failure=near_failure, max_steps=4)
    env.report_achieved()
    put(env, 1, "near bed", "near bed")
    end, steps = RUNS, 0
    while end == RUNS:
        result, steps = act(env, "NOOP"), steps + 1
        end = outcome(result)
    assert (end, steps) == ((FAILED, 2) if near_failure else (TIMEOUT, 4))
    assert result[4]["has_achieved"].tolist() == [near_failure]


@pytest.mark.parametrize("task", ["on bed", "on tray", "near bed", "near tray"])
@pytest.mark.parametrize("place", list(PLACES))
def test_an_object_that_was_never_lifted_does_not_count(task: str, place: str) -> None:
    env = playroom("put/put_on_bed_tray_all")
    put(env, 0, place, task, lifted=False)
    assert outcome(act(env, *["NOOP"] * 6)) == RUNS


@pytest.mark.parametrize(("gap", "near"), [(0.49, True), (0.51, False)])
@pytest.mark.parametrize("corner", [False, True])
def test_near_is_half_a_metre_from_the_edge(gap: float, near: bool, corner: bool) -> None:
    env = playroom("put/put_near_bed_tray_frequent")
    aside = gap / math.sqrt(2)
    place = (-0.5 + aside, -0.45 - aside) if corner else (-1.2, -0.45 - gap)
    arrange(env, (1.0, 0, 0, 0), {0: place}, task="near bed")
    env.envs.lifted[0, 0] = True
    assert outcome(act(env, "NOOP", "NOOP")) == (DONE if near else RUNS)


def test_a_held_object_does_not_count_as_put() -> None:
    env = playroom("put/put_near_bed_tray_frequent")
    arrange(env, (-1.1, -1.6, 0, 0), {0: (-1.1, -0.85)}, task="near bed")
    env.envs.lifted[0, 0] = True
    look_at(env, 0)
    assert outcome(act(env, *["GRAB"] * 8)) == RUNS
    assert wait(env) == DONE


def test_a_moving_object_does_not_count_as_put() -> None:
    env = playroom("put/put_near_bed_tray_frequent")
    put(env, 0, "near bed", "near bed")
    env.rooms[0].objects[0].velocity = 0.6, 0.0
    steps = 0
    result = act(env, "NOOP")
    while outcome(result) == RUNS:
        motion = env.envs.objects[0, 0, X]
        result = act(env, "NOOP")
        motion = env.envs.objects[0, 0, X] - motion
        steps += 1
    assert outcome(result) == DONE
    assert steps >= 4
    assert motion < STILL_MOTION


def test_an_object_that_falls_onto_the_support_counts_at_rest() -> None:
    env = playroom("put/put_on_bed_tray_all")
    arrange(env, (0.5, 0, 0, 0), {0: (-0.8, 0.1, 0.0, 1.2)}, task="on bed")
    env.envs.lifted[0, 0] = True
    heights = []
    result = act(env, "NOOP")
    while outcome(result) == RUNS:
        heights.append(env.envs.objects[0, 0, Z])
        result = act(env, "NOOP")
    assert outcome(result) == DONE
    assert min(heights) == 0.35
    # The two actions at rest count only after it has landed.
    assert 3 <= len(heights) <= 6


def test_an_object_pushed_against_a_support_does_not_count() -> None:
    for piece, agent, item in (
        (0, (0.4, 0.0, math.pi, 0.0), (-0.1, 0.0)),
        (1, (0.8, 0.0, math.pi / 2, 0.0), (0.8, 0.5)),
    ):
        env = playroom("put/put_near_bed_tray_frequent")
        arrange(env, agent, {0: item}, task=("near bed", "near tray")[piece])
        assert outcome(act(env, *["MOVE_FORWARD_FULL"] * 6)) == RUNS
        assert wait(env) == RUNS
        x, y = env.envs.objects[0, 0, [X, Y]]
        size = FURNITURE_SIZE[piece]
        assert rectangle_gap(env.envs.furniture[0, piece], size, x, y) < 0.3


def test_an_object_dropped_elsewhere_can_be_gripped_again() -> None:
    env = playroom("put/put_on_bed_tray_all")
    put(env, 0, "far away", "on bed")
    assert wait(env) == RUNS
    look_at(env, 0)
    act(env, "GRAB")
    assert env.envs.hands[0] == 0
    env.envs.objects[0, 0, :4] = PLACES["on bed"]
    env.rooms[0].objects[0].position = PLACES["on bed"][:2]
    assert wait(env) == DONE


def test_putting_by_hand() -> None:
    """From gripping the object to releasing it over the bed, by actions alone."""
    for item, end in ((0, DONE), (1, FAILED)):
        env = playroom("put/put_on_bed_tray_all")
        arrange(env, (0.9, 0, math.pi, 0), {item: (-0.1, 0.0)}, task="on bed")
        look_at(env, item)
        raised = ["GRAB", *["GRAB_AND_LOOK_UP_FULL"] * 2, *["GRAB_AND_MOVE_FORWARD_FULL"] * 7]
        assert outcome(act(env, *raised, *["GRAB"] * 4)) == RUNS
        assert wait(env) == end
        assert env.envs.status[0, item] == ON_BED


# Finding.


def find(env: PlayroomVectorEnv, names: tuple[str, str], item: int) -> Any:
    """Walks to one of two objects."""
    arrange(env, (0, 0, 0, 0), {0: (0.8, 0.8), 1: (0.8, -0.8)}, names)
    look_at(env, item)
    result = act(env, "MOVE_FORWARD_FULL")
    while outcome(result) == RUNS:
        before = env.envs.agents.copy()
        result = act(env, "MOVE_FORWARD_FULL")
    gaps = [
        np.linalg.norm(env.envs.objects[0, item, :2] - a[0, :2]) for a in (before, env.envs.agents)
    ]
    assert gaps[1] < 0.7 <= gaps[0]
    return result


@pytest.mark.parametrize(("item", "end"), [(0, DONE), (1, FAILED)])
def test_finding(item: int, end: Any) -> None:
    env = playroom("supervised/find_shape_uniform")
    assert outcome(find(env, ("duck", "book"), item)) == end
    assert outcome(find(playroom("supervised/find_shape_zipf2"), ("duck", "duck"), item)) == DONE


@pytest.mark.parametrize(("target_side", "end"), [(0.5, FAILED), (0.45, DONE)])
def test_between_two_objects_the_nearer_one_counts(target_side: float, end: Any) -> None:
    """Both come within 0.7 m in one step of an agent that walks straight ahead."""
    env = playroom("supervised/find_shape_uniform")
    aside = 0.95 - target_side
    arrange(env, (0, 0, 0, 0), {0: (0.7, target_side), 1: (0.7, -aside)}, ("duck", "book"))
    result = act(env, "MOVE_FORWARD_FULL")
    while outcome(result) == RUNS:
        result = act(env, "MOVE_FORWARD_FULL")
    gaps = [math.hypot(*(env.envs.objects[0, j, :2] - env.envs.agents[0, :2])) for j in (0, 1)]
    assert max(gaps) < 0.7
    assert outcome(result) == end
    assert achieved(env.envs, 0) == ((0 if end == DONE else 1), env.envs.task[0])


# Time.


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf3", "put/put_on_bed_tray_all"])
def test_episodes_are_truncated_after_900_actions(level: str) -> None:
    env = playroom(level)
    env.reset(seed=0)
    for _ in range(899):
        assert outcome(act(env, "NOOP")) == RUNS
    result = act(env, "NOOP")
    assert outcome(result) == TIMEOUT
    assert result[4]["length"].tolist() == [900]
    assert result[4]["return"].tolist() == [0.0]


@pytest.mark.parametrize(("max_steps", "end"), [(1, TIMEOUT), (2, DONE), (3, DONE)])
def test_success_at_the_last_action_counts(max_steps: int, end: Any) -> None:
    env = playroom("put/put_on_bed_tray_all", max_steps=max_steps)
    put(env, 0, "on bed", "on bed")
    results = [outcome(act(env, "NOOP"))]
    while results[-1] == RUNS:
        results.append(outcome(act(env, "NOOP")))
    assert results[-1] == end
    assert len(results) == min(max_steps, 2)


def test_failure_at_the_last_action_is_not_a_truncation() -> None:
    env = playroom("put/put_on_bed_tray_all", max_steps=2)
    put(env, 1, "on tray", "on bed")
    assert outcome(act(env, "NOOP", "NOOP")) == FAILED
