"""Levels to choose on, and levels that nobody trains on: what they draw; the others stay."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from run_folders import constant, level, only_table, write_run

from zipf import envs, evaluate
from zipf.envs.gridworld.maps import build_maps
from zipf.experiments.building import loading
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation import evaluator, scoring
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.reporting import markdown, seed_statistics
from zipf.report import report

SMALL = {"num_rooms": (2, 2), "num_objects": 5}


@pytest.mark.parametrize(
    ("level", "ranks"),
    [
        ("gridworld/validation", {"map": range(8, 12), "target": range(8, 12)}),
        ("gridworld/fresh", {"map": range(20), "target": range(20)}),
        ("playroom/lift/lift_shape_validation", {"target": range(20, 30)}),
        ("playroom/put/put_on_bed_tray_validation", {"target": range(20, 30)}),
        ("playroom/supervised/find_shape_validation", {"target": range(20, 30)}),
        ("labyrinth/forward_validation", {"level": range(12, 18)}),
    ],
)
def test_what_further_levels_draw(level: str, ranks: dict[str, range]) -> None:
    options = {} if level.startswith("gridworld") else {"image_size": (3, 4)}
    env = envs.make_vec(level, 20, **options)
    met: dict[str, set[int]] = {name: set() for name in ranks}
    for seed in range(0, 400, 20):
        _, info = env.reset(seed=seed)
        for name in ranks:
            met[name] |= set(info[name].tolist())
    env.close()
    assert met == {name: set(of_rank) for name, of_rank in ranks.items()}


def test_validation_tasks_of_the_labyrinth_are_the_middle_fifth_of_either_order() -> None:
    for name in ("labyrinth_forward", "labyrinth_reversed"):
        split = envs.split(name)
        trained = [one.name for one in split.train]
        assert [one.name for one in split.validation] == trained[12:18]


def test_fresh_maps_are_those_of_other_seeds() -> None:
    fresh = envs.make_vec("gridworld/fresh", 1).level.maps  # type: ignore[attr-defined]
    of_seeds = build_maps(40)
    np.testing.assert_array_equal(fresh.codes, of_seeds.codes[20:])
    np.testing.assert_array_equal(fresh.cells, of_seeds.cells[20:])
    # The first of them is the map of seed 1254, and none is one of the benchmark's, however many.
    few = envs.make_vec("gridworld/fresh", 1, num_maps=5).level.maps  # type: ignore[attr-defined]
    np.testing.assert_array_equal(few.codes, fresh.codes[:5])
    many = envs.make_vec("gridworld/fresh", 1, num_maps=30).level.maps  # type: ignore[attr-defined]
    np.testing.assert_array_equal(many.codes[:10], fresh.codes[10:])


def test_the_exact_references_of_fresh_maps_are_of_these() -> None:
    chance = envs.baseline("chance", "gridworld/fresh")
    played = envs.measure_chance("gridworld/fresh", episodes=4000, seed=3)
    assert chance is not None
    assert played.error is not None
    assert abs(chance.score - played.score) < 4 * played.error
    expert = envs.baseline("expert", "gridworld/fresh")
    assert expert is not None
    assert expert.score == pytest.approx(1)


def test_other_kinds_play_the_episodes_that_they_played_before() -> None:
    """By the seeds of version 0.1.0: the place of kind and level among three kinds."""
    split = envs.split("gridworld")
    results = evaluator.evaluate(
        evaluator_policy(), split, episodes=30, num_envs=10, seed=7, **SMALL
    )
    assert [result.kind for result in results] == list(envs.KINDS)
    for place, result in enumerate(results[:3]):
        env = envs.make_vec(result.level, 10, **SMALL)
        seed = derive_seed(7, "evaluation", place)
        alone = evaluator.play(evaluator_policy(), env, episodes=30, seed=seed)
        pd.testing.assert_frame_equal(result.episodes, alone)


def evaluator_policy() -> evaluator.Policy:
    class Ahead:
        def start(self, num_envs: int) -> None: ...

        def __call__(self, observation, reward, is_first):
            return np.full(len(reward), 2)

    return Ahead()


def test_a_split_without_further_kinds_is_valid() -> None:
    split = envs.Split("own", "gridworld/zipf_2", "gridworld/uniform", "gridworld/rare")
    assert split.kinds == envs.PAPER_KINDS
    assert split.levels("fresh") == ()
    policy = lambda seen: np.zeros(len(seen["image"]), np.int64)  # noqa: E731
    assert list(evaluate.score(policy, split, episodes=4, **SMALL)) == ["train", "uniform", "rare"]
    more = envs.Split(
        "own",
        *("gridworld/zipf_2", "gridworld/uniform", "gridworld/rare"),
        validation="gridworld/validation",
        episodes={"train": 2, "uniform": 3, "rare": 4, "validation": 5},
    )
    details = evaluate.score(policy, more, details=True, **SMALL)
    assert details.levels["episodes"].tolist() == [2, 3, 4, 5]
    with pytest.raises(ValueError, match="and may have one for validation and fresh"):
        envs.Split("own", *["gridworld/rare"] * 3, episodes={"train": 1, "uniform": 1})
    assert envs.split("gridworld").episodes_of("fresh") == 1000


def test_a_split_may_have_nothing_but_levels_to_train_on(tmp_path: Path) -> None:
    split = envs.split("labyrinth_rooms_watermaze")
    assert split.kinds == ("train",)
    assert [one.name for one in split.all_levels] == ["labyrinth/rooms_watermaze"]
    alone = envs.Split("own", "gridworld/zipf_2")
    assert list(evaluate.score(evaluator_policy(), alone, episodes=4, **SMALL)) == ["train"]
    levels = [level("train", "gridworld/zipf_2")]
    for seed in range(3):
        scores = {update: (0.9 - 0.1 * seed,) for update in (100, 200, 300)}
        write_run(tmp_path, scores, condition="impala", levels=levels, seed=seed)
    report(tmp_path, tmp_path / "report", html=tmp_path / "report.html", claims=True)
    text = (tmp_path / "report" / "report.md").read_text()
    assert "| Condition | Seeds | Train (Zipfian) |" in text
    assert "| IMPALA | 3 | 0.80 ± 0.10 |" in text


def test_uniform_training_has_a_split_in_every_family() -> None:
    for name in ("playroom_lift", "playroom_put", "playroom_find", "labyrinth"):
        split = envs.split(f"{name}_uniform")
        assert [(one.name, one.weight) for one in split.train] == [
            (one.name, one.weight) for one in split.uniform
        ]
    config = loading.load(
        ["experiment=playroom_lift_compact", "environment.split=playroom_lift_uniform"]
    )
    assert config.split.train[0].name == "playroom/lift/lift_shape_uniform"


def test_a_table_has_the_further_kinds_and_a_dash_for_runs_of_before(tmp_path: Path) -> None:
    levels = [level(kind, f"gridworld/{kind}") for kind in envs.KINDS]
    scores = {update: (0.9, 0.5, 0.3, 0.4, 0.2) for update in (100, 200, 300)}
    write_run(tmp_path, scores, condition="impala", levels=levels)
    write_run(tmp_path, constant(0.1), condition="r2d2")
    text = markdown.markdown_report([only_table(tmp_path)], {})
    assert "| Rare | paper | Validation | Fresh |" in text  # the paper has no such levels
    lines = {line.split(" | ")[0]: line for line in reversed(text.splitlines())}
    assert lines["| IMPALA"].endswith("| 0.40 | 0.20 |")
    assert lines["| R2D2"].endswith("| – | – |")
    for seed in (1, 2):
        write_run(tmp_path, scores, condition="impala", levels=levels, seed=seed)
        write_run(tmp_path, constant(0.1), condition="r2d2", seed=seed)
    statistics = seed_statistics.seed_statistics(only_table(tmp_path))
    means, better = statistics.grids
    assert [line.leading[1] for line in means.lines] == ["3", "3"]
    assert means.lines[1].ours[2:] == ["0.10 [0.10, 0.10]", "–", "–"]
    assert better.lines[0].ours[3:] == ["–", "–"]


def test_a_run_of_before_resumes_and_is_scored_on_the_further_kinds(tmp_path: Path) -> None:
    from zipf.experiments.building import run_folder
    from zipf.experiments.training import runner

    line = [
        *("experiment=demo", f"run_root={tmp_path}", "collector.num_envs=4", "memory.size=8"),
        *("evaluation.episodes=2", "evaluation.every=1", "schedule.window=[1,2]"),
        *("environment.num_maps=5", "schedule.checkpoint_every=1", "schedule.log_every=1"),
    ]
    config = loading.load([*line, "updates=1"])
    runner.train(config)
    path = config.folder / "run.json"
    described = json.loads(path.read_text())
    assert {one["level_kind"] for one in described["levels"]} == set(envs.KINDS)
    described["levels"] = described["levels"][:3]
    path.write_text(json.dumps(described))
    runner.train(loading.load([*line, "updates=2"]))
    described = run_folder.read_description(config.folder)
    assert [one["level_kind"] for one in described["levels"]] == list(envs.KINDS)
    evaluations = pd.read_csv(config.folder / "evaluations.csv")
    assert set(evaluations["level_kind"]) == set(envs.KINDS)


def test_training_never_met_the_situations_of_fresh_maps() -> None:
    visits = Visits(("map", "target"))
    visits.add({"map": np.array([0]), "target": np.array([1])}, np.array([True]))
    rows = pd.DataFrame(
        {"level_kind": ["uniform", "fresh"], "map": [0, 0], "target": [1, 1], "episodes": [1, 1]}
    )
    met = visits.beside(rows)
    assert met["visits"].tolist() == [1, 0]
    assert met["visits_map"].tolist() == [1, 0]


def test_the_sweep_of_conditions_has_rare_situations_that_chance_finds() -> None:
    config = loading.load(["experiment=demo_conditions", "condition=impala"])
    rare = envs.make_vec("gridworld/rare", 200, **config.level_options)
    _, info = rare.reset(seed=0)
    assert len(set(zip(info["map"].tolist(), info["target"].tolist(), strict=True))) >= 4
    chance = envs.baseline("chance", "gridworld/rare", **config.level_options)
    assert chance is not None
    assert 0 < chance.score < 1


def test_intervals_of_rare_scores_also_cover_which_situations_these_are() -> None:
    """Two situations, one of which is always solved: 400 episodes, but two draws."""
    level = envs.SplitLevel("gridworld/rare")
    ranks = np.arange(400) % 2
    episodes = pd.DataFrame({"map": 18, "target": 18 + ranks, "success": ranks == 0})
    episodes["return"] = episodes["success"].astype(float)
    intervals = {
        kind: scoring.score_interval(evaluator.Result(kind, level, episodes)) for kind in envs.KINDS
    }
    assert intervals["uniform"] == intervals["train"] == pytest.approx((0.45, 0.55), abs=0.01)
    for kind in ("rare", "validation", "fresh"):
        assert intervals[kind] == (0.0, 1.0)
    # Of equal situations the episodes are all that varies.
    episodes["return"] = np.random.default_rng(0).permutation(np.arange(400) % 4 == 0) * 1.0
    low, high = scoring.score_interval(evaluator.Result("rare", level, episodes))
    assert (low, high) == pytest.approx((0.21, 0.295), abs=0.03)


def test_situations_that_are_alike_make_intervals_little_wider() -> None:
    """Drawing situations and then episodes doubles the variance, as every two-stage bootstrap."""
    rng, ratios = np.random.default_rng(0), []
    for _ in range(20):
        returns = rng.permutation(np.arange(400) % 2 == 0) * 1.0
        low, high = scoring.bootstrap_over_situations(np.arange(400) % 20, returns)
        ratios.append((high - low) / (2 * 1.96 * 0.5 / np.sqrt(400)))
    assert np.mean(ratios) == pytest.approx(np.sqrt(1.9), rel=0.06)


def test_situations_that_are_hardly_met_are_drawn_by_their_first_rank() -> None:
    level = envs.SplitLevel("playroom/lift/lift_shape_uniform_rare")
    targets = 40 + np.arange(300) % 3
    episodes = pd.DataFrame({"target": targets, "other_1": np.arange(300) % 50})
    episodes["return"] = (targets == 40) * 1.0
    low, high = scoring.score_interval(evaluator.Result("rare", level, episodes))
    assert (low, high) == (0.0, 1.0)  # three toys, one of which is lifted
