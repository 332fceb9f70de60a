"""Zipfian environments, agents and evaluation for learning from long-tailed experience.

Importing this registers the environments with Gymnasium: `gymnasium.make("zipf/Gridworld-v0")`.
"""

__version__ = "0.2.0"

import zipf.envs  # noqa: F401
