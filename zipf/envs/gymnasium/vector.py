"""Existing Gymnasium environments as batched envs."""

import copy as copying
import math
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import mapping, whole
from zipf.envs.errors import EnvError
from zipf.envs.gymnasium.parts import Reading, Words, parts_of, short
from zipf.envs.gymnasium.replayed import Outcome, ReplayedVectorEnv
from zipf.envs.vector import Observation, ZipfVectorEnv

Success = Callable[[float, bool, dict[str, Any]], bool]
"""Whether an episode was a success: `success(episode_return, terminated, last_info)`."""

_REPORTED = ("is_success", "success")
_SEVERAL = (tuple, list)
_TIME_LIMITS = (
    "max_episode_steps",
    "_max_episode_steps",
    "max_steps",
    "max_num_frames_per_episode",
)
LEAST_IDLE = 8  # ours: environments that a mixture keeps though it plays none of them
LONGEST_EPISODE = 100_000  # ours: Atari's have at most 27,000 steps, or 108,000 frames
TRIED_EPISODES = 20  # ours: whose texts are read when a batch is made
TRIED_SAMPLES = 100  # ours: of a space that draws whole texts, as MiniGrid's does
_TRIED: set[str] = set()
"""Environments whose texts this process has tried."""


class GymnasiumVectorEnv(ReplayedVectorEnv):
    """`N` envs of an existing Gymnasium environment, each made when it is first needed.

    In a mixture, an env that goes on to another level leaves its environment to the next one that
    comes to this level; of those that nobody plays at most `max(num_envs, 8)` are kept, the others
    are closed.

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
    `observation.0`. Discrete and MultiDiscrete count from 0, MultiBinary stays as it is. Images
    become uint8 [H, W, C]: a Box is one if it is uint8 or bool with two or three axes, of which two
    are at least 7 long. Of three axes the channels are the first or the last, if that one is the
    shortest and at most 16 long; what else may be an image is refused, and `image_axes` decides.
    Where the space is bool, or its bounds are 0 and 1, 1 becomes 255. Bytes from 0 to some number
    in 2 .. 254 are codes, but for those with 1, 3 or 4 channels last, which networks read as an
    image unless `codes` names them. Any other Box keeps its shape, and its dtype but where PyTorch
    has none.
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
        image_axes: for the names of uint8 or bool parts what their axes are, a letter each: H and
            W once, C for all others, which become the channels: "CHW", or "CHWC" for a stack of
            colour images. None: the part is no image; it gets a single axis.
        success: whether an episode was a success: a name in the last step's `info`, or a function
            `success(episode_return, terminated, last_info)`. None: `is_success` or `success` of
            `info` if the environment reports one of them in its first step, otherwise the
            environment does not report success.
        text_length: codes of a text.
        cut_texts: whether texts of more words are cut. False: they are an error.
        vocabulary: number of different codes, 0 included.
        longest_episode: of how many steps an episode may be in an evaluation, which more of them
            end with an error; at least as many as a time limit that the environment declares.
        autoreset_mode, copy: see `ZipfVectorEnv`.
        render_mode: "rgb_array" (if the environment offers it) or None.

    Raises:
        ValueError: the environment cannot be made, or its observations or actions are of another
            kind.
        EnvError: here, where a step is tried, and while stepping, the environment raises an error,
            or returns something else than Gymnasium's interface says: observations of another
            shape or kind than the space, whole numbers that are not in it, codes out of range, a
            text of more words than `text_length`, a reward that is no finite number, or an `info`
            without the name given as success.
    """

    def __init__(
        self,
        num_envs: int,
        id: str,
        *,
        options: Mapping[str, Any] | None = None,
        wrap: Callable[[gym.Env], gym.Env] | None = None,
        codes: Mapping[str, int] | None = None,
        image_axes: Mapping[str, str | None] | None = None,
        success: str | Success | None = None,
        text_length: int = 16,
        cut_texts: bool = False,
        vocabulary: int = 1000,
        longest_episode: int = LONGEST_EPISODE,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
    ) -> None:
        self.id = id
        self.replayed_name = f"environment {id!r}"
        self.options = dict(mapping("options", options))
        self._given = f" with {short(self.options)}" if self.options else ""
        self._called = f"{id}{self._given}"
        self.wrap = wrap
        self.render_mode = render_mode
        if render_mode not in ("rgb_array", None):
            raise ValueError(f"render_mode must be 'rgb_array' or None, got {render_mode!r}")
        first = self._make()
        reading = Reading(
            mapping("codes", codes),
            mapping("image_axes", image_axes),
            Words(text_length, vocabulary, cut_texts),
        )
        self.parts = parts_of(self._called, self._space(first, "observation_space"), reading)
        action_space = self._space(first, "action_space")
        if not isinstance(action_space, spaces.Discrete):
            raise ValueError(
                f"the actions of {id} are {short(action_space)}: only Discrete actions are "
                "supported; give a wrapper that makes them Discrete as `wrap`"
            )
        self._first_action = action_space.start
        self.longest_episode = whole("longest_episode", longest_episode, 1)
        if limits := list(_time_limits(first)):
            self.time_limit = max(limits)
            self.longest_episode = max(longest_episode, self.time_limit)
        else:
            warnings.warn(
                f"{id} declares no time limit: an episode of it may never end, and evaluations end "
                f"with an error after {longest_episode} steps (longest_episode); "
                "options={'max_episode_steps': ...} gives it one",
                stacklevel=2,
            )
        reported = self._try(first)
        self.success = reported if success is None else success
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
        self._idle = _Idle(None if render_mode else max(num_envs, LEAST_IDLE))
        self._idle.put(self, first)

    def name_of(self, i: int) -> str:
        return self.replayed_name + self._given

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
        self._idle.close()

    def _make(self) -> gym.Env:
        options = self.options
        if self.render_mode is not None:
            options = {**options, "render_mode": self.render_mode}
        try:
            # Our own checks take the place of Gymnasium's, which cost time in every step.
            env = gym.make(self.id, disable_env_checker=True, **options)
            env = env if self.wrap is None else self.wrap(env)
        except Exception as error:
            given = f" with {short(options)}" if options else ""
            raise ValueError(
                f"environment {self.id!r}{given} cannot be made: {type(error).__name__}: "
                f"{short(error)}"
            ) from error
        if not isinstance(env, gym.Env):
            raise ValueError(f"{self._called}: wrap must return a gymnasium.Env, got {short(env)}")
        return env

    def _space(self, env: gym.Env, name: str) -> spaces.Space:
        space = getattr(env, name, None)
        if not isinstance(space, spaces.Space):
            raise ValueError(
                f"{self._called}: {name} must be a Gymnasium space, got {short(space)}"
            )
        return space

    def _try(self, env: gym.Env) -> str | None:
        """Begins an episode and takes a step, so that an environment that keeps another interface
        is refused now; returns the name under which it reports success, if it does."""
        self._read(self._reset(env, 0))
        self._try_texts(env)
        outcome = self._step(env, self._first_action)
        return next((name for name in _REPORTED if name in outcome.info), None)

    def _try_texts(self, env: gym.Env) -> None:
        """Reads texts that the environment may give, once in a process: that one is too long would
        otherwise be found out after hours."""
        texts = [part for part in self.parts if part.words is not None]
        tried = repr((self.id, self.options, self.wrap, [part.words for part in texts]))
        if not texts or tried in _TRIED:
            return
        for part in texts:
            if not isinstance(part.given, spaces.Text):  # samples of which are no texts of use
                space = copying.deepcopy(part.given)
                for _ in range(TRIED_SAMPLES):
                    part.read_text(space.sample())
        for seed in range(1, TRIED_EPISODES):
            self._read(self._reset(env, seed))
        _TRIED.add(tried)

    def _open(self, i: int, seed: int) -> Observation:
        env = self._envs[i]
        if env is None:
            env = self._envs[i] = self._idle.take(self) or self._make()
        return self._read(self._reset(env, seed))

    def _leave(self, envs: list[int]) -> None:
        for i in envs:
            env = self._envs[i]
            if env is not None:
                self._envs[i] = None
                self._idle.put(self, env)

    def _use_processes(self, other: ZipfVectorEnv) -> None:
        if isinstance(other, GymnasiumVectorEnv) and other._idle is not self._idle:
            for batch, env in self._idle.kept:
                other._idle.put(batch, env)
            self._idle = other._idle

    def _act(self, i: int, action: int) -> Outcome:
        env = self._envs[i]
        assert env is not None
        return self._step(env, self._first_action + action)

    def _reset(self, env: gym.Env, seed: int) -> Any:
        """The first observation of an episode, as the environment gives it."""
        try:
            returned = env.reset(seed=seed)
        except Exception as error:
            raise self._raised("reset", error) from error
        if not isinstance(returned, _SEVERAL) or len(returned) != 2:
            raise EnvError(
                f"{self._called}: reset must return (observation, info), got {short(returned)}"
            )
        observation, info = returned
        self._check_info("reset", info)
        return observation

    def _step(self, env: gym.Env, action: Any) -> Outcome:
        try:
            returned = env.step(action)
        except Exception as error:
            raise self._raised("step", error) from error
        if not isinstance(returned, _SEVERAL) or len(returned) != 5:
            count = f" of {len(returned)} values" if isinstance(returned, _SEVERAL) else ""
            raise EnvError(
                f"{self._called}: step must return (observation, reward, terminated, truncated, "
                f"info), got {type(returned).__name__}{count}"
            )
        observation, reward, terminated, truncated, info = returned
        self._check_info("step", info)
        reward = self._number(reward)
        terminated = self._flag("terminated", terminated)
        # There is no future after a terminal state, whatever the time limit says.
        truncated = self._flag("truncated", truncated) and not terminated
        return Outcome(self._read(observation), reward, terminated, truncated, info)

    def _raised(self, method: str, error: Exception) -> Exception:
        """What to raise in the place of an error of the environment."""
        if isinstance(error, EnvError | MemoryError):
            return error
        text = short(error) or "no message"
        *_, last = traceback.extract_tb(error.__traceback__)
        where = f"{Path(last.filename).name}, line {last.lineno}"
        line = f"{self._called}: {method} raised {type(error).__name__} in {where}: {text}"
        if method == "reset" and isinstance(error, TypeError) and " argument" in text:
            line += "; it must be reset(self, *, seed=None, options=None)"
        if method == "step" and isinstance(error, ValueError) and "unpack" in text:
            line += "; it must return (observation, reward, terminated, truncated, info)"
        return EnvError(line)

    def _check_info(self, method: str, info: Any) -> None:
        if type(info) is not dict and not isinstance(info, Mapping):
            raise EnvError(f"{self._called}: info of {method} must be a dict, got {short(info)}")

    def _number(self, reward: Any) -> float:
        """A reward. That of an array with a single entry is the entry."""
        if type(reward) is not float:
            try:
                plain = reward.item() if hasattr(reward, "item") else reward
                if isinstance(plain, str | bytes):
                    raise TypeError
                reward = float(plain)
            except (TypeError, ValueError, RuntimeError, OverflowError):
                raise EnvError(
                    f"{self._called}: a reward must be a number, got {short(reward)}"
                ) from None
        if not math.isfinite(reward):  # a state with such a return could not be restored
            raise EnvError(f"{self._called}: a reward must be a finite number, got {reward}")
        return reward

    def _flag(self, name: str, value: Any) -> bool:
        """Whether an episode has ended."""
        if type(value) is bool:
            return value
        try:
            plain = value.item() if hasattr(value, "item") else value
        except (ValueError, RuntimeError):  # of several entries
            plain = None
        if not isinstance(plain, int | float) or plain not in (0, 1):
            raise EnvError(f"{self._called}: {name} must be True or False, got {short(value)}")
        return bool(plain)

    def _read(self, observation: Any) -> Observation:
        return {part.name: part.read(observation) for part in self.parts}

    def _succeeded(self, episode_return: float, outcome: Outcome) -> bool:
        info = dict(outcome.info)
        if not callable(self.success) and self.success not in info:
            raise EnvError(
                f"success={self.success!r}, but {self._called} has no such entry in the info of an "
                f"episode's last step: {sorted(map(str, info))}"
            )
        try:
            if callable(self.success):
                return bool(self.success(episode_return, outcome.terminated, info))
            return bool(info[self.success])
        except Exception as error:
            raise self._raised(f"success={short(self.success)}", error) from error

    def __getstate__(self) -> dict[str, Any]:
        none = [None] * self.num_envs
        return {**super().__getstate__(), "_envs": none, "_idle": _Idle(self._idle.most)}


