"""What the agent of a playroom has done at an episode's end."""

from zipf.envs.playroom.constants import FURNITURE_SIZE, NEAR_DISTANCE
from zipf.envs.playroom.falling import STILL_STEPS
from zipf.envs.playroom.geometry import rectangle_gap
from zipf.envs.playroom.judgement import approached
from zipf.envs.playroom.levels import LIFT, NEAR, ON
from zipf.envs.playroom.state import FLOOR, ON_BED, Envs, X, Y

Achievement = tuple[int, int]  # which of the env's objects, and the task that was done with it


def achieved(envs: Envs, i: int) -> Achievement | None:
    """What was done in env `i`, of the kind that its task asks for; None: nothing.

    By the rules of `judgement.py`, with any object and any place in the place of the right ones.
    Where that was done with several objects, it is with the target if that is one of them.
    """
    if envs.finding:
        return _approached(envs, i)
    if envs.task[i] != LIFT:
        return _put(envs, i)
    held = int(envs.hands[i])
    return (held, LIFT) if held >= 0 and envs.lifted[i, held] else None


def _approached(envs: Envs, i: int) -> Achievement | None:
    nearest = approached(envs.agents[i], envs.objects[i])
    return None if nearest < 0 else (int(nearest), int(envs.task[i]))


def _put(envs: Envs, i: int) -> Achievement | None:
    """What was asked for if that was done, else an object on a support, else an object near a
    support, which counts only if it ends the episode: it may have been near before."""
    task = int(envs.task[i])
    near = task < ON
    on_top: list[Achievement] = []
    beside: list[Achievement] = []
    for j, place in enumerate(envs.objects[i]):
        if not envs.lifted[i, j] or envs.still[i, j] < STILL_STEPS:
            continue
        for k in range(2):
            right = envs.ranks[i, j] == envs.ranks[i, 0] and NEAR + k == task
            if envs.status[i, j] == ON_BED + k:
                on_top.append((j, (NEAR if near else ON) + k))
            elif near and envs.status[i, j] == FLOOR and (right or envs.near_failure):
                gap = rectangle_gap(envs.furniture[i, k], FURNITURE_SIZE[k], place[X], place[Y])
                if gap <= NEAR_DISTANCE:
                    beside.append((j, NEAR + k))
    done = on_top + beside
    return (0, task) if (0, task) in done else next(iter(done), None)
