"""Scores of any policy, with everything that they were computed from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any, Literal, overload

import numpy as np
import pandas as pd
from gymnasium import spaces
from numpy.typing import NDArray

from zipf import envs
from zipf.envs.arguments import whole
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.evaluator import (
    OUTCOMES,
    Result,
    evaluate,
    scores,
    situations,
)
from zipf.experiments.evaluation.policies import (
    as_policy,
    check_env_options,
    own_torch_draws,
    plain_option,
)
from zipf.experiments.reporting.statistics import RESAMPLES, bootstrap, wilson_interval

FEWEST_MET = 5  # times, on average, that a situation is met where situations are drawn

HOW_STEPPED = {"autoreset_mode", "copy", "render_mode"}
"""Constructor options that say how environments are stepped and drawn, and not what is played."""


@dataclass(frozen=True, repr=False)
class Evaluation:
    """What `zipf.score(..., details=True)` returns. A notebook shows the scores with their
    intervals.

    Intervals are 95 % confidence intervals. They cover the chance of the episodes that were played,
    not the differences between agents trained from other seeds. Of a level whose returns are all 0
    or 1, and of `success`, they are Wilson's (1927); of other returns the percentiles of a
    bootstrap of 2000 resamples (Efron 1979), NaN for a single episode; scores have the intervals of
    their mean returns, normalised. Where returns differ, scores on rare, validation and fresh
    levels also cover which situations these are: of a bootstrap that draws situations, and then
    episodes of each. Where most situations were met fewer than five times, it draws values of the
    first rank. Of the mean over several levels they are combined by MOVER (Zou, Huang and Zhang
    2009, Computational Statistics & Data Analysis 53(11)).

    Attributes:
        split: the split's name.
        env_options: for each level's name the constructor options of the environments that were
            played, defaults included. Those of your own levels are the ones that were given.
        episodes: a row per episode, in the order in which they started on their level:
            `level_kind` (of `zipf.envs.KINDS`), `level_name`, the situation's ranks
            (0 = most frequent), `success` (where the envs report it), `return` and `length` (in
            frames).
        situations: a row per situation met on a kind of levels: `level_kind`, its ranks,
            `episodes`, `successes` (None where the envs report none) and `return_sum`.
        levels: a row per level: `level_kind`, `level_name`, `weight`, `episodes`, `score` with its
            interval `score_low` to `score_high`, `success` with `success_low` and `success_high`
            (NaN where the envs report none), and the means `return` and `length`.
        kinds: a row per kind of levels: `level_kind`, `score` (the mean over its levels, by their
            weights), `score_low`, `score_high`, `plain` (the mean over its levels, all weighing the
            same), `plain_low` and `plain_high`.
    """

    split: str
    env_options: Mapping[str, Mapping[str, Any]]
    episodes: pd.DataFrame
    situations: pd.DataFrame
    levels: pd.DataFrame
    kinds: pd.DataFrame
    results: Sequence[Result]

    @property
    def scores(self) -> dict[str, float]:
        """The score of each kind of levels, as `score` returns without `details`."""
        return scores(self.results)

    def __repr__(self) -> str:
        shown = ", ".join(f"{kind} {score:.3f}" for kind, score in self.scores.items())
        return f"Evaluation({self.split}: {shown})"

    def to_dataframe(self) -> pd.DataFrame:
        """A copy of `levels`."""
        return self.levels.copy()

    def _repr_html_(self) -> str:
        shown = [
            (row.level_kind, f"{row.score:.3f}", f"{row.score_low:.3f} to {row.score_high:.3f}")
            for row in self.kinds.itertuples()
        ]
        table = pd.DataFrame(shown, columns=["Levels", "Score", "95 % interval"])
        return f"<b>{escape(self.split)}</b>{table.to_html(index=False, border=0)}"


@overload
def score(
    policy: Any,
    split: str | envs.Split = ...,
    *,
    episodes: int | None = ...,
    num_envs: int = ...,
    seed: int = ...,
    batched: bool = ...,
    details: Literal[False] = ...,
    **level_options: Any,
) -> dict[str, float]: ...
@overload
def score(
    policy: Any,
    split: str | envs.Split = ...,
    *,
    episodes: int | None = ...,
    num_envs: int = ...,
    seed: int = ...,
    batched: bool = ...,
    details: Literal[True],
    **level_options: Any,
) -> Evaluation: ...
def score(
    policy: Any,
    split: str | envs.Split = "gridworld",
    *,
    episodes: int | None = None,
    num_envs: int = 250,
    seed: int = 0,
    batched: bool = True,
    details: bool = False,
    **level_options: Any,
) -> dict[str, float] | Evaluation:
    """Scores any policy as the paper does: {"train": ..., "uniform": ..., "rare": ...}, and on the
    further kinds of levels that the split has ("validation", "fresh").

    The score of a level is its mean return, normalised where the split says so; the score of a
    kind of levels is the mean over them, by their weights.

    Args:
        policy: a function from observations `{name: [N, ...]}` to actions [N], or a
            `zipf.evaluate.Policy`, which may have a memory; "expert" or "generalist" for a scripted
            policy of the split's family. `zipf.load_agent` makes one of the agent of a run,
            `policy` in each module of `zipf.adapters` one of an agent of another library.
        split: the benchmark, for instance "gridworld", or a `zipf.envs.Split` of your own.
        episodes: played on each level; None: as many as the split says: 1000, in the labyrinth's
            splits 100 of each task.
        num_envs: environments played at a time; `batched=False` plays one.
        seed: of the environments and of the policy's draws, as far as they come from PyTorch's
            global generator or the policy is given a seed; at least 0.
        batched: False for a function that takes one observation `{name: [...]}` and returns one
            action, as agents of a single Gymnasium environment do.
        details: return an `Evaluation` in the place of the scores.
        level_options: constructor options of the levels, for instance `num_maps=5`.

    A policy that depends on what it is to play has a method `for_envs(observation_space,
    action_space, seed)`, of one environment's spaces, that returns a function or `Policy` that is
    played in its place, or raises a `ValueError`.

    A policy may carry the constructor options that it was trained with in a mapping `env_options`,
    for instance `policy.env_options = {"num_maps": 5}`. It is then refused in other environments.

    Raises:
        ValueError: an unknown split, no episodes, no environments, a seed that is no whole number
            >= 0, options that no level can have; a policy whose spaces or `env_options` differ from
            the split's, or that returns something else than an action for each environment; the
            path of a file or folder.
        zipf.envs.EnvError: an episode does not end, or an environment returns what it must not.
        TypeError: the policy cannot be called.
    """
    split = as_split(split)
    check_options(split, level_options)
    seed = whole("seed", seed, 0)
    observation_space, action_space = _spaces(split, level_options)
    played = env_options(split, **level_options)
    check_env_options(getattr(policy, "env_options", None), split, played)
    draws = derive_seed(seed, "actions")
    with own_torch_draws(draws):
        results = evaluate(
            as_policy(policy, observation_space, action_space, batched=batched, seed=draws),
            split,
            episodes=episodes,
            num_envs=num_envs if batched else 1,
            seed=seed,
            **level_options,
        )
    return _evaluation(split.name, played, results) if details else scores(results)


def env_options(split: str | envs.Split, **level_options: Any) -> dict[str, dict[str, Any]]:
    """The constructor options of a split's levels, defaults included, by level name.

    Raises:
        ValueError: an unknown split or level.
    """
    split = as_split(split)
    found = {}
    for level in split.all_levels:
        options: dict[str, Any] = {}
        if isinstance(level.level, str):
            known = envs.find_level(level.level)[0].options_class.model_fields
            options = {
                name: option.get_default(call_default_factory=True)
                for name, option in known.items()
                if not option.is_required()
            }
        options |= {**level_options, **level.options}
        found[level.name] = {
            name: plain_option(value) for name, value in options.items() if name not in HOW_STEPPED
        }
    return found


def as_split(split: Any) -> envs.Split:
    """A split that may be given by its name.

    Raises:
        ValueError: it is neither, or unknown.
    """
    if isinstance(split, envs.Split):
        return split
    if isinstance(split, envs.Family):
        names = ", ".join(map(repr, split.split_names))
        raise ValueError(f"split must be a split's name, got a Family: it has {names}")
    if not isinstance(split, str):
        raise ValueError(
            f"split must be a split's name or a zipf.envs.Split, got a {type(split).__name__}"
        )
    return envs.split(split)


def check_options(split: envs.Split, level_options: Mapping[str, Any]) -> None:
    """Raises ValueError for names that `score` needs itself, or that no level has as an option."""
    for name in ("level", "autoreset_mode"):
        if name in level_options:
            raise ValueError(
                f"{name}={level_options[name]!r} is no option here: a split has its levels, and "
                "environments are reset in the step that ends an episode"
            )
    own = "episodes", "num_envs", "seed", "batched", "details"  # that a name may be meant for
    made = "copy", "render_mode", "threads", "processes"  # of `envs.make_vec`
    for level in split.all_levels:
        if isinstance(level.level, str):
            family, _ = envs.find_level(level.level)
            family.check_options(level_options, *own, *made)


def _spaces(
    split: envs.Split, level_options: Mapping[str, Any]
) -> tuple[spaces.Dict, spaces.Discrete]:
    """Of one environment. Raises ValueError where the split's levels are not alike."""
    found: dict[str, tuple[Any, Any]] = {}
    for level in split.all_levels:
        env = envs.make_vec(level, 1, **level_options)
        found[level.name] = env.single_observation_space, env.single_action_space
        env.close()
    first = next(iter(found))
    for name, one in found.items():
        if one != found[first]:
            raise ValueError(
                f"split {split.name!r}: its levels have different spaces: {name} has {one[0]} "
                f"and {one[1]}, {first} has {found[first][0]} and {found[first][1]}"
            )
    return found[first]


