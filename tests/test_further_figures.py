"""Figures of time, of averages, of frequencies and of visits: what is drawn where."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from run_folders import (
    SITUATIONS,
    constant,
    labels,
    level,
    only_table,
    picture_of,
    write_external,
    write_run,
)

from zipf.experiments.records.wording import KIND_NAMES
from zipf.experiments.reporting.charts import (
    KIND_MARKS,
    ZERO,
    _log_axis,
    _visits_axis,
    averages,
    by_visits,
    frequencies,
    learning_curves,
)
from zipf.experiments.reporting.panels import GREY, Chart, Looks, looks_of
from zipf.experiments.reporting.situations import shares
from zipf.experiments.reporting.tables import ScoreTable
from zipf.protocol import PAPER_KINDS


def points(chart: Chart | None, panel: int = 0) -> list[list[list[float]]]:
    """The points of each line of a panel that has some."""
    assert chart is not None
    lines = [one for one in chart.panels[panel].lines if one.is_drawn]
    return [np.column_stack([one.x, one.y]).round(6).tolist() for one in lines]


def shown(folder: Path) -> tuple[ScoreTable, Looks]:
    table = only_table(folder)
    return table, looks_of([table])


def curves(table: ScoreTable, across: str = "") -> Chart | None:
    return learning_curves(table, looks_of([table]), across)


def test_scores_against_time_and_frames(tmp_path: Path) -> None:
    """An update takes 2.5 seconds in these runs and has 4096 frames."""
    write_run(tmp_path, {0: (0.1,) * 3, 240: (0.5,) * 3})
    table = only_table(tmp_path)
    assert points(curves(table, "update"))[0] == [[0.0, 0.1], [240.0, 0.5]]
    assert points(curves(table, "frames"))[0] == [[0.0, 0.1], [240.0 * 4096, 0.5]]
    assert points(curves(table, "time"))[0] == [[0.0, 0.1], [10.0, 0.5]]
    minutes = picture_of(table, "time")
    np.testing.assert_array_equal(minutes.axes[0].lines[0].get_xdata(), [0, 10])
    assert minutes.axes[0].get_xlabel() == "Minutes of training and evaluation"
    assert minutes.get_suptitle() == "gridworld: score against minutes"
    updates = picture_of(table, "learning")
    np.testing.assert_array_equal(updates.axes[0].lines[0].get_xdata(), [0, 240])
    updates.draw_without_rendering()
    (above,) = updates.axes[0].child_axes
    assert above.get_xlabel() == "Frames"
    assert above.get_xlim() == pytest.approx([4096 * end for end in updates.axes[0].get_xlim()])


def test_times_on_different_devices_are_not_compared(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5))
    write_run(tmp_path, constant(0.5), seed=1, device="a GPU")
    table = only_table(tmp_path)
    assert curves(table, "time") is None
    (note,) = (note for note in table.notes if "times are not compared" in note)
    assert note.startswith("Runs were on cpu; a GPU: ")


def test_a_run_that_went_on_elsewhere_was_on_both_devices(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.5), resumed=[{"update": 100, "device": "a GPU"}])
    assert curves(only_table(tmp_path), "time") is None


def test_long_runs_are_drawn_in_hours_without_external_agents(tmp_path: Path) -> None:
    write_run(tmp_path, {0: (0.1,) * 3, 14400: (0.5,) * 3})
    write_external(tmp_path, {7: (0.3, 0.2, 0.1)})
    table = only_table(tmp_path)
    assert points(curves(table, "time"))[0] == [[0.0, 0.1], [10.0, 0.5]]
    hours = picture_of(table, "time")
    assert hours.axes[0].get_xlabel() == "Hours of training and evaluation"
    assert not any("†" in text for text in labels(hours))
    assert any("†" in text for text in labels(picture_of(table, "learning")))


def test_averages_are_the_scores_of_the_table(tmp_path: Path) -> None:
    for seed, rare in enumerate((0.1, 0.2, 0.4)):
        scores = {update: (0.9, 0.6, rare) for update in (100, 200, 300)}
        write_run(tmp_path, scores, seed=seed)
    write_run(tmp_path, {}, condition="r2d2")  # without a score
    found = points(averages(*shown(tmp_path)))
    assert [[0.1, 0.0], [0.9, 0.0]] not in found  # the rare score is the median of the seeds
    assert [[0.2, 0.0], [0.9, 0.0]] in found
    assert [[0.1, 0.0], [0.4, 0.0]] in found  # lowest to highest seed
    for place in (0.9, 0.6, 0.2):
        assert [[place, 0.0]] in found
    figure = picture_of(only_table(tmp_path), "averages")
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == ["IMPALA", "Chance", "Blind"]


@pytest.mark.parametrize("seeds", [1, 2])
def test_averages_explain_ranges_of_seeds_only_where_there_are_some(
    tmp_path: Path, seeds: int
) -> None:
    for seed in range(seeds):
        write_run(tmp_path, constant(0.1 * seed), seed=seed)
    figure = picture_of(only_table(tmp_path), "averages")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert ("Lowest to highest seed" in texts) == (seeds > 1)


def test_the_legend_of_averages_is_no_mark_of_a_row(tmp_path: Path) -> None:
    """Also where the last row, an agent as no baseline is known, lacks a kind."""
    levels = [level(kind, f"gridworld/{kind}") for kind in PAPER_KINDS]
    write_run(tmp_path, constant(0.5), levels=levels)
    folder = write_run(tmp_path, constant(0.6), condition="r2d2", levels=levels)
    written = (folder / "evaluations.csv").read_text().splitlines(keepends=True)
    (folder / "evaluations.csv").write_text("".join(x for x in written if ",rare," not in x))
    chart = averages(*shown(tmp_path))
    assert chart is not None
    assert not [one for one in chart.panels[0].lines if one.colour == GREY and one.opacity]
    figure = picture_of(only_table(tmp_path), "averages")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == [KIND_NAMES[kind] for kind in PAPER_KINDS]
    handles = figure.legends[0].legend_handles
    assert [handle.get_alpha() for handle in handles if handle] == [None] * 3


def test_a_logarithmic_axis_has_ticks_between_round_numbers() -> None:
    axis = _log_axis("", [1 / 3, 0.35], lambda share: f"{100 * share:.3g} %")
    assert axis.ticks == ([1 / 3, 0.35], ["33.3 %", "35 %"])
    assert _visits_axis("", pd.Series([3333.3])).ticks == ([3333.3], ["3.33k"])


def test_long_titles_of_averages_have_room(tmp_path: Path) -> None:
    options = ", network=comparing, precision=bfloat16, collector.num_envs=64"
    for number, title in enumerate(["A", "B" + 3 * options, "C" + 2 * options, "D", "E" + options]):
        row = {"title": title, "order": number, "colour": None, "line": "solid"}
        write_run(tmp_path, constant(0.5), condition=title[0], row=row)
    figure = picture_of(only_table(tmp_path), "averages")
    figure.draw_without_rendering()
    labels = figure.axes[0].get_yticklabels()
    assert max(label.get_text().count("\n") for label in labels) > 4
    boxes = [label.get_window_extent() for label in labels]
    for above, below in itertools.pairwise(boxes):
        assert above.y0 > below.y1
    assert boxes[-1].y0 > figure.axes[0].xaxis.label.get_window_extent().y1


def test_frequencies_are_shares_of_episodes(tmp_path: Path) -> None:
    rows = (
        SITUATIONS,
        "100,train,0,0,75,1,1.0",
        "300,train,1,0,25,1,1.0",
        "300,uniform,0,0,5,1,1.0",
        "300,uniform,1,0,5,1,1.0",
    )
    write_run(tmp_path, constant(0.5), situations=rows)
    table = only_table(tmp_path)
    found = points(frequencies(table))
    assert found[list(KIND_MARKS).index("train")] == [[1.0, 0.75], [2.0, 0.25]]
    assert found[list(KIND_MARKS).index("uniform")] == [[1.0, 0.5], [2.0, 0.5]]


def test_levels_that_differ_in_weight_are_as_frequent_as_their_weights(tmp_path: Path) -> None:
    levels = [
        level("train", "a", 3.0),
        level("train", "b", 1.0),
        level("uniform", "a"),
        level("uniform", "b"),
        level("rare", "b"),
    ]
    rows = (
        "update,level_kind,level,episodes,successes,return_sum",
        *(f"300,train,{rank},50,25,25.0" for rank in (0, 1)),
    )
    described = {"levels": levels, "situation": {"level": 2}, "paper": None}
    write_run(tmp_path, constant(0.5, 5), situations=rows, **described)
    assert shares(only_table(tmp_path), "level").to_numpy().tolist() == [
        ["train", 0, 0.75],
        ["train", 1, 0.25],
        ["uniform", 0, 0.5],
        ["uniform", 1, 0.5],
        ["rare", 1, 1.0],
    ]


def test_success_against_visits(tmp_path: Path) -> None:
    rows = (
        f"{SITUATIONS},visits,visits_map,visits_target",
        "300,uniform,0,0,10,9,9.0,50000,80000,70000",
        "300,uniform,0,1,4,1,1.0,2,80000,50",
        "300,uniform,1,0,5,2,2.0,0,60,70000",
    )
    write_run(tmp_path, constant(0.5), situations=rows)
    table = only_table(tmp_path)
    chart = by_visits(table, looks_of([table]))
    assert points(chart) == [[[ZERO, 0.4], [2.0, 0.25], [50_000.0, 0.9]]]
    assert chart is not None
    axis = chart.panels[0].x
    assert axis.ticks == ([ZERO, 1, 10, 100, 1000, 10_000], ["0", "1", "10", "100", "1k", "10k"])
    assert chart.panels[0].lines[0].points[1] == "IMPALA, met 2 times: 0.250 of 4 episodes"
    figure = picture_of(table, "visits")
    assert [axis.get_title() for axis in figure.axes] == ["Situation", "Map", "Target"]
    figure.draw_without_rendering()
    for axis in figure.axes:
        boxes = [label.get_window_extent() for label in axis.get_xticklabels()]
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
    write_run(tmp_path / "b", constant(0.5), situations=(SITUATIONS, "300,uniform,0,0,9,9,9.0"))
    uncounted = only_table(tmp_path / "b")
    assert by_visits(uncounted, looks_of([uncounted])) is None
