"""Imitation: its loss by its definition, labels and who acts, and that it learns."""

import gymnasium as gym
import numpy as np
import pytest
import tiny_gridworld
import torch
from conftest import random_unroll
from networks import compact
from test_hindsight import OPTIONS as HINDSIGHT
from test_hindsight import episodes_of

from zipf import envs
from zipf.agents.agent import AgentSpec
from zipf.agents.hindsight import NO_HINDSIGHT
from zipf.agents.imitation import Imitation, ImitationOptions
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.envs.policies import Teacher
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.hooks.labels import Labels
from zipf.experiments.training.host_collector import HostCollector

ACTIONS, STEPS, BATCH = 3, 6, 4
OPTIONS = ImitationOptions(
    name="imitation",
    teacher="expert",
    teacher_share=0.0,
    likeliest=True,
    learning_rate=1e-3,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-8,
    max_gradient_norm=1e9,
)


RELABELLING = HINDSIGHT.model_copy(
    update={"episodes": 3, "advantage": "none", "policy_cost": 0.5, "value_cost": 0.0, "fade": 10}
)


def build(observation_space, action_space, memory=None, hindsight=NO_HINDSIGHT, **changes):
    memory = memory or LSTMOptions(name="lstm", size=16, layers=1)
    spec = AgentSpec(observation_space, action_space, compact(), memory, hindsight=hindsight)
    return Imitation(OPTIONS.model_copy(update=changes), spec)


def test_the_loss_is_its_definition():
    space = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8))
    agent = build(space, gym.spaces.Discrete(ACTIONS))
    data = random_unroll(STEPS, BATCH, ACTIONS, 0)
    generator = torch.Generator().manual_seed(1)
    data.steps["label"] = torch.randint(ACTIONS, (STEPS + 1, BATCH), generator=generator)
    with torch.no_grad():
        logits, _, _ = agent.network(Inputs.of(data.steps), data.memory)
    loss, right = 0.0, 0
    for t in range(STEPS):
        for b in range(BATCH):
            label = data.steps["label"][t, b]
            loss -= float(logits[t, b].double().log_softmax(-1)[label]) / (STEPS * BATCH)
            right += int(logits[t, b].argmax() == label)
    metrics = agent.update(data)
    assert metrics["loss"] == metrics["imitation_loss"] == pytest.approx(loss, rel=1e-5)
    assert metrics["accuracy"] == pytest.approx(right / (STEPS * BATCH))
    assert agent.update(data)["loss"] < metrics["loss"]


def test_the_loss_of_relabelled_episodes_is_its_definition():
    """Each is unrolled alone from an empty memory; the cost falls as the agent learns."""
    space = gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8))
    data = random_unroll(STEPS, BATCH, ACTIONS, 0)
    data.steps["label"] = torch.zeros(STEPS + 1, BATCH, dtype=torch.int64)
    plain = build(space, gym.spaces.Discrete(ACTIONS)).update(data)["loss"]
    agent = build(space, gym.spaces.Discrete(ACTIONS), hindsight=RELABELLING)
    assert agent.update(data)["loss"] == plain
    lengths = [2, 5, 3]
    data.episodes = episodes_of(lengths, actions=ACTIONS)
    expected, right = 0.0, 0
    for e, length in enumerate(lengths):
        episode = data.episodes[:length, e : e + 1]
        with torch.no_grad():
            logits, _, _ = agent.network(Inputs.of(episode), agent.initial_memory(1))
        for t in range(length):
            action = episode["action"][t, 0]
            expected -= float(logits[t, 0].double().log_softmax(-1)[action]) / sum(lengths)
            right += int(logits[t, 0].argmax() == action)
    metrics = agent.update(data)
    assert metrics["loss"] - metrics["imitation_loss"] == pytest.approx(0.45 * expected, rel=1e-4)
    assert metrics["hindsight_accuracy"] == pytest.approx(right / sum(lengths))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_teacher_labels_every_step_and_acts_in_its_share(share):
    env = envs.make_vec("gridworld/zipf_2", 64)
    agent = build(env.single_observation_space, env.single_action_space, teacher_share=share)
    split = envs.split("gridworld")
    labels = Labels(Teacher("expert", split, env), share)
    collector = HostCollector(env, agent, unroll_length=8, seed=0, hooks=[labels])
    twin, expert = envs.make_vec("gridworld/zipf_2", 64), []
    asked = envs.expert("gridworld/zipf_2", twin)
    twin.reset(seed=0)
    unroll = collector.collect()
    for t in range(8):
        expert.append(asked())
        twin.step(unroll.steps["action"][t].numpy())
    labels, actions = unroll.steps["label"][:-1], unroll.steps["action"][:-1]
    assert np.array_equal(labels.numpy(), expert)
    agree = float((labels == actions).float().mean())
    # The agent that has not learned agrees by chance, an eighth.
    assert agree == pytest.approx(share + (1 - share) / 8, abs=0.06)


