"""A batch stepped by several threads or processes is the batch stepped by one, bit for bit."""

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import slow_but

from zipf import envs
from zipf.envs.policies import Teacher
from zipf.envs.slices import Slices
from zipf.envs.testing import check_vector_env
from zipf.envs.testing.steps import are_equal
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.training import runner

LIFT, MAZE = "playroom/lift/lift_shape_zipf3", "labyrinth/rooms_watermaze"
SMALL: dict[str, dict[str, Any]] = {
    LIFT: {"image_size": (12, 16), "max_steps": 6},
    MAZE: {"image_size": (12, 16), "max_steps": 6, "action_repeat": 8},
}
SPLITS = {
    "playroom_lift": SMALL[LIFT],  # levels share their engine
    "playroom_find": SMALL[LIFT],
    "playroom_put": SMALL[LIFT],  # envs shared among levels with several engines
    "labyrinth_forward": SMALL[MAZE],  # a task drawn at every reset
}
WORKERS = [{"threads": 3}, {"processes": 2}]


def played(env: envs.ZipfVectorEnv, steps: int, teacher: Teacher | None = None) -> list[Any]:
    """All that a batch gives while random actions are taken, and what a teacher would do."""
    rng = np.random.default_rng(0)
    found: list[Any] = []
    for _ in range(steps):
        actions = rng.integers(int(env.single_action_space.n), size=env.num_envs)
        found.append((env.step(actions), None if teacher is None else teacher()))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("level", [LIFT, MAZE])
def test_slices_keep_the_contract(level: str) -> None:
    options = SMALL[level]
    check_vector_env(
        lambda num_envs, **others: envs.make_vec(
            level, num_envs, threads=min(3, num_envs), **options, **others
        ),
        partial(envs.make, level, **options),
        steps=300,
    )


@pytest.mark.parametrize(
    ("name", "workers"),
    slow_but(
        [(name, workers) for name in SPLITS for workers in WORKERS],
        ("playroom_lift", WORKERS[0]),
        ("playroom_find", WORKERS[0]),
        ("playroom_put", WORKERS[0]),
    ),
    ids=str,
)
def test_threads_and_processes_change_no_bit(name: str, workers: dict[str, int]) -> None:
    """Of what training sees, of teachers, and of what is saved, which goes on with any number."""
    split, n, results, states = envs.split(name), 7, [], []
    kind = "generalist" if name == "labyrinth_forward" else "expert"

    def made(given: dict[str, int]) -> tuple[envs.ZipfVectorEnv, Teacher]:
        env = envs.make_train(split, n, **given, **SPLITS[name])
        if env.achieves:
            env.report_achieved()
        return env, Teacher(kind, split, env)

    for given in ({}, workers):
        env, teacher = made(given)
        first = env.reset(seed=3)
        found = played(env, 8, teacher)
        states.append((env.get_state(), teacher.get_state()))
        results.append((first, found, played(env, 8, teacher)))
        env.close()
    assert are_equal(results[0], results[1])
    assert are_equal(states[0], states[1])

    for given, saved in ((workers, states[0]), ({}, states[1])):  # what the other has saved
        env, teacher = made(given)
        env.reset(seed=0)
        env.set_state(saved[0])
        teacher.set_state(saved[1])
        assert are_equal(played(env, 8, teacher), results[0][2])
        env.close()


@pytest.mark.parametrize("workers", slow_but(WORKERS, WORKERS[0]), ids=str)
def test_envs_know_their_levels(workers: dict[str, int]) -> None:
    """Those shared among levels for good, wherever the slices are cut."""
    split = envs.split("playroom_put")
    one, several = (envs.make_train(split, 7, **given, **SMALL[LIFT]) for given in ({}, workers))
    assert are_equal(one.level_of_envs, several.level_of_envs)
    assert len(set(one.level_of_envs)) == 3
    assert [one.name_of(i) for i in range(7)] == [several.name_of(i) for i in range(7)]
    assert one.name_of(0) != one.name_of(6)
    several.close()
    with pytest.raises(ValueError, match="num_envs must be at least 3, an env for each"):
        envs.make_train(split, 2, **{name: 2 for name in workers}, **SMALL[LIFT])


def test_slices_tell_what_one_batch_tells() -> None:
    one, several = (envs.make_vec(LIFT, 4, threads=k, **SMALL[LIFT]) for k in (1, 2))
    assert one.time_limit is not None
    for name in ("time_limit", "longest_episode", "situation", "reports_success"):
        assert getattr(several, name) == getattr(one, name)
    for env in (one, several):
        env.reset(seed=0)
    for drawn, expected in zip(several.pictures(40, 30), one.pictures(40, 30), strict=True):
        np.testing.assert_array_equal(drawn, expected)


