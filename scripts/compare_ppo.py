"""Prints the scores of our PPO and of Stable-Baselines3's at equal values and equal frames.

    python scripts/compare_ppo.py

Two environments: CartPole, and the gridworld of `experiment=demo` in codes of cells. Both agents
have the same number of environments, steps, epochs and minibatches, rates and costs. Networks
differ: Stable-Baselines3's has two hidden layers of 64 units for the policy and two for the value,
ours one encoder and one hidden layer for both; our minibatches are whole sequences, theirs single
frames. Needs `pip install ".[sb3]"` in a clone. Takes about a quarter of an hour on one core.
"""

import statistics
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

import zipf.envs
from zipf.adapters import stable_baselines3
from zipf.agents import AgentSpec, agents
from zipf.agents.memory import MLPOptions
from zipf.agents.network_options import CompactOptions
from zipf.envs.gymnasium.vector import GymnasiumVectorEnv
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.training.host_collector import HostCollector

SEEDS = 0, 1, 2
EPISODES = 500
GRID = {"num_rooms": [2, 2], "num_objects": 5, "observation": "tiles"}

# Stable-Baselines3's defaults, but for what is said.
CARTPOLE = {
    "frames": 131_072,
    "envs": 16,         # ours: with 64 steps 1,024 frames an unroll
    "steps": 64,
    "minibatches": 4,   # of 256 frames
    "epochs": 10,
    "rate": 3e-4,
    "entropy": 0.0,
    "size": 64,
}  # fmt: skip
GRIDWORLD = {**CARTPOLE, "frames": 1_966_080, "envs": 64, "entropy": 0.01, "size": 256}


def ours(env: ZipfVectorEnv, seed: int, values: dict[str, Any]) -> AgentPolicy:
    """Our PPO, trained."""
    network = CompactOptions(
        name="compact", patch=None, channels=16, size=values["size"], code_channels=16,
        code_size=128, vector_layers=[values["size"]], head_size=0,
    )  # fmt: skip
    memory = MLPOptions(name="mlp", size=values["size"], layers=1)
    spaces = env.single_observation_space, env.single_action_space
    spec = AgentSpec(
        *spaces, network, memory, num_envs=values["envs"], unroll_length=values["steps"], seed=seed
    )
    agent = agents()["ppo"]
    options = agent.Options.model_validate({
        "name": "ppo", "learning_rate": values["rate"], "adam_beta1": 0.9, "adam_beta2": 0.999,
        "adam_epsilon": 1e-5, "max_gradient_norm": 0.5, "discount": 0.99, "gae_lambda": 0.95,
        "epochs": values["epochs"], "minibatches": values["minibatches"], "clip_ratio": 0.2,
        "clip_value": None, "baseline_cost": 0.5, "entropy_cost": values["entropy"],
    })  # fmt: skip
    learner = agent(options, spec)
    learner.begin_learning()
    collector = HostCollector(env, learner, unroll_length=values["steps"], seed=seed)
    for _ in range(values["frames"] // (values["envs"] * values["steps"])):
        learner.update(collector.collect())
    return AgentPolicy(learner, seed=seed)


class Predicting:
    """A model of Stable-Baselines3 as a policy of the evaluator; it samples, as ours does."""

    def __init__(self, model: PPO) -> None:
        self.model = model

    def start(self, num_envs: int) -> None:
        """It has no memory."""

    def __call__(self, observation: dict[str, NDArray], reward: NDArray, first: NDArray) -> NDArray:
        if isinstance(self.model.observation_space, gym.spaces.Box):
            (observation,) = observation.values()
        return self.model.predict(observation, deterministic=False)[0]


def theirs(env: VecEnv, seed: int, values: dict[str, Any]) -> Predicting:
    """Stable-Baselines3's PPO, trained."""
    policy = (
        "MlpPolicy" if isinstance(env.observation_space, gym.spaces.Box) else "MultiInputPolicy"
    )
    batch = values["envs"] * values["steps"] // values["minibatches"]
    model = PPO(
        policy, env, learning_rate=values["rate"], n_steps=values["steps"], batch_size=batch,
        n_epochs=values["epochs"], ent_coef=values["entropy"], seed=seed, device="cpu",
    )  # fmt: skip
    model.learn(values["frames"])
    return Predicting(model)


def compare(
    title: str,
    values: dict[str, Any],
    make: Callable[[], ZipfVectorEnv],
    make_theirs: Callable[[int], VecEnv],
    levels: dict[str, Callable[[], ZipfVectorEnv]],
) -> None:
    """Prints a table: medians over the seeds, and each seed's score."""
    print(f"\n{title}, {values['frames']:,} frames\n")
    print("| | " + " | ".join(levels) + " |\n| :-- |" + " --: |" * len(levels))
    for name in "zipf", "Stable-Baselines3":
        scores: dict[str, list[float]] = {level: [] for level in levels}
        for seed in SEEDS:
            if name == "zipf":
                policy = ours(make(), seed, values)
            else:
                policy = theirs(make_theirs(seed), seed, values)
            for level, made in levels.items():
                played = play(policy, made(), episodes=EPISODES, seed=seed)
                scores[level].append(float(played["return"].mean()))
        cells = [
            f"{statistics.median(every):.2f} ({', '.join(f'{one:.2f}' for one in every)})"
            for every in scores.values()
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Both environments."""
    torch.set_num_threads(1)
    compare(
        "CartPole-v1",
        CARTPOLE,
        lambda: GymnasiumVectorEnv(CARTPOLE["envs"], "CartPole-v1"),
        lambda seed: make_vec_env("CartPole-v1", CARTPOLE["envs"], seed=seed),
        {"return": lambda: GymnasiumVectorEnv(50, "CartPole-v1")},
    )
    compare(
        "The demo's gridworld, in codes of cells",
        GRIDWORLD,
        lambda: zipf.envs.make_vec("gridworld/zipf_2", GRIDWORLD["envs"], **GRID),
        lambda seed: stable_baselines3.ZipfVecEnv(
            zipf.envs.make_vec("gridworld/zipf_2", GRIDWORLD["envs"], **GRID)
        ),
        {
            level: lambda level=level: zipf.envs.make_vec(f"gridworld/{level}", 100, **GRID)
            for level in ("zipf_2", "uniform", "rare")
        },
    )  # fmt: skip


if __name__ == "__main__":
    main()
