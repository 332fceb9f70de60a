"""Damaged and unfinished run folders: what is left out, and what is refused, by file and line."""

from __future__ import annotations

import csv
import errno
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_folders import (
    EVALUATIONS,
    SITUATIONS,
    change_description,
    constant,
    level,
    line,
    only_table,
    refusal,
    row_of,
    write_run,
)

from zipf import envs
from zipf.errors import UserError
from zipf.experiments.records import results
from zipf.experiments.reporting import grids, markdown, tables


def test_a_torn_last_line_is_left_out_and_noted(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5), situations=("update,level_kind,map,episodes,succ",))
    (folder / "situations.csv").write_text("update,level_kind,ma")
    with (folder / "evaluations.csv").open("a") as file:
        file.write("400,1638400,1000,train,gridworld/train,1000,0.9,0.9,0.9,1")
    table = only_table(tmp_path, "last")
    assert line(table, "impala", "train")["score"] == 0.5
    assert table.notes == (
        f"{folder.as_posix()}/evaluations.csv: the last line is torn and was left out",
        f"{folder.as_posix()}/situations.csv: the last line is torn and was left out",
    )


def test_either_line_ending_is_read(tmp_path: Path) -> None:
    situations = (SITUATIONS, "300,uniform,0,1,10,5,5.0")
    write_run(tmp_path, {100: (0.1, 0.2, 0.3), 200: (0.3, 0.4, 0.5)}, situations=situations)
    (before,) = results.load_runs([tmp_path])
    for path in tmp_path.rglob("*.csv"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    (after,) = results.load_runs([tmp_path])
    pd.testing.assert_frame_equal(after.evaluations, before.evaluations)
    pd.testing.assert_frame_equal(after.situations, before.situations)


def test_a_name_may_need_quotes(tmp_path: Path) -> None:
    name = 'MyEnv-v0(size=5,goal="a")'
    levels = [level(kind, name) for kind in envs.PAPER_KINDS]
    folder = write_run(tmp_path, {}, levels=levels)
    with (folder / "evaluations.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(EVALUATIONS.split(","))
        writer.writerow([100, 1, 1.0, "train", name, 10, 0.5, "", 0.5, 3.0])
    assert line(only_table(tmp_path), "impala", "train")["score"] == 0.5


@pytest.mark.parametrize(
    ("damaged", "problem"),
    [
        ("100,409600,250", "line 5: 3 fields where there are 10 columns"),
        ("", "line 5: 0 fields where there are 10 columns"),
        ("1e2,409600,250,train,g,1000,0.5,0.5,0.5,17", "line 5: column update has '1e2'"),
        ("-1,409600,250,train,g,1000,0.5,0.5,0.5,17", "expected a whole number"),
        ("100,409600,250,train,g,1000,o.5,0.5,0.5,17", "line 5: column score has 'o.5'"),
        ("100,409600,250,train,g,1000,nan,0.5,0.5,17", "expected a finite number"),
        ("100,409600,250,train,g,1000,0.5,inf,0.5,17", "expected a finite number or nothing"),
        ("100,409600,250,train,g,1000,0.5,0.5,,17", "column return has '', expected a finite"),
        ("100,409600,250,test,g,1000,0.5,0.5,0.5,17", "expected one of train, uniform, rare"),
        ("100,409600,250,\x00\xff,g,1000,0.5,0.5,0.5,17", "line 5: column level_kind"),
        ("100,409600,250,train,\xff,1000,0.5,0.5,0.5,17", "line 5: train level"),
        ("600,409600,250,train,g,1000,0.5,0.5,0.5,17", "line 5: train level 'g'; by run.json"),
        (f"{'9' * 400},1,250,train,g,1000,0.5,0.5,0.5,17", "line 5: column update has '9999"),
        (f"100,1,{'9' * 400},train,g,1000,0.5,0.5,0.5,17", "line 5: column seconds has '9999"),
        ("100,1,250,train\rg,1000,0.5,0.5,0.5,17,1", "line 5: "),
        ('100,1,250,train,"g,1000,0.5,0.5,0.5,17', "line 5: "),
        ('100,1,250,train,"g"h,1000,0.5,0.5,0.5,17', "line 5: "),
        (
            "100,409600,250,rare,gridworld/rare,1000,0,0,0,17",
            "line 5: gridworld/rare at update 100",
        ),
        (f"100,1,250,train,{'g' * 200_000},1000,0.5,0.5,0.5,17", "line 5: "),
    ],
)
def test_other_damage_names_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damaged: str, problem: str
) -> None:
    folder = write_run(tmp_path, {100: (0.5, 0.5, 0.5)})
    with (folder / "evaluations.csv").open("ab") as file:
        file.write(damaged.encode("latin-1") + b"\n")
        file.write(b"500,409600,250,rare,gridworld/rare,1000,0.5,0.5,0.5,17\n")
    message = refusal(capsys, str(tmp_path))
    assert f"{folder.as_posix()}/evaluations.csv" in message
    assert problem in message
    assert len(message) < 500


@pytest.mark.parametrize("content", [b"\n", b"\n\n", b"\nupdate,frames,seconds\n"])
def test_a_blank_first_line_is_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    folder = write_run(tmp_path, {})
    (folder / "metrics.csv").write_bytes(content)
    assert "metrics.csv, line 1: is empty" in refusal(capsys, str(tmp_path))


DAMAGE = [b"\x80", b"\xff\xfe", b"\r", b"\n", b"\x00", b'"', b"abc", b",,,", b"9" * 400]
FILES = [
    "run.json",
    "evaluations.csv",
    "situations.csv",
    "metrics.csv",
    "config.yaml",
]


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(FILES), st.data())
def test_no_damage_ends_in_a_traceback(name: str, data: st.DataObject) -> None:
    """A piece of a file is replaced: it is still a run, or the file is named in one line."""
    with tempfile.TemporaryDirectory() as root:
        situations = (SITUATIONS, "300,uniform,0,1,10,5,5.0")
        folder = write_run(Path(root), constant(0.5), situations=situations)
        rows = "10,40960,5.0,episode_length,7.5\n10,40960,5.0,loss,1.5\n"
        (folder / "metrics.csv").write_text(f"update,frames,seconds,metric,value\n{rows}")
        content = (folder / name).read_bytes()
        start = data.draw(st.integers(0, len(content)))
        end = start + data.draw(st.integers(0, 20))
        put = data.draw(st.sampled_from(DAMAGE) | st.binary(max_size=5))
        (folder / name).write_bytes(content[:start] + put + content[end:])
        refused = ""
        try:
            found = tables.score_tables(results.load_runs([root]))
            markdown.record(found, "")
            tables.csv_report(found)
        except UserError as error:
            refused = str(error)
        assert not refused or name in refused
        assert "\n" not in refused


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
        (
            {"levels": [level("all", "a")]},
            "levels.0.level_kind: Input should be 'train', 'uniform'",
        ),
        ({"levels": [level("train", "a"), level("train", "a")]}, "two train levels have the same"),
        ({"levels": [level("uniform", "a")]}, "levels: there is no train level"),
        ({"levels": [level("train", "a", -1.0)]}, "levels.0.weight: Input should be greater than"),
        ({"row": row_of("impala") | {"colour": "blue"}}, "row.colour: String should match"),
        ({"row": row_of("impala") | {"line": "wavy"}}, "row.line: Input should be 'solid'"),
        ({"spread": "levels"}, "spread: Input should be 'seeds' or 'tasks'"),
        ({"situation": {"map": 0}}, "situation.map: Input should be greater than 0"),
        ({"window": None}, "window: missing"),
        ({"external": {}}, "external.name: Field required"),
        ({"resumed": 5}, "resumed: Input should be a valid"),
        (
            {"levels": [level("train", "a", oracle=1.0)]},
            "levels.0.references.oracle.[key]: Input should be 'chance', 'blind'",
        ),
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


