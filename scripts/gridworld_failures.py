"""How an agent's episodes in the gridworld end, and what it had seen by then.

    python scripts/gridworld_failures.py runs/gridworld_compact/impala_mlp/seed0
    python scripts/gridworld_failures.py RUN --level gridworld/rare --episodes 1000

A row for each way to end: at the target, at another object, at the time limit. `seen` is the share
of these episodes in which the target had been in view, `squares` how many different squares the
agent stood on, in the mean.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from zipf import envs
from zipf.envs.gridworld import kernels
from zipf.envs.gridworld.maps import VIEW
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.trained import load_agent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("--level", default="gridworld/uniform")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    trained = load_agent(options.run, "cpu")
    env = envs.make_vec(options.level, options.episodes, **trained.config.level_options)
    assert isinstance(env, GridworldVectorEnv)
    ends = first_episodes(env, AgentPolicy(trained.agent, seed=options.seed), options.seed)
    ends["share"] = 1 / len(ends)
    means = ends.groupby("end").agg(
        share=("share", "sum"),
        length=("length", "mean"),
        seen=("seen", "mean"),
        squares=("squares", "mean"),
    )
    print(f"{options.run}, update {trained.update}, {options.level}, {len(ends)} episodes")
    print(means.round({"share": 3, "length": 1, "seen": 2, "squares": 1}).to_string())


def first_episodes(env: GridworldVectorEnv, policy: AgentPolicy, seed: int) -> pd.DataFrame:
    """The first episode of each env: `end`, `length`, `seen` and `squares`."""
    n = env.num_envs
    cells = env.level.maps.cells
    running, seen = np.ones(n, np.bool_), np.zeros(n, np.bool_)
    end, length = np.full(n, "", object), np.zeros(n, np.int64)
    visited: list[set[tuple[int, int]]] = [set() for _ in range(n)]
    observation, _ = env.reset(seed=seed)
    reward, is_first = np.zeros(n, np.float32), np.ones(n, np.bool_)
    policy.start(n)
    while running.any():
        states = env.get_state()["worlds"]
        place = states[:, [kernels.ROW, kernels.COLUMN]]
        target = cells[states[:, kernels.MAP], states[:, kernels.TARGET]]
        seen |= running & (np.abs(place - target).max(1) <= VIEW // 2)
        for i in np.flatnonzero(running):
            visited[i].add(tuple(place[i]))
        actions = policy(observation, reward, is_first)
        observation, rewards, terminated, truncated, _ = env.step(actions)
        reward, is_first = rewards.astype(np.float32), terminated | truncated
        length[running] += 1
        ended = running & is_first
        end[ended] = np.where(
            rewards > 0, "target", np.where(terminated, "another object", "time limit")
        )[ended]
        running &= ~ended
    squares = [len(one) for one in visited]
    return pd.DataFrame({"end": end, "length": length, "seen": seen, "squares": squares})


if __name__ == "__main__":
    main()
