"""One env as a Gymnasium environment, for families written as batches."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from zipf.envs.arguments import reset_options, single_action, whole
from zipf.envs.vector import Observation, ZipfVectorEnv


class SingleEnv(gym.Env[dict[str, Any], Any]):
    """A batch of one env, without its batch axis.

        env = SingleEnv(GridworldVectorEnv, level="rare")

    After `reset(seed=s + i)` it equals env `i` of a batch after `reset(seed=s)`. As the single
    env of `check_vector_env` it reveals envs that affect each other, wrong masks, states and
    buffers, but not wrong rules, because both sides share them; to check the rules, write a single
    env independently of the batch.

    `info` holds the ranks of the situation as integers, and the batch's other entries as Python
    values (text as str). The step that ends an episode adds `success` (bool, if the batch reports
    it), `return` (float) and `length` (int). Episodes are drawn from the batch's own random stream;
    `np_random` is seeded too, but unused.

    Args:
        make_vec: `make_vec(num_envs, autoreset_mode=..., **kwargs)` makes the batch.
        kwargs: the batch's other options.
    """

    observation_space: spaces.Dict
    action_space: spaces.Discrete

    def __init__(self, make_vec: Callable[..., ZipfVectorEnv], **kwargs: Any) -> None:
        self.batch = make_vec(1, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self.situation = self.batch.situation
        self.reports_success = self.batch.reports_success
        self.metadata = self.batch.metadata
        self.render_mode = self.batch.render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode; `options` may force the ranks of the situation.

        Raises:
            ValueError: for a seed that is no whole number >= 0, unknown options or ranks out of
                range; nothing has happened then.
        """
        if seed is not None:
            seed = whole("seed", seed, 0)  # Gymnasium takes no NumPy integers
        forced = reset_options(options, self.situation)  # without the batch's `reset_mask`
        observation, info = self.batch.reset(seed=seed, options=forced)
        super().reset(seed=seed)
        return _row(observation), _items(info)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Takes an action.

        Raises:
            TypeError: for an action that is no whole number.
            ValueError: for one out of range.
            ResetNeeded: if no episode is running.
        """
        actions = np.array([single_action(action, int(self.action_space.n))])
        observation, reward, terminated, truncated, info = self.batch.step(actions)
        ends = bool(terminated[0]), bool(truncated[0])
        return _row(observation), float(reward[0]), *ends, _items(info)

    def render(self) -> Any:
        """The env's frame, as the batch draws it; None without a `render_mode`."""
        frames = None if self.render_mode is None else self.batch.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        self.batch.close()


def _row(observation: Observation) -> dict[str, Any]:
    return {key: value[0] for key, value in observation.items()}


def _items(info: dict[str, Any]) -> dict[str, Any]:
    """The single env's entries as Python values, without masks (`_success`, ...)."""
    own = {key: value[0] for key, value in info.items() if not key.startswith("_")}
    return {key: one.item() if isinstance(one, np.generic) else one for key, one in own.items()}
