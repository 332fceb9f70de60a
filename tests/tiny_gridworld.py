"""One room, three objects: two steps lead to any of them. Chance is a third."""

from zipf import envs
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.evaluator import play
from zipf.experiments.training.host_collector import HostCollector

ENVS = {
    "num_maps": 1,
    "num_rooms": [1, 1],
    "num_objects": 3,
    "max_steps": 20,
    "observation": "tiles",
}


def after_learning(build, seed):
    """A thousand episodes of `build(observation_space, action_space)` after 250 updates."""
    env = envs.make_vec("gridworld/uniform", 64, **ENVS)
    agent = build(env.single_observation_space, env.single_action_space)
    collector = HostCollector(env, agent, unroll_length=8, seed=seed)
    for _ in range(250):
        agent.update(collector.collect())
    policy = AgentPolicy(agent, seed=1)
    test = envs.make_vec("gridworld/uniform", 100, **ENVS)
    return play(policy, test, episodes=1000, seed=2)
