"""The report: scores checked by hand and against oracles, tables and their files.

`UPDATE_GOLDEN=1 pytest tests/test_report.py` rewrites the golden files.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import statistics as stdlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from run_folders import (
    CHANCE,
    SITUATIONS,
    change_description,
    constant,
    gridworld,
    level,
    line,
    only_table,
    refusal,
    row_of,
    write_external,
    write_run,
)

from zipf import envs, report
from zipf.errors import UserError
from zipf.experiments.options import command_line
from zipf.experiments.records import paper, results, wording
from zipf.experiments.reporting import (
    charts,
    comparable,
    grids,
    markdown,
    scores,
    statistics,
    tables,
    terminal,
    windows,
)
from zipf.experiments.reporting.grids import legend

GOLDEN = Path(__file__).parent / "golden" / "report"


def hand_made(root: Path) -> None:
    """Runs whose medians and deviations `test_scores_by_hand` derives."""
    outside = {50: (0.01, 0.01, 0.01), 400: (0.99, 0.99, 0.99)}
    write_run(
        root,
        {100: (0.80, 0.5, 0.1), 200: (0.84, 0.6, 0.3), 300: (0.90, 0.7, 0.2), **outside},
        situations=(
            SITUATIONS,
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
            SITUATIONS,
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
        levels=gridworld({}),
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


# --- scores ----------------------------------------------------------------------------------


def test_scores_by_hand(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    # Window medians of the seeds, updates 50 and 400 left out: 0.84, 0.80, 0.91; their median
    # 0.84; the distances 0, 0.04, 0.07, with median 0.04.
    train = line(table, "impala", "train")
    assert (train["seeds"], train["score"]) == (3, pytest.approx(0.84))
    assert train["error"] == pytest.approx(0.04)
    # 0.6, 0.8, 0.2; distances 0, 0.2, 0.4.
    uniform = line(table, "impala", "uniform")
    assert uniform["score"] == pytest.approx(0.6)
    assert uniform["error"] == pytest.approx(0.2)
    # 0.2, 0.0, 0.9; distances 0, 0.2, 0.7.
    rare = line(table, "impala", "rare")
    assert rare["score"] == pytest.approx(0.2)
    assert rare["error"] == pytest.approx(0.2)
    # Two seeds at 0.5 and 0.6: the mean of the middle two, both 0.05 away.
    mlp = line(table, "impala_mlp", "rare")
    assert (mlp["seeds"], mlp["score"]) == (2, pytest.approx(0.55))
    assert mlp["error"] == pytest.approx(0.05)


def test_one_seed_has_no_deviation(runs: Path) -> None:
    mine = line(only_table(runs / "gridworld"), "my_agent", "train")
    assert mine["seeds"] == 1
    assert np.isnan(mine["error"])


@given(st.lists(st.integers(0, 1000), min_size=2, max_size=9))
def test_deviation_is_the_unscaled_median_distance(values: list[int]) -> None:
    middle = stdlib.median(values)
    expected = stdlib.median(abs(value - middle) for value in values)
    assert statistics.median_absolute_deviation(pd.Series(values)) == expected


def test_the_papers_numbers_stand_beside(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    train, rare = line(table, "impala", "train"), line(table, "impala", "rare")
    assert train["paper_value"] == 0.851
    assert np.isnan(train["paper_error"])
    assert (rare["paper_value"], rare["paper_error"]) == (0.24, 0.04)
    assert np.isnan(line(table, "my_agent", "rare")["paper_value"])
    assert table.baseline("chance") == CHANCE


def test_a_table_without_a_published_number_is_silent_about_the_paper(tmp_path: Path) -> None:
    write_run(tmp_path / "mine", constant(0.5), condition="mine")
    table = only_table(tmp_path)
    assert "| Condition | Seeds | Train (Zipfian) | Uniform | Rare |" in markdown.markdown(table)
    assert "aper" not in markdown.markdown(table)
    write_run(tmp_path / "theirs", constant(0.5))
    console = Console(record=True, width=120)
    terminal.print_table(only_table(tmp_path), console)
    assert console.export_text().count("│   paper ") == 1


def test_the_caption_tells_how_many_episodes_of_any_run(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    path = write_run(tmp_path, constant(0.5), seed=1) / "evaluations.csv"
    path.write_text(path.read_text().replace(",1000,", ",7,"))
    assert "Episodes per estimate: 7 to 1,000." in grids.caption(only_table(tmp_path))


def test_rows_are_in_the_order_of_their_conditions(tmp_path: Path) -> None:
    conditions = ["zeta", "impala_mlp", "alpha", "r2d2", "impala_mlp,agent.discount=0.9", "impala"]
    for condition in conditions:
        write_run(tmp_path, constant(0.5), condition=condition)
    assert [row.key for row in only_table(tmp_path).rows] == [
        "impala",
        "r2d2",
        "impala_mlp",
        "impala_mlp,agent.discount=0.9",
        "alpha",
        "zeta",
    ]


def test_seeds_with_other_titles_are_noted(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), seed=1, row=row_of("impala") | {"title": "Other"})
    table = only_table(tmp_path)
    assert [row.title for row in table.rows] == ["IMPALA"]
    assert table.notes == (
        "The seeds of impala have different titles (IMPALA, Other): the first is shown.",
    )


def test_the_record_has_the_command_that_finished_a_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5))
    later = "python -m zipf.train experiment=gridworld updates=4400"
    change_description(folder, resumed=[{"update": 9, "command": later}, {"update": 10}])
    text = markdown.record(tables.score_tables(results.load_runs([tmp_path])), "")
    assert f"```\n{later}\n```" in text


def test_the_record_begins_with_links_to_its_parts(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    pages = ["## Zipf's Gridworld: baselines\n\n### A part\n"]
    text = markdown.record(tables.score_tables(results.load_runs([tmp_path])), "", pages)
    contents, _ = text.split("\n\n## gridworld\n", 1)
    assert "# Results\n\n- [gridworld](#gridworld)\n- [" in contents
    assert contents.endswith("\n- [Zipf's Gridworld: baselines](#zipfs-gridworld-baselines)")
    linked = re.findall(r"^- \[(.+)\]\(#.+\)$", contents, re.MULTILINE)
    assert linked == re.findall(r"^## (.+)$", text, re.MULTILINE)


def test_the_frames_of_a_row_are_those_behind_its_score(tmp_path: Path) -> None:
    write_run(tmp_path, {100: (0.1,) * 3, 300: (0.1,) * 3, 400: (0.1,) * 3})
    write_run(tmp_path, {100: (0.1,) * 3, 200: (0.1,) * 3}, seed=1)
    write_run(tmp_path, {100: (0.1,) * 3, 300: (0.1,) * 3}, condition="r2d2")
    table = only_table(tmp_path)
    impala = line(table, "impala", "uniform")
    assert (impala["updates"], impala["frames"]) == (200, 200 * 4096)
    assert "| IMPALA | 2/3 | 819,200 | 0.10 ± 0.00 |" in markdown.markdown(table)
    assert "| R2D2 | 1/3 | 1,228,800 | 0.10 |" in markdown.markdown(table)


def test_overlapping_folders_count_a_run_once(runs: Path) -> None:
    found = results.load_runs([runs, runs / "gridworld", runs / "gridworld/impala/seed0"])
    assert len(found) == 8


# --- windows ---------------------------------------------------------------------------------


def test_a_run_that_did_not_reach_its_window_has_no_score(runs: Path) -> None:
    table = only_table(runs / "gridworld")
    byol = line(table, "impala_byol", "train")
    assert byol["seeds"] == 0
    assert np.isnan(byol["score"])
    assert (
        "IMPALA + BYOL, seed 0: no evaluation at updates 100 to 300 (the last is at update 80); "
        "not counted."
    ) in table.notes
    # The last one is shown, and in no file.
    shown = markdown.markdown(table).replace("\\", "")
    assert "| IMPALA + BYOL | 0/3 | 0.50 * | 0.75 | 0.40 * |" in shown
    assert any(sentence.startswith("*: the window is not reached") for sentence in legend([table]))
    assert "nan" not in shown


def test_a_table_whose_window_no_run_has_reached_shows_the_last_evaluations(tmp_path: Path) -> None:
    scores = {0: (0.1,) * 3, 40: (0.2,) * 3, 80: (0.4, 0.3, 0.2)}
    situations = (SITUATIONS, "80,uniform,0,0,10,4,4.0")
    write_run(tmp_path, scores, situations=situations)
    write_run(tmp_path, scores, seed=1)
    table = only_table(tmp_path)
    assert line(table, "impala", "train")["score"] == 0.4
    assert line(table, "impala", "train")["window"] == "last"
    assert "| IMPALA | 2/3 | 0.40 ± 0.00 * |" in markdown.markdown(table).replace("\\", "")
    assert grids.caption(table).startswith(
        "No run has reached its window, updates 100 to 300: the last evaluation of each."
    )
    assert table.notes == ()
    made = report.report([tmp_path], tmp_path / "report", claims=True)
    assert {path.name for path in made.files} >= {"gridworld_scores.png", "gridworld_ranks.png"}
    assert not any(claim.at_hand for claim in made.claims)


def test_the_last_evaluations_on_request(runs: Path) -> None:
    last = only_table(runs / "gridworld", "last")
    assert line(last, "impala_byol", "train")["score"] == 0.5
    assert line(last, "impala", "train")["score"] == pytest.approx(0.99)  # 0.99, 0.99, 0.91
    assert grids.caption(last).startswith(
        "The last evaluation (not the experiment's own window). Episodes"
    )
    last_two = only_table(runs / "gridworld", "last:2")
    assert line(last_two, "impala_byol", "train")["score"] == pytest.approx(0.45)


def test_situations_are_those_of_the_evaluations_inside_a_window(tmp_path: Path) -> None:
    """Also where a run was killed between writing the one and the other."""
    rows = (SITUATIONS, *(f"{update},train,0,0,9,5,5.0" for update in (100, 200, 300)))
    write_run(tmp_path, {100: (0.1,) * 3, 200: (0.2,) * 3}, situations=rows)
    (run,) = results.load_runs([tmp_path])
    for window in (windows.LastEvaluations(1), windows.UpdateWindow(200, 300)):
        assert windows.evaluations_inside(run, window)["update"].unique().tolist() == [200]
        assert windows.situations_inside(run, window)["update"].tolist() == [200]


def test_fewer_last_evaluations_than_asked_for_are_noted(tmp_path: Path) -> None:
    write_run(tmp_path, {0: (0.0,) * 3, 200: (0.4,) * 3, 300: (0.6,) * 3})
    write_run(tmp_path, {0: (0.1,) * 3}, condition="r2d2")
    write_external(tmp_path, {7: (0.3,) * 3}, experiment="gridworld")
    table = only_table(tmp_path, "last:3")
    assert line(table, "impala", "rare")["score"] == pytest.approx(0.5)
    assert line(table, "r2d2", "rare")["score"] == 0.1
    assert table.notes == (
        "IMPALA, seed 0: has 2 evaluations beside that at update 0, not 3: scored over what there "
        "is.",
        "R2D2, seed 0: has 1 evaluation, not 3: scored over what there is.",
    )
    assert only_table(tmp_path, "last").notes == ()


def test_a_given_window_includes_both_ends(runs: Path) -> None:
    table = only_table(runs / "gridworld", "40:80")
    assert line(table, "impala_byol", "train")["score"] == pytest.approx(0.45)
    assert line(table, "impala", "train")["seeds"] == 2  # seed 2 has nothing at update 50
    assert grids.caption(table).startswith(
        "Updates 40 to 80 (not the experiment's own window). Episodes"
    )


def test_a_window_that_is_not_over_yet_is_noted(tmp_path: Path) -> None:
    write_run(tmp_path, {100: (0.1, 0.1, 0.1), 150: (0.2, 0.2, 0.2)})
    table = only_table(tmp_path)
    assert line(table, "impala", "train")["score"] == pytest.approx(0.15)
    assert table.notes == (
        "IMPALA, seed 0: at update 150, before the window's end: scored over the 2 evaluations so "
        "far.",
    )


@pytest.mark.parametrize(
    ("text", "window"),
    [
        ("0:0", windows.UpdateWindow(0, 0)),
        ("200k:2M", windows.UpdateWindow(200_000, 2_000_000)),
        ("2000000:3000000", windows.UpdateWindow(2_000_000, 3_000_000)),
        ("last", windows.LastEvaluations(1)),
        ("last:10", windows.LastEvaluations(10)),
        ("scaled", "scaled"),
        ("own", windows.OwnWindows()),
    ],
)
def test_windows(text: str, window: windows.Window) -> None:
    assert windows.parse_window(text) == window


def test_a_scaled_window_has_the_same_fractions_of_a_shorter_run(tmp_path: Path) -> None:
    # Of the window 200 to 300, updates 80 to 120 of a run that ends at 120, and 200 to 300 of one
    # that goes on to 400.
    short = {60: (0.9,) * 3, 80: (0.1,) * 3, 100: (0.2,) * 3, 120: (0.3,) * 3}
    write_run(tmp_path, short, window=[200, 300])
    long = {100: (0.9,) * 3, 200: (0.5,) * 3, 300: (0.7,) * 3, 400: (0.9,) * 3}
    write_run(tmp_path, long, condition="r2d2", window=[200, 300])
    assert np.isnan(line(only_table(tmp_path), "impala", "rare")["score"])  # unless asked for
    table = only_table(tmp_path, "scaled")
    assert line(table, "impala", "rare")["score"] == pytest.approx(0.2)
    assert line(table, "impala", "rare")["window"] == "scaled:200:300"
    assert line(table, "r2d2", "rare")["score"] == pytest.approx(0.6)
    assert not table.own_window
    assert table.notes == (
        "IMPALA, seed 0: ends at update 120, before update 300: scored over updates 80 to 120, a "
        "scaled window.",
    )
    assert grids.caption(table).startswith(
        "66.7 to 100 % of each run, which are the fractions of updates 200 to 300 (not the "
        "experiment's own window)."
    )


@pytest.mark.parametrize("window", ["100:300", "scaled", "own"])
def test_the_own_window_is_not_called_another(window: str, tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, {}, condition="r2d2")  # no evaluation yet
    asked, usual = only_table(tmp_path, window), only_table(tmp_path)
    assert asked.own_window
    assert markdown.markdown(asked) == markdown.markdown(usual)


def test_a_window_that_is_the_own_one_of_some_runs_only(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), condition="r2d2", window=[200, 300])
    assert not only_table(tmp_path, "100:300").own_window


def test_each_runs_own_window_in_one_table(tmp_path: Path) -> None:
    scores = {50: (0.1,) * 3, 100: (0.2,) * 3, 200: (0.4,) * 3, 300: (0.8,) * 3}
    write_run(tmp_path, scores, window=[100, 300])
    write_run(tmp_path, scores, condition="r2d2", window=[50, 100])
    write_run(tmp_path, scores, condition="r2d2", window=[200, 200], seed=1)
    table = only_table(tmp_path, "own")
    assert line(table, "impala", "rare")["score"] == pytest.approx(0.4)
    assert line(table, "r2d2", "rare")["score"] == pytest.approx((0.15 + 0.4) / 2)
    assert line(table, "r2d2", "rare")["window"] == "50:100, 200:200"
    shown = markdown.markdown(table)
    assert "| Condition | Seeds | Frames | Window |" in shown
    assert "| 100 to 300 |" in shown
    assert "| 50 to 100, 200 to 200 |" in shown
    assert grids.caption(table).startswith("The updates in the column Window. Episodes")
    assert charts.window_ends(table, "update") is None


@pytest.mark.parametrize("text", ["", "5", "3:2", "-1:2", "a:b", "last:0", "last:25%", "1.5:2"])
def test_no_windows(text: str, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"window {text!r}" in refusal(capsys, str(runs), f"window={text}")


# --- what may be pooled ----------------------------------------------------------------------


def test_other_environments_and_windows_get_their_own_table(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.1))
    write_run(tmp_path / "b", constant(0.2), environment={"num_maps": 5, "num_objects": 20})
    write_run(tmp_path / "c", constant(0.3), window=[100, 200])
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert {table.title: line(table, "impala", "train")["score"] for table in found} == {
        "gridworld (num_maps 20, window 100:300)": 0.1,
        "gridworld (num_maps 5, window 100:300)": 0.2,
        "gridworld (num_maps 20, window 100:200)": 0.3,
    }
    assert len({table.name for table in found}) == 3


def test_a_given_window_pools_runs_that_differ_only_there(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.1))
    write_run(tmp_path / "b", constant(0.3), seed=1, window=[100, 200])
    assert line(only_table(tmp_path, "100:200"), "impala", "train")["seeds"] == 2


def test_other_levels_and_weights_get_their_own_table(tmp_path: Path) -> None:
    def levels(weight: float) -> list[dict[str, Any]]:
        return [*gridworld({}), level("train", "gridworld/other", weight)]

    write_run(tmp_path / "a", constant(0.1))
    write_run(tmp_path / "b", constant(0.2, 4), levels=levels(1.0))
    write_run(tmp_path / "c", constant(0.3, 4), levels=levels(2.0))
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert sorted(line(table, "impala", "train")["score"] for table in found) == [0.1, 0.2, 0.3]
    assert all("levels train: gridworld/train x 1" in table.title for table in found)


def test_the_same_run_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = write_run(tmp_path / "a", constant(0.1))
    second = write_run(tmp_path / "b", constant(0.2))
    message = refusal(capsys, str(tmp_path))
    assert f"{first.as_posix()} and {second.as_posix()} are the same run twice" in message


def test_two_runs_of_one_name_and_seed_with_other_options_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder, discount in (("a", 0.99), ("b", 0.5)):
        settings = f"agent:\n  learning_rate: 0.001\n  discount: {discount}\n"
        write_run(tmp_path / folder, constant(0.1), settings=settings)
    message = refusal(capsys, str(tmp_path))
    assert "the same run" not in message
    assert (
        "are both experiment gridworld, condition impala, seed 0, but by config.yaml they differ "
        "in agent.discount (0.99 and 0.5): train one of them under another name="
    ) in message


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
    write_run(tmp_path, constant(0.5), levels=gridworld({"train": 0.1}))
    table = only_table(tmp_path)
    assert table.baseline("chance") == {"train": 0.1}
    assert "| Chance |  | 0.10 |  | – |  | – |  |" in markdown.markdown(table)


def test_disagreement_about_chance_is_noted(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), seed=1, levels=gridworld({**CHANCE, "rare": 0.1}))
    table = only_table(tmp_path)
    assert table.baseline("chance") == CHANCE
    assert "seed1 disagree about chance (0.09 and 0.10 on gridworld/rare)" in table.notes[0]


def test_a_disagreement_about_chance_names_the_one_that_is_shown(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    other = gridworld({**CHANCE, "rare": 0.1})
    write_run(tmp_path, constant(0.5), condition="r2d2", levels=other)
    (table,) = tables.score_tables(results.load_runs([tmp_path]), order=["r2d2"])
    assert table.baseline("chance")["rare"] == 0.1
    assert "impala/seed0 disagree about chance (0.10 and 0.09 on gridworld/rare)" in table.notes[0]


def test_episodes_of_a_reference_are_those_of_the_score_that_is_shown(tmp_path: Path) -> None:
    measured = [
        level(kind, f"gridworld/{kind}", chance=CHANCE[kind], episodes=500)
        for kind in envs.PAPER_KINDS
    ]
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), seed=1, levels=measured)
    assert only_table(tmp_path).baseline_episodes("chance") == []
    write_run(tmp_path / "other", constant(0.5), levels=measured)
    assert only_table(tmp_path / "other").baseline_episodes("chance") == [500] * 3


def test_text_in_square_brackets_is_no_link(tmp_path: Path) -> None:
    row = {"title": "[click](http://there) [0.1, 0.2]", "order": None, "colour": None}
    write_run(tmp_path, constant(0.5), row={**row, "line": "solid"})
    assert r"[click\](http://there) [0.1, 0.2]" in markdown.markdown(only_table(tmp_path))


def test_the_record_ends_with_the_pages_beside_the_runs(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.6))
    (tmp_path / "references.md").write_text("## References\n\n± 0.1\n", "utf-8")
    (tmp_path / "gridworld" / "further_down.md").write_text("Not this.")
    for _ in range(2):  # the second time there is a report and a record beside the page
        record = tmp_path / "RESULTS.md"
        report.report([tmp_path], tmp_path, record=record)
        text = record.read_text("utf-8")
        assert text.endswith("\n## References\n\n± 0.1\n")
        assert text.count("\n## ") == 6  # the table, the paper's two, claims, statistics, the page
        assert "Not this." not in text


def test_a_page_that_cannot_be_read_is_named_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = tmp_path / "runs"
    write_run(runs, constant(0.6))
    (runs / "folder.md").mkdir()
    (runs / "notes.md").write_bytes(b"caf\xff\n")
    record = tmp_path / "RESULTS.md"
    arguments = [runs.as_posix(), f"record={record.as_posix()}"]
    assert "runs/notes.md: is not UTF-8 text" in refusal(capsys, *arguments)
    assert sorted(path.name for path in runs.iterdir()) == ["folder.md", "gridworld", "notes.md"]
    (runs / "notes.md").write_bytes(b"Notes.\n")
    assert report.main(arguments) == 0
    assert record.read_text("utf-8").endswith("Notes.\n")


def test_the_record_names_the_command_that_writes_it_again(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", constant(0.6))
    record = tmp_path / "RESULTS.md"
    arguments = [(tmp_path / "runs").as_posix(), "window=last", "conditions=impala", "claims=true"]
    assert report.main([*arguments, f"record={record.as_posix()}"]) == 0
    command = shlex.join(["python", "-m", "zipf.report", *arguments, f"record={record.as_posix()}"])
    assert f"`{command}`" in record.read_text("utf-8")


# --- agents from outside ---------------------------------------------------------------------


def test_an_external_agent_is_a_marked_row_of_its_own(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.6))
    write_run(tmp_path, constant(0.8), seed=1)
    scores = {5000: (0.1, 0.1, 0.1), 9000: (0.3, 0.2, 0.1)}
    write_external(tmp_path, scores, name="impala", experiment="gridworld_ppo")
    made = report.report([tmp_path], tmp_path / "out", record=tmp_path / "RESULTS.md")
    (table,) = made.tables
    assert [row.key for row in table.rows] == ["impala", "impala †"]
    assert line(table, "impala", "train")["score"] == pytest.approx(0.7)
    assert line(table, "impala", "train")["paper_value"] == 0.851
    external = line(table, "impala †", "train")
    # The last evaluation, which is no evaluation of ours at updates 100 to 300.
    assert (external["seeds"], external["score"]) == (1, 0.3)
    assert external["window"] == "last"
    assert np.isnan(external["paper_value"])
    assert table.notes == ()
    assert "†: recorded from outside this package and scored at its last evaluation." in (
        legend([table])
    )
    for name in ("out/report.md", "RESULTS.md"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert "| IMPALA † | 1/3 | 36.9 million | 0.30 | – | 0.20 | – | 0.10 | – |" in text
    assert "| IMPALA † | 0 | – | 36.9 million | – | – | – | 0.1.0 | – |" in text
    assert r"IMPALA \dag{} & 1/3 &" in (tmp_path / "out/report.tex").read_text("utf-8")
    rows = pd.read_csv(tmp_path / "out/report.csv")
    assert rows["external"].tolist() == [False] * 3 + [True] * 3


def test_an_external_agent_stands_in_every_table_of_its_worlds(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), experiment="gridworld_compact", window=[200, 300])
    write_run(tmp_path, constant(0.5), experiment="small", environment={"num_maps": 5})
    write_external(tmp_path, {7: (0.3, 0.2, 0.1)})
    found = tables.score_tables(results.load_runs([tmp_path]), windows.parse_window("100:200"))
    assert {table.name: [row.title for row in table.rows] for table in found} == {
        "gridworld": ["IMPALA", "PPO †"],
        "gridworld_compact": ["IMPALA", "PPO †"],
        "small": ["IMPALA"],
    }
    # Its own experiment, where that has a table of the same envs.
    change_description(tmp_path / "external/PPO/seed0", experiment="gridworld_compact")
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert [len(table.rows) for table in found] == [1, 2, 1]


def test_an_external_agent_of_several_experiments_has_a_table_for_each(tmp_path: Path) -> None:
    """In a table of ours they would be the same row twice."""
    write_run(tmp_path, constant(0.5))
    for number, name in enumerate(("lr_1e-3", "lr_1e-4")):
        write_external(tmp_path, {7: (0.1 * number,) * 3}, experiment=name)
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert [table.title for table in found] == ["gridworld", "lr_1e-3", "lr_1e-4"]
    assert [len(table.rows) for table in found] == [1, 1, 1]


def test_external_agents_alone_have_a_table(tmp_path: Path) -> None:
    for seed, score in enumerate((0.3, 0.5, 0.4)):
        scores = {3: (0.9, 0.9, 0.9), 7: (score, 0.2, 0.1)}
        write_external(tmp_path, scores, seed=seed, environment={"num_maps": 5})
    table = only_table(tmp_path, "1:2")
    assert line(table, "PPO †", "train")["score"] == 0.4
    caption = grids.caption(table)
    assert caption.startswith("The last evaluation. Episodes per estimate")
    assert "Updates reached" not in caption
    assert "Frames: 28,672." in caption


def test_an_external_agent_has_no_configuration_of_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_external(tmp_path, {7: (0.3, 0.2, 0.1)})
    (folder / "config.yaml").write_text("agent:\n  name: impala\n")
    message = refusal(capsys, str(tmp_path))
    assert "config.yaml: by run.json the agent is external and has none" in message


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
    assert "taken: cannot be written" in refusal(capsys, str(runs), "output=taken")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--window", "last", "."], "--window: no such flag; options have no dashes: window="),
        (["wndow=last", "."], "wndow: no such option; did you mean window?"),
        (["window=last"], "name a run's folder"),
        (["format=gif", "."], "format=gif: "),
        (["html=page", "."], "html=page: should be true, or a name that ends in .html"),
    ],
)
def test_unknown_arguments(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert told in refusal(capsys, *arguments)


def test_without_arguments_it_tells_its_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert report.main([]) == 2
    assert "usage:" in capsys.readouterr().out


def test_a_folder_may_have_an_equals_sign(runs: Path) -> None:
    """As those of rows with options that differ."""
    (runs / "gridworld").rename(runs / "impala,agent.discount=0.5")
    assert report.main([str(runs / "impala,agent.discount=0.5")]) == 0


def test_it_prints_the_table_and_says_where_the_files_are(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(runs / "gridworld")]) == 0
    printed = capsys.readouterr().out
    assert "0.84 ± 0.04" in printed
    assert "Chance" in printed
    for name in ("report.md", "report.csv", "gridworld_learning.png", "gridworld_ranks.png"):
        assert f"Wrote runs/gridworld/report/{name}" in printed
        assert (runs / "gridworld" / "report" / name).stat().st_size > 0


def test_figures_of_several_tables_are_counted(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A hundred names of files would push the tables off the screen."""
    assert report.main([str(runs)]) == 0
    printed = capsys.readouterr().out
    assert "Wrote runs/report/report.md\n" in printed
    assert "gridworld_learning.png" not in printed
    for name in ("gridworld", "demo_50"):
        count = len(list((runs / "report").glob(f"{name}_*.png")))
        assert f"Wrote runs/report/{name}_*.png: {count} figures\n" in printed


