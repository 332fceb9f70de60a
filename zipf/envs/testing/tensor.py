"""A self-check of tensor environments: against the batch of envs on NumPy arrays.

    from zipf.envs import goal, make_tensor, make_vec
    from zipf.envs.testing import check_tensor_env

    level = "gridworld/zipf_2"
    batch = make_vec(level, 8)
    check_tensor_env(make_tensor(level, 8, "cpu"), batch, goal=goal(level, batch))

It works for any family in which an episode depends on nothing but its ranks and the actions: it
uses the interfaces of `TensorEnv` and `ZipfVectorEnv` only.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from torch import Tensor

from zipf.envs.family import Symmetries
from zipf.envs.goals import Goal
from zipf.envs.tensor import Codes, Stepped, TensorEnv
from zipf.envs.testing.steps import must_raise, require, require_same
from zipf.envs.vector import Observation, ZipfVectorEnv


def check_tensor_env(
    tensor: TensorEnv,
    batch: ZipfVectorEnv,
    *,
    goal: Goal | None = None,
    symmetries: Symmetries | None = None,
    steps: int = 300,
    seed: int = 0,
) -> dict[str, int]:
    """Plays a tensor environment, plays the same situations and actions in a batch, and compares.

    Compared are spaces, decoded observations, rewards, ends, last observations, outcomes, goals
    that were achieved, what symmetries show, hashes, and steps after a state is restored. Half of
    the episodes begin at ranks that are forced. The law that ranks are drawn from is not checked.

    Args:
        tensor: the tensor environment.
        batch: as many envs of the same level and options, that reset in the step that ends an
            episode.
        goal: what reads the goals of the batch's observations; None: they are not checked.
        symmetries: of the batch's spaces; None: they are not checked.
        steps: random actions in every env, enough for several episodes to end.
        seed: of the envs, the actions and the forced ranks.

    Returns:
        How many episodes `ended`, and how many of those had `achieved` something: whether the check
        saw what it is about.

    Raises:
        AssertionError: saying what is wrong and where.
    """
    check = _Check(tensor, batch, goal, symmetries, steps, seed)
    check.interface()
    played = check.play()
    counts = check.replay(played)
    check.hashes(played)
    check.state()
    return counts


class _Played:
    """What a tensor environment showed and gave, a row for each step."""

    def __init__(self) -> None:
        self.codes: list[Codes] = []
        self.actions: list[NDArray[np.int64]] = []
        self.stepped: list[Stepped] = []
        self.forced: list[NDArray[np.int64]] = []  # [ranks, N], -1: drawn


class _Check:
    def __init__(
        self,
        tensor: TensorEnv,
        batch: ZipfVectorEnv,
        goal: Goal | None,
        symmetries: Symmetries | None,
        steps: int,
        seed: int,
    ) -> None:
        self.tensor, self.batch, self.goal, self.symmetries = tensor, batch, goal, symmetries
        self.n, self.steps, self.seed = tensor.num_envs, steps, seed
        self.rng = np.random.default_rng(seed)
        self.addresses: dict[str, int] = {}

    def interface(self) -> None:
        """Both describe the same envs."""
        tensor, batch = self.tensor, self.batch
        require(
            batch.autoreset_mode is AutoresetMode.SAME_STEP,
            f"the batch must have the autoreset mode SAME_STEP, got {batch.autoreset_mode.name}",
        )
        for name in (
            "num_envs",
            "single_observation_space",
            "single_action_space",
            "situation",
            "reports_success",
            "achieves",
        ):
            require_same(getattr(tensor, name), getattr(batch, name), name)
        for seed in (-1, 0.5):
            with must_raise(ValueError, f"reset({seed})"):
                tensor.reset(seed)  # type: ignore[arg-type]
        if tensor.achieves:
            tensor.report_achieved()
            batch.report_achieved()
        else:
            with must_raise(ValueError, "report_achieved() of envs that do not tell"):
                tensor.report_achieved()

    def play(self) -> _Played:
        """Plays the tensor environment. Some of the envs in which an episode has begun begin
        another, of which some ranks are forced."""
        tensor, played = self.tensor, _Played()
        tensor.reset(self.seed)
        self.addresses = {name: one.data_ptr() for name, one in tensor.tensors().items()}
        begun = np.ones(self.n, np.bool_)
        sizes = np.array(list(tensor.situation.values()), np.int64).reshape(-1, 1)
        for t in range(self.steps):
            again = begun & (self.rng.random(self.n) < 0.5)
            forced = self.rng.integers(sizes, size=(len(sizes), self.n))
            forced[(self.rng.random(forced.shape) < 0.3) | ~again] = -1
            if again.any() or t == 0:
                tensor.begin(self._to(again), self._to(forced))
            played.forced.append(forced)
            played.codes.append(tensor.observe())
            played.actions.append(self._actions())
            stepped = tensor.step(self._to(played.actions[-1]))
            played.stepped.append(stepped)
            begun = _array(stepped.terminated | stepped.truncated)
        addresses = {name: one.data_ptr() for name, one in tensor.tensors().items()}
        require(
            addresses == self.addresses,
            "tensors() gives other tensors after steps: they must be written in place",
        )
        return played

    def _actions(self) -> NDArray[np.int64]:
        return self.rng.integers(self.tensor.single_action_space.n, size=self.n)

    def _to(self, array: NDArray[Any]) -> Tensor:
        return torch.from_numpy(array.copy()).to(self.tensor.device)

    def replay(self, played: _Played) -> dict[str, int]:
        """Plays the same in the batch. Which ranks an episode was drawn at is known when it ends;
        the last ones, which did not end, are not compared."""
        codes = _stacked(played.codes)
        shown = _arrays(self.tensor.decode(codes))  # {name: [T, N, ...]}
        final = {name: [one.final[name] for one in played.stepped] for name in codes}
        final_codes = {name: torch.stack(parts) for name, parts in final.items()}
        final_shown = _arrays(self.tensor.decode(final_codes))
        outcomes = _arrays(_stacked([one.outcome for one in played.stepped]))
        ends = np.stack([_array(one.terminated | one.truncated) for one in played.stepped])
        self._dtypes(played, outcomes)

        length, longest = np.zeros(self.n, np.int64), 0
        for ended in ends:
            length += 1
            longest = max(longest, int(length.max()))
            length[ended] = 0
        require(
            longest <= self.tensor.max_steps,
            f"max_steps is {self.tensor.max_steps}, and an episode has not ended after {longest}",
        )
        ranks, known = self._ranks(outcomes, ends)
        forced = np.stack(played.forced)
        ranks = np.where(forced >= 0, forced, ranks)

        symmetric = self._symmetric(codes)
        names = list(self.batch.situation)
        options: dict[str, Any] = dict(zip(names, ranks[0], strict=True))
        observation, _ = self.batch.reset(seed=self.seed, options=options)
        counts = {"ended": int(ends.sum()), "achieved": 0}
        for t, (actions, stepped) in enumerate(zip(played.actions, played.stepped, strict=True)):
            where, mask = f"step {t}", known[t]
            row = {name: part[t] for name, part in shown.items()}
            _same(row, observation, mask, f"{where}: the decoded observation")
            self._symmetries(symmetric, t, observation, mask)
            self._goals(played.codes[t], observation, mask, where)
            observation, reward, terminated, truncated, info = self.batch.step(actions)
            expected = {
                "reward": reward.astype(np.float32),
                "terminated": terminated,
                "truncated": truncated,
            }
            given = {name: _array(getattr(stepped, name)) for name in expected}
            _same(given, expected, mask, where)
            ended = ends[t]
            if not ended.any():
                continue
            row = {name: part[t] for name, part in final_shown.items()}
            _same(row, info["final_obs"], ended, f"{where}: the decoded last observation")
            outcome = {name: part[t] for name, part in outcomes.items()}
            expected = {name: info["final_info"][name] for name in outcome if name != "achieved"}
            _same(outcome, expected, ended, f"{where}: outcome")
            if self.tensor.achieves:
                has = info["final_info"]["has_achieved"] & ended
                counts["achieved"] += int(has.sum())
                self._achieved(stepped, info, has, where)
            if t + 1 < self.steps:
                options = dict(zip(names, ranks[t + 1], strict=True))
                observation, _ = self.batch.reset(options={**options, "reset_mask": ended})
        require(
            counts["ended"] > self.n,
            f"only {counts['ended']} episodes ended: check with more steps",
        )
        return counts

    def _dtypes(self, played: _Played, outcomes: Observation) -> None:
        """Tensors have the dtypes and shapes of the contract."""
        dtypes: dict[str, Any] = dict.fromkeys(self.tensor.situation, torch.int64)
        dtypes |= {"return": torch.float64, "length": torch.int64}
        if self.tensor.reports_success:
            dtypes["success"] = torch.bool
        if self.tensor.achieves:
            dtypes["has_achieved"] = torch.bool
        names = {*dtypes, *(["achieved"] if self.tensor.achieves else [])}
        require(outcomes.keys() == names, f"outcome has {list(outcomes)}, expected {list(names)}")
        first = played.stepped[0]
        given = {**first.outcome, **first._asdict()}
        dtypes |= {"reward": torch.float32, "terminated": torch.bool, "truncated": torch.bool}
        for name, dtype in dtypes.items():
            one = given[name]
            require(
                one.dtype == dtype and one.shape == (self.n,),
                f"{name} must be {dtype} {(self.n,)}, got {one.dtype} {tuple(one.shape)}",
            )

    def _ranks(
        self, outcomes: Observation, ends: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """The ranks of the episodes that every row is of, int64 [T, ranks, N], and bool [T, N]:
        whether they are known."""
        names = list(self.tensor.situation)
        ranks = np.zeros((self.steps, len(names), self.n), np.int64)
        known = np.zeros((self.steps, self.n), np.bool_)
        for t in reversed(range(self.steps)):
            if t + 1 < self.steps:
                ranks[t], known[t] = ranks[t + 1], known[t + 1]
            for row, name in enumerate(names):
                ranks[t, row, ends[t]] = outcomes[name][t, ends[t]]
            known[t] |= ends[t]
        return ranks, known

    def _goals(
        self, codes: Codes, observation: Observation, mask: NDArray[np.bool_], where: str
    ) -> None:
        """Goals of codes are those of observations: another env's is written to both."""
        if self.goal is None:
            return
        read = self.tensor.read_goal(codes)
        kept = {name: part.clone() for name, part in codes.items()}
        written = self.tensor.write_goal(codes, read.roll(1, 0))
        _same(_arrays(codes), _arrays(kept), mask, f"{where}: codes, after write_goal()")
        expected = {name: part.copy() for name, part in observation.items()}
        goals = np.roll(self.goal.read(observation), 1, axis=0)
        both = mask & np.roll(mask, 1)
        self.goal.write(expected, goals, both)
        given = _arrays(self.tensor.decode(written))
        _same(given, expected, both, f"{where}: the observation of codes with another goal")
        again = self.tensor.read_goal(written)
        require(torch.equal(again, read.roll(1, 0)), f"{where}: read_goal() after write_goal()")

    def _achieved(
        self, stepped: Stepped, info: dict[str, Any], has: NDArray[np.bool_], where: str
    ) -> None:
        """What was achieved, written to the last observation, makes it that of an episode which
        asked for it."""
        if self.goal is None:
            return
        expected = {name: part.copy() for name, part in info["final_obs"].items()}
        self.goal.write(expected, info["final_info"]["achieved"], has)
        written = self.tensor.write_goal(stepped.final, stepped.outcome["achieved"])
        given = _arrays(self.tensor.decode(written))
        _same(given, expected, has, f"{where}: the observation of codes with the goal achieved")

    def _symmetric(self, codes: Codes) -> tuple[NDArray[np.int64], Observation] | None:
        """Symmetries drawn for every row [T, N], and what is shown under them."""
        if self.symmetries is None:
            return None
        which = self.rng.integers(self.symmetries.count, size=(self.steps, self.n))
        return which, _arrays(self.tensor.decode(codes, self._to(which)))

    def _symmetries(
        self,
        symmetric: tuple[NDArray[np.int64], Observation] | None,
        t: int,
        observation: Observation,
        mask: NDArray[np.bool_],
    ) -> None:
        if self.symmetries is None or symmetric is None:
            return
        which, shown = symmetric
        expected = {name: part.copy() for name, part in observation.items()}
        self.symmetries(expected, which[t], np.ones(self.n, np.bool_))
        row = {name: part[t] for name, part in shown.items()}
        _same(row, expected, mask, f"step {t}: the observation under symmetries {which[t]}")

    def hashes(self, played: _Played) -> None:
        """Hashes are those of the bytes of decoded observations."""
        codes = _stacked(played.codes[:10])
        parts = {
            name: part.reshape(*part.shape[:2], -1).view(np.uint8).astype(np.uint64)
            for name, part in _arrays(self.tensor.decode(codes)).items()
        }
        weights = {
            name: self.rng.integers(2**64, size=part.shape[-1:], dtype=np.uint64)
            for name, part in parts.items()
        }
        hashed = self.tensor.hashes(
            {name: self._to(one.view(np.int64)) for name, one in weights.items()}
        )
        sums = sum((part * weights[name]).sum(-1, np.uint64) for name, part in parts.items())
        require_same(_array(hashed(codes)).view(np.uint64), sums, "hashes")
        with must_raise(ValueError, "hashes() with weights of another name"):
            self.tensor.hashes({"no such part": self._to(np.zeros(1, np.int64))})

    def state(self) -> None:
        """Stepping goes on bit for bit from a state."""
        tensor = self.tensor
        state = tensor.get_state()
        require(
            state.keys() == {*tensor.tensors(), "generator"},
            f"get_state() has {sorted(state)}, expected those of tensors() and 'generator'",
        )
        kept = {name: one.clone() for name, one in state.items()}
        actions = [self._actions() for _ in range(max(self.steps // 3, 1))]
        rest = self._steps(actions)
        _equal(state, kept, "a state, after its environment went on,")
        tensor.set_state(state)
        _equal(tensor.get_state(), kept, "get_state() after set_state()")
        addresses = {name: one.data_ptr() for name, one in tensor.tensors().items()}
        require(addresses == self.addresses, "set_state() must write in place")
        for t, (given, expected) in enumerate(zip(self._steps(actions), rest, strict=True)):
            _equal(given, expected, f"step {t} after set_state()")
        some = next(iter(tensor.tensors()))
        with must_raise(ValueError, "set_state() with a key too few"):
            tensor.set_state({name: one for name, one in state.items() if name != some})
        with must_raise(ValueError, "set_state() of more envs"):
            tensor.set_state({name: torch.cat([one, one]) for name, one in state.items()})

    def _steps(self, actions: list[NDArray[np.int64]]) -> list[Codes]:
        """What steps of these actions give: of the ranks and the first observations of the episodes
        that begin, too."""
        rows = []
        for action in actions:
            stepped = self.tensor.step(self._to(action))
            flat = {**stepped.outcome, **stepped.final, **self.tensor.observe()}
            rows.append({**flat, "reward": stepped.reward, "terminated": stepped.terminated})
        return rows


def _array(tensor: Tensor) -> NDArray[Any]:
    return tensor.cpu().numpy()


def _arrays(parts: Mapping[str, Tensor]) -> Observation:
    return {name: _array(part) for name, part in parts.items()}


def _stacked(rows: list[Codes]) -> Codes:
    return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}


def _same(given: Observation, expected: Observation, mask: NDArray[np.bool_], where: str) -> None:
    """Raises AssertionError where parts of the same names differ in the envs of `mask`, or in
    dtype. Parts that are not expected are not compared."""
    for name, part in expected.items():
        require(name in given, f"{where} lacks {name!r}")
        require(
            given[name].dtype == part.dtype,
            f"{where}, {name!r}, must be {part.dtype}, got {given[name].dtype}",
        )
        require_same(given[name][mask], part[mask], f"{where}, {name!r}, of envs {_rows(mask)},")


def _rows(mask: NDArray[np.bool_]) -> str:
    return "all" if mask.all() else str(np.flatnonzero(mask).tolist())


def _equal(given: Mapping[str, Tensor], expected: Mapping[str, Tensor], where: str) -> None:
    for name, tensor in expected.items():
        require(torch.equal(given[name], tensor), f"{where} differs: {name!r}")
