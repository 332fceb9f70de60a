"""What `gymnasium.make_vec` calls: an attribute for each family that has an id, by its name.

A string in the place of a function, so that specs of Gymnasium can be written as JSON.
"""

from functools import partial
from typing import Any

import numpy as np

from zipf.envs.arguments import whole
from zipf.envs.family import Family, families
from zipf.envs.vector import ZipfVectorEnv


def __getattr__(name: str) -> Any:
    if name not in families():
        raise AttributeError(f"there is no family {name!r}")
    return partial(_make_vec, families()[name])


def _make_vec(
    family: Family, num_envs: int, max_episode_steps: int | None = None, **kwargs: Any
) -> ZipfVectorEnv:
    """A batch with Gymnasium's own option: the shorter of it and `max_steps`, as with
    `gymnasium.make`; -1 and None add no limit."""
    if max_episode_steps not in (None, -1):
        steps = whole("max_episode_steps", max_episode_steps, 1)
        if "max_steps" not in family.options_class.model_fields:
            raise ValueError(
                f"max_episode_steps={steps}: {family.name} has no option max_steps; say "
                'vectorization_mode="sync", which wraps single environments'
            )
        known = family.options_class.model_fields["max_steps"]
        own = kwargs.get("max_steps", known.get_default(call_default_factory=True))
        shorter = own is None or (isinstance(own, int | np.integer) and steps < own)
        kwargs["max_steps"] = steps if shorter else own
    return family.load_make_vec()(num_envs=num_envs, **kwargs)
