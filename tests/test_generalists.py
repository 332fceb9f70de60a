"""Scripted generalists: what they know, how they score, and labels for what another policy does."""

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import slow_but
from numpy.typing import NDArray
from playroom_envs import arrange, playroom

from zipf import envs
from zipf.envs.episodes import BoundPolicy, play_episodes
from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.generalist import UNSEEN
from zipf.envs.gridworld.generalist import Generalist as GridworldGeneralist
from zipf.envs.gridworld.maps import PAD, VIEW
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.playroom import actions
from zipf.envs.playroom.generalist import Generalist as PlayroomGeneralist
from zipf.envs.playroom.in_view import look
from zipf.envs.playroom.state import AX, YAW
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.testing import check_policy

PLAYERS = [
    (family.name, name)
    for family in envs.families().values()
    for name in envs.SCRIPTED
    if getattr(family, name) is not None
]


@pytest.mark.parametrize(
    ("family", "name"), slow_but(PLAYERS, *(one for one in PLAYERS if one[0] != "labyrinth"))
)
def test_every_player_can_label_what_another_policy_does(family: str, name: envs.Scripted) -> None:
    level = f"{family}/{envs.find_family(family).levels[0]}"
    steps = 15 if family == "labyrinth" else 60  # saving its state takes long
    check_policy(partial(envs.scripted, name, level), partial(envs.make_vec, level), steps=steps)


def test_who_has_a_generalist() -> None:
    made = {name for name, family in envs.families().items() if family.generalist is not None}
    assert made == {"gridworld", "playroom", "labyrinth"}
    env = envs.make_vec("gridworld/rare", 1)
    with pytest.raises(ValueError, match="did you mean"):
        envs.generalist("gridwrld/rare", env)


@pytest.mark.parametrize(("family", "name"), PLAYERS)
def test_players_refuse_worlds_that_they_cannot_play(family: str, name: envs.Scripted) -> None:
    others = [one for one in envs.families() if one != family]
    level, *other = (f"{one}/{envs.find_family(one).levels[0]}" for one in (family, *others))
    with pytest.raises(ValueError, match=f"the {name} plays what make_vec makes, got"):
        envs.scripted(name, level, envs.make(level))  # type: ignore[arg-type]
    for wrong in other:
        with pytest.raises(ValueError, match=f"the {name} .*, got"):
            envs.scripted(name, level, envs.make_vec(wrong, 1))


@pytest.mark.parametrize("name", envs.SCRIPTED)
def test_players_of_one_level_refuse_a_mixture(name: envs.Scripted) -> None:
    for family in ("gridworld", "playroom"):
        levels = [f"{family}/{one}" for one in envs.find_family(family).levels[:2]]
        with pytest.raises(ValueError, match=f"the {name} .* one {family} level.*got Mixture"):
            envs.scripted(name, levels[0], envs.make_vec(levels, 2))


class Bad:
    """A player that counts how often it was asked."""

    def __init__(self, env: Any, wrong: str) -> None:
        self.env, self.wrong, self.asked = env, wrong, 0

    def __call__(self) -> NDArray[Any]:
        self.asked += 1
        if self.wrong == "asked again":
            return np.full(self.env.num_envs, self.asked % 8)
        if self.wrong == "changed the state":
            self.env._lengths[0] += 1
        if self.wrong == "in 0 .. 7":
            return np.full(self.env.num_envs, 8)
        return np.zeros(self.env.num_envs, np.int32 if self.wrong == "int64" else np.int64)


@pytest.mark.parametrize("wrong", ["asked again", "changed the state", "in 0 .. 7", "int64"])
def test_the_check_of_players_finds_mistakes(wrong: str) -> None:
    make = partial(envs.make_vec, "gridworld/rare")
    check_policy(partial(Bad, wrong=""), make, steps=5)
    with pytest.raises(AssertionError, match=wrong):
        check_policy(partial(Bad, wrong=wrong), make, steps=5)


# The gridworld.


def gridworld(num_envs: int, level: str = "uniform", **options: Any) -> GridworldVectorEnv:
    return GridworldVectorEnv(num_envs, level, observation="tiles", **options)