def test_it_needs_neither_torch_nor_a_display(runs: Path) -> None:
    code = (
        "import sys\n"
        "class Refusal:\n"  # scipy looks torch up in sys.modules, where None would be found
        "    def find_spec(self, name, *_):\n"
        "        if name.split('.')[0] == 'torch': raise ImportError(name)\n"
        "sys.meta_path.insert(0, Refusal())\n"
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


def test_titles_name_what_only_some_runs_tell_only_where_nothing_else_does() -> None:
    """Older runs wrote down only the options that were chosen."""
    new = {"split": "s", "window": "1:2", "environment.reach": 2.0}
    old = {"split": "s", "window": "3:4"}
    titles = [comparable._title("lift", one, [new, old]) for one in (new, old)]
    assert titles == ["lift (window 1:2)", "lift (window 3:4)"]
    old = {"split": "s", "window": "1:2"}
    titles = [comparable._title("lift", one, [new, old]) for one in (new, old)]
    assert titles == ["lift (reach 2.0)", "lift (reach not recorded)"]


def test_titles_name_the_split_where_it_tells_levels_apart(tmp_path: Path) -> None:
    for exponent in (1, 3):
        levels = [level("train", f"gridworld/zipf_{exponent}"), *gridworld({})[1:]]
        split = f"gridworld_zipf_{exponent}"
        write_run(tmp_path / split, constant(0.1), levels=levels, split=split)
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert [table.title for table in found] == [
        "gridworld (split gridworld_zipf_1)",
        "gridworld (split gridworld_zipf_3)",
    ]


def test_windows_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for first in (100, 20, 3):
        write_run(tmp_path / str(first), constant(0.1), window=[first, 300])
    titles = [table.title for table in tables.score_tables(results.load_runs([tmp_path]))]
    assert titles == [f"gridworld (window {first}:300)" for first in (3, 20, 100)]


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
    assert wording.score_text(value, error) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(44.6, "45 s"), (600, "10 min"), (3599, "1 h 00 min"), (11_100, "3 h 05 min")],
)
def test_duration_text(seconds: float, text: str) -> None:
    assert wording.duration_text(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0"),
        (9_999_999, "9,999,999"),
        (12_288_000, "12.3 million"),
        (999_400_000, "999 million"),
        (999_600_000, "1,000 million"),
        (9 * 10**9, "9 billion"),
        (1_228_800_000_000, "1,229 billion"),
    ],
)
def test_count_text(count: int, text: str) -> None:
    assert wording.count_text(count) == text


