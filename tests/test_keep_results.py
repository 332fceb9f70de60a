"""What `scripts/keep_results.py` takes into the record."""

from pathlib import Path

import keep_results
import pytest
from run_folders import constant, write_run

from zipf.errors import UserError
from zipf.experiments.records.results import load_run

METRICS = "update,frames,seconds\n300,1228800,750.0\n"


def run(root: Path) -> Path:
    rows = ("update,level_kind,map,target,episodes,successes,return_sum", "300,rare,1,1,10,2,2.0")
    folder = write_run(root, constant(0.5), situations=rows, resumed=[])
    (folder / "metrics.csv").write_text(METRICS)
    return folder


def test_a_run_is_kept_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keep_results, "RESULTS", tmp_path / "results")
    kept = load_run(keep_results.keep(run(tmp_path)))
    assert kept.notes == ()
    assert kept.evaluations["score"].tolist() == [0.5] * 9
    assert len(kept.situations) == 1


def test_weights_are_kept_if_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keep_results, "RESULTS", tmp_path / "results")
    folder = run(tmp_path)
    with pytest.raises(UserError, match=r"has no weights\.pt"):
        keep_results.keep(folder, weights=True)
    (folder / "weights.pt").write_bytes(b"weights")
    assert not (keep_results.keep(folder) / "weights.pt").exists()
    assert (keep_results.keep(folder, weights=True) / "weights.pt").read_bytes() == b"weights"


def test_a_run_that_is_damaged_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keep_results, "RESULTS", tmp_path / "results")
    folder = run(tmp_path)
    evaluations = folder / "evaluations.csv"
    evaluations.write_text(evaluations.read_text().replace(",0.5,", ",o.5,", 1))
    with pytest.raises(UserError, match=r"evaluations\.csv, line 2: column score has 'o\.5'"):
        keep_results.keep(folder)
    with pytest.raises(UserError, match="cannot be read"):
        keep_results.keep(tmp_path / "nowhere")
    assert not (tmp_path / "results").exists()
