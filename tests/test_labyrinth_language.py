"""The language levels: what instructions say is what is there, and is rewarded."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labyrinth_levels import batch

from zipf.envs.labyrinth import layouts, looks, patterns
from zipf.envs.labyrinth.grids import distances
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.levels.language import LanguageEpisode, Task
from zipf.envs.labyrinth.levels.language_execute import KINDS
from zipf.envs.labyrinth.scenery import Scenery, atlas
from zipf.envs.labyrinth.state import YAW, make_worlds
from zipf.envs.labyrinth.tasks import counts, counts_up_to
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv
from zipf.envs.labyrinth.words import COLOURS, SHAPES, VOCABULARY

LANGUAGE = [level for level in LEVELS if level.startswith("language")]
DESCRIBED, LOCATED, EXECUTE, ANSWER = LANGUAGE
ALL = pytest.mark.parametrize("level", LANGUAGE)
WAIT = 14


def episode_of(level: str, seed: int = 0) -> LanguageEpisode:
    env = batch(level, 1)
    env.reset(seed=seed)
    episode = env.episodes[0]
    assert isinstance(episode, LanguageEpisode)
    return episode


def tasks(level: str, count: int, seed: int = 0) -> list[Task]:
    episode, rng = episode_of(level), np.random.default_rng(seed)
    return [episode.draw(rng) for _ in range(count)]


def rooms(task: Task) -> list[str | None]:
    """The region of each object's slot."""
    return [None if slot is None else task.layout.slot_regions[slot] for slot in task.places]


def meant(task: Task) -> set[int]:
    """The objects that an instruction is about, read word by word."""
    words, where = task.text.split(), rooms(task)
    there = {k: one for k, one in enumerate(task.objects) if where[k] is not None}

    def are(*said: str) -> set[int]:
        return {k for k, one in there.items() if {one.colour, one.shape} >= set(said)}

    if words[0] == "Pick":
        assert (words[1], words[3:6], words[7]) == ("the", ["object", "in", "the"], "room")
        floors = {letter: name for letter, name in task.theme.floors.items()}
        return {k for k in are(words[2]) if floors[where[k]] == f"floor_{words[6]}"}
    if words[0] == "Every":
        return are(words[1])
    if words[0] in ("Are", "Is"):
        return {0 if answer(task) else 1}
    if "near" in words:
        this, that = (text.removesuffix(" object") for text in task.text.split(" near "))
        return {k for k in are(this) if any(where[k] == where[j] for j in are(that) - {k})}
    return are(*words)


def answer(task: Task) -> bool:
    """The answer to a question about the objects that are shown."""
    words = task.text.removesuffix("?").split()
    shown = [one for one, slot in zip(task.objects[2:], task.places[2:], strict=True)
             if slot is not None]  # fmt: skip
    assert len(shown) == 4
    colour = words[-1]
    if words[1] in ("all", "most"):
        shown = [one for one in shown if one.shape == words[2]]
        share = [one.colour == colour for one in shown]
        return all(share) if words[1] == "all" else sum(share) > len(share) / 2
    if words[1] == "any":
        return any((one.shape, one.colour) == (words[2], colour) for one in shown)
    return any(one.colour == colour for one in shown)


# Words.


def test_the_vocabulary_is_that_of_the_original() -> None:
    words = set(VOCABULARY.words)
    assert len(words) == 66
    assert len(SHAPES) == 40
    assert set(SHAPES) <= set(atlas().names)
    assert COLOURS == ("red", "green", "blue", "cyan", "magenta", "yellow")
    functions = words - set(SHAPES) - set(COLOURS) - {f"{colour}?" for colour in COLOURS}
    text = "Pick the object in room Every near Are all objects Is any anything most"
    assert functions == set(text.split())


@ALL
def test_instructions_are_in_the_vocabulary(level: str) -> None:
    texts = {task.text for task in tasks(level, 400)}
    for text in texts:
        assert VOCABULARY.decode(VOCABULARY.encode(text)) == text
    assert max(len(text.split()) for text in texts) == {DESCRIBED: 1, LOCATED: 8, EXECUTE: 5,
                                                        ANSWER: 5}[level]  # fmt: skip