def test_the_papers_tables_name_known_conditions_and_levels() -> None:
    conditions = set(command_line.choices("condition"))
    for experiment in (
        "gridworld",
        "playroom_lifting",
        "playroom_putting",
        "playroom_finding",
        "labyrinth_forward",
        "labyrinth_reversed",
    ):
        table = paper.paper_table(experiment)
        assert set(table.rows) <= conditions
        columns = {*envs.PAPER_KINDS, *table.train_groups}
        assert all(set(scores) <= columns for scores in table.rows.values())
    assert paper.paper_table("playroom_lifting").score("impala_mlp", "train") is None
    assert paper.paper_table("labyrinth_forward").score("impala", "rare") == (
        paper.PaperScore(0.32, 0.11)
    )
    with pytest.raises(UserError, match="gridworld"):
        paper.paper_table("maze")
    for split in envs.all_splits().values():
        if split.paper is not None:
            groups = paper.paper_table(split.paper).train_groups.values()
            assert all(set(group) < {level.name for level in split.train} for group in groups)


def test_the_papers_layouts_have_columns_of_its_tables() -> None:
    layouts = paper.paper_layouts()
    assert {name for one in layouts for name in one.experiments} == {
        split.paper for split in envs.all_splits().values() if split.paper
    }
    for layout in layouts:
        for _, columns in layout.tables:
            for one in columns.values():
                assert paper.paper_table(one.experiment).score("impala", one.column) is not None
                assert one.statistic in scores.CSV_COLUMNS


