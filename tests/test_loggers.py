"""The tables of a run: appended, and cut to their length at a checkpoint when it goes on; and the
loggers: what they are called with, may ask for, and cannot break."""

import os
from pathlib import Path
from typing import Literal

import pandas as pd
import pytest
from conftest import TINY, assert_equal, learned, untimed

from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.loggers import LOGGERS, End, Logger, Start
from zipf.experiments.loggers.tensorboard import TensorBoard, TensorBoardOptions
from zipf.experiments.records.result_table import ResultTable, check_table
from zipf.experiments.training import runner
from zipf.experiments.training.tables import Tables
from zipf.options import Options

ROWS = [{"loss": 0.5}, {"loss": 0.25, "kl": 1.0}, {"kl": 2.0, "a, quoted": 3.0}, {"loss": 0.125}]


def write(folder, rows, after=0, lengths=None):
    """Metrics of the updates from `after` + 1 on; returns their file and what a checkpoint after
    each would know of the tables."""
    tables = Tables(folder, after, lengths)
    found = [tables.lengths()]
    for update, row in enumerate(rows, after + 1):
        tables.metrics({"update": update, "frames": 10 * update, "seconds": 0.5}, row)
        found.append(tables.lengths())
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


def events_in(folder):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder), size_guidance={"images": 0})
    events.Reload()
    return events


def points(folder, tag):
    """The points of a curve that TensorBoard shows."""
    return [(point.step, point.value) for point in events_in(folder).Scalars(tag)]


def start(folder, update=0, **options):
    return Start(folder, "a run", update == 0, update, 10 * update, options, ("train", "rare"))


@pytest.mark.parametrize("clock", [[3e9, 2e9, 1e9], [1e9, 1e9, 1e9]], ids=["set back", "frozen"])
def test_tensorboard_shows_the_whole_curve_whatever_the_clock_says(tmp_path, monkeypatch, clock):
    for part, now in enumerate(clock):
        monkeypatch.setattr("time.time", lambda now=now: now)
        monkeypatch.setattr("time.time_ns", lambda now=now: int(now * 1e9))
        logger = TensorBoard(TensorBoardOptions(name="tensorboard", film=False))
        logger.on_start(start(tmp_path, 2 * part))
        for update in range(2 * part + 1, 2 * part + 4):  # one more than the next part begins with
            when = {"update": update, "frames": 10 * update, "seconds": 0.5}
            logger.on_update(when, {"loss": update + 0.5 * part})
        logger.on_end(End(update, False, lambda: None))
    shown = [1.0, 2.0, 3.5, 4.5, 6.0, 7.0, 8.0]
    folder = tmp_path / "tensorboard"
    assert points(folder, "train/loss") == [*enumerate(shown, 1)][:7]
    frames = [(10 * update, loss) for update, loss in enumerate(shown, 1)]
    assert points(folder / "by_frames", "train/loss") == frames
    assert len(list(folder.glob("events*"))) == 3


OPTIONS = [*TINY, "updates=4", "schedule.window=[0,4]"]


def test_tensorboard_has_scores_options_and_a_film(tmp_path):
    more = ["loggers.tensorboard.film=true", f"run_root={tmp_path}"]
    config = loading.load([*OPTIONS, *more])
    assert runner.train(config) == 0
    folder = config.folder / "tensorboard"
    rows = pd.read_csv(config.folder / "evaluations.csv")
    rare = rows[rows["level_kind"] == "rare"]
    for where, column in ((folder, "update"), (folder / "by_frames", "frames")):
        shown = points(where, "score/rare")
        assert [step for step, _ in shown] == rare[column].tolist()
        assert [value for _, value in shown] == pytest.approx(rare["score"].tolist())
    events = events_in(folder)
    (film,) = events.Images("failure in the rarest situation")
    assert (film.encoded_image_string[:4], film.step) == (b"GIF8", 4)
    described = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    assert b"agent.discount" in described


class OwnOptions(Options):
    name: Literal["own"]
    fails: str = ""
    stops: str = ""
    after: int = 2


@pytest.fixture
def own(own_registries):
    """A logger that remembers its calls, and fails or asks to stop in the method that it is asked
    to, from the update `after` on."""
    calls = []

    class Own(Logger):
        def __init__(self, options):
            self.options = options

        def _called(self, method, update, *given):
            calls.append((method, update, *given))
            if update >= self.options.after and method == self.options.fails:
                raise ConnectionError("the network\nis down")
            return "enough" if method == self.options.stops else None

        def on_start(self, run):
            return self._called("on_start", run.update, run.options["agent"]["name"])

        def on_update(self, when, metrics):
            return self._called("on_update", when["update"], "loss" in str(sorted(metrics)))

        def on_evaluation(self, when, scores):
            return self._called("on_evaluation", when["update"], sorted(scores))

        def on_end(self, end):
            return self._called("on_end", end.update, end.finished)

    LOGGERS.register(OwnOptions, Own)
    return calls


