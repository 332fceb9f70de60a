import tracemalloc
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import slow_but
from gymnasium.vector import AutoresetMode

from zipf.envs import (
    KINDS,
    Split,
    SplitLevel,
    ZipfVectorEnv,
    all_splits,
    baseline,
    find_family,
    make,
    make_vec,
    measure_chance,
    split,
)


@pytest.mark.parametrize(
    "name", slow_but(all_splits(), "gridworld", "playroom_put", "labyrinth_forward")
)
def test_every_level_of_every_split_can_be_made(name: str) -> None:
    levels = split(name)
    assert levels.name == name
    for level in levels.all_levels:
        assert isinstance(level.level, str)
        batch, single = make_vec(level, 2), make(level.level)
        assert isinstance(batch, ZipfVectorEnv)
        assert batch.single_observation_space == single.observation_space
        assert batch.autoreset_mode is AutoresetMode.SAME_STEP


def test_the_gridworld_split() -> None:
    levels = split("gridworld")
    assert [one.name for one in levels.train] == ["gridworld/zipf_2"]
    assert [one.name for one in levels.uniform] == ["gridworld/uniform"]
    assert [one.name for one in levels.rare] == ["gridworld/rare"]


def test_other_names_of_the_same_level() -> None:
    for name in ("gridworld/rare", "gridworld/uniform_rare"):
        assert make_vec(name, 8).reset(seed=0)[1]["map"].min() >= 16
    uniform = make_vec("gridworld/uniform", 50).reset(seed=0)[1]["map"]
    assert (make_vec("gridworld/zipf_0", 50).reset(seed=0)[1]["map"] == uniform).all()


def test_options_reach_the_environment() -> None:
    env = make_vec("gridworld/zipf_1", 3, autoreset_mode="Disabled", num_maps=7, num_objects=4)
    assert env.autoreset_mode is AutoresetMode.DISABLED
    assert env.situation == {"map": 7, "target": 4}


@pytest.mark.parametrize(
    ("level", "message"),
    [
        ("gridworld/unifrom", "did you mean 'uniform'"),
        ("gridworld/zipf_-2", "finite and >= 0"),
        ("gridwrld/zipf_2", "did you mean 'gridworld/zipf_2'"),
        ("zipf_2", "did you mean 'gridworld/zipf_2'"),
        ("gridworld", "unknown level 'gridworld'"),
        ("playroom/playroom/lift/lift_shape_zipf3", "unknown level 'playroom/playroom/lift"),
        ("", "expected one of gridworld/zipf_2"),
    ],
)
@pytest.mark.parametrize(
    "function", [make, lambda level: make_vec(level, 2), partial(baseline, "chance")]
)
def test_unknown_levels_name_the_nearest(function: Any, level: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        function(level)


@pytest.mark.parametrize("level", [3, None, 2.5, {"gridworld/rare"}])
@pytest.mark.parametrize("function", [make, lambda level: make_vec(level, 2)])
def test_what_is_no_level_is_refused(function: Any, level: Any) -> None:
    with pytest.raises(ValueError, match=r"level must be a name such as 'gridworld/zipf_2'.*got"):
        function(level)


def test_a_list_of_what_is_no_level_is_refused() -> None:
    with pytest.raises(ValueError, match="got 3"):
        make_vec(["gridworld/rare", 3], 2)  # type: ignore[list-item]


def test_a_world_takes_little_memory_beside_its_observation() -> None:
    def taken(num_envs: int) -> int:
        """Bytes a batch holds after some steps, without the caller's buffers."""
        tracemalloc.start()
        env = make_vec("gridworld/zipf_2", num_envs)
        assert env.observation_space.shape is None
        before, _ = tracemalloc.get_traced_memory()
        out = env.allocate()
        buffers = tracemalloc.get_traced_memory()[0] - before
        env.reset(seed=0, out=out)
        for _ in range(20):
            env.step(np.arange(num_envs) % 8, out=out)
        total, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return total - buffers

    taken(2)
    assert (taken(2050) - taken(2)) / 2048 < 1024


@pytest.mark.parametrize(
    "function",
    [
        make,
        partial(make_vec, num_envs=2),
        lambda level, **options: make_vec([level, "gridworld/zipf_2"], 2, **options),
        measure_chance,
        partial(baseline, "chance"),
    ],
)
def test_unknown_options_name_the_nearest(function: Any) -> None:
    message = r"unknown gridworld option 'num_map' \(did you mean 'num_maps'.* one of num_maps, num"
    with pytest.raises(ValueError, match=message):
        function("gridworld/rare", num_map=3)


def test_unknown_splits_name_the_nearest() -> None:
    with pytest.raises(ValueError, match="did you mean 'gridworld'"):
        split("gridwolrd")


@pytest.mark.parametrize("name", [None, 3, ["gridworld"]])
def test_what_is_no_name_is_refused(name: Any) -> None:
    with pytest.raises(ValueError, match="a split must be a name, got"):
        split(name)
    with pytest.raises(ValueError, match="a family must be a name, got"):
        find_family(name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 100}, "episodes must be a mapping, got 100"),
        ({"episodes": {"train": 1, "uniform": 1}}, "a number for each of train, uniform, rare"),
        ({"episodes": {"train": "a", "uniform": 1, "rare": 1}}, "must be a whole number, got 'a'"),
        ({"episodes": {"train": 1, "uniform": 2.5, "rare": 1}}, "whole number, got 2.5"),
        ({"train": None}, "a level must be a name or a function that makes it, got None"),
        ({"train": []}, "has no train level"),
    ],
)
def test_splits_that_are_none_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Split("own", **{**dict.fromkeys(KINDS, "gridworld/rare"), **options})


