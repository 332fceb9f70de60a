"""Statistics across seeds: against loop-written oracles, and in the report."""

from __future__ import annotations

import dataclasses
import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from run_folders import SITUATIONS, constant, only_table, write_external, write_run

from zipf.experiments.reporting import latex, markdown, seed_statistics, statistics
from zipf.experiments.reporting.html import Notes, report_sections
from zipf.experiments.reporting.panels import looks_of
from zipf.experiments.reporting.situations import rates_by_visits, shares


def draws(scores: np.ndarray, count: int) -> list[np.ndarray]:
    """A stratified bootstrap, written out: for each level its own seeds."""
    rng = np.random.default_rng(5)
    drawn = []
    for _ in range(count):
        again = np.empty_like(scores)
        for level in range(scores.shape[1]):
            for seed in range(scores.shape[0]):
                again[seed, level] = scores[rng.integers(len(scores)), level]
        drawn.append(again)
    return drawn


def middle(scores: np.ndarray) -> float:
    every = sorted(scores.ravel().tolist())
    cut = len(every) // 4
    kept = every[cut : len(every) - cut]
    return sum(kept) / len(kept)


def better(scores: np.ndarray, others: np.ndarray) -> float:
    total = 0.0
    for level in range(scores.shape[1]):
        for mine, theirs in itertools.product(scores[:, level], others[:, level]):
            total += 1.0 if mine > theirs else 0.5 if mine == theirs else 0.0
    return total / (len(scores) * len(others) * scores.shape[1])


@pytest.mark.parametrize("levels", [1, 4])
def test_the_interquartile_mean_against_an_oracle(levels: int) -> None:
    scores = np.random.default_rng(levels).normal(size=(5, levels))
    found = statistics.interquartile_mean(scores)
    assert found.value == pytest.approx(middle(scores))
    low, high = np.quantile([middle(one) for one in draws(scores, 4000)], [0.025, 0.975])
    # Both ends are quantiles of a few thousand draws.
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.12)
    assert found.low < found.value < found.high
    assert statistics.interquartile_mean(scores) == found


def test_the_interquartile_mean_leaves_a_quarter_out_at_either_end() -> None:
    scores = np.array([[0.0, 100.0], [1.0, 2.0], [3.0, 4.0], [5.0, -50.0]])
    assert statistics.interquartile_mean(scores).value == pytest.approx((1 + 2 + 3 + 4) / 4)


@pytest.mark.parametrize("levels", [1, 3])
def test_the_probability_of_improvement_against_an_oracle(levels: int) -> None:
    rng = np.random.default_rng(levels)
    scores, others = rng.integers(0, 5, (4, levels)) / 1.0, rng.integers(0, 4, (3, levels)) / 1.0
    found = statistics.improvement(scores, others)
    assert found.value == pytest.approx(better(scores, others))
    assert statistics.improvement(others, scores).value == pytest.approx(1 - found.value)
    drawn = zip(draws(scores, 3000), draws(others[::-1], 3000), strict=True)
    low, high = np.quantile([better(*one) for one in drawn], [0.025, 0.975])
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.09)


def test_known_probabilities_of_improvement() -> None:
    low, high = np.array([[0.1], [0.2]]), np.array([[0.3], [0.4]])
    assert statistics.improvement(high, low) == statistics.Interval(1.0, 1.0, 1.0)
    assert statistics.improvement(low, low).value == 0.5
    for few in (np.zeros((1, 2)), np.zeros((0, 2))):
        with pytest.raises(ValueError, match="needs 2 seeds"):
            statistics.improvement(few, few)
        with pytest.raises(ValueError, match="needs 2 seeds"):
            statistics.interquartile_mean(few)


def shown(folder: Path) -> str:
    table = only_table(folder)
    found = seed_statistics.seed_statistics(table)
    latex.latex_report([table], [found])
    return markdown.markdown_report([table], {}, (), [found])