# Generators.


@ALL
def test_instructions_mean_the_goals_and_nothing_else(level: str) -> None:
    for task in tasks(level, 1500):
        if level == DESCRIBED:
            assert [one.shape for one in task.objects].count(task.text) == 1
        assert meant(task) == task.judge.goals
        taken = [slot for slot in task.places if slot is not None]
        assert len(set(taken)) == len(taken)
        assert set(taken) <= set(range(len(task.layout.slots)))


@given(st.data())
def test_counts_keep_to_their_limits(data: st.DataObject) -> None:
    least = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=4))
    total = data.draw(st.integers(sum(least), sum(least) + 6))
    most = [data.draw(st.none() | st.integers(one, 6)) for one in least]
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    if sum(total if one is None else one for one in most) < total:
        with pytest.raises(ValueError, match="no sizes from"):
            counts(total, least, rng, most)
        return
    sizes = counts(total, least, rng, most)
    assert sum(sizes) == total
    for size, low, high in zip(sizes, least, most, strict=True):
        assert low <= size <= (total if high is None else high)


def test_counts_are_random() -> None:
    rng = np.random.default_rng(0)
    drawn = Counter(tuple(counts(4, (0, 0, 0), rng)) for _ in range(2000))
    assert len(drawn) == 15
    totals = Counter(sum(counts_up_to(8, (2, 2), rng)) for _ in range(2000))
    assert set(totals) == {4, 5, 6, 7, 8}
    assert min(totals.values()) > 320


def test_described_objects_are_of_all_looks() -> None:
    drawn = tasks(DESCRIBED, 1500)
    for task in drawn:
        goal, other = task.objects
        assert goal.shape != other.shape
        assert (task.judge.right, task.judge.wrong) == (10, -10)
    seen = [one for task in drawn for one in task.objects]
    assert {one.shape for one in seen} == {"cake", "car", "cassette", "hat", "tv"}
    for attribute, count in (("colour", 13), ("colour2", 13), ("pattern", 9)):
        found = Counter(getattr(one, attribute) for one in seen)
        assert len(found) == count
        assert min(found.values()) > 0.7 * 3000 / count
    places = Counter(tuple(task.places) for task in drawn)
    assert len(places) == 12
    assert min(places.values()) > 80


def test_located_objects_are_as_described() -> None:
    """All slots are filled, and the goal's colour is in another room, too."""
    drawn = tasks(LOCATED, 2000)
    for task in drawn:
        count = len(task.layout.slots)
        assert sorted(task.places) == list(range(count))
        floors = list(task.theme.floors.values())
        assert len(set(floors)) == len(floors) == count // 2
        assert {floor.removeprefix("floor_") for floor in floors} <= set(COLOURS)
        goal, *others = task.objects
        assert goal.colour in [one.colour for one in others]
        assert task.judge.wrong == {4: -3, 8: -1, 12: -1}[count]
        assert task.judge.right == 10
    sizes = Counter(id(task.layout) for task in drawn)
    shares = [sizes[id(one)] / 2000 for one in (layouts.TWO_AREAS, layouts.TWO_ROOMS,
                                                layouts.FOUR_ROOMS, layouts.SIX_ROOMS)]  # fmt: skip
    np.testing.assert_allclose(shares, 0.25, atol=0.04)
    assert {one.shape for task in drawn for one in task.objects} == set(SHAPES)


