"""Frames learned from per second, beside other libraries: same envs, network and cores.

    python scripts/benchmark_training.py
    python scripts/benchmark_training.py --rounds 5 --seconds 20 --match "Stable-Baselines3"

Every library has a virtual environment of its own in `--environments`, made at the first run, with
the versions of constraints.txt and this checkout. Every row is a process that trains; they are let
go in turn, `--seconds` of wall clock each, `--rounds` times over, while the others wait. A row's
ratio is the median, over rounds, of its speed beside that of zipf in float32 in the same round.

All rows learn the same envs with the experiment's network and `memory=mlp` (built from zipf's
modules), on unrolls of the same size, in float32 unless they say otherwise, and learn from
every frame once: advantage actor-critic, or PPO with one epoch of one batch, which is the least
that it can do (its usual four or ten epochs take as many times as long). "gym.make" rows step
envs one by one, as `make_vec_env` of Stable-Baselines3 does; the others use zipf's batches
through zipf's adapters.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import turns

EXPERIMENTS = ("gridworld_compact", "playroom_lift_compact")
ZIPF = "zipf, IMPALA"


@dataclass(frozen=True)
class Peer:
    """A library: the packages of its environment, and its rows' training functions."""

    packages: tuple[str, ...]
    rows: dict[str, Callable[[str, turns.Pause], None]]


@dataclass(frozen=True)
class Task:
    """What all rows train on.

    Attributes:
        level: the environment's id in zipf.
        options: of the level's constructor.
        envs: in a batch.
        steps: of an unroll.
        learning_rate: of the optimiser.
    """

    level: str
    options: dict[str, Any]
    envs: int
    steps: int
    learning_rate: float
    network: Any
    memory: Any


def task_of(experiment: str) -> Task:
    from zipf import envs
    from zipf.experiments.building import loading

    config = loading.load([f"experiment={experiment}", "memory=mlp"])
    return Task(
        envs.split(config.environment.split).train[0].level,
        config.level_options,
        config.collector.num_envs,
        config.collector.unroll_length,
        config.agent.learning_rate,
        config.network,
        config.memory,
    )


