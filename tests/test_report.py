"""The report: scores checked by hand, output against golden files, and every kind of bad input.

`UPDATE_GOLDEN=1 pytest tests/test_report.py` rewrites the golden files.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from rich.console import Console

from zipf import envs, report
from zipf.experiments.errors import UserError
from zipf.experiments.reporting import figures, paper, rendering, results, tables

GOLDEN = Path(__file__).parent / "golden" / "report"
CHANCE = {"train": 0.0324, "uniform": 0.0477, "rare": 0.0859}
EVALUATION_HEADER = "update,frames,seconds,level_kind,level,episodes,score,success,return,length"
Scores = Mapping[int, Sequence[float]]


def write_run(
    root: Path,
    scores: Scores,
    *,
    condition: str = "impala",
    seed: int = 0,
    situations: Sequence[str] = (),
    settings: str | None = None,
    **description: Any,
) -> Path:
    """A run folder; `scores` are (train, uniform, rare) by update."""
    described = {
        "experiment": "gridworld",
        "condition": condition,
        "seed": seed,
        "split": "gridworld",
        "command": f"python -m zipf.train experiment=gridworld seed={seed}",
        "commit": "0123456789abcdef",
        "version": "0.1.0",
        "torch": "2.5.0",
        "device": "cpu",
        "precision": "float32",
        "window": [100, 300],
        "num_updates": 300,
        "started": "2024-05-01T10:00:00+00:00",
        "chance": CHANCE,
        "environment": {"num_maps": 20, "num_objects": 20},
        "paper": "gridworld",
        **description,
    }
    folder = root / described["experiment"] / condition / f"seed{seed}"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps(described))
    lines = [EVALUATION_HEADER]
    for update, triple in scores.items():
        for level_kind, score in zip(paper.LEVEL_KINDS, triple, strict=True):
            lines.append(
                f"{update},{update * 4096},{update * 2.5},{level_kind},gridworld/{level_kind},"
                f"1000,{score},{score},{score},17.5"
            )
    (folder / "evaluations.csv").write_text("\n".join(lines) + "\n")
    if situations:
        (folder / "situations.csv").write_text("\n".join(situations) + "\n")
    if settings is not None:
        (folder / "config.yaml").write_text(settings)
    return folder


def constant(score: float) -> Scores:
    return {update: (score, score, score) for update in (100, 200, 300)}


def hand_made(root: Path) -> None:
    """Runs whose medians and deviations `test_scores_by_hand` derives."""
    outside = {50: (0.01, 0.01, 0.01), 400: (0.99, 0.99, 0.99)}
    write_run(
        root,
        {100: (0.80, 0.5, 0.1), 200: (0.84, 0.6, 0.3), 300: (0.90, 0.7, 0.2), **outside},
        situations=(
            "update,level_kind,map,target,episodes,successes,return_sum",
            "50,uniform,0,0,500,500,500.0",
            "100,uniform,0,0,30,27,27.0",
            "100,uniform,0,1,20,10,10.0",
            "300,uniform,1,0,40,8,8.0",
            "300,uniform,1,1,10,0,0.0",
            "300,rare,1,1,100,5,5.0",
        ),
    )
    write_run(
        root,
        {100: (0.70, 0.9, 0.0), 200: (0.90, 0.8, 0.0), 300: (0.80, 0.7, 0.0), **outside},
        seed=1,
        situations=(
            "update,level_kind,map,target,episodes,successes,return_sum",
            "200,uniform,0,0,10,9,9.0",
            "200,uniform,1,1,10,10,10.0",
        ),
    )
    write_run(root, {100: (0.95, 0.1, 1.0), 200: (0.85, 0.2, 0.9), 300: (0.91, 0.3, 0.8)}, seed=2)
    write_run(root, constant(0.5), condition="impala_mlp")
    write_run(root, constant(0.6), condition="impala_mlp", seed=1)
    write_run(root, {40: (0.4, 0.3, 0.2), 80: (0.5, 0.4, 0.3)}, condition="impala_byol")
    write_run(root, constant(-0.001), condition="my_agent", commit="0123456789abcdef+changes")
    write_run(
        root,
        {150: (0.875, 0.5, 0.0)},
        condition="impala_mlp,agent.discount=0.9",
        experiment="demo_50%",
        paper=None,
        chance=None,
        commit=None,
        window=[150, 150],
        num_updates=150,
    )


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The hand-made runs, below the working directory, so that messages hold no absolute path."""
    monkeypatch.chdir(tmp_path)
    hand_made(Path("runs"))
    return Path("runs")


def only_table(folder: Path, window: str | None = None) -> tables.ScoreTable:
    chosen = tables.parse_window(window) if window else None
    (table,) = tables.score_tables(results.load_runs([folder]), chosen)
    return table


