"""The evaluator: scores any policy on the levels of a split.

Episodes are counted as they *start*: the first n to start are played to their end and scored,
whatever their length. Counting the first n to *end* would over-count short ones, and in these
worlds an agent that fails fast would look worse, or better, than it is.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from zipf import envs
from zipf.agents.agent import Agent
from zipf.agents.network import Inputs
from zipf.envs.vector import ZipfVectorEnv


class Policy(Protocol):
    """Plays a batch of worlds; may remember.

    Observations are written over at the next step: keep copies.
    """

    def start(self, num_envs: int) -> None:
        """Forgets everything: `num_envs` new worlds begin."""

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        """Actions int [N] for observations `{name: [N, ...]}`.

        `reward` float32 [N] is what the last action brought, and `is_first` bool [N] says where an
        episode has just begun, so that memory is to be cleared.
        """


class AgentPolicy:
    """An agent with its memory; samples its actions from a generator of its own."""

    def __init__(self, agent: Agent, *, seed: int, device: str):
        self.agent = agent
        self.device = device
        self.generator = torch.Generator().manual_seed(seed)

    def start(self, num_envs: int) -> None:
        self.memory = self.agent.initial_memory(num_envs)
        self.action = torch.full((num_envs,), -1, device=self.device)

    def __call__(
        self, observation: dict[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        first = torch.from_numpy(is_first).to(self.device)
        inputs = Inputs(
            {name: torch.from_numpy(part).to(self.device) for name, part in observation.items()},
            self.action.masked_fill(first, -1),
            torch.from_numpy(reward).to(self.device).masked_fill(first, 0.0),
            first,
        )
        self.action, self.memory, _ = self.agent.act(
            inputs, self.memory, self.generator, training=False
        )
        return self.action.cpu().numpy()


@dataclass(frozen=True)
class Result:
    """The episodes of one level, in the order in which they started."""

    kind: str  # train, uniform or rare
    level: str
    episodes: pd.DataFrame  # a row each: the situation's ranks, success, return, length

    @property
    def score(self) -> float:
        """Mean return: the paper's score."""
        return float(self.episodes["return"].mean())

    def row(self) -> dict[str, Any]:
        """The row of `evaluations.csv`, without when it was taken."""
        means = self.episodes[["success", "return", "length"]].mean()
        return {
            "level_kind": self.kind,
            "level": self.level,
            "episodes": len(self.episodes),
            "score": self.score,
            "success": means["success"],
            "return": means["return"],
            "length": means["length"],
        }

    def situations(self) -> pd.DataFrame:
        """Every situation met, with what came of it."""
        ranks = [c for c in self.episodes.columns if c not in ("success", "return", "length")]
        table = self.episodes.groupby(ranks, as_index=False).agg(
            **{
                "episodes": ("success", "size"),
                "successes": ("success", "sum"),
                "return_sum": ("return", "sum"),
            }
        )
        table.insert(0, "level_kind", self.kind)
        return table


def play(policy: Policy, env: ZipfVectorEnv, *, episodes: int, seed: int) -> pd.DataFrame:
    """Plays the first `episodes` episodes to start; one row each, in that order."""
    names = [*env.situation, "success", "return", "length"]
    records: dict[str, NDArray] = {}
    # Which episode each world plays; from `episodes` on they are not scored.
    playing = np.arange(env.num_envs)
    started = env.num_envs
    unfinished = episodes
    observation, _ = env.reset(seed=seed)
    reward = np.zeros(env.num_envs, np.float32)
    is_first = np.ones(env.num_envs, np.bool_)
    policy.start(env.num_envs)
    buffers = {name: np.empty_like(part) for name, part in observation.items()}
    while unfinished:
        actions = policy(observation, reward, is_first)
        observation, rewards, terminated, truncated, info = env.step(actions, out=buffers)
        reward = rewards.astype(np.float32)
        is_first = terminated | truncated
        if not is_first.any():
            continue
        scored = is_first & (playing < episodes)
        for name in names:
            values = info["final_info"][name]
            column = records.setdefault(name, np.zeros(episodes, values.dtype))
            column[playing[scored]] = values[scored]
        unfinished -= int(scored.sum())
        new = int(is_first.sum())
        playing[is_first] = np.arange(started, started + new)
        started += new
    return pd.DataFrame({name: records[name] for name in names})