def test_tasks_to_execute_are_as_likely_as_described() -> None:
    """By instruction, number of objects and wrong choice's reward, of nineteen."""
    expected = Counter(
        {
            ("pick", 2, -5): 2, ("pick", 4, -3): 1, ("pick", 6, -1): 1,
            ("pick both", 2, -5): 2, ("pick both", 4, -2): 1, ("pick both", 6, -1): 1,
            ("every", 2, -6): 4, ("every", 4, 0): 2,
            ("near", 2, -3): 2, ("near", 4, -1): 3,
        }
    )  # fmt: skip
    sizes = {3: (2, "pick"), 5: (4, "pick"), 9: (6, "pick"),
             7: (4, "pick both"), 11: (6, "pick both")}  # fmt: skip
    drawn: Counter[tuple[str, int, int]] = Counter()
    every = set()
    for task in tasks(EXECUTE, 5000):
        slots, count = len(task.layout.slots), len(task.objects)
        wrong = task.judge.wrong
        if "near" in task.text:
            kind = "near", slots // 2, wrong
            assert count == slots
        elif "Every" in task.text:
            goals = len(task.judge.goals)
            assert wrong == -math.floor((goals + 10) / (count - goals) + 0.5)
            kind = "every", slots // 2, wrong if slots == 4 else 0
            if slots == 8:
                every.add((count, goals))
        else:
            number, name = sizes[count]
            both = len({one.colour for one in task.objects}) < count and count == 3
            alike = any(one.colour == task.objects[0].colour for one in task.objects[1:])
            assert number == slots // 2
            kind = ("pick both" if count == 3 and both and alike else name), number, wrong
        drawn[kind] += 1
    assert set(drawn) == set(expected)
    for kind, weight in expected.items():
        assert drawn[kind] / 5000 == pytest.approx(weight / 19, abs=0.02), kind
    assert every == {(n, g) for n in range(4, 9) for g in range(2, n - 1)}
    assert sum(kind.weight for kind in KINDS) == 19


def test_questions_are_as_likely_as_their_answers() -> None:
    drawn = tasks(ANSWER, 4000)
    yes: dict[str, list[bool]] = {}
    for task in drawn:
        assert {0, 1} > task.judge.goals
        assert (task.judge.right, task.judge.wrong) == (10, -10)
        words = task.text.split()
        yes.setdefault(" ".join(words[:2]), []).append(0 in task.judge.goals)
        assert rooms(task)[:2] == ["A", "B"]
        assert {room for room in rooms(task)[2:] if room} == {"D"}
    assert set(yes) == {"Are all", "Is any", "Is anything", "Are most"}
    for question, answers in yes.items():
        assert len(answers) == pytest.approx(1000, abs=120), question
        assert np.mean(answers) == pytest.approx(0.5, abs=0.06), question


# Maps.


@pytest.mark.parametrize(
    ("layout", "starts", "slots"),
    [
        (layouts.TWO_AREAS, 2, 4),
        (layouts.TWO_ROOMS, 2, 4),
        (layouts.FOUR_ROOMS, 4, 8),
        (layouts.SIX_ROOMS, 6, 12),
    ],
)
def test_every_region_has_two_slots(layout: layouts.Layout, starts: int, slots: int) -> None:
    assert (len(layout.starts), len(layout.slots)) == (starts, slots)
    assert set(Counter(layout.slot_regions).values()) == {2}
    assert len(layout.regions) == slots // 2
    reach = distances(layout.solid, *layout.starts[0])
    assert ((reach >= 0) == ~layout.solid).all()
    # As one reads: from the north, which has the highest row, then from the west.
    assert list(layout.slots) == sorted(layout.slots, key=lambda cell: (-cell[0], cell[1]))
    assert all(layout.region[cell] for cell in layout.slots)


def test_the_alcoves_of_answers() -> None:
    layout = tasks(ANSWER, 1)[0].layout
    text = ["".join("*" if solid else region or "." for solid, region in zip(*row, strict=True))
            for row in zip(layout.solid[::-1], layout.region[::-1], strict=True)]  # fmt: skip
    assert text == ["********", "*CCCCCA*", "*CCCDD**", "*CCCDD**", "*CCCCCB*", "********"]
    assert layout.slot_regions == ("A", "D", "D", "D", "D", "B")