def test_rules_in_python_take_turns() -> None:
    one, several = (envs.make_vec(MAZE, 5, threads=k, **SMALL[MAZE]) for k in (1, 3))
    assert are_equal(one.reset(seed=3), several.reset(seed=3))
    assert are_equal(played(one, 8), played(several, 8))


@pytest.mark.parametrize("workers", slow_but(WORKERS, WORKERS[0]), ids=str)
def test_a_pickled_batch_goes_on(workers: dict[str, int]) -> None:
    env = envs.make_vec(LIFT, 5, **workers, **SMALL[LIFT])
    env.report_achieved()
    env.reset(seed=1)
    played(env, 3)
    twin = pickle.loads(pickle.dumps(env))
    assert are_equal(played(twin, 8), played(env, 8))
    env.close()
    twin.close()


@pytest.mark.parametrize("workers", slow_but(WORKERS, WORKERS[0]), ids=str)
@pytest.mark.parametrize("draw", ["worlds", "resets"])
def test_slices_of_levels_are_not_levels_in_slices(workers: dict[str, int], draw: str) -> None:
    makers = {LIFT: partial(envs.make_vec, LIFT, **workers, **SMALL[LIFT])}
    law = {} if draw == "worlds" else {"exponent": 1.0}
    with pytest.raises(ValueError, match=r"a level of a mixture cannot have .* of its own"):
        envs.Mixture(makers, 4, draw=draw, **law)


def test_levels_that_are_drawn_need_no_env_each() -> None:
    levels = [f"playroom/lift/lift_shape_{name}" for name in ("zipf3", "zipf2", "uniform")]
    law = {"draw": "resets", "exponent": 1.0, **SMALL[LIFT]}
    one, two = (envs.make_vec(levels, 2, threads=threads, **law) for threads in (1, 2))
    for key, part in one.reset(seed=3)[0].items():
        assert np.array_equal(part, two.reset(seed=3)[0][key])
    two.close()


def test_what_cannot_be_sliced_is_refused() -> None:
    with pytest.raises(
        ValueError, match="threads=2: a GridworldVectorEnv is stepped by one thread"
    ):
        envs.make_vec("gridworld/zipf_2", 4, threads=2)
    for name in ("threads", "processes"):
        with pytest.raises(ValueError, match=f"{name}=5: should be at most num_envs=4"):
            envs.make_vec(LIFT, 4, **{name: 5})
    with pytest.raises(ValueError, match="threads=2, processes=3: give one of them"):
        envs.make_vec(LIFT, 4, threads=2, processes=3)
    with pytest.raises(ValueError, match="processes=2: the envs cannot be sent: Can't pickle"):
        envs.make_vec(lambda num_envs: envs.make_vec(LIFT, num_envs), 4, processes=2)


def test_what_a_thread_raises_is_raised_once_all_have_ended() -> None:
    env = envs.make_vec(LIFT, 4, threads=4, **SMALL[LIFT])
    assert isinstance(env, Slices)
    ended = []

    class Failing:
        def fail(self, rows: slice) -> None:
            ended.append(rows.start)
            if rows.start in (0, 2):
                raise RuntimeError(f"slice {rows.start}")

    with pytest.raises(RuntimeError, match="slice 0"):
        env.each("fail", lambda rows: (rows,), of=env.bind(lambda part: Failing()))
    assert sorted(ended) == [0, 1, 2, 3]
    env.close()


@pytest.mark.parametrize(
    ("condition", "workers"),
    slow_but(
        [(condition, workers) for condition in ("imitation", "vmpo") for workers in WORKERS],
        ("imitation", WORKERS[0]),
        ("vmpo", WORKERS[0]),
    ),
    ids=str,
)
def test_training_is_the_same_however_envs_are_stepped(
    condition: str, workers: dict[str, int], tmp_path: Path
) -> None:
    """Also where a run goes on with another number."""
    words = [
        "experiment=playroom_lift_compact", f"condition={condition}", "collector.num_envs=6",
        "collector.unroll_length=4", "environment.image_size=[12,16]", "network=compact",
        "network.patch=4", "environment.max_steps=6", "evaluation.episodes=2",
        "schedule.window=[0,4]", "precision=float32",
    ]  # fmt: skip
    found = []
    name = next(iter(workers))
    for folder, parts in (("one", [(4, [])]), ("both", [(2, []), (4, [f"{name}=2"])])):
        for updates, more in parts:
            more = [f"updates={updates}", f"run_root={tmp_path / folder}", *more]
            config = loading.load([*words, *more])
            assert runner.train(config) == 0
        weights = checkpoint.load(config.folder / "weights.pt")["weights"]
        found.append({key: value.numpy() for key, value in weights.items()})
    assert are_equal(found[0], found[1])
