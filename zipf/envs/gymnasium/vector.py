"""Existing Gymnasium environments as batched envs."""

import hashlib
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import mapping, whole
from zipf.envs.gymnasium.replayed import Outcome, ReplayedVectorEnv
from zipf.envs.vector import Observation

Success = Callable[[float, bool, dict[str, Any]], bool]
"""Whether an episode was a success: `success(episode_return, terminated, last_info)`."""

_REPORTED = ("is_success", "success")


class GymnasiumVectorEnv(ReplayedVectorEnv):
    """`N` envs of an existing Gymnasium environment, each made when it is first needed.

        env = GymnasiumVectorEnv(16, "CartPole-v1")
        env = GymnasiumVectorEnv(
            16,
            "MiniGrid-DoorKey-5x5-v0",
            codes={"image": 11},
            success=lambda episode_return, terminated, info: episode_return > 0,
        )

    **Observations** become a Dict: a Dict space stays one, any other becomes a Dict with the one
    part `image`, if it is uint8 [H, W, 3], or `observation`. Dict and Tuple spaces within are
    flattened: `{"arm": {"angle": ...}}` becomes `arm.angle`, the first part of a tuple
    `observation.0`. Box and MultiBinary stay as they are; Discrete and MultiDiscrete count from 0.
    Floats are rounded to the precision of their space, and not held to its bounds, which many
    environments pass by a little; whole numbers have to be in their space.
    Text becomes int64 [text_length]: a code of 1 .. vocabulary - 1 for each word (or punctuation
    mark) in lower case, from a hash that is the same on every machine, and 0 after the last one.
    Two words may share a code; the larger the vocabulary, the fewer do.

    **Actions** are Discrete, counted from 0.

    **Randomness.** Every episode is seeded by `reset(seed=...)` with a number of the env's own
    stream. A saved state is replayed, see `ReplayedVectorEnv`.

    The situation has no ranks; `Mixture` and `zipfian` give it one.

    Args:
        num_envs: number of envs N.
        id: the environment's Gymnasium id; `module:id` imports the module that registers it.
        options: further arguments of `gymnasium.make`.
        wrap: applied to each environment made, for instance a wrapper's class.
        codes: for the names of integer parts of the observation the number of codes n: their
            values are codes in 0 .. n - 1 (kinds of things, not quantities). These parts become
            MultiDiscrete (or Discrete, where the part is a single number).
        success: whether an episode was a success: a name in the last step's `info`, or a function
            `success(episode_return, terminated, last_info)`. None: `is_success` or `success` of
            `info` if the environment reports one of them in its first step, otherwise the
            environment does not report success.
        text_length: codes of a text.
        vocabulary: number of different codes, 0 included.
        autoreset_mode, copy: see `ZipfVectorEnv`.
        render_mode: "rgb_array" (if the environment offers it) or None.

    Raises:
        ValueError: the environment cannot be made, or its observations or actions are of another
            kind; while stepping, for observations of another shape or kind than the space says,
            whole numbers that are not in it, codes out of range, a text of more words than
            `text_length`, rewards that are not finite, or an `info` without the name given as
            success.
    """

    def __init__(
        self,
        num_envs: int,
        id: str,
        *,
        options: Mapping[str, Any] | None = None,
        wrap: Callable[[gym.Env], gym.Env] | None = None,
        codes: Mapping[str, int] | None = None,
        success: str | Success | None = None,
        text_length: int = 16,
        vocabulary: int = 1000,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
    ) -> None:
        self.id = id
        self.replayed_name = f"environment {id!r}"
        self.options = dict(mapping("options", options))
        self.wrap = wrap
        self.render_mode = render_mode
        if render_mode not in ("rgb_array", None):
            raise ValueError(f"render_mode must be 'rgb_array' or None, got {render_mode!r}")
        first = self._make()
        words = Words(text_length, vocabulary)
        self.parts = _parts(id, first.observation_space, mapping("codes", codes), words)
        action_space = first.action_space
        if not isinstance(action_space, spaces.Discrete):
            raise ValueError(
                f"the actions of {id} are {action_space}: only Discrete actions are supported; "
                "give a wrapper that makes them Discrete as `wrap`"
            )
        self._first_action = action_space.start
        self.success = self._reported(first) if success is None else success
        self.reports_success = self.success is not None
        offered = first.metadata.get("render_modes") or []
        self.metadata = {
            "render_modes": [mode for mode in ("rgb_array",) if mode in offered],
            "render_fps": first.metadata.get("render_fps", 30),
        }
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict({part.name: part.space for part in self.parts}),
            single_action_space=spaces.Discrete(int(action_space.n)),
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._envs: list[gym.Env | None] = [None] * num_envs
        self._envs[0] = first

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [height, width, 3], with `render_mode="rgb_array"`.

        Envs that have not begun are a single black pixel.
        """
        if self.render_mode is None:
            return None
        return tuple(
            np.asarray(env.render()) if env is not None and begun else np.zeros((1, 1, 3), np.uint8)
            for env, begun in zip(self._envs, self._seeded.tolist(), strict=True)
        )

    def close_extras(self, **kwargs: Any) -> None:
        for env in self._envs:
            if env is not None:
                env.close()

    def _make(self) -> gym.Env:
        options = self.options
        if self.render_mode is not None:
            options = {**options, "render_mode": self.render_mode}
        try:
            # Our own checks take the place of Gymnasium's, which cost time in every step.
            env = gym.make(self.id, disable_env_checker=True, **options)
            return env if self.wrap is None else self.wrap(env)
        except Exception as error:
            given = f" with {options}" if options else ""
            raise ValueError(
                f"environment {self.id!r}{given} cannot be made: {type(error).__name__}: {error}"
            ) from error

    def _reported(self, env: gym.Env) -> str | None:
        """The name under which an environment reports success in its first step, if it does."""
        env.reset(seed=0)
        info = env.step(self._first_action)[4]
        return next((name for name in _REPORTED if name in info), None)

    def _open(self, i: int, seed: int) -> Observation:
        env = self._envs[i]
        if env is None:
            env = self._envs[i] = self._make()
        return self._read(env.reset(seed=seed)[0])

    def _act(self, i: int, action: int) -> Outcome:
        env = self._envs[i]
        assert env is not None
        observation, reward, terminated, truncated, info = env.step(self._first_action + action)
        # There is no future after a terminal state, whatever the time limit says.
        ends = bool(terminated), bool(truncated) and not terminated
        if not math.isfinite(reward):  # a state with such a return could not be restored
            raise ValueError(f"{self.id}: a reward must be a finite number, got {reward}")
        return Outcome(self._read(observation), float(reward), *ends, info)

    def _read(self, observation: Any) -> Observation:
        return {part.name: part.read(observation) for part in self.parts}

    def _succeeded(self, episode_return: float, outcome: Outcome) -> bool:
        info = dict(outcome.info)
        if callable(self.success):
            return bool(self.success(episode_return, outcome.terminated, info))
        assert self.success is not None
        if self.success not in info:
            raise ValueError(
                f"success={self.success!r}, but {self.id} has no such entry in the info of an "
                f"episode's last step: {sorted(info)}"
            )
        return bool(info[self.success])

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_envs": [None] * self.num_envs}


@dataclass(frozen=True)
class Words:
    """Texts as codes of their words, by a hash.

    Attributes:
        length: codes of a text.
        size: number of different codes, 0 included.

    Raises:
        ValueError: `length` is below 1 or `size` below 2.
    """

    length: int
    size: int

    def __post_init__(self) -> None:
        whole("text_length", self.length, 1)
        whole("vocabulary", self.size, 2)

    def space(self) -> spaces.Box:
        """The space of `encode`, that of an instruction in the benchmark's families."""
        return spaces.Box(0, self.size - 1, (self.length,), dtype=np.int64)

    def encode(self, text: str) -> NDArray[np.int64]:
        """The codes of a text's words, int64 [length], 0 after the last one.

        Raises:
            ValueError: the text has more words than `length`.
        """
        return _encoded(text, self.length, self.size)


