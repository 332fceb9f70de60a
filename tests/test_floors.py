"""Policies that are not told what is asked for: how they are played and found, what they score."""

import math
from typing import Any

import numpy as np
import pytest
import search_floors
from numpy.typing import NDArray

from zipf import envs
from zipf.envs import floors
from zipf.envs.episodes import measure
from zipf.envs.family import BoundPolicy
from zipf.envs.gridworld import kernels
from zipf.envs.gridworld.expert import shortest_ways
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.playroom.judgement import APPROACH_DISTANCE
from zipf.envs.playroom.vector import PlayroomVectorEnv

FIND = "supervised/find_shape_uniform"
SMALL = {"image_size": (3, 4)}


def exceeds(found: floors.Floor, known: float, margin: float) -> bool:
    """Whether a policy is better than a floor by more than a margin, and by more than chance: above
    its one-sided 99.99 % interval."""
    return found.score > known + margin and found.score - 3.719 * found.error > known


def test_a_policy_plays_the_episodes_of_its_seeds_from_their_first_step_on() -> None:
    arena = floors.Arena("gridworld/rare", rows=5)
    policies, seeds = ["actions 7*6 5*8 2 7*16 2 7*6 2 1*6 2 7*6 2", "actions 2"], range(5, 25)
    found = arena.returns(policies, seeds)
    for k, runs in enumerate((floors._runs(policies[0]), [(2, 1)])):
        cycle = [action for action, steps in runs for _ in range(steps)]
        for j, seed in enumerate(seeds):
            env = envs.make("gridworld/rare")
            env.reset(seed=seed)
            total, step, ended = 0.0, 0, False
            while not ended:
                _, reward, terminated, truncated, _ = env.step(cycle[step % len(cycle)])
                total, step, ended = total + float(reward), step + 1, terminated or truncated
            assert found[k, j] == total
    assert found.any()
    assert (arena.returns(policies, seeds) == found).all()


def test_walks_hold_their_actions() -> None:
    player = floors._open_loop(["walk 0.75 of 1 4"] * 4000, 8, 0)
    played = np.array([player() for _ in range(20)])
    assert set(np.unique(played)) == {1, 4}
    # A new draw is the same action half of the time.
    assert (played[1:] == played[:-1]).mean() == pytest.approx(0.75 + 0.25 / 2, abs=0.01)
    assert (played == 1).mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    "text", ["action 1", "actions", "actions 1*0", "walk of 1", "walk 5 of 0", "expert"]
)
def test_what_is_no_policy_is_refused(text: str) -> None:
    arena = floors.Arena("gridworld/uniform", rows=2)
    with pytest.raises(ValueError, match="is no policy: expected 'actions"):
        floors.play([text], arena, episodes=2)
    with pytest.raises(ValueError, match="there are actions 0 to 7"):
        floors.play(["actions 8"], arena, episodes=2)
    for long in (f"actions 1*{floors.LONGEST + 1}", "walk 0.9 of 0 1 2 3 4 5 6 7 0"):
        with pytest.raises(ValueError, match="actions: at most"):
            floors.play([long], arena, episodes=2)
    with pytest.raises(ValueError, match="episodes must be at least 2"):
        floors.play(["actions 1"], arena, episodes=1)


def test_trying_every_toy_at_both_places_solves_the_near_task() -> None:
    near = "playroom/put/put_near_bed_tray_frequent"
    arena = floors.Arena(near, rows=8, options=SMALL)
    (found,) = floors.play(["guessing expert"], arena, episodes=8)
    assert found.score == 1.0
    arena = floors.Arena(near, rows=8, options={**SMALL, "near_failure": True})
    (found,) = floors.play(["guessing expert"], arena, episodes=8)
    assert found.score < 0.5


class AnyToyInReach(PlayroomVectorEnv):
    """Finding by the rule of version 0.2.0: the target counts wherever it is within reach, also
    where another toy is nearer."""

    def _play(self, mask: NDArray[np.bool_], actions: NDArray[np.int64]) -> Any:
        reward, terminated, success = super()._play(mask, actions)
        places, agents = self.envs.objects[:, :, :2], self.envs.agents[:, None, :2]
        near = np.linalg.norm(places - agents, axis=2) < APPROACH_DISTANCE
        found = near & (self.envs.ranks == self.envs.ranks[:, :1])
        success |= mask & found.any(axis=1)
        return np.where(success, 1.0, reward), terminated, success


@pytest.mark.slow
@pytest.mark.parametrize(("make", "cheats"), [(AnyToyInReach, True), (PlayroomVectorEnv, False)])
def test_the_search_finds_a_rule_that_can_be_cheated(make: Any, cheats: bool) -> None:
    known = envs.baseline("blind", f"playroom/{FIND}")
    assert known is not None
    arena = floors.Arena(
        lambda num_envs, **options: make(num_envs, FIND, max_steps=20, **options),
        rows=256,
        options=SMALL,
    )
    best = floors.play(floors.search(arena, seconds=6), arena, episodes=1000)
    assert any(exceeds(one, known.score, 0.05) for one in best) == cheats


