"""Every level of the labyrinth can be solved: its scripted expert reaches a stated floor."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import slow_but
from labyrinth_levels import REWARDS, batch, play_out, record_rewards

from zipf.envs import baseline, expert
from zipf.envs.labyrinth.expert import Expert
from zipf.envs.labyrinth.levels import LEVELS
from zipf.envs.labyrinth.steering import BACKWARD, NAMES, WAIT

FLOORS = {
    "rooms_collect_good_objects_train": 8,
    "rooms_exploit_deferred_effects_train": 9,
    "rooms_select_nonmatching_object": 60,
    "rooms_watermaze": 100,
    "rooms_keys_doors_puzzle": 52,
    "language_select_described_object": 550,
    "language_select_located_object": 580,
    "language_execute_random_task": 450,
    "language_answer_quantitative_question": 340,
    "lasertag_one_opponent_small": 24,
    "lasertag_three_opponents_small": 34,
    "lasertag_one_opponent_large": 13,
    "lasertag_three_opponents_large": 24,
    "natlab_fixed_large_map": 70,
    "natlab_varying_map_regrowth": 20,
    "natlab_varying_map_randomized": 20,
    "skymaze_irreversible_path_hard": 100,
    "skymaze_irreversible_path_varied": 100,
    "psychlab_arbitrary_visuomotor_mapping": 60,
    "psychlab_continuous_recognition": 60,
    "psychlab_sequential_comparison": 60,
    "psychlab_visual_search": 80,
    "explore_object_locations_small": 60,
    "explore_object_locations_large": 60,
    "explore_obstructed_goals_small": 220,
    "explore_obstructed_goals_large": 130,
    "explore_goal_locations_small": 300,
    "explore_goal_locations_large": 200,
    "explore_object_rewards_few": 80,
    "explore_object_rewards_many": 120,
}
"""Mean returns of three episodes."""


@pytest.mark.parametrize("level", slow_but(LEVELS, "rooms_select_nonmatching_object"))
def test_an_expert_reaches_its_floor(level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rewards = record_rewards(monkeypatch)
    env = batch(level, 3)
    env.reset(seed=11)
    player = expert(f"labyrinth/{level}", env)
    assert player is not None
    returns, lengths = play_out(env, player)
    assert returns.mean() >= FLOORS[level]
    assert (lengths <= LEVELS[level].seconds * 15).all()
    assert set(rewards) <= REWARDS[level]


@pytest.mark.slow
def test_deferred_effects_are_exploited() -> None:
    env = batch("rooms_exploit_deferred_effects_train", 8)
    env.reset(seed=0)
    best = np.array([100 if episode.open else 10 for episode in env.episodes])
    assert set(best.tolist()) == {10, 100}
    player = expert("labyrinth/rooms_exploit_deferred_effects_train", env)
    assert player is not None
    returns, _ = play_out(env, player)
    assert (returns >= 0.8 * best).all()  # an apple before the door cannot be avoided


@pytest.mark.slow
def test_keys_and_doors_are_solved_as_well_as_possible() -> None:
    env = batch("rooms_keys_doors_puzzle", 12)
    env.reset(seed=0)
    best = np.array([episode.best for episode in env.episodes])
    player = expert("labyrinth/rooms_keys_doors_puzzle", env)
    assert player is not None
    returns, _ = play_out(env, player)
    assert (returns == best).mean() >= 0.9


@pytest.mark.parametrize(
    "level",
    slow_but((x for x in LEVELS if x.startswith("natlab")), "natlab_fixed_large_map"),
)
def test_leaving_a_place_is_remembered_and_saved(level: str) -> None:
    """Asked again without a step the expert says the same, and a second one goes on from its
    state, while another policy holds some of the players in their places for a while."""
    env, other = batch(level, 8), batch(level, 8)
    player = Expert(env)
    env.reset(seed=0)
    held, backward = np.arange(8) < 4, 0
    for t in range(120):
        if t % 7 == 0:
            other.set_state(env.get_state())
            successor = Expert(other)
            successor.set_state(player.get_state())
        labels = player()
        np.testing.assert_array_equal(player(), labels)
        np.testing.assert_array_equal(successor(), labels)
        backward += (labels == BACKWARD).sum()
        dance = NAMES["strafe right" if t % 2 else "strafe left"]
        actions = np.where(held & (t % 60 < 40), dance, labels)
        env.step(actions)
        other.step(actions)
    assert backward >= 4 * 6  # a player in his place is led away at least once


def test_an_episode_begins_without_a_trail() -> None:
    """Another one, and an earlier step of the same."""
    env = batch("natlab_fixed_large_map", 1)
    env.reset(seed=0)
    early = env.get_state()
    stuck = np.array([WAIT])
    for begin in (lambda: env.set_state(early), lambda: env.reset(seed=1)):
        player = Expert(env)
        for _ in range(14):
            player()
            env.step(stuck)
        assert player()[0] == BACKWARD
        begin()
        assert player()[0] == Expert(env)()[0] != BACKWARD


def test_the_expert_needs_fifteen_actions() -> None:
    with pytest.raises(ValueError, match="the expert needs num_actions=15, got 9"):
        expert("labyrinth/rooms_watermaze", batch("rooms_watermaze", 1, num_actions=9))


# Baselines.


def test_every_level_was_measured() -> None:
    for name, level in LEVELS.items():
        chance, generalist, expert = (
            baseline(of, f"labyrinth/{name}") for of in ("chance", "generalist", "expert")
        )
        assert chance is not None
        assert generalist is not None
        assert expert is not None
        for one in (chance, generalist, expert):
            assert (one.episodes or 0) >= 200
            assert one.error is not None
            assert one.error >= 0
        assert chance.error is not None
        assert expert.score > chance.score + 5 * chance.error
        assert generalist.score > chance.score + 5 * chance.error
        assert expert.score >= FLOORS[name]
        # Random actions score as published, within a factor of 3 (or 1 near 0), as far as is known
        # by the standard error, except where the original's map is not known.
        low, high = sorted((level.random / 3, level.random * 3))
        margin = 1 + 2 * chance.error
        if name != "natlab_fixed_large_map":
            assert low - margin <= chance.score <= high + margin


def test_references_are_known_for_what_was_measured() -> None:
    expected = baseline("chance", "labyrinth/rooms_watermaze")
    assert expected is not None
    for options in ({"image_size": (5, 5)}, {"num_actions": 15, "action_repeat": 4}):
        assert baseline("chance", "labyrinth/rooms_watermaze", **options) == expected
    for other in ({"num_actions": 9}, {"action_repeat": 1}):
        assert baseline("chance", "labyrinth/rooms_watermaze", **other) is None
    hard = baseline("expert", "labyrinth/skymaze_irreversible_path_hard_v2")
    assert hard == baseline("expert", "labyrinth/skymaze_irreversible_path_hard")


def test_the_references_come_from_one_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scripts = Path(__file__).parent.parent / "scripts"
    monkeypatch.syspath_prepend(str(scripts))
    import measure_baselines

    path, page = tmp_path / "baselines.json", tmp_path / "page.md"
    files = ["--out", str(path), "--page", str(page)]
    level = "rooms_select_nonmatching_object"
    path.write_text(json.dumps({"expert": {level: [{"score": 1, "options": {}}]}}))
    for _ in range(2):  # renewed, and the same again
        measure_baselines.main(["labyrinth", level, "--episodes", "2", *files])
        written = json.loads(path.read_text())
        assert list(written) == ["chance", "generalist", "expert"]
        for of in written:
            ((name, figures),) = written[of].items()
            assert name == level
            assert {(one["episodes"], one["seed"]) for one in figures} == {(2, 0)}
            compact = {"action_repeat": 8, "max_steps": 450}  # as labyrinth_compact has them
            assert [one["options"] for one in figures] == [{}, compact]
        assert written["expert"][level][0]["score"] == 67
    assert re.search(
        rf"\n\| {level} \| 0.312 \| 65.9 \| .* \| 2 \|.* \| 2 \| 67.00 ± 0.00 \| 2 \|",
        page.read_text(),
    )
    assert "measure_baselines.py labyrinth --episodes 2\n" in page.read_text()
    assert f"expert, {level} {{}}: 67.0 +- 0.0" in capsys.readouterr().out
    path.write_text(json.dumps(written | {"chance": {level: written["chance"][level][1:]}}))
    measure_baselines.main(["labyrinth", level, "--episodes", "2", "--missing", *files])
    assert capsys.readouterr().out.count(level) == 1
    for wrong in (["--episodes", "1"], ["rooms_water"], ["--baselines", "blind"]):
        with pytest.raises(SystemExit):
            measure_baselines.main(["labyrinth", *wrong, *files])
    assert measure_baselines.measurable("gridworld") == ["generalist"]  # the others are exact