def test_a_run_without_its_options_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path, constant(0.5), settings=None)
    assert f"{folder.as_posix()}/config.yaml: cannot be read" in refusal(capsys, str(tmp_path))


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "is no run's options, or cut"),
        ("- 1\n", "is no run's options, or cut"),
        ("agent: {learning_rate: 0.001}\n", "is no run's options, or cut"),
        (
            "schedule: {}\n",
            "than run.json (experiment, condition, seed, environment)",
        ),
    ],
)
def test_options_of_another_run_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, problem: str
) -> None:
    folder = write_run(tmp_path, constant(0.5))
    (folder / "config.yaml").write_text(content)
    message = refusal(capsys, str(tmp_path))
    assert f"{folder.as_posix()}/config.yaml" in message
    assert problem in message


def test_a_description_of_another_seed_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change_description(write_run(tmp_path, constant(0.5)), seed=9)
    assert "options of another run than run.json (seed)" in refusal(capsys, str(tmp_path))


def test_more_successes_than_episodes_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = (SITUATIONS, "300,uniform,1,1,10,12,5.0")
    write_run(tmp_path, constant(0.5), situations=rows)
    message = refusal(capsys, str(tmp_path))
    assert "situations.csv, line 2: 12 successes of 10 episodes" in message


def test_a_rank_that_cannot_be_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = (SITUATIONS, "300,uniform,20,1,10,5,5.0")
    folder = write_run(tmp_path, constant(0.5), situations=rows)
    message = refusal(capsys, str(tmp_path))
    assert "situations.csv, line 2: map 20, but by run.json the ranks are 0 to 19" in message
    change_description(folder, situation={"target": 20})
    message = refusal(capsys, str(tmp_path))
    assert "situations.csv, line 1: column map, but run.json's situation has target" in message
    change_description(folder, situation={"map{.x}": 20, "target": 20})  # a name of one's own
    table = folder / "situations.csv"
    table.write_text(table.read_text().replace("map", "map{.x}"))
    assert "line 2: map{.x} 20, but by run.json" in refusal(capsys, str(tmp_path))