def evaluate(
    policy: Policy,
    split: envs.Split,
    *,
    episodes: int = 1000,
    num_envs: int = 250,
    seed: int = 0,
    **level_options: Any,
) -> list[Result]:
    """Scores a policy on every level of a split: those to train on, the uniform and the rare one.

    Worlds are seeded from `seed` and the level's place; nothing else's randomness is touched.

    Raises:
        ValueError: no episodes, no worlds, or options that no level can have.
    """
    if episodes < 1:
        raise ValueError(f"episodes={episodes}: should be at least 1")
    results = []
    for index, kind in enumerate(envs.KINDS):
        for place, level in enumerate(split.levels(kind)):
            env = envs.make_vec(level, min(num_envs, episodes), **level_options)
            worlds = derive_seed(seed, "evaluation", index + place * len(envs.KINDS))
            played = play(policy, env, episodes=episodes, seed=worlds)
            results.append(Result(kind, level.name, played))
            env.close()
    return results


def scores(results: Sequence[Result]) -> dict[str, float]:
    """The score on each kind of level: the mean over its levels."""
    by_kind: dict[str, list[float]] = {}
    for result in results:
        by_kind.setdefault(result.kind, []).append(result.score)
    return {kind: float(np.mean(of_kind)) for kind, of_kind in by_kind.items()}


def situations(results: Sequence[Result]) -> pd.DataFrame:
    """The rows of `situations.csv`: every situation met, levels of a kind taken together."""
    table = pd.concat([result.situations() for result in results])
    ranks = [c for c in table.columns if c not in ("episodes", "successes", "return_sum")]
    return table.groupby(ranks, as_index=False, sort=False).sum()


def score(
    policy: Any,
    split: str | envs.Split = "gridworld",
    *,
    episodes: int = 1000,
    num_envs: int = 250,
    seed: int = 0,
    batched: bool = True,
    **level_options: Any,
) -> dict[str, float]:
    """Scores any policy as the paper does: {"train": ..., "uniform": ..., "rare": ...}.

    Where a split has several levels to train on, the train score is the mean over them.

    Args:
        policy: one of
            a function from observations `{name: [N, ...]}` to actions [N];
            an agent with `predict(observation, state, episode_start)` returning actions and state,
            as Stable-Baselines3's;
            a `Policy` of this module.
        split: the benchmark, for instance "gridworld", or a `zipf.envs.Split` of your own.
        episodes: scored per level (the paper: 1000).
        num_envs: worlds played at a time; `batched=False` plays one.
        seed: of the worlds.
        batched: False for a policy that takes one observation `{name: [...]}` and returns one
            action, as agents written for a single Gymnasium environment do.
        level_options: constructor options of the levels, for instance `num_maps=5`.

    Raises:
        ValueError: unknown split, no episodes, no worlds, or options that no level can have.
        TypeError: the policy is neither of the above.
    """
    results = evaluate(
        _as_policy(policy, batched),
        envs.split(split) if isinstance(split, str) else split,
        episodes=episodes,
        num_envs=num_envs if batched else 1,
        seed=seed,
        **level_options,
    )
    return scores(results)


def derive_seed(*parts: int | str) -> int:
    """A seed for one purpose, 62 bits hashed from a run's seed and the purpose's name."""
    digest = hashlib.sha256(repr(parts).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 2


class _Function:
    def __init__(self, function: Callable[[Any], Any], batched: bool):
        self.function = function
        self.batched = batched

    def start(self, num_envs: int) -> None: ...

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        if self.batched:
            actions = np.asarray(self.function(observation))
            if actions.shape != is_first.shape:
                raise ValueError(
                    f"the policy returned actions of shape {actions.shape} for {len(is_first)} "
                    f"observations; should be {is_first.shape}, or say batched=False for a policy "
                    "that takes one observation"
                )
            return actions
        return np.asarray([self.function({name: part[0] for name, part in observation.items()})])


class _Predictor:
    """An agent in Stable-Baselines3's convention."""

    def __init__(self, predict: Callable[..., Any], batched: bool):
        self.predict = predict
        self.batched = batched

    def start(self, num_envs: int) -> None:
        self.state = None

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        if not self.batched:
            observation = {name: part[0] for name, part in observation.items()}
        actions, self.state = self.predict(observation, state=self.state, episode_start=is_first)
        return np.atleast_1d(actions)


def _as_policy(policy: Any, batched: bool) -> Policy:
    if hasattr(policy, "start") and callable(policy):
        return policy
    if callable(getattr(policy, "predict", None)):
        return _Predictor(policy.predict, batched)
    if callable(policy):
        return _Function(policy, batched)
    raise TypeError(
        f"policy is a {type(policy).__name__}; should be a function from observations to actions "
        "or an agent with `predict`"
    )
