"""The supervised classifier: its questions, labels and update, and that it learns."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from networks import compact

from zipf import envs
from zipf.agents.agent import AgentSpec
from zipf.agents.hindsight import AchievedOptions
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.supervised import Supervised, SupervisedOptions
from zipf.envs.playroom.blind import BlindExpert
from zipf.envs.playroom.expert import Expert
from zipf.envs.playroom.first_frame import LEFT, RIGHT, FirstFrameVectorEnv
from zipf.envs.playroom.generalist import Generalist
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.single import SingleEnv
from zipf.envs.testing import check_vector_env
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.hooks.augmentation import (
    Draws,
    RandomAugmentation,
    RandomAugmentationOptions,
)
from zipf.experiments.hooks.relabelling import Hindsight
from zipf.experiments.training.host_collector import HostCollector

OPTIONS = SupervisedOptions(
    name="supervised",
    learning_rate=1e-3,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-8,
    max_gradient_norm=1.0,
)
NETWORK = compact(patch=12, channels=8, size=16, head_size=8)
MLP = MLPOptions(name="mlp", size=16, layers=1)
LEVEL = "supervised/find_shape_zipf3"


def classifier(env, memory=MLP, network=NETWORK, spec=None, **changes):
    spaces = env.single_observation_space, env.single_action_space
    spec = AgentSpec(*spaces, network, memory, **(spec or {}))
    return Supervised(OPTIONS.model_copy(update=changes), spec)


# Questions


def test_its_worlds_pass_the_self_check():
    check_vector_env(
        lambda n=1, **options: FirstFrameVectorEnv(n, LEVEL, image_size=(18, 24), **options),
        lambda: SingleEnv(
            lambda n=1, **options: FirstFrameVectorEnv(n, LEVEL, image_size=(18, 24), **options)
        ),
        steps=30,
    )


def test_the_right_answer_is_the_side_of_the_object_on_the_levels_first_frame():
    asked = envs.make_vec(envs.questions(envs.split("playroom_find")).uniform[0], 60)
    played = envs.make_vec("playroom/supervised/find_shape_uniform", 60)
    frames, info = asked.reset(seed=3)
    others, there = played.reset(seed=3)
    for name in frames:
        np.testing.assert_array_equal(frames[name], others[name])
    side = there["side"]
    assert set(side) == {LEFT, RIGHT}
    alike = there["target"] == there["other"]
    _, reward, terminated, truncated, step = asked.step(side)
    assert reward.all()
    assert terminated.all()
    assert not truncated.any()
    assert step["final_info"]["success"].all()
    asked.reset(seed=3)
    _, reward, *_ = asked.step(1 - side)
    np.testing.assert_array_equal(reward > 0, alike)
    # After an episode comes the next of the env's stream, as in the level itself.
    assert (step["target"] != info["target"]).any()


@pytest.mark.slow
@pytest.mark.parametrize("kind", envs.PAPER_KINDS)
def test_random_answers_score_as_their_reference_says(kind):
    [asked] = envs.questions(envs.split("playroom_find")).levels(kind)
    known = envs.baseline("chance", asked, image_size=(18, 24))
    measured = envs.measure_chance(asked, episodes=4000, image_size=(18, 24))
    assert known.episodes is None
    assert measured.score == pytest.approx(known.score, abs=0.025)  # three standard errors
    # Who walks, and is never stopped, is at the wrong object as often as at the right one.
    walked = envs.baseline("blind", asked.name)
    assert (walked.score, walked.by_rank) == (known.score, known.by_rank)
    assert envs.baseline("expert", asked) is None


def test_either_answer_is_right_where_both_objects_are_the_same():
    env = FirstFrameVectorEnv(20, LEVEL)
    for answer in (LEFT, RIGHT):
        env.reset(seed=0, options={"target": 7, "other": 7})
        _, reward, *_ = env.step(np.full(20, answer))
        assert reward.all()


def test_an_answer_achieves_what_names_the_object_on_its_side():
    env = FirstFrameVectorEnv(60, "supervised/find_shape_uniform")
    env.report_achieved()
    for wrong in (False, True):
        frames, info = env.reset(seed=3)
        asked, other = (
            FirstFrameVectorEnv(60, "supervised/find_shape_uniform").reset(
                seed=0, options={"target": info[name], "other": info[name]}
            )[0]["instruction"]
            for name in ("target", "other")
        )
        np.testing.assert_array_equal(asked, frames["instruction"])
        assert (asked != other).any(1).sum() > 50
        *_, step = env.step(1 - info["side"] if wrong else info["side"])
        final = step["final_info"]
        assert final["has_achieved"].all()
        np.testing.assert_array_equal(final["achieved"], other if wrong else asked)


def test_states_that_no_question_has_are_refused():
    level = "supervised/find_shape_uniform"
    asked, played = FirstFrameVectorEnv(2, level), PlayroomVectorEnv(2, level)
    asked.reset(seed=0)
    before = asked.get_state()
    played.reset(seed=0)
    asked.set_state(played.get_state())  # the same envs, at their first frames
    played.step(np.zeros(2, np.int64))
    ended = {**before, "lengths": np.array([2, 0]), "running": np.array([False, True])}
    for state in (played.get_state(), ended):
        with pytest.raises(ValueError, match="not one of questions, or damaged"):
            asked.set_state(state)
        np.testing.assert_equal(asked.get_state(), before)


@pytest.mark.parametrize("player", [Expert, Generalist, BlindExpert])
def test_scripted_players_cannot_answer(player):
    env = FirstFrameVectorEnv(2, LEVEL)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="needs the playroom's 46 actions, got 2"):
        player(env)


def test_levels_without_sides_are_refused():
    with pytest.raises(ValueError, match="no object on the left and on the right"):
        FirstFrameVectorEnv(1, "lift/lift_shape_zipf3")
    for name in ("gridworld", "playroom_lift", "playroom_put"):
        with pytest.raises(ValueError, match=r"left and right|no questions"):
            envs.questions(envs.split(name))
    found = envs.questions(envs.split("playroom_find"))
    assert [level.name for level in found.all_levels] == [
        level.name for level in envs.split("playroom_find").all_levels
    ]


def test_there_are_two_answers():
    with pytest.raises(ValueError, match="one of two answers, not of 46"):
        classifier(envs.make_vec(f"playroom/{LEVEL}", 1))


# Learning


def test_an_update_is_one_step_of_adam_on_the_cross_entropy_of_the_sides():
    env = FirstFrameVectorEnv(4, "supervised/find_shape_uniform")
    made = classifier(env, max_gradient_norm=1e9)
    unroll = HostCollector(env, made, unroll_length=3, seed=1).collect()

    frames, info = env.reset(seed=1)
    sides, alike = [], []
    for t in range(3):
        for name in frames:
            np.testing.assert_array_equal(unroll.steps["observation", name][t], frames[name])
        sides.append(info["side"])
        alike.append(info["target"] == info["other"])
        frames, *_, info = env.step(np.zeros(4, np.int64))
    sides = torch.from_numpy(np.where(alike, unroll.steps["action"][:3], sides))

    baseline = classifier(env)
    optimiser = torch.optim.Adam(baseline.network.parameters(), lr=1e-3)
    loss = torch.zeros(())
    for t in range(3):
        for world in range(4):
            steps = unroll.steps[t : t + 1, world : world + 1]
            logits = baseline.network(Inputs.of(steps), {})[0, 0]
            loss = loss + F.cross_entropy(logits, sides[t, world]) / 12
    loss.backward()
    optimiser.step()
    metrics = made.update(unroll)
    assert metrics["loss"] == pytest.approx(loss.item(), rel=1e-5)
    for one, other in zip(made.network.parameters(), baseline.network.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kept", [None, 2])
def test_with_hindsight_it_learns_relabelled_questions_too(kept):
    """Each shows an image of the unroll, with a name of the object on the side of its answer."""
    level = "supervised/find_shape_uniform"
    options = AchievedOptions(
        name="achieved", episodes=5, length=None, kept_per_goal=kept, reward=1.0,
        advantage="none", policy_cost=0.4, value_cost=0.0, fade=4,
    )  # fmt: skip
    env, changes = FirstFrameVectorEnv(4, level), {"hindsight": options}
    made, plain = classifier(env, spec=changes), classifier(env, spec=changes)
    goal = envs.goal(f"playroom/{level}", env)
    hook = Hindsight(options, goal, env, seed=1)
    collector = HostCollector(env, made, unroll_length=6, seed=1, hooks=[hook])
    frames, info = env.reset(seed=1)
    named = {}
    for _ in range(6):
        for i in range(4):
            ranks = (info["target"][i], info["other"][i])
            sides = (info["side"][i], 1 - info["side"][i])
            named[frames["image"][i].tobytes()] = dict(zip(sides, ranks, strict=True))
        frames, *_, info = env.step(np.zeros(4, np.int64))
    env.reset(seed=1)
    unroll = collector.collect()
    questions = unroll.episodes
    assert questions.shape == (1, 5)
    told = FirstFrameVectorEnv(5, level)
    ranks = [
        named[image.numpy().tobytes()][answer]
        for image, answer in zip(
            questions["observation", "image"][0], questions["action"][0].tolist(), strict=True
        )
    ]
    frames, _ = told.reset(seed=0, options={"target": np.array(ranks), "other": 0})
    np.testing.assert_array_equal(questions["observation", "instruction"][0], frames["instruction"])
    for updates in (0, 1, 4):
        made.updates = plain.updates = updates
        logits = made.network(Inputs.of(questions), {})[0]
        share = 0.4 * max(0, 1 - updates / 4)
        expected = share * F.cross_entropy(logits, questions["action"][0]).item()
        unroll.episodes = questions
        loss = made.update(unroll)["loss"]
        assert made.updates == updates + 1
        unroll.episodes = None
        assert loss == pytest.approx(float(plain.update(unroll)["loss"]) + expected, rel=1e-5)
        plain.load_state_dict(made.state_dict())


class Painted(FirstFrameVectorEnv):
    """Each half of a frame has the colour of its object's rank."""

    def _observe(self, out, mask):
        super()._observe(out, mask)
        middle = out["image"].shape[2] // 2
        for i in np.flatnonzero(mask):
            objects = self.envs.ranks[i, :2][:: 1 if self._side[i] == LEFT else -1]
            out["image"][i, :, :middle], out["image"][i, :, middle:] = 5 * objects[:, None, None]


