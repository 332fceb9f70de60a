"""A self-check of goals: what a family says that its observations ask for.

    from functools import partial
    from zipf.envs import goal, make_vec
    from zipf.envs.testing import check_goal

    level = "gridworld/zipf_2"
    check_goal(partial(goal, level), partial(make_vec, level))

It raises AssertionError where they are wrong.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.goals import Goal
from zipf.envs.testing.steps import require
from zipf.envs.vector import Observation, ZipfVectorEnv


def check_goal(
    make_goal: Callable[[ZipfVectorEnv], Goal | None],
    make_vec: Callable[..., ZipfVectorEnv],
    *,
    num_envs: int = 5,
    steps: int = 300,
    seed: int = 0,
    actions: Callable[[ZipfVectorEnv], NDArray[np.int64]] | None = None,
) -> dict[str, int]:
    """Checks in played envs that goals are read, replaced and achieved as `Goal` says.

    Args:
        make_goal: makes the family's goals from a batch.
        make_vec: `make_vec(num_envs)` makes a batch.
        num_envs, steps: of the envs that are played.
        seed: of the envs and of the actions.
        actions: `actions(env)` gives those to take, [N]; None: random ones.

    Returns:
        How many episodes `ended`, how many of them had `achieved` something, and how many of those
        something `other` than they were asked for: whether the check saw what it is about.

    Raises:
        AssertionError: saying what is wrong and where.
    """
    env = make_vec(num_envs)
    goal = make_goal(env)
    require(goal is not None, "the family has no goals")
    assert goal is not None
    if env.achieves:
        env.report_achieved()
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    asked = goal.read(observation)
    counts = {"ended": 0, "achieved": 0, "other": 0}
    for t in range(steps):
        where = f"step {t}"
        now = _replacing(goal, observation, where)
        require(
            now.shape == asked.shape and now.dtype == asked.dtype,
            f"{where}: goals are {now.dtype} {now.shape}, at first {asked.dtype} {asked.shape}",
        )
        if actions is None:
            taken = rng.integers(env.single_action_space.n, size=num_envs)
        else:
            taken = actions(env)
        observation, _, terminated, truncated, info = env.step(taken)
        ended = terminated | truncated
        counts["ended"] += int(ended.sum())
        if env.achieves and ended.any():
            _achieved(info["final_info"], ended, asked, counts, where)
        asked[ended] = goal.read(observation)[ended]
    env.close()
    return counts


def _replacing(goal: Goal, observation: Observation, where: str) -> NDArray[Any]:
    """Checks that goals are replaced where the mask says, and nothing else; returns the goals."""
    now = goal.read(observation)
    count = len(next(iter(observation.values())))
    require(
        now.ndim == 2 and len(now) == count and now.dtype.kind in "iu",
        f"{where}: read() must give integers [{count}, K], got {now.dtype} {now.shape}",
    )
    require(
        not any(np.may_share_memory(now, part) for part in observation.values()),
        f"{where}: read() must give a fresh array, not a view of the observation",
    )
    copy = {name: part.copy() for name, part in observation.items()}
    goal.write(copy, now, np.ones(count, np.bool_))
    for name, part in observation.items():
        require(
            np.array_equal(part, copy[name]),
            f"{where}: writing the goals that were read changes {name!r}",
        )
    mask = np.arange(count) % 2 == 0
    others = np.roll(now, 1, axis=0)
    goal.write(copy, others, mask)
    require(
        np.array_equal(goal.read(copy), np.where(mask[:, None], others, now)),
        f"{where}: read() does not give the goals that were written",
    )
    for name, part in observation.items():
        require(
            np.array_equal(part[~mask], copy[name][~mask]),
            f"{where}: write() changes {name!r} outside its mask",
        )
    goal.write(copy, now, mask)
    for name, part in observation.items():
        require(
            np.array_equal(part, copy[name]),
            f"{where}: writing other goals changes more of {name!r} than writing back restores",
        )
    return now


def _achieved(
    final: dict[str, Any],
    ended: NDArray[np.bool_],
    asked: NDArray[Any],
    counts: dict[str, int],
    where: str,
) -> None:
    """Checks what ended episodes have achieved against what they were asked for and success."""
    goals, has = final["achieved"], final["has_achieved"]
    require(
        goals.shape == asked.shape and goals.dtype == asked.dtype,
        f"{where}: achieved is {goals.dtype} {goals.shape}, goals are {asked.dtype} {asked.shape}",
    )
    require(
        has.shape == ended.shape and has.dtype == np.bool_,
        f"{where}: has_achieved must be bool {ended.shape}, got {has.dtype} {has.shape}",
    )
    has = has & ended
    same = (goals == asked).all(1)
    counts["achieved"] += int(has.sum())
    counts["other"] += int((has & ~same).sum())
    if "success" not in final:
        return
    success = final["success"] & ended
    require(
        (has & same)[success].all(),
        f"{where}: an episode that succeeded has not achieved what it was asked for",
    )
    require(
        not (has & same)[ended & ~success].any(),
        f"{where}: an episode that failed has achieved what it was asked for",
    )
