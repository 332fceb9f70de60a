"""R2D2: its update against its definition, exploration, replay, resume, and what it learns."""

import shutil
from copy import deepcopy
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import TINY, assert_equal, learned, untimed
from networks import compact
from recall import Recall
from tensordict import TensorDict

from zipf import envs
from zipf.agents import r2d2, replay
from zipf.agents.agent import AgentSpec
from zipf.agents.gtrxl import GTrXLOptions
from zipf.agents.memory import LSTMOptions, MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.r2d2 import R2D2, R2D2Options
from zipf.agents.returns import rescale, unrescale
from zipf.agents.unroll import Unroll
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, feasibility, loading, run_folder
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.options.schema import schema
from zipf.experiments.training import runner
from zipf.experiments.training.host_collector import HostCollector

ACTIONS, STEPS, ENVS, BURN_IN = 3, 6, 4, 2
OPTIONS = R2D2Options(
    name="r2d2",
    learning_rate=1e-3,
    adam_beta1=0.9,
    adam_beta2=0.999,
    adam_epsilon=1e-8,
    weight_decay=1e-4,
    max_gradient_norm=1e9,
    discount=0.9,
    trace_lambda=0.7,
    target_period=3,
    epsilon=0.3,
    epsilon_ladder=False,
    burn_in=BURN_IN,
    final_observations=2,
    samples_per_insert=1.0,
    replay_capacity=20,
    replay_min=8,
    storage="ram",
    priority_exponent=0.9,
    importance_exponent=0.6,
    priority_max_weight=0.8,
    fresh_priority="error",
)
NETWORK = compact(channels=8, size=16, head_size=8)
LSTM = LSTMOptions(name="lstm", size=16, layers=1)
MEMORIES = {
    "lstm": LSTM,
    "lstm2": LSTMOptions(name="lstm", size=16, layers=2),
    "mlp": MLPOptions(name="mlp", size=16, layers=1),
    "gtrxl": GTrXLOptions(
        name="gtrxl", size=16, layers=2, heads=2, memory_length=4, mlp_size=16, gate_bias=2.0
    ),
}


def learn(made, items, weights):
    """One optimiser step on sequences: the metrics, and their new priorities."""
    metrics, kept = made.learn(r2d2.Replayed(items, weights))
    return metrics, kept["priorities"]


def agent(memory=LSTM, worlds=ENVS, seed=0, **changes):
    spec = AgentSpec(
        gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)),
        gym.spaces.Discrete(ACTIONS),
        NETWORK,
        memory,
        num_envs=worlds,
        unroll_length=STEPS,
        seed=seed,
    )
    made = R2D2(OPTIONS.model_copy(update=changes), spec)
    made.begin_learning()
    # Else Q is so small that rescaling does nothing, and target and online network agree.
    with torch.no_grad():
        for parameter in made.network.parameters():
            parameter *= 1.5
        for parameter in made.target.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=torch.Generator())
    return made


def random_steps(rows, batch, seed=0):
    rng = np.random.default_rng(seed)
    shape = (rows, batch)
    ended = torch.tensor(rng.random(shape) < 0.3)
    cut = torch.tensor(rng.random(shape) < 0.5)
    floats = {
        name: torch.tensor(3 * rng.normal(size=shape), dtype=torch.float32)
        for name in ("previous_reward", "reward")
    }
    images = rng.integers(256, size=(*shape, 9, 9, 3))
    return TensorDict(
        {
            **floats,
            "bonus": floats["reward"].abs() / 3,
            "previous_action": torch.tensor(rng.integers(ACTIONS, size=shape)),
            "is_first": torch.cat([torch.zeros(1, batch, dtype=torch.bool), ended[:-1]]),
            "action": torch.tensor(rng.integers(ACTIONS, size=shape)),
            "terminated": ended & ~cut,
            "truncated": ended & cut,
            "observation": TensorDict(
                {"image": torch.tensor(images, dtype=torch.uint8)}, batch_size=shape
            ),
        },
        batch_size=shape,
    )


