"""dm_env: every level as a `dm_env.Environment`, and the names under which the paper's appendix
and release make them.

It needs `pip install ".[dm_env]"` in a clone of zipf.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf import envs

try:
    import dm_env
    from dm_env import specs
except ImportError as error:
    raise ImportError(
        "zipf.adapters.dm_env needs dm_env: pip install '.[dm_env]' in a clone of zipf"
    ) from error


class DmEnv(dm_env.Environment):
    """One env of a level.

        env = DmEnv("gridworld/zipf_2", seed=1)

    Observations are dictionaries with the names, shapes and dtypes of the level's observation
    space, rewards float, actions int32 scalars. A time step is FIRST, without reward and discount,
    after `reset` and after a `step` where no episode runs, which ignores its action. The step that
    ends an episode is LAST, with discount 0 where it was terminated and 1 where it was truncated,
    so that values are bootstrapped there; all others are MID, with discount 1.

    Args:
        level: a level's full name, as `zipf.envs.make` takes it.
        seed: of the first episode and all that follow; None: another one every time.
        options: the constructor options of the level's family.

    Attributes:
        info: what the last step said in addition: the ranks of the situation, the instruction as
            text, and at the end of an episode `success` (where envs report it), `return`, `length`.

    Raises:
        ValueError: there is no such level, or an option is out of range.
    """

    action_name = "action"

    def __init__(self, level: str, *, seed: int | None = None, **options: Any) -> None:
        self.env = envs.make(level, **options)
        self.info: dict[str, Any] = {}
        self._seed = seed
        self._running = False

    def reset(self) -> dm_env.TimeStep:
        """Starts an episode. Raises ValueError: the seed is no whole number >= 0."""
        observation, self.info = self.env.reset(seed=self._seed)
        self._seed, self._running = None, True
        return dm_env.restart(self.show(observation))

    def step(self, action: Any) -> dm_env.TimeStep:
        """Takes an action, or starts an episode where none runs.

        Raises:
            TypeError: for an action that is no whole number.
            ValueError: for one out of range.
        """
        if not self._running:
            return self.reset()
        observation, reward, terminated, truncated, self.info = self.env.step(action)
        self._running = not (terminated or truncated)
        shown = self.show(observation)
        if terminated:
            return dm_env.termination(float(reward), shown)
        if truncated:
            return dm_env.truncation(float(reward), shown)
        return dm_env.transition(float(reward), shown)

    def show(self, observation: dict[str, NDArray[Any]]) -> Any:
        """What an agent is given of an observation; as `observation_spec` says."""
        return observation

    def observation_spec(self) -> Any:
        space = self.env.observation_space
        assert isinstance(space, spaces.Dict)
        return {name: _spec(name, part) for name, part in space.items()}

    def action_spec(self) -> specs.DiscreteArray:
        assert isinstance(self.env.action_space, spaces.Discrete)
        return specs.DiscreteArray(int(self.env.action_space.n), name=self.action_name)

    def close(self) -> None:
        self.env.close()


def _spec(name: str, space: spaces.Space) -> specs.Array:
    """Raises ValueError: dm_env has no spec for such a space."""
    if isinstance(space, spaces.Discrete) and space.start == 0:
        return specs.DiscreteArray(int(space.n), dtype=space.dtype, name=name)
    if isinstance(space, spaces.Discrete):
        return specs.BoundedArray((), space.dtype, space.start, space.start + space.n - 1, name)
    if isinstance(space, spaces.MultiDiscrete):
        high = space.start + space.nvec - 1
        return specs.BoundedArray(space.shape, space.dtype, space.start, high, name)
    if isinstance(space, spaces.MultiBinary):
        return specs.BoundedArray(space.shape, space.dtype, 0, 1, name)
    if not isinstance(space, spaces.Box):
        raise ValueError(f"observation {name!r} is {space}; dm_env has specs of arrays alone")
    if not np.isfinite([space.low, space.high]).any():
        return specs.Array(space.shape, space.dtype, name)
    bounds = [np.asarray(bound) for bound in (space.low, space.high)]
    low, high = (one.flat[0] if (one == one.flat[0]).all() else one for one in bounds)
    return specs.BoundedArray(space.shape, space.dtype, low, high, name)


class _Gridworld(DmEnv):
    """As released: a tuple of the image alone, float32 [63, 63, 3] in 0 .. 1."""

    action_name = "grid_actions"

    def show(self, observation: dict[str, NDArray[Any]]) -> Any:
        return (observation["image"].astype(np.float32) / np.float32(255),)

    def observation_spec(self) -> Any:
        shape = self.env.observation_space["image"].shape  # type: ignore[index]
        return (specs.BoundedArray(shape, np.float32, 0, 1, "image"),)


class _WithText(DmEnv):
    """As released: the image as `RGB_INTERLEAVED`, and the instruction's text."""

    text_name: str

    def show(self, observation: dict[str, NDArray[Any]]) -> Any:
        text = np.array(self.info["instruction"], object)
        return {"RGB_INTERLEAVED": observation["image"], self.text_name: text}

    def observation_spec(self) -> Any:
        image = self.env.observation_space["image"]  # type: ignore[index]
        return {
            "RGB_INTERLEAVED": _spec("RGB_INTERLEAVED", image),
            self.text_name: specs.StringArray((), name=self.text_name),
        }


