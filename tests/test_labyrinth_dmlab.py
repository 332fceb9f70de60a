"""The labyrinth in DeepMind Lab, with a stand-in that is as strict as its documentation."""

import pickle
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import fake_deepmind_lab
import numpy as np
import pytest
from conftest import assert_equal, learned

from zipf import envs
from zipf.envs import EngineError, Mixture, Split, make, make_vec, replayed
from zipf.envs.check import check_vector_env
from zipf.envs.labyrinth.actions import TABLES
from zipf.envs.labyrinth.dmlab import DmlabVectorEnv
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.words import VOCABULARY
from zipf.evaluate import score
from zipf.experiments.building import run_folder
from zipf.experiments.options import command_line, composing
from zipf.experiments.options.schema import Config
from zipf.experiments.playing.playing import PlayOptions, play
from zipf.experiments.training import runner

Lab = fake_deepmind_lab.Lab
SMALL: dict[str, Any] = {"backend": "dmlab", "image_size": (3, 4)}


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "deepmind_lab", fake_deepmind_lab)
    monkeypatch.setattr(Lab, "opened", [])
    yield
    replayed._NOT_DETERMINISTIC.clear()


def alive() -> list[str]:
    """The levels of the instances that are not closed."""
    return [lab.name for lab in Lab.opened if lab.status != "closed"]


@pytest.mark.parametrize("level", ["language_execute_random_task", "forward_zipf"])
def test_it_keeps_the_contract(level: str) -> None:
    name = f"labyrinth/{level}"
    check_vector_env(
        partial(make_vec, name, **SMALL), partial(make, name, **SMALL), num_envs=3, steps=120
    )


@pytest.mark.parametrize("num_actions", list(TABLES))
def test_the_spaces_are_those_of_our_engine(num_actions: int) -> None:
    for level in LEVELS:
        ours, theirs = (
            make_vec(f"labyrinth/{level}", 2, backend=backend, num_actions=num_actions)
            for backend in ("own", "dmlab")
        )
        assert theirs.single_observation_space == ours.single_observation_space
        assert theirs.single_action_space == ours.single_action_space
        assert theirs.situation == ours.situation
        assert theirs.reports_success == ours.reports_success
    assert Lab.opened == []


def test_actions_observations_and_rewards() -> None:
    env = make_vec("labyrinth/language_select_described_object", 1, **SMALL, num_actions=9)
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
        "labyrinth/rooms_watermaze", 40, **SMALL, action_repeat=100, autoreset_mode="Disabled"
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
    env = make_vec("labyrinth/uniform", 4, **SMALL)
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
    names = [f"labyrinth/{name}" for name in list(LEVELS)[:4]]
    split = Split("some", names, *names[:2], draw=draw)
    env = envs.make_train(split, 4, **SMALL)
    for seed in range(3):
        env.reset(seed=seed)
        assert len(alive()) == 4
    env.close()
    assert alive() == []


def test_pickled_and_restored_mixtures_go_on() -> None:
    env = make_vec("labyrinth/uniform", 3, **SMALL)
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
    env = make_vec("labyrinth/natlab_fixed_large_map", 2, **SMALL)
    env.reset(seed=0)
    env.step(np.full(2, 14))
    with pytest.warns(UserWarning, match="DeepMind Lab's natlab_fixed_large_map is not determ"):
        assert env.set_state(env.get_state()).all()


