"""A batch stepped by several threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cached_property, partial
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import whole
from zipf.envs.remembering import Remembering
from zipf.envs.vector import SHARED, Observation, Step, ZipfVectorEnv

Make = Callable[..., ZipfVectorEnv]
"""Makes rows of a batch: `make(rows, num_envs, autoreset_mode=..., render_mode=..., **options)`."""

ALIKE = (
    "sliceable", "metadata", "reports_success", "achieves", "action_regions", "longest_episode",
    "time_limit", "single_observation_space", "single_action_space", "situation", "_state_axis",
)  # fmt: skip
"""What the batch has as its slices do."""


class Slices(ZipfVectorEnv):
    """`N` envs in consecutive slices, each a batch of its own that a thread of its own steps.

    The slices work on rows of this batch's arrays. An env draws from its own stream alone, so the
    number of threads changes the speed and no bit of what is observed. Threads step, lay out and
    draw at the same time as far as the compiled code takes; what is plain Python takes turns.

    Attributes:
        rows: the rows of this batch that each slice is.
        parts: the slices.

    Args:
        make: makes the rows `rows` of `num_envs` envs, a batch with `sliceable`.
        num_envs: number of envs N.
        count: how many threads, at most N.
        autoreset_mode, copy, render_mode: see `ZipfVectorEnv`.
        options: of `make`.

    Raises:
        ValueError: the envs cannot be sliced, or there are fewer than threads.
    """

    _workers = "threads"

    def __init__(
        self,
        make: Make,
        num_envs: int,
        count: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        num_envs, count = whole("num_envs", num_envs, 1), whole(self._workers, count, 1)
        if count > num_envs:
            raise ValueError(f"{self._workers}={count}: should be at most num_envs={num_envs}")
        ends = [num_envs * (k + 1) // count for k in range(count)]
        self.rows = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        options |= {"autoreset_mode": autoreset_mode, "render_mode": render_mode}
        found = self._make(partial(make, num_envs=num_envs, **options))
        for name in ALIKE:
            setattr(self, name, found[0][name])
        levels = [one["level_of_envs"] for one in found]
        self.level_of_envs = (
            np.concatenate(levels) if isinstance(levels[0], np.ndarray) else levels[0]
        )
        super().__init__(
            num_envs,
            single_observation_space=self.single_observation_space,
            single_action_space=self.single_action_space,
            situation=self.situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._share_rows()

    def _make(self, make: Callable[[slice], ZipfVectorEnv]) -> list[dict[str, Any]]:
        """Makes the slices, and returns what this batch has of them."""
        self.parts = [make(rows) for rows in self.rows]
        return [described(part, self._workers, len(self.rows)) for part in self.parts]

    def _share_rows(self) -> None:
        for rows, part in zip(self.rows, self.parts, strict=True):
            share(vars(self), part, rows)

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(len(self.parts) - 1 or 1, "zipf-envs")

    def each(
        self,
        method: str,
        args: Callable[[slice], tuple[Any, ...]] = lambda rows: (),
        of: Sequence[Any] | None = None,
    ) -> list[Any]:
        """Calls a method of every slice, each in its thread; what one raises is raised here once
        all have ended.

        Args:
            method: its name.
            args: its arguments, by the slice's rows.
            of: what `bind` returned, to call in the place of the slices.
        """
        first, *others = [
            partial(getattr(one, method), *args(rows))
            for one, rows in zip(of or self.parts, self.rows, strict=True)
        ]
        waiting = [self._pool.submit(one) for one in others]
        try:
            found = first()
        finally:
            wait(waiting)
        return [found, *(one.result() for one in waiting)]

    def bind(self, make: Callable[[ZipfVectorEnv], Any]) -> list[Any]:
        """What `make` makes of every slice."""
        return [make(part) for part in self.parts]

    def name_of(self, i: int) -> str:
        # Every slice answers, for the env of its own that is nearest.
        names = self.each(
            "name_of", lambda rows: (min(max(i, rows.start), rows.stop - 1) - rows.start,)
        )
        return str(next(name for name, rows in zip(names, self.rows, strict=True) if i < rows.stop))

    def render(self) -> tuple[Any, ...] | None:
        """The envs' frames; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return tuple(frame for part in self.each("render") for frame in part)

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """The envs' pictures."""
        drawn = self.each("pictures", lambda rows: (width, height))
        return tuple(picture for part in drawn for picture in part)

    def report_achieved(self) -> None:
        super().report_achieved()
        self.each("report_achieved")

    def close_extras(self, **kwargs: Any) -> None:
        self._pool.shutdown()
        for part in self.parts:
            part.close(**kwargs)

    def _step_checked(
        self,
        actions: NDArray[np.int64],
        mask: NDArray[np.bool_],
        observation: Observation,
        final: Observation | None,
    ) -> Step:
        try:
            found = self._step_slices(actions, observation, final)
        except BaseException:
            self._lose(self._everywhere)  # some were stepped, others not
            raise
        rewards, terminations, truncations, nows, lasts = zip(*found, strict=True)
        terminated, truncated = np.concatenate(terminations), np.concatenate(truncations)
        done = terminated | truncated
        self._all_running = bool(self._running.all())
        info = joined(nows)
        if done.any():
            same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
            like = next(filter(None, lasts))
            outcome = joined([
                last or self._unended(like, now, rows)
                for last, now, rows in zip(lasts, nows, self.rows, strict=True)
            ])  # fmt: skip
            if same_step:
                info |= {"final_info": outcome, "_final_info": done}
                if final is not None:
                    info |= {"final_obs": final, "_final_obs": done.copy()}
            else:
                info |= outcome | {f"_{key}": done.copy() for key in outcome}
        return observation, np.concatenate(rewards), terminated, truncated, info

    def _step_slices(
        self, actions: NDArray[np.int64], observation: Observation, final: Observation | None
    ) -> list[Any]:
        def args(rows: slice) -> tuple[Any, ...]:
            of_final = None if final is None else cut(final, rows)
            return actions[rows], cut(observation, rows), of_final

        return self.each("_step_slice", args)

    def _unended(
        self, like: dict[str, NDArray[Any]], now: dict[str, NDArray[Any]], rows: slice
    ) -> dict[str, NDArray[Any]]:
        """What is told of a slice without an ended episode, in the place of what is `like` this."""
        own = {"return": self._returns[rows], "length": self._lengths[rows], **now}
        count = rows.stop - rows.start
        return {
            name: own[name] if name in own else np.zeros((count, *part.shape[1:]), part.dtype)
            for name, part in like.items()
        }

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        self.each("_begin_slice", lambda rows: (mask[rows], forced[:, rows]))

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        self.each("_observe", lambda rows: (cut(out, rows), mask[rows]))

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return joined(self.each("_situations"))

    def _describe(self) -> dict[str, NDArray[Any]]:
        return joined(self.each("_describe"))

    def _advance(self, actions: NDArray[np.int64], mask: NDArray[np.bool_]) -> Any:
        raise NotImplementedError("slices are stepped as a whole")

    def _share(self) -> None:
        raise ValueError(
            f"a level of a mixture cannot have {self._workers} of its own: give the mixture's "
            f"levels to zipf.envs.make_vec, with {self._workers}={len(self.rows)}"
        )

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        return joined(self.each("_get_env_states"), self._state_axis)

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        before = self.get_state()
        try:
            self._set_slices(state)
        except ValueError:
            self._set_slices(before)  # the slices before the one that refused its part
            raise

    def _set_slices(self, state: Mapping[str, NDArray[Any]]) -> None:
        def own(rows: slice) -> tuple[dict[str, NDArray[Any]]]:
            along = {key: (slice(None),) * self._state_axis.get(key, 0) for key in state}
            return (
                {
                    key: np.ascontiguousarray(array[(*along[key], rows)])
                    for key, array in state.items()
                },
            )

        self.each("_set_env_states", own)

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        state.pop("_pool", None)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share_rows()


