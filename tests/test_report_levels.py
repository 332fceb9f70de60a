"""Splits of several levels: weighted and plain means, ± across seeds or tasks, tables of levels."""

from __future__ import annotations

import csv
import math
import shutil
import statistics as stdlib
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from run_folders import (
    change_description,
    constant,
    level,
    line,
    only_table,
    refusal,
    write_run,
)

from zipf import envs, report
from zipf.experiments.records import results
from zipf.experiments.reporting import grids, markdown, statistics, tables

PUTTING = envs.split("playroom_put")
LIFTING = envs.split("playroom_lift")


def write_playroom(
    root: Path,
    split: envs.Split,
    scores: Mapping[int, Sequence[float]],
    *,
    variant: str = "",
    chance: Sequence[float | None] = (0.3, 0.01, 0.02, 0.015, 0.015),
    **description: Any,
) -> Path:
    """A run of the playroom; `scores` are those of every level of its split, by update."""
    every = [(kind, one.name) for kind in envs.PAPER_KINDS for one in split.levels(kind)]
    return write_run(
        root,
        scores,
        experiment=split.name + variant,
        split=split.name,
        paper=split.paper,
        levels=[
            level(kind, name, chance=score, episodes=5000)
            for (kind, name), score in zip(every, chance, strict=False)
        ],
        environment={"max_steps": 900},
        **description,
    )


def test_the_train_score_is_the_mean_over_train_levels(tmp_path: Path) -> None:
    write_playroom(
        tmp_path,
        PUTTING,
        {100: (0.9, 0.6, 0.3, 0.2, 0.1), 200: (0.8, 0.2, 0.2, 0.2, 0.1), 300: (1, 1, 0.7, 0.2, 0)},
    )
    table = only_table(tmp_path)
    train = line(table, "impala", "train")
    assert train["score"] == pytest.approx(0.6)  # of 0.6, 0.4, 0.9
    assert train["episodes"] == 3000
    assert train["chance"] == pytest.approx(0.11)
    assert "Episodes per estimate: 1,000." in grids.caption(table)
    assert (
        "Chance: uniformly random actions, measured over 5,000 episodes of each level."
        in grids.legend([table])
    )
    scores = table.group_scores.set_index("level")
    near, on = (level.name for level in PUTTING.train[1:])
    assert list(scores.index) == ["Lifting (Zipf 2)", "Putting (frequent only)", near, on]
    # Putting at each update 0.45, 0.2, 0.85.
    assert scores["score"].tolist() == pytest.approx([0.9, 0.45, 0.6, 0.3])
    assert scores["paper_value"].tolist()[:2] == [0.993, 0.987]
    assert scores["chance"].tolist() == pytest.approx([0.3, 0.015, 0.01, 0.02])


def test_an_update_at_which_a_train_level_is_missing_has_no_train_score(tmp_path: Path) -> None:
    folder = write_playroom(tmp_path, PUTTING, {100: (0.3,) * 5, 200: (0.9,) * 5})
    path = folder / "evaluations.csv"
    kept = path.read_text().splitlines()
    del kept[-4]  # of update 200, the near level
    path.write_text("\n".join(kept) + "\n")
    table = only_table(tmp_path)
    assert line(table, "impala", "train")["score"] == pytest.approx(0.3)
    assert line(table, "impala", "rare")["score"] == pytest.approx(0.6)
    scores = table.group_scores
    assert scores["score"].tolist() == pytest.approx([0.6, 0.3, 0.3, 0.6])


def test_a_level_that_is_none_of_the_runs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_playroom(tmp_path, LIFTING, {100: (0.3,) * 3})
    path = folder / "evaluations.csv"
    path.write_text(path.read_text().replace("zipf3", "zipf4"))
    message = refusal(capsys, str(tmp_path))
    assert (
        "evaluations.csv, line 2: train level 'playroom/lift/lift_shape_zipf4'; by run.json the "
        "run has playroom/lift/lift_shape_zipf3"
    ) in message


