"""The self-check passes on the families' environments, and fails on broken ones."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from gridworld_rules import ByHand
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from zipf.envs import SingleEnv, ZipfVectorEnv, make, make_vec, pcg64
from zipf.envs.distributions import zipfian
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.testing import check_vector_env

SMALL = {"num_maps": 6, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 20}


@pytest.mark.parametrize("level", ["gridworld/zipf_2", "gridworld/uniform", "gridworld/rare"])
@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_gridworld_keeps_the_contract(level: str, observation: str) -> None:
    options = {"observation": observation}
    check_vector_env(partial(make_vec, level, **options), partial(ByHand, level, **options))


@pytest.mark.parametrize(
    "options",
    [
        SMALL,
        {"num_maps": 1, "num_objects": 1, "max_steps": 9},
        {"num_rooms": (1, 2), "room_size": (6, 4), "num_objects": 7},
        {"num_rooms": [5, 4], "room_size": [3, 5], "num_objects": 60, "num_maps": 3},
    ],
)
def test_other_sizes_keep_the_contract(options: dict[str, Any]) -> None:
    level, options = "gridworld/zipf_1", {"observation": "tiles", **options}
    check_vector_env(partial(make_vec, level, **options), partial(ByHand, level, **options))


class Bandit(ZipfVectorEnv):
    """Three tries to pull the arm that is lit."""

    dtype: Any = np.float32

    def __init__(self, num_envs: int, **options: Any) -> None:
        shown = spaces.Box(0, 1, (4,), self.dtype)
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict({"lights": shown}),
            single_action_space=spaces.Discrete(4),
            situation={"arm": 4},
            **options,
        )
        self.lights = np.eye(4, dtype=self.dtype)
        self.cdf = pcg64.cumulative(zipfian(4, 1.0))
        self.arms = np.zeros(num_envs, np.int64)

    def _begin(self, mask: Any, forced: Any) -> None:
        for i in np.flatnonzero(mask):
            drawn = pcg64.choice(self._streams[i], self.cdf)
            self.arms[i] = drawn if forced[0, i] < 0 else forced[0, i]

    def _advance(self, actions: Any, mask: Any) -> Any:
        success = actions == self.arms
        return success.astype(np.float64), success, ~success & (self._lengths >= 3), success

    def _observe(self, out: Any, mask: Any) -> None:
        out["lights"][mask] = self.lights[self.arms[mask]]

    def _situations(self) -> Any:
        return {"arm": self.arms.copy()}

    def _get_env_states(self) -> Any:
        return {"arms": self.arms}

    def _set_env_states(self, state: Any) -> None:
        self.arms[:] = state["arms"]


class IgnoredMask(Bandit):
    def _observe(self, out: Any, mask: Any) -> None:
        super()._observe(out, self._everywhere)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint8, np.int64, np.bool_])
def test_any_dtype_may_be_shown(kind: Any) -> None:
    class Shown(Bandit):
        dtype = kind

    check_vector_env(Shown, partial(SingleEnv, Shown), steps=60)


@pytest.mark.parametrize("kind", [np.float32, np.uint8, np.bool_])
def test_observing_more_worlds_than_asked_is_caught(kind: Any) -> None:
    class Shown(IgnoredMask):
        dtype = kind

    with pytest.raises(AssertionError, match=r"final_out.* of envs whose episode goes on"):
        check_vector_env(Shown, partial(SingleEnv, Shown), steps=60)


class Speaking(Bandit):
    """Says which arm is lit, as text and as a number."""

    words = np.array(["first", "second arm", "third", "the last one"])

    def _describe(self) -> Any:
        return {"instruction": self.words[self.arms], "half": self.arms // 2}


class Mumbling(Speaking):
    def __init__(self, num_envs: int, **options: Any) -> None:
        super().__init__(num_envs, **options)
        self.kept = np.zeros(num_envs, np.int64)

    def _describe(self) -> Any:
        self.kept[:] = self.arms
        return {"again": self.kept}


class Babbling(Speaking):
    def _describe(self) -> Any:
        return {"instruction": self.words[(self.arms + (self.num_envs == 1)) % 4]}


class Stammering(Speaking):
    def _describe(self) -> Any:
        return {"instruction": self.words}


class Boasting(Speaking):
    def reset(self, **options: Any) -> Any:
        observation, info = super().reset(**options)
        return observation, {**info, "success": self.arms >= 0}


def test_what_a_family_tells_about_an_episode_is_checked() -> None:
    check_vector_env(Speaking, partial(SingleEnv, Speaking), steps=60)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (Babbling, r"\['instruction'\]"),
        (Mumbling, r"final_info.*\['again'\]"),
        (Stammering, r"info\['instruction'\] must be an array \[N\], got shape \(4,\)"),
        (Boasting, r"info\['success'\] of a reset: the name has another meaning"),
    ],
)
def test_telling_wrong_things_about_an_episode_is_caught(broken: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_vector_env(broken, partial(SingleEnv, broken), steps=60)


class SharedSeed(GridworldVectorEnv):
    def _read_seeds(self, seed: Any) -> list[int | None]:
        return [seed if isinstance(seed, int) else None] * self.num_envs


class NewSituationInFinalInfo(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        result = super().step(actions, **buffers)
        if "final_info" in result[4]:
            result[4]["final_info"]["map"] = result[4]["map"]
        return result


class FinalObservationOfTheNextEpisode(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        result = super().step(actions, **buffers)
        if "final_obs" in result[4]:
            for key, value in result[4]["final_obs"].items():
                value[:] = result[0][key]
        return result


class MergedEnds(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        observation, reward, terminated, truncated, info = super().step(actions, **buffers)
        return observation, reward, terminated | truncated, np.zeros_like(truncated), info


class NarrowReward(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        observation, reward, *rest = super().step(actions, **buffers)
        return observation, reward.astype(np.float32), *rest


class ReusedReward(GridworldVectorEnv):
    kept = np.zeros(5)

    def step(self, actions: Any, **buffers: Any) -> Any:
        observation, reward, *rest = super().step(actions, **buffers)
        self.kept[:] = reward
        return observation, self.kept, *rest


class IgnoredOut(GridworldVectorEnv):
    def step(self, actions: Any, *, out: Any = None, final_out: Any = None) -> Any:
        return super().step(actions, final_out=final_out)


class IgnoredCopy(GridworldVectorEnv):
    def _writable(self, out: Any, name: str) -> Any:
        if out is None:
            return self._buffers.setdefault(name, self.allocate())
        return super()._writable(out, name)


class MaskResetsAll(GridworldVectorEnv):
    def _begin(self, mask: Any, forced: Any) -> None:
        disabled = self.autoreset_mode is AutoresetMode.DISABLED
        super()._begin(self._everywhere if disabled else mask, forced)


class ForgottenStreams(GridworldVectorEnv):
    def set_state(self, state: Any) -> None:
        super().set_state({**state, "streams": self.get_state()["streams"]})


class ForgottenEnds(GridworldVectorEnv):
    """Takes episodes that wait for their reset for running ones."""

    def set_state(self, state: Any) -> Any:
        return super().set_state({**state, "running": state["seeded"]})


class UnpicklableEnds(GridworldVectorEnv):
    """Fails where an episode waits for its reset."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        assert self._running.all(), "unpickled an episode that has ended"


