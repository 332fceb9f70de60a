"""The tables of a run: complete columns, and resumed without rows of later updates."""

import numpy as np
import pandas as pd
import pytest

from zipf.experiments.errors import UserError
from zipf.experiments.running.logger import Logger

ROWS = [{"loss": 0.5}, {"loss": 0.25, "kl": 1.0}, {"kl": 2.0, "a, quoted": 3.0}, {"loss": 0.125}]


def write(folder, rows, after=0):
    logger = Logger(folder, resume_at=after or -1)
    for update, row in enumerate(rows, after + 1):
        logger.metrics(update, row)
    logger.close()
    return folder / "metrics.csv"


def test_metrics_may_appear_after_the_first_row(tmp_path):
    table = pd.read_csv(write(tmp_path, ROWS))
    assert list(table.columns) == ["update", "loss", "kl", "a, quoted"]
    for index, row in enumerate(ROWS):
        for name in ("loss", "kl", "a, quoted"):
            np.testing.assert_equal(table[name][index], row.get(name, np.nan))


@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_resumed_table_equals_an_uninterrupted_one(tmp_path, after):
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    whole = write(tmp_path / "whole", ROWS).read_bytes()
    path = write(tmp_path / "cut", ROWS)
    with open(path, "a") as file:
        file.write("5,0.0")  # a line that a crash cut
    write(tmp_path / "cut", ROWS[after:], after)
    assert path.read_bytes() == whole
    assert [file.name for file in path.parent.iterdir() if file.is_file()] == ["metrics.csv"]


def test_a_damaged_line_is_an_error(tmp_path):
    path = write(tmp_path, ROWS)
    path.write_text(path.read_text().replace("\n2,", "\ntwo,"))
    with pytest.raises(UserError, match=r"metrics\.csv, line 3"):
        write(tmp_path, ROWS)