def test_a_run_without_evaluations_is_noted(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    folder = write_run(tmp_path, {}, seed=1)
    (folder / "evaluations.csv").unlink()
    (folder / "metrics.csv").write_text("update,frames,seconds,loss\n10,40960,5.0,nan\n")
    table = only_table(tmp_path)
    assert line(table, "impala", "train")["seeds"] == 1
    assert table.notes == ("IMPALA, seed 1: no evaluation yet; not counted.",)
    assert "Updates reached: 10 to 300; frames: 40,960 to 1,228,800." in grids.caption(table)


def test_a_missing_level_is_noted(tmp_path: Path) -> None:
    folder = write_run(tmp_path, constant(0.5))
    path = folder / "evaluations.csv"
    kept = [line for line in path.read_text().splitlines() if ",rare," not in line]
    path.write_text("\n".join(kept) + "\n")
    table = only_table(tmp_path)
    assert table.notes == ("IMPALA, seed 0: no evaluation of rare; not counted there.",)
    assert "| IMPALA | 1/3 | 0.50 |" in markdown.markdown(table)


def test_runs_are_found_through_links(tmp_path: Path) -> None:
    """Once each, and links that lead back do no harm."""
    write_run(tmp_path / "elsewhere", constant(0.5), condition="impala")
    write_run(tmp_path / "here", constant(0.5), condition="vmpo")
    (tmp_path / "here" / "linked").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "back").symlink_to(tmp_path)
    found = results.load_runs([tmp_path / "here"])
    assert sorted(run.description.condition for run in found) == ["impala", "vmpo"]
    assert len(results.load_runs([tmp_path, tmp_path / "here"])) == 2


def test_runs_of_an_interrupted_unpacking_are_left_out(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / ".unpacking-x"):
        write_run(folder, constant(0.5))
    assert len(results.load_runs([tmp_path])) == 1


def test_a_folder_that_cannot_be_read_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path, constant(0.5))
    closed = tmp_path / "closed"
    closed.mkdir()
    scandir = os.scandir

    def refuse(path: Any) -> Any:
        if Path(path) == closed:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(UserError, match="closed: Permission denied"):
        results.load_runs([tmp_path])