def finals_of(steps, places=2, seed=0):
    """The first `places` observations that steps [T, B] were truncated at, drawn at random."""
    rng = np.random.default_rng([seed, 1])
    shape = (places, steps.shape[1])
    images = torch.tensor(rng.integers(256, size=(*shape, 9, 9, 3)), dtype=torch.uint8)
    final = TensorDict(
        {
            "step": torch.full(shape, -1),
            "previous_action": torch.full(shape, -1),
            "previous_reward": torch.zeros(shape),
            "is_first": torch.zeros(shape, dtype=torch.bool),
            "observation": TensorDict({"image": images}, shape),
        },
        shape,
    )
    for b in range(shape[1]):
        for k, t in enumerate(steps["truncated"][:, b].nonzero().flatten()[:places].tolist()):
            final["step"][k, b] = t
            final["previous_action"][k, b] = steps["action"][t, b]
            final["previous_reward"][k, b] = steps["reward"][t, b] / 2  # without the bonus
    return final


def random_memory(batch, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return {part: torch.randn(batch, 16, generator=generator) for part in ("hidden", "cell")}


def sequences(batch, seed=0, places=2):
    steps = random_steps(BURN_IN + STEPS + 1, batch, seed)
    memory = TensorDict(random_memory(batch, seed), [batch])
    parts = {"steps": steps.transpose(0, 1), "memory": memory}
    if places:
        parts["final"] = finals_of(steps[BURN_IN:-1], places, seed).transpose(0, 1)
    return TensorDict(parts, [batch])


def unrolls(count, seed=0):
    """Unrolls as a collector's: row T is the next one's first row, and memories follow."""
    steps = random_steps(count * STEPS + 1, ENVS, seed)
    for i in range(count):
        rows = steps[i * STEPS : (i + 1) * STEPS + 1].clone()
        memories = random_memory(ENVS, 2 * i), random_memory(ENVS, 2 * i + 1)
        yield Unroll(rows, *memories, finals_of(rows[:-1], seed=i))


# Rescaling and returns


def h(x):
    return np.sign(x) * (np.sqrt(abs(x) + 1) - 1) + 1e-3 * x


def test_rescaling_equals_the_definition_and_unrescaling_is_its_inverse():
    x = np.concatenate([np.logspace(-6, 6, 100), -np.logspace(-6, 6, 100), [0.0]])
    tensor = torch.tensor(x, dtype=torch.float32)
    np.testing.assert_allclose(rescale(tensor), h(x), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(unrescale(torch.tensor(h(x)).float()), x, rtol=1e-5, atol=1e-12)
    values = pytest.importorskip("torchrl.modules")
    theirs = values.SignedHyperbolicValueTransform(epsilon=1e-3)
    torch.testing.assert_close(rescale(tensor), theirs(tensor), rtol=1e-3, atol=1e-5)


# One update


def unrescaled(y):
    return np.sign(y) * (((np.sqrt(1 + 4e-3 * (abs(y) + 1 + 1e-3)) - 1) / 2e-3) ** 2 - 1)


def by_hand(made, items, weights):
    """The loss of the definition, with gradients, and the new priorities: one sequence and one
    frame at a time."""
    o = made.options
    loss, priorities, actions_differ = 0.0, [], 0
    cut = {"known": 0, "unknown": 0}
    for b in range(len(items)):
        steps = items["steps"][b]
        memory = {name: part[b : b + 1] for name, part in items["memory"].items()}
        q, target_q, at_cut = [], [], {}
        online, target = memory, memory
        final = items["final"][b] if o.final_observations else None
        for t in range(len(steps)):
            frame = Inputs.of(steps[t : t + 1].unsqueeze(1))
            with torch.set_grad_enabled(t >= BURN_IN):
                values, online = made.network(frame, online)
            with torch.no_grad():
                target_values, target = made.target(frame, target)
            if t >= BURN_IN:
                q.append(values[0, 0])
                target_q.append(target_values[0, 0].double().numpy())
            places = range(o.final_observations)
            for k in (k for k in places if final["step"][k] == t - BURN_IN):
                cut_at = Inputs.of(final[k : k + 1].unsqueeze(1))
                with torch.no_grad():
                    best = int(made.network(cut_at, online)[0][0, 0].argmax())
                    y = made.target(cut_at, target)[0][0, 0, best].double().numpy()
                at_cut[t - BURN_IN] = unrescaled(y)
        rows = {name: steps[name][BURN_IN:] for name in steps.keys() if name != "observation"}
        following = 0.0
        errors = [None] * STEPS
        for t in reversed(range(STEPS)):
            best = int(q[t + 1].argmax())
            actions_differ += best != int(target_q[t + 1].argmax())
            value = unrescaled(target_q[t + 1][best])
            if t == STEPS - 1:
                following = value
            following = (1 - o.trace_lambda) * value + o.trace_lambda * following
            if rows["truncated"][t] and t not in at_cut:
                following = unrescaled(target_q[t][int(q[t].argmax())])
                errors[t] = torch.zeros(())
                cut["unknown"] += 1
                continue
            if rows["truncated"][t]:
                following = at_cut[t]
                cut["known"] += 1
            if rows["terminated"][t]:
                following = 0.0
            following = float(rows["reward"][t]) + o.discount * following
            errors[t] = h(following) - q[t][rows["action"][t]]
        squares = sum(error**2 for error in errors) / STEPS
        loss = loss + weights[b] * 0.5 * squares / len(items)
        sizes = [abs(float(error.detach())) for error in errors]
        eta = o.priority_max_weight
        priorities.append(eta * max(sizes) + (1 - eta) * sum(sizes) / STEPS)
    assert actions_differ > 0  # else double Q-learning is not put to the test
    return loss, priorities, cut


@pytest.mark.parametrize(
    ("places", "memory", "seed"),
    [(0, "lstm", 0), (1, "lstm", 3), (2, "lstm", 7), (2, "gtrxl", 0)],
)
def test_the_update_equals_the_definition(places, memory, seed):
    """With room for none, the first or all of the observations that episodes were cut at."""
    torch.manual_seed(seed)
    made = agent(MEMORIES[memory], final_observations=places)
    items = sequences(5, seed, places)
    if memory == "gtrxl":
        state = {name: torch.randn(part.shape) for name, part in made.initial_memory(5).items()}
        items["memory"] = TensorDict({**state, "length": torch.arange(5)}, [5])
    learned = items["steps"][:, BURN_IN:-1]
    assert learned["terminated"].any()
    assert learned["truncated"].any()
    assert items["steps"]["is_first"][:, 1:BURN_IN].any()
    weights = torch.tensor([1.0, 0.2, 0.7, 0.5, 0.9])
    loss, expected, cut = by_hand(made, items, weights)
    assert (cut["known"] > 0, cut["unknown"] > 0) == (places > 0, places < 2)
    if memory == "gtrxl":  # no gradient flows from step to step, as it does in an unroll
        metrics, priorities = learn(made, items, weights)
        assert metrics["loss"] == pytest.approx(loss.item(), rel=1e-4)
        np.testing.assert_allclose(priorities, expected, rtol=1e-4)
        return
    gradients = torch.autograd.grad(loss, list(made.network.parameters()))
    before = deepcopy(made.network.state_dict())
    metrics, priorities = learn(made, items, weights)
    assert metrics["loss"] == pytest.approx(loss.item(), rel=1e-4)
    np.testing.assert_allclose(priorities, expected, rtol=1e-4)
    norm = torch.stack([g.norm() for g in gradients]).norm().item()
    assert metrics["gradient_norm"] == pytest.approx(norm, rel=1e-4)
    for (name, parameter), gradient in zip(made.network.named_parameters(), gradients, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-3, atol=1e-5)
        # AdamW's first step: its size whatever the gradient's, and the decay of the weight.
        step = 1e-3 * (gradient / (gradient.abs() + 1e-8) + 1e-4 * before[name])
        moved = before[name] - parameter
        certain = gradient.abs() > 1e-4
        torch.testing.assert_close(moved[certain], step[certain], rtol=1e-2, atol=1e-6)


def test_repeated_updates_reduce_the_loss():
    made, items = agent(learning_rate=3e-3, target_period=1000), sequences(5)
    losses = [learn(made, items, torch.ones(5))[0]["loss"] for _ in range(100)]
    assert losses[-1] < 0.1 * losses[0]


def test_training_on_means_equals_training_on_sums_over_time():
    """If the bound on the gradient's norm and Adam's epsilon are divided by the sequence's length,
    as configs/ does with the paper's. Without that, training differs."""
    bound, epsilon = 0.2, 1e-3
    summed = agent(max_gradient_norm=bound, adam_epsilon=epsilon)
    mean = agent(max_gradient_norm=bound / STEPS, adam_epsilon=epsilon / STEPS)
    unscaled = agent(max_gradient_norm=bound, adam_epsilon=epsilon)
    for seed in range(20):
        items, weights = sequences(5, seed), torch.rand(5)
        metrics, _ = learn(summed, items, STEPS * weights)
        assert metrics["gradient_norm"] > bound
        learn(mean, items, weights)
        learn(unscaled, items, weights)

    def parameters(made):
        return torch.cat([p.detach().flatten() for p in made.network.parameters()])

    moved = (parameters(summed) - parameters(agent())).norm()
    assert (parameters(mean) - parameters(summed)).norm() < 1e-3 * moved
    assert (parameters(unscaled) - parameters(summed)).norm() > 0.05 * moved


def test_the_target_network_is_copied_every_target_period():
    made = agent(target_period=3)

    def same():
        pairs = zip(made.network.parameters(), made.target.parameters(), strict=True)
        return all(torch.equal(one, other) for one, other in pairs)

    followed = []
    for seed in range(7):
        learn(made, sequences(2, seed), torch.ones(2))
        followed.append(same())
    assert followed == [False, False, True, False, False, True, False]


def test_a_step_that_ends_and_is_cut_is_learned_as_its_end():
    """Its reward, without a final observation, which only a cut needs."""
    made, items = agent(), sequences(5)
    steps = items["steps"]
    for name, value in (("reward", 0.0), ("terminated", True), ("truncated", True)):
        steps[name].fill_(value)
    with torch.no_grad():
        _, before, _ = made._losses(items)
        steps["reward"].fill_(1.0)
        _, after, _ = made._losses(items)
    assert (after > before + 0.1).all()


def test_values_at_truncations_follow_the_target_network():
    """They are not those that the agent had when it acted: with all rewards 0 and every step cut,
    a target network of larger Q makes all returns larger."""
    made, items = agent(final_observations=STEPS), sequences(5)
    steps = items["steps"]
    for name, value in (("reward", 0.0), ("terminated", False), ("truncated", True)):
        steps[name].fill_(value)
    steps["is_first"][:, BURN_IN + 1 :] = True
    items["final"] = finals_of(steps.transpose(0, 1)[BURN_IN:-1], STEPS).transpose(0, 1)
    with torch.no_grad():
        _, before, _ = made._losses(items)
        made.target.value[-1].bias += 1.0
        _, after, _ = made._losses(items)
    assert (after > before + 0.5).all()


# Replay


@pytest.mark.parametrize("burn_in", [0, BURN_IN, STEPS])
def test_replay_holds_unrolls_with_the_rows_before_them(burn_in):
    made = agent(burn_in=burn_in, replay_min=20)
    collected = list(unrolls(3))
    history = torch.cat([*(unroll.steps[:-1] for unroll in collected), collected[-1].steps[-1:]])
    for unroll in collected:
        reused = unroll.steps.clone()
        final = unroll.final.clone()
        made.update(Unroll(reused, unroll.memory, unroll.late_memory, final))
        reused.zero_()  # as the collector writes over it
        final.zero_()
    without = 1 if burn_in else 0
    assert len(made.replay) == (3 - without) * ENVS
    items, _, _ = made.replay.sample(64)
    assert set(items["number"].tolist()) == set(range(len(made.replay)))
    for item in items:
        which, world = divmod(int(item["number"]), ENVS)
        first = (which + without) * STEPS - burn_in
        expected = history[first : first + burn_in + STEPS + 1, world]
        for name in ("action", "is_first", "truncated", ("observation", "image")):
            assert torch.equal(item["steps"][name], expected[name])
        for name in ("step", "previous_action", "previous_reward", ("observation", "image")):
            kept = collected[which + without].final[name][:, world]
            assert torch.equal(item["final"][name], kept)
        assert torch.equal(item["steps"]["reward"], expected["reward"] + expected["bonus"])
        memory = collected[which].late_memory if burn_in else collected[which].memory
        for name, part in memory.items():
            assert torch.equal(item["memory"][name], part[world])


def test_no_step_is_taken_before_replay_min_sequences():
    made = agent(replay_min=8, replay_capacity=16)
    learned, sizes, inserted = [], [], []
    for unroll in unrolls(6):
        metrics = made.update(unroll)
        learned.append(not np.isnan(float(metrics["loss"])))
        sizes.append(metrics["replay_sequences"])
        inserted.append(metrics["replay_inserted"])
        assert list(metrics) == [*r2d2.METRICS, "replay_sequences", "replay_inserted"]
        assert made.updates == sum(learned)
    assert sizes == [0, 4, 8, 12, 16, 16]
    assert inserted == [0, 4, 4, 4, 4, 4]
    assert learned == [False, False, True, True, True, True]


@pytest.mark.parametrize(("samples", "worlds", "size"), [(0.5, 4, 2), (0.29, 100, 29)])
def test_a_batch_has_so_many_samples_for_each_insert(samples, worlds, size):
    made = agent(worlds=worlds, samples_per_insert=samples, replay_min=100, replay_capacity=100)
    assert made.batch_size == size  # 0.29 * 100 is a little less than 29


def test_the_seed_draws_from_replay():
    draws = []
    for seed in (1, 1, 2):
        replay = agent(seed=seed).replay
        replay.insert(sequences(8))  # priorities are alike: the draws depend on the seed alone
        draws.append([replay.sample(3)[1].tolist() for _ in range(10)])
    assert draws[0] == draws[1]
    assert draws[0] != draws[2]


def test_replay_has_the_exponents_of_the_options():
    replay = agent(priority_exponent=0.5, importance_exponent=2.0).replay
    slots = replay.insert(sequences(4))
    replay.update_priorities(slots, torch.tensor([1.0, 4.0, 9.0, 16.0]))
    _, drawn, importance = replay.sample(40)
    assert drawn.bincount().tolist() == [4, 8, 12, 16]
    torch.testing.assert_close(importance, (drawn + 1.0) ** -2)


def test_priorities_are_those_of_the_learned_sequences():
    made = agent(replay_min=8, samples_per_insert=0.5, fresh_priority="largest")
    for unroll in unrolls(3):
        made.update(unroll)
    before = made.replay._buffer.sampler.leaves.clone()
    batches = []
    sample, learned = made.replay.sample, made.learn
    made.replay.sample = lambda size: batches.append(sample(size)) or batches[-1]
    made.learn = lambda batch: batches.append(learned(batch)) or batches[-1]
    made.update(next(unrolls(1, seed=1)))
    (_, index, _), (_, kept) = batches
    priorities = kept["priorities"]
    assert len(index) == 2
    after = made.replay._buffer.sampler.leaves
    np.testing.assert_allclose(after[index], priorities.numpy() ** 0.9, rtol=1e-5)
    others = np.setdiff1d(np.arange(8), index)  # what was there, and was not drawn
    np.testing.assert_array_equal(after[others], before[others])


def test_a_fresh_sequence_has_the_priority_of_its_errors_or_the_largest():
    made, other = agent(replay_min=20), agent(replay_min=20, fresh_priority="largest")
    for unroll in unrolls(3):
        made.update(unroll)
        other.update(unroll)
    items = made.replay._buffer.storage[:8]
    _, priorities = learn(made, items, torch.ones(8))
    leaves = made.replay._buffer.sampler.leaves
    np.testing.assert_allclose(leaves[:8], priorities.numpy() ** 0.9, rtol=1e-4)
    assert len(set(leaves[:8].tolist())) == 8
    np.testing.assert_array_equal(other.replay._buffer.sampler.leaves[:8], 1.0)


@pytest.mark.parametrize("memory", MEMORIES.values(), ids=MEMORIES)
@pytest.mark.parametrize("storage", ["ram", "memmap"])
def test_after_the_burn_in_memory_equals_that_of_the_whole_history(memory, storage, tmp_path):
    """With weights that do not change: Q of replayed steps is Q from the start of the history."""
    env = Recall(ENVS, 3)
    spec = AgentSpec(
        env.single_observation_space,
        env.single_action_space,
        NETWORK,
        memory,
        num_envs=ENVS,
        unroll_length=STEPS,
    )
    made = R2D2(OPTIONS.model_copy(update={"replay_min": 20, "storage": storage}), spec)
    made.begin_learning(tmp_path)
    collector = HostCollector(env, made, unroll_length=STEPS, seed=0)
    history = []
    for _ in range(4):
        unroll = collector.collect()
        history.append(unroll.steps[:-1].clone())
        made.update(unroll)
    history = torch.cat([*history, unroll.steps[-1:]])
    with torch.no_grad():
        whole, _ = made.network(Inputs.of(history), made.initial_memory(ENVS))
        for item in made.replay.sample(32)[0]:
            which, world = divmod(int(item["number"]), ENVS)
            steps = item["steps"].unsqueeze(1)
            state = {name: part.unsqueeze(0) for name, part in item["memory"].items()}
            _, state = made.network(Inputs.of(steps[:BURN_IN]), state)
            q, _ = made.network(Inputs.of(steps[BURN_IN:]), state)
            first = (which + 1) * STEPS
            expected = whole[first : first + STEPS + 1, world]
            torch.testing.assert_close(q[:, 0], expected, rtol=1e-4, atol=1e-5)


# Acting


def frames(n):
    return Inputs(
        {"image": torch.full((n, 9, 9, 3), 200, dtype=torch.uint8)},
        torch.full((n,), -1),
        torch.zeros(n),
        torch.ones(n, dtype=torch.bool),
    )


def test_random_actions_have_probability_epsilon_and_none_are_taken_in_evaluation():
    n = 3000
    made = agent(worlds=n, epsilon=0.3, replay_capacity=n)
    generator = torch.Generator().manual_seed(0)
    memory = made.initial_memory(n)
    action, _, _ = made.act(frames(n), memory, generator, training=False)
    q, _ = made.network(frames(n).unsqueeze(), memory)
    assert (action == q[0].argmax(-1)).all()
    greedy = int(action[0])
    action, _, nothing = made.act(frames(n), memory, generator)
    assert nothing == {}
    expected = np.full(ACTIONS, 0.3 / ACTIONS)
    expected[greedy] += 0.7
    frequencies = np.bincount(action, minlength=ACTIONS) / n
    sigma = np.sqrt(expected * (1 - expected) / n)
    assert (abs(frequencies - expected) < 4 * sigma).all()


def test_the_epsilon_ladder():
    worlds = 8
    made = agent(worlds=worlds, epsilon=0.4, epsilon_ladder=True)
    expected = [0.4 ** (1 + 7 * i / (worlds - 1)) for i in range(worlds)]
    np.testing.assert_allclose(made.epsilon.sort(descending=True).values, expected)
    expected = made.epsilon.tolist()
    generator = torch.Generator().manual_seed(0)
    memory = made.initial_memory(worlds)
    greedy, _, _ = made.act(frames(worlds), memory, generator, training=False)
    other = np.zeros(worlds)
    for _ in range(2000):
        other += (made.act(frames(worlds), memory, generator)[0] != greedy).numpy() / 2000
    probability = np.array(expected) * (ACTIONS - 1) / ACTIONS
    assert (abs(other - probability) < 4 * np.sqrt(probability * (1 - probability) / 2000)).all()
    assert agent(worlds=1, epsilon_ladder=True, epsilon=0.4).epsilon.tolist() == [0.4]


def test_levels_with_a_row_of_worlds_each_explore_alike():
    made = agent(worlds=32, epsilon=0.4, epsilon_ladder=True, replay_capacity=40)
    places = (made.epsilon.log() / np.log(0.4) - 1) / 7
    assert abs(places.reshape(2, 16).mean(1) - 0.5).max() < 0.15


def test_the_mean_advantage_is_subtracted():
    made = agent()
    with torch.no_grad():
        core, _ = made.network.remember(frames(2).unsqueeze(), made.initial_memory(2))
        q, _ = made.network(frames(2).unsqueeze(), made.initial_memory(2))
        torch.testing.assert_close(q.mean(-1), made.network.value(core).squeeze(-1))


# Options


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"samples_per_insert": 0.3}, "agent.samples_per_insert=0.3"),
        ({"samples_per_insert": 0.1}, "0.4 sequences a batch"),
        ({"burn_in": 7}, "agent.burn_in=7: should be at most collector.unroll_length=6"),
        ({"replay_capacity": 3, "replay_min": 1}, "agent.replay_capacity=3: should be at least"),
        ({"replay_min": 21}, "agent.replay_min=21: should be at most agent.replay_capacity=20"),
    ],
)
def test_impossible_options_are_refused(changes, told):
    with pytest.raises(ValueError, match=told.replace(".", r"\.")):
        agent(**changes)


