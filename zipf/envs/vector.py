"""The base class of batched environments, which every family of the benchmark derives from."""

from abc import abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any, Self, cast

import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from zipf.envs import pcg64
from zipf.envs.arguments import mapping, reset_options, whole
from zipf.envs.errors import EnvError
from zipf.envs.pictures import fit

Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]
Step = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]

RESERVED = (
    "achieved",
    "final_info",
    "final_obs",
    "has_achieved",
    "length",
    "reset_mask",
    "return",
    "success",
)
"""Entries of `info` and options of `reset` that every batch has."""

COLUMNS = (
    "episodes",
    "level_kind",
    "level_name",
    "return_sum",
    "successes",
    "update",
    "visits",
)
"""Columns of evaluations beside the ranks of a situation."""


def own_name(what: str, name: Any) -> str:
    """The name of an entry of `info` that a family has of its own.

    Raises:
        ValueError: it is no string, is in `RESERVED`, or begins with an underscore as masks do.
    """
    if not isinstance(name, str) or name in RESERVED or name.startswith("_"):
        raise ValueError(
            f"{what} cannot be called {name!r}: expected a string that does not begin with an "
            f"underscore and is none of the reserved names {', '.join(RESERVED)}"
        )
    return name


def rank_name(what: str, name: Any) -> str:
    """The name of a rank.

    Raises:
        ValueError: as `own_name`, or it is in `COLUMNS`.
    """
    if name in COLUMNS:
        raise ValueError(
            f"{what} cannot be called {name!r}: evaluations have columns {', '.join(COLUMNS)} of "
            "their own"
        )
    return own_name(what, name)


SHARED = ("_streams", "_running", "_lengths", "_returns", "_restarted")
"""Arrays of a batch that batches inside of it work on in the place of their own."""


