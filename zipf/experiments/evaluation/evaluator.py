"""The evaluator: plays any policy on the levels of a split and scores it.

Episodes are counted as they *start*: the first n to start are played to their end and scored,
whatever their length. Counting the first n to *end* would over-count short ones, and an agent that
fails fast would get a different score than the same agent with slow failures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zipf import envs
from zipf.envs.arguments import whole
from zipf.envs.episodes import play_episodes
from zipf.envs.mixture import Mixture
from zipf.envs.vector import Observation, ZipfVectorEnv
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.scripted import ScriptedPolicy

OUTCOMES = ("success", "return", "length")
"""The columns of an episode that are not ranks of its situation."""


Watch = Callable[[int, int], object]
"""Called after every step of an evaluation with how many episodes have ended, of how many; what it
raises ends the evaluation."""


def unwatched(ended: int, episodes: int) -> None:
    """A `Watch` that does nothing."""


class Policy(Protocol):
    """Plays a batch of envs; may have a memory. What it is given is its own, to be kept."""

    def start(self, num_envs: int) -> None:
        """Clears the memory: `num_envs` new envs begin."""

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        """Actions int [N] for observations `{name: [N, ...]}`.

        `reward` float32 [N] is the reward of the last action. `is_first` bool [N] is True where an
        episode begins: there the memory is to be cleared and the reward belongs to the episode
        before.
        """


@dataclass(frozen=True)
class Result:
    """The episodes of one level, in the order in which they started.

    Attributes:
        kind: of `zipf.envs.KINDS`.
        split_level: the level as the split has it, with weight and normalisation.
        episodes: a row each: the situation's ranks, `success` (not in envs that report none),
            `return` and `length`.
    """

    kind: str
    split_level: envs.SplitLevel
    episodes: pd.DataFrame

    @property
    def level(self) -> str:
        """The level's name."""
        return self.split_level.name

    @property
    def score(self) -> float:
        """The mean return, normalised where the split says so."""
        return self.split_level.score(self.episodes["return"].to_numpy())

    def row(self) -> dict[str, Any]:
        """The row of `evaluations.csv`, without when it was taken; `success` may be None."""
        episodes = self.episodes
        return {
            "level_kind": self.kind,
            "level": self.level,
            "episodes": len(episodes),
            "score": self.score,
            "success": episodes["success"].mean() if "success" in episodes else None,
            "return": episodes["return"].mean(),
            "length": episodes["length"].mean(),
        }


def play(
    policy: Policy,
    env: ZipfVectorEnv,
    *,
    episodes: int,
    seed: int,
    watch: Callable[[int], object] = lambda ended: None,
) -> pd.DataFrame:
    """Plays the first `episodes` episodes to start; one row each, in that order.

    Args:
        watch: called after every step with the number of episodes that have ended.

    Raises:
        ValueError: the policy returns something else than an action for each env.
    """
    policy.start(env.num_envs)

    def act(observation: Observation, reward: NDArray, is_first: NDArray) -> NDArray:
        own = {name: part.copy() for name, part in observation.items()}  # the envs' are overwritten
        return _checked(policy(own, reward, is_first), env)

    return pd.DataFrame(play_episodes(env, act, episodes, seed=seed, watch=watch))


def _checked(actions: Any, env: ZipfVectorEnv) -> NDArray:
    count = int(env.single_action_space.n)
    try:
        array = np.asarray(actions)
    except (ValueError, TypeError, RuntimeError):  # a pair of actions and a state, for instance
        got = f"a {type(actions).__name__} that is no array"
    else:
        if array.shape != (env.num_envs,) or array.dtype.kind not in "iu":
            got = f"{array.dtype} of shape {array.shape}"
        elif array.min() >= 0 and array.max() < count:
            return array
        else:
            got = f"values from {array.min()} to {array.max()}"
    raise ValueError(
        f"the policy returned {got} as actions; should be integers in 0 .. {count - 1} of shape "
        f"({env.num_envs},), one for each env (batched=False is for policies of one observation)"
    )


