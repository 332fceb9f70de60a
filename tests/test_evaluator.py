"""The evaluator: exact accounting, scores by level and kind, intervals."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest

from zipf import envs, evaluate
from zipf.envs import ZipfVectorEnv, pcg64
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation import evaluator, scoring

SMALL = {"num_maps": 5, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 20}


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda observation: rng.integers(8, size=len(observation["image"]))


def scripted(observation):
    """Actions from the observation alone: any batching gives the same episodes."""
    images = observation["image"].reshape(len(observation["image"]), -1)
    return (images.astype(np.int64) * np.arange(images.shape[1])).sum(-1) // 7 % 8


class Plays:
    """A function from observations to actions as a policy."""

    def __init__(self, function):
        self.function = function

    def start(self, num_envs): ...

    def __call__(self, observation, reward, is_first):
        return self.function(observation)


@pytest.mark.parametrize("num_envs", [1, 3, 16, 40])
def test_the_first_episodes_to_start_are_the_ones_scored(num_envs):
    """Against a loop that notes every episode with its start time, then sorts."""
    episodes = 40
    env = envs.make_vec("gridworld/uniform", num_envs, **SMALL)
    policy = Plays(scripted)
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


def test_a_policy_may_keep_what_it_is_given():
    """Frames of the step before, for instance, without a copy."""
    kept, copies = [], []

    def keeps(observation):
        kept.append(observation["image"])
        copies.append(observation["image"].copy())
        return scripted(observation)

    env = envs.make_vec("gridworld/uniform", 4, **SMALL)
    evaluator.play(Plays(keeps), env, episodes=12, seed=0)
    np.testing.assert_array_equal(kept, copies)
    assert (kept[0] != kept[-1]).any()


def test_batches_of_several_levels_are_not_measured():
    levels = ["gridworld/uniform", "gridworld/rare"]
    with pytest.raises(ValueError, match="of several levels: short episodes would count more"):
        envs.measure_chance(levels, episodes=4, num_envs=4)


def test_an_evaluation_tells_how_far_it_is():
    """Levels that stand in several kinds are counted once, and what it is told may end it."""
    split = envs.Split(
        "told", ("gridworld/zipf_2", "gridworld/uniform"), "gridworld/uniform", "gridworld/rare"
    )
    told = []

    def watch(ended, episodes):
        told.append(ended)
        assert episodes == 3 * 11

    options = {"episodes": 11, "num_envs": 4, **SMALL}
    evaluator.evaluate(Plays(scripted), split, watch=watch, **options)
    assert told == sorted(told)
    assert told[-1] == 33
    assert {11, 22} < set(told)
    assert told[0] < 11

    class Enough(Exception): ...

    def stop(ended, episodes):
        if ended > 15:
            raise Enough

    with pytest.raises(Enough):
        evaluator.evaluate(Plays(scripted), split, watch=stop, **options)


def test_short_episodes_are_not_over_counted():
    """Random play on the small env scores what is known exactly, whatever the batch."""
    chance = envs.baseline("chance", "gridworld/uniform", **SMALL).score
    for num_envs in (7, 1000):
        env = envs.make_vec("gridworld/uniform", num_envs, **SMALL)
        policy = Plays(random_policy(0))
        result = evaluator.play(policy, env, episodes=4000, seed=1)
        assert abs(result["return"].mean() - chance) < 4 * np.sqrt(chance * (1 - chance) / 4000)


def test_score_of_a_function():
    scores = evaluate.score(random_policy(0), split="gridworld", episodes=3000, seed=2)
    assert list(scores) == ["train", "uniform", "rare", "validation", "fresh"]
    exactly = (0.0324, 0.0477, 0.0859, 0.0817, 0.0497)
    for kind, exact in zip(scores, exactly, strict=True):
        assert abs(scores[kind] - exact) < 4 * np.sqrt(exact * (1 - exact) / 3000)


TWO = envs.Split(
    "two", ("gridworld/zipf_2", "gridworld/zipf_1"), "gridworld/uniform", "gridworld/rare"
)


def test_every_train_level_is_scored_apart():
    policy = Plays(scripted)
    one = evaluator.evaluate(policy, envs.split("gridworld"), episodes=50, seed=3, **SMALL)
    two = evaluator.evaluate(policy, TWO, episodes=50, seed=3, **SMALL)
    assert [(result.kind, result.level) for result in two] == [
        ("train", "gridworld/zipf_2"),
        ("train", "gridworld/zipf_1"),
        ("uniform", "gridworld/uniform"),
        ("rare", "gridworld/rare"),
    ]
    # What is scored as before is scored on the same episodes, also where there are other kinds.
    for before, now in zip(one[:3], [two[0], *two[2:]], strict=True):
        pd.testing.assert_frame_equal(before.episodes, now.episodes)
    assert not two[0].episodes["map"].equals(two[1].episodes["map"])
    means = evaluator.scores(two)
    assert list(means) == ["train", "uniform", "rare"]
    assert means["train"] == pytest.approx((two[0].score + two[1].score) / 2)
    assert means["rare"] == two[3].score
    assert evaluate.score(scripted, TWO, episodes=50, seed=3, **SMALL) == means


def test_situations_of_the_train_levels_are_taken_together():
    policy = Plays(scripted)
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
    assert list(dict.fromkeys(table.index.get_level_values(0))) == ["train", "uniform", "rare"]
    alone = evaluator.situations(results[2:3]).set_index(["level_kind", "map", "target"])
    pd.testing.assert_frame_equal(alone, table.loc[["uniform"]])


def test_situations_have_the_ranks_that_all_levels_have():
    episodes = pd.DataFrame({"map": [0, 1, 1], "success": True, "return": 1.0, "length": 3})
    level = envs.SplitLevel("gridworld/rare")
    results = [
        evaluator.Result("uniform", level, episodes.assign(goal=[0, 1, 2])),
        evaluator.Result("rare", level, episodes),
    ]
    table = evaluator.situations(results)
    assert list(table.columns) == ["level_kind", "map", "episodes", "successes", "return_sum"]
    assert table["episodes"].tolist() == [1, 2, 1, 2]
    assert table["map"].tolist() == [0, 1, 0, 1]


def test_score_takes_what_make_vec_takes():
    how = {"copy": False, "render_mode": None, "threads": 1, "processes": None}
    plain = evaluate.score(scripted, episodes=4, num_envs=2, **SMALL)
    assert evaluate.score(scripted, episodes=4, num_envs=2, **SMALL, **how) == plain


def test_bad_requests():
    with pytest.raises(ValueError, match="episodes must be at least 1, got 0"):
        evaluate.score(scripted, episodes=0)
    with pytest.raises(ValueError, match="episodes must be a whole number, got '5'"):
        evaluate.score(scripted, episodes="5")
    with pytest.raises(ValueError, match="gridworld"):
        evaluate.score(scripted, split="gridwrld")
    with pytest.raises(ValueError, match=r"split must be a split's name or .*, got a NoneType"):
        evaluate.env_options(None)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"seed": one}, "seed must be") for one in ("a", 1.5, None, True, -1)),
        *(({"num_envs": one}, "num_envs must be") for one in (0, "a", None)),
        ({"split": None}, "split must be a split's name or a zipf.envs.Split, got a NoneType"),
        ({"split": envs.find_family("gridworld")}, "got a Family: it has 'gridworld', "),
        ({"level": "gridworld/rare"}, "level='gridworld/rare' is no option here"),
        ({"autoreset_mode": "Disabled"}, "autoreset_mode='Disabled' is no option here"),
        ({"episode": 3}, r"unknown gridworld option 'episode' \(did you mean 'episodes'"),
        ({"num_map": 3}, r"unknown gridworld option 'num_map' \(did you mean 'num_maps'"),
    ],
)
def test_wrong_arguments_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        evaluate.score(scripted, **{"episodes": 5, **SMALL, **options})


def test_a_seed_may_be_numpys():
    expected = evaluate.score(scripted, episodes=20, seed=1, **SMALL)
    assert evaluate.score(scripted, episodes=20, seed=np.int64(1), **SMALL) == expected


def test_any_rank_has_its_column():
    """Columns for internal use are not taken from the ranks."""
    episodes = pd.DataFrame({"unknown": [0, 1, 1], "return": [0.0, 1.0, 1.0], "length": [1, 2, 3]})
    level = envs.SplitLevel("gridworld/rare")
    table = evaluator.situations([evaluator.Result("train", level, episodes)])
    assert table["unknown"].tolist() == [0, 1]
    assert table["episodes"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ((np.zeros(5, np.int64), None), r"returned a tuple that is no array as actions; should"),
        (3, r"int64 of shape \(\) as actions; should be integers in 0 \.\. 7 of shape \(5,\)"),
        (np.zeros((5, 1), np.int64), r"int64 of shape \(5, 1\)"),
        (np.zeros(4, np.int64), r"int64 of shape \(4,\)"),
        (np.zeros(5), r"float64 of shape \(5,\)"),
        (np.zeros(5, np.bool_), r"bool of shape \(5,\)"),
        (np.array([0, 1, 8, 3, 4]), "values from 0 to 8 as actions"),
        (np.array([0, 1, -1, 3, 4]), "values from -1 to 4 as actions"),
    ],
)
def test_what_is_no_action_is_refused(actions, message):
    with pytest.raises(ValueError, match=message):
        evaluate.score(lambda observation: actions, episodes=5)


def test_per_situation_results_add_up():
    results = evaluator.evaluate(
        Plays(scripted),
        envs.split("gridworld"),
        episodes=200,
        seed=0,
    )
    for result in results:
        situations = evaluator.situations([result])
        assert situations["episodes"].sum() == 200
        assert situations["return_sum"].sum() == pytest.approx(200 * result.score)
        if result.kind == "rare":
            assert situations["map"].min() >= 16
            assert situations["target"].min() >= 16


WEIGHTED = envs.Split(
    "weighted",
    (
        envs.SplitLevel("gridworld/zipf_2", weight=3.0, options={"max_steps": 10}),
        envs.SplitLevel("gridworld/zipf_1", normalisation=envs.Normalisation(0.1, 0.6, cap=0.5)),
    ),
    "gridworld/uniform",
    "gridworld/rare",
    episodes={"train": 30, "uniform": 20, "rare": 10},
)


def test_levels_have_weights_options_and_normalisations():
    results = evaluator.evaluate(Plays(random_policy(0)), WEIGHTED, seed=1, **SMALL)
    assert [len(result.episodes) for result in results] == [30, 30, 20, 10]
    first, second = results[:2]
    assert first.episodes["length"].max() == 10 < second.episodes["length"].max()
    mean = second.episodes["return"].mean()
    assert second.score == pytest.approx(min((mean - 0.1) / 0.5, 0.5))
    assert evaluator.scores(results)["train"] == pytest.approx((3 * first.score + second.score) / 4)
    details = evaluate.score(scripted, WEIGHTED, seed=1, details=True, **SMALL)
    one, other = details.levels["score"][:2]
    assert one != other
    assert details.kinds["score"][0] == pytest.approx((3 * one + other) / 4)
    assert details.kinds["plain"][0] == pytest.approx((one + other) / 2)
    assert [len(r.episodes) for r in evaluator.evaluate(Plays(scripted), WEIGHTED, episodes=7)] == [
        7
    ] * 4


DRAWN = envs.Split(
    "drawn",
    (
        envs.SplitLevel("gridworld/uniform", weight=1.0),
        envs.SplitLevel("gridworld/zipf_2", weight=3.0, options={"max_steps": 6}),
    ),
    ("gridworld/zipf_2", "gridworld/uniform"),
    "gridworld/uniform",
    draw="resets",
)


def test_levels_drawn_at_resets_are_scored_one_at_a_time():
    """Long and short tasks get the same number of episodes, and situations have the rank."""
    results = evaluator.evaluate(Plays(random_policy(0)), DRAWN, episodes=25, num_envs=6, **SMALL)
    expected = [1, 0, 0, 1, 1]  # by weight
    assert [len(result.episodes) for result in results] == [25] * 5
    for result, rank in zip(results, expected, strict=True):
        assert list(result.episodes.columns)[:3] == ["level", "map", "target"]
        assert (result.episodes["level"] == rank).all()
    assert results[1].episodes["length"].max() == 6 < results[2].episodes["length"].max()
    assert set(evaluator.situations(results)["level"]) == {0, 1}
    assert evaluator.scores(results)["train"] == pytest.approx(
        (results[0].score + 3 * results[1].score) / 4
    )
    details = evaluate.score(scripted, DRAWN, episodes=5, details=True, **SMALL)
    assert set(details.episodes["level_name"]) == {"gridworld/uniform", "gridworld/zipf_2"}


class Quiet(GridworldVectorEnv):
    """Envs whose episodes neither succeed nor fail."""

    reports_success = False


def test_one_mixture_serves_all_levels(monkeypatch):
    """As envs of their own for every level would; a level of several kinds is played once."""
    names = ["gridworld/zipf_2", "gridworld/uniform", "gridworld/rare"]
    train = [envs.SplitLevel(name, weight) for name, weight in zip(names, (3, 2, 1), strict=True)]
    split = envs.Split("drawn", train, names[:2], names[2], draw="resets")
    made = []

    def make_scored(*args, **options):
        made.append(args)
        return original(*args, **options)

    original = envs.make_scored
    monkeypatch.setattr(envs, "make_scored", make_scored)
    results = evaluator.evaluate(Plays(scripted), split, episodes=7, num_envs=3, seed=4, **SMALL)
    assert len(made) == 1
    by_level = {}
    for place, (level, result) in enumerate(zip(train, results, strict=False)):
        env = original(split, level, 3, **SMALL)
        seed = derive_seed(4, "evaluation", place * 3)
        by_level[level.name] = evaluator.play(Plays(scripted), env, episodes=7, seed=seed)
        pd.testing.assert_frame_equal(result.episodes, by_level[level.name])
        assert set(result.episodes["level"]) == {place}
    assert [(one.kind, one.level) for one in results[3:]] == [
        ("uniform", names[0]), ("uniform", names[1]), ("rare", names[2]),
    ]  # fmt: skip
    for result in results[3:]:
        pd.testing.assert_frame_equal(result.episodes, by_level[result.level])


class Tasks(ZipfVectorEnv):
    """Two tasks: a short one whose episodes have one step and return 0, and one ten times as long
    whose episodes return 1. On level `both` one of them is drawn at every reset."""

    def __init__(self, num_envs, level="both", **options):
        super().__init__(
            num_envs,
            single_observation_space=gym.spaces.Dict(nothing=gym.spaces.Box(0, 1, (1,))),
            single_action_space=gym.spaces.Discrete(2),
            situation={"task": 2},
            **options,
        )
        shares = {"short": [1.0, 0.0], "long": [0.0, 1.0], "both": [0.5, 0.5]}
        self.cumulative = pcg64.cumulative(np.array(shares[level]))
        self.tasks = np.zeros(num_envs, np.int64)

    def _begin(self, mask, forced):
        for i in np.flatnonzero(mask):
            self.tasks[i] = pcg64.choice(self._streams[i], self.cumulative)

    def _advance(self, actions, mask):
        ended = self._lengths >= np.where(self.tasks == 0, 1, 10)
        reward = (ended & (self.tasks == 1)).astype(np.float64)
        return reward, ended, np.zeros_like(ended), reward > 0

    def _observe(self, out, mask):
        out["nothing"][mask] = 0

    def _situations(self):
        return {"task": self.tasks.copy()}

    def _get_env_states(self):
        return {"tasks": self.tasks}

    def _set_env_states(self, state):
        self.tasks[:] = state["tasks"]


def first_to_finish(env, episodes, seed):
    """The mean return of the first episodes to end, which is not what the evaluator counts."""
    env.reset(seed=seed)
    returns = []
    while len(returns) < episodes:
        _, _, terminated, _, info = env.step(np.zeros(env.num_envs, np.int64))
        if terminated.any():
            returns += list(info["final_info"]["return"][terminated])
    return np.mean(returns[:episodes])


@pytest.mark.parametrize("draw", ["worlds", "resets"])
def test_lengths_do_not_matter(monkeypatch, draw):
    """Long episodes count as much as short ones, of a level and of a kind of several levels."""
    known = envs.Family(name="tasks", summary="", levels=("short", "long", "both"), make_vec=Tasks)
    monkeypatch.setitem(envs.family._FAMILIES, "tasks", known)
    split = envs.Split(
        "tasks",
        (envs.SplitLevel("tasks/short", 3.0), envs.SplitLevel("tasks/long", 1.0)),
        ("tasks/short", "tasks/long"),
        "tasks/both",
        draw=draw,
    )
    episodes, sigma = 400, 0.5 / np.sqrt(400)
    policy = Plays(lambda observation: np.zeros(len(observation["nothing"]), np.int64))
    results = evaluator.evaluate(policy, split, episodes=episodes, num_envs=400, seed=3)
    assert [len(result.episodes) for result in results] == [episodes] * 5
    assert [result.score for result in results[:4]] == [0, 1, 0, 1]
    assert evaluator.scores(results) == {
        "train": 0.25,
        "uniform": 0.5,
        "rare": pytest.approx(0.5, abs=4 * sigma),
    }
    both = results[4].episodes
    assert both["return"].tolist() == both["task"].tolist()
    assert both["length"].tolist() == (1 + 9 * both["task"]).tolist()
    naive = first_to_finish(envs.make_vec("tasks/both", 400), episodes, seed=3)
    assert naive < 0.5 - 5 * sigma


def test_levels_with_options_of_their_own_have_worlds_of_their_own():
    short = envs.SplitLevel("gridworld/uniform", options={"max_steps": 1})
    split = envs.Split("drawn", "gridworld/uniform", short, "gridworld/rare", draw="resets")
    results = evaluator.evaluate(Plays(scripted), split, episodes=7, num_envs=3, **SMALL)
    lengths = [one.episodes["length"].max() for one in results]
    assert lengths[1] == 1 < lengths[0]


def test_worlds_may_report_no_success():
    split = envs.Split("quiet", lambda n, **o: Quiet(n, **o), "gridworld/uniform", "gridworld/rare")
    results = evaluator.evaluate(Plays(scripted), split, episodes=20, **SMALL)
    assert list(results[0].episodes.columns) == ["map", "target", "return", "length"]
    assert results[0].row()["success"] is None
    table = evaluator.situations(results)
    of_train = table["level_kind"] == "train"
    assert table.loc[of_train, "successes"].map(lambda value: value is None).all()
    assert table.loc[~of_train, "successes"].notna().all()
    assert table.loc[of_train, "episodes"].sum() == 20


# Details


def test_details_hold_everything():
    scores = evaluate.score(scripted, TWO, episodes=40, seed=3, **SMALL)
    details = evaluate.score(scripted, TWO, episodes=40, seed=3, details=True, **SMALL)
    assert details.scores == scores
    assert details.split == "two"
    assert details.env_options["gridworld/rare"] == {
        "num_maps": 5,
        "num_rooms": [2, 2],
        "room_size": [3, 3],
        "num_objects": 5,
        "max_steps": 20,
        "observation": "image",
    }
    assert list(details.episodes.columns) == [
        *("level_kind", "level_name", "map", "target", "success", "return", "length")
    ]
    names = ["gridworld/zipf_2", "gridworld/zipf_1", "gridworld/uniform", "gridworld/rare"]
    assert list(details.levels["level_name"]) == names
    assert list(details.episodes["level_name"]) == [name for name in names for _ in range(40)]
    by_level = details.episodes.groupby("level_name", sort=False)["return"].mean()
    assert list(by_level) == list(details.levels["score"])
    assert details.situations["episodes"].sum() == 160
    assert list(details.kinds["level_kind"]) == ["train", "uniform", "rare"]
    assert dict(zip(details.kinds["level_kind"], details.kinds["score"], strict=True)) == scores
    for row in (*details.levels.itertuples(), *details.kinds.itertuples()):
        assert 0 <= row.score_low <= row.score <= row.score_high <= 1


def result(returns, **level):
    split_level = envs.SplitLevel("gridworld/rare", **level)
    return evaluator.Result("rare", split_level, pd.DataFrame({"return": np.array(returns)}))


def test_intervals_cover_the_mean_as_often_as_they_say():
    rng = np.random.default_rng(0)
    for draw, mean in (
        (lambda: rng.binomial(1, 0.1, size=60).astype(float), 0.1),
        (lambda: rng.gamma(2, 1.5, size=60), 3.0),
    ):
        covered = 0
        for _ in range(200):
            low, high = scoring.score_interval(result(draw()))
            covered += low <= mean <= high
        assert 0.90 * 200 <= covered <= 0.99 * 200


def test_scores_that_are_all_alike_are_no_more_certain_than_their_episodes():
    """Also where situations could be drawn: of those that were met, and never solved."""
    episodes = pd.DataFrame({"map": np.arange(20) % 4, "return": np.zeros(20)})
    split_level = envs.SplitLevel("gridworld/rare")
    low, high = scoring.score_interval(evaluator.Result("rare", split_level, episodes))
    assert (low, high) == pytest.approx((0, 0.161), abs=1e-3)  # Wilson's of 0 of 20


def test_intervals_of_scores_are_normalised():
    returns = np.random.default_rng(0).normal(10, 3, size=50)
    low, high = scoring.score_interval(result(returns))
    assert low < returns.mean() < high
    falling = envs.Normalisation(random=20, human=0)
    ends = scoring.score_interval(result(returns, normalisation=falling))
    assert ends == pytest.approx(((20 - high) / 20, (20 - low) / 20))
    capped = envs.Normalisation(random=0, human=1, cap=1.0)
    assert scoring.score_interval(result(returns, normalisation=capped)) == (1.0, 1.0)
    assert np.isnan(scoring.score_interval(result([0.5]))).all()
    assert scoring.score_interval(result([0.0, 0.0])) == pytest.approx((0, 0.6576), abs=1e-4)


def test_intervals_of_kinds_combine_those_of_levels():
    details = evaluate.score(random_policy(0), WEIGHTED, seed=1, details=True, **SMALL)
    train = details.kinds.iloc[0]
    of_train = details.levels[details.levels["level_kind"] == "train"]
    shares = np.array([0.75, 0.25])
    below = (of_train["score"] - of_train["score_low"]) * shares
    assert train["score"] == pytest.approx(shares @ of_train["score"])
    assert train["score_low"] == pytest.approx(train["score"] - np.hypot(*below))
    rare = details.levels.iloc[-1]
    columns = ["score", "score_low", "score_high"]
    assert list(details.kinds.iloc[-1][columns]) == pytest.approx(list(rare[columns]))


def test_scoring_imports_neither_pytorch_nor_tensorboard():
    code = (
        "import sys, numpy as np; from zipf.evaluate import score; "
        "score(lambda o: np.zeros(len(o['image']), int), episodes=2, max_steps=2); "
        "print(sorted({'torch', 'tensorboard', 'hydra', 'torchrl'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
