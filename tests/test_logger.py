"""The tables of a run: complete columns, and resumed without rows of later updates."""

import numpy as np
import pandas as pd
import pytest

from zipf.errors import UserError
from zipf.experiments.records.result_table import ResultTable
from zipf.experiments.training.logger import Logger

ROWS = [{"loss": 0.5}, {"loss": 0.25, "kl": 1.0}, {"kl": 2.0, "a, quoted": 3.0}, {"loss": 0.125}]


def write(folder, rows, after=0, saved=None):
    """Rows of the updates from `after` + 1 on; returns the table's file and what a checkpoint after
    the row `after` would know of it."""
    logger = Logger(folder, resume_at=after or -1, saved=saved)
    states = [logger.state_dict()]
    for update, row in enumerate(rows, after + 1):
        logger.metrics(update, row)
        states.append(logger.state_dict())
    logger.close()
    return folder / "metrics.csv", states


def test_metrics_may_appear_after_the_first_row(tmp_path):
    table = pd.read_csv(write(tmp_path, ROWS)[0])
    assert list(table.columns) == ["update", "loss", "kl", "a, quoted"]
    for index, row in enumerate(ROWS):
        for name in ("loss", "kl", "a, quoted"):
            np.testing.assert_equal(table[name][index], row.get(name, np.nan))


@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_resumed_table_equals_an_uninterrupted_one(tmp_path, after):
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    whole = write(tmp_path / "whole", ROWS)[0].read_bytes()
    path, states = write(tmp_path / "cut", ROWS)
    with open(path, "a") as file:
        file.write("5,0.0")  # a line that a crash cut
    write(tmp_path / "cut", ROWS[after:], after, states[after])
    assert path.read_bytes() == whole
    assert [file.name for file in path.parent.iterdir() if file.is_file()] == ["metrics.csv"]


def test_rows_of_one_evaluation_may_have_different_columns(tmp_path):
    """None is lost that appears after the first."""
    table = ResultTable(tmp_path / "table.csv")
    table.append([{"update": 0, "a": 1}, {"update": 0, "b": 2}, {"update": 0, "a": 3, "c": 4}])
    table.append([{"update": 1, "d": 5}])
    shown = pd.read_csv(tmp_path / "table.csv", dtype=str, keep_default_na=False)
    assert shown.to_dict("list") == {
        "update": ["0", "0", "0", "1"],
        "a": ["1", "", "3", ""],
        "b": ["", "2", "", ""],
        "c": ["", "", "4", ""],
        "d": ["", "", "", "5"],
    }
    ResultTable.check(tmp_path / "table.csv", 1, table.state_dict())


def test_a_damaged_line_is_an_error(tmp_path):
    path, states = write(tmp_path, ROWS)
    path.write_text(path.read_text().replace("\n2,", "\ntwo,"))
    with pytest.raises(UserError, match=r"metrics\.csv, line 3"):
        write(tmp_path, ROWS, 4, states[4])


def curve(folder):
    """The points of a curve that TensorBoard shows."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return [(point.step, point.value) for point in events.Scalars("train/loss")]


@pytest.mark.parametrize("clock", [[3e9, 2e9, 1e9], [1e9, 1e9, 1e9]], ids=["set back", "frozen"])
def test_tensorboard_shows_the_whole_curve_whatever_the_clock_says(tmp_path, monkeypatch, clock):
    rows = [{"loss": float(update)} for update in range(1, 7)]
    saved = None
    for part, now in enumerate(clock):
        monkeypatch.setattr("time.time", lambda now=now: now)
        monkeypatch.setattr("time.time_ns", lambda now=now: int(now * 1e9))
        _, states = write(tmp_path, rows[2 * part : 2 * part + 2], 2 * part, saved)
        saved = states[-1]
    assert curve(tmp_path) == [(update, float(update)) for update in range(1, 7)]
    assert len(list((tmp_path / "tensorboard").iterdir())) == 3
