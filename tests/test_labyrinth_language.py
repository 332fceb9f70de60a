"""The envs of the language levels: what is there, is said, is seen, and is rewarded."""

import math

import numpy as np
import pytest
from labyrinth_levels import batch

from zipf.envs.labyrinth import materials, patterns
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.levels.language import LanguageEpisode, Task
from zipf.envs.labyrinth.scenery import Scenery, atlas
from zipf.envs.labyrinth.state import YAW, make_envs
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.labyrinth.words import COLOURS, VOCABULARY
from zipf.envs.render3d import TILE_TEXTURE

LANGUAGE = [level for level in LEVELS if level.startswith("language")]
DESCRIBED, LOCATED, EXECUTE, ANSWER = LANGUAGE
ALL = pytest.mark.parametrize("level", LANGUAGE)
WAIT = 14


@ALL
def test_instructions_change_with_tasks_only(level: str) -> None:
    """And observations, `info` and the task say the same at any time."""
    env = batch(level, 6)
    observation, info = env.reset(seed=3)
    rng = np.random.default_rng(0)
    changed = 0
    for _ in range(300):
        before = [episode.task for episode in env.episodes]
        texts = info["instruction"].tolist()
        # Straight ahead for the most part, into objects.
        observation, _, terminated, truncated, info = env.step(rng.choice([0, 0, 0, 10, 12], 6))
        for i, episode in enumerate(env.episodes):
            assert info["instruction"][i] == episode.task.text
            assert (observation["instruction"][i] == VOCABULARY.encode(episode.task.text)).all()
            if episode.task is before[i]:
                assert info["instruction"][i] == texts[i]
            changed += episode.task is not before[i]
        assert not (terminated | truncated).any()
    assert changed > 6


def look_up(env: LabyrinthVectorEnv) -> tuple[LanguageEpisode, Task]:
    episode = env.episodes[0]
    assert isinstance(episode, LanguageEpisode)
    return episode, episode.task


@ALL
def test_the_world_shows_the_task(level: str) -> None:
    env = batch(level, 1)
    env.reset(seed=1)
    scenes = env._scenery.scenes
    yaws, starts = [], set()
    for _ in range(40):
        env._begin_map(0)
        episode, task = look_up(env)
        assert env.envs.present[0].sum() == sum(slot is not None for slot in task.places)
        assert not env.envs.zones[0].any()
        for item, number in episode.items.items():
            one, slot = task.objects[number], task.places[number]
            row, column = task.layout.slots[slot]
            assert env.envs.places[0, item, :2].tolist() == [column * 100 + 50, row * 100 + 50]
            assert atlas().names[env._scenery.shape[0, item]] == one.shape
            first, second = scenes.colours[0, item].astype(int)
            exact = np.array(patterns.rgb(one.colour, np.random.default_rng(0)))
            assert abs(first - exact).max() <= 9
            if one.pattern == "solid":
                assert scenes.pattern[0, item] == -1
                assert abs(second - patterns.SHADE * first).max() <= 1
            else:
                assert scenes.pattern[0, item] == materials.index(f"pattern_{one.pattern}")
                assert abs(second - patterns.rgb(one.colour2, np.random.default_rng(0))).max() <= 9
            scale = {"car": 0.8, "cassette": 0.95, "chair": 0.84, "cow": 0.81}.get(one.shape, 1)
            assert scenes.scale[0, item] == pytest.approx(scale)
        # Floors of regions, and nothing of the map before.
        tiles = scenes.tiles[0, : task.layout.solid.size].reshape(task.layout.solid.shape)
        for cell in np.argwhere(~task.layout.solid):
            letter = task.layout.region[tuple(cell)]
            name = task.theme.floors[letter] if letter else "corridor_floor"
            assert tiles[tuple(cell)] & TILE_TEXTURE == materials.index(name)
        assert (env.envs.cells[0] == task.layout.solid.shape).all()
        assert scenes.flat_count[0] == 1
        assert episode.world.cell in task.layout.starts
        starts.add((id(task.layout), episode.world.cell))
        yaws.append((env.envs.bodies[0, YAW] + math.pi) % (2 * math.pi) - math.pi)
    wide = np.degrees(np.abs(yaws).max())
    if level in (DESCRIBED, ANSWER):
        assert 7 < wide <= 10
        assert len(starts) == (1 if level == DESCRIBED else 2)
    else:
        assert wide > 140
        assert len(starts) > 10


def take(env: LabyrinthVectorEnv, number: int) -> float:
    """Puts the player on an object, waits a step, and returns the reward."""
    episode, _ = look_up(env)
    item = next(item for item, found in episode.items.items() if found == number)
    env.envs.bodies[0, :3] = env.envs.places[0, item]
    env.envs.bodies[0, 3:6] = 0.0
    return float(env.step(np.full(1, WAIT))[1][0])


