"""Checks that a batch of corridors keeps the contract: seeds, resets, states, buffers, pickling."""

from functools import partial

import corridor  # noqa: F401  registers the family

from zipf.envs import make, make_vec
from zipf.envs.testing import check_vector_env

check_vector_env(partial(make_vec, "corridor/zipf_2"), partial(make, "corridor/zipf_2"))
print("the corridor passes")
