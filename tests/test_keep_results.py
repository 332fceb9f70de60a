"""The record: what `scripts/keep_results.py` takes into it; it is read as run folders are."""

import gzip
import json
from pathlib import Path

import keep_results
import pandas as pd
import pytest
import torch
from run_folders import (
    SITUATIONS,
    change_description,
    constant,
    gridworld,
    level,
    write_external,
    write_run,
)

from zipf import report
from zipf.errors import UserError
from zipf.experiments.building import checkpoint
from zipf.experiments.records import record
from zipf.experiments.records.record import Record
from zipf.experiments.records.results import Run, load_run, load_runs
from zipf.experiments.reporting import draw_matplotlib

METRICS = (
    "update,frames,seconds,metric,value\n100,409600,250.0,episode_length,12.5\n"
    "100,409600,250.0,value,0.1\n200,819200,500.0,value,nan\n"
)


def run(root: Path, seed: int = 0, **described: object) -> Path:
    """A finished run."""
    rows = (f"{SITUATIONS},visits", "300,rare,1,1,10,2,2.0,7", "0,rare,1,1,10,0,0.0,0")
    baselines = {"rare": level("rare", "gridworld/rare", by_rank={"map": [0.25, 0.5]}, chance=0.3)}
    levels = [baselines.get(one["level_kind"], one) for one in gridworld()]
    folder = write_run(
        root, constant(0.5), seed=seed, situations=rows, levels=levels, resumed=[], **described
    )
    (folder / "metrics.csv").write_text(METRICS)
    return folder


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "results"
    folder.mkdir()
    monkeypatch.setattr(keep_results, "RESULTS", folder)
    return folder


def kept(results: Path, *folders: Path) -> Path:
    """A record of these runs; returns its folder."""
    found = Record()
    for folder in folders:
        keep_results.keep(found, folder)
    record.write(results, found)
    return results


def assert_same(one: Run, other: Run) -> None:
    """Two runs in different places, but for situations outside the window."""
    assert one.description == other.description
    assert one.settings == other.settings
    assert {"run_root": "runs", **one.options} == {"run_root": "runs", **other.options}
    assert one.situation_names == other.situation_names
    pd.testing.assert_frame_equal(one.evaluations, other.evaluations)
    inside = one.situations[one.situations["update"] > 0].reset_index(drop=True)
    pd.testing.assert_frame_equal(inside, other.situations)
    assert (one.updates, one.frames, one.seconds) == (other.updates, other.frames, other.seconds)


