"""The self-check of environments: of a batch, of what reads its goals, of a scripted policy, and of
a tensor environment."""

from typing import TYPE_CHECKING

from zipf.envs.testing.batch import check_vector_env
from zipf.envs.testing.goal import check_goal
from zipf.envs.testing.policy import check_policy
from zipf.lazy import lazily

if TYPE_CHECKING:
    from zipf.envs.testing.tensor import check_tensor_env
else:  # it brings PyTorch
    __getattr__, __dir__ = lazily(__name__, {"check_tensor_env": "zipf.envs.testing.tensor"})

__all__ = ["check_goal", "check_policy", "check_tensor_env", "check_vector_env"]