def _time_limits(env: gym.Env) -> Iterator[int]:
    """The time limits that an environment and its wrappers declare, in steps or frames."""
    layer: Any = env
    while layer is not None:
        spec = getattr(layer, "spec", None)
        kwargs = spec.kwargs if spec else {}
        for name in _TIME_LIMITS:
            for limit in (getattr(layer, name, None), getattr(spec, name, None), kwargs.get(name)):
                if isinstance(limit, int | np.integer) and limit > 0:
                    yield int(limit)
        layer = layer.env if isinstance(layer, gym.Wrapper) else None


class _Idle:
    """Environments that are not played now, those that were left last at the end.

    The batches of a mixture share one: an env that is drawn a level takes an environment that
    another has left, if there is one. So there are at most `num_envs` that are played and `most`
    that are not, however many levels there are.

    Args:
        most: how many are kept; the others are closed. None: all, where they draw pictures, since
            closing one may end the library that the others draw with.
    """

    def __init__(self, most: int | None) -> None:
        self.most = most
        self.kept: list[tuple[GymnasiumVectorEnv, gym.Env]] = []

    def put(self, batch: "GymnasiumVectorEnv", env: gym.Env) -> None:
        self.kept.append((batch, env))
        if self.most is not None and len(self.kept) > self.most:
            self.kept.pop(0)[1].close()

    def take(self, batch: "GymnasiumVectorEnv") -> gym.Env | None:
        """The one of this batch that was left last; None: there is none."""
        for place in reversed(range(len(self.kept))):
            if self.kept[place][0] is batch:
                return self.kept.pop(place)[1]
        return None

    def close(self) -> None:
        while self.kept:
            self.kept.pop()[1].close()
