"""Zipf's Gridworld, one world."""

import operator
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from zipf.envs.gridworld import looks
from zipf.envs.gridworld.maps import MOVES
from zipf.envs.gridworld.spec import GridworldSpec

Observation = dict[str, NDArray[np.uint8]]


class GridworldEnv(gym.Env[dict[str, Any], Any]):
    """Zipf's Gridworld, one world."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 8}  # noqa: RUF012 (Gymnasium's form)
    observation_space: spaces.Dict
    action_space: spaces.Discrete

    def __init__(
        self,
        level: str = "zipf_2",
        *,
        num_maps: int = 20,
        num_rooms: Sequence[int] = (3, 3),
        room_size: Sequence[int] = (3, 3),
        num_objects: int = 20,
        max_steps: int = 100,
        observation: str = "image",
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(
                f"render_mode must be one of {self.metadata['render_modes']} or None, "
                f"got {render_mode!r}"
            )
        self.world = GridworldSpec.make(
            level, num_maps, num_rooms, room_size, num_objects, max_steps, observation
        )
        self.observation_space = self.world.observation_space
        self.action_space = self.world.action_space
        self.situation = self.world.situation
        self.render_mode = render_mode
        self._closed = False
        self._running = False
        self._map = self._target = self._row = self._column = self._length = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: restarts the random stream.
            options: `map` and `target` force these ranks. Both are drawn all the same and then
                replaced, so that the episodes that follow do not depend on it.

        Raises:
            ValueError: for unknown options or ranks out of range.
        """
        if self._closed:
            raise ClosedEnvironmentError("reset() of an environment that was closed")
        options = options or {}
        if unknown := options.keys() - self.situation.keys():
            raise ValueError(
                f"unknown reset options {sorted(unknown)}: expected {list(self.situation)}"
            )
        for name, rank in options.items():
            size = self.situation[name]
            if not isinstance(rank, int | np.integer) or not 0 <= rank < size:
                raise ValueError(
                    f"option {name!r} must be an integer in 0 .. {size - 1}, got {rank!r}"
                )
        super().reset(seed=seed)
        drawn = {"map": self._draw(self.world.map_cdf), "target": self._draw(self.world.target_cdf)}
        self._map, self._target = (int(options.get(name, drawn[name])) for name in drawn)
        maps = self.world.maps
        self._board = maps.boards[self._map].tolist()
        self._goal = tuple(maps.cells[self._map, self._target].tolist())
        self._row, self._column = maps.cells[self._map, -1].tolist()
        self._length = 0
        self._running = True
        return self._observe(), {"map": self._map, "target": self._target}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Moves the agent one cell.

        Raises:
            ValueError: if the action is not in 0 .. 7.
            ResetNeeded: if no episode is running.
        """
        if self._closed:
            raise ClosedEnvironmentError("step() of an environment that was closed")
        if not self._running:
            raise ResetNeeded("step() needs a running episode: call reset() first")
        action = operator.index(action)
        if not 0 <= action < len(MOVES):
            raise ValueError(f"the action must be in 0 .. {len(MOVES) - 1}, got {action}")
        down, right = MOVES[action]
        row, column, board = self._row, self._column, self._board
        cut_off = (
            down != 0
            and right != 0
            and board[row + down][column] == board[row][column + right] == looks.WALL
        )
        if board[row + down][column + right] != looks.WALL and not cut_off:
            row, column = self._row, self._column = row + down, column + right
        self._length += 1
        success = (row, column) == self._goal
        terminated = board[row][column] >= looks.FIRST_LOOK
        truncated = not terminated and self._length >= self.world.max_steps
        reward = float(success)
        info: dict[str, Any] = {"map": self._map, "target": self._target}
        if terminated or truncated:
            info.update({"success": success, "return": reward, "length": self._length})
            self._running = False
        return self._observe(), reward, terminated, truncated, info

    def close(self) -> None:
        self._closed = True

    def _draw(self, cdf: NDArray[np.float64]) -> int:
        """What `Generator.choice(len(p), p=p)` draws, without its checks."""
        return int(np.searchsorted(cdf, self.np_random.random(), side="right"))

    def _observe(self) -> Observation:
        world = np.array([[self._map, self._target, self._row, self._column]])
        batch = {
            key: np.empty((1, *space.shape), dtype=np.uint8)
            for key, space in self.observation_space.items()
        }
        self.world.observe(batch, _ONE, world)
        return {key: value[0] for key, value in batch.items()}


_ONE = np.ones(1, dtype=np.bool_)
