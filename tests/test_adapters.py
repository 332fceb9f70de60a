"""Our batches in other libraries' classes: the same envs, and nothing they tell is lost."""

import importlib
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers
from numpy.typing import NDArray

from zipf.envs import Mixture, ZipfVectorEnv, make, make_vec
from zipf.envs.gridworld.vector import GridworldVectorEnv

LEVEL = "gridworld/zipf_2"
SMALL: dict[str, Any] = {"num_maps": 5, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 12}
ENVS = 6


def batch(autoreset_mode: str = "SameStep", **options: Any) -> ZipfVectorEnv:
    return make_vec(LEVEL, ENVS, autoreset_mode=autoreset_mode, **{**SMALL, **options})


def episodes_of(env: ZipfVectorEnv, actions: NDArray[np.int64]) -> list[dict[str, Any]]:
    """What the batch itself tells about every episode that ends, with its step and env."""
    env.reset(seed=0)
    ended = []
    for step, action in enumerate(actions):
        *_, info = env.step(action)
        for i in np.flatnonzero(info.get("_final_info", [])):
            told = {name: value[i].item() for name, value in info["final_info"].items()}
            ended.append({"step": step, "world": int(i), **told})
    return ended


@pytest.fixture
def actions() -> NDArray[np.int64]:
    return np.random.default_rng(0).integers(8, size=(80, ENVS))


# Stable-Baselines3


def sb3_env(env: ZipfVectorEnv) -> Any:
    pytest.importorskip("stable_baselines3")
    from zipf.adapters.stable_baselines3 import ZipfVecEnv

    return ZipfVecEnv(env)


def test_sb3_sees_what_the_batch_shows(actions):
    env, baseline = sb3_env(batch()), batch()
    env.seed(3)
    given, (expected, info) = env.reset(), baseline.reset(seed=3)
    for action in actions:
        np.testing.assert_array_equal(given["image"], expected["image"])
        for i in range(ENVS):
            assert env.reset_infos[i] == {"map": info["map"][i], "target": info["target"][i]}
        given, rewards, dones, infos = env.step(action)
        expected, reward, terminated, truncated, info = baseline.step(action)
        np.testing.assert_array_equal(rewards, reward)
        np.testing.assert_array_equal(dones, terminated | truncated)
        assert rewards.dtype == np.float32
        for i in range(ENVS):
            if not dones[i]:
                assert infos[i] == {}
                continue
            final = infos[i]["terminal_observation"]["image"]
            np.testing.assert_array_equal(final, info["final_obs"]["image"][i])
            assert infos[i]["TimeLimit.truncated"] == (truncated[i] and not terminated[i])


def test_sb3_is_told_how_episodes_ended(actions):
    env = sb3_env(batch())
    env.seed(0)
    env.reset()
    ended = []
    for step, action in enumerate(actions):
        *_, infos = env.step(action)
        for i, info in enumerate(infos):
            if info:
                outcome = {
                    "success": info["is_success"],
                    "return": info["episode"]["r"],
                    "length": info["episode"]["l"],
                }
                ranks = {"map": info["map"], "target": info["target"]}
                ended.append({"step": step, "world": i, **ranks, **outcome})
    assert ended == episodes_of(batch(), actions)
    assert {one["success"] for one in ended} == {True, False}


def test_sb3_statistics_are_those_of_its_own_monitor(actions):
    env = sb3_env(batch())
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor

    assert env.env_is_wrapped(Monitor) == [True] * ENVS
    assert env.env_is_wrapped(VecMonitor, indices=[0, 2]) == [False] * 2
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        monitored = VecMonitor(VecCheckNan(sb3_env(batch()), raise_exception=True))
    for one in (env, monitored):
        one.seed(0)
        one.reset()
    ended = 0
    for action in actions:
        for own, theirs in zip(env.step(action)[3], monitored.step(action)[3], strict=True):
            assert ("episode" in own) == ("episode" in theirs)
            if "episode" in own:
                ended += 1
                assert own["episode"]["r"] == theirs["episode"]["r"]
                assert own["episode"]["l"] == theirs["episode"]["l"]
    assert ended > 20