class ForgottenLengths(GridworldVectorEnv):
    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_lengths": np.zeros_like(self._lengths)}


class IgnoredOptions(GridworldVectorEnv):
    def _read_options(self, options: Any) -> Any:
        return super()._read_options(options)[0], self._unforced


class ForcingSkipsDraws(GridworldVectorEnv):
    def _begin(self, mask: Any, forced: Any) -> None:
        before = self._streams.copy()
        super()._begin(mask, forced)
        if (forced >= 0).any():
            self._streams[:] = before


class AcceptedActions(GridworldVectorEnv):
    def _read_actions(self, actions: Any, mask: Any) -> Any:
        return np.resize(np.asarray(actions), self.num_envs).astype(np.int64) % 8


class WrongActions(GridworldVectorEnv):
    def _read_actions(self, actions: Any, mask: Any) -> Any:
        return super()._read_actions(actions, mask)[::-1].copy()


class SteppedWhenOver(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        if self.autoreset_mode is AutoresetMode.DISABLED:
            self._all_running = bool(self._seeded.all())
        return super().step(actions, **buffers)


class StepsTheNewEpisode(GridworldVectorEnv):
    def _advance(self, actions: Any, mask: Any) -> Any:
        return super()._advance(actions, self._everywhere)


class ResetOnceMore(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        result = super().step(actions, **buffers)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and (result[2] | result[3]).any():
            self._begin(result[2] | result[3], self._unforced)
        return result


class SteppedWhenClosed(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        self.closed = False
        return super().step(actions, **buffers)


class SharedState(GridworldVectorEnv):
    def get_state(self) -> Any:
        return {**super().get_state(), "worlds": self._envs}


class LengthOffByOne(GridworldVectorEnv):
    def step(self, actions: Any, **buffers: Any) -> Any:
        result = super().step(actions, **buffers)
        if "final_info" in result[4]:
            result[4]["final_info"]["length"] -= 1
        return result


BROKEN = [
    (SharedSeed, "reset.seed=0. differs"),
    (NewSituationInFinalInfo, "final_info of env"),
    (FinalObservationOfTheNextEpisode, "final_obs of env"),
    (MergedEnds, "reward and ends differs"),
    (NarrowReward, "reward must be float64"),
    (ReusedReward, "overwrites what an earlier step returned, with copy=True"),
    (IgnoredOut, "must return out"),
    (IgnoredCopy, "overwrites what an earlier step returned, with copy=True"),
    (MaskResetsAll, "reset of envs"),
    (ForgottenStreams, "after set_state"),
    (ForgottenEnds, r"after set_state \(NEXT_STEP\)"),
    (UnpicklableEnds, "unpickled an episode that has ended"),
    (ForgottenLengths, "after pickling"),
    (IgnoredOptions, "options="),
    (ForcingSkipsDraws, "episode after a forced one"),
    (AcceptedActions, "negative action must raise ValueError, and was accepted"),
    (WrongActions, "step .* differs"),
    (SteppedWhenOver, "episode has ended must raise ResetNeeded, and was accepted"),
    (StepsTheNewEpisode, r"step .* \(NEXT_STEP\): observation and info"),
    (ResetOnceMore, r"step .* \(NEXT_STEP\): observation and info"),
    (SteppedWhenClosed, r"after close\(\) must raise ClosedEnvironmentError, and was accepted"),
    (SharedState, "after its environment went on"),
    (LengthOffByOne, "final_info of env"),
]


@pytest.mark.parametrize(("broken", "message"), BROKEN, ids=[one[0].__name__ for one in BROKEN])
def test_broken_environments_are_caught(broken: type[GridworldVectorEnv], message: str) -> None:
    level, options = "uniform", {"observation": "tiles", **SMALL}
    with pytest.raises(AssertionError, match=message):
        check_vector_env(
            lambda n, **kwargs: broken(n, level, **options, **kwargs),
            partial(make, f"gridworld/{level}", **options),
        )


def test_too_few_steps_to_tell_are_noticed() -> None:
    level = "gridworld/zipf_2"
    with pytest.raises(AssertionError, match="check with more steps"):
        check_vector_env(partial(make_vec, level), partial(make, level), steps=2)


class Endless(Bandit):
    """Pays for the lit arm; an episode is neither a success nor a failure."""

    reports_success = False

    def _advance(self, actions: Any, mask: Any) -> Any:
        reward, _, _, success = super()._advance(actions, mask)
        return reward, np.zeros_like(success), self._lengths >= 3, success


class Succeeding(Endless):
    def step(self, actions: Any, **buffers: Any) -> Any:
        result = super().step(actions, **buffers)
        if "final_info" in result[4]:
            result[4]["final_info"]["success"] = result[2]
        return result


def test_a_family_may_report_no_success() -> None:
    check_vector_env(Endless, partial(SingleEnv, Endless), steps=60)
    with pytest.raises(AssertionError, match=r"final_info of env .* differs: keys"):
        check_vector_env(Succeeding, partial(SingleEnv, Endless), steps=60)


@pytest.mark.parametrize("space", [spaces.Discrete(3, start=1), spaces.Box(-1, 1, (2,))])
def test_other_action_spaces_are_refused(space: Any) -> None:
    class Other(Bandit):
        def __init__(self) -> None:
            ZipfVectorEnv.__init__(
                self,
                2,
                single_observation_space=spaces.Dict(),
                single_action_space=space,
                situation={},
            )

    with pytest.raises(ValueError, match="must be a Discrete space that starts at 0, got "):
        Other()
