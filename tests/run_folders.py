"""Run folders made by hand, as training and `zipf.evaluate.record` write them, and their tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml
from matplotlib.figure import Figure

from zipf import envs, report
from zipf.experiments.options import command_line, config_files
from zipf.experiments.records import results
from zipf.experiments.reporting import (
    charts,
    draw_matplotlib,
    panels,
    seed_statistics,
    tables,
    windows,
)

CHANCE = {"train": 0.0324, "uniform": 0.0477, "rare": 0.0859}
EVALUATIONS = "update,frames,seconds,level_kind,level,episodes,score,success,return,length"
SITUATIONS = "update,level_kind,map,target,episodes,successes,return_sum"
CONFIG = "agent:\n  learning_rate: 0.001\n"
BLIND = {"train": 0.6265, "uniform": 0.05, "rare": 0.0}
CONDITIONS = command_line.choices("condition")
ROWS = {name: config_files.find("condition", name).values["row"] for name in CONDITIONS}
Scores = Mapping[int, Sequence[float]]  # of every level, by update


def row_of(condition: str) -> dict[str, Any]:
    """The row of a condition, its title with what is added to a known one."""
    known, *added = condition.split(",")
    row = ROWS.get(known, {"title": known, "order": None, "colour": None, "line": "solid"})
    return {**row, "title": ", ".join([row["title"], *added])}


def level(
    kind: str,
    name: str,
    weight: float = 1.0,
    chance: float | None = None,
    episodes: Any = None,
    by_rank: Mapping[str, Sequence[float]] | None = None,
    normalised: bool = False,
    **baselines: float,
) -> dict[str, Any]:
    """A level as `run.json` describes it; `references` other than chance are exact."""
    known = {name: baseline(score) for name, score in baselines.items()}
    if chance is not None:
        known["chance"] = baseline(chance, episodes, by_rank)
    return {
        "level_kind": kind,
        "level": name,
        "weight": weight,
        "normalised": normalised,
        "references": known,
    }


def baseline(
    score: float, episodes: Any = None, by_rank: Mapping[str, Sequence[float]] | None = None
) -> dict[str, Any]:
    """A baseline as `run.json` describes it."""
    return {"score": score, "episodes": episodes, "by_rank": by_rank or {}}


def gridworld(chance: Mapping[str, float | None] = CHANCE) -> list[dict[str, Any]]:
    """The levels of a gridworld."""
    return [
        level(kind, f"gridworld/{kind}", chance=chance.get(kind), blind=BLIND[kind])
        for kind in envs.PAPER_KINDS
    ]


def write_run(
    root: Path,
    scores: Scores,
    *,
    condition: str = "impala",
    seed: int = 0,
    situations: Sequence[str] = (),
    settings: str | None = CONFIG,
    normalised: float = 1.0,
    success: bool = True,
    **description: Any,
) -> Path:
    """A run folder; `scores` are in the order of its levels, train, uniform and rare by default.

    A return is `normalised` times its score.
    """
    described = {
        "experiment": "gridworld",
        "condition": condition,
        "row": row_of(condition),
        "seed": seed,
        "split": "gridworld",
        "spread": "seeds",
        "command": f"python -m zipf.train experiment=gridworld seed={seed}",
        "commit": "0123456789abcdef",
        "version": "0.1.0",
        "torch": "2.5.0",
        "device": "cpu",
        "precision": "float32",
        "window": [100, 300],
        "num_updates": 300,
        "started": "2024-05-01T10:00:00+00:00",
        "levels": gridworld(),
        "situation": {"map": 20, "target": 20},
        "environment": {"num_maps": 20, "num_objects": 20},
        "paper": "gridworld",
        "external": None,
        **description,
    }
    folder = root / described["experiment"] / condition / f"seed{seed}"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps(described))
    lines = [EVALUATIONS]
    for update, of_levels in scores.items():
        for one, score in zip(described["levels"], of_levels, strict=True):
            lines.append(
                f"{update},{update * 4096},{update * 2.5},{one['level_kind']},{one['level']},"
                f"1000,{score},{score if success else ''},{score * normalised},17.5"
            )
    (folder / "evaluations.csv").write_text("\n".join(lines) + "\n")
    if situations:
        (folder / "situations.csv").write_text("\n".join(situations) + "\n")
    if settings is not None:
        own = {name: described[name] for name in ("experiment", "condition", "seed")}
        worlds = {"split": described["split"], **described["environment"]}
        options = {**own, "environment": worlds, "schedule": {}}
        (folder / "config.yaml").write_text(settings + yaml.safe_dump(options))
    return folder


def write_external(root: Path, scores: Scores, *, name: str = "PPO", **changes: Any) -> Path:
    """The folder of an agent from outside the package."""
    return write_run(
        root,
        scores,
        condition=name,
        settings=None,
        **{
            "experiment": "external",
            "paper": None,
            "window": None,
            "command": None,
            "commit": None,
            "torch": None,
            "device": None,
            "precision": None,
            "external": {"name": name, "env_options": {"image": [63, 63, 3], "actions": 8}},
            **changes,
        },
    )


def constant(score: float, levels: int = 3) -> Scores:
    """The same score at every update and level."""
    return {update: (score,) * levels for update in (100, 200, 300)}


def change_description(folder: Path, **changes: Any) -> None:
    """Change fields of a run's `run.json`."""
    described = json.loads((folder / "run.json").read_text()) | changes
    (folder / "run.json").write_text(json.dumps(described))


def only_table(folder: Path, window: str | None = None) -> tables.ScoreTable:
    """The one table of the runs in a folder."""
    chosen = windows.parse_window(window) if window else None
    (table,) = tables.score_tables(results.load_runs([folder]), chosen)
    return table


def picture_of(table: tables.ScoreTable, kind: str) -> Figure:
    """The picture of a table of one of `zipf.experiments.reporting.markdown.PLOT_KINDS`."""
    found = charts.charts(seed_statistics.seed_statistics(table), panels.looks_of([table]))
    return draw_matplotlib.picture(next(chart for chart in found if chart.kind == kind))


def labels(figure: Figure) -> list[str]:
    """The labels at the ends of the curves in a picture, unwrapped."""
    return [text.get_text().replace("\n", " ") for axis in figure.axes for text in axis.texts]


def line(table: tables.ScoreTable, row: str, column: str) -> pd.Series:
    """The score of a row, by its key, on a level kind or on a group of levels."""
    scores = pd.concat([table.scores, table.group_scores])
    (found,) = scores[(scores["row"] == row) & (scores["column"] == column)].iloc
    return found


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What the command says when it refuses; asserts one line and exit code 2."""
    assert report.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err