def mean_return(env: envs.ZipfVectorEnv, player: BoundPolicy, episodes: int, *, seed: int) -> float:
    played = play_episodes(env, lambda *_: player(), episodes, seed=seed)
    return float(played["return"].mean())


@pytest.mark.parametrize(
    ("level", "floor", "without"),
    [("zipf_2", 0.86, 0.16), ("uniform", 0.88, 0.4), ("rare", 0.92, 0.48)],
)
def test_gridworld_scores(level: str, floor: float, without: float) -> None:
    """Four standard errors and more below those of 1000 episodes."""
    env = gridworld(100, level)
    score = mean_return(env, GridworldGeneralist(env), 400, seed=0)
    assert score > floor
    forgetful = mean_return(env, GridworldGeneralist(env, memory=False), 400, seed=0)
    assert without < forgetful < score - 0.2


def test_the_gridworlds_generalist_touches_no_other_object() -> None:
    env = gridworld(100)
    player = GridworldGeneralist(env)
    env.reset(seed=1)
    ended = 0
    for _ in range(120):
        _, reward, terminated, _, _ = env.step(player())
        assert (reward[terminated] == 1).all()
        ended += terminated.sum()
    assert ended > 100


def test_in_the_gridworld_it_knows_what_has_been_in_view() -> None:
    """Against a record of the tiles, while another policy acts and episodes end."""
    n = 30
    env = gridworld(n, max_steps=25)
    player = GridworldGeneralist(env)
    rng = np.random.default_rng(0)
    tiles, _ = env.reset(seed=3)
    record = np.full(player._known.shape, UNSEEN)
    visits = np.zeros(player._known.shape, np.int64)
    begun = 0
    for _ in range(60):
        for i, (row, column) in enumerate(env._envs[:, 2:]):
            view = np.where(tiles["tiles"][i] == sprites.AGENT, sprites.FLOOR, tiles["tiles"][i])
            seen = record[i, row : row + VIEW, column : column + VIEW]
            cued = seen[0, 0]
            seen[:] = view
            seen[0, 0] = cued
            visits[i, row + PAD, column + PAD] += 1
        labels = player()
        np.testing.assert_array_equal(player._known, record)
        np.testing.assert_array_equal(player._visits, visits)
        acts = np.where(rng.random(n) < 0.3, labels, rng.integers(8, size=n))
        tiles, _, terminated, truncated, _ = env.step(acts)
        ended = terminated | truncated
        record[ended], visits[ended] = UNSEEN, 0
        begun += ended.sum()
    assert begun > n


@pytest.mark.parametrize("memory", [True, False])
def test_in_the_gridworld_what_is_unseen_changes_nothing(memory: bool) -> None:
    """The same answers in envs with other walls and objects where nothing has been seen."""
    n = 20
    env, other = gridworld(n, "rare"), gridworld(n, "rare")
    player = GridworldGeneralist(env, memory=memory)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    other.reset(seed=0)
    pretender = GridworldGeneralist(other, memory=memory)
    made = env.level.maps
    differed = 0
    for t in range(40):
        labels = player()
        goals = made.cells[env._envs[:, 0], env._envs[:, 1]] + PAD
        # A map for each env, so that what is unseen differs from env to env.
        codes = made.codes[env._envs[:, 0]].copy()
        hidden = player._known == UNSEEN
        hidden[np.arange(n), goals[:, 0], goals[:, 1]] = False  # the cue is shown
        drawn = rng.choice(
            [sprites.FLOOR, sprites.WALL, sprites.FIRST_LOOK + 200], size=codes.shape
        )
        codes[hidden] = drawn[hidden]
        cells = made.cells[env._envs[:, 0]]
        maps = dataclasses.replace(made, num_maps=n, codes=codes, cells=cells)
        other.level = dataclasses.replace(other.level, maps=maps)
        other._envs[:] = env._envs
        other._envs[:, 0] = np.arange(n)
        other._lengths[:], other._streams[:] = env._lengths, env._streams
        np.testing.assert_array_equal(pretender(), labels, f"step {t}")
        differed += (codes != made.codes[env._envs[:, 0]]).sum()
        env.step(labels)
    assert differed > 10_000


