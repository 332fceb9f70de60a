"""Unrolls: what they hold is what happened, in envs played one by one."""

import math
from copy import deepcopy
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from conftest import assert_equal
from noise import Noise

from zipf import envs
from zipf.agents.network import Inputs
from zipf.envs.mixture import Mixture
from zipf.experiments.building import loading
from zipf.experiments.building.factory import build_agent
from zipf.experiments.hooks.bonus import Bonus
from zipf.experiments.hooks.exploration import (
    CountBonus,
    CountOptions,
    FirstVisitBonus,
    FirstVisitOptions,
)
from zipf.experiments.hooks.hook import Hook
from zipf.experiments.hooks.rewards import SoftAsymmetric, TimeLimitsEnd, soft_asymmetric
from zipf.experiments.training.host_collector import HostCollector

ENVS, STEPS = 6, 9
SMALL = {"num_maps": 5, "num_rooms": [2, 2], "num_objects": 5, "max_steps": 7}


def build(*overrides, exploration=None, seed=3):
    options = loading.load(
        [
            "experiment=demo",
            f"collector.num_envs={ENVS}",
            f"collector.unroll_length={STEPS}",
            "environment.max_steps=7",
            *overrides,
        ]
    )
    env = envs.make_vec("gridworld/zipf_2", ENVS, **SMALL)
    agent = build_agent(options, env)
    hooks = [] if exploration is None else [exploration]
    collector = HostCollector(env, agent, unroll_length=STEPS, seed=seed, hooks=hooks)
    return agent, collector


@pytest.mark.parametrize("memory", ["lstm", "mlp"])
def test_an_unroll_is_what_single_worlds_would_have_been(memory):
    agent, collector = build(f"memory={memory}")
    singles = [envs.make("gridworld/zipf_2", **SMALL) for _ in range(ENVS)]
    first = [env.reset(seed=3 + i)[0]["image"] for i, env in enumerate(singles)]
    action = np.full(ENVS, -1)
    reward = np.zeros(ENVS)
    is_first = np.ones(ENVS, bool)
    carried = agent.initial_memory(ENVS)
    ends = {"terminated": 0, "truncated": 0}
    for _ in range(4):
        unroll = collector.collect()
        for name in carried:
            torch.testing.assert_close(unroll.memory[name], carried[name])
        memory_state = unroll.memory
        for t in range(STEPS + 1):
            row = {
                name: np.asarray(unroll.steps[name][t])
                for name in unroll.steps.keys()
                if name != "observation"
            }
            image = np.asarray(unroll.steps["observation", "image"][t])
            np.testing.assert_array_equal(image, np.stack(first))
            np.testing.assert_array_equal(row["previous_action"], action)
            np.testing.assert_array_equal(row["previous_reward"], reward)
            np.testing.assert_array_equal(row["is_first"], is_first)
            if t == STEPS:
                break
            inputs = Inputs.of(unroll.steps[t])
            outputs = agent.network(inputs.unsqueeze(), memory_state)
            memory_state = outputs.state
            torch.testing.assert_close(unroll.steps["logits"][t], outputs.logits[0])
            for i, env in enumerate(singles):
                observation, r, terminated, truncated, _ = env.step(int(row["action"][i]))
                assert (r, terminated, truncated) == (
                    row["reward"][i],
                    row["terminated"][i],
                    row["truncated"][i],
                )
                expected = 0.0
                if truncated:
                    one = Inputs(
                        {"image": torch.from_numpy(observation["image"])[None]},
                        torch.tensor([row["action"][i]]),
                        torch.tensor([r], dtype=torch.float32),
                        torch.tensor([False]),
                    )
                    memory_i = {name: part[i : i + 1] for name, part in memory_state.items()}
                    expected = agent.value(one, memory_i).item()
                np.testing.assert_allclose(
                    row["truncation_value"][i], expected, rtol=1e-4, atol=1e-6
                )
                over = terminated or truncated
                ends["terminated"] += terminated
                ends["truncated"] += truncated
                first[i] = env.reset()[0]["image"] if over else observation["image"]
                action[i] = -1 if over else row["action"][i]
                reward[i] = 0.0 if over else r
                is_first[i] = over
        carried = memory_state
    assert min(ends.values()) > 3