@pytest.mark.parametrize("kept", [None, 3])
@pytest.mark.parametrize("augmented", [False, True])
def test_relabelled_questions_tell_where_the_named_object_is(kept, augmented):
    """Also in a mirror, moved and scaled: where they say there is nothing but its colour."""
    level = "supervised/find_shape_uniform"
    options = AchievedOptions(
        name="achieved", episodes=100, length=None, kept_per_goal=kept, reward=1.0,
        advantage="none", policy_cost=1.0, value_cost=0.0, fade=None, matching_cost=1.0,
    )  # fmt: skip
    env, draws = Painted(20, level), None
    agent = classifier(env)
    if augmented:
        changes = RandomAugmentationOptions(
            name="random", symmetries=True, channels=False, shift=12, cutout=0, scale=[0.4, 1.4]
        )
        space, symmetries = (
            env.single_observation_space, envs.symmetries(envs.split("playroom_find"), env)
        )  # fmt: skip
        agent.augmentation = RandomAugmentation(changes, space, symmetries=symmetries)
        draws = Draws(agent.augmentation, 20, seed=0)
    goal = envs.goal(f"playroom/{level}", env)
    hooks = [Hindsight(options, goal, env, seed=1, draws=draws)]
    if draws is not None:
        hooks.insert(0, draws)
    collector = HostCollector(env, agent, unroll_length=10, seed=1, hooks=hooks)
    questions = collector.collect().changed(agent.augmentation).episodes
    toys = FirstFrameVectorEnv(50, level)
    frames, _ = toys.reset(seed=0, options={"target": np.arange(50), "other": 0})
    rank_of = {words.tobytes(): rank for rank, words in enumerate(frames["instruction"])}
    sides, edges = set(), set()
    for question in questions[0]:
        image = question["observation", "image"].numpy()
        width = image.shape[1]
        top, left, bottom, right = question["region"].tolist()
        assert (top, bottom) == (0, 1)
        # A pixel at the edge may show either.
        shown = image[:, np.ceil(left * width).astype(int) + 1 : int(right * width) - 1]
        rank = rank_of[question["observation", "instruction"].numpy().tobytes()]
        assert shown.size > 1000
        assert (shown == 5 * rank).all()
        sides.add(int(question["action"]))
        edges.add(round(max(left, 1 - right), 3))
    assert sides == {LEFT, RIGHT}
    assert (len(edges) > 20) == augmented
    plain = options.model_copy(update={"matching_cost": 0.0})
    apart = Painted(20, level)
    hook = Hindsight(plain, goal, apart, seed=1)
    without = HostCollector(apart, classifier(env), unroll_length=10, seed=1, hooks=[hook])
    assert "region" not in without.collect().episodes