def test_sb3_trains_on_a_batch():
    env = sb3_env(batch())
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy

    model = PPO("MultiInputPolicy", env, n_steps=16, batch_size=48, n_epochs=1, seed=0)
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(2 * 16 * ENVS)
    assert any(
        not torch.equal(old, new)
        for old, new in zip(before, model.policy.parameters(), strict=True)
    )
    assert len(model.ep_info_buffer) == len(model.ep_success_buffer) > 0
    mean, _ = evaluate_policy(model, env, n_eval_episodes=12)
    assert 0 <= mean <= 1


def test_sb3_forces_situations_and_draws_frames():
    env = sb3_env(batch(render_mode="rgb_array"))
    env.set_options({"map": 2})
    env.reset()
    assert [info["map"] for info in env.reset_infos] == [2] * ENVS
    env.set_options([{"target": i % 5} for i in range(ENVS)])
    env.reset()
    assert [info["target"] for info in env.reset_infos] == [0, 1, 2, 3, 4, 0]
    env.set_options([{"target": 1}] + [{}] * (ENVS - 1))
    with pytest.raises(ValueError, match="same ranks in every env"):
        env.reset()
    assert env.render().ndim == 3
    assert len(env.get_images()) == ENVS
    assert sb3_env(batch()).get_images() == [None] * ENVS


def test_sb3_asks_for_attributes():
    env = sb3_env(batch())
    assert env.get_attr("num_envs", indices=[0, 1]) == [ENVS] * 2
    assert env.has_attr("situation")
    assert not env.has_attr("nothing")
    with pytest.raises(NotImplementedError, match="action_masks"):
        env.env_method("action_masks")
    with pytest.raises(NotImplementedError, match="level"):
        env.set_attr("level", 3)


def test_sb3_has_a_name_for_each_part():
    from zipf.adapters import stable_baselines3

    space = spaces.Dict({"keys": spaces.Discrete(2), "a.b": spaces.Discrete(2)})
    assert stable_baselines3._names(space) == {"keys": "keys_", "a.b": "a_b"}
    with pytest.raises(ValueError, match="two observations would be called the same"):
        stable_baselines3._names(spaces.Dict({**space, "keys_": spaces.Discrete(2)}))


def test_sb3_needs_batches_that_start_over_in_the_same_step():
    with pytest.raises(ValueError, match=r"SAME_STEP .* got DISABLED"):
        sb3_env(batch("Disabled"))


@pytest.mark.parametrize(
    ("adapter", "library", "extra"),
    [("stable_baselines3", "stable_baselines3", "sb3"), ("onnx", "onnxruntime", "onnx")],
)
def test_without_its_library_an_adapter_says_what_to_install(adapter, library, extra, monkeypatch):
    for name in list(sys.modules):
        if name.startswith((library, f"zipf.adapters.{adapter}")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"pip install '\.\[{extra}\]'"):
        importlib.import_module(f"zipf.adapters.{adapter}")


class Quiet(GridworldVectorEnv):
    """Envs whose episodes neither succeed nor fail."""

    reports_success = False


def mixture(autoreset_mode: str) -> Mixture:
    levels = {name: partial(make_vec, f"gridworld/{name}") for name in ("zipf_2", "uniform")}
    return Mixture(levels, ENVS, draw="resets", exponent=1, autoreset_mode=autoreset_mode, **SMALL)


def test_sb3_is_told_of_levels_that_are_drawn(actions):
    env = sb3_env(mixture("SameStep"))
    env.reset()
    assert {info["level_name"] for info in env.reset_infos} <= {"zipf_2", "uniform"}
    ended = [info for action in actions for info in env.step(action)[3] if info]
    assert {info["level"] for info in ended} == {0, 1}
    assert all(info["level_name"] == ("zipf_2", "uniform")[info["level"]] for info in ended)