# Worlds.


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
        assert env.worlds.present[0].sum() == sum(slot is not None for slot in task.places)
        assert not env.worlds.zones[0].any()
        for item, number in episode.items.items():
            one, slot = task.objects[number], task.places[number]
            row, column = task.layout.slots[slot]
            assert env.worlds.places[0, item, :2].tolist() == [column * 100 + 50, row * 100 + 50]
            assert atlas().names[env._scenery.shape[0, item]] == one.shape
            first, second = scenes.colours[0, item].astype(int)
            exact = np.array(patterns.rgb(one.colour, np.random.default_rng(0)))
            assert abs(first - exact).max() <= 9
            if one.pattern == "solid":
                assert scenes.pattern[0, item] == -1
                assert abs(second - patterns.SHADE * first).max() <= 1
            else:
                assert scenes.pattern[0, item] == looks.index(f"pattern_{one.pattern}")
                assert abs(second - patterns.rgb(one.colour2, np.random.default_rng(0))).max() <= 9
            scale = {"car": 0.8, "cassette": 0.95, "chair": 0.84, "cow": 0.81}.get(one.shape, 1)
            assert scenes.scale[0, item] == pytest.approx(scale)
        # Floors of regions, and nothing of the map before.
        tiles = scenes.tiles[0, : task.layout.solid.size].reshape(task.layout.solid.shape)
        for cell in np.argwhere(~task.layout.solid):
            letter = task.layout.region[tuple(cell)]
            name = task.theme.floors[letter] if letter else "corridor_floor"
            assert tiles[tuple(cell)] == looks.index(name)
        assert (env.worlds.cells[0] == task.layout.solid.shape).all()
        assert scenes.flat_count[0] == 1
        assert episode.world.cell in task.layout.starts
        starts.add((id(task.layout), episode.world.cell))
        yaws.append((env.worlds.bodies[0, YAW] + math.pi) % (2 * math.pi) - math.pi)
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
    env.worlds.bodies[0, :3] = env.worlds.places[0, item]
    env.worlds.bodies[0, 3:6] = 0.0
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


def test_every_goal_has_to_be_taken() -> None:
    env = batch(EXECUTE, 1)
    env.reset(seed=0)
    done = 0
    while done < 6:
        clock = env.worlds.clock[0]
        env._begin_map(0)
        assert env.worlds.clock[0] == clock
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
    env.worlds.bodies[0, :2] = (column - 2) * 100 + 50, row * 100 + 50
    env.worlds.bodies[0, 3:] = 0.0
    for _ in range(20):
        env.step(np.zeros(1, np.int64))
    assert env.worlds.bodies[0, 0] > column * 100 + 100
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
    env.worlds.bodies[0, :2] = column * 100, row * 100
    env.worlds.present[0] = False
    references = np.array([patterns.FLOORS[colour] for colour in COLOURS], float)
    references /= np.linalg.norm(references, axis=1, keepdims=True)
    for yaw in np.arange(4) * math.pi / 2:
        env.worlds.bodies[0, YAW] = yaw
        lowest = env.observations()["image"][0, -4:].reshape(-1, 3).astype(float)
        lowest /= np.linalg.norm(lowest, axis=1, keepdims=True)
        assert ((lowest @ references.T).argmax(1) == COLOURS.index(word)).all()


def test_patterns_can_be_told_apart() -> None:
    """For each shape that has them, from as far away as the nearest slots are."""
    count = len(patterns.PATTERNS)
    worlds = make_worlds(count)
    scenery = Scenery(worlds, 96, 72)
    for shape in ("cake", "car", "cassette", "hat", "tv"):
        worlds.present[:, 0], worlds.places[:, 0] = True, (200, 0, 24)
        scenery.shape[:, 0] = atlas().index(shape)
        scenery.scenes.colours[:, 0] = (255, 0, 0), (0, 0, 255)
        for i, name in enumerate(patterns.PATTERNS[1:], 1):
            scenery.scenes.pattern[i, 0] = looks.index(f"pattern_{name}")
        worlds.bodies[:, 2] = 24
        images = np.zeros((count, 72, 96, 3), np.uint8)
        scenery.draw(images, np.ones(count, np.bool_))
        worlds.present[:, 0] = False
        empty = images.copy()
        scenery.draw(empty, np.ones(count, np.bool_))
        there = (images[0] != empty[0]).any(-1)
        assert ((images != empty).any(-1) == there).all()
        for i in range(count):
            for j in range(i):
                off = abs(images[i].astype(int) - images[j]).max(-1)[there]
                assert (off > 25).mean() > 0.15, (shape, patterns.PATTERNS[i], patterns.PATTERNS[j])
