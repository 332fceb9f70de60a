"""The psychlab levels: the rules of trials."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labyrinth_levels import batch, play_out
from psychlab_trials import (
    ALL,
    BLACK,
    COMPARISON,
    MAPPING,
    RECOGNITION,
    SEARCH,
    WHITE,
    answer,
    begin,
    colour,
    empty,
    give,
    look,
    wait,
)

from zipf.envs.labyrinth import pictures
from zipf.envs.labyrinth.levels.psychlab import CENTRE, LEFT, RIGHT, Psychlab, Staircase
from zipf.envs.labyrinth.levels.psychlab_comparison import (
    BUTTON_STARTS,
    CELLS,
    COLOURS,
    DELAYS,
    DOMAINS,
    SQUARE,
    SequentialComparison,
)
from zipf.envs.labyrinth.levels.psychlab_memory import (
    BUTTONS,
    ArbitraryVisuomotorMapping,
    ContinuousRecognition,
)
from zipf.envs.labyrinth.levels.psychlab_search import LADDER, PRESENT, SHAPES
from zipf.envs.labyrinth.state import PITCH, YAW
from zipf.envs.labyrinth.vector import LabyrinthVectorEnv

# What trials have in common.


@ALL
def test_a_trial_from_the_mark_to_the_next(level: str) -> None:
    env, episode = begin(level)
    corner = (0.475, 0.42, 0.525, 0.47)  # on the mark, but not in its middle
    assert colour(env, (0.5, 0.45, 0.5, 0.47)) == (255, 0, 0)
    assert look(env, episode, corner) == 0
    assert episode.fixating
    assert look(env, episode, CENTRE) == 0
    assert not episode.fixating
    assert colour(env, (0.5, 0.45, 0.5, 0.47)) != (255, 0, 0)
    if level == COMPARISON:
        look(env, episode, episode.button)
        look(env, episode, CENTRE)
        while episode.phase == "delay":
            assert empty(env)
            wait(env)
    button = episode.buttons[episode.right]
    for _ in range(3):  # nothing is paid while it is looked at
        assert look(env, episode, button) == 0
        assert colour(env, button) == (100, 255, 100)
    assert look(env, episode, (0.7, 0.6, 0.75, 0.65)) == 1
    assert empty(env)
    assert episode.done == 1
    assert not episode.fixating
    assert wait(env) == 0  # the next frame
    assert episode.fixating
    assert colour(env, (0.5, 0.45, 0.5, 0.47)) == (255, 0, 0)


@ALL
def test_wrong_answers_pay_nothing(level: str) -> None:
    env, episode = begin(level)
    look(env, episode, CENTRE)
    if level == COMPARISON:
        look(env, episode, episode.button)
        look(env, episode, CENTRE)
        while episode.phase == "delay":
            wait(env)
    wrong = episode.buttons[episode.right - 1]
    assert look(env, episode, wrong) == 0
    assert colour(env, wrong) == (255, 100, 100)
    right = episode.buttons[episode.right]
    assert colour(env, right) == ((100, 255, 100) if level == MAPPING else BLACK)
    assert look(env, episode, CENTRE) == 0
    assert episode.done == 1


def test_one_frame_on_a_button_is_enough() -> None:
    """Within the four frames of a large turn, the gaze enters and leaves the button."""
    env, episode = begin(RECOGNITION, action_repeat=4)
    look(env, episode, CENTRE)
    side, turn = (1, "left") if episode.right == ContinuousRecognition.NEW else (-1, "right")
    env.envs.bodies[0, [YAW, PITCH]] = math.pi / 2 + side * math.radians(16.5), 0.0
    reward = env.step(np.array([6 if turn == "left" else 7]))[1][0]
    assert reward == 1
    assert episode.done == 1


@ALL
def test_the_last_trial_ends_the_episode(level: str) -> None:
    env, episode = begin(level)
    trials = 80 if level == SEARCH else 60
    assert episode.trials == trials
    for _ in range(trials):
        assert env.envs.ending[0] < 0
        answer(episode, right=True)
    assert episode.done == trials
    env.envs.timer[:] = -1  # what no frame has seen
    for frame in range(13):  # that of the answer, which was given between frames here, and 12
        _, _, terminated, truncated, _ = env.step(np.array([14]))
        assert (bool(terminated[0]), bool(truncated[0])) == (frame == 12, False)
        assert empty(env)


class SlowStaircase:
    """As the description has it: a block of K answers is judged when it is complete."""

    def __init__(self, answers: list[bool]) -> None:
        self.levels = [1]
        level, block = 1, []
        for correct in answers:
            block.append(correct)
            if len(block) == level:
                if all(block):
                    level += 1
                elif sum(block) <= math.floor(level / 2):
                    level = max(level - 1, 1)
                block = []
            self.levels.append(level)


@given(st.lists(st.booleans(), max_size=200), st.integers(0, 80))
def test_the_staircase(answers: list[bool], right_at_first: int) -> None:
    answers = [True] * right_at_first + answers
    staircase = Staircase()
    levels = [1]
    for correct in answers:
        staircase.count(correct)
        levels.append(staircase.level)
    assert levels == SlowStaircase(answers).levels


# The mapping.


def test_a_pair_tells_its_response_at_first_only() -> None:
    env, episode = begin(MAPPING)
    seen: set[int] = set()
    for _ in range(25):
        episode.looked_at(0)
        first = episode.pair not in seen
        seen.add(episode.pair)
        for button, place in enumerate(BUTTONS):
            dull = (100, 200, 100) if button == episode.right else (200, 100, 100)
            assert colour(env, place) == (dull if first else BLACK)
        shown = env._scenery.scenes.screen[0, 16:112, 16:112]
        assert (shown == pictures.draw(int(episode.pictures[episode.pair]), 96)).all()
        assert episode.right == episode.responses[episode.pair]
        episode.looked_at(episode.right - 1)
        for button, place in enumerate(BUTTONS):
            bright = (100, 255, 100) if button == episode.right else (255, 100, 100)
            assert colour(env, place) == bright
        episode.looked_away(episode.right if len(seen) < 4 else episode.right - 1)
        episode.went_off()
    assert len(seen) > 3


def test_pairs_are_added_after_blocks_without_errors() -> None:
    _, episode = begin(MAPPING, seed=3)
    rng = np.random.default_rng(0)
    size = 1
    while episode.done < 55:
        pairs, perfect = [], True
        for _ in range(size):
            right = bool(rng.random() < 0.85)
            answer(episode, right)
            pairs.append(episode.pair)
            perfect &= right
            if episode.done >= 60:
                break
        else:
            assert sorted(pairs) == list(range(size))  # each once
        assert episode.size == size
        size += perfect
    assert size > 4


def test_pairs_are_drawn_evenly() -> None:
    responses, chosen, orders = Counter(), Counter(), set()
    env = batch(MAPPING, 60)
    env.reset(seed=0)
    for episode in env.episodes:
        assert isinstance(episode, ArbitraryVisuomotorMapping)
        assert len(set(episode.pictures.tolist())) == 60
        responses.update(episode.responses.tolist())
        chosen.update((episode.pictures // 600).tolist())
        for _ in range(6):
            answer(episode, right=True)
            if episode.size == 3:
                orders.add((episode.pair, *episode.block))
    expected = 60 * 60 / 4
    for counts in (responses, chosen):
        assert sorted(counts) == [0, 1, 2, 3]
        assert all(abs(count - expected) < 130 for count in counts.values())
    assert len({order for order in orders if len(order) == 3}) == 6


# Recognition.


def test_half_of_the_pictures_are_old() -> None:
    old, back = [], Counter()
    env = batch(RECOGNITION, 40)
    env.reset(seed=0)
    for episode in env.episodes:
        assert isinstance(episode, ContinuousRecognition)
        seen: list[int] = []
        for trial in range(60):
            episode.looked_at(0)
            assert (episode.right == ContinuousRecognition.OLD) == (episode.picture in seen)
            if trial == 0:
                assert episode.right == ContinuousRecognition.NEW
            else:
                old.append(episode.picture in seen)
            if episode.picture in seen:
                back[4 * seen.index(episode.picture) // len(seen)] += len(seen) >= 8
            else:
                seen.append(episode.picture)
            give(episode, 0)
        assert len(set(episode.pictures.tolist())) == 60
    assert np.mean(old) == pytest.approx(0.5, abs=0.04)
    total = sum(back.values())
    assert all(abs(back[k] / total - 0.25) < 0.06 for k in range(4))


# Comparison.


def trials_of(level: str, count: int, right: float = 0.9) -> Any:
    """Episodes at the trials that are to be answered, of a player who is mostly right."""
    rng = np.random.default_rng(0)
    seed = done = 0
    while done < count:
        env, episode = begin(level, seed=seed)
        seed += 1
        for _ in range(episode.trials):
            episode.looked_at(0)
            yield env, episode
            done += 1
            if level == COMPARISON:
                episode.looked_at(0)
                episode.looked_away(0)
                episode.went_off()
            give(episode, episode.right if rng.random() < right else 1 - episode.right)


def test_arrays_of_figures() -> None:
    assert len(CELLS) == 49 - 16
    assert not {(x, y) for x in (12, 20, 36, 44) for y in (12, 20, 36, 44)} & set(CELLS)
    domains, same, buttons, changes = Counter(), [], Counter(), Counter()
    for env, episode in trials_of(COMPARISON, 1500):
        study, test = episode.study, episode.test
        domains[episode.domain] += 1
        buttons[episode.button[:2]] += 1
        assert colour(env, episode.button) == WHITE  # a frame
        assert len(study) == episode.staircase.level
        assert study.keys() == test.keys() <= set(CELLS)
        changed = [cell for cell in study if study[cell] != test[cell]]
        same.append(not changed)
        assert len(changed) == (episode.right == SequentialComparison.NEW)
        forms = {form for form, _ in study.values()}
        colours = {colour for _, colour in study.values()}
        if episode.domain == "letter colours":
            assert len(forms) == 1
        if episode.domain == "letter orientations":
            assert len(colours) == 1
        if episode.domain == "squares":
            assert forms == {SQUARE}
        elif episode.domain != "all":
            assert SQUARE not in forms
        for cell in changed:
            (form, hue), (new_form, new_hue) = study[cell], test[cell]
            assert (form == new_form) != (hue == new_hue)  # in one thing only
            optotype = (form == SQUARE) != (new_form == SQUARE)
            kind = "colour" if hue != new_hue else "form" if optotype else "orientation"
            changes[episode.domain, kind] += 1
    assert sorted(domains) == sorted(DOMAINS)
    assert all(abs(count - 300) < 75 for count in domains.values())
    assert np.mean(same) == pytest.approx(0.5, abs=0.05)
    assert sorted(buttons) == [(x, y) for x in BUTTON_STARTS for y in BUTTON_STARTS]
    assert all(abs(count - 375) < 85 for count in buttons.values())
    assert set(changes) == {
        ("letters", "colour"), ("letters", "orientation"), ("letter colours", "colour"),
        ("letter orientations", "orientation"), ("squares", "colour"), ("all", "colour"),
        ("all", "orientation"), ("all", "form"),
    }  # fmt: skip


def test_the_study_phase_and_the_delay() -> None:
    delays = Counter()
    for seed in range(12):
        env, episode = begin(COMPARISON, seed=seed)
        for _ in range(4):
            while episode.fixating is False:
                wait(env)
            look(env, episode, CENTRE)
            place = episode.button
            assert colour(env, place) == WHITE
            assert look(env, episode, place) == 0
            assert colour(env, place) == (59, 165, 170)
            assert look(env, episode, CENTRE) == 0
            frames = 0
            while episode.phase == "delay":
                assert empty(env)
                wait(env)
                frames += 1
            delays[frames] += 1
            for button in (LEFT, RIGHT):
                assert colour(env, button) == BLACK
            look(env, episode, episode.buttons[episode.right])
            assert look(env, episode, (0.7, 0.7, 0.8, 0.8)) == 1
            wait(env)
            assert episode.fixating
    assert sorted(delays) == list(DELAYS)
    assert max(delays.values()) < 20


def test_figures_of_the_comparison() -> None:
    """Squares, and letters whose notches, 0.2 x 0.6, open to the four sides."""
    env, episode = begin(COMPARISON)
    for form in range(5):
        for hue, expected in enumerate(COLOURS):
            episode.screen.clear()
            episode._show({CELLS[0]: (form, hue)})
            # Cell 0 is at 4 of 64 units of an area that begins at 0.125 of the screen.
            pixels = env._scenery.scenes.screen[0, 22:34, 22:34, :3]
            rest = env._scenery.scenes.screen[0].astype(int)
            rest[22:34, 22:34] = 255
            assert (rest == 255).all()
            figure = pixels[1:11, 1:11]
            ink = (figure == expected).all(-1)
            assert (ink | (figure == 255).all(-1)).all()
            if form == SQUARE:
                assert ink.all()
                continue
            assert (~ink).sum() == 2 * 2 * 6
            west, east = ink[:, 0].mean(), ink[:, -1].mean()
            north, south = ink[0].mean(), ink[-1].mean()
            open_side = [west, east, north, south].index(min(west, east, north, south))
            assert open_side == form - 1
            assert sorted([west, east, north, south]) == [0.6, 1, 1, 1]


# Search.


def test_figures_of_the_search() -> None:
    modes, present, shapes = Counter(), [], Counter()
    for env, episode in trials_of(SEARCH, 1500):
        level = episode.staircase.level
        assert len(episode.figures) == LADDER[min(level, 10) - 1]
        modes[episode.mode] += 1
        targets = episode.figures.count((0, 0))
        assert targets == (episode.right == PRESENT)
        present.append(targets)
        for shape, hue in episode.figures[targets:]:
            shapes[episode.mode, shape, hue] += 1
        for button in episode.buttons:
            assert colour(env, button) == BLACK
        screen = env._scenery.scenes.screen[0, :115, :, :3]
        inked = (screen < 255).any(-1)
        assert not inked[:14].any()
        assert not inked[:, :14].any()
        assert not inked[:, 114:].any()
        cells = inked[15:113, 15:113].reshape(7, 14, 7, 14).any((1, 3))
        assert cells.sum() == len(episode.figures)  # each in its own cell
        assert inked.sum() > 40 * len(episode.figures)
    assert all(abs(count - 500) < 95 for count in modes.values())
    assert np.mean(present) == pytest.approx(0.5, abs=0.05)
    assert {key[1:] for key in shapes if key[0] == "shape"} == {(k, 0) for k in range(1, 8)}
    assert {key[1:] for key in shapes if key[0] == "colour"} == {(0, k) for k in range(1, 5)}
    assert len([key for key in shapes if key[0] == "conjunction"]) == 39
    assert ("conjunction", 0, 0) not in shapes


def test_shapes_of_the_search() -> None:
    """No two are the same, and pairs mirror each other."""
    grids = {name: rows.split() for name, rows in SHAPES.items()}
    assert len(set(SHAPES.values())) == 8
    assert all(len(rows) == 3 and {len(row) for row in rows} == {3} for rows in grids.values())
    mirrored = {name: [row[::-1] for row in rows] for name, rows in grids.items()}
    assert grids["inverted T"] == grids["T"][::-1]
    assert grids["mirrored L"] == mirrored["L"]
    assert grids["mirrored R"] == mirrored["R"]
    assert grids["Z"] == mirrored["S"]


# Nine actions, which cannot look up or down.


def turning(env: LabyrinthVectorEnv) -> np.ndarray:
    """What a player does who knows the answers and turns to where they are, as far as he can."""
    actions = np.zeros(env.num_envs, np.int64)
    for i, episode in enumerate(env.episodes):
        assert isinstance(episode, Psychlab)
        left, top, right, bottom = episode.wanted
        if not top <= 0.509 < bottom and isinstance(episode, ArbitraryVisuomotorMapping):
            left, _, right, _ = LEFT
        yaw, _ = episode.screen.direction((left + right) / 2, 0.509)
        actions[i] = 4 if env.envs.bodies[i, YAW] < yaw else 5
    return actions


@pytest.mark.parametrize("level", [COMPARISON, SEARCH])
def test_nine_actions_cannot_answer(level: str) -> None:
    env = batch(level, 4, num_actions=9)
    env.reset(seed=0)
    for _ in range(400):
        assert not env.step(turning(env))[1].any()
    for episode in env.episodes:
        assert not episode.fixating  # a trial was begun
        assert episode.done == 0


def test_nine_actions_learn_mappings_to_the_sides_only() -> None:
    env = batch(MAPPING, 6, num_actions=9)
    env.reset(seed=0)
    totals = np.zeros(6)
    for _ in range(1200):
        before = list(env.episodes)
        totals += env.step(turning(env))[1]
        if any(a is not b for a, b in zip(before, env.episodes, strict=True)):
            break
    reach = []
    for episode in env.episodes:
        assert isinstance(episode, ArbitraryVisuomotorMapping)
        known = episode.responses[: episode.size]
        assert (known[:-1] >= 2).all()  # all pairs of blocks without errors
        reach.append(episode.size)
    assert max(reach) < 20
    assert (totals[np.array(reach) > 1] > 0).all()


def test_nine_actions_recognise() -> None:
    env = batch(RECOGNITION, 4, num_actions=9)
    env.reset(seed=0)
    returns, _ = play_out(env, lambda: turning(env))
    assert (returns == 60).all()