def test_the_papers_titles_are_those_of_the_conditions() -> None:
    published = {name for split in envs.all_splits().values() for name in rows_of_paper(split)}
    assert set(paper.paper_titles()) == published
    for condition, title in paper.paper_titles().items():
        assert title == row_of(condition)["title"]


def rows_of_paper(split: envs.Split) -> set[str]:
    return set(paper.paper_table(split.paper).rows) if split.paper else set()


# --- conditions that are chosen --------------------------------------------------------------


def test_chosen_conditions_are_shown_in_their_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for condition in ("impala", "r2d2", "impala_mlp", "impala_mlp,agent.discount=0.9"):
        write_run(tmp_path, constant(0.5), condition=condition)
    chosen = "r2d2,impala_mlp,agent.discount=0.9,IMPALA"  # a name with a comma, and a title
    (table,) = report.report([tmp_path], conditions=chosen).tables
    assert [row.key for row in table.rows] == ["r2d2", "impala_mlp,agent.discount=0.9", "impala"]
    (table,) = report.report([tmp_path], conditions=["impala_mlp*"]).tables
    assert [row.key for row in table.rows] == ["impala_mlp", "impala_mlp,agent.discount=0.9"]
    described = {"order": None, "colour": None, "line": "solid"}
    for condition in ("slow", "slower"):  # with one title, of commas and brackets
        row = {"title": "Slow, [of two]", **described}
        write_run(tmp_path, constant(0.5), condition=condition, row=row)
    for chosen in ("slow, [of two]", "[Slow, [of two],r2d2]", "*[of two]"):
        (table,) = report.report([tmp_path], conditions=chosen).tables
        assert [row.key for row in table.rows][:2] == ["slow", "slower"]
    for option in ("conditions", "highlight"):
        told = refusal(capsys, str(tmp_path), f"{option}=impala,vmpo")
        assert "vmpo: no such condition; there are impala, " in told
        for none in ("[]", ","):
            assert f"{option}: names none; leave it out" in refusal(
                capsys, str(tmp_path), f"{option}={none}"
            )
    (table,) = report.report([tmp_path], conditions="impala,").tables
    assert [row.key for row in table.rows] == ["impala"]
    for wrong in ({"conditions": []}, {"format": "jpg"}):
        with pytest.raises(UserError, match=r"should be png|conditions: names none"):
            report.report([tmp_path], tmp_path / "report", **wrong)
    assert not (tmp_path / "report").exists()