class Told(GridworldVectorEnv):
    def _describe(self) -> dict[str, Any]:
        return {"words": np.array(["go"] * self.num_envs, object)}


def test_sb3_is_told_texts_of_any_kind(actions):
    env = sb3_env(Told(ENVS, **SMALL))
    env.reset()
    assert env.reset_infos[0]["words"] == "go"
    assert {info["words"] for action in actions for info in env.step(action)[3] if info} == {"go"}


def test_sb3_hears_of_no_success_where_there_is_none(actions):
    env = sb3_env(Quiet(ENVS, **SMALL))
    env.reset()
    ended = [info for action in actions for info in env.step(action)[3] if info]
    assert ended
    assert not any("is_success" in info for info in ended)


# TorchRL


def torchrl_env(env: ZipfVectorEnv) -> Any:
    from zipf.adapters.torchrl import torchrl_env

    return torchrl_env(env)


def test_torchrl_accepts_the_specs():
    from torchrl.envs.utils import check_env_specs

    check_env_specs(torchrl_env(batch("Disabled")))


def test_torchrl_sees_what_the_batch_shows(actions):
    env = torchrl_env(batch("Disabled"))
    state, baseline = env.reset(seed=3), batch()
    expected, info = baseline.reset(seed=3)
    for action in actions:
        np.testing.assert_array_equal(state["image"], expected["image"])
        for name in ("map", "target"):
            np.testing.assert_array_equal(state[name].squeeze(-1), info[name])
        step, state = env.step_and_maybe_reset(state.set("action", torch.as_tensor(action)))
        expected, reward, terminated, truncated, info = baseline.step(action)
        following = step["next"]
        np.testing.assert_array_equal(following["reward"].squeeze(-1), reward)
        np.testing.assert_array_equal(following["terminated"].squeeze(-1), terminated)
        np.testing.assert_array_equal(following["truncated"].squeeze(-1), truncated)
        done = terminated | truncated
        for i in np.flatnonzero(done):
            np.testing.assert_array_equal(following["image"][i], info["final_obs"]["image"][i])


def test_torchrl_is_told_how_episodes_ended(actions):
    env = torchrl_env(batch("Disabled"))
    state = env.reset(seed=0)
    ended = []
    names = ("map", "target", "success", "return", "length")
    for step, action in enumerate(actions):
        played, state = env.step_and_maybe_reset(state.set("action", torch.as_tensor(action)))
        following = played["next"]
        done = following["done"]
        for name in ("success", "return", "length"):
            assert not following[name][~done].any()
            assert not state[name].any()
        for i in torch.nonzero(done.squeeze(-1)).squeeze(-1).tolist():
            told = {name: following[name][i].item() for name in names}
            ended.append({"step": step, "world": i, **told})
    assert ended == episodes_of(batch(), actions)


def test_torchrl_collects():
    from torchrl.collectors import Collector

    env = torchrl_env(batch("Disabled"))
    collector = Collector(env, None, frames_per_batch=20 * ENVS, total_frames=-1)
    collected = next(iter(collector))
    assert collected.batch_size == (ENVS, 20)
    following = collected["next"]
    assert (following["length"][following["done"]] > 0).all()
    assert collected["action"].shape == (ENVS, 20)
    collector.shutdown()


def test_torchrl_is_told_of_levels_that_are_drawn():
    from torchrl.envs.utils import check_env_specs

    env = torchrl_env(mixture("Disabled"))
    check_env_specs(env)
    played = env.rollout(40, break_when_any_done=False)["next"]
    assert set(played["level"].flatten().tolist()) == {0, 1}


def test_libraries_that_keep_observations_are_given_fresh_ones() -> None:
    with pytest.raises(ValueError, match="copy must be True for Stable-Baselines3"):
        sb3_env(batch(copy=False))
    with pytest.raises(ValueError, match="copy must be True for TorchRL"):
        torchrl_env(batch("Disabled", copy=False))