def test_train_levels_stand_in_a_table_of_their_own(tmp_path: Path) -> None:
    write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    made = report.report([tmp_path], tmp_path / "out", record=tmp_path / "RESULTS.md")
    expected = (
        "Train levels:\n\n"
        "| Condition | Seeds | Lifting (Zipf 2) | paper | Putting (frequent only) | paper "
        "| put\\_near\\_bed\\_tray\\_frequent | put\\_on\\_bed\\_tray\\_frequent |\n"
        "| :-- | --: | --: | --: | --: | --: | --: | --: |\n"
        "| IMPALA | 1/3 | 0.90 | 0.99 | 0.45 | 0.99 | 0.60 | 0.30 |\n"
        "| Chance |  | 0.30 |  | 0.01 |  | 0.01 | 0.02 |\n"
    )
    for name in ("out/report.md", "RESULTS.md"):
        assert expected in (tmp_path / name).read_text(encoding="utf-8")
    rows = pd.read_csv(tmp_path / "out/report.csv")
    assert rows["level"].isna().tolist() == [True] * 3 + [False] * 4
    assert rows.loc[3, ["level_kind", "level", "score"]].tolist() == [
        "train",
        "Lifting (Zipf 2)",
        0.9,
    ]
    assert r"\label{tab:playroom-put-train}" in (tmp_path / "out/report.tex").read_text("utf-8")
    assert tmp_path / "out/playroom_put_learning.png" in made.files


def test_levels_of_no_published_experiment_stand_each_alone(tmp_path: Path) -> None:
    folder = write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    change_description(folder, paper=None)
    table = only_table(tmp_path)
    assert [group.name for group in table.groups] == [level.name for level in PUTTING.train]
    assert "| Condition | Seeds | lift\\_shape\\_zipf2 |" in markdown.markdown(table)


