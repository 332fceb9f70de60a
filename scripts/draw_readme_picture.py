"""Draws docs/gridworld.png, the picture at the head of the documentation.

    python scripts/draw_readme_picture.py

Every number in it is computed from the environment: the distributions, the probabilities written
into them, the map and what the agent sees.
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.patches import ConnectionPatch, Rectangle
from numpy.typing import NDArray

from zipf import envs
from zipf.envs import distributions, make, split

OUTPUT = Path(__file__).parent.parent / "docs" / "gridworld.png"
SPLIT = split("gridworld")
SITUATION = {"map": 0, "target": 0}
VIEW = 7  # cells, each way
MARGIN = 54  # pixels around the board in the environment's frames

INK, QUIET, AMBER = "#737a87", "#7d8492", "#e69f00"  # greys that can be read on white and on black
DARK = "#1f2430"
# Light to dark in one direction, so that it reads alike with any colour vision and in grey.
COLOURS = plt.get_cmap("YlGnBu")
NEVER = "#80808020"


def main() -> None:
    """Writes the picture."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    plt.rcParams.update(
        {
            "font.family": "DejaVu Sans",
            "font.size": 9,
            "text.color": INK,
            "axes.labelcolor": QUIET,
            "axes.edgecolor": QUIET,
            "xtick.color": QUIET,
            "ytick.color": QUIET,
        }
    )
    figure = plt.figure(figsize=(8.4, 6.44), dpi=200)
    draw_distributions(figure)
    draw_env(figure)
    OUTPUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUTPUT, transparent=True, pil_kwargs={"optimize": True})
    print(f"Wrote {OUTPUT.name}: {OUTPUT.stat().st_size / 1024:.0f} KB")


def probabilities(level: str) -> NDArray[np.float64]:
    """How often each situation is drawn: float64 [maps, targets]."""
    distribution = distributions.by_name(level.partition("/")[2])
    sizes = make(level).get_wrapper_attr("situation")
    return np.outer(distribution(sizes["map"]), distribution(sizes["target"]))


def draw_distributions(figure: plt.Figure) -> None:
    """The three levels side by side, on one scale."""
    tables = {kind: probabilities(SPLIT.levels(kind)[0].name) for kind in envs.PAPER_KINDS}
    train = tables["train"]
    norm = LogNorm(train.min(), train.max())
    seldom = train[tables["rare"] > 0]
    uniform, rare = tables["uniform"], tables["rare"]
    captions = {
        "train": f"all {len(seldom)} rare situations: 1 episode in {1 / seldom.sum():,.0f}",
        "uniform": f"{uniform.size} situations, 1 in {1 / uniform.max():.0f} each",
        "rare": f"{len(seldom)} situations, 1 in {1 / rare.max():.0f} each",
    }
    titles = {"train": "Train: Zipfian", "uniform": "Test: uniform", "rare": "Test: rare"}
    for i, (kind, table) in enumerate(tables.items()):
        axes = figure.add_axes((0.065 + 0.292 * i, 0.61, 0.255, 0.3326))
        shown = np.ma.masked_equal(table, 0)
        axes.add_patch(Rectangle((-0.5, -0.5), *table.shape, fc=NEVER, ec="none", zorder=-1))
        image = axes.imshow(shown, cmap=COLOURS, norm=norm)
        axes.set_title(titles[kind], fontsize=11, fontweight="bold", pad=7)
        axes.set_xlabel("target, by frequency rank")
        axes.text(0.5, -0.235, captions[kind], transform=axes.transAxes, ha="center", va="top")
        axes.set_xticks([0, 5, 10, 15, 19])
        axes.set_yticks([0, 5, 10, 15, 19])
        axes.set_xticks(np.arange(0.5, table.shape[1] - 1), minor=True)
        axes.set_yticks(np.arange(0.5, table.shape[0] - 1), minor=True)
        axes.grid(which="minor", color="#a0a0a060", lw=0.25)
        axes.tick_params(length=2, labelsize=8)
        axes.tick_params(which="minor", length=0)
        if i == 0:
            axes.set_ylabel("map, by frequency rank")
    first, _, last = figure.axes
    note(first, f"{100 * train[0, 0]:.0f} % of episodes", (0, 0), (4.4, 1.2))
    note(first, f"1 episode in {1 / train[-1, -1]:,.0f}", (19, 19), (5.6, 14.6))
    last.text(8, 8, "never", ha="center", va="center", color=QUIET)

    bar = figure.add_axes((0.925, 0.61, 0.013, 0.3326))
    scale = figure.colorbar(image, cax=bar)
    scale.outline.set_visible(False)
    ticks = [1e-5, 1e-4, 1e-3, 1e-2, 1e-1]
    scale.set_ticks(ticks, labels=["0.001 %", "0.01 %", "0.1 %", "1 %", "10 %"])
    scale.ax.minorticks_off()
    scale.ax.tick_params(length=2, labelsize=7)


