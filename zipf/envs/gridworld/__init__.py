"""Zipf's Gridworld: find the cued object in one of 20 fixed maps of nine rooms."""

from zipf.envs.gridworld.chance import random_policy, random_policy_success
from zipf.envs.gridworld.single import GridworldEnv
from zipf.envs.gridworld.vector import GridworldVectorEnv

__all__ = ["GridworldEnv", "GridworldVectorEnv", "random_policy", "random_policy_success"]