@pytest.mark.slow
def test_it_learns_what_its_teacher_does():
    def learner(observation_space, action_space):
        memory = MLPOptions(name="mlp", size=32, layers=1)
        return build(observation_space, action_space, memory, learning_rate=3e-3)

    env = envs.make_vec("gridworld/uniform", 64, **tiny_gridworld.ENVS)
    agent = learner(env.single_observation_space, env.single_action_space)
    teacher = Teacher("expert", envs.split("gridworld"), env)
    collector = HostCollector(env, agent, unroll_length=8, seed=0, hooks=[Labels(teacher, 0.0)])
    for _ in range(100):
        agent.update(collector.collect())
    test = envs.make_vec("gridworld/uniform", 100, **tiny_gridworld.ENVS)
    played = play(AgentPolicy(agent, seed=1), test, episodes=500, seed=2)
    assert played["success"].mean() > 0.8  # chance is a third


@pytest.mark.parametrize(
    ("split", "options"),
    [("playroom_put", {"image_size": (3, 4), "max_steps": 9}), ("gridworld", {"max_steps": 30})],
)
def test_a_teachers_memory_is_restored(split, options):
    """In envs where random actions are taken, with several levels in a batch or one."""
    found = envs.split(split)
    one, other = (envs.make_train(found, 3, **options) for _ in range(2))
    teacher, resumed = (Teacher("generalist", found, env) for env in (one, other))
    rng = np.random.default_rng(0)
    one.reset(seed=0)
    count = int(one.single_action_space.n)
    for _ in range(7):
        teacher()
        one.step(rng.integers(count, size=3))
    other.reset(seed=1)
    other.set_state(one.get_state())
    resumed.set_state(teacher.get_state())
    for _ in range(12):
        actions = teacher()
        assert np.array_equal(actions, resumed())
        for env in (one, other):
            env.step(actions)


def test_one_player_labels_all_levels_with_an_engine():
    """As each level's own player would."""
    found = envs.split("playroom_put")
    env = envs.make_train(found, 6, image_size=(3, 4), max_steps=9)
    teacher = Teacher("generalist", found, env)
    levels = zip(env.level_names, env.batches, strict=True)
    own = [envs.generalist(level, batch) for level, batch in levels]
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(12):
        answers = [player() for player in own]
        assert teacher().tolist() == [answers[k][i] for i, k in enumerate(env.levels_of_envs)]
        env.step(rng.integers(int(env.single_action_space.n), size=6))


@pytest.mark.parametrize("name", ["expert", "generalist"])
def test_an_engine_without_envs_is_asked_for_no_action(name):
    """Of two levels that are drawn, one may not have been yet."""
    find, lift = "playroom/supervised/find_shape_zipf3", "playroom/lift/lift_shape_zipf3"
    found = envs.Split("two", (find, lift), find, draw="resets")
    env = envs.make_train(found, 3, image_size=(3, 4), max_steps=9)
    teacher = Teacher(name, found, env)
    env.reset(seed=0, options={"level": np.array([0, 0, 0])})
    for _ in range(12):
        assert teacher().shape == (3,)
        env.step(teacher())


def test_experts_with_plans_of_their_own_are_asked_once_a_step():
    """In the labyrinth, where all tasks are on one engine and asking again may change the plan."""
    found, options = envs.split("labyrinth_forward"), {"image_size": (3, 4), "max_steps": 9}
    env, twin = (envs.make_train(found, 6, **options) for _ in range(2))
    teacher, expert = Teacher("expert", found, env), envs.expert("labyrinth/forward_zipf", twin)
    rng = np.random.default_rng(0)
    for worlds in (env, twin):
        worlds.reset(seed=0)
    for _ in range(30):
        assert np.array_equal(teacher(), expert())
        actions = rng.integers(int(env.single_action_space.n), size=6)
        for worlds in (env, twin):
            worlds.step(actions)


def test_levels_without_such_a_player_are_named(monkeypatch):
    found = envs.split("gridworld")
    env = envs.make_train(found, 1)
    monkeypatch.setitem(envs.find_family("gridworld").__dict__, "generalist", None)
    with pytest.raises(ValueError, match="the levels of gridworld have no generalist"):
        Teacher("generalist", found, env)


def test_it_is_scored_by_its_likeliest_actions():
    env = envs.make_vec("gridworld/zipf_2", 32)
    agent = build(
        env.single_observation_space,
        env.single_action_space,
        MLPOptions(name="mlp", size=8, layers=1),
    )
    observation, _ = env.reset(seed=0)
    inputs = Inputs(
        {name: torch.from_numpy(part) for name, part in observation.items()},
        torch.full((32,), -1),
        torch.zeros(32),
        torch.ones(32, dtype=torch.bool),
    )
    logits, _, _ = agent.network(inputs.unsqueeze(), {})
    generator = torch.Generator().manual_seed(0)
    scored, _, _ = agent.act(inputs, {}, generator, training=False)
    assert torch.equal(scored, logits[0].argmax(-1))
    sampled, _, _ = agent.act(inputs, {}, generator)
    assert not torch.equal(sampled, scored)
    agent.options = agent.options.model_copy(update={"likeliest": False})
    again, _, known = agent.act(inputs, {}, torch.Generator().manual_seed(0), training=False)
    assert torch.equal(again, agent.act(inputs, {}, torch.Generator().manual_seed(0))[0])
    assert not torch.equal(again, scored)
    assert torch.equal(known["logits"].argmax(-1), scored)  # what `deterministic=True` takes
