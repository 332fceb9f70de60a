"""The record and the page on result files agree with the files."""

import re
from pathlib import Path

import keep_results
import pandas as pd
import pytest

from zipf.experiments.building import loading, run_folder
from zipf.experiments.evaluation.evaluator import scores
from zipf.experiments.evaluation.trained import evaluate_agent, load_agent
from zipf.experiments.records.results import load_runs
from zipf.experiments.reporting import draw_matplotlib
from zipf.experiments.reporting.claims import CLAIM_COLUMNS
from zipf.experiments.reporting.scores import CSV_COLUMNS
from zipf.experiments.reporting.seed_statistics import STATISTICS_COLUMNS
from zipf.report import report

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def documented(heading: str) -> list[str]:
    """The names in the first column of the tables under a heading."""
    text = PAGE.split(f"### `{heading}`\n")[1].split("\n#")[0]
    rows = re.findall(r"^\| (.*?) \|", text, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


@pytest.mark.slow
def test_the_record_is_up_to_date(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(draw_matplotlib, "draw", lambda *_: {})  # the record has none
    record = tmp_path / "record.md"
    report([Path("results")], output=tmp_path / "report", window="own", record=record, claims=True)
    ours = (ROOT / "docs" / "record.md").read_text().splitlines()
    assert record.read_text().splitlines()[1:] == ours[1:]
    assert "`python -m zipf.report results window=own claims=true record=docs/record.md`" in ours[0]
    scores_of_runs = keep_results.scores(load_runs(["results"]), Path("results"))
    assert scores_of_runs.to_csv(index=False) == Path("results/scores.csv").read_text()


KEPT = sorted(path.parent for path in ROOT.glob("results/*/*/*/weights.pt"))


@pytest.mark.slow
@pytest.mark.parametrize("folder", KEPT, ids=lambda folder: "/".join(folder.parts[-3:]))
def test_agents_whose_weights_are_kept_score_as_they_did(folder):
    """Within 0.15: the standard error of 100 episodes is at most 0.05, of 1,000 0.016. Where a
    score is of thirty tasks, each is played in 20 episodes."""
    trained = load_agent(folder, "cpu")
    (run,) = load_runs([folder])
    episodes = 20 if run.description.split == "labyrinth_forward" else 100
    results = evaluate_agent(
        trained.config, trained.agent, episodes=episodes, num_envs=episodes, seed=5
    )
    found = scores(results)
    kinds = set(run.evaluations["level_kind"])
    assert kinds <= found.keys()
    for kind in kinds:
        recorded = run.mean_scores(run.description.levels_of(kind)).set_index("update")["score"]
        assert found[kind] == pytest.approx(recorded[trained.update], abs=0.15)


def test_every_column_is_documented(trained):
    config = loading.load(trained)
    evaluations = pd.read_csv(config.folder / "evaluations.csv")
    assert documented("evaluations.csv") == list(evaluations.columns)
    situations = pd.read_csv(config.folder / "situations.csv")
    of_ranks = {"map", "target", "visits_map", "visits_target"}
    assert of_ranks <= set(situations.columns)
    assert documented("situations.csv") == [c for c in situations.columns if c not in of_ranks]
    assert documented("report.csv") == list(CSV_COLUMNS)
    assert documented("claims.csv") == list(CLAIM_COLUMNS)
    assert documented("statistics.csv") == list(STATISTICS_COLUMNS)
    metrics = pd.read_csv(config.folder / "metrics.csv")
    assert documented("metrics.csv")[:5] == list(metrics.columns)
    named = [name for name in documented("metrics.csv")[5:] if name != "learning_rate_factor"]
    assert set(named) <= set(metrics["metric"])


def test_every_field_of_run_json_is_documented(tmp_path):
    config = loading.load(["experiment=demo", f"run_root={tmp_path}"])
    config.folder.mkdir(parents=True)
    run_folder.write_description(config, {"map": 5, "target": 5}, [], resumed_at=None)
    written = set(pd.read_json(config.folder / "run.json", typ="series").index)
    assert set(documented("run.json")) == written


def test_the_example_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    exec(compile(code, "docs/results.md", "exec"), {"__name__": "__main__"})
    assert "level_kind" in capsys.readouterr().out
