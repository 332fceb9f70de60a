"""Frames per second of environments on one core, beside those that one would take instead.

    python scripts/benchmark_peers.py
    python scripts/benchmark_peers.py --rounds 5 --seconds 4 --match ViZDoom
    python scripts/benchmark_peers.py --release ../zipfian_environments

Actions are uniformly random, episodes begin anew when they end, and every frame comes with an image
of the size that the row names. Each row is a process on the same core; they are let go in turn,
`--seconds` of wall clock each, `--rounds` times over, while the others wait. Speeds are per CPU
second of a row's process and of the engine that it starts, so that other jobs on the machine
disturb less. A row's ratio is the median, over rounds, of the table's first row beside it.

Other libraries have virtual environments in `--environments`, made at the first run; zipf's rows
take the interpreter that runs this script. A frame is what an agent sees after an action: in the
playroom, the labyrinth and ViZDoom four steps of the simulation and one image. Envs are made
ready before anything is measured: those of a batch begin one after another over an episode's
length, so that resets have the share that they have in long runs.

The released gridworld is in no package index: `--release` is a clone of its repository, and its row
is left out without one. Its library needs a NumPy that Python 3.11 is the last to have.

MuJoCo draws with OpenGL: with EGL, unless the variable MUJOCO_GL names another way. Where EGL finds
no GPU, Mesa draws on the CPU.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import turns

PACKAGES = {
    "minigrid": ("minigrid==3.2.0",),
    "mujoco": ("gymnasium[mujoco]==1.4.0", "mujoco==4.0.0"),
    "procgen": ("procgen-mirror==0.10.7",),  # the release, built for later versions of Python
    "released": ("numpy==1.24.4", "pycolab==1.2", "dm-env==1.6", "absl-py==2.5.1"),
    "vizdoom": ("vizdoom==1.3.2",),
}
"""What pip installs for a row's library, in a virtual environment of that name."""


def zipf_batch(pause: turns.Pause, level: str, num_envs: int, steps: int, **options: Any) -> None:
    """Steps a batch of a level whose episodes have at most so many steps, into arrays kept."""
    import numpy as np

    from zipf import envs

    env = envs.make_vec(level, num_envs, **options)
    out = env.allocate()
    count = int(env.single_action_space.n)
    actions = cycle(np.random.default_rng(0).integers(count, size=(1024, num_envs)))
    env.reset(seed=0, out=out)
    everywhere = np.arange(num_envs)
    for number in range(steps):
        due = everywhere * steps // num_envs == number
        if due.any():
            env.reset(options={"reset_mask": due}, out=out)
        env.step(next(actions), out=out)
    while True:
        for _ in range(8):
            env.step(next(actions), out=out)
        pause(8 * num_envs)


def gymnasium_env(pause: turns.Pause, env: Any, look: Callable[[], Any] | None = None) -> None:
    """Steps one Gymnasium environment, and looks if its observations have no image."""
    env.action_space.seed(0)
    actions = cycle([env.action_space.sample() for _ in range(10_000)])
    env.reset(seed=0)
    while True:
        for _ in range(64):
            _, _, terminated, truncated, _ = env.step(next(actions))
            if terminated or truncated:
                env.reset()
            if look is not None:
                look()
        pause(64)


def zipf_alone(pause: turns.Pause, id: str, **options: Any) -> None:
    import gymnasium as gym

    import zipf.envs  # noqa: F401  registers them

    gymnasium_env(pause, gym.make(f"zipf/{id}", **options))


def minigrid(pause: turns.Pause) -> None:
    import gymnasium as gym
    from minigrid.wrappers import RGBImgPartialObsWrapper

    env = RGBImgPartialObsWrapper(gym.make("MiniGrid-FourRooms-v0"), tile_size=9)
    assert env.observation_space["image"].shape == (63, 63, 3)
    gymnasium_env(pause, env)


def released(pause: turns.Pause) -> None:
    import numpy as np
    from zipfian_environments.gridworld import zipfs_gridworld

    env = zipfs_gridworld.simple_builder("zipf_2")
    actions = cycle(np.random.default_rng(0).integers(8, size=10_000).tolist())
    env.reset()
    while True:
        for _ in range(64):
            if env.step(next(actions)).last():
                env.reset()
        pause(64)


def procgen(pause: turns.Pause, game: str, num_envs: int) -> None:
    import numpy as np
    from procgen import ProcgenEnv

    env = ProcgenEnv(num_envs=num_envs, env_name=game, num_threads=0)
    actions = cycle(np.random.default_rng(0).integers(15, size=(1024, num_envs)))
    env.reset()  # later resets are its own
    while True:
        for _ in range(8):
            env.step(next(actions))
        pause(8 * num_envs)


