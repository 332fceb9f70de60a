"""Goals: what observations ask for is read and replaced, and what episodes achieved is told."""

from functools import partial

import numpy as np
import pytest

from zipf import envs
from zipf.envs.gridworld.goal import Cue
from zipf.envs.gridworld.sprites import FIRST_LOOK
from zipf.envs.playroom import levels
from zipf.envs.testing import check_goal

SMALL = {"gridworld": {"max_steps": 30}, "default": {"image_size": (3, 4), "max_steps": 20}}
GOALS = [name for name, family in envs.families().items() if family.goal is not None]


def options(level):
    return SMALL.get(level.partition("/")[0], SMALL["default"])


def checked(level, **changes):
    made = partial(envs.make_vec, level, **{**options(level), **changes.pop("options", {})})
    return check_goal(partial(envs.goal, level), made, **changes)


@pytest.mark.parametrize("family", GOALS)
def test_every_goal_passes_the_check(family):
    split = envs.find_family(family).splits[0]
    assert checked(split.train[0].name, steps=60)["ended"] > 0


@pytest.mark.parametrize("observation", ["image", "tiles"])
def test_the_gridworlds_objects_are_achieved(observation):
    counts = checked("gridworld/uniform", steps=300, options={"observation": observation})
    assert counts["achieved"] > counts["other"] > 10
    assert counts["ended"] > counts["achieved"]  # time ran out


@pytest.mark.parametrize(
    "level",
    ["lift/lift_shape_zipf3", "put/put_near_bed_tray_frequent", "supervised/find_shape_uniform"],
)
def test_what_the_playrooms_expert_does_is_achieved(level):
    level = f"playroom/{level}"
    policies = {}

    def actions(env):
        if "expert" not in policies:
            policies["expert"] = envs.expert(level, env)
        return policies["expert"]()

    counts = checked(level, steps=150, actions=actions, options={"max_steps": 150})
    assert counts["achieved"] > 4


def test_a_relabelled_playroom_is_that_which_asks_for_the_other_toy():
    """The same scene with both toys' places in the state exchanged, and the other one as target:
    under the same actions it looks the same, and the relabelled instruction is its own."""
    level = "playroom/lift/lift_shape_uniform"
    one, other = (envs.make_vec(level, 1, image_size=(18, 24), max_steps=200) for _ in range(2))
    one.report_achieved()
    lifted = 0
    for seed in range(3):
        first, _ = one.reset(seed=seed)
        other.reset(seed=seed)
        worlds = other.envs
        for part in (worlds.ranks, worlds.objects, worlds.orientation, worlds.colours):
            part[0, [0, 1]] = part[0, [1, 0]]
        other._furnish(0)
        other._view.begin(np.ones(1, np.bool_))
        name = other.object_names[worlds.ranks[0, 0]]
        other._texts[0] = f"lift a {name}"
        other._instructions[0] = levels.VOCABULARY.encode(other._texts[0])
        expert, seen, asked = envs.expert(level, other), [first], [other.observations()]
        ended = False
        while not ended:
            actions = expert()
            told, reward, terminated, truncated, info = one.step(actions)
            wanted, gained, _, _, _ = other.step(actions)
            ended = bool(terminated[0] or truncated[0])
            seen.append(told)
            asked.append(wanted)
        final = info["final_info"]
        lifted += int(gained[0])
        assert reward[0] == 0
        assert final["has_achieved"][0] == (gained[0] == 1)
        if not gained[0]:
            continue
        goal = envs.goal(level, one)
        for mine, theirs in zip(seen[:-1], asked[:-1], strict=True):
            goal.write(mine, final["achieved"], np.ones(1, np.bool_))
            assert mine["instruction"].tolist() == theirs["instruction"].tolist()
            np.testing.assert_array_equal(mine["image"], theirs["image"])
    assert lifted