def test_torchrl_hears_of_no_success_where_there_is_none():
    env = torchrl_env(Quiet(ENVS, **SMALL, autoreset_mode="Disabled"))
    played = env.rollout(20, break_when_any_done=False)["next"]
    assert "success" not in played.keys()
    assert (played["length"][played["done"]] > 0).all()


def test_torchrl_needs_batches_that_it_resets_itself():
    with pytest.raises(ValueError, match=r"DISABLED .* got SAME_STEP"):
        torchrl_env(batch())


@pytest.mark.parametrize("adapter", [sb3_env, torchrl_env])
def test_only_batches_are_adapted(adapter):
    with pytest.raises(ValueError, match=r"what zipf\.envs\.make_vec makes, got GridworldEnv"):
        adapter(make(LEVEL))


@pytest.mark.parametrize("rank", ["image", "reward", "done"])
def test_torchrl_has_one_entry_of_a_name(rank):
    makers = {str(i): partial(make_vec, LEVEL, **SMALL) for i in range(2)}
    options = {"draw": "resets", "exponent": 1, "autoreset_mode": "Disabled"}
    torchrl_env(Mixture(makers, ENVS, **options))
    with pytest.raises(ValueError, match=f"'{rank}' cannot be both an observation or a rank of"):
        torchrl_env(Mixture(makers, ENVS, rank=rank, **options))


# Gymnasium's vector wrappers


MODES = ["SameStep", "NextStep", "Disabled"]


def played(env: Any, actions: NDArray[np.int64]) -> Iterator[Any]:
    """`info` of every step; in `DISABLED` mode envs are reset as their episodes end."""
    env.reset(seed=0)
    for action in actions:
        observation, _, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        yield info
        done = terminated | truncated
        if done.any() and env.metadata["autoreset_mode"] is AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": done})


@pytest.mark.parametrize("mode", MODES)
def test_gymnasiums_statistics_are_ours(mode, actions):
    ended = 0
    for info in played(wrappers.RecordEpisodeStatistics(batch(mode)), actions):
        outcome = info["final_info"] if mode == "SameStep" and "final_info" in info else info
        if "_episode" in info:
            mask = info["_episode"]
            ended += mask.sum()
            np.testing.assert_array_equal(info["episode"]["r"][mask], outcome["return"][mask])
            np.testing.assert_array_equal(info["episode"]["l"][mask], outcome["length"][mask])
    assert ended > 20


def test_gymnasiums_lists_of_infos_have_outcomes(actions):
    ours = episodes_of(batch(), actions)
    infos = played(wrappers.DictInfoToList(batch()), actions)
    theirs = [
        {"step": step, "world": i, **info["final_info"]}
        for step, of_worlds in enumerate(infos)
        for i, info in enumerate(of_worlds)
        if "final_info" in info
    ]
    assert theirs == ours


@pytest.mark.parametrize(
    "wrapper",
    [
        lambda env: wrappers.TransformReward(env, lambda reward: reward * 2),
        lambda env: wrappers.NormalizeReward(env),
        lambda env: wrappers.TransformAction(env, lambda action: 7 - action),
        lambda env: wrappers.DictInfoToList(wrappers.RecordEpisodeStatistics(env)),
    ],
    ids=["TransformReward", "NormalizeReward", "TransformAction", "DictInfoToList"],
)
@pytest.mark.parametrize("mode", MODES)
def test_gymnasiums_wrappers_work(wrapper, mode, actions):
    assert len(list(played(wrapper(batch(mode)), actions))) == len(actions)


@pytest.mark.parametrize(
    "wrapper",
    [
        lambda env: wrappers.FlattenObservation(env),
        lambda env: wrappers.FilterObservation(env, ["image"]),
        lambda env: wrappers.TransformObservation(env, lambda o: {"image": o["image"] // 2}),
    ],
    ids=["FlattenObservation", "FilterObservation", "TransformObservation"],
)
@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_gymnasiums_observation_wrappers_work(wrapper, mode, actions):
    """They refuse SAME_STEP, whatever the environment."""
    assert len(list(played(wrapper(batch(mode)), actions))) == len(actions)