def test_in_the_gridworld_batches_of_any_size_play_alike() -> None:
    def answers(num_envs: int, first: int) -> NDArray[np.int64]:
        env = gridworld(num_envs)
        player = GridworldGeneralist(env)
        env.reset(seed=first)
        made = []
        for _ in range(40):
            made.append(player())
            env.step(made[-1])
        return np.array(made)

    np.testing.assert_array_equal(answers(6, 10)[:, 4:5], answers(1, 14))


def test_in_the_gridworld_another_episode_is_not_remembered() -> None:
    env = gridworld(1)
    player = GridworldGeneralist(env)
    env.reset(seed=0, options={"map": 3, "target": 5})
    early = env.get_state()
    for _ in range(10):
        env.step(player())
    much = (player._known != UNSEEN).sum()
    env.set_state(early)  # to an earlier time
    player()
    assert (player._known != UNSEEN).sum() == VIEW * VIEW - 1 < much
    env.reset(seed=0, options={"map": 7, "target": 5})  # another map, by the same random numbers
    player()
    assert (player._known != UNSEEN).sum() == VIEW * VIEW - 1


# The playroom.


@pytest.mark.parametrize(
    "level",
    slow_but(
        [
            *("lift/lift_shape_uniform", "put/lift_shape_many_zipf1", "put/put_on_bed_tray_all"),
            *("put/put_near_bed_tray_frequent", "supervised/find_shape_uniform"),
        ],
        "put/put_on_bed_tray_all",
    ),
)
def test_playroom_scores(level: str) -> None:
    env = PlayroomVectorEnv(20, level, image_size=(3, 4), max_steps=250)
    assert mean_return(env, PlayroomGeneralist(env), 40, seed=1) >= 0.95


def seen(env: PlayroomVectorEnv) -> tuple[list[bool], list[bool]]:
    """Toys, and bed and tray in view of the first env, in an image of 4 x 3."""
    items, supports = np.zeros((1, env.envs.ranks.shape[1]), np.bool_), np.zeros((1, 2), np.bool_)
    wide = np.tan(np.radians(37.5))
    look(env.envs, wide, 0.75 * wide, items, supports)
    return items[0].tolist(), supports[0].tolist()


def test_what_is_in_view() -> None:
    env = playroom()
    down = np.radians(-25)
    for agent, expected in (
        ((0, 0, 0, down), True),
        ((0, 0, np.radians(30), down), True),
        ((0, 0, np.radians(70), down), False),  # beside the image
        ((0, 0, np.pi, down), False),  # behind the agent
        ((0, 0, 0, np.radians(20)), False),  # below the image
        ((1, 0, 0, down), False),  # below the image, before the feet
    ):
        arrange(env, agent, {0: (1.2, 0)})
        assert seen(env)[0][0] is expected
    arrange(env, (-1, 0, 0, down), {0: (0.65, 0), 1: (0.3, 0)}, names=("dice", "piano", "cup"))
    assert seen(env)[0][:2] == [False, True]  # hidden
    arrange(env, (-1, 0, 0, down), {0: (0.65, 0.6), 1: (0.3, 0)}, names=("dice", "piano", "cup"))
    assert seen(env)[0][:2] == [True, True]


def test_bed_and_tray_in_view() -> None:
    env = playroom("put/put_on_bed_tray_all")
    arrange(env, (1.0, -0.5, np.pi, np.radians(-25)))
    assert seen(env)[1] == [True, False]
    arrange(env, (1.0, -0.5, np.pi / 2, np.radians(-25)))
    assert seen(env)[1] == [False, True]
    env = playroom()
    arrange(env, (1.0, -0.5, np.pi, np.radians(-25)))
    assert seen(env)[1] == [False, False]


def labels(env: PlayroomVectorEnv, steps: int) -> list[int]:
    """What a new generalist does from here on."""
    player = PlayroomGeneralist(env)
    made = []
    for _ in range(steps):
        made.append(int(player()[0]))
        env.step(np.array(made[-1:]))
    return made