@pytest.mark.parametrize("level", [DESCRIBED, LOCATED, ANSWER])
def test_one_choice_ends_a_task(level: str) -> None:
    env = batch(level, 1)
    env.reset(seed=0)
    for k in range(20):
        _, task = look_up(env)
        (goal,) = task.judge.goals
        wrong = 1 - goal  # the second object, or the other ball
        assert take(env, goal if k % 2 else wrong) == (10 if k % 2 else task.judge.wrong)
        assert look_up(env)[1] is not task


@pytest.mark.parametrize(
    ("level", "least", "most"),
    [(DESCRIBED, -2.0, 2.0), (LOCATED, -2.0, 2.0), (EXECUTE, 2.0, 4.5), (ANSWER, 3.5, 6.5)],
)
def test_what_objects_betray_without_the_instruction(level: str, least: float, most: float) -> None:
    """The mean reward of the first choice of who cannot read, over 400 tasks. Goals have
    the first numbers: who chose by these would have it all."""
    env = batch(level, 1)
    env.reset(seed=0)
    total = 0.0
    for _ in range(400):
        env._begin_map(0)
        episode, task = look_up(env)
        there = sorted((number for _, number in episode._there()), key=episode._slot)
        total += task.judge.take(episode.likeliest(there))[0]
    assert least < total / 400 < most


def test_every_goal_has_to_be_taken() -> None:
    env = batch(EXECUTE, 1)
    env.reset(seed=0)
    done = 0
    while done < 6:
        clock = env.envs.clock[0]
        env._begin_map(0)
        assert env.envs.clock[0] == clock
        _, task = look_up(env)
        if not task.text.startswith("Every"):
            continue
        *first, last = sorted(task.judge.goals)
        for goal in first:
            assert take(env, goal) == 1
            assert look_up(env)[1] is task
        if done % 2:
            assert take(env, last) == 11
        else:
            assert take(env, len(task.objects) - 1) == task.judge.wrong < 0
        assert look_up(env)[1] is not task
        done += 1


def test_objects_of_questions_are_walked_through() -> None:
    env = batch(ANSWER, 1)
    env.reset(seed=0)
    _, task = look_up(env)
    shown = [k for k in range(2, len(task.objects)) if task.places[k] is not None]
    for number in shown:
        assert take(env, number) == 0
        assert look_up(env)[1] is task
    row, column = task.layout.slots[1]
    env.envs.bodies[0, :2] = (column - 2) * 100 + 50, row * 100 + 50
    env.envs.bodies[0, 3:] = 0.0
    for _ in range(20):
        env.step(np.zeros(1, np.int64))
    assert env.envs.bodies[0, 0] > column * 100 + 100
    assert look_up(env)[1] is task


# Pictures.


@pytest.mark.parametrize("word", COLOURS)
def test_a_floor_shows_its_colour(word: str) -> None:
    """Nearest to it of all floors with a word, wherever one looks at it from."""
    env = batch(LOCATED, 1, image_size=(36, 48))
    env.reset(seed=0)
    task = look_up(env)[1]
    while f"floor_{word}" not in task.theme.floors.values():
        env._begin_map(0)
        task = look_up(env)[1]
    letter = next(key for key, name in task.theme.floors.items() if name == f"floor_{word}")
    row, column = np.argwhere(task.layout.region == letter).mean(0) + 0.5
    env.envs.bodies[0, :2] = column * 100, row * 100
    env.envs.present[0] = False
    references = np.array([patterns.FLOORS[colour] for colour in COLOURS], float)
    references /= np.linalg.norm(references, axis=1, keepdims=True)
    for yaw in np.arange(4) * math.pi / 2:
        env.envs.bodies[0, YAW] = yaw
        lowest = env.observations()["image"][0, -4:].reshape(-1, 3).astype(float)
        lowest /= np.linalg.norm(lowest, axis=1, keepdims=True)
        assert ((lowest @ references.T).argmax(1) == COLOURS.index(word)).all()


def test_patterns_can_be_told_apart() -> None:
    """For each shape that has them, from as far away as the nearest slots are."""
    count = len(patterns.PATTERNS)
    envs = make_envs(count)
    scenery = Scenery(envs, 96, 72)
    for shape in ("cake", "car", "cassette", "hat", "tv"):
        envs.present[:, 0], envs.places[:, 0] = True, (200, 0, 24)
        scenery.shape[:, 0] = atlas().index(shape)
        scenery.scenes.colours[:, 0] = (255, 0, 0), (0, 0, 255)
        for i, name in enumerate(patterns.PATTERNS[1:], 1):
            scenery.scenes.pattern[i, 0] = materials.index(f"pattern_{name}")
        envs.bodies[:, 2] = 24
        images = np.zeros((count, 72, 96, 3), np.uint8)
        scenery.draw(images, np.ones(count, np.bool_))
        envs.present[:, 0] = False
        empty = images.copy()
        scenery.draw(empty, np.ones(count, np.bool_))
        there = (images[0] != empty[0]).any(-1)
        assert ((images != empty).any(-1) == there).all()
        for i in range(count):
            for j in range(i):
                off = abs(images[i].astype(int) - images[j]).max(-1)[there]
                assert (off > 25).mean() > 0.15, (shape, patterns.PATTERNS[i], patterns.PATTERNS[j])
