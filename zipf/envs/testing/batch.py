"""A self-check of batched environments: N envs of a batch against N single envs.

    from functools import partial
    from zipf.envs import make, make_vec
    from zipf.envs.testing import check_vector_env

    level = "gridworld/zipf_2"
    check_vector_env(partial(make_vec, level), partial(make, level))

It works for any family: it uses the interface of `ZipfVectorEnv` only.
"""

import io
import math
import pickle
from collections.abc import Callable, Iterator
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from zipf.envs.testing.steps import (
    are_equal,
    arrays_in,
    copied,
    first_step,
    must_raise,
    require,
    require_dtype,
    require_same,
    row_of,
    stacked,
    visible,
)
from zipf.envs.vector import RESERVED, Observation, ZipfVectorEnv

MakeVec = Callable[..., ZipfVectorEnv]
MakeSingle = Callable[[], gym.Env]

_OUTCOME = {"return": np.float64, "length": np.int64}
_SUCCESS = {"success": np.bool_}


def check_vector_env(
    make_vec: MakeVec,
    make_single: MakeSingle,
    *,
    num_envs: int = 5,
    steps: int = 300,
    seed: int = 0,
) -> None:
    """Checks a batched environment against single ones and against the contract.

    Args:
        make_vec: `make_vec(num_envs, **kwargs)` makes the batch; it is given `autoreset_mode` and
            `copy` at times.
        make_single: makes one env of the same level.
        num_envs: size of the batch, at least 2.
        steps: random actions per rollout; enough for several episodes to end.
        seed: of the envs and of the actions.

    Raises:
        AssertionError: saying what is wrong and where.
    """
    require(num_envs >= 2, "check at least two envs: one cannot show that envs differ")
    check = _Check(make_vec, make_single, num_envs, steps, seed)
    check.spaces()
    modes = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED
    for mode in modes:
        check.against_singles(mode)
    check.determinism()
    check.buffers()
    for mode in modes:
        check.state(mode)
        check.pickling(mode)
    check.forcing()
    check.errors()