@lru_cache(maxsize=4096)
def _encoded(text: str, length: int, size: int) -> NDArray[np.int64]:
    words = re.findall(r"\w+|[^\w\s]", text.lower())
    if len(words) > length:
        raise ValueError(
            f"{text!r} has {len(words)} words, more than text_length={length}: give a larger one"
        )
    hashes = [hashlib.blake2b(word.encode(), digest_size=8).digest() for word in words]
    codes = np.zeros(length, np.int64)
    codes[: len(words)] = [1 + int.from_bytes(one, "little") % (size - 1) for one in hashes]
    codes.flags.writeable = False  # it is given out again
    return codes


@dataclass(frozen=True)
class Part:
    """A part of an environment's observation.

    Attributes:
        id: of the environment.
        name: of the part, as agents see it.
        path: the keys and indices that lead to it in the environment's observation.
        space: its space, as agents see it.
        given: its space, as the environment gives it.
        start: subtracted from what the environment gives, None for 0.
        codes: how many codes its values are, None where they are not checked.
        words: for texts.
    """

    id: str
    name: str
    path: tuple[Any, ...]
    space: spaces.Space
    given: spaces.Space
    start: Any = None
    codes: int | None = None
    words: Words | None = None

    @cached_property
    def bounds(self) -> tuple[Any, Any] | None:
        """The least and the greatest whole number that the environment may give, scalars or of the
        space's shape. None: of floats."""
        given = self.given
        if self.codes is not None:
            return 0, self.codes - 1
        if isinstance(given, spaces.Discrete):
            return given.start, given.start + given.n - 1
        if isinstance(given, spaces.MultiDiscrete):
            return given.start, given.start + given.nvec - 1
        if isinstance(given, spaces.Box):
            return None if given.dtype.kind == "f" else (given.low, given.high)
        return 0, 1

    @cached_property
    def _in_bounds(self) -> np.dtype[Any] | None:
        """The dtype whose values are all in the bounds, as those of most images; None: there is
        none."""
        dtype = self.given.dtype
        if self.bounds is None or dtype is None or dtype.kind not in "iu":
            return None
        low, high = self.bounds
        limits = np.iinfo(dtype)
        whole = (low == limits.min) & (high == limits.max)
        return dtype if np.all(whole) else None

    def read(self, observation: Any) -> NDArray[Any]:
        """The part of an observation of the environment, in the shape of `space`.

        Raises:
            ValueError: another shape, values that the space does not have, or too many words.
        """
        for key in self.path:
            observation = observation[key]
        if self.words is not None:
            if not isinstance(observation, str):
                raise ValueError(
                    f"{self.id}: observation {self.name!r} is {observation!r}, which is no text"
                )
            return self.words.encode(observation)
        value = np.asarray(observation)
        if value.shape != self.space.shape:
            raise ValueError(
                f"{self.id}: observation {self.name!r} has shape {value.shape}, its space "
                f"{self.space.shape}"
            )
        if self._in_bounds is None or value.dtype != self._in_bounds:
            self._check(value)
        return value if self.start is None else value - self.start

    def _check(self, value: NDArray[Any]) -> None:
        """Raises ValueError for values that cannot be kept in `space` as they are, but for floats
        that are rounded."""
        if value.dtype.kind not in "biuf":
            raise self._error(value, "no number")
        if self.bounds is None:
            return
        low, high = self.bounds
        inside = (value >= low) & (value <= high)
        if not inside.all():
            raise self._error(value[~inside], "out of range")
        if value.dtype.kind == "f":
            whole = value.astype(self.space.dtype) == value
            if not whole.all():
                raise self._error(value[~whole], "no whole number")

    def _error(self, wrong: NDArray[Any], what: str) -> ValueError:
        """About the first of these values."""
        if self.codes is not None:
            space = f"codes says {self.codes}: whole numbers in 0 .. {self.codes - 1}"
        else:
            space = f"its space is {textwrap.shorten(str(self.given), 200, placeholder=' ...')}"
        return ValueError(
            f"{self.id}: observation {self.name!r} has the value {wrong.flat[0]}, {what}: {space}"
        )


