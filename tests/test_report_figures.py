"""The plots of the report: what they show, and that their text fits."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
import pandas as pd
import pytest
from conftest import PACKAGE, slow_but
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from run_folders import (
    ROWS,
    SITUATIONS,
    constant,
    gridworld,
    labels,
    level,
    only_table,
    picture_of,
    row_of,
    write_external,
    write_run,
)

from zipf import report
from zipf.experiments.reporting import markdown, statistics
from zipf.experiments.reporting.charts import rank_ticks
from zipf.experiments.reporting.draw_matplotlib import STYLE, apart
from zipf.experiments.reporting.panels import (
    COLOURS,
    OTHERS,
    TOO_NEAR,
    LineStyle,
    _distance,
    line_styles,
    looks_of,
)
from zipf.experiments.reporting.situations import (
    baseline_by_rank,
    baseline_on_uniform,
    measure_of,
    rare_ranks,
    rates,
    spans,
)
from zipf.experiments.reporting.tables import ScoreTable


def drawn(table: ScoreTable) -> list[Figure]:
    """The figures of learning curves, of ranks and of situations."""
    return [picture_of(table, kind) for kind in ("learning", "ranks", "situations")]


def legend(figure: Figure) -> list[str]:
    """The labels, unwrapped."""
    texts = [text for one in figure.legends for text in one.get_texts()]
    return [text.get_text().replace("\n", " ") for text in texts]


# --- what is measured at a rank --------------------------------------------------------------


def test_success_by_rank_by_hand(tmp_path: Path) -> None:
    first = (
        SITUATIONS,
        "50,uniform,0,0,500,500,500.0",
        "100,uniform,0,0,30,27,27.0",
        "100,uniform,0,1,20,10,10.0",
        "300,uniform,1,0,40,8,8.0",
        "300,uniform,1,1,10,0,0.0",
        "300,rare,1,1,100,5,5.0",
    )
    second = (SITUATIONS, "200,uniform,0,0,10,9,9.0", "200,uniform,1,1,10,10,10.0")
    write_run(tmp_path, constant(0.5), situations=first)
    write_run(tmp_path, constant(0.5), seed=1, situations=second)
    table = only_table(tmp_path)
    found = rates(table, ["map"])
    # Rank 0: 27/30 + 10/20 of seed 0, 9/10 of seed 1; update 50 is outside the window.
    # Rank 1: 8/40 + 0/10 of seed 0, 10/10 of seed 1.
    assert found[["row_key", "map", "episodes"]].to_numpy().tolist() == [
        ["impala", 0, 60],
        ["impala", 1, 60],
    ]
    assert found["value"].tolist() == [pytest.approx(46 / 60), pytest.approx(0.3)]
    assert rates(table, ["map", "target"])["value"].tolist() == [0.9, 0.5, 0.2, 0.5]


def test_wilson_interval() -> None:
    # Agresti and Coull (1998), The American Statistician 52(2): 0 of 10 gives (0, 0.28).
    low, high = statistics.wilson_interval(pd.Series([0, 8, 10]), pd.Series([10, 10, 10]))
    assert low.tolist() == pytest.approx([0, 0.4902, 0.7225], abs=1e-4)
    assert high.tolist() == pytest.approx([0.2775, 0.9433, 1], abs=1e-4)


RETURNS = (
    SITUATIONS,
    "100,uniform,0,0,10,,30.0",
    "100,uniform,0,1,10,,10.0",
    "200,uniform,0,0,30,,30.0",
    "300,uniform,1,1,50,,-50.0",
    "300,rare,19,19,50,,-50.0",
)


def test_ranks_have_the_same_name_in_every_figure(tmp_path: Path) -> None:
    rows = (SITUATIONS.replace("map,target", "map,cue_colour"), "300,uniform,0,1,10,5,5.0")
    write_run(tmp_path, constant(0.5), situations=rows, situation={"map": 3, "cue_colour": 4})
    _, ranks, maps = drawn(only_table(tmp_path))
    assert [axis.get_title() for axis in ranks.axes] == ["Map", "Cue colour"]
    assert maps.axes[0].get_ylabel() == "Map rank"
    assert maps.axes[0].get_xlabel() == "Cue colour rank"


def test_the_mean_return_stands_in_for_success(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5), situations=RETURNS, success=False)
    table = only_table(tmp_path)
    assert measure_of(table) == "return"
    found = rates(table, ["map"], measure="return")
    assert found["value"].tolist() == [1.4, -1.0]
    # Evaluations of rank 0: 2.0 of 20 episodes, 1.0 of 30; of rank 1: only one.
    error = (2 / 1 * ((20 / 50 * (2 - 1.4)) ** 2 + (30 / 50 * (1 - 1.4)) ** 2)) ** 0.5
    assert found["low"].iloc[0] == pytest.approx(1.4 - 1.96 * error, abs=1e-3)
    assert found["high"].iloc[0] == pytest.approx(1.4 + 1.96 * error, abs=1e-3)
    assert np.isnan(found["low"].iloc[1])
    with matplotlib.rc_context(STYLE):
        curves, ranks, heat_map = drawn(table)
        for figure in (curves, ranks, heat_map):
            assert_text_is_inside(figure)
    assert ranks.axes[0].get_ylabel() == "Mean return on the uniform level"
    assert "95 % interval (1.96 standard errors across evaluations)" in legend(ranks)
    assert "Wilson" not in " ".join(legend(ranks))
    assert "mean return by situation" in heat_map.get_suptitle()
    assert heat_map.axes[0].images[1].get_clim() == (-1.0, 1.5)


def test_one_run_without_success_is_enough(tmp_path: Path) -> None:
    with_success = (SITUATIONS, "100,uniform,0,0,30,27,27.0")
    write_run(tmp_path, constant(0.5), situations=with_success)
    assert measure_of(only_table(tmp_path)) == "success"
    write_run(tmp_path, constant(0.5), condition="r2d2", situations=RETURNS, success=False)
    assert measure_of(only_table(tmp_path)) == "return"


@pytest.mark.parametrize(
    ("count", "last", "step"), [(20, 20, 5), (301, 300, 100), (5000, 5000, 1000)]
)
def test_axes_of_many_ranks_have_round_numbers(count: int, last: int, step: int) -> None:
    ranks, words = rank_ticks(count)
    assert ranks == [1, *range(step, last + 1, step)]
    assert words == [f"{rank:.0f}" for rank in ranks]


@pytest.mark.parametrize(("normalised", "drawn"), [(1.0, True), (40.0, False)])
def test_chance_is_drawn_where_it_has_the_same_unit(
    tmp_path: Path, normalised: float, drawn: bool
) -> None:
    run = {"situations": RETURNS, "success": False, "normalised": normalised}
    write_run(tmp_path, constant(0.5), **run)
    table = only_table(tmp_path)
    for baseline in ("chance", "blind"):
        known = table.baseline(baseline)["uniform"] if drawn else None
        assert baseline_on_uniform(table, "return", baseline) == known
    figure = picture_of(table, "ranks")
    assert ("Chance, Blind" in labels(figure)) == drawn  # at 0.048 and 0.05: one line


def test_chance_is_drawn_at_each_rank_where_it_is_known(tmp_path: Path) -> None:
    levels = [
        level("train", "a"),
        level("uniform", "b", chance=0.2, by_rank={"target": [0.1, 0.3], "other": [0.2] * 9}),
        level("rare", "c", chance=0.3),
    ]
    rows = (SITUATIONS, "100,uniform,0,0,10,1,1.0", "100,uniform,1,1,10,3,3.0")
    sizes = {"map": 2, "target": 2}
    write_run(tmp_path, constant(0.5), levels=levels, situations=rows, situation=sizes)
    table = only_table(tmp_path)
    assert baseline_by_rank(table, "success", "chance") == {"target": (0.1, 0.3)}
    assert baseline_by_rank(table, "success", "blind") == {}
    figure = picture_of(table, "ranks")
    of_map, of_target = (axis.lines[-1] for axis in figure.axes)
    np.testing.assert_array_equal(of_map.get_ydata(), [0.2, 0.2])
    np.testing.assert_array_equal(of_target.get_xdata(), [1, 2])
    np.testing.assert_array_equal(of_target.get_ydata(), [0.1, 0.3])
    several = [*levels, level("uniform", "d", chance=0.2, by_rank={"target": [0.2, 0.2]})]
    write_run(tmp_path / "several", constant(0.5, 4), levels=several, situations=rows)
    assert baseline_by_rank(only_table(tmp_path / "several"), "success", "chance") == {}


def test_ranks_that_the_rare_level_does_not_choose_by_are_not_marked(tmp_path: Path) -> None:
    header = "update,level_kind,target,task,episodes,successes,return_sum"
    cells = ("300,uniform,3,4,10,5,5.0", "300,rare,45,3,10,5,5.0", "300,rare,46,4,10,5,5.0")
    sizes = {"target": 50, "task": 5}
    write_run(tmp_path, constant(0.5), situations=(header, *cells), situation=sizes)
    table = only_table(tmp_path)
    assert rare_ranks(table, "target") == [45, 46]
    assert rare_ranks(table, "task") == []


def test_rare_ranks_are_those_of_the_rare_level_whichever_they_are(tmp_path: Path) -> None:
    """Not the last fifth, and not without a gap."""
    cells = [f"100,uniform,{rank},0,10,5,5.0" for rank in range(10)]
    cells += [f"50,rare,{rank},0,10,5,5.0" for rank in (1, 2, 7)]
    rows = (SITUATIONS, *cells, "300,rare,3,0,10,5,5.0")
    sizes = {"map": 10, "target": 1}
    write_run(tmp_path, constant(0.5), situations=rows, situation=sizes)
    table = only_table(tmp_path)
    assert rare_ranks(table, "map") == [1, 2, 3, 7]
    assert spans([1, 2, 3, 7]) == [(1, 3), (7, 7)]
    figure = picture_of(table, "ranks")
    shaded = [patch for patch in figure.axes[0].patches if isinstance(patch, Rectangle)]
    assert [(one.get_x(), one.get_width()) for one in shaded] == [(1.5, 3), (7.5, 1)]


def test_all_ranks_are_shown(tmp_path: Path) -> None:
    rows = ["300,uniform,0,1,10,5,5.0"]
    rows += [f"300,rare,{m},{t},10,5,5.0" for m in range(16, 20) for t in (8, 9)]
    sizes = {"map": 20, "target": 10}
    write_run(tmp_path, constant(0.5), situations=(SITUATIONS, *rows), situation=sizes)
    _, ranks, heat_map = drawn(only_table(tmp_path))
    panel = heat_map.axes[0]
    (frame,) = (patch for patch in panel.patches if isinstance(patch, Rectangle))
    image = panel.images[0].get_array()
    assert image is not None
    assert image.shape == (20, 10)
    corners = [frame.get_y(), frame.get_y() + frame.get_height(), frame.get_x()]
    assert corners == [16.5, 20.5, 8.5]
    assert [axis.get_xlim() for axis in ranks.axes] == [(0.5, 20.5), (0.5, 10.5)]


# --- learning curves -------------------------------------------------------------------------


def test_rows_of_other_budgets_are_drawn_against_frames(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    path = write_run(tmp_path, constant(0.5), condition="r2d2") / "evaluations.csv"
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    assert figure.axes[0].get_xlabel() == "Updates"
    text = path.read_text()
    for update in (100, 200, 300):
        text = text.replace(f"{update},{update * 4096},", f"{update},{update * 1024},")
    path.write_text(text)
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    assert figure.axes[0].get_xlabel() == "Frames"
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_xdata(), [102_400, 204_800, 307_200])


def test_few_updates_have_whole_ticks(tmp_path: Path) -> None:
    write_run(tmp_path, {0: (0.1, 0.1, 0.1), 1: (0.2, 0.2, 0.2)}, window=[0, 1], num_updates=1)
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    figure.draw_without_rendering()
    axis = figure.axes[0].xaxis
    ticks = [tick for tick in axis.get_ticklocs() if tick <= 1]
    assert axis.get_major_formatter().format_ticks(ticks) == ["0", "1"]


def test_a_curve_is_the_weighted_mean_of_levels(tmp_path: Path) -> None:
    levels = [
        level("train", "a", 3.0),
        level("train", "b", 1.0),
        level("uniform", "a"),
        level("rare", "b"),
    ]
    scores = {100: (0.4, 0.8, 0.1, 0.1), 200: (0.8, 0.0, 0.1, 0.1)}
    write_run(tmp_path, scores, levels=levels)
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    curve = figure.axes[0].lines[0]
    np.testing.assert_allclose(curve.get_xdata(), [100, 200])
    np.testing.assert_allclose(curve.get_ydata(), [0.5, 0.6])


def test_an_external_agent_is_drawn_against_frames(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_external(tmp_path, {3: (0.9, 0.9, 0.9), 7: (0.3, 0.2, 0.1)})
    table = only_table(tmp_path)
    with matplotlib.rc_context(STYLE):
        figure = picture_of(table, "learning")
        assert_text_is_inside(figure)
    assert figure is not None
    axis = figure.axes[0]
    assert axis.get_xlabel() == "Frames"
    assert {"IMPALA", "PPO †"} <= set(labels(figure))
    own, external = axis.lines[:2]
    np.testing.assert_array_equal(own.get_xdata(), [409_600, 819_200, 1_228_800])
    np.testing.assert_array_equal(external.get_xdata(), [3 * 4096, 7 * 4096])
    (window,) = (patch for patch in axis.patches if isinstance(patch, Rectangle))
    assert (window.get_x(), window.get_width()) == (409_600, 819_200)
    # Rows of other numbers of frames an update have no common window in frames.
    path = write_run(tmp_path, constant(0.5), condition="r2d2") / "evaluations.csv"
    path.write_text(path.read_text().replace(",409600,", ",4096,"))
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    assert "Window of the table" not in legend(figure)


def test_the_median_of_seeds_that_were_recorded_at_other_frames(tmp_path: Path) -> None:
    for seed, score in enumerate((0.2, 0.5, 0.8)):
        scores = {count * 10 + seed: (score,) * 3 for count in (1, 2, 3)}
        write_external(tmp_path, scores, seed=seed)
    table = only_table(tmp_path)
    figure = picture_of(table, "learning")
    median = figure.axes[0].lines[0]
    np.testing.assert_array_equal(median.get_ydata(), [0.5] * 3)
    np.testing.assert_array_equal(median.get_xdata(), [11 * 4096, 21 * 4096, 31 * 4096])


# --- lines -----------------------------------------------------------------------------------


def styles_of(root: Path, conditions: Sequence[str]) -> dict[str, LineStyle]:
    for condition in conditions:
        write_run(root, constant(0.5), condition=condition)
    return line_styles(only_table(root).rows)


def test_a_condition_looks_the_same_in_any_company(tmp_path: Path) -> None:
    alone = styles_of(tmp_path / "alone", ["impala_mlp"])
    many = styles_of(tmp_path / "many", [*ROWS, "a", "b", "impala_mlp,agent.discount=0.9"])
    assert alone["impala_mlp"] == many["impala_mlp"] == LineStyle(ROWS["impala_mlp"]["colour"], ())
    assert len(set(many.values())) == len(many)
    # Those with no colour of their own get what is left.
    assert many["a"].colour in COLOURS
    assert many["r2d2_uniform_replay"].dash == (5, 1.5)


def test_a_row_without_a_colour_keeps_its_line(tmp_path: Path) -> None:
    row = row_of("mine") | {"line": "dashed"}
    write_run(tmp_path, constant(0.5), condition="mine", row=row)
    assert line_styles(only_table(tmp_path).rows)["mine"] == LineStyle(COLOURS[0], (5, 1.5))


def test_more_rows_than_styles(tmp_path: Path) -> None:
    styles = styles_of(tmp_path, [f"condition{number}" for number in range(40)])
    assert len(styles) == 40
    assert len(set(styles.values())) == 4 * len(COLOURS)


# --- text and files --------------------------------------------------------------------------

CELLS = [f"300,uniform,{m},{t},10,5,5.0" for m in range(5) for t in range(5)]


@pytest.mark.slow
def test_figures_keep_their_text_inside(tmp_path: Path) -> None:
    names = ["impala_mlp,agent.learning_rate=0.001,network=w"]
    for condition in [*ROWS, *(f"condition{number}" for number in range(4)), *names]:
        write_run(tmp_path, constant(0.5), condition=condition, situations=(SITUATIONS, *CELLS))
    with matplotlib.rc_context(STYLE):
        for figure in drawn(only_table(tmp_path)):
            assert_text_is_inside(figure)


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_a_heat_map_makes_room_for_its_titles(tmp_path: Path, count: int) -> None:
    settings = ",precision=bfloat16,collector.num_envs=2"
    for number in range(count):
        write_run(
            tmp_path,
            constant(0.5),
            experiment="demo (an experiment whose title has several lines)",
            condition=f"impala_mlp,number={number}{settings if number else ''}",
            situations=(SITUATIONS, *CELLS),
            situation={"map": 5, "target": 5},
        )
    with matplotlib.rc_context(STYLE):
        figure = picture_of(only_table(tmp_path), "situations")
        assert_text_is_inside(figure)
    assert figure is not None
    panel = figure.axes[0].get_window_extent()
    assert 0.7 < panel.width / panel.height < 1.4


def assert_text_is_inside(figure: Figure) -> None:
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


def test_situations_with_other_ranks(tmp_path: Path) -> None:
    header = "update,level_kind,row,run,task,episodes,successes,return_sum"
    rows = (header, "300,uniform,0,1,2,10,5,5.0")
    sizes = {"row": 3, "run": 3, "task": 3}
    write_run(tmp_path, constant(0.5), situations=rows, situation=sizes)
    made = report.report([tmp_path], tmp_path / "out")
    assert [path.name for path in made.files if path.suffix == ".png"] == [
        f"gridworld_{kind}.png"
        for kind in markdown.PLOT_KINDS
        if kind not in ("situations", "visits")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("format", ["pdf", "svg"])
def test_plots_in_vector_formats(tmp_path: Path, format: Literal["pdf", "svg"]) -> None:
    """The same bytes each time; they replace those of the earlier report, and it theirs."""
    write_run(tmp_path / "run", constant(0.5))
    first = [tmp_path / one for one in ("a", "b")]
    for output in first:
        assert report.main([str(tmp_path / "run"), f"output={output}", f"format={format}"]) == 0
    name = f"gridworld_learning.{format}"
    contents = [(output / name).read_bytes() for output in first]
    assert contents[0] == contents[1]
    assert contents[0].startswith({"pdf": b"%PDF", "svg": b"<?xml"}[format])
    assert f"[gridworld_learning]({name})" in (first[0] / "report.md").read_text()
    report.report([tmp_path / "run"], first[0])
    suffixes = {path.suffix for path in first[0].iterdir()}
    assert suffixes == {".csv", ".md", ".png", ".tex"}


def test_a_figure_without_data_does_not_stay_behind(tmp_path: Path) -> None:
    rows = (SITUATIONS, "300,uniform,0,1,10,5,5.0")
    write_run(tmp_path, constant(0.5), situations=rows)
    figure = tmp_path / "report/gridworld_ranks.png"
    report.report([tmp_path], tmp_path / "report")
    assert figure.exists()
    report.report([tmp_path], tmp_path / "report", window="100:200")
    assert not figure.exists()


def test_only_the_plots_of_the_earlier_report_are_removed(tmp_path: Path) -> None:
    write_run(tmp_path / "a", constant(0.5))
    write_run(tmp_path / "b", constant(0.5), environment={"num_maps": 5})
    output = tmp_path / "out"
    report.report([tmp_path], output)
    assert (output / "gridworld_num_maps_20_learning.png").exists()
    (output / "my_learning.png").write_text("")
    report.report([tmp_path / "b"], output)
    assert sorted(path.name for path in output.glob("*.png")) == [
        "gridworld_averages.png",
        "gridworld_learning.png",
        "gridworld_scores.png",
        "gridworld_time.png",
        "my_learning.png",
    ]


# --- a user's own settings -------------------------------------------------------------------


def test_figures_are_the_same_whatever_matplotlib_is_set_to(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", constant(0.5))
    theirs: dict[Any, Any] = {
        "text.usetex": True,
        "font.size": 30,
        "savefig.bbox": "tight",
        "lines.linewidth": 9,
    }
    usual = report.report([tmp_path / "runs"], tmp_path / "usual").files
    with matplotlib.rc_context(theirs):
        made = report.report([tmp_path / "runs"], tmp_path / "made").files
        assert all(matplotlib.rcParams[name] == value for name, value in theirs.items())
    pictures = [path for path in usual if path.suffix == ".png"]
    assert pictures
    for path in pictures:
        assert path.read_bytes() == (tmp_path / "made" / path.name).read_bytes()
    assert len(made) == len(usual)


@pytest.mark.parametrize(
    ("backend", "settings", "told"),
    slow_but(
        [
            ("module://matplotlib_inline.backend_inline", b"font.size: 8", ""),
            ("no", b"text.usetex: true", ""),
            ("agg", b"# caf\xe9", "error: matplotlib cannot read its settings, a matplotlibrc: "),
        ],
        ("module://matplotlib_inline.backend_inline", b"font.size: 8", ""),
    ),
)
def test_matplotlib_is_imported_whatever_it_is_set_to(
    backend: str, settings: bytes, told: str, tmp_path: Path
) -> None:
    """In another environment than the notebook's there is no `matplotlib_inline`."""
    (tmp_path / "matplotlibrc").write_bytes(settings)
    write_run(tmp_path / "runs", constant(0.5))
    variables = {"PYTHONPATH": str(PACKAGE), "MPLBACKEND": backend}
    made = subprocess.run(
        [sys.executable, "-m", "zipf.report", "runs"],
        env={**os.environ, **variables},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (told in made.stderr, bool(made.returncode)) == (True, bool(told)), made.stderr
    assert "Traceback" not in made.stderr


# --- many rows -------------------------------------------------------------------------------


def test_the_best_of_many_rows_are_in_colour_by_what_may_be_chosen_by(tmp_path: Path) -> None:
    """By validation where there is one, else by training; never by what is reported."""
    with_validation = [*gridworld(), level("validation", "v")]
    for number in range(8):
        others = (number / 10, 1 - number / 10, 1 - number / 10)
        write_run(tmp_path / "a", {200: others}, condition=f"c{number}")
        scores = {200: (*others, 1 - number / 10)}
        more = {"levels": with_validation, "experiment": "validated"}
        write_run(tmp_path / "b", scores, condition=f"c{number}", **more)
    trained, validated = (only_table(tmp_path / one) for one in "ab")
    looks = looks_of([trained, validated])
    assert looks.coloured["gridworld"] == [f"c{number}" for number in range(2, 8)]
    assert looks.rule["gridworld"] == "the 6 best by training score"
    assert looks.coloured["validated"] == [f"c{number}" for number in range(6)]
    assert looks.rule["validated"] == "the 6 best by validation score"
    figure = picture_of(trained, "learning")
    assert "2 others (in colour: the 6 best by training score)" in legend(figure)
    assert {"c2", "c7"} <= set(labels(figure))
    assert not {"c0", "c1"} & set(labels(figure))
    chosen = looks_of([trained], ["c0", "c7"])
    assert chosen.coloured["gridworld"] == ["c0", "c7"]
    assert chosen.of(trained, trained.rows[1]).colour == OTHERS
    assert len({chosen.styles[one].colour for one in ("c0", "c7")}) == 2


def test_rows_in_colour_are_told_apart(tmp_path: Path) -> None:
    """Imitation's own blue is nearly IMPALA's."""
    for condition in ("impala", "imitation"):
        write_run(tmp_path, constant(0.5), condition=condition)
    table = only_table(tmp_path)
    styles = looks_of([table]).styles
    assert styles["impala"].colour == ROWS["impala"]["colour"].upper()
    assert _distance(styles["impala"].colour, styles["imitation"].colour) > TOO_NEAR


def test_a_pretrained_agents_curve_begins_at_the_frames_it_inherited(tmp_path: Path) -> None:
    there = {"experiment": "gridworld", "condition": "impala", "seed": 0, "update": 300}
    there |= {"frames": 1_000_000, "parts": ["encoder"]}
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.6), condition="r2d2", pretrained=there)
    table = only_table(tmp_path)
    assert list(table.frames.values()) == [1_228_800, 2_228_800]
    figure = picture_of(table, "learning")
    assert figure.axes[0].get_xlabel() == "Frames"
    own, pretrained = figure.axes[0].lines[:2]
    np.testing.assert_array_equal(own.get_xdata(), [409_600, 819_200, 1_228_800])
    np.testing.assert_array_equal(pretrained.get_xdata(), [1_409_600, 1_819_200, 2_228_800])


def test_labels_do_not_lie_on_each_other() -> None:
    places = apart([0.5, 0.5, 0.52, 1.0, 1.0], [0.1] * 5)
    assert all(high - low > 0.0999 for low, high in itertools.pairwise(places))
    assert max(places) < 1
    assert apart([0.2, 0.8], [0.1, 0.1]) == [0.2, 0.8]


def test_lines_at_one_have_room_above(tmp_path: Path) -> None:
    levels = [
        level(kind, kind, expert=1.0, generalist=1.0) for kind in ("train", "uniform", "rare")
    ]
    write_run(tmp_path, constant(0.5), levels=levels)
    figure = picture_of(only_table(tmp_path), "learning")
    assert figure.axes[0].get_ylim()[1] > 1.04
    assert "Generalist, Expert" in labels(figure)  # one line, not two on each other