class _Check:
    def __init__(
        self, make_vec: MakeVec, make_single: MakeSingle, num_envs: int, steps: int, seed: int
    ) -> None:
        self.make_vec = make_vec
        self.make_single = make_single
        self.n = num_envs
        self.seed = seed
        env = make_vec(num_envs)
        rng = np.random.default_rng(seed)
        self.actions = rng.integers(env.single_action_space.n, size=(steps, num_envs))
        self.outcome: dict[str, type] = {**_OUTCOME, **(_SUCCESS if env.reports_success else {})}
        env.close()

    def spaces(self) -> None:
        """Spaces are those of the single env, batched, and contain what is returned."""
        env, single = self.make_vec(self.n), self.make_single()
        require_same(env.num_envs, self.n, "num_envs")
        require_same(
            env.single_observation_space, single.observation_space, "single_observation_space"
        )
        require_same(env.single_action_space, single.action_space, "single_action_space")
        for name in ("observation", "action"):
            batched = batch_space(getattr(env, f"single_{name}_space"), self.n)
            require_same(getattr(env, f"{name}_space"), batched, f"{name}_space")
        require_same(env.situation, single.get_wrapper_attr("situation"), "situation")
        require_same(
            env.metadata["autoreset_mode"], AutoresetMode.SAME_STEP, "default autoreset_mode"
        )
        require_same(env.autoreset_mode, AutoresetMode.SAME_STEP, "attribute autoreset_mode")

        observation, info = env.reset(seed=self.seed)
        self._contained(env, observation, info, "reset")
        for name in info.keys() - env.situation.keys():
            taken = name.startswith("_") or name in RESERVED
            require(not taken, f"info[{name!r}] of a reset: the name has another meaning")
            shape = np.shape(info[name])
            require(shape == (self.n,), f"info[{name!r}] must be an array [N], got shape {shape}")
        for t, actions in enumerate(self.actions):
            observation, reward, terminated, truncated, info = env.step(actions)
            where = f"step {t}"
            self._contained(env, observation, info, where)
            require_dtype(reward, np.float64, (self.n,), f"{where}: reward")
            require_dtype(terminated, np.bool_, (self.n,), f"{where}: terminated")
            require_dtype(truncated, np.bool_, (self.n,), f"{where}: truncated")
            if "_final_info" in info:
                final = info["final_info"]
                for name in env.situation:
                    require_dtype(
                        final[name], np.int64, (self.n,), f"{where}: final_info[{name!r}]"
                    )
                for name, dtype in self.outcome.items():
                    require_dtype(final[name], dtype, (self.n,), f"{where}: final_info[{name!r}]")
                for key, like in env.allocate().items():
                    array = info["final_obs"][key]
                    require_dtype(array, like.dtype, like.shape, f"{where}: final_obs[{key!r}]")
        env.close()

    def _contained(
        self, env: ZipfVectorEnv, observation: Observation, info: dict[str, Any], where: str
    ) -> None:
        require(
            observation in env.observation_space,
            f"{where}: the observation is not in the observation space: "
            + str({key: (value.dtype, value.shape) for key, value in observation.items()}),
        )
        for name, size in env.situation.items():
            require(name in info, f"{where}: info lacks the rank {name!r}")
            require_dtype(info[name], np.int64, (self.n,), f"{where}: info[{name!r}]")
            require(
                ((info[name] >= 0) & (info[name] < size)).all(),
                f"{where}: info[{name!r}] must be in 0 .. {size - 1}, got {info[name]}",
            )

    def against_singles(self, mode: AutoresetMode) -> None:
        """A batch equals N single environments: each reset when its episode ends (SAME_STEP), or in
        the step after (NEXT_STEP), or by a mask, at which some have waited (DISABLED)."""
        env = self.make_vec(self.n, autoreset_mode=mode)
        require_same(env.metadata["autoreset_mode"], mode, "autoreset_mode")
        singles = self._singles()
        observation, info = env.reset(seed=self.seed)
        starts = [single.reset(seed=self.seed + i) for i, single in enumerate(singles)]
        require_same((observation, info), stacked(starts), f"reset(seed={self.seed})")
        reported = set(info)
        begins = done = np.zeros(self.n, np.bool_)  # those that the next step resets
        ended = 0
        for t, actions in enumerate(self.actions):
            where = f"step {t} ({mode.name})"
            # Actions of those that begin an episode are ignored, even one out of range.
            given = env.step(np.where(begins, -1, actions))
            results = [
                first_step(single.reset()) if begins[i] else single.step(actions[i])
                for i, single in enumerate(singles)
            ]
            done = np.array([result[2] or result[3] for result in results])
            ended += done.sum()
            ends = stacked([result[1:4] for result in results])
            require_same(given[1:4], ends, f"{where}: reward and ends")
            current = [(r[0], {name: r[4][name] for name in reported}) for r in results]
            self._compare_ends(given[4], results, done, reported, mode, where)
            if mode is AutoresetMode.SAME_STEP:
                for i in np.flatnonzero(done):
                    current[i] = singles[i].reset()
            now = given[0], {name: given[4][name] for name in reported}
            require_same(now, stacked(current), f"{where}: observation and info")
            if mode is AutoresetMode.DISABLED and done.any() and ended == done.sum():
                with must_raise(ResetNeeded, f"{where}: stepping an env whose episode has ended"):
                    env.step(actions)
            begins = done & (mode is AutoresetMode.NEXT_STEP)
            # Now and then one whose episode is running or has just ended is reset, too.
            mask = done & (mode is AutoresetMode.DISABLED)
            if mask.any() or (mode is AutoresetMode.NEXT_STEP and t % 7 == 0):
                mask[t % self.n] = True
                for i in np.flatnonzero(mask):
                    current[i] = singles[i].reset()
                now = env.reset(options={"reset_mask": mask})
                require_same(now, stacked(current), f"{where}: reset of envs {mask}")
                begins &= ~mask
        if mode is not AutoresetMode.NEXT_STEP:
            enough = self.n if mode is AutoresetMode.SAME_STEP else 0
            require(ended > enough, f"only {ended} episodes ended: check with more steps")
        _close(env, *singles)

    def _compare_ends(
        self,
        info: dict[str, Any],
        results: list[Any],
        done: NDArray[np.bool_],
        reported: set[str],
        mode: AutoresetMode,
        where: str,
    ) -> None:
        """Compares what a step says of the episodes that it has ended, those of `done`."""
        if mode is AutoresetMode.SAME_STEP:
            names = ["final_info", "final_obs"]
            last = [{"final_obs": result[0], "final_info": result[4]} for result in results]
        else:
            names = list(self.outcome)
            last = [result[4] for result in results]
        keys = {*names, *(f"_{name}" for name in names)} if done.any() else set()
        require_same(set(info), reported | keys, f"{where}: keys of info")
        for name in names if done.any() else ():
            require_same(info[f"_{name}"], done, f"{where}: info['_{name}']")
            for i in np.flatnonzero(done):
                require_same(
                    row_of(info[name], int(i)), last[i][name], f"{where}: {name} of env {i}"
                )

    def _singles(self) -> list[gym.Env]:
        return [self.make_single() for _ in range(self.n)]

    def determinism(self) -> None:
        """The seed determines everything, however it is given; envs do not affect each other."""
        env = self.make_vec(self.n)
        first = self._rollout(env, self.seed)
        require_same(self._rollout(env, self.seed), first, "a second rollout from the same seed")
        seeds = [self.seed + i for i in range(self.n)]
        require_same(self._rollout(env, seeds), first, "a rollout from a list of the same seeds")
        if math.prod(env.situation.values()) > 1:
            self._envs_differ(env, first)
        env.close()

    def _envs_differ(self, env: ZipfVectorEnv, first: list[Any]) -> None:
        other = self._rollout(env, self.seed + self.n)
        require(not are_equal(other, first), "rollouts from different seeds are the same")
        seeds = [self.seed + i for i in range(self.n)]
        starts = [[env.reset(seed=seed)[1]] + [env.reset()[1] for _ in range(20)] for seed in seeds]
        each = [[{k: v[0] for k, v in info.items()} for info in infos] for infos in starts]
        require(
            any(not are_equal(each[0], one) for one in each[1:]),
            "envs of different seeds draw the same episodes",
        )
        require(
            any(not are_equal(each[0][0], start) for start in each[0][1:]),
            "reset() without a seed repeats the same episode",
        )

    def buffers(self) -> None:
        """`out` and `final_out` receive what a step without them returns; `copy` is respected."""
        env = self.make_vec(self.n)
        expected = self._rollout(env, self.seed)
        out, final_out, other = (_filled(env) for _ in range(3))
        observation, info = env.reset(seed=self.seed, out=out)
        require(observation is out, "reset(out=...) must return out")
        require_same((copied(out), info), expected[0], "reset(out=...)")
        for t, actions in enumerate(self.actions):
            where = f"step {t} with out and final_out"
            # Two values in turn: an observation may equal one of them, or be of bools.
            for array in final_out.values():
                array.fill(123 * (t % 2))
            untouched = copied(final_out)
            given = env.step(actions, out=out, final_out=final_out)
            require(given[0] is out, f"{where}: step must return out")
            if "final_obs" in given[4]:
                require(given[4]["final_obs"] is final_out, f"{where}: final_obs must be final_out")
            require_same(visible(given), expected[1 + t], where)
            running = ~given[4].get("_final_obs", np.zeros(self.n, dtype=np.bool_))
            for key, array in final_out.items():
                require_same(
                    array[running],
                    untouched[key][running],
                    f"{where}: final_out[{key!r}] of envs whose episode goes on",
                )
        env.reset(seed=self.seed)
        for t, actions in enumerate(self.actions):
            given = env.step(actions, out=out)
            require(
                "final_obs" not in given[4],
                f"step {t}: with out and without final_out, final_obs must be left out",
            )
            baseline = {k: v for k, v in expected[1 + t][4].items() if "final_obs" not in k}
            require_same(given[:4], expected[1 + t][:4], f"step {t} with out alone")
            require_same(visible(given)[4], baseline, f"info of step {t} with out alone")
        require_same(env.observations(out=other), out, "observations(out=...)")
        require_same(env.observations(), out, "observations()")

        before = env.get_state()
        for name, bad in _bad_buffers(env):
            with must_raise(ValueError, f"step(out=...) with {name}"):
                env.step(self.actions[0], out=bad)
            with must_raise(ValueError, f"reset(out=...) with {name}"):
                env.reset(out=bad)
        require_same(env.get_state(), before, "the state after refused buffers")

        self._fresh(env, "copy=True", lambda step: step)
        env.close()
        env = self.make_vec(self.n, copy=False)
        require_same(self._rollout(env, self.seed), expected, "a rollout with copy=False")
        first, second = env.step(self.actions[0])[0], env.step(self.actions[1])[0]
        for key in first:
            require(first[key] is second[key], f"copy=False must reuse observation {key!r}")
        self._fresh(env, "copy=False", lambda step: [*step[1:4], step[4].get("final_info", {})])
        env.close()

    def _fresh(self, env: ZipfVectorEnv, how: str, part: Callable[[Any], Any]) -> None:
        """That part of what a step returns is not overwritten by later steps."""
        env.reset(seed=self.seed)
        before: list[NDArray[Any]] = []
        for t, actions in enumerate(self.actions):
            now = list(arrays_in(part(env.step(actions))))
            shared = any(np.may_share_memory(one, other) for one in before for other in now)
            require(not shared, f"step {t} overwrites what an earlier step returned, with {how}")
            before = now

    def state(self, mode: AutoresetMode) -> None:
        """Stepping goes on bit for bit from a state, here and in another environment."""
        env, other = (self.make_vec(self.n, autoreset_mode=mode) for _ in range(2))
        rest_of = self._play_to_an_end(env)
        observation = env.observations()
        state = env.get_state()
        where = f"({mode.name})"
        for key, value in state.items():
            require(
                isinstance(value, np.ndarray) and value.dtype.kind in "biuf",
                f"get_state()[{key!r}] must be a numeric array, got {type(value)}",
            )
        kept = copied(state)
        rest = rest_of(env)
        require_same(state, kept, f"a state, after its environment went on, {where}")
        env.set_state(state)
        require_same(env.observations(), observation, f"observations() after set_state {where}")
        require_same(rest_of(env), rest, f"steps after set_state {where}")
        other.set_state(state)
        require_same(rest_of(other), rest, f"steps after set_state in another environment {where}")
        require_same(state, kept, f"a state, after the environment it was set in went on, {where}")
        with must_raise(ValueError, "set_state with a key too few"):
            env.set_state(dict(list(state.items())[1:]))
        with must_raise(ValueError, "set_state of more envs"):
            env.set_state({key: np.concatenate([value] * 2) for key, value in state.items()})
        _close(env, other)

    def pickling(self, mode: AutoresetMode) -> None:
        """A pickled environment continues in the same state."""
        env = self.make_vec(self.n, autoreset_mode=mode, copy=False)
        rest_of = self._play_to_an_end(env)
        other = _pickled(env)
        where = f"after pickling ({mode.name})"
        require_same(other.observations(), env.observations(), f"observations() {where}")
        require_same(rest_of(other), rest_of(env), f"steps {where}")
        _close(env, other)

    def _play_to_an_end(self, env: ZipfVectorEnv) -> Callable[[ZipfVectorEnv], list[Any]]:
        """Plays up to half of the steps, if possible to the end of an episode, where in some modes
        envs wait for their reset.

        Returns what goes on from there in an environment, half of the steps, and returns what they
        returned.
        """
        env.reset(seed=self.seed)
        quarter = len(self.actions) // 4
        t = 0
        none = ended = np.zeros(self.n, np.bool_)
        for t, (_, ended) in enumerate(self._played(env, self.actions[: 2 * quarter], none), 1):
            if t > quarter and ended.any():
                break
        rest = self.actions[t : t + 2 * quarter]
        return lambda env: [step for step, _ in self._played(env, rest, ended)]

    def _played(
        self, env: ZipfVectorEnv, actions: NDArray[np.int64], ended: NDArray[np.bool_]
    ) -> Iterator[tuple[Any, NDArray[np.bool_]]]:
        """Takes these actions; yields what each step returned, and which episodes it has ended.

        Envs that have ended, at first those of `ended`, are reset if they are not by themselves.
        """
        for these in actions:
            if env.autoreset_mode is AutoresetMode.DISABLED and ended.any():
                env.reset(options={"reset_mask": ended})
            step = env.step(these)
            ended = step[2] | step[3]
            yield visible(step), ended

    def forcing(self) -> None:
        """`reset(options=...)` forces a situation, as it does in a single env."""
        env = self.make_vec(self.n, autoreset_mode=AutoresetMode.DISABLED)
        single = self.make_single()
        for name, size in env.situation.items():
            for rank in (0, size - 1):
                given = env.reset(seed=self.seed, options={name: rank})
                require_same(given[1][name], np.full(self.n, rank), f"options={{{name!r}: {rank}}}")
                alone = single.reset(seed=self.seed, options={name: rank})
                require_same(
                    row_of(given, 0), alone, f"options={{{name!r}: {rank}}} in a single env"
                )
            ranks = np.arange(self.n) % size
            require_same(
                env.reset(options={name: ranks})[1][name], ranks, f"options={{{name!r}: array}}"
            )
            mask = np.arange(self.n) == self.n - 1
            given = env.reset(options={name: 0, "reset_mask": mask})
            expected = np.where(mask, 0, ranks)
            require_same(given[1][name], expected, f"options={{{name!r}: 0}} with a reset_mask")
            before = env.get_state()
            for bad in (-1, size, 0.5, np.zeros(self.n + 1, dtype=np.int64)):
                with must_raise(ValueError, f"reset(options={{{name!r}: {bad}}})"):
                    env.reset(options={name: bad})
            require_same(env.get_state(), before, "the state after refused options")
        everything = {name: size - 1 for name, size in env.situation.items()}
        given = env.reset(seed=self.seed, options=everything)
        alone = single.reset(seed=self.seed, options=everything)
        require_same(row_of(given, 0), alone, f"options={everything} in a single env")
        given, alone = env.reset(), single.reset()
        require_same(row_of(given, 0), alone, "the episode after a forced one")
        with must_raise(ValueError, "an unknown reset option"):
            env.reset(options={"no_such_option": 0})
        for mask in (np.ones(self.n + 1, dtype=np.bool_), np.ones(self.n, dtype=np.int64)):
            with must_raise(ValueError, f"a reset_mask {mask.dtype} {mask.shape}"):
                env.reset(options={"reset_mask": mask})
        _close(env, single)

    def errors(self) -> None:
        """Wrong calls raise errors and change nothing."""
        env = self.make_vec(self.n)
        with must_raise(ResetNeeded, "step() before reset()"):
            env.step(self.actions[0])
        env.reset(seed=self.seed)
        before = env.get_state()
        num_actions = int(env.single_action_space.n)
        for name, bad in {
            "a negative action": np.where(np.arange(self.n) == 0, -1, 0),
            "an action too high": np.where(np.arange(self.n) == 0, num_actions, 0),
            "an action too few": np.zeros(self.n - 1, dtype=np.int64),
            "a column of actions": np.zeros((self.n, 1), dtype=np.int64),
            "fractional actions": np.zeros(self.n),
        }.items():
            with must_raise(ValueError, f"step() with {name}"):
                env.step(bad)
        for seed in ([self.seed] * (self.n + 1), -1):
            with must_raise(ValueError, f"reset(seed={seed})"):
                env.reset(seed=seed)
        require_same(env.get_state(), before, "the state after refused actions and seeds")
        narrow = self.actions[0].astype(np.int32)
        require_same(visible(env.step(narrow)), self._rollout(env, self.seed)[1], "int32 actions")
        env.close()
        with must_raise(ClosedEnvironmentError, "step() after close()"):
            env.step(self.actions[0])
        with must_raise(ClosedEnvironmentError, "reset() after close()"):
            env.reset()
        with must_raise(ValueError, "a batch of no envs"):
            self.make_vec(0)
        with must_raise(ValueError, "an unknown autoreset_mode"):
            self.make_vec(self.n, autoreset_mode="no such mode")

    def _rollout(self, env: ZipfVectorEnv, seed: int | list[int]) -> list[Any]:
        """Copies of what reset and every step returned, zero where the masks are not set."""
        steps = (visible(env.step(actions)) for actions in self.actions)
        return [copied(env.reset(seed=seed)), *steps]