@pytest.mark.parametrize("places", [1, 3])
def test_an_unroll_holds_the_observations_that_episodes_were_truncated_at(places):
    """The first of each env, for an agent that asks for them."""
    agent, collector = build("condition=r2d2", f"agent.final_observations={places}")
    singles = [envs.make("gridworld/zipf_2", **{**SMALL, "max_steps": 3}) for _ in range(ENVS)]
    env = envs.make_vec("gridworld/zipf_2", ENVS, **{**SMALL, "max_steps": 3})
    collector = HostCollector(env, agent, unroll_length=STEPS, seed=3)
    for i, single in enumerate(singles):
        single.reset(seed=3 + i)
    left_out = 0
    for _ in range(3):
        unroll = collector.collect()
        assert not unroll.steps["truncation_value"].any()
        for i, single in enumerate(singles):
            expected = []
            for t in range(STEPS):
                action = int(unroll.steps["action"][t, i])
                observation, reward, terminated, truncated, _ = single.step(action)
                if truncated:
                    expected.append((t, action, reward, observation["image"]))
                if terminated or truncated:
                    single.reset()
            left_out += max(len(expected) - places, 0)
            used = [one for one in unroll.final[:, i] if one["step"] >= 0]
            assert len(used) == min(len(expected), places)
            assert (unroll.final["step"][len(used) :, i] == -1).all()
            for one, (t, action, reward, image) in zip(used, expected, strict=False):
                assert (one["step"], one["previous_action"]) == (t, action)
                assert one["previous_reward"] == reward
                assert not one["is_first"]
                np.testing.assert_array_equal(one["observation", "image"], image)
    assert (left_out > 0) == (places == 1)


def test_a_time_limit_can_be_the_end_of_the_task():
    """Played from the same seeds: the same steps, and what was cut has terminated."""
    agent, apart = build()
    alike = HostCollector(
        apart.env.__class__(ENVS, **SMALL), agent, unroll_length=STEPS, seed=3,
        hooks=[TimeLimitsEnd()],
    )  # fmt: skip
    for _ in range(3):
        one, other = apart.collect().steps, alike.collect().steps
        assert one["truncated"][:-1].any()
        assert not other["truncated"].any()
        assert torch.equal(other["terminated"], one["terminated"] | one["truncated"])
        assert not other["truncation_value"].any()
        assert torch.equal(other["is_first"], one["is_first"])
        assert torch.equal(other["action"], one["action"])


def test_soft_asymmetric_clipping():
    """As printed by Espeholt et al.'s code, and its limits."""
    rewards = np.array([-100.0, -5, -1, 0, 1, 5, 100])
    expected = [0.3 * 5 * math.tanh(r / 5) if r < 0 else 5 * math.tanh(r / 5) for r in rewards]
    squashed = soft_asymmetric(torch.from_numpy(rewards)).numpy()
    np.testing.assert_allclose(squashed, expected)
    np.testing.assert_allclose(squashed[[0, -1]], [-1.5, 5])


def test_clipping_changes_what_is_learned_from_alone():
    """Played from the same seeds: the same steps, and the agent is told the true rewards."""
    agent, apart = build()
    alike = HostCollector(
        apart.env.__class__(ENVS, **SMALL), agent, unroll_length=STEPS, seed=3,
        hooks=[SoftAsymmetric()],
    )  # fmt: skip
    rewarded = False
    for _ in range(10):
        one, other = apart.collect().steps, alike.collect().steps
        clipped = soft_asymmetric(one["reward"].double()).numpy()
        np.testing.assert_allclose(other["reward"].numpy(), clipped, rtol=1e-6)
        for name in ("previous_reward", "truncation_value", "action", "is_first"):
            assert torch.equal(other[name], one[name])
        rewarded |= bool(one["reward"].any())
    assert rewarded
    assert apart.episode_metrics() == alike.episode_metrics()


RANDOM_R2D2 = ["condition=r2d2", "agent.epsilon=1", "agent.epsilon_ladder=false"]


@pytest.mark.parametrize("overrides", [["condition=impala"], RANDOM_R2D2], ids=lambda o: o[0])
def test_clipping_does_not_change_what_the_agent_is_told_at_a_truncation(overrides):
    sizes = f"collector.num_envs={ENVS}", f"collector.unroll_length={STEPS}"
    options = loading.load(["experiment=demo", *sizes, *overrides])
    env = Noise(ENVS, gym.spaces.Dict(image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8)))
    agent = build_agent(options, env)
    apart, alike = (
        HostCollector(deepcopy(env), agent, unroll_length=STEPS, seed=3, hooks=hooks)
        for hooks in ([], [SoftAsymmetric()])
    )
    one, other = apart.collect(), alike.collect()
    rewarded = one.steps["truncated"] & (one.steps["reward"] > 0)
    assert rewarded[:-1].any()
    assert (other.steps["reward"] < one.steps["reward"])[rewarded].all()
    assert torch.equal(other.steps["truncation_value"], one.steps["truncation_value"])
    if one.final is not None:
        assert_equal(other.final.to_dict(), one.final.to_dict())


