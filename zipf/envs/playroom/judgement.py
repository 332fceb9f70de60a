"""The end of a step: whether an episode has ended, and whether the task was done."""

import math

from zipf.compiled import compiled
from zipf.envs.playroom.constants import FURNITURE_SIZE, NEAR_DISTANCE
from zipf.envs.playroom.falling import STILL_STEPS, fall
from zipf.envs.playroom.geometry import rectangle_gap
from zipf.envs.playroom.hand import keep_in_hand
from zipf.envs.playroom.levels import LIFT, NEAR, ON
from zipf.envs.playroom.state import AX, AY, FLOOR, ON_BED, X, Y

APPROACH_DISTANCE = 0.7
"""Between the centres of agent and object, in `supervised/` levels, metres. Ours."""


@compiled(references=False)
def settle(mask, start, before, envs, reward, terminated, success):
    """After the physics, objects are held or fall, and the episodes of `mask` are judged.

    Args:
        start: the agents' x, y before the physics of this step, float64 [N, 2].
        before: the objects' x, y before the physics of this step, float64 [N, C, 2].
        reward, terminated, success: float64, bool, bool [N], written.
    """
    for i in range(mask.size):
        if not mask[i]:
            continue
        if envs.hands[i] >= 0:
            keep_in_hand(envs, i, start[i])
        fall(envs, i, before[i])
        outcome = _judge(envs, i)
        terminated[i] = outcome >= 0
        success[i] = outcome == 1
        reward[i] = 1.0 if outcome == 1 else 0.0


@compiled(references=False)
def _judge(envs, i):
    """1 if the task was done, 0 if it was done with the wrong object or place, -1 if neither.
    An object counts as the target if it is of the target's rank."""
    ranks = envs.ranks[i]
    if envs.finding:
        return _judge_approach(ranks, envs.agents[i], envs.objects[i])
    if envs.task[i] != LIFT:
        return _judge_put(envs, i)
    held = envs.hands[i]
    if held >= 0 and envs.lifted[i, held]:
        return 1 if ranks[held] == ranks[0] else 0
    return -1


@compiled(references=False)
def _judge_approach(ranks, agent, objects):
    """1 if the agent has come near the target, 0 if near another object, -1 if near none.
    The nearest object counts: an agent that walks between two comes near both in one step."""
    nearest = approached(agent, objects)
    if nearest < 0:
        return -1
    return 1 if ranks[nearest] == ranks[0] else 0


@compiled(references=False)
def approached(agent, objects):
    """The object nearest to the agent of those that it is near to; -1 if it is near none."""
    nearest, distance = -1, APPROACH_DISTANCE
    for j in range(objects.shape[0]):
        gap = math.hypot(objects[j, X] - agent[AX], objects[j, Y] - agent[AY])
        if gap < distance:
            nearest = j
            distance = gap
    return nearest


@compiled(references=False)
def _judge_put(envs, i):
    """1 if the target was put on or near the right support, 0 for any other, -1 if nothing was put.

    An object has been put when it rests after having been lifted. Where the task is to put the
    target near a support, putting it on the support is right, too; another object near a support,
    or the target near the wrong one, is nothing yet, or a failure with `near_failure`.
    """
    task, ranks, status = envs.task[i], envs.ranks[i], envs.status[i]
    objects, furniture = envs.objects[i], envs.furniture[i]
    near = task < ON
    support = task - (NEAR if near else ON)
    for j in range(ranks.size):
        if not envs.lifted[i, j] or envs.still[i, j] < STILL_STEPS:
            continue
        for k in range(2):
            right = k == support and ranks[j] == ranks[0]
            if status[j] == ON_BED + k:
                return 1 if right else 0
            if near and status[j] == FLOOR and (right or envs.near_failure):
                gap = rectangle_gap(furniture[k], FURNITURE_SIZE[k], objects[j, X], objects[j, Y])
                if gap <= NEAR_DISTANCE:
                    return 1 if right else 0
    return -1
