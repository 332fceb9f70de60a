"""The labyrinth in DeepMind Lab, with a stand-in that is as strict as its documentation."""

import io
import pickle
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import fake_deepmind_lab
import numpy as np
import pytest
import torch
from dmlab import DmlabVectorEnv

from zipf import envs
from zipf.envs import EngineError, Mixture, SingleEnv, Split, make, make_vec
from zipf.envs.gymnasium import replayed
from zipf.envs.labyrinth.actions import TABLES
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.words import VOCABULARY
from zipf.envs.testing import check_vector_env
from zipf.evaluate import score
from zipf.experiments.building import loading, run_folder
from zipf.experiments.options import config_files
from zipf.experiments.options.schema import Config
from zipf.experiments.playing.playing import PlayOptions, play
from zipf.experiments.training import runner

Lab = fake_deepmind_lab.Lab
SMALL: dict[str, Any] = {"image_size": (3, 4)}


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "deepmind_lab", fake_deepmind_lab)
    monkeypatch.setattr(Lab, "opened", [])
    yield
    replayed._NOT_DETERMINISTIC.clear()


def alive() -> list[str]:
    """The levels of the instances that are not closed."""
    return [lab.name for lab in Lab.opened if lab.status != "closed"]


def uniform(num_envs: int, **options: Any) -> Any:
    """Envs of all tasks, of which each reset draws one."""
    return envs.make_train(envs.split("dmlab_uniform"), num_envs, **SMALL, **options)


def test_it_keeps_the_contract() -> None:
    name = "dmlab/language_execute_random_task"
    check_vector_env(
        partial(make_vec, name, **SMALL), partial(make, name, **SMALL), num_envs=3, steps=120
    )
    check_vector_env(uniform, partial(SingleEnv, uniform), num_envs=3, steps=120)


@pytest.mark.parametrize("num_actions", list(TABLES))
def test_the_spaces_are_those_of_our_engine(num_actions: int) -> None:
    for level in LEVELS:
        ours, theirs = (
            make_vec(f"{family}/{level}", 2, num_actions=num_actions)
            for family in ("labyrinth", "dmlab")
        )
        assert theirs.single_observation_space == ours.single_observation_space
        assert theirs.single_action_space == ours.single_action_space
        assert theirs.situation == ours.situation
        assert theirs.reports_success == ours.reports_success
    assert Lab.opened == []


def test_actions_observations_and_rewards() -> None:
    env = make_vec("dmlab/language_select_described_object", 1, **SMALL, num_actions=9)
    observation, info = env.reset(seed=0)
    (lab,) = Lab.opened
    assert (lab.width, lab.height) == (4, 3)
    assert info["instruction"][0] in Lab.words
    np.testing.assert_array_equal(
        observation["instruction"][0], VOCABULARY.encode(info["instruction"][0])
    )
    assert (observation["image"][0, 1] == lab.place).all()
    total = 0.0
    for action in (4, 0, 1, 2, 8):
        observation, reward, *_ = env.step(np.array([action]))
        total += reward[0]
        assert (observation["image"][0, 1] == lab.place).all()
    assert lab.calls == [
        ([-20, 0, 0, 0, 0, 0, 0], 4),
        ([0, 0, 0, 1, 0, 0, 0], 4),
        ([0, 0, 0, -1, 0, 0, 0], 4),
        ([0, 0, -1, 0, 0, 0, 0], 4),
        ([0, 0, 0, 0, 1, 0, 0], 4),
    ]
    env.close()
    assert alive() == []


def test_ends() -> None:
    """At the time limit an episode is truncated, before it terminated; the last observation is the
    one before the end."""
    env = make_vec(
        "dmlab/rooms_watermaze", 40, **SMALL, action_repeat=100, autoreset_mode="Disabled"
    )
    before = env.reset(seed=0)[0]["image"].copy()
    stay = np.full(40, 14)
    for step in range(1, 73):
        observation, reward, terminated, truncated, info = env.step(stay)
        assert not terminated.any()
        assert not reward.any()
        assert (truncated == (step == 72)).all()
    assert (info["length"] == 72).all()
    assert (observation["image"][:, 1] == before[:, 1]).all()
    assert (observation["image"][:, 0, 0, 1:] == divmod(7100, 256)).all()

    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.zeros(40, np.int64))  # 100 x 3 places
    assert terminated.all()
    assert not truncated.any()
    assert (info["return"] == 1).all()


def test_max_steps_truncate() -> None:
    env = DmlabVectorEnv(1, "rooms_watermaze", max_steps=3, autoreset_mode="Disabled")
    env.reset(seed=0)
    ends = [[*map(bool, env.step(np.array([14]))[2:4])] for _ in range(3)]
    assert ends == [[False, False], [False, False], [False, True]]


def test_a_world_has_one_engine() -> None:
    env = uniform(4)
    assert isinstance(env, Mixture)
    for seed in range(3):
        _, info = env.reset(seed=seed)
        assert sorted(alive()) == sorted(name.split("/")[1] for name in info["level_name"])
    first = Lab.opened[-1]
    env.reset(options={"level": info["level"]})
    assert Lab.opened[-1] is first
    env.close()
    assert alive() == []


@pytest.mark.parametrize("draw", ["resets", "worlds"])
def test_a_world_has_one_engine_in_training(draw: str) -> None:
    names = [f"dmlab/{name}" for name in list(LEVELS)[:4]]
    split = Split("some", names, *names[:2], draw=draw)
    env = envs.make_train(split, 4, **SMALL)
    for seed in range(3):
        env.reset(seed=seed)
        assert len(alive()) == 4
    env.close()
    assert alive() == []