def test_runs_are_read_from_a_record_as_from_their_folders(
    tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [
        run(tmp_path),
        run(tmp_path, 1, row={"title": "1.0", "order": None, "colour": None, "line": "solid"}),
        write_run(
            tmp_path,
            {100: (0.1, 0.2, 0.3, 0.4)},
            experiment="playroom",
            levels=[*gridworld(), level("fresh", "x", 2.0)],
            situation={"toy": 4},
            situations=("update,level_kind,toy,episodes,successes,return_sum", "100,rare,3,5,,1.5"),
            environment={"size": [2, 3], "looks": None, "backend": "null"},
            success=False,
        ),
        write_external(tmp_path, constant(0.25), seed=2),
    ]
    kept(results, *folders)
    before, after = load_runs(folders), load_runs([results])
    assert len(before) == len(after) == 4
    for one, other in zip(before, after, strict=True):
        assert other.folder.relative_to(results) == one.folder.relative_to(tmp_path)
        assert_same(one, other)
    (only,) = load_runs([results / "gridworld" / "impala" / "seed1"])
    assert_same(load_run(folders[1]), only)
    assert len(load_runs([results / "gridworld", results])) == 4
    (tmp_path / "link").symlink_to(results / "gridworld")
    (results / "gridworld/impala").mkdir(parents=True)  # as that of a run with weights
    monkeypatch.chdir(results / "gridworld/impala")
    for folder, number in ((".", 2), ("..", 2), ("seed1", 1), (tmp_path / "link", 2)):
        assert [len(one.evaluations) for one in load_runs([folder])] == [9] * number
    metrics = pd.read_csv(results / "metrics.csv.gz", keep_default_na=False)
    of_one = metrics[metrics["run"] == "gridworld/impala/seed0"].drop(columns="run")
    assert of_one.to_csv(index=False) == METRICS


def test_a_further_run_leaves_the_rows_of_others_as_they_are(tmp_path: Path, results: Path) -> None:
    first, second = run(tmp_path), run(tmp_path, 1)
    alone = {path.name: path.read_bytes() for path in kept(results, first).iterdir()}
    both = record.read(results)
    keep_results.keep(both, second)
    record.write(results, both)
    for name in ("evaluations.csv.gz", "metrics.csv.gz", "situations.csv.gz"):
        assert (results / name).read_bytes().startswith(alone[name])
    keep_results.keep(both, second)
    again = {path.name: path.read_bytes() for path in results.iterdir()}
    record.write(results, record.read(results))
    assert {path.name: path.read_bytes() for path in results.iterdir()} == again
    levels = pd.read_csv(results / "levels.csv.gz")
    assert levels["levels"].unique().tolist() == ["gridworld-1"]  # of both
    change_description(second, levels=gridworld({"train": 0.5}))
    keep_results.keep(both, second)
    record.write(results, both)
    one, other = load_runs([results])
    assert one.description.levels != other.description.levels
    assert other.description == load_run(second).description


def test_an_agent_of_others_takes_no_place_of_ours(tmp_path: Path, results: Path) -> None:
    theirs = write_external(
        tmp_path / "theirs", constant(0.25), name="impala", experiment="gridworld"
    )
    with pytest.raises(UserError, match="gridworld/impala/seed0: is of an agent of ours in one"):
        kept(results, run(tmp_path), theirs)


def test_scores_are_those_of_the_window(tmp_path: Path, results: Path) -> None:
    updates = {100: (0.1, 0.2, 0.3), 200: (0.3, 0.4, 0.5), 300: (0.2, 0.9, 0.1), 400: (1, 1, 1)}
    kept(results, write_run(tmp_path, updates))
    scores = keep_results.scores(load_runs([results]), results)
    assert scores.to_csv(index=False) == (
        "run,level_kind,score,evaluations,episodes,update,frames\n"
        "gridworld/impala/seed0,train,0.2,3,1000,300,1228800\n"
        "gridworld/impala/seed0,uniform,0.4,3,1000,300,1228800\n"
        "gridworld/impala/seed0,rare,0.3,3,1000,300,1228800\n"
    )


def test_weights_are_kept_if_asked_for(tmp_path: Path, results: Path) -> None:
    command = "python -m zipf.train 'run_root=/there or here' seed=0 'row.title=\"A b\"'"
    folder, found = run(tmp_path, command=command), Record()
    with pytest.raises(UserError, match=r"has no weights\.pt"):
        keep_results.keep(found, folder, weights=True)
    assert found == Record()
    learned = {"layer": torch.tensor([1.0, 1 / 3]), "count": torch.tensor(3)}
    checkpoint.save(folder / "weights.pt", {"update": 7, "weights": learned})
    name = keep_results.keep(found, folder)
    assert list(results.iterdir()) == []
    keep_results.keep(found, folder, weights=True)
    record.write(results, found)
    taken = checkpoint.load(results / name / "weights.pt")
    assert taken["update"] == 7
    assert taken["weights"]["layer"].tolist() == [1.0, 0.333984375]  # bfloat16's
    assert taken["weights"]["count"] == 3
    described = json.loads((results / name / "run.json").read_text())
    assert described["command"] == "python -m zipf.train seed=0 'row.title=\"A b\"'"
    (only,) = load_runs([results])  # once, and from the record
    assert len(only.evaluations) == 9
    assert only.settings == load_run(folder).settings
    with pytest.raises(UserError, match="weights of an earlier training; give --weights, or"):
        keep_results.keep(found, folder)


def test_a_run_that_is_damaged_is_not_kept(tmp_path: Path, results: Path) -> None:
    folder, found = run(tmp_path), Record()
    evaluations = folder / "evaluations.csv"
    evaluations.write_text(evaluations.read_text().replace(",0.5,", ",o.5,", 1))
    with pytest.raises(UserError, match=r"evaluations\.csv, line 2: column score has 'o\.5'"):
        keep_results.keep(found, folder)
    with pytest.raises(UserError, match="cannot be read"):
        keep_results.keep(found, tmp_path / "nowhere")
    begun = write_run(tmp_path, {50: (0.9, 0.9, 0.9)}, seed=7)
    with pytest.raises(UserError, match="has no evaluation in its window yet"):
        keep_results.keep(found, begun)
    assert found == Record()


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("evaluations.csv.gz", ",0.5,", ",o.5,", "line 2: column score has 'o.5'"),
        ("evaluations.csv.gz", "impala/seed0", "impala/seed9", "line 2: runs.csv.gz has no"),
        ("evaluations.csv.gz", "500.0,", "500.0,,", "line 5: 12 fields where there are 11 columns"),
        ("situations.csv.gz", ",10,2,", ",10,12,", "line 2: 12 successes of 10 episodes"),
        ("levels.csv.gz", ",reference,", ",baseline,", "line 1: no column reference"),
        (
            "levels.csv.gz",
            ",0.25,",
            ",x,",
            "references.chance.by_rank.map.0: Input should",
        ),
        ("runs.csv.gz", "gridworld-1", "gridworld-2", "has levels that levels.csv.gz lacks"),
        ("runs.csv.gz", "gridworld,impala,", "gridworld,0.5,", "seed0: condition: Input should"),
        ("options.csv.gz", ",impala,", ",vmpo,", "options of another run than run.json"),
        ("metrics.csv.gz", ",409600,", ",x,", "line 2: column frames has 'x'"),
    ],
)
def test_damage_is_named_in_one_line(
    tmp_path: Path, results: Path, name: str, old: str, new: str, told: str
) -> None:
    path = kept(results, run(tmp_path)) / name
    text = gzip.decompress(path.read_bytes()).decode()
    assert old in text
    path.write_bytes(gzip.compress(text.replace(old, new).encode()))
    with pytest.raises(UserError) as error:
        load_runs([results])
    assert str(error.value).startswith(results.as_posix())
    assert "\n" not in str(error.value)
    assert told in str(error.value)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(UserError, match=rf"{name}: is (damaged|missing)"):
        load_runs([results])


def test_the_record_is_written_from_its_tables_as_from_run_folders(
    tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And differs as soon as a score there does."""
    monkeypatch.setattr(draw_matplotlib, "draw", lambda *_: {})
    folders = [run(tmp_path / "runs"), run(tmp_path / "runs", 1)]
    kept(results, *folders)

    def written(folder: Path) -> list[str]:
        page = tmp_path / "record.md"
        report.report([folder], tmp_path / "report", "own", record=page)
        return page.read_text(encoding="utf-8").splitlines()[1:]  # the first is the command

    before = written(tmp_path / "runs")
    assert any(line.startswith("| IMPALA | 2/3 | 0.50 ± 0.00 |") for line in before)
    assert written(results) == before
    evaluations = folders[0] / "evaluations.csv"
    evaluations.write_text(evaluations.read_text().replace(",0.5,", ",0.9,"))
    found = record.read(results)
    keep_results.keep(found, folders[0])
    record.write(results, found)
    assert written(results) == written(tmp_path / "runs") != before