def test_answers_are_random_in_training_and_its_best_in_evaluation():
    env = FirstFrameVectorEnv(200, "supervised/find_shape_uniform", image_size=(18, 24))
    made = classifier(env, network=NETWORK.model_copy(update={"patch": 6}))
    policy = AgentPolicy(made, seed=0)
    seen, _ = env.reset(seed=0)
    first = np.ones(200, np.bool_)
    policy.start(200)
    answers = policy(seen, np.zeros(200, np.float32), first)
    np.testing.assert_array_equal(answers, policy(seen, np.zeros(200, np.float32), first))
    collector = HostCollector(env, made, unroll_length=20, seed=0)
    tosses = collector.collect().steps["action"][:-1].float()
    assert 0.47 < tosses.mean() < 0.53
    assert abs(np.corrcoef(tosses[:-1].flatten(), tosses[1:].flatten())[0, 1]) < 0.05


def test_every_frame_is_read_with_an_empty_memory():
    """By an LSTM, in every row of an unroll."""
    env = FirstFrameVectorEnv(3, LEVEL)
    made = classifier(env, memory=LSTMOptions(name="lstm", size=8, layers=1))
    unroll = HostCollector(env, made, unroll_length=4, seed=1).collect()
    inputs = Inputs.of(unroll.steps[:-1])
    together = made.network(inputs, made.initial_memory(3))
    for t in range(4):
        row = Inputs.of(unroll.steps[t : t + 1])
        alone = made.network(row, made.initial_memory(3))
        torch.testing.assert_close(together[t : t + 1], alone)