def test_the_late_memory_is_that_before_the_burn_in_of_the_next_unroll():
    agent, collector = build("condition=r2d2", "memory=lstm", "agent.burn_in=4")
    for _ in range(2):
        unroll = collector.collect()
        _, expected = agent.network(Inputs.of(unroll.steps[: STEPS - 4]), unroll.memory)
        for name, part in expected.items():
            torch.testing.assert_close(unroll.late_memory[name], part)


def test_the_learner_recomputes_what_the_actor_did():
    """The unrolled network gives the stepped network's logits, across episodes' ends."""
    agent, collector = build("memory=lstm")
    for _ in range(3):
        unroll = collector.collect()
        outputs = agent.network(Inputs.of(unroll.steps), unroll.memory)
        assert unroll.steps["is_first"][1:].any()
        torch.testing.assert_close(
            outputs.logits[:-1], unroll.steps["logits"][:-1], rtol=1e-4, atol=1e-5
        )


def test_the_bonus_is_kept_apart_from_the_reward():
    options = CountOptions(name="count", scale=0.5, table_size=2**16)
    _, plain = build()
    _, bonused = build(exploration=CountBonus(options))
    for _ in range(3):
        one, other = plain.collect().steps, bonused.collect().steps
        assert torch.equal(one["reward"], other["reward"])
        assert torch.equal(one["previous_reward"], other["previous_reward"])
        assert not one["bonus"].any()
        assert (other["bonus"][:-1] > 0).all()
    assert plain.episode_metrics() == bonused.episode_metrics()


@pytest.mark.parametrize("name", ["memory", "exploration"])
def test_a_hook_has_a_name_of_its_own(name):
    own = Hook()
    own.name = name
    agent, collector = build()
    hooks = [CountBonus(CountOptions(name="count", scale=0.5, table_size=2**16)), own]
    with pytest.raises(ValueError, match=f"{name!r} is the collector's own or another hook's"):
        HostCollector(collector.env, agent, unroll_length=STEPS, seed=0, hooks=hooks)


class Brightness(Bonus):
    """A bonus that says of which observation it is: the mean of its pixels."""

    def __init__(self):
        self.paid = self.begun = 0

    def __call__(self, observation, mask):
        self.paid += int(mask.sum())
        return observation["image"].double().mean((1, 2, 3)).float() * mask

    def begin(self, observation, mask):
        self.begun += int(mask.sum())


def test_the_bonus_is_of_the_observation_that_an_action_led_to():
    """Also where an episode ends: it is not of the first observation of the next."""
    bonus = Brightness()
    _, collector = build(exploration=bonus)
    singles = [envs.make("gridworld/zipf_2", **SMALL) for _ in range(ENVS)]
    for i, env in enumerate(singles):
        env.reset(seed=3 + i)
    ended = 0
    for _ in range(2):
        steps = collector.collect().steps
        for t in range(STEPS):
            for i, env in enumerate(singles):
                observation, _, terminated, truncated, _ = env.step(int(steps["action"][t, i]))
                assert steps["bonus"][t, i].item() == pytest.approx(observation["image"].mean())
                if terminated or truncated:
                    ended += 1
                    env.reset()
    assert bonus.paid == 2 * STEPS * ENVS
    assert bonus.begun == ENVS + ended > ENVS


def test_a_first_visit_bonus_begins_anew_with_every_episode():
    options = FirstVisitOptions(name="first_visit", scale=0.5)
    _, collector = build(exploration=FirstVisitBonus(options))
    seen, ends = [set() for _ in range(ENVS)], 0
    for _ in range(6):
        steps = collector.collect().steps
        for t in range(STEPS):
            for i in range(ENVS):
                ended = bool(steps["is_first"][t + 1, i])
                image = np.asarray(steps["observation", "image"][t + 1, i]).tobytes()
                if not ended:  # the last image of an episode is not in the unroll
                    assert bool(steps["bonus"][t, i]) == (image not in seen[i])
                    seen[i].add(image)
                else:
                    seen[i], ends = set(), ends + 1
    assert ends > 20


