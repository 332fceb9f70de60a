"""The gridworld as users of Gymnasium and TorchRL meet it."""

import importlib.util
import subprocess
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import env_render_passive_checker
from gymnasium.vector import AutoresetMode

import zipf.envs
from zipf.envs.gridworld.gridworld_env import GridworldEnv
from zipf.envs.gridworld.render import frame
from zipf.envs.gridworld.vector import GridworldVectorEnv

ID = "zipf/Gridworld-v0"
HAS_PYGAME = importlib.util.find_spec("pygame") is not None


@pytest.mark.parametrize("level", ["zipf_2", "uniform", "rare", "gridworld/uniform_rare"])
@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_gymnasium_checks_the_environment(
    level: str, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make(ID, level=level, observation=observation)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The checker also opens a window, which takes pygame.
        check_env(env.unwrapped, skip_render_check=not HAS_PYGAME)
        env = gym.make(ID, level=level, observation=observation, render_mode="rgb_array")
        env.reset(seed=0)
        env_render_passive_checker(env.unwrapped)


def test_make_vec_gives_the_native_batch() -> None:
    env = gym.make_vec(ID, num_envs=256, level="zipf_2", num_maps=10)
    assert isinstance(env, GridworldVectorEnv)
    assert env.num_envs == 256
    assert env.situation == {"map": 10, "target": 20}
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.spec is not None
    assert env.spec.id == ID


def test_the_id_brings_its_module() -> None:
    """`gym.make("zipf.envs:...")` needs no import of ours before it."""
    program = (
        "import gymnasium; env = gymnasium.make('zipf.envs:zipf/Gridworld-v0', level='rare');"
        "print(env.reset(seed=0)[1]['map'] >= 16)"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "True"


def test_envs_on_numpy_arrays_are_made_and_checked_without_torch() -> None:
    program = (
        "import sys, zipf.envs.testing; from zipf import envs;"
        "envs.make_vec('gridworld/rare', 2); envs.has_tensor(envs.split('gridworld'));"
        "print('torch' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": "zipf"}, "unknown level 'zipf'"),
        ({"level": "zipf_-1"}, "finite and >= 0"),
        ({"num_objects": 100}, "at most .* objects fit"),
        ({"num_objects": 300}, "only 225 different looks"),
        ({"num_objects": 200, "num_rooms": (9, 9)}, "up to about 90 objects"),
        ({"num_maps": 0}, "num_maps must be at least 1"),
        ({"num_rooms": (3,)}, r"num_rooms must be \(rows, columns\)"),
        ({"max_steps": 0}, "max_steps must be at least 1"),
        ({"observation": "pixels"}, "'image' or 'tiles', got 'pixels'"),
        ({"render_mode": "ansi"}, "render_mode must be one of"),
        ({"level": "rare", "num_maps": 4}, "num_maps must be at least 5 for level 'rare'"),
        ({"level": "rare", "num_objects": 3}, "num_objects must be at least 5.*got 3"),
        ({"max_steps": float("nan")}, "max_steps must be a whole number, got nan"),
        ({"max_steps": 10**20}, "max_steps must be at most"),
        ({"max_steps": True}, "max_steps must be a whole number"),
        ({"num_maps": 2.5}, "num_maps must be a whole number, got 2.5"),
        ({"num_maps": 10**9}, "num_maps must be at most 10000"),
        ({"num_maps": [3]}, "num_maps must be a whole number"),
        ({"num_rooms": "33"}, r"num_rooms must be \(rows, columns\)"),
        ({"num_rooms": 3}, r"num_rooms must be \(rows, columns\)"),
        ({"num_rooms": ([3], 3)}, "num_rooms must be a whole number"),
        ({"num_rooms": (1000, 1000)}, "maps of 1,000,000 rooms"),
        (
            {"num_rooms": (50, 50), "num_maps": 1},
            r"maps of 2,500 rooms; .*num_maps \* rooms \*\* 3",
        ),
        ({"room_size": (10**6, 10**6)}, "cells"),
        ({"num_objects": "20"}, "num_objects must be a whole number"),
        ({"level": 2}, "level must be a level's name"),
        ({"observation": ["image"]}, "observation must be"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str) -> None:
    for make in (GridworldEnv, GridworldVectorEnv):
        with pytest.raises(ValueError, match=message):
            make(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"map": 20}, "'map' must be an integer in 0 .. 19, got 20"),
        ({"target": -1}, "'target' must be an integer in 0 .. 19, got -1"),
        ({"target": 1.5}, "must be an integer"),
        ({"map": True}, "'map' must be an integer in 0 .. 19, got True"),
        ({"reset_mask": [True]}, r"unknown reset options \['reset_mask'\]: expected \['map', 't"),
        ({"goal": 1}, r"unknown reset options \['goal'\]: expected \['map', 'target'\]"),
    ],
)
def test_bad_reset_options_are_refused(options: dict[str, Any], message: str) -> None:
    env = GridworldEnv()
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_single_world_refuses_what_cannot_be_done() -> None:
    env = GridworldEnv(max_steps=1)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(0)
    env.reset(seed=0)
    for action in (-1, 8):
        with pytest.raises(ValueError, match=r"0 .. 7"):
            env.step(action)
    with pytest.raises(TypeError, match=r"the action must be an integer in 0 .. 7, got 1.0"):
        env.step(1.0)
    env.step(0)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(0)
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(0)):
        with pytest.raises(ClosedEnvironmentError, match="closed"):
            call()