class Squares(FirstFrameVectorEnv):
    """A white square is on the left or the right of the image; words name black or white."""

    def __init__(self, num_envs, **options):
        super().__init__(num_envs, "supervised/find_shape_uniform", image_size=(12, 24), **options)

    def _observe(self, out, mask):
        words = self._instructions[mask]
        black = self.envs.ranks[mask, 0] % 2
        image = np.zeros((len(words), 12, 24, 3), np.uint8)
        white_is_right = self._side[mask] ^ black
        image[white_is_right == LEFT, :, :12] = 255
        image[white_is_right == RIGHT, :, 12:] = 255
        out["image"][mask] = image
        out["instruction"][mask] = words


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_it_learns_the_side_that_the_words_name(seed):
    """Fifty words stand for two colours; the side depends on both image and words."""
    env = Squares(32)
    spec = AgentSpec(
        env.single_observation_space,
        env.single_action_space,
        NETWORK.model_copy(update={"head_size": 32}),
        MLP.model_copy(update={"size": 64}),
        seed=seed,
    )
    made = Supervised(OPTIONS.model_copy(update={"learning_rate": 5e-3}), spec)
    collector = HostCollector(env, made, unroll_length=4, seed=seed)
    for _ in range(150):
        metrics = made.update(collector.collect())
    assert metrics["accuracy"] >= 0.9
    policy = AgentPolicy(made, seed=0)
    episodes = play(policy, Squares(100), episodes=300, seed=10_000)
    assert (episodes["length"] == 1).all()
    assert episodes["success"].mean() >= 0.95