def test_levels_made_by_functions_have_names_of_their_own() -> None:
    """The same in every process, and not those of others."""
    local = "test_levels_made_by_functions_have_names_of_their_own.<locals>"

    def easy(num_envs: int, **options: Any) -> ZipfVectorEnv:
        return make_vec("gridworld/rare", num_envs, **options)

    partly = partial(easy, 2)
    assert SplitLevel(easy).name == f"{local}.easy"
    assert SplitLevel(partly).name == f"functools.partial(<function {local}.easy>, 2)"
    assert SplitLevel(ZipfVectorEnv).name == "ZipfVectorEnv"
    Split("own", easy, easy, partial(easy))
    with pytest.raises(ValueError, match=r"split 'own' has two levels called .*<lambda>: give"):
        Split("own", lambda n: easy(n), "gridworld/uniform", lambda n: easy(n))


@pytest.mark.parametrize("weight", ["1", None, 0, -1.0, float("nan"), True])
def test_weights_that_are_none_are_refused(weight: Any) -> None:
    with pytest.raises(ValueError, match="the weight of gridworld/rare must be positive, got"):
        SplitLevel("gridworld/rare", weight=weight)


def test_options_of_a_level_are_a_mapping() -> None:
    with pytest.raises(ValueError, match="options of gridworld/rare must be a mapping, got 3"):
        SplitLevel("gridworld/rare", options=3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options", [{"episodes": "10"}, {"episodes": 2.5}, {"num_envs": "a"}, {"max_steps": "a"}]
)
def test_chance_is_not_measured_with_what_is_no_number(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be a whole number, got"):
        measure_chance("gridworld/rare", **options)


def test_chance_is_measured_of_worlds_that_start_over() -> None:
    with pytest.raises(ValueError, match="autoreset_mode must be SAME_STEP, got DISABLED"):
        measure_chance("gridworld/rare", autoreset_mode="Disabled")


@pytest.mark.parametrize("player", ["chance", "expert"])
@pytest.mark.parametrize("options", [{"max_steps": "a"}, {"max_steps": 0}, {"num_rooms": 3}])
def test_references_are_not_known_of_worlds_that_are_none(
    player: str, options: dict[str, Any]
) -> None:
    (name,) = options
    with pytest.raises(ValueError, match=f"{name} must be"):
        baseline(player, "gridworld/rare", **options)