def test_a_damaged_state_is_refused_before_anything_is_taken() -> None:
    env = GridworldVectorEnv(3)
    env.reset(seed=0)
    before = env.get_state()
    for column, value in ((0, 20), (1, -1), (2, 13), (3, 1000)):
        damaged = env.get_state()
        damaged["worlds"][1, column] = value
        damaged["lengths"] += 1
        with pytest.raises(ValueError, match="damaged"):
            env.set_state(damaged)
    for key, value in env.get_state().items():
        np.testing.assert_array_equal(value, before[key])


def test_a_state_with_an_agent_in_a_wall_is_refused() -> None:
    """From the outer wall a few steps lead off the board, where the kernels read other memory."""
    env = GridworldVectorEnv(2)
    unbegun = env.get_state()
    env.reset(seed=0)
    last = env.level.maps.boards.shape[1] - 1
    for cell in ((0, 0), (0, 5), (last, last), (5, last), (4, 4)):
        state = env.get_state()
        state["worlds"][1, 2:] = cell
        with pytest.raises(ValueError, match="an agent in a wall"):
            env.set_state(state)
    env.set_state(unbegun)  # envs that have not begun are at (0, 0), and cannot be stepped
    state = env.get_state()
    state["running"][:] = True
    with pytest.raises(ValueError, match="running that have not begun"):
        env.set_state(state)


def test_chance_of_very_long_episodes_is_known_at_once() -> None:
    long = zipf.envs.baseline("chance", "gridworld/uniform", max_steps=10**9)
    assert long is not None
    assert long.score == pytest.approx(1 / 20)  # every episode ends at one of 20 objects


# Rendering.


def test_frames_show_the_whole_map() -> None:
    env = gym.make(ID, level="uniform", render_mode="rgb_array")
    with pytest.raises(gym.error.ResetNeeded):
        env.unwrapped.render()
    env.reset(seed=0, options={"map": 0, "target": 2})
    first: Any = env.render()
    assert first.dtype == np.uint8
    assert first.shape == ((13 + 4) * 27, (13 + 4) * 27, 3)
    env.step(4)
    assert (env.render() != first).any()


def test_frames_of_a_batch_are_those_of_single_worlds() -> None:
    batch = GridworldVectorEnv(3, "uniform", render_mode="rgb_array")
    batch.reset(seed=4)
    frames = batch.render()
    assert frames is not None
    for i, given in enumerate(frames):
        single = GridworldEnv("uniform", render_mode="rgb_array")
        single.reset(seed=4 + i)
        np.testing.assert_array_equal(given, single.render())
    assert GridworldVectorEnv(3).render() is None


def test_frames_mark_target_agent_and_view() -> None:
    maps = GridworldEnv().level.maps
    row, column = maps.cells[0, -1].tolist()
    drawn = frame(maps, 0, 0, row, column)

    def cell(r: int, c: int) -> np.ndarray:
        return drawn[(r + 2) * 27 : (r + 3) * 27, (c + 2) * 27 : (c + 3) * 27]

    assert (cell(row, column) == 255).all()
    goal_row, goal_column = maps.cells[0, 0].tolist()
    assert (drawn[(goal_row + 2) * 27 - 1, (goal_column + 2) * 27] == (255, 190, 60)).all()
    assert cell(6, 7).max() == 255  # pink, seen
    assert cell(1, 11).max() == 255 // 8 * 5  # pink, not seen


def test_a_window_takes_pygame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = GridworldEnv(render_mode="human")
    with pytest.raises(ImportError, match=r"\.\[human\]"):
        env.reset()


def test_a_window_takes_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if sys.platform == "linux":
        with pytest.raises(RuntimeError, match="needs a display"):
            GridworldEnv(render_mode="human").reset()


def test_a_window_shows_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    human, array = (GridworldEnv(render_mode=mode) for mode in ("human", "rgb_array"))
    for env in (human, array):
        env.reset(seed=0)
        env.step(0)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, array.render())
    human.close()


def test_windows_are_closed_with_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    first, second = (
        GridworldEnv(render_mode="human", num_rooms=(1, rooms), num_objects=2) for rooms in (2, 3)
    )
    for env in (first, second):
        env.reset(seed=0)
    second.step(0)
    first.step(0)  # a map of another size
    first.close()
    first.close()
    assert pygame.display.get_init()
    second.step(0)
    second.close()
    assert not pygame.display.get_init()