def test_in_the_playroom_what_is_unseen_changes_nothing() -> None:
    # A turn to the right takes some steps to come to what is behind on the left.
    agent = (0, 0, 0, np.radians(-25))
    made = []
    for toy in ((-1.2, 0.2), (-1.0, 0.4)):
        env = playroom(image_size=(3, 4))
        arrange(env, agent, {0: toy})
        made.append(labels(env, 6))
    assert made[0] == made[1] == [actions.TURN_RIGHT] * 6
    # The toy is in view, and others behind the agent are nearer or farther.
    made = []
    for others in (((-1.2, 0.2), (-1.2, -0.6)), ((-0.5, 0.1), (-0.5, -0.4))):
        env = playroom(image_size=(3, 4))
        arrange(env, agent, {0: (1.6, 0), 1: others[0], 2: others[1]})
        made.append(labels(env, 2))
    assert made[0] == made[1]
    assert actions.TURN_RIGHT not in made[0]


def test_in_the_playroom_it_remembers_and_forgets() -> None:
    env = playroom(image_size=(3, 4))
    arrange(env, (0, 0, 0, np.radians(-25)), {0: (1.4, 0)})
    player = PlayroomGeneralist(env)
    before = player()[0]
    assert before != actions.TURN_RIGHT
    # Another policy turns away from the toy: it is remembered where it was.
    for _ in range(10):
        env.step(np.array([actions.TURN_RIGHT]))
        label = player()[0]
    assert not seen(env)[0][0]
    assert label == actions.TURN_LEFT  # the short way back
    # It is moved, and its old place comes into view.
    env.envs.objects[0, 0, :2] = 0.3, -1.6
    assert player()[0] == label
    env.envs.agents[0, YAW] = 0.0
    assert player()[0] == actions.TURN_RIGHT
    # A player that has not seen it searches.
    env.envs.agents[0, YAW] = np.pi / 2
    assert PlayroomGeneralist(env)()[0] == actions.TURN_RIGHT


def test_in_the_playroom_the_support_must_have_been_seen() -> None:
    env = playroom("put/put_on_bed_tray_all", image_size=(3, 4))
    arrange(env, (0.6, 0, 0, np.radians(-10)), {0: (1.2, 0, 0, 0.7)}, task="on bed")
    env.envs.hands[0] = 0
    env.envs.lifted[0, 0] = True
    env._lengths[0] = 2  # in the midst of an episode
    assert seen(env)[1] == [False, False]
    player = PlayroomGeneralist(env)
    assert player()[0] == actions.GRAB + actions.TURN_RIGHT
    # After a look at the bed, it goes there.
    env.envs.agents[0, YAW] = np.pi
    player()
    env.envs.agents[0, YAW] = 0.0
    assert player._supports[0].tolist() == [True, False]
    assert (player._furniture[0, 0] == env.envs.furniture[0, 0]).all()
    assert player()[0] in actions.GRAB + np.arange(actions.FORWARD, actions.LEFT + 1)


def test_in_the_playroom_it_looks_for_a_bed_that_it_bumps_into() -> None:
    env = playroom("put/put_on_bed_tray_all", image_size=(3, 4))
    for x, expected in ((-0.24, True), (-0.1, False)):  # the bed ends at -0.5
        arrange(env, (x, 0, 0, np.radians(-25)), {0: (1.2, 0)}, task="on bed")
        assert env.envs.agents[0, AX] == x
        assert bool(PlayroomGeneralist(env)()[0] == actions.TURN_RIGHT) is expected


def test_of_two_toys_of_a_kind_either_is_found() -> None:
    env = playroom("supervised/find_shape_uniform", image_size=(3, 4))
    for there, away in ((0, 1), (1, 0)):
        arrange(
            env,
            (0, 0, 0, np.radians(-25)),
            {there: (1.4, 0), away: (-1.5, 0)},
            names=("cup", "cup"),
        )
        assert actions.TURN_RIGHT not in labels(env, 4)