def test_statistics_in_the_report(tmp_path: Path) -> None:
    for seed, score in enumerate((0.2, 0.3, 0.4)):
        write_run(tmp_path, constant(score), seed=seed)
        write_run(tmp_path, constant(score + 0.5), condition="r2d2", seed=seed)
    write_run(tmp_path, constant(0.5), condition="impala_mlp")
    text = shown(tmp_path)
    assert "| IMPALA | 3 | 0.30 [0.20, 0.40] | 0.30 [0.20, 0.40] | 0.30 [0.20, 0.40] |" in text
    assert "| IMPALA + MLP | 1/3 | needs 2 seeds | needs 2 seeds | needs 2 seeds |" in text
    assert "Probability of improvement on IMPALA:" in text
    assert "| R2D2 | 1.00 [1.00, 1.00] | 1.00 [1.00, 1.00] | 1.00 [1.00, 1.00] |" in text
    assert "| IMPALA + MLP | needs 2 seeds |" in text
    table = only_table(tmp_path)
    found = seed_statistics.seed_statistics(table)
    frame = found.frame
    assert set(frame["statistic"]) == {seed_statistics.IQM, seed_statistics.IMPROVEMENT}
    assert len(frame) == 3 * (2 + 1)  # kinds; two rows of several seeds, one pair
    written = seed_statistics.csv_statistics([found, dataclasses.replace(found, frame=frame[:0])])
    assert written.startswith(",".join(seed_statistics.STATISTICS_COLUMNS))


def test_conditions_at_the_floor_are_not_compared(tmp_path: Path) -> None:
    """A rare score of 0.1 against 0.05 says nothing, as chance is 0.09; a training score of 0.6
    against 0.5 neither, as blind is 0.63."""
    for seed, extra in enumerate((0.0, 0.001, 0.002)):
        scores = {update: (0.5 + extra, 0.3, 0.05 + extra) for update in (100, 200, 300)}
        write_run(tmp_path, scores, seed=seed)
        scores = {update: (0.6 + extra, 0.06, 0.1 + extra) for update in (100, 200, 300)}
        write_run(tmp_path, scores, condition="r2d2", seed=seed)
    text = shown(tmp_path)
    assert "| R2D2 | at the floor | 0.00 [0.00, 0.00] | at the floor |" in text
    assert "less than 0.05 above the floor, the higher one of chance and blind." in text
    frame = seed_statistics.statistics_frame(only_table(tmp_path))
    compared = frame[frame["statistic"] == seed_statistics.IMPROVEMENT]
    assert set(compared["level_kind"]) == {"uniform"}


def test_success_in_each_rare_situation(tmp_path: Path) -> None:
    won = {(18, 18): (9, 0), (18, 19): (10, 10), (19, 18): (0, 0), (19, 19): (10, 5)}
    for seed in (0, 1):
        lines = [
            f"{update},rare,{map},{target},10,{of_seeds[seed]},{of_seeds[seed]}.0"
            for update in (100, 300)
            for (map, target), of_seeds in won.items()
        ]
        write_run(tmp_path, constant(0.5), seed=seed, situations=[SITUATIONS, *lines])
    text = shown(tmp_path)
    assert "| Condition | Mean | 18–18 | 18–19 | 19–18 | 19–19 |" in text
    mean = np.mean([seeds for seeds in won.values()]) / 10
    line = next(one for one in text.splitlines() if one.startswith("| IMPALA | 0.55 ["))
    assert line.endswith("| 0.90/0.00 | 1.00/1.00 | 0.00/0.00 | 1.00/0.50 |")
    assert mean == pytest.approx(0.55)
    table = only_table(tmp_path)
    found = seed_statistics.success_by_situation(table.rows[0], table)
    _, low, high = seed_statistics.bootstrap_of_situations(found)
    # Few situations that differ much: far wider than the 160 episodes alone would be.
    rng = np.random.default_rng(1)
    rates = np.array([[p for p, _ in row] for row in found.to_numpy()])
    means = []
    for _ in range(4000):
        seeds, situations = rng.integers(2, size=2), rng.integers(4, size=4)
        drawn = [rng.binomial(20, rates[s, k]) / 20 for s in seeds for k in situations]
        means.append(np.mean(drawn))
    assert (low, high) == pytest.approx(tuple(np.quantile(means, [0.025, 0.975])), abs=0.03)


def test_a_row_that_has_only_begun_has_no_rare_situations(tmp_path: Path) -> None:
    lines = [f"{update},rare,18,{k},10,5,5.0" for update in (100, 300) for k in (18, 19)]
    write_run(tmp_path, constant(0.5), situations=[SITUATIONS, *lines])
    begun = [one.replace("100,", "0,", 1) for one in lines[:2]]
    write_run(tmp_path, constant(0.1), condition="r2d2", situations=[SITUATIONS, *begun])
    text = shown(tmp_path)
    assert "| IMPALA | 0.50 | 0.50 | 0.50 |" in text


