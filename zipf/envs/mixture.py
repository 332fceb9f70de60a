"""Several levels in one batch, to train on all of them at once."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.vector import Observation, ZipfVectorEnv

_COMMON = ("streams", "seeded", "running", "lengths", "returns")
"""What every batch keeps for each of its worlds; a state's keys, underscored its attributes."""


class MixtureVectorEnv(ZipfVectorEnv):
    """`N` worlds shared evenly, in contiguous blocks, among several levels.

    World `i` of `reset(seed=s)` is that of its level's own batch seeded `s + i`; see
    `ZipfVectorEnv` for everything else. The keys of a state begin with the level's name.

    Args:
        levels: for the name of each level what makes a batch of it, called as
            `make(num_envs, autoreset_mode=..., render_mode=..., **options)`.
        num_envs: number of worlds; where they cannot be shared evenly, the first levels get one
            more.
        options: constructor options that all levels are made with.

    Attributes:
        level_names: the levels, in the order of their worlds.
        levels_of_worlds: int64 [N], each world's place in `level_names`.

    Raises:
        ValueError: no level, fewer worlds than levels, or levels that differ in what is shown, in
            the actions or in the situation.
    """

    def __init__(
        self,
        levels: Mapping[str, Callable[..., ZipfVectorEnv]],
        num_envs: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.level_names = tuple(levels)
        if not levels:
            raise ValueError("a mixture has at least one level, got none")
        if num_envs < len(levels):
            raise ValueError(
                f"num_envs must be at least {len(levels)}, a world for each of the levels "
                f"{', '.join(levels)}; got {num_envs}"
            )
        self.levels_of_worlds = np.sort(np.arange(num_envs) % len(levels))
        ends = np.cumsum(np.bincount(self.levels_of_worlds)).tolist()
        self._blocks = [slice(*ends) for ends in zip([0, *ends[:-1]], ends, strict=True)]
        self.batches = [
            make(
                block.stop - block.start,
                autoreset_mode=autoreset_mode,
                render_mode=render_mode,
                **options,
            )
            for make, block in zip(levels.values(), self._blocks, strict=True)
        ]
        first = self.batches[0]
        for name, batch in zip(self.level_names, self.batches, strict=True):
            for what in ("single_observation_space", "single_action_space", "situation"):
                given, expected = getattr(batch, what), getattr(first, what)
                if given != expected:
                    raise ValueError(
                        f"the levels of a mixture must be alike, but {what} is {expected} of "
                        f"{self.level_names[0]} and {given} of {name}"
                    )
        self.metadata = first.metadata
        super().__init__(
            num_envs,
            single_observation_space=first.single_observation_space,
            single_action_space=first.single_action_space,
            situation=first.situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._share()

    def _share(self) -> None:
        """Lets the levels' batches work on this one's random streams, lengths and so on."""
        for batch, block in zip(self.batches, self._blocks, strict=True):
            for name in _COMMON:
                setattr(batch, f"_{name}", getattr(self, f"_{name}")[block])

    def render(self) -> tuple[Any, ...] | None:
        """The worlds' frames, as their levels draw them; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return tuple(frame for batch in self.batches for frame in batch.render() or ())

    def close_extras(self, **kwargs: Any) -> None:
        for batch in self.batches:
            batch.close(**kwargs)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share()

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        for batch, block in zip(self.batches, self._blocks, strict=True):
            batch._begin(mask[block], np.ascontiguousarray(forced[:, block]))

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        steps = [
            batch._advance(actions[block], mask[block])
            for batch, block in zip(self.batches, self._blocks, strict=True)
        ]
        reward, terminated, truncated, success = map(np.concatenate, zip(*steps, strict=True))
        return reward, terminated, truncated, success

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        for batch, block in zip(self.batches, self._blocks, strict=True):
            batch._observe({key: rows[block] for key, rows in out.items()}, mask[block])

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return _joined([batch._situations() for batch in self.batches])

    def _describe(self) -> dict[str, NDArray[Any]]:
        return _joined([batch._describe() for batch in self.batches])

    def _get_worlds(self) -> dict[str, NDArray[Any]]:
        return {
            f"{name}:{key}": value
            for name, batch in zip(self.level_names, self.batches, strict=True)
            for key, value in batch._get_worlds().items()
        }

    def _set_worlds(self, state: Mapping[str, NDArray[Any]]) -> None:
        before = self.get_state()
        try:
            self._set_batches(state)
        except ValueError:
            self._set_batches(before)  # a level that refuses its part comes after some that took it
            raise

    def _set_batches(self, state: Mapping[str, NDArray[Any]]) -> None:
        for name, batch, block in zip(self.level_names, self.batches, self._blocks, strict=True):
            common = {key: state[key][block] for key in _COMMON}
            own = {key: state[f"{name}:{key}"] for key in batch._get_worlds()}
            batch._set_worlds({**common, **own})


def _joined(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