def test_without_time_a_search_has_what_is_known() -> None:
    arena = floors.Arena("gridworld/rare", rows=64)
    known = ["actions 7*6 5*8 2 7*16 2 7*6 2 1*6 2 7*6 2", "actions 0"]
    found = floors.search(arena, seconds=0, known=known)
    assert found == known  # the first knows a map


@pytest.mark.slow
def test_no_constant_action_beats_blind_in_finding() -> None:
    """Walking straight ahead once found the target nine times in ten."""
    for name in ("zipf3", "uniform", "uniform_rare", "validation"):
        level = f"playroom/supervised/find_shape_{name}"
        known = envs.baseline("blind", level)
        assert known is not None
        arena = floors.Arena(level, rows=230, options={**SMALL, "max_steps": 15})
        every = [f"actions {one}" for one in range(arena.count)]
        for found in floors.play(every, arena, episodes=150):
            assert not exceeds(found, known.score, 0.0), (level, found)


def test_a_floor_is_the_higher_one_of_what_was_reasoned_and_found() -> None:
    lift = envs.baseline("blind", "playroom/lift/lift_shape_uniform")
    assert lift is not None
    assert (lift.score, lift.episodes) == (1 / 3, None)
    near = envs.baseline("blind", "playroom/put/put_near_bed_tray_frequent")
    assert near is not None
    assert near.policy == "guessing expert"
    assert near.score == pytest.approx(1, abs=0.01)


def test_the_floor_of_putting_near_a_support_is_not_reasoned() -> None:
    """Where what was not asked for ends no episode, whoever cannot read may try everything."""
    near = "playroom/put/put_near_bed_tray_frequent"
    for options in ({"object_order": "alternate"}, {"reach": 3.0}):
        assert envs.baseline("blind", near, **options) is None
    failing = envs.baseline("blind", near, object_order="alternate", near_failure=True)
    assert failing is not None
    assert failing.score == 1 / 6


def test_options_that_a_level_does_not_use_do_not_hide_its_scores() -> None:
    unused = {"frequent_exponent": 2.0, "near_failure": True}
    for name in envs.BASELINES:
        for level in ("put/put_on_bed_tray_rare", "lift/lift_shape_zipf3"):
            known = envs.baseline(name.name, f"playroom/{level}")
            assert known is not None
            assert envs.baseline(name.name, f"playroom/{level}", **unused) == known
    frequent = "playroom/put/put_on_bed_tray_frequent"
    assert envs.baseline("expert", frequent, frequent_exponent=2.0) is None


@pytest.mark.parametrize(
    ("level", "options", "rank", "score"),
    [
        ("zipf_2", {}, 0, 0.627),
        ("rare", {}, 16, 0.25),
        ("validation", {}, 8, 0.25),
        ("uniform", {}, 0, 0.05),
        ("rare", {"num_objects": 5, "num_rooms": [2, 2]}, 4, 1.0),
    ],
)
def test_the_floor_of_the_gridworld_is_that_of_a_guess(
    level: str, options: dict[str, Any], rank: int, score: float
) -> None:
    """Who takes the shortest way to one object, without a look at the cue."""

    def guess(env: GridworldVectorEnv) -> BoundPolicy:
        ways, state = shortest_ways(env.level.maps), env._envs
        width = env.level.maps.boards.shape[2]

        def act() -> NDArray[np.int64]:
            map, row, column = (state[:, one] for one in (kernels.MAP, kernels.ROW, kernels.COLUMN))
            return ways[map, rank, row * width + column]

        return act

    known = envs.baseline("blind", f"gridworld/{level}", **options)
    assert known is not None
    assert known.score == pytest.approx(score, abs=1e-3)
    assert known.by_rank["target"][rank] == 1.0
    played = measure(guess, f"gridworld/{level}", episodes=1000, **options)
    assert played.score == pytest.approx(known.score, abs=0.05)


# Each level once, with the options of an experiment where one has others: its episodes are shorter.
TASKS = {
    (family, level): options
    for family in search_floors.ROWS
    for family, level, options in search_floors.tasks(family)
}
SECONDS = {"playroom": 1.0, "labyrinth": 2.0}
EPISODES = {"playroom": 48, "labyrinth": 24}


@pytest.mark.slow
@pytest.mark.parametrize(("family", "level"), TASKS)
def test_no_cheat_beats_the_floor_of_a_level(family: str, level: str) -> None:
    """Neither the recorded policy nor one that a short search finds now."""
    options = TASKS[family, level]
    known = envs.baseline("blind", f"{family}/{level}", **options)
    assert known is not None
    of_split = search_floors.split_level(family, level)
    # The margin is in units of the score, which in the labyrinth is a fraction of a human's.
    margin = 0.05 / (of_split.normalised(1.0) - of_split.normalised(0.0))
    arena = search_floors.arena(family, level, options)
    cheats = floors.search(arena, seconds=SECONDS[family], episodes=8)[:2]
    # Others are exact or of random actions, and no policy to play.
    recorded = [known.policy] if known.policy and known.episodes else []
    for found in floors.play([*recorded, *cheats], arena, episodes=EPISODES[family]):
        assert math.isfinite(found.score)
        assert not exceeds(found, known.score, margin), found
    arena.close()
