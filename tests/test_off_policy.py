"""Learning from older weights' unrolls: V-trace's correction is needed, and enough."""

import itertools

import gymnasium as gym
import numpy as np
import pytest
import torch
from test_impala import OPTIONS as IMPALA

from zipf.agents import impala
from zipf.agents.agent import AgentSpec
from zipf.agents.impala import Impala
from zipf.agents.memory import MLPOptions
from zipf.agents.network import Inputs
from zipf.agents.network_options import CompactOptions
from zipf.agents.returns import vtrace
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.training.host_collector import HostCollector
from zipf.experiments.training.rollouts import BackgroundRollouts

# The fixed point, exactly: a small Markov decision process whose every unroll is listed.

STATES, ACTIONS, STEPS, DISCOUNT = 2, 2, 3, 0.9


class Process:
    """Random transitions to one of the states or to the episode's end, where state 0 follows.

    `behaviour` and `target` are policies [states, actions], `leads_to` probabilities
    [states, actions, states + 1] and `rewards` [states, actions].
    """

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.behaviour = rng.dirichlet(np.ones(ACTIONS), STATES) * 0.8 + 0.1
        self.target = rng.dirichlet(np.ones(ACTIONS), STATES) * 0.8 + 0.1
        self.leads_to = rng.dirichlet(np.ones(STATES + 1), (STATES, ACTIONS))
        self.rewards = rng.normal(size=(STATES, ACTIONS))

    def value_of(self, policy):
        """V = r + discount P V, solved."""
        policy = policy / policy.sum(-1, keepdims=True)
        transitions = np.einsum("xa,xay->xy", policy, self.leads_to[..., :STATES])
        rewards = (policy * self.rewards).sum(-1)
        return np.linalg.solve(np.eye(STATES) - DISCOUNT * transitions, rewards)

    def unrolls(self):
        """Every unroll of the behaviour as columns: probabilities given the first state [B], states
        [T + 1, B], actions [T, B], terminated [T, B]."""
        columns = []
        outcomes = itertools.product(range(ACTIONS), range(STATES + 1))
        for start, steps in itertools.product(
            range(STATES), itertools.product(outcomes, repeat=STEPS)
        ):
            states, probability = [start], 1.0
            for action, outcome in steps:
                probability *= self.behaviour[states[-1], action]
                probability *= self.leads_to[states[-1], action, outcome]
                states.append(outcome % STATES)
            actions, outcomes_of = zip(*steps, strict=True)
            columns.append((probability, states, actions, [o == STATES for o in outcomes_of]))
        return (np.array(part).T for part in zip(*columns, strict=True))


def fixed_point(process, corrected, clip_rho):
    """What the values of both states become where each is replaced by its mean target, again and
    again."""
    probabilities, states, actions, terminated = process.unrolls()
    at, start = states[:-1], states[0]
    ratios = np.log(process.target[at, actions]) - np.log(process.behaviour[at, actions])
    values = np.zeros(STATES)
    for _ in range(200):
        targets = vtrace(
            log_ratios=torch.tensor(ratios if corrected else np.zeros_like(ratios)),
            rewards=torch.tensor(process.rewards[at, actions]),
            values=torch.tensor(values[states]),
            terminated=torch.tensor(terminated),
            truncated=torch.zeros(terminated.shape, dtype=torch.bool),
            truncation_values=torch.zeros(terminated.shape, dtype=torch.float64),
            discount=DISCOUNT,
            clip_rho=clip_rho,
        ).targets[0]
        values = np.bincount(start, probabilities * targets.numpy())
    return values


@pytest.mark.parametrize("seed", range(3))
def test_only_corrected_values_become_those_of_the_target_policy(seed):
    """With clipped ratios, those of the policy in proportion to min(clip x behaviour, target)
    (Espeholt et al. 2018, theorem 1)."""
    process = Process(seed)
    behaviour, target = process.behaviour, process.target
    for clip_rho in (1.0, 1.3, 1e9):
        clipped = np.minimum(clip_rho * behaviour, target)
        found = fixed_point(process, corrected=True, clip_rho=clip_rho)
        np.testing.assert_allclose(found, process.value_of(clipped), rtol=1e-6)
    np.testing.assert_allclose(found, process.value_of(target), rtol=1e-6)
    uncorrected = fixed_point(process, corrected=False, clip_rho=1.0)
    np.testing.assert_allclose(uncorrected, process.value_of(behaviour), rtol=1e-6)
    assert abs(uncorrected - process.value_of(target)).max() > 0.01


# Learning, end to end: a bandit.


PAYS = (1.0, 0.7, 0.0)


class Bandit(ZipfVectorEnv):
    """A bandit of three arms, which pay 1, 0.7 and nothing."""

    reports_success = False

    def __init__(self, num_envs):
        super().__init__(
            num_envs,
            single_observation_space=gym.spaces.Dict(nothing=gym.spaces.Discrete(1)),
            single_action_space=gym.spaces.Discrete(3),
            situation={},
        )

    def _begin(self, mask, forced): ...

    def _advance(self, actions, mask):
        no = np.zeros(self.num_envs, np.bool_)
        return np.array(PAYS)[actions], ~no, no, no

    def _observe(self, out, mask):
        out["nothing"][mask] = 0

    def _situations(self):
        return {}

    def _get_env_states(self):
        return {}

    def _set_env_states(self, state): ...


OPTIONS = IMPALA.model_copy(
    update={"learning_rate": 0.02, "discount": 1.0, "baseline_cost": 0.5, "entropy_cost": 0.01}
)
NETWORK = CompactOptions(
    name="compact",
    patch=None,
    channels=1,
    size=1,
    code_channels=8,
    code_size=16,
    vector_layers=[1],
    head_size=0,
)


class NeverPublished(Impala):
    """Acts with its first weights, as an actor does that is far behind the learner."""

    def publish(self): ...


FIRST = torch.tensor([0.05, 0.6, 0.35])
"""The policy that acts. It earns most, in all, with the second arm."""


def learn(seed, updates=100):
    """What the learned policy earns."""
    env = Bandit(128)
    spec = AgentSpec(
        env.single_observation_space,
        env.single_action_space,
        NETWORK,
        MLPOptions(name="mlp", size=16, layers=1),
        seed=seed,
    )
    agent = NeverPublished(OPTIONS, spec)
    with torch.no_grad():
        agent.network.policy.weight.zero_()
        agent.network.policy.bias.copy_(FIRST.log())
        agent.network.baseline.weight.zero_()
        agent.network.baseline.bias.fill_(FIRST @ torch.tensor(PAYS))
    overlap = BackgroundRollouts(
        HostCollector(env, agent, unroll_length=2, seed=seed, lag=1), agent
    )
    for _ in range(updates):
        unroll, _ = overlap.step(agent.update)
    overlap.close()
    with torch.no_grad():
        outputs = agent.network(Inputs.of(unroll.steps), unroll.memory)
    return float(outputs.logits[0, 0].softmax(-1) @ torch.tensor(PAYS))


def uncorrected(**arguments):
    return vtrace(**arguments | {"log_ratios": torch.zeros_like(arguments["log_ratios"])})


@pytest.mark.slow
def test_lag_without_the_correction_learns_worse(monkeypatch):
    """V-trace finds the best arm. With all ratios 1 an arm's share of the gradient is how often it
    was pulled times its advantage, and the second arm, which is not the best, has the largest."""
    torch.set_num_threads(1)
    corrected = [learn(seed) for seed in range(3)]
    monkeypatch.setattr(impala, "vtrace", uncorrected)
    assert min(corrected) > 0.95
    assert max(learn(seed) for seed in range(3)) < 0.75
