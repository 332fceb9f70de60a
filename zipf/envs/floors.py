"""What policies score that are not told what an episode asks for: searched for.

A floor that was only reasoned about may be beaten by a simple cheat, such as walking straight
ahead. `search` tries to cheat on a level, with

- each action, repeated for ever;
- cycles of two actions, and of three of those that do best alone, each held for some steps;
- walks that take random actions and hold each for some time;
- sequences of up to 200 actions, evolved from the best of these, played again and again;
- the scripted policies that a family has for this, see `Family.blind_policies`.

A policy is known by its text, from which `play` plays it: `actions 1*8 5` (action 1 eight times,
then action 5, then both again), `walk 0.9 of 0 6` (the last action again with probability 0.9,
otherwise one of these), or the name of a family's own. What a walk, or a family's own, draws
depends on how many policies and episodes are played beside it: its score repeats exactly with the
same list alone, and otherwise within its standard error.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.family import BoundPolicy, find_level, make_vec
from zipf.envs.splits import Level
from zipf.envs.vector import ZipfVectorEnv

# Ours: how the search goes.
EPISODES = 32  # of a policy, at first
REPEATS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # steps for which an action of a cycle is held
PERSISTENCE = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98)  # of walks
LONGEST = 200  # actions of an evolved sequence
KEPT = 5  # policies whose score is measured again
SURVIVORS = 6  # actions that cycles of three and walks are made of
PARENTS = 16  # sequences that others are evolved from
SHARES = (0.3, 0.5, 0.75)  # of the time, until which cycles, walks and sequences are tried
HALVED = 20  # policies that are played on, of which the better half remains again and again
SEARCHED = 1_000_000
"""The first seed that a search plays; `play` counts from 0 on, so that its seeds are others."""


@dataclass(frozen=True)
class Floor:
    """A policy that is not told what is asked for, and its score."""

    policy: str  # its text
    score: float  # mean return
    error: float  # standard error of the score
    episodes: int  # how many it was measured over


@dataclass
class Arena:
    """Envs of a level in which policies are played without a look.

    Args:
        level: what `make_vec` takes for a single level, for instance its full name.
        rows: how many envs are stepped together.
        own: the family's own blind policies by name, each `policy(env)` a scripted policy; None:
            those of the level's family.
        options: constructor options of the level.
    """

    level: Level
    rows: int = 512
    own: Mapping[str, Callable[[Any], BoundPolicy]] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.own is None:
            found = find_level(self.level)[0] if isinstance(self.level, str) else None
            self.own = found.loaded_blind_policies() if found is not None else {}
        self.env = _unseen(make_vec(self.level, self.rows, **self.options))
        self.count = int(self.env.single_action_space.n)

    def returns(self, policies: Sequence[str], seeds: Sequence[int]) -> NDArray[np.float64]:
        """The return of the episode of each seed, [policies, seeds].
        Raises ValueError: a text is no policy of these envs."""
        found = np.zeros((len(policies), len(seeds)))
        drawn = [k for k, text in enumerate(policies) if text not in (self.own or {})]
        pairs = [(k, j) for k in drawn for j in range(len(seeds))]
        for first in range(0, len(pairs), self.rows):
            part = pairs[first : first + self.rows]
            act = _open_loop([policies[k] for k, _ in part], self.count, seeds[part[0][1]])
            played = self._play(act, [seeds[j] for _, j in part])
            for (k, j), value in zip(part, played, strict=True):
                found[k, j] = value
        for k in set(range(len(policies))) - set(drawn):
            for first in range(0, len(seeds), self.rows):
                of_own = list(seeds[first : first + self.rows])
                act = (self.own or {})[policies[k]](self.env)
                found[k, first : first + len(of_own)] = self._play(act, of_own)
        return found

    def _play(self, act: BoundPolicy, seeds: Sequence[int]) -> NDArray[np.float64]:
        """The returns of the first episodes of envs with these seeds."""
        env = self.env
        spare = [SEARCHED - 1] * (env.num_envs - len(seeds))
        out = env.allocate()
        env.reset(seed=[*seeds, *spare], out=out)
        running = np.arange(env.num_envs) < len(seeds)
        returns = np.zeros(env.num_envs)
        actions = np.zeros(env.num_envs, np.int64)
        while running.any():
            chosen = act()
            actions[: len(chosen)] = chosen
            _, rewards, terminated, truncated, _ = env.step(actions, out=out)
            returns += np.where(running, rewards, 0.0)
            running &= ~(terminated | truncated)
            env.check_lengths(running)
        return returns[: len(seeds)]

    def close(self) -> None:
        self.env.close()


def play(policies: Sequence[str], arena: Arena, *, episodes: int = 2000) -> list[Floor]:
    """Measures policies on the episodes of the seeds from 0 on.
    Raises ValueError: a text is no policy of these envs, or fewer than two episodes."""
    if episodes < 2:
        raise ValueError(f"episodes must be at least 2, got {episodes}")
    returns = arena.returns(policies, range(episodes))
    return [_floor(text, of_policy) for text, of_policy in zip(policies, returns, strict=True)]


def search(
    arena: Arena,
    *,
    seconds: float,
    episodes: int = EPISODES,
    known: Sequence[str] = (),
) -> list[str]:
    """The best policies that were found in about so many seconds, the best first.

    What is found depends on the machine's speed. What `play` measures does not.

    Args:
        episodes: of each policy, at first.
        known: policies to begin with, for instance those that do well with other options.
    """
    return _Search(arena, seconds, episodes).run(known)


def summary(policy: str) -> str:
    """A policy in a few words: its text, or of a long sequence how long it is."""
    if not policy.startswith("actions") or len(policy) <= 40:
        return policy
    return f"a sequence of {sum(steps for _, steps in _runs(policy))} actions"


class _Search:
    def __init__(self, arena: Arena, seconds: float, episodes: int) -> None:
        self.arena = arena
        self.rng = np.random.default_rng(0)
        self.began, self.seconds = time.monotonic(), seconds
        self.tried: dict[str, float] = {}
        self.episodes = episodes
        self.batch = max(arena.rows // episodes, 1)

    def run(self, known: Sequence[str]) -> list[str]:
        count = self.arena.count
        self._try([*(self.arena.own or {}), *known], share=math.inf)
        self._try([_actions([(one, 1)]) for one in self.rng.permutation(count).tolist()])
        alone = sorted(range(count), key=lambda one: -self.tried.get(_actions([(one, 1)]), -1e9))
        survivors = alone[:SURVIVORS]
        self._try_until(SHARES[0], self._cycles(list(range(count)), survivors))
        self._try_until(SHARES[1], self._walks(survivors))
        while self._used() < SHARES[2]:
            self._try(self._children())
        return self._halved()

    def _used(self) -> float:
        passed = time.monotonic() - self.began
        return passed / self.seconds if self.seconds else math.inf

    def _seeds(self, count: int) -> list[int]:
        return self.rng.integers(SEARCHED, 2 * SEARCHED, size=count).tolist()

    def _try(self, texts: Sequence[str], share: float = SHARES[2]) -> None:
        new = [text for text in dict.fromkeys(texts) if text not in self.tried]
        for first in range(0, len(new), self.batch):
            if self._used() > share:
                return
            part = new[first : first + self.batch]
            for text, of_policy in zip(
                part, self.arena.returns(part, self._seeds(self.episodes)), strict=True
            ):
                self.tried[text] = float(of_policy.mean())

    def _try_until(self, share: float, texts: Iterator[str]) -> None:
        while self._used() < share:
            part = [text for text, _ in zip(texts, range(self.batch), strict=False)]
            if not part:
                return
            self._try(part)

    def _cycles(self, actions: list[int], survivors: list[int]) -> Iterator[str]:
        """Cycles of two of all actions and of three of the survivors, in a random order."""
        pairs = [(a, b) for a in actions for b in actions if a != b]
        self.rng.shuffle(pairs)
        for number in range(20 * len(pairs)):
            chosen = pairs[number % len(pairs)]
            if number % 3 == 2:
                chosen = tuple(self.rng.choice(survivors, min(3, len(survivors)), replace=False))
            yield _actions([(int(one), int(self.rng.choice(REPEATS))) for one in chosen])

    def _walks(self, survivors: list[int]) -> Iterator[str]:
        every = list(range(self.arena.count))
        for persistence in PERSISTENCE:
            yield _walk(persistence, every)
        for _ in range(500):
            size = int(self.rng.integers(2, max(len(survivors), 2) + 1))
            among = survivors if self.rng.random() < 0.7 else every
            chosen = self.rng.choice(among, min(size, len(among)), replace=False)
            yield _walk(float(self.rng.choice(PERSISTENCE)), sorted(chosen.tolist()))

    def _children(self) -> list[str]:
        """Sequences that differ a little from the best."""
        best = sorted(self.tried, key=lambda text: -self.tried[text])
        parents = [text for text in best if text.startswith("actions")][:PARENTS]
        children = []
        for _ in range(self.batch):
            runs = _runs(parents[int(len(parents) * self.rng.random() ** 2)])
            if len(runs) < 8:  # a cycle is written out, so that its parts may differ
                runs = (runs * LONGEST)[: int(self.rng.integers(4, 24))]
            for _ in range(int(self.rng.integers(1, 4))):
                place = int(self.rng.integers(len(runs)))
                change = self.rng.random()
                action = int(self.rng.integers(self.arena.count))
                if change < 0.35:
                    runs[place] = (action, runs[place][1])
                elif change < 0.65:
                    runs[place] = (runs[place][0], int(self.rng.choice(REPEATS)))
                elif change < 0.85:
                    runs.insert(place, (action, int(self.rng.choice(REPEATS))))
                elif len(runs) > 1:
                    del runs[place]
            children.append(_actions(_shortened(runs)))
        return children

    def _halved(self) -> list[str]:
        """The best, after more and more episodes of fewer and fewer."""
        best = sorted(self.tried, key=lambda text: -self.tried[text])[:HALVED]
        episodes = self.episodes
        while len(best) > KEPT and self._used() < 1:
            returns = self.arena.returns(best, self._seeds(episodes)).mean(axis=1)
            order = np.argsort(-returns, kind="stable")
            best = [best[k] for k in order[: max(len(best) // 2, KEPT)]]
            episodes *= 2
        return best[:KEPT]


def _open_loop(texts: Sequence[str], count: int, seed: int) -> BoundPolicy:
    """Plays a policy in each env, from the first step of an episode on."""
    rng = np.random.default_rng([seed, 2])
    n = len(texts)
    table, lengths = np.zeros((n, LONGEST), np.int64), np.ones(n, np.int64)
    walks = np.zeros(n, np.bool_)
    persistence, choices = np.zeros(n), np.zeros((n, count), np.int64)
    sizes = np.ones(n, np.int64)
    for i, text in enumerate(texts):
        if found := re.fullmatch(r"walk (0(?:\.\d+)?|1) of ((?:\d+ ?)+)", text):
            among = [int(one) for one in found[2].split()]
            if len(among) > count:
                raise ValueError(f"{summary(text)!r} has {len(among)} actions: at most {count}")
            walks[i], persistence[i], sizes[i] = True, float(found[1]), len(among)
            choices[i, : len(among)] = among
        else:
            sequence = [action for action, steps in _runs(text) for _ in range(steps)]
            if len(sequence) > LONGEST:
                raise ValueError(
                    f"{summary(text)!r} has {len(sequence)} actions: at most {LONGEST}"
                )
            table[i, : len(sequence)], lengths[i] = sequence, len(sequence)
    if max(table.max(), choices.max()) >= count:
        raise ValueError(f"there are actions 0 to {count - 1}, got {', '.join(texts)}")
    rows, last = np.arange(n), np.full(n, -1, np.int64)
    step = 0

    def act() -> NDArray[np.int64]:
        nonlocal step
        actions = table[rows, step % lengths]
        if walks.any():
            new = (last < 0) | (rng.random(n) >= persistence)
            drawn = choices[rows, (rng.random(n) * sizes).astype(np.int64)]
            last[:] = np.where(new, drawn, last)
            actions = np.where(walks, last, actions)
        step += 1
        return actions

    return act


def _actions(runs: Sequence[tuple[int, int]]) -> str:
    return "actions " + " ".join(f"{one}*{steps}" if steps > 1 else f"{one}" for one, steps in runs)


def _walk(persistence: float, actions: Sequence[int]) -> str:
    return f"walk {persistence:g} of {' '.join(map(str, actions))}"


def _runs(text: str) -> list[tuple[int, int]]:
    """The actions of a sequence, each with the number of steps for which it is held."""
    if not re.fullmatch(r"actions( \d+(\*[1-9]\d*)?)+", text):
        raise ValueError(
            f"{text!r} is no policy: expected 'actions 1*8 5', 'walk 0.9 of 0 6' or the name of "
            "one of the family's own"
        )
    parts = (part.partition("*") for part in text.split()[1:])
    return [(int(action), int(steps or 1)) for action, _, steps in parts]


def _shortened(runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    kept: list[tuple[int, int]] = []
    left = LONGEST
    for action, steps in runs:
        if left > 0:
            kept.append((action, min(steps, left)))
            left -= steps
    return kept


def _unseen(env: ZipfVectorEnv) -> ZipfVectorEnv:
    """The same envs without their observations, which nobody looks at and which cost most."""
    env._observe = lambda out, mask: None  # type: ignore[method-assign]
    return env


def _floor(text: str, returns: NDArray[np.float64]) -> Floor:
    error = float(returns.std(ddof=1)) / math.sqrt(len(returns))
    return Floor(text, float(returns.mean()), error, len(returns))
