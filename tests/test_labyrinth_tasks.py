"""Tasks in words: what instructions mean, how likely they are, and the maps they are for."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labyrinth_levels import batch

from zipf.envs.labyrinth import layouts
from zipf.envs.labyrinth.grids import distances
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.levels.language import LanguageEpisode, Task
from zipf.envs.labyrinth.levels.language_execute import KINDS
from zipf.envs.labyrinth.scenery import atlas
from zipf.envs.labyrinth.tasks import counts
from zipf.envs.labyrinth.words import COLOURS, SHAPES, VOCABULARY

LANGUAGE = [level for level in LEVELS if level.startswith("language")]
DESCRIBED, LOCATED, EXECUTE, ANSWER = LANGUAGE
ALL = pytest.mark.parametrize("level", LANGUAGE)


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
