"""What the tests of the labyrinth's levels share."""

from typing import Any

import numpy as np

from zipf.envs import make_vec
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.labyrinth.world import World

KINDS = (
    "rooms_watermaze",
    "language_execute_random_task",
    "lasertag_one_opponent_small",
    "natlab_varying_map_regrowth",
    "skymaze_irreversible_path_varied",
    "psychlab_visual_search",
    "explore_goal_locations_small",
)
"""A level for each kind of rules."""

REWARDS: dict[str, set[float]] = {
    "rooms_collect_good_objects_train": {1, -1},
    "rooms_exploit_deferred_effects_train": {1, 10, -3},
    "rooms_select_nonmatching_object": {1, 10, -10},
    "rooms_watermaze": {1},
    "rooms_keys_doors_puzzle": {1, 50},
    "language_select_described_object": {10, -10},
    "language_select_located_object": {10, -3, -1},
    "language_execute_random_task": {10, 1, 11, *range(-8, 0)},
    "language_answer_quantitative_question": {10, -10},
    **{name: {1, -1} for name in LEVELS if name.startswith("lasertag")},
    **{name: {1} for name in LEVELS if name.startswith("natlab")},
    **{name: {100} for name in LEVELS if name.startswith("skymaze")},
    **{name: {1} for name in LEVELS if name.startswith("psychlab")},
    **{name: {1} for name in LEVELS if name.startswith("explore_object_locations")},
    **{name: {10} for name in LEVELS if "goal" in name and name.startswith("explore")},
    **{name: {2, -1} for name in LEVELS if name.startswith("explore_object_rewards")},
}
"""What a single event may be worth, from the description of the original."""


def batch(level: str, num_envs: int, **options: Any) -> LabyrinthVectorEnv:
    """A batch with images as small as possible."""
    env = make_vec(f"labyrinth/{level}", num_envs, **{"image_size": (1, 1), **options})
    assert isinstance(env, LabyrinthVectorEnv)
    return env


def record_rewards(monkeypatch: Any) -> list[float]:
    """A list to which every single reward is added from now on."""
    seen: list[float] = []
    original = World.reward

    def reward(world: World, amount: float) -> None:
        seen.append(amount)
        original(world, amount)

    monkeypatch.setattr(World, "reward", reward)
    return seen


def play_out(env: LabyrinthVectorEnv, act: Any) -> tuple[np.ndarray, np.ndarray]:
    """Plays one episode in every env; returns and lengths. The batch does not reset itself."""
    returns, lengths = np.zeros(env.num_envs), np.zeros(env.num_envs, np.int64)
    left = np.ones(env.num_envs, np.bool_)
    while left.any():
        _, _, terminated, truncated, info = env.step(act())
        ended = (terminated | truncated) & left
        if ended.any():
            returns[ended] = info["final_info"]["return"][ended]
            lengths[ended] = info["final_info"]["length"][ended]
            left &= ~ended
    return returns, lengths