def test_impossible_options_are_reported_before_a_run(tmp_path):
    wrong = config(tmp_path, burn_in=7, samples_per_insert=0.25)
    assert list(feasibility.problems(wrong)) == [
        "agent.samples_per_insert=0.25: times collector.num_envs=6 is 1.5 sequences a batch; "
        "should be a whole number",
        "agent.burn_in=7: should be at most collector.unroll_length=5",
    ]
    with pytest.raises(ValueError, match="burn-in of 2 rows is longer than an unroll of 1"):
        HostCollector(Recall(ENVS, 3), agent(), unroll_length=1, seed=0)


# Runs


def config(root, *overrides, **changes):
    """A tiny run of R2D2."""
    values = loading.load([*TINY, "updates=12", f"run_root={root}", *overrides]).model_dump()
    values["agent"] = (
        OPTIONS.model_dump()
        | {"replay_capacity": 24, "replay_min": 12, "target_period": 2}
        | changes
    )
    return schema().model_validate(values | {"condition": "r2d2"})


def train_until_killed(options, update):
    """A run that is killed after an update, without a checkpoint there."""
    run_folder.make(options.folder)
    with runner.Run(options) as run:
        run.evaluate()
        run.save()
        while run.update < update:
            run.log(*run.step())
            if run.update % options.schedule.checkpoint_every == 0:
                run.save()