def test_pickled_and_restored_mixtures_go_on() -> None:
    env = uniform(3)
    env.reset(seed=5)
    for _ in range(4):
        env.step(np.full(3, 14))
    other = pickle.loads(pickle.dumps(env))
    for _ in range(4):
        actions = np.array([0, 6, 14])
        for one, expected in zip(
            env.step(actions)[0].values(), other.step(actions)[0].values(), strict=True
        ):
            np.testing.assert_array_equal(one, expected)
    other.close()
    assert len(alive()) == 3


def test_an_engine_that_is_not_deterministic_begins_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Lab, "sound", False)
    env = make_vec("dmlab/natlab_fixed_large_map", 2, **SMALL)
    env.reset(seed=0)
    env.step(np.full(2, 14))
    with pytest.warns(UserWarning, match="DeepMind Lab's natlab_fixed_large_map is not determ"):
        assert env.set_state(env.get_state()).all()


def test_without_deepmind_lab(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "deepmind_lab", None)
    with pytest.raises(ValueError, match=r"dmlab needs .* or use the family labyrinth"):
        make_vec("dmlab/rooms_watermaze", 1)


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("image_size", (5000, 4), r"image_size must be at most 4096, got \(5000, 4\)"),
        ("action_repeat", 10**9, "action_repeat must be at most 1000000, got 1000000000"),
    ],
)
def test_sizes_that_are_too_large(option: str, value: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        make_vec("dmlab/rooms_watermaze", 1, **{**SMALL, option: value})


def test_levels_that_cannot_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = "psychlab_continuous_recognition"
    monkeypatch.setattr(Lab, "lost", frozenset({lost}))
    env = make_vec(f"dmlab/{lost}", 1, **SMALL)
    with pytest.raises(EngineError, match=r"cannot begin .* data/brady_konkle.*no data set"):
        env.reset(seed=0)
    assert alive() == []

    monkeypatch.setattr(fake_deepmind_lab, "LEVELS", {})
    env = DmlabVectorEnv(1, "rooms_select_nonmatching_object")
    with pytest.raises(EngineError, match=r"cannot be loaded .*dmlab30/rooms_select"):
        env.reset(seed=0)


def test_words_that_we_do_not_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Lab, "words", ("red teapot",))
    env = make_vec("dmlab/language_select_described_object", 1, **SMALL)
    with pytest.raises(EngineError, match="unknown word 'teapot' in 'red teapot'"):
        env.reset(seed=0)


def test_there_are_no_references_and_no_expert() -> None:
    level = "dmlab/rooms_watermaze"
    for name in ("chance", "expert"):
        assert envs.baseline(name, level) is None
    assert envs.expert(level, make_vec(level, 1, **SMALL)) is None


SHORT = (
    *("updates=2", "condition=impala", "device=cpu", "collector.num_envs=3"),
    *("environment.image_size=[24,32]", "environment.action_repeat=600", "network=shallow"),
    *("network.size=8", "memory.size=8", "collector.unroll_length=4", "schedule.window=[2,2]"),
    *("schedule.log_every=1", "schedule.checkpoint_every=1", "evaluation.every=2"),
    *("evaluation.episodes=1", "evaluation.num_envs=1"),
)


def test_runs_are_trained_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parent)

    def load(name: str) -> Config:
        config_files.use_folder("configs")
        return loading.load(["experiment=dmlab_forward", *SHORT, f"run_root={tmp_path / name}"])

    whole, cut = load("whole"), load("cut")
    for config, steps in ((whole, 2), (cut, 1), (cut, 1)):
        run_folder.make(config.folder)
        with runner.Run(config) as run:
            for _ in range(steps):
                run.step()
            run.save()
    trained = [weights(config.folder) for config in (whole, cut)]
    assert trained[0].keys() == trained[1].keys()
    assert all(torch.equal(one, trained[1][name]) for name, one in trained[0].items())
    film = tmp_path / "film.gif"
    play(
        PlayOptions(run=str(whole.folder), level="dmlab/rooms_watermaze", seed=0, record=str(film)),
        lambda line: None,
    )
    assert film.stat().st_size > 0
    assert Lab.opened[-1].name == "rooms_watermaze"
    assert alive() == []
    description = run_folder.read_description(whole.folder)
    assert description["paper"] is None
    assert [one["references"] for one in description["levels"]] == [{}] * (30 + 30 + 6 + 6)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    """The tensors of a run's checkpoint, by their places in it."""
    with (folder / "checkpoint.pt").open("rb") as file:
        file.readline()
        state = torch.load(io.BytesIO(file.read()), weights_only=False)
    found: dict[str, torch.Tensor] = {}

    def collect(place: str, value: Any) -> None:
        if isinstance(value, torch.Tensor):
            found[place] = value
        elif isinstance(value, dict):
            for key, one in value.items():
                collect(f"{place}/{key}", one)

    collect("", state["agent"])
    assert found
    return found


def test_policies_are_scored() -> None:
    split = Split("one", *["dmlab/language_select_described_object"] * 3)
    scores = score(
        lambda observation: np.ones(len(observation["image"]), np.int64),
        split,
        episodes=3,
        num_envs=2,
        **SMALL,
    )
    assert scores == {"train": 1.0, "uniform": 1.0, "rare": 1.0}
    assert alive() == []