def test_lifting_and_putting_stand_side_by_side_as_in_the_paper(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_playroom(tmp_path, LIFTING, {100: (0.99, 0.6, 0.5)}, chance=(0.3, 0.3, 0.3))
    write_playroom(tmp_path, LIFTING, {100: (0.9, 0.4, 0.4)}, condition="vmpo")
    write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    write_playroom(tmp_path, PUTTING, {100: (0.1, 0.1, 0.1, 0.1, 0.1)}, variant="_compact")
    assert report.main([str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("training performance") == 1
    text = (tmp_path / "report/report.md").read_text(encoding="utf-8")
    assert text.count("## Zipf's Playroom\n") == 1
    # There is no compact lifting beside the compact putting.
    compact = text[text.index("## Zipf's Playroom (compact)\n") :]
    assert "| IMPALA | 1/3 | – | 0.65 ± 0.02 | – | 0.59 ± 0.02 | 0.10 | 0.62" in compact
    assert "There is no run of playroom\\_lifting." in compact
    start = text.index("## Zipf's Playroom\n")
    assert text[start:].splitlines()[2:6] == [
        "| Condition | Seeds | Lifting: uniform | paper | Lifting: rare | paper "
        "| Putting: uniform | paper | Putting: rare | paper |",
        "| :-- | --: | --: | --: | --: | --: | --: | --: | --: | --: |",
        "| IMPALA | 1/3 | 0.60 | 0.65 ± 0.02 | 0.50 | 0.59 ± 0.02 "
        "| 0.20 | 0.62 ± 0.02 | 0.10 | 0.49 ± 0.04 |",
        "| V-MPO | 1/3 | 0.40 | 0.39 ± 0.01 | 0.40 | 0.40 ± 0.03 "
        "| – | 0.00 ± 0.00 | – | 0.00 ± 0.00 |",
    ]
    assert "| R2D2 | 0/3 | – | 0.57 ± 0.00 | – | 0.51 ± 0.00 | – | 0.61 ± 0.05 |" in text[start:]
    assert "| Chance |  | 0.30 |  | 0.30 |  | 0.01 |  | 0.01 |  |" in text[start:]
    train = text[text.index("## Zipf's Playroom, training performance") :].splitlines()
    assert train[4].startswith("| IMPALA | 1/3 | 0.99 | 1.00 | 0.90 | 0.99 | 0.45 | 0.99 |")


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_the_latex_file_of_the_playroom_compiles(tmp_path: Path) -> None:
    write_playroom(tmp_path, LIFTING, {100: (0.99, 0.6, 0.5)})
    write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    report.report([tmp_path], tmp_path / "out")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"]
    done = subprocess.run(command, cwd=tmp_path / "out", capture_output=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Overfull" not in done.stdout


# --- weights and tasks -----------------------------------------------------------------------

TASKS = [
    *(level("train", f"tasks/{n}", weight, 0.1 * n) for n, weight in enumerate((4.0, 2.0, 1.0))),
    *(level("uniform", f"tasks/{n}", chance=0.1 * n) for n in range(3)),
    level("rare", "tasks/2", chance=0.2),
]


def write_tasks(root: Path, rng: np.random.Generator, **description: Any) -> list[Path]:
    """Three seeds with random scores on the levels of `TASKS`; a torn evaluation in one."""
    folders = []
    for seed in range(3):
        scores = {update: rng.normal(0.5, 1, len(TASKS)) for update in (50, 100, 150, 200, 250)}
        folders.append(
            write_run(root, scores, seed=seed, levels=TASKS, paper=None, **description)  # type: ignore[arg-type]
        )
    path = folders[1] / "evaluations.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-2]))  # of update 250
    return folders


def median(values: Sequence[float]) -> float:
    return stdlib.median(values)


def read_scores(folders: Sequence[Path], kind: str) -> list[dict[int, dict[str, float]]]:
    """For each seed and update the scores by level, of the updates 100 to 300."""
    seeds = []
    for folder in folders:
        updates: dict[int, dict[str, float]] = {}
        with (folder / "evaluations.csv").open() as file:
            for row in csv.DictReader(file):
                if row["level_kind"] == kind and 100 <= int(row["update"]) <= 300:
                    updates.setdefault(int(row["update"]), {})[row["level"]] = float(row["score"])
        wanted = {one["level"] for one in TASKS if one["level_kind"] == kind}
        seeds.append({update: row for update, row in updates.items() if row.keys() == wanted})
    return seeds


def slow_across_seeds(
    seeds: Sequence[dict[int, dict[str, float]]], weights: dict[str, float]
) -> tuple[float, float]:
    """The weighted mean of every evaluation, the median over the window, and over seeds."""
    of_seeds = []
    for updates in seeds:
        means = []
        for row in updates.values():
            summed = 0.0
            for name, score in row.items():
                summed += weights[name] * score
            means.append(summed / sum(weights.values()))
        of_seeds.append(median(means))
    middle = median(of_seeds)
    return middle, median([abs(score - middle) for score in of_seeds])


def slow_across_tasks(
    seeds: Sequence[dict[int, dict[str, float]]], weights: dict[str, float]
) -> tuple[float, float]:
    """For each level the median over the window and over seeds, then mean and standard error."""
    of_levels = {}
    for name in weights:
        of_levels[name] = median(
            [median([row[name] for row in updates.values()]) for updates in seeds]
        )
    total = sum(weights.values())
    mean = 0.0
    for name, score in of_levels.items():
        mean += weights[name] / total * score
    squares = 0.0
    for name, score in of_levels.items():
        squares += (weights[name] / total * (score - mean)) ** 2
    n = len(weights)
    return mean, (squares * n / (n - 1)) ** 0.5 if n > 1 else math.nan


@pytest.mark.parametrize("spread", ["seeds", "tasks"])
@pytest.mark.parametrize("kind", envs.PAPER_KINDS)
def test_scores_of_weighted_levels_against_an_oracle(
    tmp_path: Path, spread: str, kind: str
) -> None:
    oracle = {"seeds": slow_across_seeds, "tasks": slow_across_tasks}[spread]
    folders = write_tasks(tmp_path, np.random.default_rng(3), spread=spread)
    found = line(only_table(tmp_path), "impala", kind)
    weights = {one["level"]: one["weight"] for one in TASKS if one["level_kind"] == kind}
    scores = read_scores(folders, kind)
    assert [len(updates) for updates in scores] == [4, 4 if kind == "train" else 3, 4]
    weighted = oracle(scores, weights)
    plain = oracle(scores, dict.fromkeys(weights, 1.0))
    assert (found["score"], found["error"]) == pytest.approx(weighted, nan_ok=True)
    assert (found["plain_score"], found["plain_error"]) == pytest.approx(plain, nan_ok=True)
    assert (found["score"] != found["plain_score"]) == (kind == "train")
    assert found["spread"] == spread
    assert found["levels"] == len(weights)


def test_the_standard_error_of_equal_weights_is_the_usual_one() -> None:
    values = [0.3, 0.9, -0.2, 0.4]
    usual = stdlib.stdev(values) / 2
    assert statistics.standard_error(values, [2.0] * 4) == pytest.approx(usual)
    assert statistics.standard_error([0.5] * 3, [1, 2, 5]) == 0
    assert math.isnan(statistics.standard_error([0.5], [1.0]))


def test_a_plain_mean_stands_beside_a_weighted_one(tmp_path: Path) -> None:
    write_run(tmp_path, {100: (0.8, 0.4, 0.3, 0.2, 0.4, 0.6, 0.5)}, levels=TASKS, paper=None)
    table = only_table(tmp_path)
    text = markdown.markdown(table)
    # (4 x 0.8 + 2 x 0.4 + 1 x 0.3) / 7, and chance (4 x 0 + 2 x 0.1 + 1 x 0.2) / 7.
    assert text.startswith(
        "| Condition | Seeds | Train (Zipfian) | Train, plain mean | Uniform | Rare |\n"
        "| :-- | --: | --: | --: | --: | --: |\n"
        "| IMPALA | 1/3 | 0.61 | 0.50 | 0.40 | 0.50 |\n"
        "| Chance |  | 0.06 | 0.10 | 0.10 | 0.20 |\n"
    )
    assert {
        "The score of several levels is their mean, weighted by the split.",
        "In a plain mean all levels have the same weight.",
    } <= set(grids.legend([only_table(tmp_path)]))
    assert "Train levels:\n\n| Condition | Seeds | 0 | 1 | 2 |\n" in text
    assert "Uniform levels:\n\n| Condition | Seeds | 0 | 1 | 2 |\n" in text


# --- capped scores ---------------------------------------------------------------------------


def of_humans(kind: str, name: str, weight: float = 1.0, expert: float = 1.0) -> dict[str, Any]:
    """A level whose score is a fraction of a human's."""
    return level(kind, name, weight, chance=0.0, expert=expert, normalised=True)


HUMAN_TASKS = [
    of_humans("train", "a", 4.0, expert=2.0),
    of_humans("train", "b", 2.0, expert=0.5),
    of_humans("train", "c", 1.0),
    *(of_humans("uniform", name, expert=2.0) for name in "abc"),
    of_humans("rare", "c"),
]


def test_capped_scores_by_hand(tmp_path: Path) -> None:
    scores = {
        0: {50: (9.0,) * 7, 100: (0.8, -0.1, 0.5, 1.5, -0.1, 0.4, 0.4), 200: (0.8, -0.1, 0.5, *(
            1.5, -0.1, 0.4, 0.4))},
        1: {100: (1.6, -0.1, 0.5, 1.5, -0.1, 0.4, 0.4)},
    }  # fmt: skip
    for seed, of_seed in scores.items():
        write_run(tmp_path, of_seed, seed=seed, levels=HUMAN_TASKS, paper=None, spread="tasks")
    table = only_table(tmp_path)
    train = line(table, "impala", "train")
    # The medians of a are 0.8 and 1.6, over seeds 1.2: capped after that, not the seeds before.
    # (4 x 1.2 - 2 x 0.1 + 0.5) / 7 = 5.1 / 7, and with 1 in the place of 1.2 it is 4.3 / 7.
    assert train["score"] == pytest.approx(5.1 / 7)
    assert train["capped_score"] == pytest.approx(4.3 / 7)
    # sqrt(3 / 2 x ((4/7 x 0.385714)² + (2/7 x 0.714286)² + (1/7 x 0.114286)²)).
    assert train["capped_error"] == pytest.approx(0.368434, abs=1e-6)
    uniform = line(table, "impala", "uniform")
    assert uniform["score"] == pytest.approx(0.6)  # 1.5, -0.1, 0.4
    assert uniform["capped_score"] == pytest.approx(1.3 / 3)  # 1, -0.1, 0.4: no cap below
    assert uniform["capped_error"] == pytest.approx(0.317980, abs=1e-6)
    rare = line(table, "impala", "rare")
    assert rare["capped_score"] == rare["score"] == 0.4
    assert math.isnan(rare["capped_error"])
    assert train["expert"] == pytest.approx((8 + 1 + 1) / 7)
    assert train["capped_expert"] == pytest.approx((4 + 1 + 1) / 7)

    made = report.report([tmp_path], tmp_path / "out")
    text = (tmp_path / "out/report.md").read_text("utf-8")
    assert (
        "| IMPALA | 2/3 | 0.73 ± 0.44 | 0.53 ± 0.38 | 0.60 ± 0.47 | 0.40 |\n"
        "| Chance |  | 0.00 | 0.00 | 0.00 | 0.00 |\n"
        "| Expert |  | 1.43 | 1.17 | 2.00 | 1.00 |\n\n"
        "Capped scores:\n\n"
        "| Condition | Seeds | Train (Zipfian) | Uniform | Rare |\n"
        "| :-- | --: | --: | --: | --: |\n"
        "| IMPALA | 2/3 | 0.61 ± 0.37 | 0.43 ± 0.32 | 0.40 |\n"
        "| Chance |  | 0.00 | 0.00 | 0.00 |\n"
        "| Expert |  | 0.86 | 1.00 | 1.00 |\n"
    ) in text
    assert (
        "Capped: each level counts as at most 1, the score of a human, before the mean, as is the "
        "convention on DMLab-30 (Espeholt et al. 2018)."
    ) in text
    assert "Expert: a scripted policy that reads the whole state of the env." in text
    assert r"\label{tab:gridworld-capped}" in (tmp_path / "out/report.tex").read_text("utf-8")
    rows = pd.read_csv(tmp_path / "out/report.csv")
    assert rows["capped_score"].tolist()[:3] == pytest.approx([4.3 / 7, 1.3 / 3, 0.4])
    assert made.tables[0].is_capped


@pytest.mark.parametrize("how", ["seeds", "partly"])
def test_scores_are_capped_only_across_levels_that_are_all_normalised(
    tmp_path: Path, how: str
) -> None:
    levels = HUMAN_TASKS
    if how == "partly":
        levels = [{**one, "normalised": one["level"] != "c"} for one in HUMAN_TASKS]
    spread = "seeds" if how == "seeds" else "tasks"
    write_run(tmp_path, constant(2.0, 7), levels=levels, paper=None, spread=spread)
    table = only_table(tmp_path)
    assert not table.is_capped
    assert "apped" not in markdown.markdown(table)


@pytest.mark.parametrize("normalised", [True, False])
def test_baselines_are_capped_where_the_first_run_has_not_their_levels(
    tmp_path: Path, normalised: bool
) -> None:
    """As one of before there were validation levels has none."""
    other = {**of_humans("validation", "d", expert=2.0), "normalised": normalised}
    write_run(tmp_path, constant(0.5, 7), levels=HUMAN_TASKS, paper=None, spread="tasks")
    more = {"levels": [*HUMAN_TASKS, other], "paper": None, "spread": "tasks"}
    write_run(tmp_path, constant(0.5, 8), condition="r2d2", **more)
    found = line(only_table(tmp_path), "r2d2", "validation")
    assert found["expert"] == 2
    for name, value in (("capped_score", 0.5), ("capped_expert", 1.0)):
        assert found[name] == pytest.approx(value if normalised else math.nan, nan_ok=True)


def test_scores_in_different_units_do_not_share_a_table(tmp_path: Path) -> None:
    returns = [{**one, "normalised": False} for one in HUMAN_TASKS]
    write_run(tmp_path, constant(0.5, 7), levels=HUMAN_TASKS, paper=None)
    write_run(tmp_path, constant(0.5, 7), condition="r2d2", levels=returns, paper=None)
    assert len(tables.score_tables(results.load_runs([tmp_path]))) == 2


def test_the_caption_says_what_the_error_is(tmp_path: Path) -> None:
    write_tasks(tmp_path, np.random.default_rng(0), spread="tasks")
    assert grids.legend([only_table(tmp_path)])[0] == (
        "A score is, for each level, the median over seeds of each seed's median over the "
        "evaluations in the window, then the mean over the levels of a kind, weighted by the "
        "split, ± standard error across these levels (tasks)."
    )


def test_many_levels_are_lines(tmp_path: Path) -> None:
    weights = [1 / rank for rank in range(1, 8)]
    many = [
        *(level("train", f"a/task {n}", weight, 0.1) for n, weight in enumerate(weights)),
        level("uniform", "a/task 0"),
        level("rare", "a/task 6"),
    ]
    for condition in ("impala", "r2d2", "a", "b", "c", "d"):
        write_run(tmp_path, {100: [0.5] * 9}, condition=condition, levels=many, paper=None)
    text = markdown.markdown(only_table(tmp_path))
    assert (
        "Train levels:\n\n"
        "| Level | Weight | Chance | IMPALA | R2D2 | a | b | c |\n"
        "| :-- | --: | --: | --: | --: | --: | --: | --: |\n"
        "| task 0 | 0.386 | 0.10 | 0.50 | 0.50 | 0.50 | 0.50 | 0.50 |\n"
    ) in text
    assert "| task 6 | 0.055 | 0.10 | 0.50 |\n\nUpdates" in text  # condition d


def test_references_are_columns_beside_many_levels(tmp_path: Path) -> None:
    """In the order of `BASELINES`, and as many rows as leave the table as wide as others."""
    many = [
        *(
            level("train", f"a/task {n}", 1 / (n + 1), 0.1, expert=2, blind=0.2, generalist=1)
            for n in range(7)
        ),
        level("uniform", "a/task 0"),
        level("rare", "a/task 6"),
    ]
    for condition in ("impala", "r2d2", "a", "b", "c", "d"):
        write_run(tmp_path, {100: [0.5] * 9}, condition=condition, levels=many, paper=None)
    text = markdown.markdown(only_table(tmp_path))
    leading = "| Level | Weight | Chance | Blind | Generalist | Expert |"
    assert f"{leading} IMPALA | R2D2 | a |\n" in text
    assert f"{leading} b | c | d |\n" in text
    assert "| task 0 | 0.386 | 0.10 | 0.20 | 1.00 | 2.00 | 0.50 | 0.50 | 0.50 |\n" in text
