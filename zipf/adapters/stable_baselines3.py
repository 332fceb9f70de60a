"""Stable-Baselines3: a batch of environments as its `VecEnv`, and its models as policies.

It needs `pip install ".[sb3]"` in a clone of zipf.
"""

from __future__ import annotations

import inspect
import logging
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import NormalizeObservation
from numpy.typing import NDArray
from torch.nn import ModuleDict

from zipf.adapters.networks import with_underscores
from zipf.envs.vector import Observation, ZipfVectorEnv

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import (
        VecCheckNan,
        VecExtractDictObs,
        VecFrameStack,
        VecMonitor,
        VecNormalize,
        VecTransposeImage,
        VecVideoRecorder,
    )
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvWrapper
    from stable_baselines3.common.vec_env.stacked_observations import StackedObservations
except ImportError as error:
    raise ImportError(
        "zipf.adapters.stable_baselines3 needs Stable-Baselines3: pip install '.[sb3]' in a clone "
        "of zipf"
    ) from error


class ZipfVecEnv(VecEnv):
    """The envs of a batch, stepped together, for agents of Stable-Baselines3.

        model = PPO("MultiInputPolicy", ZipfVecEnv(make_vec("gridworld/zipf_2", 64)))

    Observations are dictionaries of arrays `[N, ...]`, rewards float32 [N] and dones bool [N]. The
    names of their parts have underscores in the place of dots, which PyTorch's modules do not take:
    `arm_angle` for `arm.angle`.
    `reset_infos[i]` has what the environment's `info` tells about the episode that runs in env
    `i`: its ranks (int) and descriptions. `infos[i]` of the step that ends an episode has those of
    that episode and:

    - `terminal_observation`: its last observation, a dictionary of arrays;
    - `TimeLimit.truncated` (bool): it was truncated and not terminated;
    - `is_success` (bool), where the environment reports success;
    - `episode`: `{"r": return, "l": length, "t": seconds since the start}`, as `Monitor` does. No
      `VecMonitor` is needed.

    `infos[i]` of other steps are empty.

    Args:
        env: a batch in `AutoresetMode.SAME_STEP` with `copy=True`.

    Raises:
        ValueError: `env` is no batch of ours, has another autoreset mode, reuses the arrays of its
            observations, or two parts of these would have the same name.
    """

    def __init__(self, env: ZipfVectorEnv) -> None:
        if not isinstance(env, ZipfVectorEnv):
            raise ValueError(f"env must be what zipf.envs.make_vec makes, got {type(env).__name__}")
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"autoreset_mode must be SAME_STEP for Stable-Baselines3, got "
                f"{env.autoreset_mode.name}"
            )
        if not env.copy:
            raise ValueError(
                "copy must be True for Stable-Baselines3, which keeps observations after a step"
            )
        self.env = env
        self._names = _names(env.single_observation_space)
        # Copies: wrappers such as VecNormalize write to the spaces of what they wrap.
        space = deepcopy(_renamed(env.single_observation_space, self._names))
        super().__init__(env.num_envs, space, deepcopy(env.single_action_space))
        self._actions: NDArray[Any] = np.zeros(env.num_envs, np.int64)
        self._start = time.monotonic()

    def reset(self) -> Observation:
        """Starts new episodes, with the seeds of `seed` and the options of `set_options`, once.

        Raises:
            ValueError: the options force ranks in some envs and not in others, or there are no
                such ranks.
        """
        options = self._forced(self._options)
        observation, info = self.env.reset(seed=self._seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [_row(info, i) for i in range(self.num_envs)]
        return self._shown(observation)

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Observations, rewards, dones and infos of the step that `step_async` began."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            final, final_observation = info["final_info"], self._shown(info["final_obs"])
            running = {k: v for k, v in info.items() if k not in ("final_info", "final_obs")}
            seconds = round(time.monotonic() - self._start, 6)
            for i in np.flatnonzero(dones).tolist():
                report = _row(final, i)
                episode = {"r": report.pop("return"), "l": report.pop("length"), "t": seconds}
                if "success" in report:
                    report["is_success"] = report.pop("success")
                infos[i] = {
                    **report,
                    "episode": episode,
                    "terminal_observation": {k: v[i] for k, v in final_observation.items()},
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                }
                self.reset_infos[i] = _row(running, i)
        return self._shown(observation), reward.astype(np.float32), dones, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """The frame of each env; None without `render_mode="rgb_array"`."""
        frames: Any = self.env.render()
        return [None] * self.num_envs if frames is None else frames

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The batch's attribute, once for every env asked about."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Envs of a batch have no attributes of their own: raises `NotImplementedError`."""
        raise NotImplementedError(f"envs of a batch have no {attr_name!r} of their own to set")

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Envs of a batch have no methods of their own: raises `NotImplementedError`."""
        raise NotImplementedError(
            f"envs of a batch have no method {method_name!r} of their own; "
            "call the batch's, by the attribute `env`"
        )

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """True for `Monitor`, whose statistics `infos` has; no other wrapper is inside a batch."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _shown(self, observation: Observation) -> Observation:
        return {self._names[name]: part for name, part in observation.items()}

    def _forced(self, options: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
        """Options of each env as arrays [N]."""
        if any(one.keys() != options[0].keys() for one in options):
            raise ValueError("options must name the same ranks in every env")
        return {name: np.array([one[name] for one in options]) for name in options[0]}


def _names(space: spaces.Dict) -> dict[str, str]:
    """What the parts of an observation are called: without dots, and otherwise than attributes of
    a module, by which PyTorch has a network for each part. Raises ValueError: two would be called
    the same."""
    taken = ModuleDict()
    names = {
        name: f"{other}_" if hasattr(taken, other) else other
        for name, other in with_underscores(space, r"\.").items()
    }
    if len(set(names.values())) < len(names):
        raise ValueError(f"two observations would be called the same: {names}")
    return names


def _renamed(space: spaces.Dict, names: Mapping[str, str]) -> spaces.Dict:
    return spaces.Dict({names[name]: part for name, part in space.items()})


def _row(info: dict[str, Any], i: int) -> dict[str, Any]:
    """One env's entries as Python values."""
    own = {key: value[i] for key, value in info.items() if not key.startswith("_")}
    return {key: one.item() if isinstance(one, np.generic) else one for key, one in own.items()}


def policy(model: BaseAlgorithm, *, deterministic: bool = False) -> ModelPolicy:
    """A model of Stable-Baselines3 or sb3-contrib as a policy; it may be recurrent.

    It is given what the wrappers of its env, `model.get_env()`, make of observations: the
    statistics of `VecNormalize`, which stay as they are, the frames of `VecFrameStack`, the one of
    `VecExtractDictObs`. A file has no env; where there were such wrappers, load it with them:
    `PPO.load(path, env=VecNormalize.load(statistics, vec_env))`.

    Args:
        model: the model. Its attribute `env_options`, where you give it one, names the constructor
            options that it was trained with, and is saved with it.
        deterministic: its most probable actions in the place of draws; always where it explores
            by a schedule (`exploration_rate`), as DQN, which is no part of its policy.

    Raises:
        TypeError: `model` is no such model.
    """
    if not isinstance(model, BaseAlgorithm):
        raise TypeError(f"model is a {type(model).__name__}; should be one, as PPO.load(path) is")
    return ModelPolicy(model, deterministic)


class ModelPolicy:
    """A model for `zipf.evaluate.score`."""

    def __init__(self, model: BaseAlgorithm, deterministic: bool) -> None:
        self.model = model
        self.deterministic = deterministic or hasattr(model, "exploration_rate")
        self.env_options = getattr(model, "env_options", None)

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> ModelPolicy:
        """Prepares for environments with these spaces; draws are from PyTorch's global generator.

        Raises:
            ValueError: the model has other spaces, or what its env made of observations or actions
                is not known.
        """
        env, self.wrappers = _unwrapped(self.model)
        declared = self.model.observation_space if env is None else env.observation_space
        self.names = {name: name for name in observation_space}
        if isinstance(declared, spaces.Dict) and declared.keys() != observation_space.keys():
            self.names = _names(observation_space)
        expected: spaces.Space = _renamed(observation_space, self.names)
        self.alone: str | None = None  # the only observation, for a model that reads an array
        if len(observation_space) == 1 and not isinstance(declared, spaces.Dict):
            self.alone = next(iter(observation_space))
            expected = observation_space[self.alone]
        if not _same_space(_unwritten(declared, expected, self.wrappers), expected):
            raise ValueError(
                f"the model's observation space, {declared}, differs from the environments', "
                f"{expected}"
            )
        if self.model.action_space != action_space:
            raise ValueError(
                f"the model's action space, {self.model.action_space}, differs from the "
                f"environments', {action_space}"
            )
        return self

    def start(self, num_envs: int) -> None:
        self.state: Any = None
        self.frames = {
            wrapper: _frames(wrapper.stacked_obs, num_envs)
            for wrapper in self.wrappers
            if isinstance(wrapper, VecFrameStack)
        }

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        given: Any = {self.names[name]: part for name, part in observation.items()}
        if self.alone:
            given = observation[self.alone]
        for wrapper in self.wrappers:
            if isinstance(wrapper, VecNormalize):
                given = wrapper.normalize_obs(given)
            elif isinstance(wrapper, VecFrameStack):
                given = _stacked(self.frames[wrapper], given, is_first)
            elif isinstance(wrapper, VecTransposeImage):
                given = wrapper.transpose_observations(given)
            elif isinstance(wrapper, VecExtractDictObs):
                given = given[wrapper.key]
        actions, self.state = self.model.predict(given, self.state, is_first, self.deterministic)
        return actions


_WRAPPERS = (
    *(VecNormalize, VecFrameStack, VecTransposeImage, VecExtractDictObs),
    *(VecMonitor, VecCheckNan, VecVideoRecorder),  # these leave observations as they are
)
_LOAD = "load it with them, as in PPO.load(path, env=VecNormalize.load(statistics, vec_env))"


def _unwrapped(model: BaseAlgorithm) -> tuple[VecEnv | None, list[VecEnvWrapper]]:
    """The env that a model was trained in, None where it is not known, and its wrappers, the
    innermost first.

    Raises:
        ValueError: a model plays otherwise than it was trained without something that is not known
            here.
    """
    wrappers: list[VecEnvWrapper] = []
    env = model.get_env()
    has_masks = "action_masks" in inspect.signature(model.predict).parameters
    while isinstance(env, VecEnvWrapper):
        if type(env) not in _WRAPPERS:
            raise ValueError(
                f"the model's env has the wrapper {type(env).__name__}, and what it makes of "
                f"observations is not known; should be {', '.join(w.__name__ for w in _WRAPPERS)}. "
                "If it leaves them as they are, load the model without an env, as by PPO.load(path)"
            )
        wrappers.insert(0, env)
        env = env.venv
    if wrappers and isinstance(wrappers[-1], VecTransposeImage):
        wrappers.pop()  # `predict` does that itself
    # Models that learn off policy keep the last observation there in any case.
    normalised = getattr(model, "_last_original_obs", None) is not None
    off_policy = isinstance(model, OffPolicyAlgorithm)
    if normalised and not off_policy and not _normalises(wrappers):
        raise ValueError(
            "the model was trained under VecNormalize, and it is not given its statistics: " + _LOAD
        )
    # Of a loaded model, which has not played in this env, so that it may have had another.
    loaded = off_policy and model._last_obs is None and not _normalises(wrappers)
    if (env is None and (has_masks or off_policy)) or (normalised and loaded):
        missing = "action_masks or wrappers" if has_masks else "wrappers such as VecNormalize"
        logging.getLogger("zipf").warning(
            f"the model is scored without {missing}, which its file does not have; if its env had "
            f"any, {_LOAD}"
        )
    if env is not None and not getattr(env, "closed", False):  # its processes may have ended
        if any(env.env_is_wrapped(NormalizeObservation)):
            raise ValueError(
                "the model's env normalises observations by Gymnasium's NormalizeObservation, with "
                "other statistics in each env; should be VecNormalize around all of them"
            )
        if has_masks and env.has_attr("action_masks"):
            raise ValueError(
                "the model chooses among the actions that its env's action_masks allow, and a "
                "policy is not given any; should be trained with use_masking=False"
            )
    return env, wrappers


def _normalises(wrappers: list[VecEnvWrapper]) -> bool:
    return any(isinstance(wrapper, VecNormalize) for wrapper in wrappers)


def _unwritten(
    declared: spaces.Space, expected: spaces.Space, wrappers: list[VecEnvWrapper]
) -> spaces.Space:
    """An env's space without what `VecNormalize` has written into it: what it makes of images."""
    if not isinstance(declared, spaces.Dict) or not isinstance(expected, spaces.Dict):
        return declared
    own = dict(declared.spaces)
    for wrapper in wrappers:
        if isinstance(wrapper, VecNormalize) and wrapper.norm_obs:
            for name in own.keys() & expected.keys() & set(wrapper.norm_obs_keys or ()):
                if own[name].shape == expected[name].shape:
                    own[name] = expected[name]
    return spaces.Dict(own)


def _frames(stack: StackedObservations[Any], num_envs: int) -> StackedObservations[Any]:
    """A stack of frames of the same kind, empty, for `num_envs` envs."""
    stack = deepcopy(stack)
    for one in getattr(stack, "sub_stacked_observations", {"": stack}).values():
        one.stacked_obs = np.zeros((num_envs, *one.stacked_shape), one.stacked_obs.dtype)
    return stack


def _stacked(stack: StackedObservations[Any], observation: Any, is_first: NDArray) -> Any:
    """What a stack of frames has after these observations."""
    infos: list[dict[str, Any]] = [{} for _ in is_first]
    for i in np.flatnonzero(is_first):  # the last frames of an episode, which nobody asks for
        row = (
            {k: v[i] for k, v in observation.items()}
            if isinstance(observation, dict)
            else observation[i]
        )
        infos[i]["terminal_observation"] = row
    return stack.update(observation, is_first, infos)[0]


def _same_space(declared: spaces.Space, expected: spaces.Space) -> bool:
    """Whether they are equal, or the declared one has an image's channels first.

    Stable-Baselines3 declares images so where they came with channels last, and transposes what
    `predict` is given.
    """
    if isinstance(declared, spaces.Dict) and isinstance(expected, spaces.Dict):
        return declared.keys() == expected.keys() and all(
            _same_space(declared[name], expected[name]) for name in expected
        )
    if isinstance(declared, spaces.Box) and len(declared.shape) == 3:
        low, high = (np.moveaxis(bound, 0, -1) for bound in (declared.low, declared.high))
        return expected in (declared, spaces.Box(low, high, dtype=declared.dtype.type))
    return declared == expected