def _evaluation(
    split: str, played: Mapping[str, Mapping[str, Any]], results: list[Result]
) -> Evaluation:
    episodes = []
    levels = []
    for result in results:
        named = result.episodes.copy()
        named.insert(0, "level_kind", result.kind)
        named.insert(1, "level_name", result.level)
        episodes.append(named)
        row = result.row()
        low, high = score_interval(result)
        success_low = success_high = np.nan
        if "success" in result.episodes:
            success_low, success_high = _wilson(result.episodes["success"].to_numpy())
        levels.append(
            {
                "level_kind": result.kind,
                "level_name": result.level,
                "weight": result.split_level.weight,
                "episodes": row["episodes"],
                "score": row["score"],
                "score_low": low,
                "score_high": high,
                "success": np.nan if row["success"] is None else row["success"],
                "success_low": success_low,
                "success_high": success_high,
                "return": row["return"],
                "length": row["length"],
            }
        )
    by_level = pd.DataFrame(levels)
    return Evaluation(
        split=split,
        env_options=played,
        episodes=pd.concat(episodes, ignore_index=True),
        situations=situations(results).reset_index(drop=True),
        levels=by_level,
        kinds=_kinds(by_level),
        results=results,
    )


def _kinds(levels: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for kind, of_kind in levels.groupby("level_kind", sort=False):
        row: dict[str, Any] = {"level_kind": kind}
        for name, weights in (("score", of_kind["weight"]), ("plain", of_kind["weight"] * 0 + 1)):
            scores, low, high = (
                of_kind[column].to_numpy() for column in ("score", "score_low", "score_high")
            )
            shares = (weights / weights.sum()).to_numpy()
            mean = float(shares @ scores)
            row[name] = mean
            row[f"{name}_low"] = mean - np.sqrt((shares**2) @ (scores - low) ** 2)
            row[f"{name}_high"] = mean + np.sqrt((shares**2) @ (high - scores) ** 2)
        rows.append(row)
    return pd.DataFrame(rows)


def score_interval(result: Result) -> tuple[float, float]:
    """The 95 % confidence interval of a level's score; see `Evaluation`."""
    returns = result.episodes["return"].to_numpy()
    situations = None if returns.min() == returns.max() else _situations_met(result)
    interval: Callable[[NDArray], tuple[float, float]] = _bootstrap
    if situations is not None:
        interval = partial(bootstrap_over_situations, situations)
    elif np.isin(returns, (0, 1)).all():
        interval = _wilson
    ends = [result.split_level.normalised(end) for end in interval(returns)]
    return min(ends), max(ends)


def _situations_met(result: Result) -> NDArray[np.integer] | None:
    """What of the episodes of a slice of the situations is drawn, int64 [n], numbered from 0; None
    on other levels, and where there is only one."""
    ranks = [str(name) for name in result.episodes if name not in OUTCOMES]
    if result.kind in ("train", "uniform") or not ranks:
        return None
    groups = result.episodes.groupby(ranks).ngroup().to_numpy(np.int64)
    if groups.max() + 1 > len(groups) / FEWEST_MET:
        groups = result.episodes.groupby(ranks[:1]).ngroup().to_numpy(np.int64)
    return groups if groups.max() > 0 else None


def bootstrap_over_situations(
    situations: NDArray[np.integer], returns: NDArray
) -> tuple[float, float]:
    """The percentile interval of a mean return [n] whose episodes are of `situations` [n]: in each
    resample as many situations are drawn as there are, and of each as many episodes as it has."""
    rng = np.random.default_rng(0)
    of_each = [returns[situations == k] for k in range(situations.max() + 1)]
    counts = np.array([len(one) for one in of_each])
    drawn = rng.integers(len(of_each), size=(RESAMPLES, len(of_each)))
    sums = np.empty(drawn.shape)  # of the returns of episodes drawn anew for every draw
    for k, one in enumerate(of_each):
        here = drawn == k
        sums[here] = rng.choice(one, (here.sum(), len(one))).sum(axis=1)
    low, high = np.percentile(sums.sum(axis=1) / counts[drawn].sum(axis=1), [2.5, 97.5])
    return float(low), float(high)


def _wilson(outcomes: NDArray) -> tuple[float, float]:
    """The interval of the mean of zeros and ones [n]."""
    low, high = wilson_interval(outcomes.sum(), len(outcomes))
    return float(low), float(high)


def _bootstrap(returns: NDArray) -> tuple[float, float]:
    """The interval of the mean of any numbers [n]; always the same for the same numbers."""
    if len(returns) < 2:
        return np.nan, np.nan
    found = bootstrap(np.mean, [returns])
    return found.low, found.high