@pytest.mark.parametrize("storage", ["ram", "memmap"])
def test_a_killed_run_resumes_bit_for_bit(storage, tmp_path):
    """Killed four updates after a checkpoint, when replay was full and had wrapped around."""
    whole = config(tmp_path / "whole", storage=storage)
    cut = config(tmp_path / "cut", storage=storage)
    assert runner.train(whole) == 0
    train_until_killed(cut, 9)
    assert checkpoint.load(cut.folder / "checkpoint.pt")["update"] == 5
    assert runner.train(cut) == 0
    assert_equal(learned(whole.folder), learned(cut.folder))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        tables = (untimed(run.folder / name) for run in (whole, cut))
        one, other = (table[table["update"] > 5].reset_index(drop=True) for table in tables)
        pd.testing.assert_frame_equal(one, other)
    assert list(one["update"].unique()) == [8, 12]


def test_a_run_without_its_replay_files_does_not_resume(tmp_path):
    options = config(tmp_path, storage="memmap")
    train_until_killed(options, 5)
    seldom = options.model_copy(
        update={"schedule": options.schedule.model_copy(update={"checkpoint_every": 6})}
    )
    with pytest.raises(UserError, match=r"replay: has room for 30 items .* and 36 are needed"):
        runner.train(seldom)
    shutil.rmtree(options.folder / "replay")
    with pytest.raises(UserError, match="this file of the replay is missing"):
        runner.train(options)


