"""Draws the pictures of docs/learning-the-tail.md from the runs in results/.

    python scripts/draw_tail_pictures.py

Of each of `TASKS`, every agent of the record whose configuration is among its `agents`: its scores
against the frames that it has learned from, which begin with those of the run that it began with,
in `docs/tail_<name>_learning.png`, and its success against how rarely training draws a situation,
in `docs/tail_<name>_rarity.png`.
"""

import argparse
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt
import number_tables
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zipf.envs import baseline, distributions, split
from zipf.experiments.records.results import Run, load_runs
from zipf.experiments.records.wording import KIND_NAMES
from zipf.experiments.reporting.statistics import wilson_interval
from zipf.protocol import PAPER_KINDS

ROOT = Path(__file__).parent.parent


class Agent(NamedTuple):
    """How an agent is drawn; colours of Tol 2021, vibrant, which are seen on white and on black.

    Attributes:
        label: of one that the table of the page has not, which has the names of the others.
    """

    colour: str
    line: str = "-"
    label: str = ""


class Task(NamedTuple):
    """Envs that agents are drawn in.

    Attributes:
        name: of the pictures.
        split: what is trained on, and its levels.
        experiment: the folder of results/.
        agents: by folder in that.
        baseline: a scripted policy whose score is drawn.
        share: of the training episodes that each of some situations has.
    """

    name: str
    split: str
    experiment: str
    agents: dict[str, Agent]
    baseline: str
    share: Callable[[pd.DataFrame], NDArray[np.float64]]


def of_map_and_target(situations: pd.DataFrame) -> NDArray[np.float64]:
    """The shares of situations of the gridworld."""
    law = distributions.zipfian(20, 2)
    return law[situations["map"]] * law[situations["target"]]


def of_target(situations: pd.DataFrame) -> NDArray[np.float64]:
    """The shares of what is asked for in finding, whatever else is there."""
    return distributions.zipfian(50, 3)[situations["target"]]


def of_lifted(situations: pd.DataFrame) -> NDArray[np.float64]:
    """The same in lifting: any of three toys, which are drawn without replacement."""
    law = distributions.zipfian(50, 3)
    second = law[:, None] * law / (1 - law)[:, None]  # [first, second]
    np.fill_diagonal(second, 0.0)
    pairs = second / (1 - law[:, None] - law)  # the chance of a third is this times the law
    third = law * (pairs.sum() - pairs.sum(0) - pairs.sum(1))
    return ((law + second.sum(0) + third) / 3)[situations["target"]]


TASKS = [
    Task(
        "gridworld",
        "gridworld",
        "gridworld_compact",
        {
            "impala_mlp": Agent("#997700"),
            "impala_mlp,network=comparing,network.comparison=given": Agent(
                "#0077bb", label="IMPALA + MLP, given comparison"
            ),
            "impala,network=comparing,precision=bfloat16,network.comparison=given": Agent(
                "#33bbee", "--", "IMPALA, given comparison"
            ),
            "impala_given_augmented": Agent("#ee7733", "-."),
            "impala_comparing_hindsight,precision=bfloat16": Agent("#ee3377"),
            "impala_comparing_augmented,precision=bfloat16,"
            "pretrained.run=gridworld_compact_impala_comparing_hindsight,precision=bfloat16,"
            "collector.num_envs=64,collector.unroll_length=64": Agent("#cc3311", "--"),
            "imitation_comparing_augmented,precision=bfloat16": Agent("#009988"),
        },
        "generalist",
        of_map_and_target,
    ),
    Task(
        "finding",
        "playroom_find",
        "playroom_find_compact",
        {
            "impala-network_film": Agent("#997700"),
            "supervised-network_film": Agent("#0077bb"),
            "names": Agent("#009988"),
            "told": Agent("#cc3311"),
        },
        "blind",
        of_target,
    ),
    Task(
        "lifting",
        "playroom_lift",
        "playroom_lift_compact",
        {
            "impala,network=film": Agent("#997700"),
            "imitation": Agent("#0077bb"),
            "matched": Agent("#cc3311"),
            "matched_settled": Agent("#ee7733"),
            "imitation_matching": Agent("#009988"),
        },
        "blind",
        of_lifted,
    ),
]
BINS = 8
"""Of the shares of situations, equal on a logarithmic axis."""


