"""Ten MiniGrid levels made Zipfian: the first is met most often, the last hardly ever."""

import minigrid  # noqa: F401  registers the levels with Gymnasium

import zipf.envs

LEVELS = [
    "MiniGrid-Empty-5x5-v0",
    "MiniGrid-Empty-Random-5x5-v0",
    "MiniGrid-Empty-6x6-v0",
    "MiniGrid-GoToDoor-5x5-v0",
    "MiniGrid-DoorKey-5x5-v0",
    "MiniGrid-LavaGapS5-v0",
    "MiniGrid-Fetch-5x5-N2-v0",
    "MiniGrid-SimpleCrossingS9N1-v0",
    "MiniGrid-Unlock-v0",
    "MiniGrid-DistShift1-v0",
]


def reached_the_goal(episode_return, terminated, info):
    """MiniGrid rewards an episode once, at its end, if the task was done."""
    return episode_return > 0


zipf.envs.register(
    zipf.envs.zipfian(
        LEVELS,
        exponent=1,
        name="minigrid_zipf",
        codes={"image": 11},  # the image holds codes of objects, colours and states, not pixels
        success=reached_the_goal,
    )
)