def _parts(
    id: str, space: spaces.Space, codes: Mapping[str, int], words: Words
) -> tuple[Part, ...]:
    """The parts of an observation space."""
    name = ""
    if not isinstance(space, spaces.Dict):
        shape = space.shape or ()
        picture = isinstance(space, spaces.Box) and space.dtype == np.uint8
        name = "image" if picture and len(shape) == 3 and shape[2] == 3 else "observation"
    parts = tuple(_flattened(id, space, name, (), codes, words))
    names = [part.name for part in parts]
    if unknown := codes.keys() - set(names):
        raise ValueError(f"{id} has no observation {sorted(unknown)} for codes, only {names}")
    if len(set(names)) < len(names):
        raise ValueError(f"{id} has two observations of the same name: {names}")
    return parts


_SIGNED: Mapping[Any, np.dtype[Any]] = {
    np.dtype(np.uint16): np.dtype(np.int32),
    np.dtype(np.uint32): np.dtype(np.int64),
}
"""PyTorch does not calculate with the former."""


def _flattened(
    id: str,
    space: spaces.Space,
    name: str,
    path: tuple[Any, ...],
    codes: Mapping[str, int],
    words: Words,
) -> Iterator[Part]:
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.items() if isinstance(space, spaces.Dict) else enumerate(space)
        for key, part in inner:
            full = f"{name}.{key}" if name else str(key)
            yield from _flattened(id, part, full, (*path, key), codes, words)
    elif name in codes:
        n = codes[name]
        number = isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1
        integers = isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.integer)
        if not number or not integers:
            raise ValueError(
                f"codes={{{name!r}: {n!r}}} of {id}: expected a number >= 1, for a Box of "
                f"integers; the observation is {space}"
            )
        coded: spaces.Space = spaces.Discrete(n)
        if space.shape:
            dtype = np.uint8 if n < 256 else np.int64
            coded = spaces.MultiDiscrete(np.full(space.shape, n), dtype=dtype)
        yield Part(id, name, path, coded, space, codes=n)
    elif isinstance(space, spaces.Discrete):
        yield Part(id, name, path, spaces.Discrete(int(space.n)), space, start=space.start or None)
    elif isinstance(space, spaces.MultiDiscrete):
        counted = spaces.MultiDiscrete(space.nvec, dtype=_SIGNED.get(space.dtype, space.dtype))
        start = space.start if space.start.any() else None
        yield Part(id, name, path, counted, space, start=start)
    elif isinstance(space, spaces.Box) and space.dtype in _SIGNED:
        kept = spaces.Box(space.low, space.high, dtype=_SIGNED[space.dtype])
        yield Part(id, name, path, kept, space)
    elif isinstance(space, spaces.Box | spaces.MultiBinary):
        yield Part(id, name, path, space, space)
    elif space.dtype is not None and space.dtype.kind == "U":  # Text, and MiniGrid's MissionSpace
        yield Part(id, name, path, words.space(), space, words=words)
    else:
        raise ValueError(
            f"{id}: observation {name!r} is {space}: expected Box, Discrete, MultiDiscrete, "
            "MultiBinary, Text, or a Dict or Tuple of these; give a wrapper that changes it as "
            "`wrap`"
        )
