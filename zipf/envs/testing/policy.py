"""A self-check of scripted policies: that they can label what another policy does.

    from functools import partial
    from zipf.envs import generalist, make_vec
    from zipf.envs.testing import check_policy

    level = "gridworld/zipf_2"
    check_policy(partial(generalist, level), partial(make_vec, level))

It raises AssertionError where they cannot.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.episodes import BoundPolicy
from zipf.envs.testing.steps import require
from zipf.envs.vector import ZipfVectorEnv


def check_policy(
    policy: Callable[[Any], BoundPolicy],
    make_vec: Callable[..., ZipfVectorEnv],
    *,
    num_envs: int = 4,
    steps: int = 60,
    seed: int = 0,
) -> None:
    """Asks a scripted policy in envs in which random actions and its own are taken.

    In every autoreset mode its answers have to be actions, be the same when it is asked again and
    in a second rollout, and leave the envs as they are.

    Args:
        policy: `policy(env)` plays a batch: called, it gives actions int64 [N].
        make_vec: `make_vec(num_envs, autoreset_mode=...)` makes the batch.
        num_envs: size of the batch.
        steps: of a rollout.
        seed: of the envs and of the random actions.

    Raises:
        AssertionError: saying what is wrong and where.
    """
    for mode in AutoresetMode:
        one, other = (
            _rollout(policy, make_vec(num_envs, autoreset_mode=mode), steps, seed) for _ in range(2)
        )
        require(np.array_equal(one, other), f"a second rollout has other answers ({mode.value})")


def _rollout(
    policy: Callable[[Any], BoundPolicy], env: ZipfVectorEnv, steps: int, seed: int
) -> NDArray[np.int64]:
    """The answers, int64 [steps, N]."""
    rng = np.random.default_rng(seed)
    count = int(env.single_action_space.n)
    ask = policy(env)
    env.reset(seed=seed)
    answers = []
    for t in range(steps):
        where = f"step {t} ({env.autoreset_mode.value})"
        before = env.get_state()
        answer = ask()
        require(
            isinstance(answer, np.ndarray)
            and answer.dtype == np.int64
            and answer.shape == (env.num_envs,),
            f"{where}: actions must be int64 [{env.num_envs}], got {answer!r}",
        )
        require(
            ((answer >= 0) & (answer < count)).all(),
            f"{where}: actions must be in 0 .. {count - 1}, got {answer}",
        )
        again = ask()
        require(
            np.array_equal(answer, again),
            f"{where}: asked again before the envs moved, it answers {again}, first {answer}",
        )
        after = env.get_state()
        changed = [key for key in before if not np.array_equal(before[key], after[key])]
        require(not changed, f"{where}: asking it changed the state of the envs: {changed}")
        answers.append(answer)
        own = rng.random(env.num_envs) < 0.5
        actions = np.where(own, answer, rng.integers(count, size=env.num_envs))
        _, _, terminated, truncated, _ = env.step(actions)
        ended = terminated | truncated
        if env.autoreset_mode is AutoresetMode.DISABLED and ended.any():
            env.reset(options={"reset_mask": ended})
    env.close()
    return np.array(answers)