def test_what_is_lifted_is_named():
    """Each toy in the hand, against the text of its instruction."""
    env = envs.make_vec("playroom/lift/lift_shape_uniform", 3, image_size=(3, 4))
    env.report_achieved()
    _, info = env.reset(seed=0)
    for i in range(3):
        env.envs.hands[i] = i
        env.envs.lifted[i, i] = True
    goals, has = env._achieved(np.array([True, True, False]))
    assert has.tolist() == [True, True, False]
    for i in range(2):
        name = env.object_names[env.envs.ranks[i, i]]
        assert levels.VOCABULARY.decode(goals[i]) == f"lift a {name}"
    assert levels.VOCABULARY.decode(goals[0]) == info["instruction"][0]
    env.envs.lifted[:] = False
    assert not env._achieved(np.ones(3, np.bool_))[1].any()


def test_a_mixture_tells_what_each_world_achieved():
    names = ["gridworld/zipf_2", "gridworld/uniform"]
    made = partial(envs.make_vec, names, max_steps=30)
    counts = check_goal(partial(envs.goal, names[0]), made, num_envs=6)
    assert counts["other"] > 10


def test_outcomes_are_as_before_unless_asked_for():
    env = envs.make_vec("gridworld/uniform", 4, max_steps=2)
    env.reset(seed=0)
    for _ in range(2):
        info = env.step(np.zeros(4, np.int64))[4]
    assert not {"achieved", "has_achieved"} & info["final_info"].keys()
    labyrinth = envs.make_vec("labyrinth/rooms_watermaze", 1, image_size=(1, 1))
    with pytest.raises(ValueError, match="do not tell what an episode has achieved"):
        labyrinth.report_achieved()


def test_goals_and_players_are_of_batches():
    single = envs.make("gridworld/rare")
    with pytest.raises(ValueError, match="a goal is of what make_vec makes, got GridworldEnv"):
        envs.goal("gridworld/rare", single)
    with pytest.raises(ValueError, match="the expert plays what make_vec makes, got GridworldEnv"):
        envs.expert("gridworld/rare", single)
    with pytest.raises(
        ValueError, match=r"unknown scripted policy 'exprt' \(did you mean 'expert'"
    ):
        envs.scripted("exprt", "gridworld/rare", envs.make_vec("gridworld/rare", 1))


class Flawed(Cue):
    """Goals with one mistake each."""

    def __init__(self, env, flaw):
        super().__init__(env)
        self.flaw = flaw

    def read(self, observation):
        goals = super().read(observation)
        return {"view": observation["cue"], "one": goals[:, 0]}.get(self.flaw, goals)

    def write(self, observation, goals, mask):
        if self.flaw == "everywhere":
            mask = np.ones_like(mask)
        if self.flaw != "nowhere":
            super().write(observation, goals, mask)
        if self.flaw == "elsewhere":
            observation["tiles"][mask] = FIRST_LOOK


@pytest.mark.parametrize(
    ("flaw", "message"),
    [
        ("view", "not a view"),
        ("one", r"must give integers \[5, K\]"),
        ("everywhere", "does not give the goals that were written"),
        ("nowhere", "does not give the goals that were written"),
        ("elsewhere", "changes 'tiles'"),
    ],
)
def test_the_check_finds_mistakes(flaw, message):
    made = partial(envs.make_vec, "gridworld/uniform", observation="tiles")
    with pytest.raises(AssertionError, match=message):
        check_goal(partial(Flawed, flaw=flaw), made, steps=5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda goals, has: (goals, ~has), "has not achieved"),
        (lambda goals, has: (goals[:, :0], has), "achieved is uint8"),
        (lambda goals, has: (goals, has[:1]), "has_achieved must be bool"),
    ],
)
def test_the_check_finds_wrong_achievements(wrong, message):
    def made(num_envs):
        env = envs.make_vec("gridworld/zipf_2", num_envs, observation="tiles", num_objects=3)
        right = env._achieved
        env._achieved = lambda ended: wrong(*right(ended))
        return env

    with pytest.raises(AssertionError, match=message):
        check_goal(partial(envs.goal, "gridworld/zipf_2"), made)
