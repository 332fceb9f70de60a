"""The bonuses that count, against dictionaries and sets of visits; and what bonuses find."""

from collections import Counter

import gymnasium as gym
import numpy as np
import pytest
import torch
from networks import compact
from test_impala import OPTIONS as IMPALA
from test_rnd import OPTIONS as RND

from zipf.agents.agent import AgentSpec
from zipf.agents.impala import Impala
from zipf.agents.memory import MLPOptions
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.hooks import exploration as bonuses
from zipf.experiments.hooks.exploration import (
    CountBonus,
    CountOptions,
    FirstVisitBonus,
    FirstVisitOptions,
)
from zipf.experiments.training.host_collector import HostCollector

OPTIONS = CountOptions(name="count", scale=0.3, table_size=2**20)
FIRST_VISIT = FirstVisitOptions(name="first_visit", scale=0.25)


def test_the_bonus_equals_counting_visits():
    rng = np.random.default_rng(0)
    bonus, visits = CountBonus(OPTIONS), Counter()
    for _ in range(50):
        image = rng.integers(3, size=(8, 5, 3), dtype=np.uint8) * (rng.random((8, 1, 1)) < 0.5)
        instruction = rng.integers(2, size=(8, 2))
        mask = rng.random(8) < 0.7
        result = bonus({"image": image, "instruction": instruction}, mask)
        assert result.dtype == torch.float32
        keys = [(image[i].tobytes(), instruction[i].tobytes()) for i in range(8)]
        visits.update(key for key, chosen in zip(keys, mask, strict=True) if chosen)
        for i in range(8):  # all are counted before any is paid for
            expected = 0.3 / np.sqrt(visits[keys[i]]) if mask[i] else 0.0
            np.testing.assert_allclose(result[i], expected, rtol=1e-6)
    assert max(visits.values()) > 3


def test_parts_that_swap_their_values_are_another_observation():
    one, other = np.array([[3, 1]], np.uint8), np.array([[2, 5]], np.uint8)
    bonus, mask = CountBonus(OPTIONS), np.ones(1, np.bool_)
    first = bonus({"left": one, "right": other}, mask)
    np.testing.assert_array_equal(bonus({"left": other, "right": one}, mask), first)
    assert bonus({"right": other, "left": one}, mask) < first  # in any order of the names


def test_a_small_table_is_used_whole():
    """Also where bytes differ in their highest bit alone, which low bits of a hash do not show."""
    bits = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1)
    bonus = CountBonus(OPTIONS.model_copy(update={"table_size": 128}))
    bonus({"image": 128 * bits}, np.ones(256, np.bool_))
    used = np.count_nonzero(bonus.visits)
    assert 90 < used <= 128  # 111 of a random function, by the mean


def test_the_first_visit_bonus_equals_first_visits_of_an_episode():
    rng = np.random.default_rng(1)
    bonus, seen = FirstVisitBonus(FIRST_VISIT), [set() for _ in range(8)]
    paid = 0
    for _ in range(60):
        image = rng.integers(2, size=(8, 2, 2), dtype=np.uint8)
        mask, ended = rng.random(8) < 0.7, rng.random(8) < 0.1
        result = bonus({"image": image}, mask)
        assert result.dtype == torch.float32
        for i in range(8):
            new = bool(mask[i]) and image[i].tobytes() not in seen[i]
            np.testing.assert_allclose(result[i], 0.25 if new else 0.0)
            paid += new
            if mask[i]:
                seen[i].add(image[i].tobytes())
            if ended[i]:
                seen[i] = set()
        bonus.begin({}, ended)
    assert 100 < paid < 300  # of 336: some were seen before, and again new after an episode's end


LENGTH, LIMIT = 36, 60


class Corridor(ZipfVectorEnv):
    """Steps to the left and to the right from a corridor's left end; the right end is rewarded.

    Random actions get there in one of 367,000 episodes.
    """

    def __init__(self, num_envs):
        super().__init__(
            num_envs,
            single_observation_space=gym.spaces.Dict(place=gym.spaces.Discrete(LENGTH + 1)),
            single_action_space=gym.spaces.Discrete(2),
            situation={"nothing": 1},
        )
        self.place = np.zeros(num_envs, np.int64)
        self.furthest = 0

    def _begin(self, mask, forced):
        self.place[mask] = 0

    def _advance(self, actions, mask):
        self.place[mask] = (self.place + 2 * actions - 1).clip(0)[mask]
        self.furthest = max(self.furthest, int(self.place.max()))
        arrived = self.place == LENGTH
        return arrived.astype(np.float64), arrived, self._lengths >= LIMIT, arrived

    def _observe(self, out, mask):
        out["place"][mask] = self.place[mask]

    def _situations(self):
        return {"nothing": np.zeros(self.num_envs, np.int64)}

    def _get_env_states(self):
        return {"place": self.place}

    def _set_env_states(self, state):
        self.place[:] = state["place"]


def explore(exploration, seed, learns=True):
    """How far 16 envs got in training, and the share of all episodes that arrived."""
    env = Corridor(16)
    options = IMPALA.model_copy(
        update={
            "learning_rate": 3e-3,
            "max_gradient_norm": 1.0,
            "entropy_cost": 1e-3,
            "discount": 0.97,
        }
    )
    memory = MLPOptions(name="mlp", size=32, layers=1)
    spaces = env.single_observation_space, env.single_action_space
    agent = Impala(options, AgentSpec(*spaces, compact(), memory, seed=seed))
    for parameter in agent.network.policy.parameters():
        torch.nn.init.zeros_(parameter)  # it begins with random actions
    bonus = exploration and bonuses.BONUSES.build(exploration, spaces[0], seed)
    hooks = [] if bonus is None else [bonus]
    collector = HostCollector(env, agent, unroll_length=20, seed=seed, hooks=hooks)
    for _ in range(60):
        unroll = collector.collect()
        if learns:
            agent.update(unroll)
    return env.furthest, collector.episode_metrics().get("episode_success", 0)


BONUSES = {
    "rnd": RND.model_copy(update={"scale": 1.0}),
    "first visits": FirstVisitOptions(name="first_visit", scale=0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_random_actions_do_not_find_the_end_of_a_corridor(seed):
    assert explore(None, seed, learns=False)[0] < LENGTH


@pytest.mark.slow
@pytest.mark.parametrize("bonus", BONUSES.values(), ids=BONUSES)
@pytest.mark.parametrize("seed", range(3))
def test_the_end_of_a_corridor_is_found(seed, bonus):
    furthest, success = explore(bonus, seed)
    assert furthest == LENGTH
    assert success > 0.03  # it goes there again