def described(part: ZipfVectorEnv, workers: str, count: int) -> dict[str, Any]:
    """What a batch has of a slice. Raises ValueError: it cannot be one."""
    if not part.sliceable:
        raise ValueError(
            f"{workers}={count}: a {type(part).__name__} is stepped by one thread; leave it out"
        )
    return {name: getattr(part, name) for name in (*ALIKE, "level_of_envs")}


def share(arrays: Mapping[str, NDArray[Any]], part: ZipfVectorEnv, rows: slice) -> None:
    """Makes a slice work on these rows of a batch's arrays, given by their names in it."""
    for name in (*SHARED, "_seeded"):
        setattr(part, name, arrays[name][rows])
    part._share()


def cut(arrays: Observation, rows: slice) -> Observation:
    """Rows of arrays by name."""
    return {name: array[rows] for name, array in arrays.items()}


def joined(
    parts: Sequence[dict[str, NDArray[Any]]], axis: Mapping[str, int] | None = None
) -> dict[str, Any]:
    """Arrays by name, those of the slices one after another."""
    axis = axis or {}
    return {
        name: np.concatenate([part[name] for part in parts], axis.get(name, 0)) for name in parts[0]
    }


class SlicedPolicy(Remembering):
    """A scripted policy of a batch in slices: one for each, called where the slices are stepped.

    Args:
        env: the batch.
        make: makes the policy of a slice.
    """

    def __init__(
        self, env: Slices, make: Callable[[ZipfVectorEnv], Callable[[], NDArray[np.int64]]]
    ):
        self._env = env
        self._policies = env.bind(partial(_Bound, make))

    def __call__(self) -> NDArray[np.int64]:
        return np.concatenate(self._env.each("__call__", of=self._policies))

    def get_state(self) -> dict[str, NDArray[Any]]:
        return joined(self._env.each("get_state", of=self._policies))

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        self._env.each("set_state", lambda rows: (cut(dict(state), rows),), self._policies)


class _Bound(Remembering):
    """The policy of a slice, whether it remembers anything or not."""

    def __init__(self, make: Callable[[ZipfVectorEnv], Any], part: ZipfVectorEnv):
        self._policy = make(part)

    def __call__(self) -> NDArray[np.int64]:
        return self._policy()

    def get_state(self) -> dict[str, NDArray[Any]]:
        return self._policy.get_state() if isinstance(self._policy, Remembering) else {}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        if isinstance(self._policy, Remembering):
            self._policy.set_state(state)