def vizdoom(pause: turns.Pause, scenario: str) -> None:
    import numpy as np
    import vizdoom

    game = vizdoom.DoomGame()
    game.load_config(os.path.join(vizdoom.scenarios_path, f"{scenario}.cfg"))
    game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)  # its smallest
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    game.set_window_visible(False)
    game.init()
    buttons = game.get_available_buttons_size()
    actions = cycle(np.random.default_rng(0).integers(2, size=(1024, buttons)).tolist())
    while True:
        for _ in range(64):
            if game.is_episode_finished():
                game.new_episode()
            game.make_action(next(actions), 4)
            game.get_state()
        pause(64)


def mujoco(pause: turns.Pause, model: str) -> None:
    os.environ.setdefault("MUJOCO_GL", "egl")
    import gymnasium as gym

    env = gym.make(model, render_mode="rgb_array", width=96, height=72)
    gymnasium_env(pause, env, env.render)


@dataclass(frozen=True)
class Entry:
    """A row: its name, its library, None being zipf, and what it does in its process."""

    name: str
    library: str | None
    work: Callable[[turns.Pause], None]


def batch(level: str, num_envs: int, steps: int, **options: Any) -> Entry:
    name = f"zipf {level.partition('/')[0]}, batch of {num_envs}"
    return Entry(name, None, lambda pause: zipf_batch(pause, level, num_envs, steps, **options))


def alone(id: str, **options: Any) -> Entry:
    name = f"zipf {id.partition('-')[0].lower()}, gym.make"
    return Entry(name, None, lambda pause: zipf_alone(pause, id, **options))


def three_dimensional(**options: Any) -> Iterator[Entry]:
    lift, maze = "playroom/lift/lift_shape_zipf3", "labyrinth/explore_goal_locations_small"
    yield batch(lift, 64, 900, **options)
    yield alone("Playroom-v1", level="lift/lift_shape_zipf3", **options)
    yield batch(maze, 64, 1350, **options)


TABLES = {
    "grids, images of 63 x 63 (Procgen 64 x 64)": (
        batch("gridworld/zipf_2", 256, 100),
        alone("Gridworld-v0", level="zipf_2"),
        Entry("the released gridworld", "released", released),
        Entry("MiniGrid FourRooms, gym.make", "minigrid", minigrid),
        Entry("Procgen coinrun, batch of 256", "procgen", lambda p: procgen(p, "coinrun", 256)),
        Entry("Procgen maze, batch of 256", "procgen", lambda p: procgen(p, "maze", 256)),
    ),
    "three dimensions, images of 96 x 72": (
        *three_dimensional(),
        Entry("MuJoCo InvertedPendulum", "mujoco", lambda p: mujoco(p, "InvertedPendulum-v5")),
        Entry("MuJoCo HalfCheetah", "mujoco", lambda p: mujoco(p, "HalfCheetah-v5")),
    ),
    "three dimensions, images of 160 x 120": (
        *three_dimensional(image_size=(120, 160)),
        Entry("ViZDoom basic", "vizdoom", lambda p: vizdoom(p, "basic")),
        Entry("ViZDoom my_way_home", "vizdoom", lambda p: vizdoom(p, "my_way_home")),
    ),
}
"""The rows by title of their table; the others are compared with its first."""


def release(folder: str) -> Path:
    """The clone of the released environments, which import themselves by the folder's name."""
    path = Path(folder).resolve()
    if path.name != "zipfian_environments" or not (path / "gridworld").is_dir():
        raise argparse.ArgumentTypeError(
            f"{folder} is no clone of the released environments in a folder zipfian_environments"
        )
    return path


def measure(title: str, arguments: argparse.Namespace) -> list[turns.Row]:
    """A table's rows, with their speeds by round."""
    entries = [
        entry
        for entry in TABLES[title]
        if (not entry.library or arguments.match in entry.name)
        and (entry.library != "released" or arguments.release)
    ]
    pythons: dict[str | None, Path | str] = {None: sys.executable}
    for name in dict.fromkeys(entry.library for entry in entries if entry.library):
        pythons[name] = turns.python_of(name, PACKAGES[name], arguments.environments)
    given = ["--release", str(arguments.release)] if arguments.release else []
    rows = [
        turns.Row(
            entry.name, pythons[entry.library], [__file__, *given, "--row", title, entry.name]
        )
        for entry in entries
    ]
    turns.measure(title, rows, arguments.rounds, arguments.seconds)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    turns.add_options(parser, seconds=4.0)
    parser.add_argument("--core", type=int, default=0, help="the core to run on, where possible")
    parser.add_argument("--release", type=release, help="a clone of zipfian_environments")
    parser.add_argument("--row", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.row:
        title, name = arguments.row
        if arguments.release:
            sys.path.insert(0, str(arguments.release.parent))
        (work,) = (entry.work for entry in TABLES[title] if entry.name == name)
        turns.serve(work, turns.cpu_seconds)
        return
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {arguments.core})
    for title in TABLES:
        turns.show(title, measure(title, arguments))
    print(f"one core, CPU seconds, {arguments.rounds} rounds of {arguments.seconds} s")


if __name__ == "__main__":
    main()
