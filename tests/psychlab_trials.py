"""What the tests of the psychlab levels share."""

from typing import Any

import numpy as np
import pytest
from labyrinth_levels import batch

from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.levels.psychlab import Psychlab
from zipf.envs.labyrinth.levels.psychlab_comparison import (
    SequentialComparison,
)
from zipf.envs.labyrinth.scenery import SCREEN_PIXELS
from zipf.envs.labyrinth.screen import Place
from zipf.envs.labyrinth.state import PITCH, YAW
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv

NAMES = [name for name in LEVELS if name.startswith("psychlab")]
MAPPING, RECOGNITION, COMPARISON, SEARCH = NAMES
ALL = pytest.mark.parametrize("level", NAMES)
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


def begin(level: str, seed: int = 0, **options: Any) -> tuple[LabyrinthVectorEnv, Any]:
    """An env whose steps are single frames, and its episode."""
    options = {"action_repeat": 1, "autoreset_mode": "Disabled", **options}
    env = batch(level, 1, **options)
    env.reset(seed=seed)
    return env, env.episodes[0]


def wait(env: LabyrinthVectorEnv) -> float:
    return float(env.step(np.full(env.num_envs, 14))[1][0])


def turn_to(env: LabyrinthVectorEnv, episode: Psychlab, place: Place) -> None:
    x, y = (place[0] + place[2]) / 2, (place[1] + place[3]) / 2
    env.envs.bodies[0, [YAW, PITCH]] = episode.screen.direction(x, y)


def look(env: LabyrinthVectorEnv, episode: Psychlab, place: Place) -> float:
    """The reward of a frame in which the player looks at a place."""
    turn_to(env, episode, place)
    return wait(env)


def colour(env: LabyrinthVectorEnv, place: Place) -> tuple[int, ...]:
    """What the screen shows in the middle of a place."""
    x, y = (place[0] + place[2]) / 2, (place[1] + place[3]) / 2
    pixel = env._scenery.scenes.screen[0, int(SCREEN_PIXELS * y), int(SCREEN_PIXELS * x), :3]
    return tuple(pixel.tolist())


def empty(env: LabyrinthVectorEnv) -> bool:
    return bool((env._scenery.scenes.screen[0] == 255).all())


def answer(episode: Any, right: bool) -> None:
    """Plays a trial by the rules alone, without frames."""
    episode.looked_at(0)
    if isinstance(episode, SequentialComparison):
        episode.looked_at(0)
        episode.looked_away(0)
        episode.went_off()
    give(episode, episode.right if right else episode.right - 1)


def give(episode: Any, button: int) -> None:
    """Answers a trial by the rules alone; the next mark appears, unless it was the last."""
    episode.looked_at(button % len(episode.buttons))
    episode.looked_away(button % len(episode.buttons))
    if episode.done < episode.trials:
        episode.went_off()