def test_the_size_of_replay_is_shown_and_refused_where_it_does_not_fit(tmp_path, monkeypatch):
    options = config(tmp_path, storage="ram")
    train_until_killed(options, 3)
    log = (options.folder / "train.log").read_text()
    assert "replay: 24 sequences of 8 rows, " in log
    assert "replay: 1 samples per insert, batches of 6; learning begins with 12 sequences" in log
    monkeypatch.setattr(replay, "free_ram", lambda: 1_000_000)
    with pytest.raises(UserError, match=r"and 1\.0 MB are free: agent\.replay_capacity="):
        runner.train(config(tmp_path / "other", storage="ram"))
    assert not (tmp_path / "other" / "demo" / "r2d2" / "seed0" / "checkpoint.pt").exists()
    # Scoring needs no replay.
    trained = load_agent(options.folder, "cpu")
    assert trained.agent.replay is None
    saved = checkpoint.load(options.folder / "checkpoint.pt")["agent"]["network"]
    assert_equal(dict(trained.agent.network.state_dict()), dict(saved))


# Learning

LEARNER = OPTIONS.model_copy(
    update={
        "learning_rate": 2e-3,
        "max_gradient_norm": 1.0,
        "discount": 0.95,
        "trace_lambda": 0.8,
        "target_period": 20,
        "epsilon": 0.2,
        "burn_in": 3,
        "replay_capacity": 2000,
        "replay_min": 100,
        "priority_max_weight": 0.9,
        "fresh_priority": "largest",
    }
)