def test_without_deepmind_lab(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "deepmind_lab", None)
    for level in ("rooms_watermaze", "forward_zipf"):
        with pytest.raises(ValueError, match=r"backend='dmlab' needs .* or use backend='own'"):
            make_vec(f"labyrinth/{level}", 1, backend="dmlab")
    with pytest.raises(ValueError, match="backend must be 'own' or 'dmlab', got 'quake'"):
        make_vec("labyrinth/rooms_watermaze", 1, backend="quake")


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("image_size", (5000, 4), r"image_size must be at most 4096, got \(5000, 4\)"),
        ("action_repeat", 10**9, "action_repeat must be at most 1000000, got 1000000000"),
    ],
)
def test_sizes_that_are_too_large(option: str, value: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        make_vec("labyrinth/rooms_watermaze", 1, **{**SMALL, option: value})


def test_levels_that_cannot_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = "psychlab_continuous_recognition"
    monkeypatch.setattr(Lab, "lost", frozenset({lost}))
    env = make_vec(f"labyrinth/{lost}", 1, **SMALL)
    with pytest.raises(EngineError, match=r"cannot begin .* data/brady_konkle.*no data set"):
        env.reset(seed=0)
    assert alive() == []

    monkeypatch.setattr(fake_deepmind_lab, "LEVELS", {})
    env = DmlabVectorEnv(1, "rooms_select_nonmatching_object")
    with pytest.raises(EngineError, match=r"cannot be loaded .*dmlab30/rooms_select"):
        env.reset(seed=0)


def test_words_that_we_do_not_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Lab, "words", ("red teapot",))
    env = make_vec("labyrinth/language_select_described_object", 1, **SMALL)
    with pytest.raises(EngineError, match="unknown word 'teapot' in 'red teapot'"):
        env.reset(seed=0)


def test_there_are_no_references_and_no_expert() -> None:
    for level in ("labyrinth/rooms_watermaze", "labyrinth/forward_zipf"):
        for name in ("chance", "expert"):
            known = envs.reference(name, level)
            assert envs.reference(name, level, backend="own") == known is not None
            assert envs.reference(name, level, backend="dmlab") is None
        with pytest.raises(ValueError, match="backend='own'"):
            envs.expert(level, make_vec(level, 1, **SMALL))


EXPERIMENT = """# @package _global_
defaults:
  - /environment: labyrinth
  - override /network: shallow
  - override /memory: lstm
  - _self_
experiment: lab
updates: 2
environment: {split: labyrinth_forward, image_size: [24, 32], action_repeat: 600}
network: {size: 8}
memory: {size: 8}
collector: {num_envs: 3, unroll_length: 4}
evaluation: {every: 2, episodes: 1, num_envs: 1}
schedule: {window: [2, 2], log_every: 1, checkpoint_every: 1}
"""


def test_runs_are_trained_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment/lab.yaml").write_text(EXPERIMENT)
    monkeypatch.setattr(composing, "_user_folders", [tmp_path])

    def load(backend: str, name: str) -> Config:
        return command_line.load(
            [
                *("experiment=lab", "condition=impala", "device=cpu"),
                *(f"environment.backend={backend}", f"run_root={tmp_path / name}"),
            ]
        )

    whole, cut = (load("dmlab", name) for name in ("whole", "cut"))
    for config, steps in ((whole, 2), (cut, 1), (cut, 1)):
        run_folder.make(config.folder)
        with runner.Run(config) as run:
            for _ in range(steps):
                run.step()
            run.save()
        assert run.update == (1 if run.is_new and config is cut else 2)
    assert_equal(learned(whole.folder), learned(cut.folder))
    film = tmp_path / "film.gif"
    said: list[str] = []
    play(
        PlayOptions(
            run=str(whole.folder), level="labyrinth/rooms_watermaze", seed=0, record=str(film)
        ),
        said.append,
    )
    assert film.stat().st_size > 0
    assert Lab.opened[-1].name == "rooms_watermaze"
    assert alive() == []
    description = run_folder.read_description(whole.folder)
    assert description["environment"]["backend"] == "dmlab"
    assert description["paper"] is None
    assert [one["references"] for one in description["levels"]] == [{}] * (30 + 30 + 6 + 6)
    assert load("own", "own").what_is_learned != whole.what_is_learned


def test_policies_are_scored() -> None:
    split = Split("one", *["labyrinth/language_select_described_object"] * 3)
    scores = score(
        lambda observation: np.ones(len(observation["image"]), np.int64),
        split,
        episodes=3,
        num_envs=2,
        **SMALL,
    )
    assert scores == {"train": 1.0, "uniform": 1.0, "rare": 1.0}
    assert alive() == []