class ZipfVectorEnv(VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """`N` envs that step together and report the situation of every episode.

    A `gymnasium.vector.VectorEnv` in any of Gymnasium's autoreset modes, with:

    - **Situations.** An episode is drawn at one or more frequency ranks (0 = most frequent), named
      and sized in `situation`. `info` holds the ranks of the running episodes, int64 [N] each, and
      the family's own entries (`_describe`), for instance instructions as text.
    - **Own random streams.** Env `i` after `reset(seed=s)` draws from
      `numpy.random.default_rng(s + i)` and equals a single environment seeded `s + i`.
    - **Writing in place.** `reset(out=...)` and `step(actions, out=..., final_out=...)` write
      observations to the caller's C-contiguous arrays `[N, ...]`, with the dtypes and shapes of
      `observation_space`, and return those.
    - **Complete state.** After `set_state(get_state())` stepping continues bit for bit.

    A step in which episodes end reports their outcome: `success` (bool, unless `reports_success`
    is False), `return` (float64) and `length` (int64, in steps), arrays [N]. The autoreset mode
    says where, and when the next episodes begin:

    - `SAME_STEP` (the default): in the same step. `info["final_info"]` holds ranks, descriptions
      and outcome of the ended episodes, `info["final_obs"]` their last observations, a dict of
      arrays [N, ...]. Both are valid only where the masks `_final_info` and `_final_obs` (bool [N])
      are set. `final_obs` is written to `final_out`; with `out` and no `final_out` it is left out,
      which saves drawing it.
    - `NEXT_STEP`: in the next step, which ignores the actions of these envs and returns the
      first observations of the new episodes, with reward 0 and neither terminated nor truncated.
      The step that ends an episode returns its last observation, and `info` holds the outcome,
      valid where the masks `_success`, `_return` and `_length` are set.
    - `DISABLED`: when the caller resets these envs, by
      `reset(options={"reset_mask": mask})` (bool [N]), which leaves the others as they are. The
      outcome is in `info` as in `NEXT_STEP`.

    Args:
        num_envs: number of envs N.
        single_observation_space: the observations of one env.
        single_action_space: the actions of one env, counted from 0.
        situation: name and size of each rank an episode is drawn at; may be empty. The names in
            `RESERVED` and `COLUMNS` and those that begin with an underscore are taken.
        autoreset_mode: a `gymnasium.vector.AutoresetMode` or its value: "SameStep", "NextStep" or
            "Disabled".
        copy: whether observations returned without `out` are fresh arrays (True, as in
            Gymnasium's SyncVectorEnv) or this environment's own, overwritten by the next step.
        render_mode: one of `metadata["render_modes"]` or None.

    Attributes:
        reports_success: whether episodes end with a success or a failure. Where it is False,
            `success` is left out of all infos.
        achieves: whether the family tells what an episode has achieved, see `report_achieved`.
        action_regions: float32 [actions, 4], the part of the image that the action points at when
            it ends an episode (top, left, bottom, right, in sides of the image): what is achieved
            is there, and nothing else. None where actions do not point.
        sliceable: whether several batches of this class may work at the same time, each in a thread
            or a process of its own, see `zipf.envs.slices`.
        longest_episode: an evaluation takes an episode of more steps for one that never ends.
        time_limit: steps after which an episode is truncated, at most; None: it is not known.
        level_of_envs: of several levels the name of each env's, [N], or, where one is drawn at
            every reset, the entry of `info` that has it; None: there is one level.

    Raises:
        ValueError: for an argument out of range, a reserved name in `situation`, or an action space
            other than a `Discrete` that starts at 0.
    """

    single_observation_space: spaces.Dict
    single_action_space: spaces.Discrete
    situation: dict[str, int]
    reports_success: bool = True
    achieves: bool = False
    action_regions: NDArray[np.float32] | None = None
    sliceable: bool = False
    longest_episode: int = 1_000_000  # ours
    time_limit: int | None = None
    level_of_envs: str | NDArray[np.str_] | None = None

    def __init__(
        self,
        num_envs: int,
        *,
        single_observation_space: spaces.Dict,
        single_action_space: spaces.Discrete,
        situation: Mapping[str, int],
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
    ) -> None:
        num_envs = whole("num_envs", num_envs, 1)
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *modes):
            raise ValueError(f"autoreset_mode must be one of {modes}, got {autoreset_mode!r}")
        autoreset_mode = AutoresetMode(autoreset_mode)
        if not isinstance(single_action_space, spaces.Discrete) or single_action_space.start != 0:
            raise ValueError(
                "single_action_space must be a Discrete space that starts at 0, "
                f"got {single_action_space}"
            )
        drawn = self.metadata.get("render_modes") or []
        if render_mode is not None and render_mode not in drawn:
            none = "None: these envs draw no pictures (their `metadata` has no `render_modes`)"
            known = f"one of {drawn} or None" if drawn else none
            raise ValueError(f"render_mode must be {known}, got {render_mode!r}")
        self.num_envs = num_envs
        self.single_observation_space = single_observation_space
        self.single_action_space = single_action_space
        self.action_space = batch_space(single_action_space, num_envs)
        self.situation = {rank_name("a rank", name): size for name, size in situation.items()}
        self.autoreset_mode = autoreset_mode
        self.metadata = {**self.metadata, "autoreset_mode": autoreset_mode}
        self.render_mode = render_mode
        self.copy = copy

        self._streams = np.zeros((num_envs, 4), dtype=np.uint64)
        self._seeded = np.zeros(num_envs, dtype=np.bool_)
        self._running = np.zeros(num_envs, dtype=np.bool_)
        self._lengths = np.zeros(num_envs, dtype=np.int64)
        self._returns = np.zeros(num_envs, dtype=np.float64)
        self._restarted = np.zeros(num_envs, dtype=np.bool_)
        self._all_running = False
        self._reports_achieved = False
        self._everywhere = np.ones(num_envs, dtype=np.bool_)
        self._unforced = np.full((len(self.situation), num_envs), -1, dtype=np.int64)
        self._shapes = {
            key: ((num_envs, *space.shape), space.dtype)
            for key, space in single_observation_space.items()
            if space.shape is not None
        }
        self._float_parts = [
            name
            for name, (_, dtype) in self._shapes.items()
            if dtype is not None and dtype.kind == "f"
        ]
        self._buffers: dict[str, Observation] = {}

    @cached_property
    def observation_space(self) -> spaces.Dict:  # type: ignore[override]
        """The batched space, made when asked for.

        Gymnasium keeps the bounds of every pixel of every env, four times what a batch of images
        takes itself. They are all alike, so here they are views of the single space's.
        """
        batched = cast(spaces.Dict, batch_space(self.single_observation_space, self.num_envs))
        for key, space in batched.items():
            single = self.single_observation_space[key]
            if isinstance(space, spaces.Box) and isinstance(single, spaces.Box):
                for bound in ("low", "high", "bounded_below", "bounded_above"):
                    setattr(space, bound, np.broadcast_to(getattr(single, bound), space.shape))
        return batched

    # What a family implements.

    @abstractmethod
    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        """Starts an episode in the envs of `mask`, drawing from `self._streams`.

        Env `i` draws from its own stream only: a rank by
        `zipf.envs.pcg64.choice(self._streams[i], cdf)`, where `cdf` is
        `zipf.envs.pcg64.cumulative(probabilities)`, and a number in [0, 1) by
        `zipf.envs.pcg64.next_double(self._streams[i])`. Both work in numba kernels, too.

        `forced` is int64 [ranks, N] in the order of `self.situation`, -1 where to draw. Draw
        forced ranks all the same, so that the episodes that follow do not depend on it.
        """

    @abstractmethod
    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Steps the envs of `mask`, without autoreset.

        Returns reward, terminated, truncated and success [N].

        The arrays are fresh ones; their entries of other envs are not used. `self._lengths`
        counts this step already. Success is used only where an episode ends, and nowhere if
        `reports_success` is False.
        """

    @abstractmethod
    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        """Writes the observations of the envs of `mask` to their rows of `out`."""

    @abstractmethod
    def _situations(self) -> dict[str, NDArray[np.int64]]:
        """The ranks of the running episodes, as fresh arrays int64 [N]."""

    def _describe(self) -> dict[str, NDArray[Any]]:
        """Further entries of `info` about the running episodes, as fresh arrays [N] of any dtype.

        Their names differ from those of the situation, are none of `RESERVED` and do not begin with
        an underscore; `reset` raises ValueError for others.
        """
        return {}

    def _achieved(self, ended: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Goals that the episodes achieved which have just ended in the envs of `ended`; for
        families with `achieves`.

        Returns a fresh array [N, K] of goals, as the family's `Goal` reads them, and bool [N]:
        whether there is one. A goal counts as achieved if an episode that asked for it would have
        ended with this step as a success. Of a successful episode it is its own goal.
        """
        raise NotImplementedError

    @abstractmethod
    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        """The family's own state, as a flat dict of numeric arrays that may alias it."""

    @abstractmethod
    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restores the family's own state from a complete one, with the keys of `_get_env_states`.

        A family that cannot restore the running episode of an env begins one and sets the
        env's entry of `self._restarted`.

        Raises ValueError, with nothing restored, if a kernel could not work on it: a kernel checks
        no bounds. Numbers may be anything; those of envs that have not begun (`state["seeded"]`)
        are never stepped.
        """

    _state_axis: Mapping[str, int] = {}
    """Of keys of `_get_env_states` the axis that counts envs, where it is not the first."""

    _resizable: frozenset[str] = frozenset()
    """Keys of `_get_env_states` whose arrays may be of another length in another state."""

    def _engine(self) -> Hashable:
        """A value that is equal for batches which differ only in how their episodes begin.

        A `Mixture` steps and draws the envs of such levels together. None, as here, if there are
        no such batches; otherwise the family implements `_use_engine`, too.
        """
        return None

    def _use_engine(self, other: Self) -> None:
        """Uses the state of `other`, a batch with an equal `_engine`, in the place of its own."""
        raise NotImplementedError

    def _share(self) -> None:
        """Makes the batches inside this one, if there are any, work on its arrays."""

    def _leave(self, envs: list[int]) -> None:
        """In a mixture: these envs go on to other levels. Most families have nothing to free."""

    def name_of(self, i: int) -> str:
        """What env `i` is called in errors."""
        return type(self).__name__

    def _use_processes(self, other: "ZipfVectorEnv") -> None:
        """In a mixture: shares the external processes (an engine for each env) of `other`, the
        mixture's first batch, since an env is of one level at a time. Most families have none."""

    # What users call.

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
        out: Observation | None = None,
    ) -> tuple[Observation, Info]:
        """Starts new episodes.

        Args:
            seed: `s` seeds env `i` with `s + i`; a list seeds each env by itself, and None
                lets an env's stream go on (from fresh entropy if it was never seeded).
            options: `reset_mask` (bool [N]) limits the reset to some envs. The name of a rank
                of the situation forces it: an integer for all envs or integers [N].
            out: where to write the observations, else as the constructor's `copy` says.

        Returns:
            Observations of all envs and `info` about all running episodes.

        Raises:
            ValueError: for seeds, options or `out` of the wrong length, type or range.
            EnvError: an observation is not finite.
        """
        if self.closed:
            raise ClosedEnvironmentError("reset() of an environment that was closed")
        mask, forced = self._read_options(options)
        seeds = self._read_seeds(seed)
        observation = self._writable(out, "out")
        for i in np.flatnonzero(mask):
            if seeds[i] is not None or not self._seeded[i]:
                self._streams[i] = pcg64.stream(seeds[i])
                self._seeded[i] = True
        self._begin_episodes(mask, forced)
        self._observe(observation, self._everywhere)
        self._check_finite(observation, mask)
        described = self._describe()
        for name in described:
            if own_name("an entry of info", name) in self.situation:
                raise ValueError(f"info cannot have both a rank and another entry {name!r}")
        return observation, {**self._situations(), **described}

    def step(
        self,
        actions: NDArray[Any],
        *,
        out: Observation | None = None,
        final_out: Observation | None = None,
    ) -> Step:
        """Takes one action in every env.

        Args:
            actions: integers [N].
            out: where to write the observations, else as the constructor's `copy` says.
            final_out: where to write the last observations of episodes that end (their rows only).

        Returns:
            Observations, reward (float64 [N]), terminated, truncated (bool [N]) and `info`, as
            the class describes.

        Raises:
            ValueError: for actions or buffers of the wrong shape, dtype or range, or buffers that
                share memory; nothing has happened then.
            EnvError: an observation is not finite.
            ResetNeeded: if an env has to be reset first. After an exception of the envs' engine
                all envs that it was stepping have to be.
        """
        if self.closed:
            raise ClosedEnvironmentError("step() of an environment that was closed")
        begins = not self._all_running  # some envs begin an episode in this step
        mask = self._everywhere
        if begins:
            next_step = self.autoreset_mode is AutoresetMode.NEXT_STEP
            waiting = ~(self._seeded if next_step else self._running)
            if waiting.any():
                envs = np.flatnonzero(waiting).tolist()
                raise ResetNeeded(f"step() needs a running episode: reset envs {envs} first")
            mask = self._running.copy()
        actions = self._read_actions(actions, mask)
        observation = self._writable(out, "out")
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        final: Observation | None = None
        if same_step and (final_out is not None or out is None):
            final = self._writable(final_out, "final_out")
            if final_out is not None:
                for key, array in final.items():
                    if np.may_share_memory(array, observation[key]):
                        raise ValueError(
                            f"final_out[{key!r}] must not share memory with the array that the "
                            "observations are written to"
                        )

        return self._step_checked(actions, mask, observation, final)

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """A picture of each env for people, uint8 [rows, columns, 3], as large as fits into these
        pixels in its own proportions. Families that can draw at any size do so, without captions;
        of others these are the frames of `render`, scaled. For `render_mode="rgb_array"`."""
        return tuple(fit(np.asarray(frame), width, height) for frame in self.render() or ())

    def report_achieved(self) -> None:
        """From now on the outcome of an episode has two entries more: `achieved` [N, K], the goal
        that it would have been a success for, in the code of the family's `zipf.envs.goals.Goal`,
        valid where `has_achieved` (bool [N]) is set.

        Raises:
            ValueError: these envs do not tell what an episode has achieved.
        """
        if not self.achieves:
            raise ValueError("these envs do not tell what an episode has achieved")
        self._reports_achieved = True

    def check_lengths(self, counted: NDArray[np.bool_] | None = None) -> None:
        """For whoever plays episodes to their end.

        Raises:
            EnvError: the running episode of one of the envs `counted` (bool [N]; None: all) is
                longer than `longest_episode`. A mean over those that have ended would be of other
                episodes.
        """
        if self._lengths.max() <= self.longest_episode:
            return
        endless = self._lengths > self.longest_episode
        if counted is not None:
            endless &= counted
        if endless.any():
            raise EnvError(
                f"{self.name_of(int(endless.argmax()))}: an episode has not ended after "
                f"{self.longest_episode} steps, so there is no score: give the environment a time "
                "limit, or longest_episode=... a larger number"
            )

    def observations(self, out: Observation | None = None) -> Observation:
        """The current observations, written as by `step`; for use after `set_state`."""
        observation = self._writable(out, "out")
        self._observe(observation, self._everywhere)
        return observation

    def allocate(self) -> Observation:
        """Fresh arrays fit for `out` and `final_out`, all zero."""
        return {key: np.zeros(shape, dtype) for key, (shape, dtype) in self._shapes.items()}

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that stepping depends on, random streams included, as numeric arrays."""
        state = {
            "streams": self._streams,
            "seeded": self._seeded,
            "running": self._running,
            "lengths": self._lengths,
            "returns": self._returns,
            **self._get_env_states(),
        }
        return {key: value.copy() for key, value in state.items()}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Restores what `get_state` returned, here or in an equal environment.

        Returns:
            bool [N], where the running episode could not be restored and a new one has begun.
            None of the benchmark's families needs this; an environment that is not deterministic
            does.

        Raises:
            ValueError: if the state is of another kind or number of envs, or damaged. The envs
                are then as they were.
        """
        own = self.get_state()
        if not isinstance(state, Mapping) or state.keys() != own.keys():
            got = list(state) if isinstance(state, Mapping) else type(state).__name__
            raise ValueError(f"a state has the keys {sorted(own)}, got {got}")
        for key, value in own.items():
            if not isinstance(state[key], np.ndarray):
                raise ValueError(
                    f"state {key!r} must be an array, got a {type(state[key]).__name__}"
                )
            shape = state[key].shape
            if key in self._resizable and value.ndim == len(shape):
                shape = (len(value), *shape[1:])
            if shape != value.shape or state[key].dtype != value.dtype:
                raise ValueError(
                    f"state {key!r} must be {value.dtype} {value.shape}, "
                    f"got {state[key].dtype} {state[key].shape}"
                )
        if (state["running"] & ~state["seeded"]).any():
            raise ValueError("the state is damaged: envs are running that have not begun")
        if (state["lengths"] < 0).any() or not np.isfinite(state["returns"]).all():
            raise ValueError("the state is damaged: lengths or returns of episodes out of range")
        self._restarted[:] = False
        self._set_env_states(state)
        self._streams[:] = state["streams"]
        self._seeded[:] = state["seeded"]
        self._running[:] = state["running"]
        self._lengths[:] = state["lengths"]
        self._returns[:] = state["returns"]
        self._lengths[self._restarted] = 0
        self._returns[self._restarted] = 0.0
        self._running[self._restarted] = True
        self._all_running = bool(self._running.all())
        return self._restarted.copy()

    def __getstate__(self) -> dict[str, Any]:
        state = {**self.__dict__, "_buffers": {}}
        state.pop("observation_space", None)
        return state

    def _step_checked(
        self,
        actions: NDArray[np.int64],
        mask: NDArray[np.bool_],
        observation: Observation,
        final: Observation | None,
    ) -> Step:
        """`step` with arguments that were checked: steps the envs of `mask`, and begins episodes in
        the others."""
        begins = mask is not self._everywhere
        if begins:
            self._begin_episodes(~mask, self._unforced)
        self._lengths += mask
        try:
            reward, terminated, truncated, success = self._advance(actions, mask)
        except BaseException:
            # Some envs may have been stepped and others not.
            self._lose(mask)
            raise
        now = self._running_info()
        if begins:
            reward = np.where(mask, reward, 0.0)
            terminated, truncated = terminated & mask, truncated & mask
        self._returns += reward
        done = terminated | truncated
        info: Info = now
        if done.any():
            outcome: dict[str, NDArray[Any]] = {
                "return": self._returns.copy(),
                "length": self._lengths.copy(),
            }
            if self.reports_success:
                outcome["success"] = success
            if self._reports_achieved:
                outcome["achieved"], outcome["has_achieved"] = self._achieved(done)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                info = {"final_info": {**now, **outcome}, "_final_info": done}
                if final is not None:
                    self._observe(final, done)
                    self._check_finite(final, done)
                    info["final_obs"] = final
                    info["_final_obs"] = done.copy()
                try:
                    self._begin_episodes(done, self._unforced)
                except BaseException:
                    self._lose(mask)  # what the other envs did in this step is lost
                    raise
                info.update(self._running_info())
            else:
                info.update(outcome)
                info.update({f"_{key}": done.copy() for key in outcome})
                self._running &= ~done
                self._all_running = False
        self._observe(observation, self._everywhere)
        self._check_finite(observation, self._everywhere)
        return observation, reward, terminated, truncated, info

    def _lose(self, mask: NDArray[np.bool_]) -> None:
        """The envs of `mask` have to be reset before the next step, in every mode."""
        self._running &= ~mask
        self._all_running = False
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:  # which would begin episodes in them
            self._seeded &= ~mask

    def _begin_slice(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        """`_begin` of a slice of another batch."""
        if mask.any():
            self._begin(mask, np.ascontiguousarray(forced))

    def _step_slice(
        self, actions: NDArray[np.int64], observation: Observation, final: Observation | None
    ) -> Any:
        """Steps a slice of another batch, which has begun and ended episodes since: reward,
        terminated and truncated, `info` of the running episodes, and that of those that ended."""
        self._all_running = bool(self._running.all())
        _, reward, terminated, truncated, info = self.step(
            actions, out=observation, final_out=final
        )
        now = {k: v for k, v in info.items() if k not in RESERVED and not k.startswith("_")}
        last = info.get("final_info", {k: v for k, v in info.items() if k in RESERVED})
        return reward, terminated, truncated, now, last

    def _running_info(self) -> Info:
        return {**self._situations(), **self._describe()}

    def _check_finite(self, observation: Observation, mask: NDArray[np.bool_]) -> None:
        """Raises EnvError where a float of the envs of `mask` is NaN or infinite: policies would
        act on it without a word."""
        for name in self._float_parts:
            finite = np.isfinite(observation[name])
            if finite.all():
                continue
            finite = finite.reshape(self.num_envs, -1).all(1) | ~mask
            if finite.all():
                continue
            i = int(finite.argmin())
            self._lose(self._everywhere)
            raise self._not_finite(i, name, observation[name][i])

    def _not_finite(self, i: int, name: str, values: NDArray[Any]) -> EnvError:
        """The error for a part of the observation of env `i`."""
        wrong = values[~np.isfinite(values)].flat[0]
        return EnvError(
            f"{self.name_of(i)}: observation {name!r} has the value {wrong} after step "
            f"{self._lengths[i]} of an episode: observations must be finite"
        )

    def _begin_episodes(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        self._running[mask] = self._all_running = False  # as it stays if `_begin` raises
        self._begin(mask, forced)
        self._lengths[mask] = 0
        self._returns[mask] = 0.0
        self._running[mask] = True
        self._all_running = bool(self._running.all())

    # Checks of arguments.

    def _writable(self, out: Observation | None, name: str) -> Observation:
        if out is None:
            if self.copy:
                return self.allocate()
            if name not in self._buffers:
                self._buffers[name] = self.allocate()
            return dict(self._buffers[name])  # whose entries the caller may replace
        if mapping(name, out).keys() != self._shapes.keys():
            raise ValueError(f"{name} must have the keys {list(self._shapes)}, got {list(out)}")
        for key, (shape, dtype) in self._shapes.items():
            array = out[key]
            if (
                not isinstance(array, np.ndarray)
                or array.shape != shape
                or array.dtype != dtype
                or not (array.flags.c_contiguous and array.flags.writeable)
            ):
                got = type(array).__name__
                if isinstance(array, np.ndarray):
                    got = f"{array.dtype} {array.shape}"
                raise ValueError(
                    f"{name}[{key!r}] must be a writable C-contiguous array {dtype} {shape}, "
                    f"got {got}"
                )
        return out

    def _read_actions(self, actions: Any, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
        """The actions of the envs of `mask`, int64 [N], 0 for the others."""
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or actions.dtype.kind not in "iu":
            got = f"{actions.dtype} of shape {actions.shape}" if actions.shape else "a single one"
            raise ValueError(
                f"actions must be integers of shape ({self.num_envs},), one for each env, got {got}"
            )
        actions = np.ascontiguousarray(actions, dtype=np.int64)
        if mask is not self._everywhere:
            actions = np.where(mask, actions, 0)
        # As unsigned, a negative action is a huge one.
        if (actions.view(np.uint64) >= self.single_action_space.n).any():
            raise ValueError(
                f"actions must be in 0 .. {self.single_action_space.n - 1}, "
                f"got {actions.min()} .. {actions.max()}"
            )
        return actions

    def _read_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif (isinstance(seed, np.ndarray) and seed.ndim > 0) or (
            isinstance(seed, Sequence) and not isinstance(seed, str | bytes)
        ):
            seeds = list(seed)
        else:
            first = whole("seed", seed, 0)
            seeds = [first + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must have {self.num_envs} entries, got {len(seeds)}")
        return [None if one is None else whole("each seed", one, 0) for one in seeds]

    def _read_options(
        self, options: Mapping[str, Any] | None
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """The envs to reset, bool [N], and the ranks to force, int64 [ranks, N]."""
        options = reset_options(options, ["reset_mask", *self.situation])
        mask = np.asarray(options.get("reset_mask", self._everywhere))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(
                f"reset_mask must be bool of shape ({self.num_envs},), "
                f"got {mask.dtype} of shape {mask.shape}"
            )
        forced = self._unforced
        for row, (name, size) in enumerate(self.situation.items()):
            if name not in options:
                continue
            ranks = np.asarray(options[name])
            if ranks.dtype.kind not in "iu" or ranks.shape not in ((), (self.num_envs,)):
                raise ValueError(
                    f"option {name!r} must be an integer or {self.num_envs} integers, "
                    f"got {options[name]!r}"
                )
            if (ranks < 0).any() or (ranks >= size).any():
                raise ValueError(
                    f"option {name!r} must be in 0 .. {size - 1}, got {options[name]!r}"
                )
            forced = forced.copy()
            forced[row] = ranks
        return mask, forced
