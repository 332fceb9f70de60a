"""Learning: IMPALA, V-MPO, PPO and R2D2 learn CartPole, and IMPALA a MiniGrid.

Scores are mean returns of 100 episodes. Uniformly random actions have about 22 in `CartPole-v1`
(at most 500 are possible) and 0.2 in `MiniGrid-Empty-5x5-v0` (at most 0.955). Each test takes ten
to forty seconds on one core; results depend on the seed and on how the processor rounds.
"""

import pytest
from networks import compact

from zipf.agents import AgentSpec, agents
from zipf.agents.memory import MLPOptions
from zipf.envs.gymnasium.vector import GymnasiumVectorEnv
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.training.host_collector import HostCollector

pytestmark = pytest.mark.slow

ADAM = {"adam_beta1": 0.9, "adam_beta2": 0.999, "adam_epsilon": 1e-8}
OPTIONS = {
    "impala": {
        **{"learning_rate": 3e-3, **ADAM, "adam_beta1": 0.0, "max_gradient_norm": 0.5},
        **{"discount": 0.95},
        **{"baseline_cost": 0.5, "entropy_cost": 0.01},
        **{"clip_rho": 1.0, "clip_pg_rho": 1.0, "clip_c": 1.0, "trace_lambda": 1.0},
    },
    "vmpo": {
        **{"learning_rate": 5e-3, "dual_learning_rate": 1e-2, **ADAM, "max_gradient_norm": 1.0},
        **{"discount": 0.95, "target_period": 5, "top_fraction": 0.5},
        **{"epsilon_eta": 0.1, "epsilon_alpha": 0.03, "initial_eta": 3.0, "initial_alpha": 1.0},
    },
    "ppo": {
        **{"learning_rate": 1e-3, **ADAM, "adam_epsilon": 1e-5, "max_gradient_norm": 0.5},
        **{"discount": 0.98, "gae_lambda": 0.8, "epochs": 4, "minibatches": 4},
        **{"clip_ratio": 0.2, "clip_value": None, "baseline_cost": 0.5, "entropy_cost": 0.0},
    },
    "r2d2": {
        **{"learning_rate": 2e-3, **ADAM, "weight_decay": 0.0, "max_gradient_norm": 1.0},
        **{"discount": 0.95, "trace_lambda": 0.9, "target_period": 50},
        **{"epsilon": 0.1, "epsilon_ladder": False, "burn_in": 0, "samples_per_insert": 2.0},
        **{"final_observations": 1, "fresh_priority": "largest"},
        **{"replay_capacity": 4000, "replay_min": 200, "storage": "ram"},
        **{"priority_exponent": 0.6, "importance_exponent": 0.4, "priority_max_weight": 0.9},
    },
}
MINIGRID = {"discount": 0.97, "adam_beta1": 0.9}


def learn(agent, id, updates, seed=0, options=None, **envs):
    """The mean return after that many updates, and the returns in training, in ten parts."""
    env = GymnasiumVectorEnv(16, id, **envs)
    network = compact(patch=None, size=64)
    memory = MLPOptions(name="mlp", size=64, layers=1)
    spaces = env.single_observation_space, env.single_action_space
    spec = AgentSpec(*spaces, network, memory, num_envs=16, unroll_length=20, seed=seed)
    chosen = {"name": agent, **OPTIONS[agent], **(options or {})}
    learner = agents()[agent](agents()[agent].Options.model_validate(chosen), spec)
    learner.begin_learning()
    collector = HostCollector(env, learner, unroll_length=20, seed=seed)
    curve = []
    for update in range(1, updates + 1):
        learner.update(collector.collect())
        if update % (updates // 10) == 0:
            curve.append(collector.episode_metrics().get("episode_return"))
    policy = AgentPolicy(learner, seed=1)
    played = play(policy, GymnasiumVectorEnv(50, id, **envs), episodes=100, seed=2)
    return float(played["return"].mean()), curve


@pytest.mark.parametrize(
    ("agent", "updates"), [("impala", 200), ("vmpo", 400), ("ppo", 200), ("r2d2", 400)]
)
def test_cartpole_is_learned(agent, updates):
    score, curve = learn(agent, "CartPole-v1", updates)
    assert score > 70, curve  # seeds 0 to 2, 400: V-MPO 240 to 459, R2D2 161 to 228


def test_a_minigrid_level_is_learned():
    pytest.importorskip("minigrid")
    id, codes = "MiniGrid-Empty-5x5-v0", {"image": 11}
    score, curve = learn("impala", id, 100, options=MINIGRID, codes=codes)
    assert score > 0.7, curve