def test_rows_that_met_other_rare_situations_are_not_in_the_table(tmp_path: Path) -> None:
    for condition, targets in (("impala", (17, 18, 19)), ("r2d2", (18, 19)), ("vmpo", (17,))):
        lines = [f"300,rare,18,{k},10,5,5.0" for k in targets]
        write_run(tmp_path, constant(0.5), condition=condition, situations=[SITUATIONS, *lines])
    text = shown(tmp_path)
    assert "| IMPALA | 0.50 | 0.50 | 0.50 | 0.50 |" in text
    assert "| R2D2 | 0.50 | 0.50 |" not in text
    shutil.rmtree(tmp_path / "gridworld/impala")
    assert "rare situations (" not in shown(tmp_path)


def test_one_seed_has_no_interval(tmp_path: Path) -> None:
    lines = [
        f"{update},rare,18,{k},10,{won},{won}.0"
        for update in (100, 300)
        for k, won in ((18, 5), (19, 10))
    ]
    write_run(tmp_path, constant(0.5), situations=[SITUATIONS, *lines])
    assert "| IMPALA | 0.75 | 0.50 | 1.00 |" in shown(tmp_path)


def test_one_seed_has_one_sentence(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    text = shown(tmp_path)
    assert text.split("## Further statistics\n")[1].strip() == (
        "- Not of gridworld: an interquartile mean needs 2 seeds of a condition, and how often "
        "training met a situation was not recorded."
    )


def test_the_page_says_the_same_of_an_external_agent_alone(tmp_path: Path) -> None:
    write_external(tmp_path, {7: (0.3,) * 3})
    found = [only_table(tmp_path)]
    statistics = [seed_statistics.seed_statistics(found[0])]
    (section,) = (
        section
        for section in report_sections(statistics, looks_of(found))
        if section.title == "Statistics across seeds"
    )
    assert section.blocks == [Notes(tuple(seed_statistics.reading(statistics)))]


COUNTED = f"{SITUATIONS},visits,visits_map,visits_target"


def test_visits_stand_beside_rare_scores(tmp_path: Path) -> None:
    """Of the rare episodes, 90 had a situation that training had met once, and 10 one that it had
    never met."""
    rows = (
        COUNTED,
        "300,uniform,0,0,10,9,9.0,5000,8000,7000",
        "300,uniform,0,1,4,1,1.0,2,8000,50",
        "300,uniform,1,1,6,0,0.0,3,60,50",
        "300,uniform,1,0,5,2,2.0,0,60,7000",
        "300,rare,1,1,90,5,5.0,1,60,50",
        "300,rare,1,0,10,5,5.0,0,60,7000",
    )
    write_run(tmp_path, constant(0.5), situations=rows)
    text = shown(tmp_path)
    assert "| Condition | Seeds | Rare score | Situation met | Map met | Target met |" in text
    assert "| IMPALA | 1/3 | 0.50 | 1 (0 to 1) | 60 (60 to 60) | 50 (50 to 7,000) |" in text
    there = {"experiment": "gridworld", "condition": "impala", "seed": 0, "update": 300}
    there |= {"frames": 1_228_800, "parts": ["encoder"]}
    options = {"condition": "r2d2", "situations": rows, "pretrained": there}
    write_run(tmp_path / "other", constant(0.5), **options)
    text = shown(tmp_path / "other")
    assert "| R2D2 | 1/3 | 0.50 | at least 1 (0 to 1) | at least 60 (60 to 60) |" in text
    assert "At least: without those of the run whose weights" in text
    groups = rates_by_visits(only_table(tmp_path / "gridworld"), "visits")
    # 0; 2 and 3 together; 5000 alone.
    assert groups["episodes"].tolist() == [5, 10, 10]
    assert groups["met"].tolist() == pytest.approx([0, (2 * 4 + 3 * 6) / 10, 5000])
    assert groups["value"].tolist() == pytest.approx([0.4, 0.1, 0.9])


def test_shares_of_episodes(tmp_path: Path) -> None:
    rows = (
        SITUATIONS,
        "100,train,0,0,60,1,1.0",
        "300,train,0,1,30,1,1.0",
        "300,train,2,1,10,1,1.0",
        "300,rare,2,1,10,1,1.0",
    )
    write_run(tmp_path, constant(0.5), situations=rows)
    found = shares(only_table(tmp_path), "map")
    assert found.values.tolist() == [["train", 0, 0.9], ["train", 2, 0.1], ["rare", 2, 1.0]]