def row(table: tables.ScoreTable, condition: str, level_kind: str) -> pd.Series:
    scores = table.scores
    chosen = (scores["condition"] == condition) & (scores["level_kind"] == level_kind)
    return scores[chosen].iloc[0]


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What the command says when it refuses; asserts one line and exit code 2."""
    assert report.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


# --- scores ----------------------------------------------------------------------------------


def test_scores_by_hand(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    # Window medians of the seeds, updates 50 and 400 left out: 0.84, 0.80, 0.91; their median
    # 0.84; the distances 0, 0.04, 0.07, with median 0.04.
    train = row(table, "impala", "train")
    assert (train["seeds"], train["median"]) == (3, pytest.approx(0.84))
    assert train["mad"] == pytest.approx(0.04)
    # 0.6, 0.8, 0.2; distances 0, 0.2, 0.4.
    uniform = row(table, "impala", "uniform")
    assert uniform["median"] == pytest.approx(0.6)
    assert uniform["mad"] == pytest.approx(0.2)
    # 0.2, 0.0, 0.9; distances 0, 0.2, 0.7.
    rare = row(table, "impala", "rare")
    assert rare["median"] == pytest.approx(0.2)
    assert rare["mad"] == pytest.approx(0.2)
    # Two seeds at 0.5 and 0.6: the mean of the middle two, both 0.05 away.
    mlp = row(table, "impala_mlp", "rare")
    assert (mlp["seeds"], mlp["median"]) == (2, pytest.approx(0.55))
    assert mlp["mad"] == pytest.approx(0.05)


def test_one_seed_has_no_deviation(runs: Path) -> None:
    mine = row(only_table(runs / "gridworld"), "my_agent", "train")
    assert mine["seeds"] == 1
    assert np.isnan(mine["mad"])


@given(st.lists(st.integers(0, 1000), min_size=2, max_size=9))
def test_deviation_is_the_unscaled_median_distance(values: list[int]) -> None:
    middle = statistics.median(values)
    expected = statistics.median(abs(value - middle) for value in values)
    assert tables.median_absolute_deviation(pd.Series(values)) == expected


def test_the_papers_numbers_stand_beside(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    train, rare = row(table, "impala", "train"), row(table, "impala", "rare")
    assert train["paper_value"] == 0.851
    assert np.isnan(train["paper_error"])
    assert (rare["paper_value"], rare["paper_error"]) == (0.24, 0.04)
    assert np.isnan(row(table, "my_agent", "rare")["paper_value"])
    assert table.chance == CHANCE


def test_a_table_without_a_published_number_is_silent_about_the_paper(tmp_path: Path) -> None:
    write_run(tmp_path / "mine", constant(0.5), condition="mine")
    table = only_table(tmp_path)
    assert "| Condition | Seeds | Train (Zipfian) | Uniform | Rare |" in rendering.markdown(table)
    assert "aper" not in rendering.markdown(table)
    write_run(tmp_path / "theirs", constant(0.5))
    console = Console(record=True, width=120)
    rendering.print_table(only_table(tmp_path), console)
    assert console.export_text().count("│   paper ") == 1


def test_the_caption_tells_how_many_episodes_of_any_run(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    path = write_run(tmp_path, constant(0.5), seed=1) / "evaluations.csv"
    path.write_text(path.read_text().replace(",1000,", ",7,"))
    assert "Episodes per estimate: 7 to 1,000." in rendering.caption(only_table(tmp_path))


def test_rows_are_in_the_papers_order(tmp_path: Path) -> None:
    conditions = ["zeta", "impala_mlp", "alpha", "r2d2", "impala_mlp,agent.discount=0.9", "impala"]
    for condition in conditions:
        write_run(tmp_path, constant(0.5), condition=condition)
    assert only_table(tmp_path).conditions == [
        "impala",
        "r2d2",
        "impala_mlp",
        "impala_mlp,agent.discount=0.9",
        "alpha",
        "zeta",
    ]


def test_a_resumed_run_counts_its_repeated_evaluations_once(tmp_path: Path) -> None:
    folder = write_run(tmp_path, {100: (0.1, 0.1, 0.1), 200: (0.2, 0.2, 0.2)})
    with (folder / "evaluations.csv").open("a") as file:
        file.write("200,819200,500,train,gridworld/train,1000,0.4,0.4,0.4,17\n")
    (run,) = results.load_runs([tmp_path])
    assert len(run.evaluations) == 6
    assert row(only_table(tmp_path), "impala", "train")["median"] == pytest.approx(0.25)


def test_overlapping_folders_count_a_run_once(runs: Path) -> None:
    found = results.load_runs([runs, runs / "gridworld", runs / "gridworld/impala/seed0"])
    assert len(found) == 8


# --- windows ---------------------------------------------------------------------------------


def test_a_run_that_did_not_reach_its_window_has_no_score(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    byol = row(table, "impala_byol", "train")
    assert byol["seeds"] == 0
    assert np.isnan(byol["median"])
    assert (
        "runs/gridworld/impala_byol/seed0: no evaluation at updates 100 to 300 (the last is at "
        "update 80); not counted. --window last shows it."
    ) in table.notes
    assert "| IMPALA + BYOL | 0/3 | – | 0.75 | – |" in rendering.markdown(table)


def test_the_last_evaluations_on_request(runs: Path) -> None:
    last = only_table(runs / "gridworld", "last")
    assert row(last, "impala_byol", "train")["median"] == 0.5
    assert row(last, "impala", "train")["median"] == pytest.approx(0.99)  # 0.99, 0.99, 0.91
    assert rendering.caption(last).startswith(
        "The last evaluation of the median seed (not the experiment's own window), ± median"
    )
    last_two = only_table(runs / "gridworld", "last:2")
    assert row(last_two, "impala_byol", "train")["median"] == pytest.approx(0.45)


def test_a_given_window_includes_both_ends(runs: Path) -> None:
    table = only_table(runs / "gridworld", "40:80")
    assert row(table, "impala_byol", "train")["median"] == pytest.approx(0.45)
    assert row(table, "impala", "train")["seeds"] == 2  # seed 2 has nothing at update 50
    assert rendering.caption(table).startswith(
        "Median over the evaluations at updates 40 to 80 of the median seed "
        "(not the experiment's own window), ± median"
    )


def test_a_window_that_is_not_over_yet_is_noted(tmp_path: Path) -> None:
    folder = write_run(tmp_path, {100: (0.1, 0.1, 0.1), 150: (0.2, 0.2, 0.2)})
    table = only_table(tmp_path)
    assert row(table, "impala", "train")["median"] == pytest.approx(0.15)
    assert table.notes == (
        f"{folder.as_posix()}: at update 150, before the window's end: scored over the 2 "
        f"evaluations so far.",
    )


@pytest.mark.parametrize(
    ("text", "window"),
    [
        ("0:0", tables.UpdateWindow(0, 0)),
        ("200k:2M", tables.UpdateWindow(200_000, 2_000_000)),
        ("2000000:3000000", tables.UpdateWindow(2_000_000, 3_000_000)),
        ("last", tables.LastEvaluations(1)),
        ("last:10", tables.LastEvaluations(10)),
    ],
)
def test_windows(text: str, window: tables.Window) -> None:
    assert tables.parse_window(text) == window


@pytest.mark.parametrize("text", ["", "5", "3:2", "-1:2", "a:b", "last:0", "last:25%", "1.5:2"])
def test_no_windows(text: str, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"window {text!r}" in refusal(capsys, str(runs), f"--window={text}")


# --- what may be pooled ----------------------------------------------------------------------


def test_other_environments_and_windows_get_their_own_table(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.1))
    write_run(tmp_path / "b", constant(0.2), environment={"num_maps": 5, "num_objects": 20})
    write_run(tmp_path / "c", constant(0.3), window=[100, 200])
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert {table.title: row(table, "impala", "train")["median"] for table in found} == {
        "gridworld (num_maps 20, window 100:300)": 0.1,
        "gridworld (num_maps 5, window 100:300)": 0.2,
        "gridworld (num_maps 20, window 100:200)": 0.3,
    }
    assert len({table.name for table in found}) == 3


def test_a_given_window_pools_runs_that_differ_only_there(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.1))
    write_run(tmp_path / "b", constant(0.3), seed=1, window=[100, 200])
    assert row(only_table(tmp_path, "100:200"), "impala", "train")["seeds"] == 2


def test_the_same_run_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = write_run(tmp_path / "a", constant(0.1))
    second = write_run(tmp_path / "b", constant(0.2))
    message = refusal(capsys, str(tmp_path))
    assert first.as_posix() in message
    assert second.as_posix() in message


def test_seeds_trained_with_other_settings_are_noted(tmp_path: Path) -> None:
    for seed, rate in enumerate(("0.001", "0.001", "0.0003")):
        settings = (
            f"seed: {seed}\ndevice: cpu{seed}\nagent:\n  learning_rate: {rate}\n  discount: 1\n"
        )
        write_run(tmp_path, constant(0.5), seed=seed, settings=settings)
    assert only_table(tmp_path).notes == (
        "The seeds of IMPALA were not trained with the same settings: agent.learning_rate differ.",
    )


def test_chance_may_be_known_for_some_levels_only(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5), chance={"train": 0.1, "uniform": None, "rare": None})
    table = only_table(tmp_path)
    assert table.chance == {"train": 0.1}
    assert "| Chance |  | 0.10 |  | – |  | – |  |" in rendering.markdown(table)


def test_disagreement_about_chance_is_noted(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), seed=1, chance={**CHANCE, "rare": 0.1})
    table = only_table(tmp_path)
    assert table.chance == CHANCE
    assert "disagree about chance" in table.notes[0]


# --- several train levels --------------------------------------------------------------------

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
    every = [(kind, level.name) for kind in envs.KINDS for level in split.levels(kind)]
    described = [
        {"level_kind": kind, "level": level, "chance": score, "chance_episodes": 5000}
        for (kind, level), score in zip(every, chance, strict=False)
    ]
    of_kinds = {
        kind: [one["chance"] for one in described if one["level_kind"] == kind]
        for kind in envs.KINDS
    }
    folder = write_run(
        root,
        {},
        experiment=split.name + variant,
        split=split.name,
        paper=paper.TABLE_OF_SPLIT[split.name],
        levels=described,
        chance={kind: None if None in s else sum(s) / len(s) for kind, s in of_kinds.items()},
        environment={"max_steps": 900},
        **description,
    )
    lines = [
        f"{update},{update * 4096},{update * 2.5},{kind},{level},1000,{score},{score},{score},40"
        for update, row in scores.items()
        for (kind, level), score in zip(every, row, strict=True)
    ]
    (folder / "evaluations.csv").write_text("\n".join([EVALUATION_HEADER, *lines]) + "\n")
    return folder


def test_the_train_score_is_the_mean_over_train_levels(tmp_path: Path) -> None:
    write_playroom(
        tmp_path,
        PUTTING,
        {100: (0.9, 0.6, 0.3, 0.2, 0.1), 200: (0.8, 0.2, 0.2, 0.2, 0.1), 300: (1, 1, 0.7, 0.2, 0)},
    )
    table = only_table(tmp_path)
    train = row(table, "impala", "train")
    assert train["median"] == pytest.approx(0.6)  # of 0.6, 0.4, 0.9
    assert train["episodes"] == 3000
    assert train["chance"] == pytest.approx(0.11)
    assert "Episodes per estimate: 1,000." in rendering.caption(table)
    assert (
        "Chance: uniformly random actions, measured over 5,000 episodes of each level."
        in rendering.caption(table)
    )
    scores = table.train_scores.set_index("level_kind")
    near, on = (level.name for level in PUTTING.train[1:])
    assert list(scores.index) == ["Lifting (Zipf 2)", "Putting (frequent only)", near, on]
    # Putting at each update 0.45, 0.2, 0.85.
    assert scores["median"].tolist() == pytest.approx([0.9, 0.45, 0.6, 0.3])
    assert scores["paper_value"].tolist()[:2] == [0.993, 0.987]
    assert scores["chance"].tolist() == pytest.approx([0.3, 0.015, 0.01, 0.02])


def test_an_update_at_which_a_train_level_is_missing_has_no_train_score(tmp_path: Path) -> None:
    folder = write_playroom(tmp_path, PUTTING, {100: (0.3,) * 5, 200: (0.9,) * 5})
    path = folder / "evaluations.csv"
    kept = path.read_text().splitlines()
    del kept[-4]  # of update 200, the near level
    path.write_text("\n".join(kept) + "\n")
    table = only_table(tmp_path)
    assert row(table, "impala", "train")["median"] == pytest.approx(0.3)
    assert row(table, "impala", "rare")["median"] == pytest.approx(0.6)
    scores = table.train_scores.set_index("level_kind")
    assert scores["median"].tolist() == pytest.approx([0.6, 0.3, 0.3, 0.6])


def test_a_level_that_is_none_of_the_runs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_playroom(tmp_path, LIFTING, {100: (0.3,) * 3})
    path = folder / "evaluations.csv"
    path.write_text(path.read_text().replace("zipf3", "zipf4"))
    message = refusal(capsys, str(tmp_path))
    assert "evaluations.csv: a train level (playroom/lift/lift_shape_zipf4); the run has" in message


def test_train_levels_stand_in_a_table_of_their_own(tmp_path: Path) -> None:
    write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    made = report.report([tmp_path], tmp_path / "out", record=tmp_path / "RESULTS.md")
    expected = (
        "Train levels:\n\n"
        "| Condition | Seeds | Lifting (Zipf 2) | paper | Putting (frequent only) | paper "
        "| put\\_near\\_bed\\_tray\\_frequent | paper "
        "| put\\_on\\_bed\\_tray\\_frequent | paper |\n"
        "| :-- | --: | --: | --: | --: | --: | --: | --: | --: | --: |\n"
        "| IMPALA | 1/3 | 0.90 | 0.99 | 0.45 | 0.99 | 0.60 | – | 0.30 | – |\n"
        "| Chance (measured) |  | 0.30 |  | 0.01 |  | 0.01 |  | 0.02 |  |\n"
    )
    for name in ("out/report.md", "RESULTS.md"):
        assert expected in (tmp_path / name).read_text(encoding="utf-8")
    lines = (tmp_path / "out/report.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 3 + 4
    assert lines[4].startswith("playroom_put,playroom_put,impala,train: Lifting (Zipf 2),1,0.9,")
    assert r"\label{tab:playroom-put-train}" in (tmp_path / "out/report.tex").read_text("utf-8")
    assert tmp_path / "out/playroom_put_learning.png" in made.files


def test_levels_of_no_published_experiment_stand_each_alone(tmp_path: Path) -> None:
    folder = write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    described = json.loads((folder / "run.json").read_text()) | {"paper": None}
    (folder / "run.json").write_text(json.dumps(described))
    table = only_table(tmp_path)
    assert list(table.train_groups) == [level.name for level in PUTTING.train]
    assert "| Condition | Seeds | lift\\_shape\\_zipf2 |" in rendering.markdown(table)


def test_lifting_and_putting_stand_side_by_side_as_in_the_paper(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_playroom(tmp_path, LIFTING, {100: (0.99, 0.6, 0.5)}, chance=(0.3, 0.3, 0.3))
    write_playroom(tmp_path, LIFTING, {100: (0.9, 0.4, 0.4)}, condition="vmpo")
    write_playroom(tmp_path, PUTTING, {100: (0.9, 0.6, 0.3, 0.2, 0.1)})
    write_playroom(tmp_path, PUTTING, {100: (0.1, 0.1, 0.1, 0.1, 0.1)}, variant="_compact")
    assert report.main([str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("Zipf's Playroom, training performance") == 1
    text = (tmp_path / "report/report.md").read_text(encoding="utf-8")
    assert text.count("## Zipf's Playroom\n") == 1  # there is no compact lifting beside it
    start = text.index("## Zipf's Playroom\n")
    assert text[start:].splitlines()[2:7] == [
        "| Condition | Seeds | Lifting: uniform | paper | Lifting: rare | paper "
        "| Putting: uniform | paper | Putting: rare | paper |",
        "| :-- | --: | --: | --: | --: | --: | --: | --: | --: | --: |",
        "| IMPALA | 1/3 | 0.60 | 0.65 ± 0.02 | 0.50 | 0.59 ± 0.02 "
        "| 0.20 | 0.62 ± 0.02 | 0.10 | 0.49 ± 0.04 |",
        "| V-MPO | 1/3 | 0.40 | 0.39 ± 0.01 | 0.40 | 0.40 ± 0.03 | – | – | – | – |",
        "| Chance (measured) |  | 0.30 |  | 0.30 |  | 0.01 |  | 0.01 |  |",
    ]
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


def test_ranks_that_the_rare_level_does_not_choose_by_are_not_marked(tmp_path: Path) -> None:
    header = "update,level_kind,target,task,episodes,successes,return_sum"
    cells = ("300,uniform,3,4,10,5,5.0", "300,rare,45,3,10,5,5.0", "300,rare,46,4,10,5,5.0")
    sizes = {"target": 50, "task": 5}
    write_run(tmp_path, constant(0.5), situations=(header, *cells), situation=sizes)
    table = only_table(tmp_path)
    assert figures._rare_ranks(table, "target") == list(range(40, 50))
    assert figures._rare_ranks(table, "task") == []


# --- damaged files ---------------------------------------------------------------------------


def test_a_torn_last_line_is_left_out_and_noted(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5), situations=("update,level_kind,map,episodes,succ",))
    (folder / "situations.csv").write_text("update,level_kind,ma")
    with (folder / "evaluations.csv").open("a") as file:
        file.write("400,1638400,1000,train,gridworld/train,1000,0.9,0.9,0.9,1")
    table = only_table(tmp_path, "last")
    assert row(table, "impala", "train")["median"] == 0.5
    assert table.notes == (
        f"{folder.as_posix()}/evaluations.csv: the last line is torn and was left out",
        f"{folder.as_posix()}/situations.csv: the last line is torn and was left out",
    )


def test_either_line_ending_is_read(tmp_path: Path) -> None:
    hand_made(tmp_path)
    before = only_table(tmp_path / "gridworld").scores
    for path in tmp_path.rglob("*.csv"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    pd.testing.assert_frame_equal(only_table(tmp_path / "gridworld").scores, before)


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("100,409600,250", "line 5: 3 fields where there are 10 columns"),
        ("", "line 5: 0 fields where there are 10 columns"),
        ("1e2,409600,250,train,g,1000,0.5,0.5,0.5,17", "line 5: column update has '1e2'"),
        ("100,409600,250,train,g,1000,o.5,0.5,0.5,17", "line 5: column score has 'o.5'"),
        ("100,409600,250,train,g,1000,nan,0.5,0.5,17", "expected a finite number"),
        ("100,409600,250,test,g,1000,0.5,0.5,0.5,17", "expected one of train, uniform, rare"),
        ("100,409600,250,\x00\xff,g,1000,0.5,0.5,0.5,17", "line 5: column level_kind"),
        ("600,409600,250,train,g,1000,0.5,0.5,0.5,17", "several train levels (g, gridworld/train)"),
    ],
)
def test_other_damage_names_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, problem: str
) -> None:
    folder = write_run(tmp_path, {100: (0.5, 0.5, 0.5)})
    with (folder / "evaluations.csv").open("ab") as file:
        file.write(line.encode("latin-1") + b"\n")
        file.write(b"500,409600,250,rare,gridworld/rare,1000,0.5,0.5,0.5,17\n")
    message = refusal(capsys, str(tmp_path))
    assert f"{folder.as_posix()}/evaluations.csv" in message
    assert problem in message


def test_a_missing_column_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_run(tmp_path, constant(0.5))
    (folder / "evaluations.csv").write_text("update,level_kind,score\n")
    message = refusal(capsys, str(tmp_path))
    assert "evaluations.csv, line 1: no column frames, seconds, level, episodes" in message


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ('{"experiment": ', "not a run's description"),
        ({"seed": None}, "seed: Input should be a valid integer"),
        ({"window": [300, 100]}, "window [300, 100] ends before it starts"),
        ({"chance": {"all": 0.1}}, "chance"),
        ({"paper": "atari"}, "paper: the paper has no experiment 'atari'; it has gridworld"),
    ],
)
def test_a_damaged_description_names_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str | dict[str, Any], problem: str
) -> None:
    path = write_run(tmp_path, constant(0.5)) / "run.json"
    if isinstance(change, str):
        path.write_text(change)
    else:
        path.write_text(json.dumps(json.loads(path.read_text()) | change))
    message = refusal(capsys, str(tmp_path))
    assert path.as_posix() in message
    assert problem in message


def test_a_run_without_evaluations_is_noted(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    folder = write_run(tmp_path, {}, seed=1)
    (folder / "evaluations.csv").unlink()
    (folder / "metrics.csv").write_text("update,frames,seconds,loss\n10,40960,5.0,nan\n")
    table = only_table(tmp_path)
    assert row(table, "impala", "train")["seeds"] == 1
    assert table.notes == (f"{folder.as_posix()}: no evaluation yet; not counted.",)
    assert "Updates reached: 10 to 300; frames: 40,960 to 1,228,800." in rendering.caption(table)


def test_a_missing_level_is_noted(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5))
    path = folder / "evaluations.csv"
    kept = [line for line in path.read_text().splitlines() if ",rare," not in line]
    path.write_text("\n".join(kept) + "\n")
    table = only_table(tmp_path)
    assert table.notes == (f"{folder.as_posix()}: no evaluation of rare; not counted there.",)
    assert "| IMPALA | 0/3 | 0.50 |" in rendering.markdown(table)


# --- the command -----------------------------------------------------------------------------


def test_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(capsys, str(tmp_path)) == (
        f"error: no run found under {tmp_path.as_posix()}: a run's folder has a run.json\n"
    )
    assert not list(tmp_path.iterdir())


def test_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such folder" in refusal(capsys, str(tmp_path / "missing"))


def test_a_place_that_cannot_be_written(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("taken").write_text("")
    assert "taken: cannot be written" in refusal(capsys, str(runs), "--output", "taken")


@pytest.mark.parametrize("arguments", [[], ["--wndow", "last", "."]])
def test_unknown_arguments(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        report.main(arguments)
    assert exit_.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_it_prints_the_table_and_says_where_the_files_are(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(runs)]) == 0
    printed = capsys.readouterr().out
    assert "0.84 ± 0.04" in printed
    assert "Chance" in printed
    for name in ("report.md", "report.csv", "gridworld_learning.png", "gridworld_ranks.png"):
        assert f"Wrote runs/report/{name}" in printed
        assert (runs / "report" / name).stat().st_size > 0


def test_it_needs_neither_torch_nor_a_display(runs: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from zipf import report\n"
        "assert 'matplotlib' not in sys.modules and 'pandas' not in sys.modules\n"
        "sys.exit(report.main(['runs']))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    root = Path(report.__file__).parents[1]
    subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        env=environment | {"PYTHONPATH": str(root)},
        stdout=subprocess.DEVNULL,
    )


# --- output ----------------------------------------------------------------------------------


def golden(name: str, text: str) -> None:
    path = GOLDEN / name
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")


def test_golden_files(runs: Path) -> None:
    made = report.report([runs], "out", record="RESULTS.md")
    assert Path("RESULTS.md") in made.files
    for name in ("report.md", "report.tex", "report.csv"):
        golden(name, (Path("out") / name).read_text(encoding="utf-8"))
    golden("RESULTS.md", Path("RESULTS.md").read_text(encoding="utf-8"))


def test_the_record_depends_on_the_results_alone(runs: Path) -> None:
    report.report([runs], "out", record="RESULTS.md")
    first = Path("RESULTS.md").read_bytes()
    moved = sorted((runs / "gridworld/impala").iterdir(), reverse=True)
    for folder in moved:  # another order of creation
        shutil.copytree(folder, f"{folder}_")
        shutil.rmtree(folder)
        Path(f"{folder}_").rename(folder)
    report.report([runs], "out", record="RESULTS.md")
    assert Path("RESULTS.md").read_bytes() == first


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_the_latex_file_compiles(runs: Path) -> None:
    report.report([runs], "out")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"]
    done = subprocess.run(command, cwd="out", capture_output=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Overfull" not in done.stdout


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.686, 0.054, "0.69 ± 0.05"),
        (1.0, float("nan"), "1.00"),
        (-0.001, 0.0, "0.00 ± 0.00"),
        (float("nan"), float("nan"), "–"),
    ],
)
def test_score_text(value: float, error: float, text: str) -> None:
    assert rendering.score_text(value, error) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(44.6, "45 s"), (600, "10 min"), (3599, "1 h 00 min"), (11_100, "3 h 05 min")],
)
def test_duration_text(seconds: float, text: str) -> None:
    assert rendering.duration_text(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0"), (9_999_999, "9,999,999"), (12_288_000, "12.3 million"), (9 * 10**9, "9 billion")],
)
def test_count_text(count: int, text: str) -> None:
    assert tables.count_text(count) == text


def test_the_papers_tables_name_known_conditions_and_levels() -> None:
    for experiment in (
        "gridworld",
        "playroom_lifting",
        "playroom_putting",
        "playroom_finding",
        "labyrinth_forward",
        "labyrinth_reversed",
    ):
        table = paper.paper_table(experiment)
        assert set(table.rows) <= set(paper.CONDITION_NAMES)
        columns = {*paper.LEVEL_KINDS, *table.train_groups}
        assert all(set(scores) <= columns for scores in table.rows.values())
    assert paper.paper_table("playroom_lifting").score("impala_mlp", "train") is None
    assert paper.paper_table("labyrinth_forward").score("impala", "rare") == (
        paper.PaperScore(0.32, 0.11)
    )
    with pytest.raises(UserError, match="gridworld"):
        paper.paper_table("maze")
    for split in envs.all_splits().values():
        table = paper.paper_table(paper.TABLE_OF_SPLIT[split.name])
        for group in table.train_groups.values():
            assert set(group) < {level.name for level in split.train}


# --- situations and plots --------------------------------------------------------------------


def test_success_by_rank_by_hand(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    rates = tables.success_rates(table, ["map"])
    # Rank 0: 27/30 + 10/20 of seed 0, 9/10 of seed 1; update 50 is outside the window.
    # Rank 1: 8/40 + 0/10 of seed 0, 10/10 of seed 1.
    assert rates[["map", "episodes", "successes"]].to_numpy().tolist() == [[0, 60, 46], [1, 60, 18]]
    assert rates["success"].tolist() == [pytest.approx(46 / 60), pytest.approx(0.3)]
    pairs = tables.success_rates(table, ["map", "target"])
    assert pairs["success"].tolist() == [0.9, 0.5, 0.2, 0.5]
    assert tables.success_rates(table, ["map"], "rare")["map"].tolist() == [1]


def test_wilson_interval() -> None:
    # Agresti and Coull (1998), The American Statistician 52(2): 0 of 10 gives (0, 0.28).
    low, high = tables.wilson_interval(pd.Series([0, 8, 10]), pd.Series([10, 10, 10]))
    assert low.tolist() == pytest.approx([0, 0.4902, 0.7225], abs=1e-4)
    assert high.tolist() == pytest.approx([0.2775, 0.9433, 1], abs=1e-4)


def test_figures_keep_their_text_inside(tmp_path: Path) -> None:
    header = "update,level_kind,map,target,episodes,successes,return_sum"
    cells = [f"300,uniform,{m},{t},10,5,5.0" for m in range(3) for t in range(3)]
    for condition in [*paper.CONDITION_NAMES, "impala_mlp,agent.learning_rate=0.001,network=wide"]:
        write_run(tmp_path, constant(0.5), condition=condition, situations=(header, *cells))
    table = only_table(tmp_path)
    styles = figures.line_styles(set(table.conditions))
    with matplotlib.rc_context(figures.STYLE):
        assert_text_is_inside(figures.learning_curves(table, styles))
        assert_text_is_inside(figures.success_against_rank(table, styles))
        assert_text_is_inside(figures.success_by_situation(table))


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_a_heat_map_makes_room_for_its_titles(tmp_path: Path, count: int) -> None:
    header = "update,level_kind,map,target,episodes,successes,return_sum"
    cells = [f"300,uniform,{m},{t},10,5,5.0" for m in range(5) for t in range(5)]
    settings = ",precision=bfloat16,collector.num_envs=2"
    for number in range(count):
        write_run(
            tmp_path,
            constant(0.5),
            experiment="demo (an experiment whose title has several lines)",
            condition=f"impala_mlp,number={number}{settings if number else ''}",
            situations=(header, *cells),
        )
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.success_by_situation(only_table(tmp_path))
        assert_text_is_inside(figure)
    assert figure is not None
    panel = figure.axes[0].get_window_extent()
    assert 0.7 < panel.width / panel.height < 1.4


def assert_text_is_inside(figure: Figure | None) -> None:
    assert figure is not None
    figure.draw_without_rendering()
    inside = figure.get_tightbbox().padded(-0.01)
    assert inside.x0 >= 0
    assert inside.y0 >= 0
    assert inside.x1 <= figure.get_figwidth()
    assert inside.y1 <= figure.get_figheight()
    # Inside, but one above the other, is no better.
    for axis in figure.axes:
        title = axis.title.get_window_extent()
        heading = figure._suptitle.get_window_extent()  # type: ignore[attr-defined]
        assert not axis.get_title() or title.y1 <= heading.y0


def test_few_updates_have_whole_ticks(tmp_path: Path) -> None:
    write_run(tmp_path, {0: (0.1, 0.1, 0.1), 1: (0.2, 0.2, 0.2)}, window=[0, 1], num_updates=1)
    table = only_table(tmp_path)
    figure = figures.learning_curves(table, figures.line_styles(set(table.conditions)))
    assert figure is not None
    figure.draw_without_rendering()
    axis = figure.axes[0].xaxis
    ticks = [tick for tick in axis.get_ticklocs() if tick <= 1]
    assert axis.get_major_formatter().format_ticks(ticks) == ["0", "1"]


def test_the_run_tells_which_ranks_there_are(tmp_path: Path) -> None:
    header = "update,level_kind,map,target,episodes,successes,return_sum"
    rows = ("300,uniform,0,1,10,5,5.0", "300,rare,18,9,10,5,5.0")
    sizes = {"map": 20, "target": 10}
    write_run(tmp_path / "new", constant(0.5), situations=(header, *rows), situation=sizes)
    write_run(tmp_path / "old", constant(0.5), situations=(header, *rows))

    def drawn(folder: str) -> tuple[tuple[int, ...], list[float], list[tuple[float, float]]]:
        table = only_table(tmp_path / folder)
        heat_map = figures.success_by_situation(table)
        ranks = figures.success_against_rank(table, figures.line_styles(set(table.conditions)))
        assert heat_map is not None
        assert ranks is not None
        panel = heat_map.axes[0]
        (frame,) = (patch for patch in panel.patches if isinstance(patch, Rectangle))
        image = panel.images[0].get_array()
        assert image is not None
        corners = [frame.get_y(), frame.get_y() + frame.get_height(), frame.get_x()]
        return image.shape, corners, [axis.get_xlim() for axis in ranks.axes]

    assert drawn("new") == ((20, 10), [15.5, 19.5, 7.5], [(-0.5, 19.5), (-0.5, 9.5)])
    assert drawn("old") == ((1, 2), [17.5, 18.5, 8.5], [(-0.5, 0.5), (-0.5, 1.5)])


def test_a_rank_that_cannot_be_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header = "update,level_kind,map,target,episodes,successes,return_sum"
    row = "300,uniform,20,1,10,5,5.0"
    write_run(
        tmp_path, constant(0.5), situations=(header, row), situation={"map": 20, "target": 10}
    )
    message = refusal(capsys, str(tmp_path))
    assert "situations.csv: map 20, but by run.json the ranks are 0 to 19" in message


def test_situations_with_other_ranks(tmp_path: Path) -> None:
    header = "update,level_kind,left,right,task,episodes,successes,return_sum"
    write_run(tmp_path, constant(0.5), situations=(header, "300,uniform,0,1,2,10,5,5.0"))
    made = report.report([tmp_path], tmp_path / "out")
    assert sorted(path.name for path in made.files if path.suffix == ".png") == [
        "gridworld_learning.png",
        "gridworld_ranks.png",
    ]


def test_a_figure_without_data_does_not_stay_behind(tmp_path: Path) -> None:
    header = "update,level_kind,map,target,episodes,successes,return_sum"
    write_run(tmp_path, constant(0.5), situations=(header, "300,uniform,0,1,10,5,5.0"))
    figure = tmp_path / "report/gridworld_ranks.png"
    report.report([tmp_path])
    assert figure.exists()
    report.report([tmp_path], window="100:200")
    assert not figure.exists()


def test_only_the_plots_of_the_earlier_report_are_removed(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.5))
    write_run(tmp_path / "b", constant(0.5), environment={"num_maps": 5})
    output = tmp_path / "out"
    report.report([tmp_path], output)
    assert (output / "gridworld-2_learning.png").exists()
    (output / "my_learning.png").write_text("")
    report.report([tmp_path / "b"], output)
    assert sorted(path.name for path in output.glob("*.png")) == [
        "gridworld_learning.png",
        "my_learning.png",
    ]


def test_a_condition_looks_the_same_in_any_company() -> None:
    alone = figures.line_styles({"impala_mlp"})
    everyone = figures.line_styles({*paper.CONDITION_NAMES, "a", "b"})
    assert alone["impala_mlp"] == everyone["impala_mlp"]
    assert len(set(everyone.values())) == len(everyone)