def test_claims_are_checked_on_request(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report.main([str(runs), "claims=true"]) == 0
    assert "Claims of the paper" in capsys.readouterr().out
    assert (runs / "report/claims.csv").exists()
    assert report.main([str(runs)]) == 0
    assert "laims" not in capsys.readouterr().out
    assert "laims" not in (runs / "report/report.md").read_text("utf-8")
    assert not (runs / "report/claims.csv").exists()


def test_titles_do_not_repeat_what_the_table_says(tmp_path: Path) -> None:
    """And the agent looks the same in both tables."""
    for exponent, condition in ((2, "impala"), (0, "impala,environment.split=gridworld_zipf_0")):
        levels = [level("train", f"gridworld/zipf_{exponent}"), *gridworld({})[1:]]
        split = "gridworld" if exponent == 2 else "gridworld_zipf_0"
        other = {"levels": levels, "split": split}
        write_run(tmp_path / split, constant(0.1), condition=condition, **other)
        write_run(tmp_path / split, constant(0.1), condition="r2d2", **other)
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert [[row.title for row in table.rows] for table in found] == [["IMPALA", "R2D2"]] * 2
    assert {row.agent for table in found for row in table.rows} == {"impala", "r2d2"}
    names = {"gridworld_split_gridworld", "gridworld_split_gridworld_zipf_0"}
    assert {table.name for table in found} == names