class _Playroom(_WithText):
    text_name = "TEXT"


class _Labyrinth(_WithText):
    text_name = "INSTR"


class zipfs_gridworld:
    """The module of this name: `zipfs_gridworld.simple_builder`."""

    @staticmethod
    def simple_builder(
        level_name: str,
        level_kwargs_overrides: Mapping[str, Any] | None = None,
        *,
        seed: int | None = None,
    ) -> DmEnv:
        """An env of Zipf's Gridworld with observations as released, the same pixels.

        Args:
            level_name: "zipf_<exponent>", "uniform", or "rare", which the release calls
                "uniform_rare".
            level_kwargs_overrides: constructor options, such as `num_maps`.
            seed: 1234 plays the episodes of the release, which has that in every env; None:
                others every time.

        Raises:
            ValueError: there is no such level, or an option is out of range.
        """
        name = "rare" if level_name == "uniform_rare" else level_name
        made = _Gridworld(f"gridworld/{name}", seed=seed, **(level_kwargs_overrides or {}))
        if "image" not in made.env.observation_space.spaces:  # type: ignore[attr-defined]
            raise ValueError("observation=tiles has no images, which this env shows; use 'image'")
        return made


class _Settings(NamedTuple):
    """Which env of Zipf's Playroom: `width` and `height` in pixels. An action lasts
    `num_action_repeats` frames of 1/30 s, always 4 here; the release's default is 1."""

    seed: int
    level_name: str
    width: int = 96
    height: int = 72
    episode_length_seconds: float = 120.0
    num_action_repeats: int = 4


class zipfs_playroom:
    """The module of this name: `zipfs_playroom.load_from_docker`, without Docker."""

    EnvironmentSettings = _Settings

    @staticmethod
    def load_from_docker(settings: _Settings, name: str | None = None) -> DmEnv:
        """An env of Zipf's Playroom, with the observations `RGB_INTERLEAVED` (uint8 [height,
        width, 3]) and `TEXT`, and the 46 actions of `zipf.envs.playroom.actions`.

        Args:
            settings: the level and how it is shown.
            name: of an image of Docker's, which this env does not use.

        Raises:
            ValueError: there is no such level, or a setting is out of range.
        """
        if settings.num_action_repeats != 4:
            raise ValueError(
                f"num_action_repeats={settings.num_action_repeats}: an action lasts 4 frames here"
            )
        return _Playroom(
            f"playroom/{settings.level_name}",
            seed=settings.seed,
            image_size=(settings.height, settings.width),
            max_steps=round(settings.episode_length_seconds * 30 / settings.num_action_repeats),
        )


def zipfs_labyrinth(level_name: str, *, seed: int | None = None, **options: Any) -> DmEnv:
    """An env of Zipf's Labyrinth, with the observations `RGB_INTERLEAVED` (uint8 [72, 96, 3]) and
    `INSTR`. Actions are those of `zipf.envs.labyrinth.actions`, each for 4 frames; the release
    takes DeepMind Lab's own, of a frame each, and has discount 0 at a level's time limit.

    Args:
        level_name: "forward_zipf", "reversed_zipf", "uniform", "forward_rare", "reversed_rare" or
            the name of a task.
        seed: of all episodes; None: others every time.
        options: the constructor options of the labyrinth's family.

    Raises:
        ValueError: there is no such level, or an option is out of range.
    """
    return _Labyrinth(f"labyrinth/{level_name}", seed=seed, **options)