def test_episodes_are_told_apart_by_level():
    """Against the ends of episodes that the unrolls show."""
    names = ["gridworld/zipf_2", "gridworld/rare"]
    agent, _ = build()
    env = envs.make_vec(names, ENVS, **SMALL)
    collector = HostCollector(env, agent, unroll_length=STEPS, seed=3)
    none_ended = collector.episode_metrics()
    assert list(none_ended) == ["episode_return", "episode_length"]
    assert np.isnan(list(none_ended.values())).all()
    ends = {level: [] for level in names}
    for _ in range(3):
        steps = collector.collect().steps
        for world, index in enumerate(env.levels_of_envs):
            over = steps["terminated"][:-1, world] | steps["truncated"][:-1, world]
            ends[names[index]] += steps["reward"][:-1, world][over].tolist()
    metrics = collector.episode_metrics()
    assert set(metrics) == {
        f"episode_{name}{level}"
        for level in ("", *(f"/{level}" for level in names))
        for name in ("return", "length", "success")
    }
    for level in names:
        assert metrics[f"episode_success/{level}"] == pytest.approx(np.mean(ends[level]))
    assert metrics["episode_return"] == pytest.approx(np.mean([*ends[names[0]], *ends[names[1]]]))


class Silent(Noise):
    """Reports no success, and cannot restore the episode of its first env."""

    reports_success = False

    def _set_env_states(self, state):
        super()._set_env_states(state)
        self._begin(np.arange(self.num_envs) == 0, None)
        self._restarted[0] = True


def silent(num_envs, **options):
    image = gym.spaces.Box(0, 255, (63, 63, 3), np.uint8)
    return Silent(num_envs, gym.spaces.Dict(image=image), actions=8)


def test_levels_drawn_at_resets_are_told_apart_by_the_name_of_their_episode():
    agent, _ = build()
    names = ("common", "seldom")
    levels = {name: silent for name in names}
    env = Mixture(levels, ENVS, draw="resets", exponent=1.0, rank="task")
    collector = HostCollector(env, agent, unroll_length=STEPS, seed=3)
    ends = {name: [] for name in names}
    playing = env.levels_of_envs.copy()
    step = env.step

    def watched(*arguments, **options):
        nonlocal playing
        results = step(*arguments, **options)
        for world in np.flatnonzero(results[2] | results[3]):
            ends[names[playing[world]]].append(results[4]["final_info"]["return"][world])
        playing = env.levels_of_envs.copy()
        return results

    env.step = watched
    for _ in range(3):
        collector.collect()
    metrics = collector.episode_metrics()
    assert set(metrics) == {
        f"episode_{name}{level}"
        for level in ("", "/common", "/seldom")
        for name in ("return", "length")
    }
    for level in names:
        assert metrics[f"episode_return/{level}"] == pytest.approx(np.mean(ends[level]))


def test_an_episode_that_is_not_restored_begins():
    agent, _ = build()
    collector, other = (
        HostCollector(silent(ENVS), agent, unroll_length=STEPS - 1, seed=3, hooks=[Brightness()])
        for _ in range(2)
    )
    collector.collect()
    other.load_state_dict(deepcopy(collector.state_dict()))
    assert other.hooks[-1].begun == ENVS + 1
    row, expected = (one.collect().steps[0] for one in (other, collector))
    assert not expected["is_first"].any()
    assert row["is_first"].tolist() == [True] + [False] * (ENVS - 1)
    assert row["previous_action"][0] == -1
    assert row["previous_reward"][0] == 0
    for name in ("previous_action", "previous_reward"):
        assert torch.equal(row[name][1:], expected[name][1:])


BONUSES = {
    "count": partial(CountBonus, CountOptions(name="count", scale=0.5, table_size=2**16)),
    "first visit": partial(FirstVisitBonus, FirstVisitOptions(name="first_visit", scale=0.5)),
}


@pytest.mark.parametrize("bonus", BONUSES.values(), ids=BONUSES)
@pytest.mark.parametrize("memory", ["lstm", "mlp"])
def test_it_continues_from_its_state(memory, bonus):
    _, collector = build(f"memory={memory}", exploration=bonus())
    collector.collect()
    state = deepcopy(collector.state_dict())
    expected = [collector.collect().steps.clone() for _ in range(2)]
    _, other = build(f"memory={memory}", exploration=bonus(), seed=77)
    other.collect()
    other.load_state_dict(state)
    for steps in expected:
        again = other.collect().steps
        for name in steps.keys(True, True):
            until = None if name in _FIRST_ROWS else -1
            assert torch.equal(steps[name][:until], again[name][:until]), name


_FIRST_ROWS = (("observation", "image"), "previous_action", "previous_reward", "is_first")
