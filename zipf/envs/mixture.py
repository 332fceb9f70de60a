"""Several levels in one batch: shared among the envs, or drawn at every reset."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from zipf.compiled import compiled
from zipf.envs import pcg64
from zipf.envs.arguments import mapping, whole
from zipf.envs.distributions import zipfian
from zipf.envs.vector import SHARED, Observation, ZipfVectorEnv, rank_name


class Mixture(ZipfVectorEnv):
    """`N` envs of several levels.

    - `draw="worlds"`: the envs are shared evenly among the levels, in contiguous blocks, for
      good. Env `i` of `reset(seed=s)` is that of its level's own batch seeded `s + i`.
    - `draw="resets"`: at every reset an env draws its level, by one number of its random stream,
      and then the episode as the level does. The situation of an episode begins with the rank of
      its level (0 = most frequent), named `level` unless `rank` says otherwise.
      `info["level"]` is the rank, int64 [N], and `info["level_name"]` the level's name;
      `reset(options={"level": 3})` forces it. The levels' own ranks follow if all levels have the
      same ones, else they are left out. Observations do not tell the level.

    Of the levels' other entries of `info` those are kept that all levels have, and `success` if all
    levels report it. Everything else is as in `ZipfVectorEnv`.

        makers = {name: partial(make_vec, f"gridworld/{name}") for name in ("zipf_2", "uniform")}
        env = Mixture(makers, num_envs=64, draw="resets", exponent=1.0)

    Batched levels stay batched: envs of the same level are stepped together, and so are those of
    levels with the same engine (`ZipfVectorEnv._engine`), which differ only in how episodes begin.

    Args:
        levels: for the name of each level a function that makes a batch of it, called as
            `make(num_envs, autoreset_mode=..., render_mode=..., **options)`.
        num_envs: number of envs. With `draw="worlds"`, where they cannot be shared evenly, the
            first levels get one more.
        draw: "worlds" or "resets".
        exponent: with "resets", the exponent of Zipf's law by which levels are drawn.
        probabilities: with "resets" and in the place of an exponent, the probability of each rank,
            on any scale (divided by their sum here). May be 0.
        order: with "resets", which level has which rank: "forward" (as in `levels`), "reversed",
            or an integer >= 0 that seeds a shuffle.
        rank: with "resets", the name of the levels' rank; none that `ZipfVectorEnv` reserves.
        options: constructor options of all levels.
        levels_of_envs: with "worlds", the place in `levels` of each env's level, int64 [N], where
            the envs are not to be shared evenly.

    Attributes:
        level_names: the levels by rank; with "worlds", in the order of their envs.
        levels_of_envs: int64 [N], the place in `level_names` of each env's level.
        batches: the levels' batches, in the order of `level_names`. Each has N rows and keeps the
            envs that are on its level; those with the same engine share their arrays.
        engines: int64 [levels], for each level the place in `batches` of the first one with its
            engine, which has the state of all envs on it.

    Raises:
        ValueError: for no level, fewer envs than levels with "worlds", levels with different
            observations, actions or (with "worlds") situations or other numbers of envs than
            asked for, or a bad law or order.
    """

    def __init__(
        self,
        levels: Mapping[str, Callable[..., ZipfVectorEnv]],
        num_envs: int,
        *,
        draw: str = "worlds",
        exponent: float | None = None,
        probabilities: ArrayLike | None = None,
        order: str | int = "forward",
        rank: str = "level",
        levels_of_envs: NDArray[np.int64] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if draw not in ("worlds", "resets"):
            raise ValueError(f"draw must be 'worlds' or 'resets', got {draw!r}")
        if not mapping("levels", levels):
            raise ValueError("a mixture needs at least one level, got none")
        num_envs = whole("num_envs", num_envs, 1)
        self.draw = draw
        self.rank = rank_name("rank: the levels' rank", rank)
        count = len(levels)
        if draw == "resets":
            if (exponent is None) == (probabilities is None):
                raise ValueError("draw='resets' needs either exponent or probabilities")
            self.level_names = tuple(np.array(list(levels), object)[ordered(count, order)])
            self.levels_of_envs = np.zeros(num_envs, np.int64)
        else:
            if exponent is not None or probabilities is not None or order != "forward":
                raise ValueError("exponent, probabilities and order need draw='resets'")
            self.level_names = tuple(levels)
            if levels_of_envs is None:
                levels_of_envs = shared(self.level_names, num_envs)
            self.levels_of_envs = levels_of_envs
        self.batches: list[ZipfVectorEnv] = []
        keys: list[Any] = []  # equal for levels with one engine
        limits: list[int | None] = []
        for k, name in enumerate(self.level_names):
            batch = levels[name](
                num_envs, autoreset_mode=autoreset_mode, render_mode=render_mode, **options
            )
            # The envs of a smaller batch would be sought outside its arrays.
            if not isinstance(batch, ZipfVectorEnv):
                raise ValueError(
                    f"level {name!r} must be a ZipfVectorEnv of {num_envs} envs, got a "
                    f"{type(batch).__name__}"
                )
            if batch.num_envs != num_envs:
                raise ValueError(
                    f"level {name!r} must have the {num_envs} envs that it was asked for, got "
                    f"{batch.num_envs}"
                )
            key = batch._engine()
            keys.append((type(batch), k if key is None else key))
            limits.append(batch.time_limit)
            first_on_engine = keys.index(keys[-1])
            if first_on_engine < k:  # at once: only one batch at a time has arrays to throw away
                batch._use_engine(self.batches[first_on_engine])
            self.batches.append(batch)
        self.engines = np.array([keys.index(key) for key in keys])
        self._require_alike("single_observation_space", "single_action_space")
        first = self.batches[0]
        situation: dict[str, int] = {}
        if draw == "resets":
            situation = {rank: count}
        else:
            self._require_alike("situation")
        self._same_situation = all(b.situation == first.situation for b in self.batches)
        if self._same_situation:
            if situation.keys() & first.situation.keys():
                raise ValueError(f"the levels have a rank {rank!r} themselves: choose another name")
            situation |= first.situation
        self.metadata = first.metadata
        self.reports_success = all(batch.reports_success for batch in self.batches)
        self.longest_episode = max(batch.longest_episode for batch in self.batches)
        known_limits = [limit for limit in limits if limit is not None]
        self.time_limit = max(known_limits) if len(known_limits) == count else None
        self.achieves = all(batch.achieves for batch in self.batches)
        self.sliceable = all(batch.sliceable for batch in self.batches)
        regions = [batch.action_regions for batch in self.batches]
        known = [one for one in regions if one is not None]
        if len(known) == count and all(np.array_equal(known[0], one) for one in known):
            self.action_regions = known[0]
        super().__init__(
            num_envs,
            single_observation_space=first.single_observation_space,
            single_action_space=first.single_action_space,
            situation=situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        self._names = np.array(self.level_names)
        self.level_of_envs = (
            f"{rank}_name" if draw == "resets" else self._names[self.levels_of_envs]
        )
        self._state_axis = {
            f"{name}:{key}": axis
            for name, batch in zip(self.level_names, self.batches, strict=True)
            for key, axis in batch._state_axis.items()
        }
        if draw == "resets":
            self.probabilities = zipfian(count, exponent) if exponent is not None else probabilities
        # [levels, N]: envs by level, once they have begun; envs by engine, in the row of its
        # first level; envs that begin now, by level.
        self._begun = np.zeros((count, num_envs), np.bool_)
        self._on_engine = np.zeros((count, num_envs), np.bool_)
        self._beginning = np.zeros((count, num_envs), np.bool_)
        self._share()
        self._locate(self._seeded)
        self._resizable = frozenset(
            f"{self.level_names[k]}:{key}"
            for k in set(self.engines.tolist())
            for key in self.batches[k]._resizable
        )
        described = [batch._describe() for batch in self.batches]
        self._described = [key for key in described[0] if all(key in one for one in described)]
        if draw == "resets" and not {rank, f"{rank}_name"}.isdisjoint(self._described):
            raise ValueError(
                f"the levels have an entry {rank!r} or '{rank}_name' in info themselves: choose "
                "another name"
            )

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """With `draw="resets"`, the probability of each rank, float64 [levels], summing to 1.

        Others may be assigned at any time, for the episodes that begin from then on; the array
        itself is read-only. They are no part of `get_state()`. To score one level after another,
        give it probability 1 and reset.
        """
        shown = self._probabilities.view()
        shown.flags.writeable = False
        return shown

    @probabilities.setter
    def probabilities(self, values: Any) -> None:
        if self.draw != "resets":
            raise ValueError("levels have probabilities with draw='resets' only")
        count = len(self.level_names)
        try:
            given = np.asarray(values, np.float64)
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != (count,) or not np.isfinite(given).all() or (given < 0).any():
            raise ValueError(f"probabilities must be {count} finite numbers >= 0, got {values}")
        if not given.any():
            raise ValueError(f"probabilities must not all be 0, got {values}")
        with np.errstate(over="ignore"):
            if not np.isfinite(given.sum()):
                given = given / given.max()
        self._probabilities = given / given.sum()
        self._cumulative = pcg64.cumulative(self._probabilities)

    def render(self) -> tuple[Any, ...] | None:
        """The envs' frames, as their levels draw them; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        frames: list[Any] = [None] * self.num_envs
        for batch, mask in self._parts(self._everywhere):
            drawn = batch.render() or ()
            for i in np.flatnonzero(mask).tolist():
                frames[i] = drawn[i]
        return tuple(frames)

    def pictures(self, width: int, height: int) -> tuple[Any, ...]:
        """The envs' pictures, as their levels draw them."""
        frames: list[Any] = [None] * self.num_envs
        for batch, mask in self._parts(self._everywhere):
            drawn = batch.pictures(width, height)
            for i in np.flatnonzero(mask).tolist():
                frames[i] = drawn[i]
        return tuple(frames)

    def close_extras(self, **kwargs: Any) -> None:
        for batch in self.batches:
            batch.close(**kwargs)

    def __getstate__(self) -> dict[str, Any]:
        # A family may replay its episodes when it is unpickled: the batches are pickled without
        # any, and the episodes restored when the batches share their arrays again.
        return {
            **super().__getstate__(),
            "batches": [_without_episodes(batch) for batch in self.batches],
            "_saved": self.get_state(),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved = state.pop("_saved")
        self.__dict__.update(state)
        self._share()
        self.set_state(saved)

    def _require_alike(self, *attributes: str) -> None:
        first = self.batches[0]
        for name, batch in zip(self.level_names, self.batches, strict=True):
            for attribute in attributes:
                given, expected = getattr(batch, attribute), getattr(first, attribute)
                if given != expected:
                    raise ValueError(
                        f"the levels of a mixture must have the same {attribute}, but "
                        f"{_difference(expected, self.level_names[0], given, name)}"
                    )

    def _share(self) -> None:
        """Makes the levels' batches work on this batch's random streams, lengths and so on.

        A batch's `_seeded` says which envs have an episode of its level: what it replays after
        `set_state`.
        """
        for k, batch in enumerate(self.batches):
            if self.engines[k] != k:
                batch._use_engine(self.batches[self.engines[k]])
            for name in SHARED:
                setattr(batch, name, getattr(self, name))
            batch._seeded = self._begun[k]
            batch._use_processes(self.batches[0])
            batch._share()

    def _locate(self, seeded: NDArray[np.bool_]) -> None:
        """Sets the masks by level and by engine, for levels that were not drawn by `_begin`."""
        places = np.arange(len(self.batches))[:, None]
        self._begun[:] = (self.levels_of_envs == places) & seeded
        self._on_engine[:] = self.engines[self.levels_of_envs] == places
        self._engines_now = np.flatnonzero(self._on_engine.any(1)).tolist()

    def _parts(self, mask: NDArray[np.bool_]) -> Iterator[tuple[ZipfVectorEnv, NDArray[np.bool_]]]:
        """The batches that step and draw the envs of `mask`, with a mask of these envs each."""
        if len(self._engines_now) == 1:
            yield self.batches[self._engines_now[0]], mask
            return
        for k in self._engines_now:
            part = self._on_engine[k]
            if mask is not self._everywhere:
                part = part & mask
                if not part.any():
                    continue
            yield self.batches[k], part

    def name_of(self, i: int) -> str:
        level = self.level_names[self.levels_of_envs[i]]
        name = self.batches[self.levels_of_envs[i]].name_of(i)
        return name if level in name else f"{name}, level {level}"

    def _leave(self, envs: list[int]) -> None:
        for batch in self.batches:
            batch._leave(envs)

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        draw = self.draw == "resets"
        before = self.levels_of_envs.copy()
        cumulative = self._cumulative if draw else np.ones(1)
        begin, in_use = _begin_levels(
            mask,
            draw,
            forced[0] if draw else self.levels_of_envs,
            cumulative,
            self._streams,
            self.engines,
            self.levels_of_envs,
            self._begun,
            self._on_engine,
            self._beginning,
        )
        self._engines_now = np.flatnonzero(in_use).tolist()
        moved = np.flatnonzero(before != self.levels_of_envs)
        for k in set(before[moved].tolist()):
            self.batches[k]._leave(moved[before[moved] == k].tolist())
        own = forced[1:] if draw else forced
        for k in np.flatnonzero(begin).tolist():
            batch = self.batches[k]
            batch._begin(self._beginning[k], own if self._same_situation else batch._unforced)

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        parts = list(self._parts(mask))
        if len(parts) == 1:
            return parts[0][0]._advance(actions, mask)
        reward = np.zeros(self.num_envs)
        terminated, truncated, success = np.zeros((3, self.num_envs), np.bool_)
        for batch, part in parts:
            results = batch._advance(actions, part)
            for total, own in zip((reward, terminated, truncated, success), results, strict=True):
                np.copyto(total, own, where=part)
        return reward, terminated, truncated, success

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        for batch, part in self._parts(mask):
            batch._observe(out, part)

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        own = list(self.batches[0].situation) if self._same_situation else []
        joined = self._joined(lambda batch: batch._situations(), own)
        if self.draw == "worlds":
            return joined
        return {self.rank: self.levels_of_envs.copy(), **joined}

    def _describe(self) -> dict[str, NDArray[Any]]:
        joined = self._joined(lambda batch: batch._describe(), self._described)
        if self.draw == "worlds":
            return joined
        return {f"{self.rank}_name": self._names[self.levels_of_envs], **joined}

    def _joined(
        self, entries: Callable[[ZipfVectorEnv], dict[str, NDArray[Any]]], names: list[str]
    ) -> dict[str, NDArray[Any]]:
        """These entries of the batches, each env's from its level's batch."""
        if not names:
            return {}
        parts = [(entries(batch), mask) for batch, mask in self._parts(self._everywhere)]
        if len(parts) == 1:
            return {name: parts[0][0][name] for name in names}
        joined = {}
        for name in names:
            joined[name] = np.empty(
                self.num_envs, np.result_type(*(own[name].dtype for own, _ in parts))
            )
            for own, mask in parts:
                np.copyto(joined[name], own[name], where=mask)
        return joined

    def _achieved(self, ended: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        parts = [(batch._achieved(part), part) for batch, part in self._parts(ended)]
        if len(parts) == 1:
            return parts[0][0]
        goals, has = (np.zeros_like(array) for array in parts[0][0])
        for (own, own_has), part in parts:
            np.copyto(goals, own, where=part[:, None])
            np.copyto(has, own_has, where=part)
        return goals, has

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        state = {"levels": self.levels_of_envs} if self.draw == "resets" else {}
        for k in sorted(set(self.engines.tolist())):
            envs = self.batches[k]._get_env_states()
            state |= {f"{self.level_names[k]}:{key}": value for key, value in envs.items()}
        return state

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        levels = state.get("levels", self.levels_of_envs)
        if (levels < 0).any() or (levels >= len(self.batches)).any():
            raise ValueError("the state is of other levels, or damaged: levels out of range")
        before = self.get_state()
        try:
            self._set_batches(state)
        except ValueError:
            self._set_batches(before)  # the levels before the one that refused its part
            raise

    def _set_batches(self, state: Mapping[str, NDArray[Any]]) -> None:
        if self.draw == "resets":
            self.levels_of_envs[:] = state["levels"]
        self._locate(state["seeded"])
        for k, batch in enumerate(self.batches):
            batch._leave(np.flatnonzero(self.levels_of_envs != k).tolist())
        for k, batch in enumerate(self.batches):
            # To a level's batch, envs that are on other levels have not begun yet.
            here = self.levels_of_envs == k
            common = {key: state[key] * here for key in ("seeded", "running", "lengths", "returns")}
            name = self.level_names[self.engines[k]]
            own = {key: state[f"{name}:{key}"] for key in batch._get_env_states()}
            batch._set_env_states({"streams": state["streams"], **common, **own})


@compiled()
def _begin_levels(
    mask, draw, forced, cumulative, streams, engine_of, levels, begun, on_engine, beginning
):
    """Gives the envs of `mask` their levels, drawn if `draw`, and keeps the masks up to date.

    Forced levels (>= 0) replace what was drawn. Returns which levels begin an episode and which
    engines have envs, bool [levels] both.
    """
    beginning[:] = False
    begin = np.zeros(len(engine_of), np.bool_)
    in_use = np.zeros(len(engine_of), np.bool_)
    for i in range(mask.size):
        if mask[i]:
            old = new = levels[i]
            if draw:
                new = pcg64.choice(streams[i], cumulative)
                if forced[i] >= 0:
                    new = forced[i]
            levels[i] = new
            begun[old, i] = False
            begun[new, i] = True
            on_engine[engine_of[old], i] = False
            on_engine[engine_of[new], i] = True
            beginning[new, i] = True
            begin[new] = True
        in_use[engine_of[levels[i]]] = True
    return begin, in_use


def shared(names: Sequence[str], num_envs: int) -> NDArray[np.int64]:
    """The place of each env's level, int64 [N], where envs are shared evenly among these levels.
    Raises ValueError: there are fewer envs than levels."""
    count = len(names)
    if num_envs < count:
        raise ValueError(
            f"num_envs must be at least {count}, an env for each of the levels "
            f"{', '.join(names)}; got {num_envs}"
        )
    return np.sort(np.arange(num_envs) % count)


def _without_episodes(batch: ZipfVectorEnv) -> ZipfVectorEnv:
    """A shallow copy of a batch for pickling, of which no env has begun."""
    twin: ZipfVectorEnv = object.__new__(type(batch))
    none = np.zeros_like(batch._seeded)
    twin.__dict__.update(batch.__dict__, _seeded=none, _running=none)
    return twin


def ordered(count: int, order: str | int) -> NDArray[np.int64]:
    """The place in the list of levels of each rank, int64 [count].

    Raises ValueError for an `order` other than "forward", "reversed" or an integer >= 0.
    """
    if order == "forward":
        return np.arange(count)
    if order == "reversed":
        return np.arange(count)[::-1]
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 0:
        raise ValueError(
            "order must be 'forward', 'reversed' or an integer >= 0 that seeds a shuffle, "
            f"got {order!r}"
        )
    return np.argsort(np.random.default_rng(order).random(count), kind="stable")


def _difference(expected: Any, first: str, given: Any, name: str) -> str:
    """In which part two levels differ."""
    if isinstance(expected, spaces.Dict) and isinstance(given, spaces.Dict):
        for key in {**expected.spaces, **given.spaces}:
            one, other = expected.spaces.get(key), given.spaces.get(key)
            if one != other:
                return f"{key!r} is {_brief(one)} in {first} and {_brief(other)} in {name}"
    return f"it is {expected} in {first} and {given} in {name}"


def _brief(space: spaces.Space | None) -> str:
    """A space in a few words; that of many codes prints each of them."""
    if space is None:
        return "absent"
    text = " ".join(str(space).split())
    return text if len(text) <= 100 else f"{text[:100]}... of shape {space.shape}"
