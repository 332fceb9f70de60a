"""The self-check of environments: of a batch, of what reads its goals, of a scripted policy, and of
a tensor environment."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from zipf.envs.testing.batch import check_vector_env
from zipf.envs.testing.goal import check_goal
from zipf.envs.testing.policy import check_policy

if TYPE_CHECKING:
    from zipf.envs.testing.tensor import check_tensor_env

__all__ = ["check_goal", "check_policy", "check_tensor_env", "check_vector_env"]


def __getattr__(name: str) -> Any:
    if name != "check_tensor_env":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module("zipf.envs.testing.tensor").check_tensor_env  # which brings PyTorch
