"""The benchmark's levels draw a task at every reset, by the law that their name says."""

import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import stats

from zipf import envs
from zipf.envs import make, make_vec
from zipf.envs.episodes import play_episodes
from zipf.envs.labyrinth import benchmark
from zipf.envs.labyrinth.labyrinth_env import LabyrinthEnv
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.mixture import Mixture
from zipf.experiments.evaluation.scripted import ScriptedPolicy

TASKS = [f"labyrinth/{name}" for name in LEVELS]
SMALL = {"image_size": (3, 4)}


def test_laws() -> None:
    n = len(TASKS)
    weights = 1 / np.arange(1, n + 1)
    order, p = benchmark.law("forward_zipf") or ("", np.empty(0))
    assert order == "forward"
    np.testing.assert_allclose(p, weights / weights.sum())
    assert benchmark.law("reversed_zipf")[0] == "reversed"  # type: ignore[index]
    np.testing.assert_allclose(benchmark.law("zipf2")[1], weights**2 / (weights**2).sum())  # type: ignore[index]
    for name, order in (("forward_rare", "forward"), ("reversed_rare", "reversed")):
        found = benchmark.law(name)
        assert found is not None
        assert found[0] == order
        assert found[1].nonzero()[0].tolist() == list(range(n - n // 5, n))
    assert benchmark.law("rooms_watermaze") is None
    for released, ours in (("uniform_rare", "forward_rare"), ("zipf1", "forward_zipf")):
        np.testing.assert_equal(benchmark.law(released), benchmark.law(ours))
    np.testing.assert_equal(benchmark.law("zipf_2"), benchmark.law("zipf2"))  # as elsewhere


def test_tasks_are_drawn_by_the_law_and_told_in_info_alone() -> None:
    env = make_vec("labyrinth/reversed_zipf", 600, **SMALL)
    assert isinstance(env, Mixture)
    observation, info = env.reset(seed=3)
    assert set(observation) == {"image", "instruction"}
    assert env.situation == {"level": len(TASKS)}
    assert env.level_names == tuple(TASKS[::-1])
    counts = np.bincount(info["level"], minlength=len(TASKS))
    assert stats.chisquare(counts, env.probabilities * 600).pvalue > 1e-3
    assert info["level_name"].tolist() == [env.level_names[rank] for rank in info["level"]]


def test_one_world() -> None:
    env = make("labyrinth/forward_rare", **SMALL)
    seen = set()
    for seed in range(20):
        _, info = env.reset(seed=seed)
        seen.add(info["level_name"])
    assert seen <= set(TASKS[-(len(TASKS) // 5) :])
    assert len(seen) > 1


def test_splits() -> None:
    for name, tasks in (("labyrinth_forward", TASKS), ("labyrinth_reversed", TASKS[::-1])):
        split = envs.split(name)
        assert split.draw == "resets"
        assert split.spread == "tasks"
        assert [one.name for one in split.train] == tasks
        assert [one.name for one in split.rare] == tasks[-(len(tasks) // 5) :]
        weights = np.array([one.weight for one in split.train])
        np.testing.assert_allclose(weights[0] / weights, np.arange(1, len(tasks) + 1))
        assert len({one.weight for one in split.uniform}) == 1
        for one in split.all_levels:
            level = LEVELS[one.name.removeprefix("labyrinth/")]
            assert one.score([level.human]) == pytest.approx(1)
            assert one.score([level.random]) == pytest.approx(0)


def test_scripted_players_play_levels_with_options_of_their_own() -> None:
    watermaze, rooms = "labyrinth/rooms_watermaze", "labyrinth/rooms_collect_good_objects_train"
    first = envs.SplitLevel(watermaze, options={"max_steps": 300})
    split = envs.Split("mine", [first, envs.SplitLevel(rooms)], draw="resets")
    env = envs.make_scored(split, split.train[1], 2, image_size=(2, 2))
    with pytest.raises(ValueError, match="plays levels with the same options"):
        envs.scripted("expert", "labyrinth/uniform", env)
    player = ScriptedPolicy("expert")
    player.enter(rooms, env)
    returns = play_episodes(env, lambda *_: player.policy(), 2, seed=0)["return"]
    assert min(returns) > 3


@pytest.mark.parametrize("of", ["chance", "generalist", "expert"])
def test_references_are_the_tasks_mean(of: str) -> None:
    every = [envs.baseline(of, f"labyrinth/{name}") for name in LEVELS]
    scores = [one.score for one in every if one is not None]
    errors = np.array([one.error for one in every if one is not None])
    for name, order in (("labyrinth/forward_zipf", 1), ("labyrinth/reversed_zipf", -1)):
        p = envs.distributions.zipfian(len(LEVELS), 1)
        found = envs.baseline(of, name)
        assert found is not None
        assert found.score == pytest.approx(p @ scores[::order])
        assert found.by_rank == {"level": tuple(scores[::order])}
        assert found.error == pytest.approx(np.sqrt((p**2) @ (errors[::order] ** 2)))
    assert envs.baseline(of, "labyrinth/uniform", num_actions=9) is None


@pytest.mark.parametrize("of", envs.SCRIPTED)
def test_scripted_players_play_all_tasks(of: envs.Scripted) -> None:
    env = make_vec("labyrinth/uniform", 60, **SMALL)
    env.reset(seed=0)
    player = envs.scripted(of, "labyrinth/uniform", env)
    assert player is not None
    total = np.zeros(60)
    for _ in range(100):
        total += env.step(player())[1]
    assert (total > 0).mean() > 0.5


@pytest.mark.parametrize(
    "name",
    [
        *("forward_zip", "zipf", "zipfx", "zipf-1", "rooms_water_maze"),
        *("zipf1_5", "zipf 2", "zipfinf", "zipfnan", "zipf1e3", "zipf.5", "zipf\u0663"),
    ],
)
def test_unknown_levels(name: str) -> None:
    with pytest.raises(ValueError, match=r"unknown level '.*expected one of .*zipf<exponent>"):
        make_vec(f"labyrinth/{name}", 1)


@pytest.mark.parametrize("name", ["order", "exponent", "rank", "draw", "levels_of_envs"])
def test_options_are_those_of_the_tasks(name: str) -> None:
    for level in ("uniform", "rooms_watermaze"):
        with pytest.raises(ValueError, match=f"unknown option '{name}'.*expected one of backend"):
            benchmark.make_vec(2, level, **{name: None})
    env = make_vec(
        "labyrinth/uniform", 2, max_steps=5, autoreset_mode="Disabled", copy=False,
        render_mode="rgb_array", **SMALL,
    )  # fmt: skip
    assert (env.time_limit, env.copy, env.render_mode) == (5, False, "rgb_array")
    assert env.autoreset_mode.value == "Disabled"
    env.reset(seed=0)
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_equal(again.step(np.zeros(2, int))[:4], env.step(np.zeros(2, int))[:4])


@pytest.mark.parametrize("level", [3, None, ["zipf1"]])
def test_a_level_that_is_no_name_is_refused(level: Any) -> None:
    for made in (benchmark.law, LabyrinthEnv, partial(benchmark.make_vec, 2)):
        with pytest.raises(
            ValueError, match=r"level must be a name, got .*expected one of forward"
        ):
            made(level)