def trained_with(tmp_path, *options):
    config = loading.load([*OPTIONS, f"run_root={tmp_path}", *options])
    assert runner.train(config) == 0
    return config


def test_a_logger_is_called_as_the_run_goes_on(own, tmp_path):
    trained_with(tmp_path, "loggers=[own]")
    methods = [call[0] for call in own]
    assert own[0] == ("on_start", 0, "impala")
    scored = ["fresh", "rare", "train", "uniform", "validation"]
    assert [call[1:] for call in own if call[0] == "on_evaluation"] == [(0, scored), (4, scored)]
    assert methods.count("on_update") == 4
    assert own[-1] == ("on_end", 4, True)


@pytest.mark.parametrize("method", ["on_update", "on_evaluation", "on_end"])
def test_a_logger_that_fails_costs_no_run(own, tmp_path, method, capsys):
    config = trained_with(
        tmp_path / "a", "loggers=[tensorboard,own]", f"loggers.own.fails={method}"
    )
    printed = capsys.readouterr().out
    assert "loggers=[own]: ConnectionError: the network is down (" in printed
    assert "the network is down" in (config.folder / "train.log").read_text()
    assert printed.count("it is switched off since update") == (0 if method == "on_end" else 2)
    without = trained_with(tmp_path / "b", "loggers=[]")
    assert_equal(learned(config.folder), learned(without.folder))
    for name in ("metrics.csv", "evaluations.csv"):
        pd.testing.assert_frame_equal(untimed(config.folder / name), untimed(without.folder / name))
    assert not (without.folder / "tensorboard").exists()


class UselessOptions(Options):
    name: Literal["useless"]


def test_a_logger_that_cannot_start_is_one_line_and_others_end(own, tmp_path):
    def useless(options):
        raise ConnectionError("nobody is\nlogged in")

    LOGGERS.register(UselessOptions, useless)
    with pytest.raises(UserError, match=r"^loggers=\[useless\]: ConnectionError: nobody is logged"):
        trained_with(tmp_path, "loggers=[own,useless]")
    assert [call[0] for call in own] == ["on_start", "on_end"]
    with pytest.raises(UserError, match=r"^loggers=\[own\]: ConnectionError: the network is down"):
        trained_with(tmp_path, "loggers=[own]", "loggers.own.fails=on_start", "loggers.own.after=0")


@pytest.mark.parametrize(
    ("method", "at"), [("on_start", 0), ("on_evaluation", 0), ("on_update", 1)]
)
def test_a_logger_may_stop_the_run_which_goes_on(own, tmp_path, method, at, capsys):
    config = trained_with(tmp_path, "loggers=[own]", f"loggers.own.stops={method}")
    assert f"stopped at update {at} (own: enough); the same command" in capsys.readouterr().out
    assert checkpoint.load(config.folder / "checkpoint.pt")["update"] == at
    assert own[-1] == ("on_end", at, False)
    again = trained_with(tmp_path, "loggers=[]")
    assert_equal(learned(again.folder), learned(trained_with(tmp_path / "b").folder))


UNKNOWN = "no such logger; should be one of tensorboard, wandb; loggers=[] for none"


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("loggers=[wand]", "loggers=[wand]: no such logger; did you mean wandb?"),
        ("loggers=none", f"loggers=[none]: {UNKNOWN}"),
        ("loggers.wandb.mode=offline", "choose it: loggers=[tensorboard,wandb]"),
        ("loggers=[wandb] loggers.wandb.mode=no", "should be 'online' or 'offline'"),
        ("loggers=[wandb] loggers.wandb.modes=x", "did you mean loggers.wandb.mode?"),
    ],
)
def test_mistakes_are_one_line(given, line):
    with pytest.raises(UserError) as raised:
        loading.load([*OPTIONS, *given.split()])
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_without_wandb_its_logger_says_what_to_install(monkeypatch):
    monkeypatch.setattr("zipf.experiments.loggers.weights_and_biases.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"needs wandb: pip install '\.\[wandb\]' in a clone"):
        loading.load([*OPTIONS, "loggers=[wandb]"])


@pytest.mark.slow  # it starts wandb's own process
def test_weights_and_biases_offline(tmp_path):
    options = ["loggers=[wandb]", "loggers.wandb.mode=offline", "loggers.wandb.film=true"]
    first = trained_with(tmp_path, *options, "updates=2")
    name = (first.folder / "wandb.txt").read_text()
    trained_with(tmp_path, *options)
    assert (first.folder / "wandb.txt").read_text() == name
    files = list(first.folder.glob("wandb/offline-run-*/*.wandb"))
    assert {file.name for file in files} == {f"run-{name.strip()}.wandb"}
    assert len(files) == 2
    content = b"".join(file.read_bytes() for file in files)
    assert b"score/rare" in content
    assert b"failure" in content