def trunk(task: Task, space: Any) -> Any:
    """zipf's encoder and its memory without state: a dictionary of observations [N, ...], or the
    parts in the order of their names -> features [N, size]."""
    import torch
    from torch import nn

    from zipf.agents.encoders import Encoder
    from zipf.agents.memory import MLPMemory

    class Trunk(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.encoder = Encoder(space, task.network)
            self.memory = MLPMemory(self.encoder.size, task.memory)
            self.size = self.memory.size

        def forward(self, *parts: Any) -> torch.Tensor:
            named = parts[0] if isinstance(parts[0], dict) else dict(zip(space, parts, strict=True))
            seen = {name: _as_in(space[name], part) for name, part in named.items()}
            return self.memory.layers(self.encoder(seen))

    def _as_in(part: Any, tensor: torch.Tensor) -> torch.Tensor:
        return tensor if part.dtype == "uint8" else tensor.long()

    return Trunk()


def train_zipf(experiment: str, pause: turns.Pause, *overrides: str) -> None:
    from zipf.experiments.building import loading, run_folder
    from zipf.experiments.training.allocator import keep_freed_ram
    from zipf.experiments.training.runner import Run

    keep_freed_ram()
    with tempfile.TemporaryDirectory() as folder:
        given = [f"experiment={experiment}", "memory=mlp", f"run_root={folder}", *overrides]
        config = loading.load(given)
        run_folder.make(config.folder)
        with Run(config) as run:
            while True:
                run.step()
                pause(run.frames_per_update)


def train_stable_baselines3(
    experiment: str, pause: turns.Pause, algorithm: str, stepping: str
) -> None:
    import gymnasium as gym
    import stable_baselines3
    import torch
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    from zipf import envs
    from zipf.adapters.stable_baselines3 import ZipfVecEnv

    task = task_of(experiment)

    class Features(BaseFeaturesExtractor):
        def __init__(self, space: gym.spaces.Dict) -> None:
            layers = trunk(task, seen)
            super().__init__(space, layers.size)
            self.layers = layers

        def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
            # The library has moved the channels of images to the front.
            parts = {
                name: part.movedim(1, -1) if part.shape[1:] != seen[name].shape else part
                for name, part in observation.items()
            }
            return self.layers(parts)

    class Paused(BaseCallback):
        def _on_rollout_start(self) -> None:  # what was collected before has been learned from
            if self.num_timesteps:
                pause(task.envs * task.steps)

        def _on_step(self) -> bool:
            return True

    if stepping == "batch":
        env = ZipfVecEnv(envs.make_vec(task.level, task.envs, **task.options))
    else:
        env = make_vec_env(
            lambda: envs.make(task.level, **task.options),
            task.envs if stepping == "one by one" else len(os.sched_getaffinity(0)),
            vec_env_cls=DummyVecEnv if stepping == "one by one" else SubprocVecEnv,
        )
    assert isinstance(env.observation_space, gym.spaces.Dict)
    seen = env.observation_space
    options: dict[str, Any] = {"n_steps": task.envs * task.steps // env.num_envs}
    if algorithm == "PPO":
        options |= {"n_epochs": 1, "batch_size": task.envs * task.steps}
    model = getattr(stable_baselines3, algorithm)(
        "MultiInputPolicy",
        env,
        learning_rate=task.learning_rate,
        policy_kwargs={
            "features_extractor_class": Features,
            "net_arch": [],
            "normalize_images": False,
        },
        device="cpu",
        **options,
    )
    model.learn(10**12, callback=Paused())


def train_torchrl(experiment: str, pause: turns.Pause) -> None:
    import torch
    from tensordict.nn import InteractionType, TensorDictModule
    from torch import nn
    from torchrl.collectors import Collector
    from torchrl.modules import ActorValueOperator, ProbabilisticActor, ValueOperator
    from torchrl.objectives import A2CLoss
    from torchrl.objectives.value import GAE

    from zipf import envs
    from zipf.adapters.torchrl import torchrl_env

    task = task_of(experiment)
    env = envs.make_vec(task.level, task.envs, autoreset_mode="Disabled", **task.options)
    space, actions = env.single_observation_space, int(env.single_action_space.n)
    env = torchrl_env(env)
    env.set_seed(0)
    layers = trunk(task, space)

    class Flat(nn.Module):  # over [envs, steps]
        def forward(self, *parts: torch.Tensor) -> torch.Tensor:
            first = next(iter(space))
            batch = parts[0].shape[: parts[0].dim() - len(space[first].shape)]
            flat = [part.reshape(-1, *part.shape[len(batch) :]) for part in parts]
            return self.layers(*flat).unflatten(0, batch) if batch else self.layers(*parts)

        def __init__(self) -> None:
            super().__init__()
            self.layers = layers

    both = ActorValueOperator(
        TensorDictModule(Flat(), list(space), ["hidden"]),
        ProbabilisticActor(
            TensorDictModule(nn.Linear(layers.size, actions), ["hidden"], ["logits"]),
            in_keys=["logits"],
            spec=env.action_spec,
            distribution_class=torch.distributions.Categorical,
            default_interaction_type=InteractionType.RANDOM,
            return_log_prob=True,
        ),
        ValueOperator(nn.Linear(layers.size, 1), in_keys=["hidden"]),
    )
    policy, value = both.get_policy_operator(), both.get_value_operator()
    # vmap has no rule for the LSTM that reads instructions.
    advantage = GAE(gamma=0.99, lmbda=1.0, value_network=value, deactivate_vmap=True)
    loss = A2CLoss(policy, value, entropy_coeff=0.003, critic_coeff=0.5)
    optimiser = torch.optim.Adam(loss.parameters(), lr=task.learning_rate)
    size = task.envs * task.steps
    collector = Collector(env, policy, frames_per_batch=size, total_frames=-1)
    for unroll in collector:
        with torch.no_grad():
            advantage(unroll)
        losses = loss(unroll.reshape(-1))
        total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        optimiser.zero_grad()
        total.backward()
        nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
        optimiser.step()
        pause(size)


def _stable_baselines3(algorithm: str, stepping: str) -> Callable[[str, turns.Pause], None]:
    return lambda *arguments: train_stable_baselines3(*arguments, algorithm, stepping)


PEERS = {
    "zipf": Peer(
        (),
        {
            ZIPF: lambda e, p: train_zipf(e, p, "precision=float32"),
            f"{ZIPF}, bfloat16": lambda e, p: train_zipf(e, p, "precision=bfloat16"),
        },
    ),
    "stable-baselines3": Peer(
        ("stable-baselines3>=2.9",),
        {
            "Stable-Baselines3, A2C": _stable_baselines3("A2C", "batch"),
            "Stable-Baselines3, PPO": _stable_baselines3("PPO", "batch"),
            "Stable-Baselines3, A2C, gym.make": _stable_baselines3("A2C", "one by one"),
            "Stable-Baselines3, A2C, gym.make in processes": _stable_baselines3("A2C", "processes"),
        },
    ),
    "torchrl": Peer((), {"TorchRL, A2C": train_torchrl}),
}


def measure(experiment: str, arguments: argparse.Namespace) -> list[turns.Row]:
    """All rows, with their speeds by round."""
    named = [
        (name, row)
        for name, peer in PEERS.items()
        for row in peer.rows
        if row == ZIPF or arguments.match in row
    ]
    common = ("--constraint", turns.ROOT / "constraints.txt", "--editable", turns.ROOT)
    pythons = {
        name: turns.python_of(name, (*common, *PEERS[name].packages), arguments.environments)
        for name in dict(named)
    }
    rows = [
        turns.Row(row, pythons[name], [__file__, "--train", name, row, experiment])
        for name, row in named
    ]
    turns.measure(experiment, rows, arguments.rounds, arguments.seconds)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    turns.add_options(parser, seconds=10.0)
    parser.add_argument("--experiments", nargs="+", default=EXPERIMENTS, metavar="EXPERIMENT")
    parser.add_argument("--train", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.train:
        name, row, experiment = arguments.train
        turns.serve(lambda pause: PEERS[name].rows[row](experiment, pause))
        return
    for experiment in arguments.experiments:
        rows = measure(experiment, arguments)
        turns.show(f"training on the envs of {experiment}", rows)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"{cores} cores, wall clock, {arguments.rounds} rounds of {arguments.seconds} s")


if __name__ == "__main__":
    main()
