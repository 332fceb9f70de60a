"""The evaluator: exact accounting, any policy, nobody else's randomness."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from zipf import envs, evaluate
from zipf.experiments.running import evaluator

SMALL = {"num_maps": 5, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 20}


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda observation: rng.integers(8, size=len(observation["image"]))


def scripted(observation):
    """Actions from the observation alone: any batching gives the same episodes."""
    images = observation["image"].reshape(len(observation["image"]), -1)
    return (images.astype(np.int64) * np.arange(images.shape[1])).sum(-1) // 7 % 8


@pytest.mark.parametrize("num_envs", [1, 3, 16, 40])
def test_the_first_episodes_to_start_are_the_ones_scored(num_envs):
    """Against a loop that notes every episode with its start time, then sorts."""
    episodes = 40
    env = envs.make_vec("gridworld/uniform", num_envs, **SMALL)
    policy = evaluator._as_policy(scripted, batched=True)
    result = evaluator.play(policy, env, episodes=episodes, seed=5)

    records = []
    for i in range(num_envs):
        world = envs.make("gridworld/uniform", **SMALL)
        observation, info = world.reset(seed=5 + i)
        time = 0
        for _ in range(episodes):
            start, total, over = time, 0.0, False
            situation = dict(info)
            while not over:
                action = scripted({"image": observation["image"][None]})[0]
                observation, reward, terminated, truncated, info = world.step(int(action))
                time, total, over = time + 1, total + reward, terminated or truncated
            records.append((start, i, situation["map"], situation["target"], total, time - start))
            observation, info = world.reset()
    records.sort()
    expected = pd.DataFrame(
        [r[2:] for r in records[:episodes]], columns=["map", "target", "return", "length"]
    )
    pd.testing.assert_frame_equal(
        result[["map", "target", "return", "length"]], expected, check_dtype=False
    )
    assert (result["success"] == (result["return"] == 1)).all()


def test_short_episodes_are_not_over_counted():
    """Random play on the small world scores what is known exactly, whatever the batch."""
    chance = envs.chance("gridworld/uniform", **SMALL).score
    for num_envs in (7, 1000):
        env = envs.make_vec("gridworld/uniform", num_envs, **SMALL)
        policy = evaluator._as_policy(random_policy(0), batched=True)
        result = evaluator.play(policy, env, episodes=4000, seed=1)
        assert abs(result["return"].mean() - chance) < 4 * np.sqrt(chance * (1 - chance) / 4000)


def test_score_of_a_function():
    scores = evaluate.score(random_policy(0), split="gridworld", episodes=3000, seed=2)
    assert list(scores) == ["train", "uniform", "rare"]
    for kind, exact in (("train", 0.0324), ("uniform", 0.0477), ("rare", 0.0859)):
        assert abs(scores[kind] - exact) < 4 * np.sqrt(exact * (1 - exact) / 3000)


class Remembering:
    """Stable-Baselines3's convention; checks that it is told where episodes begin."""

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.began = 0

    def predict(self, observation, state, episode_start):
        worlds = len(observation["image"])
        if state is None:
            assert episode_start.all()
            state = np.zeros(worlds)
        self.began += episode_start.sum()
        state = np.where(episode_start, 0, state) + 1
        assert (state <= 20).all()
        return self.rng.integers(8, size=worlds), state


def test_score_of_an_agent_with_predict():
    agent = Remembering()
    scores = evaluate.score(agent, episodes=50, num_envs=10, **SMALL)
    assert agent.began >= 3 * 50
    assert all(0 <= score <= 1 for score in scores.values())


def test_score_of_an_agent_for_one_environment():
    def policy(observation):
        assert observation["image"].shape == (63, 63, 3)
        return int(scripted({"image": observation["image"][None]})[0])

    single = evaluate.score(policy, episodes=30, seed=4, batched=False, **SMALL)
    batch = evaluate.score(scripted, episodes=30, num_envs=1, seed=4, **SMALL)
    assert single == batch


TWO = envs.Split(
    "two", ("gridworld/zipf_2", "gridworld/zipf_1"), "gridworld/uniform", "gridworld/rare"
)


def test_every_train_level_is_scored_apart():
    policy = evaluator._as_policy(scripted, batched=True)
    one = evaluator.evaluate(policy, envs.split("gridworld"), episodes=50, seed=3, **SMALL)
    two = evaluator.evaluate(policy, TWO, episodes=50, seed=3, **SMALL)
    assert [(result.kind, result.level) for result in two] == [
        ("train", "gridworld/zipf_2"),
        ("train", "gridworld/zipf_1"),
        ("uniform", "gridworld/uniform"),
        ("rare", "gridworld/rare"),
    ]
    # What is scored as before is scored on the same episodes.
    for before, now in zip(one, [two[0], *two[2:]], strict=True):
        pd.testing.assert_frame_equal(before.episodes, now.episodes)
    assert not two[0].episodes["map"].equals(two[1].episodes["map"])
    means = evaluator.scores(two)
    assert list(means) == ["train", "uniform", "rare"]
    assert means["train"] == pytest.approx((two[0].score + two[1].score) / 2)
    assert means["rare"] == two[3].score
    assert evaluate.score(scripted, TWO, episodes=50, seed=3, **SMALL) == means


def test_situations_of_the_train_levels_are_taken_together():
    policy = evaluator._as_policy(scripted, batched=True)
    results = evaluator.evaluate(policy, TWO, episodes=50, seed=3, **SMALL)
    table = evaluator.situations(results).set_index(["level_kind", "map", "target"])
    assert table.index.is_unique
    assert list(table.columns) == ["episodes", "successes", "return_sum"]
    played = pd.concat([result.episodes for result in results[:2]])
    for (rank, target), episodes in played.groupby(["map", "target"]):
        row = table.loc[("train", rank, target)]
        assert row["episodes"] == len(episodes)
        assert row["successes"] == episodes["success"].sum()
        assert row["return_sum"] == episodes["return"].sum()
    alone = evaluator.situations(results[2:3])
    pd.testing.assert_frame_equal(alone, results[2].situations())


def test_bad_requests():
    with pytest.raises(ValueError, match="episodes=0"):
        evaluate.score(scripted, episodes=0)
    with pytest.raises(ValueError, match="num_envs"):
        evaluate.score(scripted, num_envs=0)
    with pytest.raises(ValueError, match="gridworld"):
        evaluate.score(scripted, split="gridwrld")
    with pytest.raises(ValueError, match="batched=False"):
        evaluate.score(lambda observation: 3, episodes=5)
    with pytest.raises(TypeError, match="policy"):
        evaluate.score(SimpleNamespace(), episodes=5)


def test_per_situation_results_add_up():
    results = evaluator.evaluate(
        evaluator._as_policy(scripted, batched=True),
        envs.split("gridworld"),
        episodes=200,
        seed=0,
    )
    for result in results:
        situations = result.situations()
        assert situations["episodes"].sum() == 200
        assert situations["return_sum"].sum() == pytest.approx(200 * result.score)
        if result.kind == "rare":
            assert situations["map"].min() >= 16
            assert situations["target"].min() >= 16
