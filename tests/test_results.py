"""RESULTS.md is what its command makes of the files in results/."""

from pathlib import Path

from zipf.report import report

ROOT = Path(__file__).parent.parent


def test_the_record_is_up_to_date(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    record = tmp_path / "RESULTS.md"
    report([Path("results")], output=tmp_path / "report", record=record)
    ours = (ROOT / "RESULTS.md").read_text().splitlines()
    assert record.read_text().splitlines()[1:] == ours[1:]
    assert "make results" in ours[0] or "zipf.report results" in ours[0]
