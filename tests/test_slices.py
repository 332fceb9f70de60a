"""A batch stepped by several threads is the batch stepped by one, bit for bit."""

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
    "labyrinth_forward": SMALL[MAZE],  # a task drawn at every reset
}


def played(env: envs.ZipfVectorEnv, steps: int, teacher: Teacher | None = None) -> list[Any]:
    """All that a batch gives while random actions are taken, and what a teacher would do."""
    rng = np.random.default_rng(0)
    found: list[Any] = []
    for _ in range(steps):
        actions = rng.integers(int(env.single_action_space.n), size=env.num_envs)
        found.append((env.step(actions), None if teacher is None else teacher()))
    return found


def same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one is other or np.array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("level", [LIFT, MAZE])
def test_slices_keep_the_contract(level: str) -> None:
    options = SMALL[level]
    check_vector_env(
        lambda num_envs, **others: envs.make_vec(
            level, num_envs, threads=min(3, num_envs), **options, **others
        ),
        partial(envs.make, level, **options),
    )


@pytest.mark.parametrize("name", slow_but(SPLITS, "playroom_lift", "playroom_find"))
def test_the_number_of_threads_changes_no_bit(name: str) -> None:
    """Of what training sees, of teachers, and of what is saved, which goes on with any number."""
    split, n, results, states = envs.split(name), 7, [], []
    kind = "generalist" if name == "labyrinth_forward" else "expert"
    for threads in (1, 3):
        env = envs.make_train(split, n, threads=threads, **SPLITS[name])
        if env.achieves:
            env.report_achieved()
        teacher = Teacher(kind, split, env)
        first = env.reset(seed=3)
        found = played(env, 8, teacher)
        states.append((env.get_state(), teacher.get_state()))
        results.append((first, found, played(env, 8, teacher)))
    assert same(results[0], results[1])
    assert same(states[0], states[1])

    for threads in (3, 1):  # what the other number has saved
        env = envs.make_train(split, n, threads=threads, **SPLITS[name])
        if env.achieves:
            env.report_achieved()
        teacher = Teacher(kind, split, env)
        env.reset(seed=0)
        env.set_state(states[0 if threads == 3 else 1][0])
        teacher.set_state(states[0][1])
        assert same(played(env, 8, teacher), results[0][2])


def test_rules_in_python_take_turns() -> None:
    one, several = (envs.make_vec(MAZE, 5, threads=k, **SMALL[MAZE]) for k in (1, 3))
    assert same(one.reset(seed=3), several.reset(seed=3))
    assert same(played(one, 8), played(several, 8))


def test_a_pickled_batch_goes_on() -> None:
    env = envs.make_vec(LIFT, 5, threads=2, **SMALL[LIFT])
    env.reset(seed=1)
    played(env, 3)
    twin = pickle.loads(pickle.dumps(env))
    assert same(played(twin, 8), played(env, 8))


def test_what_cannot_be_sliced_is_refused() -> None:
    with pytest.raises(
        ValueError, match="threads=2: a GridworldVectorEnv is stepped by one thread"
    ):
        envs.make_vec("gridworld/zipf_2", 4, threads=2)
    with pytest.raises(ValueError, match="threads=5: should be at most num_envs=4"):
        envs.make_vec(LIFT, 4, threads=5)


def test_what_a_thread_raises_is_raised_once_all_have_ended() -> None:
    env = envs.make_vec(LIFT, 4, threads=4, **SMALL[LIFT])
    assert isinstance(env, Slices)
    ended = []

    def fail(part: envs.ZipfVectorEnv, rows: slice) -> None:
        ended.append(rows.start)
        if rows.start in (0, 2):
            raise RuntimeError(f"slice {rows.start}")

    with pytest.raises(RuntimeError, match="slice 0"):
        env.each(fail)
    assert sorted(ended) == [0, 1, 2, 3]
    env.close()


@pytest.mark.parametrize("condition", ["imitation", "vmpo"])
def test_training_is_the_same_with_any_number_of_threads(condition: str, tmp_path: Path) -> None:
    """Also where a run goes on with another."""
    words = [
        "experiment=playroom_lift_compact", f"condition={condition}", "collector.num_envs=6",
        "collector.unroll_length=4", "environment.image_size=[12,16]", "network=compact",
        "network.patch=4", "environment.max_steps=6", "evaluation.episodes=2",
        "schedule.window=[0,4]", "precision=float32",
    ]  # fmt: skip
    found = []
    for name, parts in (("one", [(4, 1)]), ("two", [(4, 2)]), ("both", [(2, 1), (4, 2)])):
        for updates, threads in parts:
            more = [f"updates={updates}", f"threads={threads}", f"run_root={tmp_path / name}"]
            config = loading.load([*words, *more])
            assert config.env_threads == threads
            assert runner.train(config) == 0
        weights = checkpoint.load(config.folder / "weights.pt")["weights"]
        found.append({key: value.numpy() for key, value in weights.items()})
    assert same(found[0], found[1])
    assert same(found[0], found[2])