def _filled(env: ZipfVectorEnv) -> Observation:
    """Buffers filled with a value that no observation is likely to have everywhere."""
    buffers = env.allocate()
    for array in buffers.values():
        array.fill(123)
    return buffers


def _bad_buffers(env: ZipfVectorEnv) -> Iterator[tuple[str, Observation]]:
    good = _filled(env)
    key = next(iter(good))
    array = good[key]
    yield "a missing key", {k: v for k, v in good.items() if k != key}
    yield "an extra key", {**good, "no_such_key": array}
    yield "an env too few", {**good, key: array[1:]}
    other = np.float64 if array.dtype == np.float32 else np.float32
    yield "another dtype", {**good, key: array.astype(other)}
    yield "an array that is not contiguous", {**good, key: array.repeat(2, axis=-1)[..., ::2]}
    read_only = array.copy()
    read_only.flags.writeable = False
    yield "a read-only array", {**good, key: read_only}


def _pickled(env: ZipfVectorEnv) -> ZipfVectorEnv:
    """A copy by pickle, whose classes may be local to a function, where pickle does not look."""
    classes: list[type] = []

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: Any) -> int | None:
            if not isinstance(value, type):
                return None
            classes.append(value)
            return len(classes) - 1

    class Unpickler(pickle.Unpickler):
        def persistent_load(self, pid: int) -> type:
            return classes[pid]

    stream = io.BytesIO()
    Pickler(stream).dump(env)
    stream.seek(0)
    return cast(ZipfVectorEnv, Unpickler(stream).load())


def _close(*envs: gym.Env | ZipfVectorEnv) -> None:
    for env in envs:
        env.close()