def trained(env, network, memory, *, unroll_length, updates, seed):
    """The policy after each of these numbers of updates, in ascending order."""
    spec = AgentSpec(
        env.single_observation_space,
        env.single_action_space,
        network,
        memory,
        num_envs=env.num_envs,
        unroll_length=unroll_length,
        seed=seed,
    )
    made = R2D2(LEARNER, spec)
    made.begin_learning()
    collector = HostCollector(env, made, unroll_length=unroll_length, seed=seed)
    for update in range(1, updates[-1] + 1):
        made.update(collector.collect())
        if update in updates:
            yield AgentPolicy(made, seed=seed)


@pytest.mark.slow
def test_r2d2_learns_to_find_three_goals_in_a_room():
    """Touching a random one scores a third, touching the cued one 1. The median of five scores: the
    greedy policy may be caught in a circle at one of the cues, and 50 updates later it is not."""
    options = {
        "num_maps": 1,
        "num_rooms": [1, 1],
        "room_size": [5, 5],
        "num_objects": 3,
        "max_steps": 20,
        "observation": "tiles",
    }
    policies = trained(
        envs.make_vec("gridworld/uniform", 16, **options),
        compact(patch=None, channels=16, size=64),
        MLPOptions(name="mlp", size=64, layers=1),
        unroll_length=10,
        updates=(300, 350, 400, 450, 500),
        seed=0,
    )
    env = envs.make_vec("gridworld/uniform", 100, **options)
    scores = [play(p, env, episodes=200, seed=2)["success"].mean() for p in policies]
    assert np.median(scores) >= 0.95, scores


@pytest.mark.slow
def test_r2d2_learns_to_recall():
    """A cue of four steps ago, also across the bounds of sequences; chance is 1/4."""
    delay = 4
    (policy,) = trained(
        Recall(32, delay),
        compact(channels=16, size=16),
        LSTMOptions(name="lstm", size=32, layers=1),
        unroll_length=2 * (delay + 1),
        updates=(350,),
        seed=0,
    )
    assert play(policy, Recall(100, delay), episodes=300, seed=2)["success"].mean() >= 0.95


def test_sequences_are_cut_on_their_device():
    made = agent()
    memory = {name: part.to("meta") for name, part in made.initial_memory(1).items()}
    sequences = replace(made.sequences, device="meta")
    empty = sequences.empty(memory)
    for unroll in unrolls(2):
        cut = sequences.of_unroll(unroll.to("meta"))
    assert {part.device.type for part in cut.values(True, True)} == {"meta"}
    assert {part.device.type for part in empty.values(True, True)} == {"meta"}
    assert {name: part.shape for name, part in cut[0].items(True, True)} == {
        name: part.shape for name, part in empty.items(True, True)
    }
