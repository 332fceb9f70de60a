"""Zipf's Gridworld, many envs at once."""

from collections.abc import Hashable, Mapping
from typing import Any, Self

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import checked
from zipf.envs.gridworld import GridworldOptions, kernels, sprites
from zipf.envs.gridworld.goal import cues
from zipf.envs.gridworld.level import Level
from zipf.envs.gridworld.render import frame
from zipf.envs.pictures import fit
from zipf.envs.vector import Observation, ZipfVectorEnv


class GridworldVectorEnv(ZipfVectorEnv):
    """`N` envs of Zipf's Gridworld; see `GridworldEnv` for the task and its arguments.

    Env `i` of `reset(seed=s)` is a `GridworldEnv` of `reset(seed=s + i)`. Every episode takes
    two numbers from its env's random stream, for the map and for the target, forced or not.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 8}  # noqa: RUF012
    achieves = True

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "zipf_2",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.level = Level.make(level, checked(GridworldOptions, options))
        super().__init__(
            num_envs,
            single_observation_space=self.level.observation_space,
            single_action_space=self.level.action_space,
            situation=self.level.situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self.time_limit = self.level.max_steps
        self.longest_episode = max(self.longest_episode, self.time_limit)
        self._envs = np.zeros((num_envs, 4), dtype=np.int64)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [height, width, 3], with `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        return tuple(frame(self.level.maps, *env) for env in self._envs.tolist())

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """As `ZipfVectorEnv.pictures`, in whole enlargements of the agent's pixels."""
        map, target, row, column = self._envs[0].tolist()
        smallest = frame(self.level.maps, map, target, row, column, 1)
        scale = max(min(width // smallest.shape[1], height // smallest.shape[0]), 1)
        drawn = (
            frame(self.level.maps, map, target, row, column, scale)
            for map, target, row, column in self._envs.tolist()
        )
        return tuple(fit(picture, width, height) for picture in drawn)

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        kernels.begin(
            mask,
            forced,
            self.level.map_cdf,
            self.level.target_cdf,
            self.level.maps.cells,
            self._streams,
            self._envs,
        )

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        reward = np.empty(self.num_envs)
        terminated = np.empty(self.num_envs, dtype=np.bool_)
        truncated = np.empty(self.num_envs, dtype=np.bool_)
        kernels.move(
            mask,
            actions,
            self.level.maps.codes,
            self.level.maps.cells,
            self.level.max_steps,
            self._lengths,
            self._envs,
            reward,
            terminated,
            truncated,
        )
        return reward, terminated, truncated, reward > 0

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        self.level.observe(out, mask, self._envs)

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return {
            "map": self._envs[:, kernels.MAP].copy(),
            "target": self._envs[:, kernels.TARGET].copy(),
        }

    def _achieved(self, ended: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The cue of the object that was touched."""
        map, _, row, column = self._envs.T
        codes = self.level.maps.boards[map, row, column]
        has = ended & (codes >= sprites.FIRST_LOOK)
        goals = cues(codes, self.level.observation)
        goals[~has] = 0
        return goals, has

    def _engine(self) -> Hashable:
        return self.level.maps, self.level.max_steps, self.level.observation

    def _use_engine(self, other: Self) -> None:
        self._envs = other._envs

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        return {"worlds": self._envs}

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        # The kernels index with these numbers and check no bounds. From a wall, which no agent can
        # reach, a step may lead off the board.
        maps, envs = self.level.maps, state["worlds"]
        limits = (maps.num_maps, maps.num_objects, *maps.boards.shape[1:])
        if (envs < 0).any() or (envs >= limits).any():
            raise ValueError("the state is of other maps, or damaged: envs outside the board")
        map, _, row, column = envs[state["seeded"]].T
        if (maps.boards[map, row, column] == sprites.WALL).any():
            raise ValueError("the state is of other maps, or damaged: an agent in a wall")
        self._envs[:] = envs