def note(axes: Axes, text: str, cell: tuple[float, float], at: tuple[float, float]) -> None:
    """Words with a line to the cell that they are about."""
    axes.annotate(
        text,
        xy=cell,
        xytext=at,
        va="center",
        fontsize=8.5,
        color=DARK,
        arrowprops={"arrowstyle": "-", "color": DARK, "lw": 0.8},
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85},
    )


def draw_env(figure: plt.Figure) -> None:
    """The most frequent situation: the map with the agent's window marked, and what it shows."""
    env = make(SPLIT.train[0].name, render_mode="rgb_array")
    observation, _ = env.reset(seed=0, options=SITUATION)
    maps = env.get_wrapper_attr("level").maps
    goal_row, goal_column = maps.cells[SITUATION["map"], SITUATION["target"]].tolist()
    row, column = maps.cells[SITUATION["map"], -1].tolist()
    rows, columns = maps.boards[SITUATION["map"]].shape
    board = np.asarray(env.render())[MARGIN:-MARGIN, MARGIN:-MARGIN]

    board_axes = panel(figure, (0.065, 0.03, 0.3066, 0.40), board, (columns, rows))
    board_axes.set_title("The most frequent map", fontsize=11, fontweight="bold", pad=9)
    seen = panel(figure, (0.4527, 0.03, 0.3066, 0.40), observation["image"], (VIEW, VIEW))
    seen.set_title("What the agent sees", fontsize=11, fontweight="bold", pad=9)

    half = VIEW / 2
    for side in (-1, 1):  # from the window's right corners to the image's left ones
        line = ConnectionPatch(
            (column + 0.5 + half, row + 0.5 + side * half),
            (0, half + side * half),
            board_axes.transData,
            seen.transData,
            color=QUIET,
            lw=0.8,
        )
        figure.add_artist(line)
    board_axes.annotate(
        "its most frequent target",
        xy=(goal_column + 1.05, goal_row - 0.05),
        xytext=(goal_column + 1.6, 0.55),
        va="center",
        color="white",
        fontsize=8,
        arrowprops={"arrowstyle": "-", "color": AMBER, "lw": 1.2},
        bbox={"boxstyle": "round,pad=0.2", "fc": DARK, "ec": AMBER, "lw": 0.8},
    )
    seen.add_patch(Rectangle((0, 0), 1, 1, fill=False, ec=AMBER, lw=2.5, clip_on=False))
    # Over the top of the image, so that no line runs through an object.
    seen.plot([0.5, 0.5, VIEW + 0.2], [0, -0.17, -0.17], color=AMBER, lw=1.2, clip_on=False)
    seen.text(VIEW + 0.35, -0.34, "the cue:\nfind this object", va="top")
    seen.set(xlim=(0, VIEW), ylim=(VIEW, 0))
    for text, point, height in (
        ("an object: touching\nany ends the episode,\nthe right one with\nreward 1", (6, 5.5), 5.5),
        ("the agent, always\nin the centre; moves\nin 8 directions", (4, 3.5), 2.9),
    ):
        seen.annotate(
            text,
            xy=point,
            xytext=(VIEW + 0.35, height),
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": QUIET, "lw": 0.8, "relpos": (0, 0.5)},
        )


def panel(
    figure: plt.Figure,
    where: tuple[float, float, float, float],
    image: NDArray[np.uint8],
    cells: tuple[int, int],
) -> Axes:
    """Axes that show an image and are measured in cells, (0, 0) at the top left."""
    axes = figure.add_axes(where)
    axes.imshow(image, extent=(0, cells[0], cells[1], 0), interpolation="nearest")
    axes.set_axis_off()
    return axes


if __name__ == "__main__":
    main()
