"""A batch stepped by several threads."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cached_property
from typing import Any, Self, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import whole
from zipf.envs.remembering import Remembering
from zipf.envs.vector import SHARED, Observation, ZipfVectorEnv

Result = TypeVar("Result")


class Slices(ZipfVectorEnv):
    """`N` envs in consecutive slices, each a batch of its own that a thread of its own steps.

    The slices work on rows of this batch's arrays. An env draws from its own stream alone, so the
    number of threads changes the speed and no bit of what is observed. Threads step, lay out and
    draw at the same time as far as the compiled code takes; what is plain Python takes turns.

    Attributes:
        parts, rows: the slices, and the rows of this batch that each of them is.

    Args:
        make: `make(num_envs, autoreset_mode=..., render_mode=..., **options)` makes a batch, of a
            class with `sliceable`.
        num_envs: number of envs N.
        threads: how many, at most N.
        autoreset_mode, copy, render_mode: see `ZipfVectorEnv`.
        options: of `make`.

    Raises:
        ValueError: the envs cannot be sliced, or there are fewer than threads.
    """

    def __init__(
        self,
        make: Callable[..., ZipfVectorEnv],
        num_envs: int,
        threads: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        num_envs, threads = whole("num_envs", num_envs, 1), whole("threads", threads, 1)
        if threads > num_envs:
            raise ValueError(f"threads={threads}: should be at most num_envs={num_envs}")
        ends = [num_envs * (k + 1) // threads for k in range(threads)]
        self.rows = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        self.parts = [
            make(
                rows.stop - rows.start,
                autoreset_mode=autoreset_mode,
                render_mode=render_mode,
                **options,
            )
            for rows in self.rows
        ]
        first = self.parts[0]
        if not first.sliceable:
            raise ValueError(
                f"threads={threads}: a {type(first).__name__} is stepped by one thread; "
                "choose threads=1"
            )
        self.metadata = first.metadata
        self.reports_success = first.reports_success
        self.achieves = first.achieves
        self.action_regions = first.action_regions
        super().__init__(
            num_envs,
            single_observation_space=first.single_observation_space,
            single_action_space=first.single_action_space,
            situation=first.situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._state_axis = first._state_axis
        self._share()

    def render(self) -> tuple[Any, ...] | None:
        """The envs' frames; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return tuple(frame for part in self.parts for frame in part.render() or ())

    def close_extras(self, **kwargs: Any) -> None:
        self._pool.shutdown()
        for part in self.parts:
            part.close(**kwargs)

    def _share(self) -> None:
        for rows, part in zip(self.rows, self.parts, strict=True):
            for name in (*SHARED, "_seeded"):
                setattr(part, name, getattr(self, name)[rows])

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(len(self.parts) - 1 or 1, "zipf-envs")

    def each(self, do: Callable[[ZipfVectorEnv, slice], Result]) -> list[Result]:
        """Calls `do` for every slice, each in its thread; what one raises is raised here."""
        first, *others = zip(self.parts, self.rows, strict=True)
        waiting = [self._pool.submit(do, *one) for one in others]
        try:
            found = do(*first)
        finally:
            wait(waiting)
        return [found, *(one.result() for one in waiting)]

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        def begin(part: ZipfVectorEnv, rows: slice) -> None:
            if mask[rows].any():
                part._begin(mask[rows], np.ascontiguousarray(forced[:, rows]))

        self.each(begin)

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        found = self.each(lambda part, rows: part._advance(actions[rows], mask[rows]))
        reward, terminated, truncated, success = map(np.concatenate, zip(*found, strict=True))
        return reward, terminated, truncated, success

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        def observe(part: ZipfVectorEnv, rows: slice) -> None:
            part._observe({name: array[rows] for name, array in out.items()}, mask[rows])

        self.each(observe)

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return self._joined([part._situations() for part in self.parts])

    def _describe(self) -> dict[str, NDArray[Any]]:
        return self._joined([part._describe() for part in self.parts])

    def _joined(self, parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _achieved(self, ended: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        found = [
            part._achieved(ended[rows]) for rows, part in zip(self.rows, self.parts, strict=True)
        ]
        goals, has = map(np.concatenate, zip(*found, strict=True))
        return goals, has

    def _engine(self) -> Hashable:
        engine = self.parts[0]._engine()
        return None if engine is None else (len(self.parts), type(self.parts[0]), engine)

    def _use_engine(self, other: Self) -> None:
        for mine, theirs in zip(self.parts, other.parts, strict=True):
            mine._use_engine(theirs)

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        states = [part._get_env_states() for part in self.parts]
        return {
            key: np.concatenate([state[key] for state in states], self._state_axis.get(key, 0))
            for key in states[0]
        }

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        before = self.get_state()
        try:
            self._set_parts(state)
        except ValueError:
            self._set_parts(before)  # the slices before the one that refused its part
            raise

    def _set_parts(self, state: Mapping[str, NDArray[Any]]) -> None:
        for rows, part in zip(self.rows, self.parts, strict=True):
            own = {}
            for key, array in state.items():
                along = (slice(None),) * self._state_axis.get(key, 0)
                own[key] = np.ascontiguousarray(array[(*along, rows)])
            part._set_env_states(own)

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        state.pop("_pool", None)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share()


class SlicedPolicy(Remembering):
    """A scripted policy of a batch in slices: one for each, called in the slices' threads.

    Args:
        env: the batch.
        make: makes the policy of a slice.
    """

    def __init__(
        self, env: Slices, make: Callable[[ZipfVectorEnv], Callable[[], NDArray[np.int64]]]
    ):
        self._env = env
        self._policies: dict[int, Any] = {id(part): make(part) for part in env.parts}

    def __call__(self) -> NDArray[np.int64]:
        return np.concatenate(self._env.each(lambda part, rows: self._policies[id(part)]()))

    def get_state(self) -> dict[str, NDArray[Any]]:
        states = [one.get_state() for one in self._remembering()]
        names = states[0] if states else ()
        return {name: np.concatenate([state[name] for state in states]) for name in names}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        for one, rows in zip(self._remembering(), self._env.rows, strict=False):
            one.set_state({name: array[rows] for name, array in state.items()})

    def _remembering(self) -> list[Remembering]:
        return [one for one in self._policies.values() if isinstance(one, Remembering)]
