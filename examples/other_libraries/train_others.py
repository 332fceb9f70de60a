"""Trains PPO of Stable-Baselines3 and of TorchRL on the small gridworld, and records their scores.

The rows stand in the table of `experiment=small_gridworld`, marked as external.
"""

import math
import sys

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from tensordict.nn import InteractionType, TensorDictModule
from torch import nn
from torchrl.envs.utils import step_mdp
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from zipf.adapters import stable_baselines3, torchrl
from zipf.envs import make_vec
from zipf.evaluate import record

ENVS = {"num_rooms": [2, 2], "num_objects": 5, "observation": "tiles"}
FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else 245_760
SEEN = ["tiles", "cue"]
ROW = {"experiment": "small_gridworld", "episodes": 500, **ENVS}


def train_stable_baselines3() -> None:
    env = stable_baselines3.ZipfVecEnv(make_vec("gridworld/zipf_2", 64, **ENVS))
    model = PPO("MultiInputPolicy", env, n_steps=64, batch_size=1024, ent_coef=0.01, seed=0)
    model.learn(FRAMES)
    folder = "runs/small_gridworld/sb3_ppo/seed0"
    policy = stable_baselines3.policy(model)
    frames = model.num_timesteps
    record(policy, "gridworld", folder, name="PPO (Stable-Baselines3)", frames=frames, **ROW)


def network(spaces: gym.spaces.Dict, outputs: int) -> nn.Module:
    """From the view as cell codes, uint8 [..., 7, 7], and the cue, uint8 [..., 1]."""
    codes_of = [spaces[name] for name in SEEN]
    codes = max(int(space.high.max()) + 1 for space in codes_of)
    cells = sum(math.prod(space.shape) for space in codes_of)

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.embed = nn.Embedding(codes, 16)
            self.layers = nn.Sequential(
                nn.Linear(cells * 16, 128), nn.ReLU(), nn.Linear(128, outputs)
            )

        def forward(self, tiles: torch.Tensor, cue: torch.Tensor) -> torch.Tensor:
            seen = torch.cat([tiles.flatten(-2), cue], -1).int()
            return self.layers(self.embed(seen).flatten(-2))

    return Network()


def train_torchrl() -> None:
    torch.manual_seed(0)
    envs = make_vec("gridworld/zipf_2", 64, autoreset_mode="Disabled", **ENVS)
    spaces, actions = envs.single_observation_space, int(envs.single_action_space.n)
    env = torchrl.torchrl_env(envs)
    env.set_seed(0)
    actor = ProbabilisticActor(
        TensorDictModule(network(spaces, actions), SEEN, ["logits"]),
        in_keys=["logits"],
        spec=env.action_spec,
        distribution_class=torch.distributions.Categorical,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
    )
    value = ValueOperator(network(spaces, 1), in_keys=SEEN)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=value)
    loss = ClipPPOLoss(actor, value, entropy_coeff=0.01, normalize_advantage=True)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    state, frames = env.reset(), 0
    while frames < FRAMES:
        with torch.no_grad():
            unroll = env.rollout(
                64, actor, auto_reset=False, tensordict=state, break_when_any_done=False
            )
            state = step_mdp(unroll[:, -1])
            state = env.maybe_reset(state)
            advantage(unroll)
        frames += unroll.numel()
        for _ in range(8):
            for batch in unroll.reshape(-1).split(1024):
                losses = loss(batch)
                total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
                optimiser.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
    folder = "runs/small_gridworld/torchrl_ppo/seed0"
    policy = torchrl.policy(actor)
    record(policy, "gridworld", folder, name="PPO (TorchRL)", frames=frames, **ROW)


if __name__ == "__main__":
    train_stable_baselines3()
    train_torchrl()