def main() -> None:
    """Writes the pictures."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    plt.rcParams.update(
        {
            "font.family": "DejaVu Sans",
            "font.size": 8,
            "lines.linewidth": 1.3,
            "lines.markersize": 3,
        }
    )
    grey = dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), "0.5")
    plt.rcParams.update(
        {**grey, "axes.edgecolor": "0.5", "legend.frameon": False}
    )  # seen on white and on black
    for task in TASKS:
        runs: dict[str, list[Run]] = {}
        for run in load_runs([ROOT / "results" / task.experiment]):
            runs.setdefault(run.folder.parent.name, []).append(run)
        save(learning(task, runs), f"tail_{task.name}_learning.png")
        save(rarity(task, runs), f"tail_{task.name}_rarity.png")


def label(task: Task, name: str) -> str:
    """An agent's name in the page's table, or its own where that has none."""
    tables = number_tables.TASKS.values()
    titles = {one.folder: one.title for table in tables for one in table.agents}
    text = titles.get(f"{task.experiment}/{name}", task.agents[name].label).replace("`", "")
    return textwrap.fill(text, 44)


def learning(task: Task, runs: dict[str, list[Run]]) -> Figure:
    """Scores on the three levels against millions of frames, a line for each run, which begins at
    the frames of the run that it began with."""
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 3.5), sharey=True, layout="constrained")
    for axis, kind in zip(axes, PAPER_KINDS, strict=True):
        for name, agent in task.agents.items():
            for k, run in enumerate(runs[name]):
                scores = run.mean_scores(run.description.levels_of(kind))
                frames = scores["frames"] + run.frames_before
                (drawn,) = axis.plot(frames / 1e6, scores["score"], agent.line, color=agent.colour)
                drawn.set_label(label(task, name) if k == 0 else "")
        finish(axis, task, kind, KIND_NAMES[kind])
        axis.set_xlabel("Million frames")
    axes[0].set_ylabel("Score")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def rarity(task: Task, runs: dict[str, list[Run]]) -> Figure:
    """Success on the uniform level against the share of training episodes that a situation has."""
    figure, axis = plt.subplots(figsize=(6.4, 3.9), layout="constrained")
    for name, agent in task.agents.items():
        rows = pd.concat([run.situations for run in runs[name] if len(run.situations)])
        rows = rows[rows["level_kind"] == "uniform"]
        share = task.share(rows)
        edges = np.geomspace(share.min() * 0.999, share.max() * 1.001, BINS + 1)
        bins = pd.Series(np.digitize(share, edges) - 1, index=rows.index)
        sums = rows.groupby(bins)[["episodes", "successes"]].sum()
        middles = np.sqrt(edges[sums.index] * edges[sums.index + 1])
        low, high = wilson_interval(sums["successes"], sums["episodes"])
        rate = sums["successes"] / sums["episodes"]
        axis.plot(
            middles, rate, agent.line, color=agent.colour, label=label(task, name), marker="o"
        )
        axis.fill_between(middles, low, high, color=agent.colour, alpha=0.15, linewidth=0)
    axis.set_xscale("log")
    axis.invert_xaxis()
    finish(axis, task, "uniform", "Success on the uniform level")
    axis.set_xlabel("Share of the training episodes that a situation has")
    axis.set_ylabel("Success")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def finish(axis: Axes, task: Task, kind: str, title: str) -> None:
    """Adds what all panels of a kind of level have."""
    (level,) = split(task.split).levels(kind)
    known = baseline(task.baseline, level)
    assert known is not None
    axis.axhline(
        known.score,
        color="0.5",
        linestyle="dotted",
        linewidth=1.2,
        label=task.baseline.capitalize(),
    )
    axis.set_title(title, fontsize=9)
    axis.set_ylim(-0.02, 1.02)
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, name: str) -> None:
    """Writes a picture into docs/."""
    path = ROOT / "docs" / name
    figure.savefig(path, dpi=160, transparent=True, pil_kwargs={"optimize": True})
    print(f"Wrote {path.name}: {path.stat().st_size / 1024:.0f} KB")


if __name__ == "__main__":
    main()
