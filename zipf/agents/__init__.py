"""Agents: learning. They know no env, only observation and action spaces."""

from zipf.agents.agent import Agent, AgentSpec, agents, register

# These register themselves.
from zipf.agents.imitation import Imitation
from zipf.agents.impala import Impala
from zipf.agents.ppo import PPO
from zipf.agents.r2d2 import R2D2
from zipf.agents.supervised import Supervised
from zipf.agents.vmpo import VMPO

__all__ = [
    "PPO", "R2D2", "VMPO", "Agent", "AgentSpec", "Imitation", "Impala", "Supervised", "agents",
    "register",
]  # fmt: skip
