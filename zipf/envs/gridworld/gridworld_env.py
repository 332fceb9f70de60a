"""Zipf's Gridworld, one env."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from zipf.envs.arguments import checked, reset_options, single_action, whole
from zipf.envs.gridworld import GridworldOptions, kernels
from zipf.envs.gridworld.level import OBSERVATIONS, Level
from zipf.envs.gridworld.maps import MOVES
from zipf.envs.gridworld.render import frame
from zipf.envs.window import Window

_ONE = np.ones(1, dtype=np.bool_)

Observation = dict[str, NDArray[np.uint8]]


class GridworldEnv(gym.Env[dict[str, Any], Any]):
    """Zipf's Gridworld: find the cued object in one of 20 fixed maps.

    ## Description

    A map of 3 x 3 rooms holds 20 objects that differ in colour and shape. The agent sees the
    7 x 7 cells around it and, in the top-left corner of its view, a cue: the object to find. Where
    the objects are, how they look and where the agent starts is fixed for each of 20 maps, so an
    agent can learn every way by heart, but which map and which object an episode is about is
    drawn from a Zipfian distribution in training, and from others in the tests. From "Zipfian
    environments for reinforcement learning" (Chan et al., 2022); maps, images and random
    sequences are those of its release.

    ## Observation space

    A `Dict` with, for `observation="image"` (the benchmark):

    - `image`: uint8 [63, 63, 3], 9 x 9 pixels a cell, the agent in the centre. Outside the board
      is floor. An object that is touched hides the agent.

    and for `observation="tiles"`, the same view in symbols:

    - `tiles`: uint8 [7, 7], cell codes: 0 floor, 1 wall, 2 agent, 3 + 15 * colour + shape an
      object. The top-left cell, which the cue covers in the image, is 0.
    - `cue`: uint8 [1], the code of the object to find.

    ## Action space

    `Discrete(8)`: move to a neighbouring cell.

    | Action    | 0 | 1  | 2 | 3  | 4 | 5  | 6 | 7  |
    |-----------|---|----|---|----|---|----|---|----|
    | Direction | N | NE | E | SE | S | SW | W | NW |

    A move is blocked by a wall at its destination, a diagonal one also by walls on both cells it
    passes between. A blocked move takes a step and leaves the agent where it is.

    ## Rewards

    1 for reaching the cued object, 0 otherwise.

    ## Starting state

    The map's frequency rank is drawn first, then the target's, each from the level's distribution
    by one number of `np_random`. `reset(options={"map": 3, "target": 17})` forces either or both;
    forced ones are drawn all the same and then replaced, so that the episodes that follow do not
    depend on it.

    ## Episode end

    Terminated when the agent touches any object; truncated after `max_steps` steps without one.

    ## Info

    `map` and `target`, the ranks of the situation (0 = most frequent). The step that ends an
    episode adds `success` (bool), `return` (float) and `length` (int).

    ## Levels

    - `zipf_2`: exponent 2, to train on; `zipf_<exponent>` for any other exponent >= 0.
    - `uniform`: every map and object alike.
    - `rare`: uniform over the rarest fifth of maps and of objects (`uniform_rare` in the paper).
    - `validation`: uniform over the middle fifth of maps and of objects, to choose agents on. Ours.
    - `fresh`: every map and object alike, on 20 other maps (of the seeds 1254 to 1273), which no
      level trains on. Ours.

    ## Arguments

    - `level`: one of these names, with or without `gridworld/` before it.
    - `num_maps`, `num_rooms` (rows, columns), `room_size` (rows, columns), `num_objects`: what
      maps there are; scores compare with the paper's only at the defaults.
    - `max_steps`: after how many steps an episode is truncated.
    - `observation`: `"image"` or `"tiles"`.
    - `render_mode`: `"rgb_array"` (the whole map with the agent's view outlined), `"human"` (the
      same in a window; needs pygame and a display) or None.

    ## Registered as

    `zipf/Gridworld-v0`, by `import zipf.envs`, or in one go
    `gymnasium.make("zipf.envs:zipf/Gridworld-v0", level="zipf_2")`. With `gymnasium.make_vec` the
    same id gives `GridworldVectorEnv`, which steps many envs at once.

    Raises:
        ValueError: for arguments out of range, or more objects than a map has places for.
        ImportError, RuntimeError: by the first `reset`, for `render_mode="human"` without pygame
            or without a display.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 8}  # noqa: RUF012
    observation_space: spaces.Dict
    action_space: spaces.Discrete

    def __init__(
        self, level: str = "zipf_2", *, render_mode: str | None = None, **options: Any
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(
                f"render_mode must be one of {self.metadata['render_modes']} or None, "
                f"got {render_mode!r}"
            )
        self.level = Level.make(level, checked(GridworldOptions, options))
        self.observation_space = self.level.observation_space
        self.action_space = self.level.action_space
        self.situation = self.level.situation
        self.render_mode = render_mode
        self._window: Window | None = None
        self._closed = False
        self._running = False
        self._length = 0
        self._ranks: dict[str, int] = {}
        self._env = np.full((1, 4), -1)  # as a row of a batch's; -1 before the first episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; `options` may force the ranks `map` and `target`. Both are drawn all
        the same and then replaced, so that the episodes that follow do not depend on it. Raises
        ValueError for a seed that is no whole number >= 0, unknown options or ranks out of range;
        nothing has happened then."""
        if self._closed:
            raise ClosedEnvironmentError("reset() of an environment that was closed")
        if seed is not None:
            seed = whole("seed", seed, 0)  # Gymnasium takes no NumPy integers
        forced = reset_options(options, self.situation)
        for name, rank in forced.items():
            size = self.situation[name]
            whole_number = isinstance(rank, int | np.integer) and not isinstance(rank, bool)
            if not whole_number or not 0 <= rank < size:
                raise ValueError(
                    f"option {name!r} must be an integer in 0 .. {size - 1}, got {rank!r}"
                )
        super().reset(seed=seed)
        drawn = {"map": self._draw(self.level.map_cdf), "target": self._draw(self.level.target_cdf)}
        self._ranks = {name: int(forced.get(name, drawn[name])) for name in drawn}
        map, target = self._ranks.values()
        self._env[0] = map, target, *self.level.maps.cells[map, -1]
        self._length = 0
        self._running = True
        self._show()
        return self._observe(), {**self._ranks}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Moves the agent one cell. Raises ValueError if the action is not in 0 .. 7, TypeError if
        it is no integer, and ResetNeeded if no episode is running."""
        if self._closed:
            raise ClosedEnvironmentError("step() of an environment that was closed")
        if not self._running:
            raise ResetNeeded("step() needs a running episode: call reset() first")
        action = single_action(action, len(MOVES))
        if not 0 <= action < len(MOVES):
            raise ValueError(f"the action must be in 0 .. {len(MOVES) - 1}, got {action}")
        success, terminated = self._move(action)
        self._length += 1
        truncated = not terminated and self._length >= self.level.max_steps
        reward = float(success)
        info: dict[str, Any] = {**self._ranks}
        if terminated or truncated:
            info.update({"success": success, "return": reward, "length": self._length})
            self._running = False
        self._show()
        return self._observe(), reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The current frame, uint8 [height, width, 3], with `render_mode="rgb_array"`.
        Raises ResetNeeded: before the first episode."""
        if self._env[0, 0] < 0:
            raise ResetNeeded("render() needs an episode: call reset() first")
        return self._frame() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._closed = True
        if self._window is not None:
            self._window.close()
            self._window = None

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window("Zipf's Gridworld", self.metadata["render_fps"])
            self._window.show(self._frame())

    def _frame(self) -> NDArray[np.uint8]:
        return frame(self.level.maps, *self._env[0].tolist())

    def _move(self, action: int) -> tuple[bool, bool]:
        """Moves the agent; whether it touches the target, and whether any object."""
        maps = self.level.maps
        return kernels.move_one(self._env[0], action, maps.codes, maps.cells)

    def _draw(self, cdf: NDArray[np.float64]) -> int:
        """What `Generator.choice(len(p), p=p)` draws, without its checks."""
        return int(np.searchsorted(cdf, self.np_random.random(), side="right"))

    def _observe(self) -> Observation:
        shapes = OBSERVATIONS[self.level.observation]
        batch = {key: np.empty((1, *shape), dtype=np.uint8) for key, shape in shapes.items()}
        self.level.observe(batch, _ONE, self._env)
        return {key: value[0] for key, value in batch.items()}
