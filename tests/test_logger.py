"""The tables of a run: appended, and cut to their length at a checkpoint when it goes on."""

import os
from pathlib import Path

import pandas as pd
import pytest
from conftest import TINY

from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.records.result_table import ResultTable, check_table
from zipf.experiments.training import runner
from zipf.experiments.training.logger import Logger

ROWS = [{"loss": 0.5}, {"loss": 0.25, "kl": 1.0}, {"kl": 2.0, "a, quoted": 3.0}, {"loss": 0.125}]


def write(folder, rows, after=0, lengths=None):
    """Metrics of the updates from `after` + 1 on; returns their file and what a checkpoint after
    each would know of the tables."""
    logger = Logger(folder, resume_at=after or -1, lengths=lengths)
    found = [logger.lengths()]
    for update, row in enumerate(rows, after + 1):
        logger.metrics({"update": update, "frames": 10 * update, "seconds": 0.5}, row)
        found.append(logger.lengths())
    logger.close()
    return folder / "metrics.csv", found


def test_metrics_may_come_and_go(tmp_path):
    table = pd.read_csv(write(tmp_path, ROWS)[0])
    assert list(table.columns) == ["update", "frames", "seconds", "metric", "value"]
    for update, row in enumerate(ROWS, 1):
        rows = table[table["update"] == update]
        assert dict(zip(rows["metric"], rows["value"], strict=True)) == row
        assert (rows["frames"] == 10 * update).all()


@pytest.mark.parametrize("after", [1, 2, 3])
def test_a_resumed_table_equals_an_uninterrupted_one(tmp_path, after):
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    whole = write(tmp_path / "whole", ROWS)[0].read_bytes()
    path, lengths = write(tmp_path / "cut", ROWS)
    with open(path, "a") as file:
        file.write("5,0.0")  # a line that a crash cut
    write(tmp_path / "cut", ROWS[after:], after, lengths[after])
    assert path.read_bytes() == whole
    assert [file.name for file in path.parent.iterdir() if file.is_file()] == ["metrics.csv"]


def test_the_header_is_that_of_the_first_rows(tmp_path):
    table = ResultTable(tmp_path / "table.csv")
    table.append([])
    assert table.length() == 0
    table.append([{"update": 0, "a": 1}, {"update": 0}])
    content = (tmp_path / "table.csv").read_bytes()
    assert content == b"update,a\n0,1\n0,\n"
    with pytest.raises(ValueError, match="'b'"):
        table.append([{"update": 1, "a": 2}, {"update": 1, "b": 2}])
    assert (tmp_path / "table.csv").read_bytes() == content
    check_table(tmp_path / "table.csv", 0, table.length())


def test_a_damaged_line_is_an_error(tmp_path):
    path, lengths = write(tmp_path, ROWS)
    path.write_text(path.read_text().replace("\n2,20,", "\ntwo,0"))
    with pytest.raises(UserError, match=r"metrics\.csv, line 3"):
        write(tmp_path, ROWS, 4, lengths[4])


def test_rows_are_on_the_disk_before_the_checkpoint_that_counts_them(tmp_path, monkeypatch):
    """At every replacement of the checkpoint, the tables have been forced to the disk up to the
    lengths in it: whenever the machine stops, no checkpoint knows of rows that are lost."""
    forced: dict[int, int] = {}
    replaced = []
    fsync, replace = os.fsync, os.replace

    def forcing(descriptor):
        fsync(descriptor)
        forced[os.fstat(descriptor).st_ino] = os.fstat(descriptor).st_size

    def replacing(new, old):
        if Path(old).name == "checkpoint.pt":
            saved = checkpoint.load(Path(new))
            for name, length in saved["tables"].items():
                path = Path(old).with_name(name)
                assert (forced.get(path.stat().st_ino, 0) if path.exists() else 0) >= length
            replaced.append((saved["update"], saved["evaluated"], saved["tables"]))
        replace(new, old)

    monkeypatch.setattr(os, "fsync", forcing)
    monkeypatch.setattr(os, "replace", replacing)
    config = loading.load([*TINY, "updates=6", f"run_root={tmp_path}"])
    assert runner.train(config) == 0
    assert [update for update, *_ in replaced] == [0, 5, 6]
    for update, evaluated, lengths in replaced:
        for name, last in (("metrics.csv", update), ("evaluations.csv", evaluated)):
            cut = (config.folder / name).read_bytes()[: lengths[name]]
            assert cut.endswith(b"\n") or update == 0
            updates = [int(line.split(b",")[0]) for line in cut.splitlines()[1:]]
            assert max(updates, default=0) == last


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
        _, lengths = write(tmp_path, rows[2 * part : 2 * part + 2], 2 * part, saved)
        saved = lengths[-1]
    assert curve(tmp_path) == [(update, float(update)) for update in range(1, 7)]
    assert len(list((tmp_path / "tensorboard").iterdir())) == 3