def evaluate(
    policy: Policy,
    split: envs.Split,
    *,
    episodes: int | None = None,
    num_envs: int = 250,
    seed: int = 0,
    watch: Watch = unwatched,
    **level_options: Any,
) -> list[Result]:
    """Plays a policy on every level of a split, of all kinds that it has.

    Envs are seeded from `seed` and the level's kind and place in the split; no other random
    generator is touched. Where the split draws a level at every reset, levels are played one at a
    time all the same, and situations begin with the level's rank, as in training. A level that
    stands in several kinds is played once, and its episodes count in each of them.

    Args:
        episodes: on each level; None: as many as the split says.
        num_envs: envs played at a time.
        watch: told how far the evaluation is.
        level_options: constructor options of the levels.

    Raises:
        ValueError: no episodes, no envs, options that a level cannot have, actions that are none,
            or a scripted policy that a level does not have.
    """
    if episodes is not None:
        episodes = whole("episodes", episodes, 1)
    num_envs = whole("num_envs", num_envs, 1)
    results = []
    counts = {kind: episodes or split.episodes_of(kind) for kind in split.kinds}
    played: dict[tuple[str, str, int], pd.DataFrame] = {}
    to_play = {_key(one, counts[kind]) for kind in split.kinds for one in split.levels(kind)}
    total = sum(count for *_, count in to_play)
    with _SharedEnv(split, level_options) as shared:
        for kind in split.kinds:
            count = counts[kind]
            for place, level in enumerate(split.levels(kind)):
                key = _key(level, count)
                if key not in played:
                    before = sum(map(len, played.values()))
                    env = shared.of(level, min(num_envs, count))
                    if isinstance(policy, ScriptedPolicy):
                        policy.enter(level.level, env)
                    played[key] = play(
                        policy,
                        env,
                        episodes=count,
                        seed=_level_seed(seed, kind, place),
                        watch=_of_all(watch, before, total),
                    )
                results.append(Result(kind, level, played[key]))
    return results


def _level_seed(seed: int, kind: str, place: int) -> int:
    """The seed of the envs of a level. That of `PAPER_KINDS` does not depend on which other kinds
    there are."""
    kinds = envs.PAPER_KINDS
    if kind in kinds:
        return derive_seed(seed, "evaluation", kinds.index(kind) + place * len(kinds))
    return derive_seed(seed, f"evaluation {kind}", place)


def _of_all(watch: Watch, before: int, total: int) -> Callable[[int], object]:
    """Counts the episodes of one level after those before it."""
    return lambda ended: watch(before + ended, total)


def _key(level: envs.SplitLevel, episodes: int) -> tuple[str, str, int]:
    """Equal for levels whose episodes can be shared."""
    return level.name, repr(dict(level.options)), episodes


class _SharedEnv:
    """Envs of one level of a split after another. Where the split draws levels at resets, and a
    level has the same options in all kinds, the same envs serve them all."""

    def __init__(self, split: envs.Split, level_options: dict[str, Any]):
        self._split = split
        self._options = level_options
        self._env: ZipfVectorEnv | None = None
        options: dict[str, str] = {}
        self._one_for_all = split.draw == "resets" and all(
            options.setdefault(level.name, repr(dict(level.options))) == repr(dict(level.options))
            for level in split.all_levels
        )

    def __enter__(self) -> _SharedEnv:
        return self

    def __exit__(self, *_: object) -> None:
        if self._env is not None:
            self._env.close()

    def of(self, level: envs.SplitLevel, num_envs: int) -> ZipfVectorEnv:
        """Envs of a level, to be reset; those of the level before are gone."""
        env = self._env
        if self._one_for_all and isinstance(env, Mixture) and env.num_envs == num_envs:
            env.probabilities = [float(name == level.name) for name in env.level_names]
            return env
        if env is not None:
            env.close()
        self._env = envs.make_scored(self._split, level, num_envs, **self._options)
        return self._env


def scores(results: Sequence[Result]) -> dict[str, float]:
    """The score on each kind of level: the mean over its levels, by their weights."""
    by_kind: dict[str, list[Result]] = {}
    for result in results:
        by_kind.setdefault(result.kind, []).append(result)
    return {
        kind: float(
            np.average([r.score for r in of_kind], weights=[r.split_level.weight for r in of_kind])
        )
        for kind, of_kind in by_kind.items()
    }


def situations(results: Sequence[Result]) -> pd.DataFrame:
    """The rows of `situations.csv`: every situation met, levels of a kind taken together.

    Returns:
        `level_kind`, the ranks that all these levels have, `episodes`, `successes` (None where a
        level that the situation was met on reports none) and `return_sum`; in the order of kinds
        and ranks.
    """
    kinds = list(dict.fromkeys(result.kind for result in results))
    episodes = pd.concat(
        [
            result.episodes.assign(
                level_kind=pd.Categorical([result.kind] * len(result.episodes), kinds),
                successes=result.episodes.get("success", np.nan),
            )
            for result in results
        ]
    )
    episodes["_unknown"] = episodes["successes"].isna()
    episodes["successes"] = episodes["successes"].fillna(0).astype(int)
    ranks = [
        name
        for name in results[0].episodes
        if name not in OUTCOMES and all(name in result.episodes for result in results)
    ]
    table = episodes.groupby(["level_kind", *ranks], as_index=False, observed=True).agg(
        episodes=("return", "size"),
        successes=("successes", "sum"),
        return_sum=("return", "sum"),
        _unknown=("_unknown", "any"),
    )
    if table["_unknown"].any():
        table["successes"] = table["successes"].astype(object).where(~table["_unknown"], None)
    return table.astype({"level_kind": str}).drop(columns="_unknown")
