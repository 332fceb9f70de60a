"""The self-check of environments: of a batch, of what reads its goals, of a scripted policy."""

from zipf.envs.testing.batch import check_vector_env
from zipf.envs.testing.goal import check_goal
from zipf.envs.testing.policy import check_policy

__all__ = ["check_goal", "check_policy", "check_vector_env"]
